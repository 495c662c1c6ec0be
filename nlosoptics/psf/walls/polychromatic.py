"""Point spread of light of several wavelengths."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, positive, whole
from ...errors import SceneError
from ..transform.point_spread import Normalisation, PointSpread, point_spread
from ..wave.wavefront import Wavefront
from ..window.window import window_shape

Array = NDArray[np.float64]


def gaussian_band(centre: float, bandwidth: float, *, count: int = 5) -> tuple[Array, Array]:
    """Wavelengths and weights that stand for a Gaussian line.

    Parameters
    ----------
    centre : float
        m.
    bandwidth : float
        Full width at half maximum, m; below a third of the centre.
    count : int
        Wavelengths, 1 to 64.

    Returns
    -------
    wavelengths, weights : ndarray, (count,)
        Gauss-Hermite nodes, m, and weights of sum 1: exact for what varies with the wavelength as a
        polynomial of degree ``2 count - 1``.
    """
    centre = positive("centre", centre, unit="m")
    in_range("bandwidth", bandwidth, 0.0, centre / 3, unit="m")
    count = whole("count", count, 1, 64)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    sigma = bandwidth / math.sqrt(8 * math.log(2))
    wavelengths = centre + sigma * nodes
    if wavelengths.min() <= 0.2 * centre:
        raise SceneError(
            f"count = {count} wavelengths of a line of {bandwidth:g} m reach {wavelengths.min():g} "
            "m; take fewer, or a narrower line"
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
) -> PointSpread:
    """Point spread of light of several wavelengths, their intensities added.

    Parameters
    ----------
    wavefront : Wavefront
        Its path errors, in m, hold for every wavelength: a wall is a mirror, without dispersion.
    wavelengths : array_like, (n,)
        m.
    weights : array_like, (n,), optional
        Energy of each, of any sum; equal by default.
    tol : float
        As for `point_spread`, of every wavelength.
    pitch, shape, normalisation, pixel_integrated
        As for `point_spread`; by default the sampling that the shortest wavelength needs and the
        window of the widest spot.

    Returns
    -------
    PointSpread
        ``wavelength`` is the weighted mean, ``error_estimate`` the largest; ``regime`` and
        ``reason`` are those of the first.

    Raises
    ------
    SceneError
        If the weights do not fit the wavelengths, or are negative or all zero.
    """
    lines = np.atleast_1d(np.asarray(wavelengths, dtype=np.float64))
    shares = np.ones(lines.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    if lines.ndim != 1 or shares.shape != lines.shape or not len(lines):
        raise SceneError(
            f"wavelengths {lines.shape} and weights {shares.shape} do not fit; give (n,) of both"
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
        wavelength=float((shares * lines).sum()),
        enclosed_energy=float(
            sum(s * p.enclosed_energy for s, p in zip(shares.tolist(), parts, strict=True))
        ),
    )
