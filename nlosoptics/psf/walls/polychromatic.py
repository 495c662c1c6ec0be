"""Polychromatic point spread functions: sums over several wavelengths."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, positive, whole
from ...errors import SceneError
from ..transform.models import Model
from ..transform.point_spread import Normalisation, PointSpread, point_spread
from ..wave.wavefront import Wavefront
from ..window.window import window_shape

Array = NDArray[np.float64]


def gaussian_band(centre: float, bandwidth: float, *, count: int = 5) -> tuple[Array, Array]:
    """Return wavelengths and weights that represent a Gaussian spectrum.

    `band_point_spread` takes them.

    Parameters
    ----------
    centre : float
        Centre wavelength in vacuum, m.
    bandwidth : float
        Full width of the spectrum at half maximum, m, 0 to a third of the centre wavelength.
    count : int
        Number of wavelengths, 1 to 64.

    Returns
    -------
    wavelengths, weights : ndarray, (count,)
        Vacuum wavelengths, m, and weights of sum 1. The weighted sum of a function of the
        wavelength is its mean over the spectrum (Gauss-Hermite quadrature). It is exact for
        polynomials up to degree ``2 count - 1``.

    Raises
    ------
    SceneError
        If an option is out of range, or a wavelength would be below a fifth of the centre.

    See Also
    --------
    band_point_spread : Sum of PSFs over wavelengths.

    Examples
    --------
    Three wavelengths for a line of 10 nm width at 632.8 nm:

    >>> from nlosoptics import psf
    >>> wavelengths, weights = psf.gaussian_band(632.8e-9, 10e-9, count=3)
    >>> print([f"{1e9 * w:.1f} nm" for w in wavelengths], weights.round(3))
    ['625.4 nm', '632.8 nm', '640.2 nm'] [0.167 0.667 0.167]
    """
    centre = positive("centre", centre, unit="m")
    in_range("bandwidth", bandwidth, 0.0, centre / 3, unit="m")
    count = whole("count", count, 1, 64)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    sigma = bandwidth / math.sqrt(8 * math.log(2))
    wavelengths = centre + sigma * nodes
    if wavelengths.min() <= 0.2 * centre:
        raise SceneError(
            f"count = {count} wavelengths at bandwidth = {bandwidth:g} m reach "
            f"{wavelengths.min():g} m, limit {0.2 * centre:g} m; take fewer, or a narrower band"
        )
    return wavelengths, weights / weights.sum()


def band_point_spread(
    wavefront: Wavefront,
    wavelengths: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
    model: Model = "auto",
) -> PointSpread:
    """Compute the point spread function of light of several wavelengths.

    The intensities of the wavelengths are added.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil. Its aberration, m, holds for every wavelength, because mirrors have
        no dispersion. Its own wavelength is not used.
    wavelengths : array_like, (n,)
        Vacuum wavelengths, m.
    weights : array_like, (n,), optional
        Energy at each wavelength, 0 or more, of any sum. Default: equal energies.
    tol : float
        Largest permitted error at each wavelength, relative to the peak; above 0, at most 1.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the shortest
        wavelength lambda and the F-number N.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx). Default: 256 per side, or more if a spot is wider.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1 at each wavelength: the energy in the whole image plane, the
        peak without aberration, or the energy that a clear disc of the pupil's radius transmits.
        With "unit-sum" and "flux", values are energies per pixel: the intensity times ``pitch^2``.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.
    model : {"auto", "scalar", "high-aperture"}
        Model of diffraction: scalar at small angles, or vector diffraction of a fast lens. "auto"
        takes the second if the error of the first exceeds ``tol``.

    Returns
    -------
    PointSpread
        Mean of the intensities, weighted by energy. Its ``wavelength`` is the weighted mean, and
        its errors are the largest of all wavelengths. ``regime`` and ``reason`` are those of the
        first wavelength.

    Raises
    ------
    SceneError
        If the weights do not match the wavelengths, are negative, or are all zero.
    SamplingError, MemoryLimitError
        If `point_spread` raises it for one of the wavelengths.

    See Also
    --------
    gaussian_band : Wavelengths and weights of a Gaussian spectrum.

    Examples
    --------
    A lens without aberration in light of 100 nm bandwidth:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=550e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> wavelengths, weights = psf.gaussian_band(550e-9, 100e-9)
    >>> spread = psf.band_point_spread(wave, wavelengths, weights, pitch=1e-6, shape=65)
    >>> spread.shape, f"{1e9 * spread.wavelength:.0f} nm"
    ((65, 65), '550 nm')
    """
    lines = np.atleast_1d(np.asarray(wavelengths, dtype=np.float64))
    shares = np.ones(lines.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    if lines.ndim != 1 or shares.shape != lines.shape or not len(lines):
        raise SceneError(
            f"wavelengths have shape {lines.shape} and weights {shares.shape}; give both of shape "
            "(n,)"
        )
    if not (np.isfinite(shares).all() and shares.min() >= 0.0 and shares.sum() > 0.0):
        raise SceneError(f"weights = {shares.tolist()}; give energies of at least 0, not all 0")
    shares = shares / shares.sum()
    waves = [replace(wavefront, wavelength=float(line)) for line in lines.tolist()]
    if pitch is None:
        pitch = min(wave.wavelength * abs(wave.f_number) for wave in waves) / 4
    if shape is None:
        shape = max(256, *(window_shape(wave, pitch=pitch, tol=max(tol, 1e-3)) for wave in waves))
    parts = [
        point_spread(
            wave,
            tol=tol,
            pitch=pitch,
            shape=shape,
            normalisation=normalisation,
            pixel_integrated=pixel_integrated,
            model=model,
        )
        for wave in waves
    ]
    total = np.zeros(parts[0].shape)
    for share, part in zip(shares.tolist(), parts, strict=True):
        total += share * part.intensity
    return replace(
        parts[0],
        intensity=total,
        method="+".join(dict.fromkeys(part.method for part in parts)),
        error_estimate=max(part.error_estimate for part in parts),
        model="+".join(dict.fromkeys(part.model for part in parts)),
        model_error=max(part.model_error for part in parts),
        wavelength=float((shares * lines).sum()),
        enclosed_energy=float(
            sum(s * p.enclosed_energy for s, p in zip(shares.tolist(), parts, strict=True))
        ),
    )
