"""Point spread functions of an exit-pupil wave."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, in_range, one_of, positive, seconds_limit
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._vectors import Array
from ..._xarray import Labelled, Labels, variable
from ...errors import SamplingError
from ..wave.detilted import Residual, split
from ..wave.regime import Regime
from ..wave.wavefront import Wavefront
from ..window.pixels import pixel_rule
from ..window.window import (
    Window,
    check_rays,
    default_shape,
    holds_rays,
    shape_of,
    window_side,
)
from .high_aperture import Polarisation, check_cone
from .models import Model, check_model, modelled
from .task import Task
from .transforms import ABLE

Method = Literal["auto", "quadrature", "fft", "mdft", "nufft", "airy", "geometric"]
Normalisation = Literal["unit-sum", "ideal-peak", "flux"]
METHODS = ("auto", "quadrature", "fft", "mdft", "nufft", "airy", "geometric")
NORMALISATIONS = ("unit-sum", "ideal-peak", "flux")


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSpread(Noun, Shown, Labelled):
    """Sampled point spread function (PSF): the image of a point, with an estimate of its error.

    Parameters
    ----------
    intensity : ndarray
        Intensity (ny, nx), read-only, row 0 at the lowest y. Sample [ny//2, nx//2] is at x = y = 0,
        where the optical axis meets the image plane.
    pitch : float
        Distance between samples, or pixel side, m.
    method : str
        Method that computed the intensity, such as "fft"; `point_spread` lists them.
    error_estimate : float
        Largest error of the intensity relative to its peak, an upper bound. It is the difference
        from the exact image of the given wave. Detail of a pupil map that its pixels do not resolve
        (`Wavefront.from_map`) is not included.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1: the energy in the whole image plane, the peak without
        aberration, or the energy that a clear disc of the pupil's radius transmits.
    wavelength : float
        Vacuum wavelength, m.
    f_number : float
        Working F-number N, image distance over pupil diameter. The pupil's radius is measured on
        the reference sphere, which is the sphere about the image point on the axis through the
        pupil's centre. N is therefore ``1/(2 sin(alpha))``, with alpha the half angle of the cone
        of light at the image.
    pixel_integrated : bool
        Whether values are means over square pixels, instead of samples at their centres. With
        "unit-sum" and "flux" both are multiplied by the area of a pixel.
    enclosed_energy : float
        Fraction of the transmitted energy inside the window, from the sum of all values. Its error
        is that of this sum: about 1e-3 at the default ``tol`` of `point_spread`. Use a smaller
        ``tol`` for more digits.
    regime : Regime
        Numbers on which the choice of the method was based, such as the aberration in wavelengths.
    reason : str
        One line: why this method was used, and why each other one was not.
    model : {"scalar", "high-aperture"}
        Model of diffraction: scalar at small angles, or vector diffraction of a fast lens.
    model_error : float
        Largest error of the scalar model relative to the peak, an upper bound. It is the difference
        from vector diffraction of unpolarised light. 0 for the high-aperture model.

    See Also
    --------
    point_spread : PSF of a given wave.
    scene_point_spread : Wave and PSF of a scene.
    PointSpreadField : PSFs at all points of the object.
    nlosoptics.views.point_spread : Map of a PSF.
    """

    intensity: Array
    pitch: float
    method: str
    error_estimate: float
    normalisation: str
    wavelength: float
    f_number: float
    pixel_integrated: bool
    enclosed_energy: float
    regime: Regime
    reason: str
    model: str = "scalar"
    model_error: float = math.inf

    _images: ClassVar[tuple[str, ...]] = ("intensity",)  # arrays of its own, read-only

    def __post_init__(self) -> None:
        for name in self._images:
            given = np.asarray(getattr(self, name))
            if given.flags.writeable or given.base is not None or not given.flags.c_contiguous:
                given = np.array(given, dtype=np.float64, order="C")
                given.setflags(write=False)
            object.__setattr__(self, name, np.asarray(given, dtype=np.float64))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples (ny, nx)."""
        ny, nx = self.intensity.shape
        return ny, nx

    @property
    def x(self) -> Array:
        """Coordinate x of each column in the image plane, (nx,), m."""
        return Window.centred(self.pitch, self.shape).x

    @property
    def y(self) -> Array:
        """Coordinate y of each row in the image plane, (ny,), m."""
        return Window.centred(self.pitch, self.shape).y

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.intensity, dtype=dtype, copy=copy is not False)

    def _labels(self) -> Labels:
        share = "1" if self.normalisation == "ideal-peak" else "1/pixel"
        intensity = variable("yx", self.intensity, share, f"point spread, {self.normalisation}")
        axes = {n: variable(n, getattr(self, n), "m", f"image plane {n}") for n in "yx"}
        names = ("pitch", "wavelength", "f_number", "method", "error_estimate", "normalisation")
        return Labels({"intensity": intensity}, axes, {n: getattr(self, n) for n in names})

    def _figures(self) -> Figures:
        ny, nx = self.shape
        kind = self.regime
        waves = f"{kind.peak_to_valley:.3g} waves peak to valley, {kind.rms:.3g} rms"
        if kind.rayleigh_parameter > 0.0:
            waves += f", Rayleigh parameter {kind.rayleigh_parameter:.3g}"
        samples = "pixels" if self.pixel_integrated else "samples"
        figures = {
            "method": self.method,
            "why": self.reason,
            "error": f"{self.error_estimate:.1e} of the peak",
            "model": _model_figure(self.model, self.model_error),
            "regime": waves,
            "pitch": f"{1e6 * self.pitch:.4g} µm, {kind.pixel:.3g} lambda N",
            samples: f"{ny} x {nx}",
            "energy within": f"{100 * self.enclosed_energy:.4g} %",
            "light": f"{1e9 * self.wavelength:.4g} nm at F/{self.f_number:.3g}",
        }
        alt = f"Point spread function, {ny} x {nx} {samples}, logarithmic colours"
        return Figures("Point spread", figures, alt)


def point_spread(
    wavefront: Wavefront | Residual,
    *,
    method: Method = "auto",
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
    max_seconds: float | None = None,
    model: Model = "auto",
    polarisation: Polarisation = "unpolarised",
) -> PointSpread:
    """Compute the point spread function (PSF) of a wave in the exit pupil.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil. Terms listed in ``wavefront.removed`` are not added back: only
        tilt that ``aberration`` still contains shifts the spot.
    method : str
        ``auto`` selects the fastest method whose estimated error is at most ``tol``. "Layout" below
        is the arrangement of the wave's sample points, see `Wavefront`.

        - ``quadrature`` integrates over the pupil by Gauss quadrature and a non-uniform FFT, for
          the layouts "polar" and "cells". It uses as many points as the window requires.
        - ``fft`` transforms as few samples of the pupil as ``tol`` allows: for the layout "polar"
          by FFTs of a grid with a softened rim if polynomials of a degree up to 10 describe the
          wave, otherwise, and for "cells", as ``quadrature`` does; for "grid" it is ``mdft``.
        - ``mdft`` is a chirp transform to any pitch, for the layout "grid".
        - ``nufft`` is a non-uniform FFT of scattered sample points, such as traced rays; for other
          layouts it is ``quadrature`` or ``mdft``.
        - ``airy`` is the closed form of a wave without aberration.
        - ``geometric`` is the density of rays in the image, without diffraction; ``auto`` tries it
          for more than 20 wavelengths of aberration with ``pixel_integrated``.
    tol : float
        Largest error of the intensity that ``auto`` accepts, relative to the peak; above 0, at most
        1. A method given by name samples as coarsely as ``tol`` allows. Its result is returned even
        if its ``error_estimate`` is larger.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the wavelength
        lambda and the F-number N; for ``fft`` of a wave on a grid, lambda N/2 or just below, a
        whole fraction of the image's period.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx); one number means a square. By default

        - at least 256 per side, enough for all rays and a margin of 16 lambda N for diffraction,
        - with ``pixel_integrated``, the size that `window_shape` returns,
        - for ``fft`` of a wave on a grid without a pitch, the full period of the image.

        All rays must arrive inside the window. There are exceptions, which accept any window if
        given as ``method``: ``quadrature``, ``nufft`` and, for the layout "grid", ``mdft``.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1: the energy in the whole image plane (``unit-sum``), the peak
        of the same pupil without aberration (``ideal-peak``), or the energy that a clear disc of
        the pupil's radius transmits (``flux``). With the first and the last, values are energies
        per pixel; without ``pixel_integrated`` that is the intensity at a sample times ``pitch^2``.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.
    max_seconds : float, optional
        Largest predicted run time on one core, s: ``auto`` skips a method beyond it. A method given
        by name always runs. Default 60 s, or the time left if `simulate` calls this function.
    model : {"auto", "scalar", "high-aperture"}
        ``scalar`` is scalar diffraction at small angles. ``high-aperture`` is the vector
        diffraction of a lens that satisfies the sine condition; it is available for ``quadrature``,
        ``mdft``, ``nufft`` and ``geometric``. ``model="auto"`` depends on ``method``. With a method
        given by name it is the scalar model. With ``method="auto"`` it is the high-aperture model
        if the scalar model's error exceeds ``tol`` or the light is polarised, and otherwise the
        scalar model.
    polarisation : {"unpolarised", "x", "y"} or float
        Polarisation of the light before the lens: none, linear along x or y, or linear at an angle
        from x toward y, rad. Only the high-aperture model depends on it.

    Returns
    -------
    PointSpread
        Intensity (ny, nx), row 0 at the lowest y, with pitch, method, reason and error estimate.

    Raises
    ------
    SceneError
        If an option is out of range or not available for the method, or if the F-number is 0.5 or
        less: at F/0.5 the cone of light fills the half space.
    SamplingError
        If the wave is sampled too coarsely, the window is too narrow for the rays, the pitch is too
        wide, no method reaches ``tol``, or none does so within ``max_seconds``.
    MemoryLimitError
        If an array would not fit into memory; raised before it is allocated.

    See Also
    --------
    scene_point_spread : From a scene.

    Notes
    -----
    The complex field at an image point x is a sum over the sample points p = (u, v) of the pupil,
    with amplitude A, area w, aberration W, k = 2 pi/lambda and the signed image distance d [1]_::

        U(x) = sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))

    A tilt W = a u moves the spot to x = a d. Piston has no effect.

    Pupil coordinates (u, v) are distances from the axis on the reference sphere of radius ``|d|``
    about the image point. A lens that satisfies the sine condition maps its entrance pupil onto
    this sphere. Hence ``u/d`` is the sine of the angle to the axis, and the F-number is
    ``1/(2 sin(alpha))``, with alpha the half angle of the cone of light.

    The high-aperture model sums plane waves that arrive at angles theta to the axis, with the
    amplitude ``A cos(theta)^(1/2)`` of the sine condition. The direction of the electric field
    turns with the rays [2]_ [3]_. The intensity is the squared electric field. For unpolarised
    light it is the mean over two perpendicular polarisations. The model neglects the finite
    distance of the pupil (Debye's approximation) and polarisation by the surfaces of the lens.

    For the layout "scattered" the error is estimated by interpolating the wave to a round or
    annular pupil of ``pupil_radius`` and ``obscuration``. For a pupil of any other outline the
    estimate is therefore large.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 4.3.
    .. [2] Richards and Wolf, Proc. R. Soc. A 253 (1959) 358.
    .. [3] Leutenegger et al., Optics Express 14 (2006) 11277.

    Examples
    --------
    An F/10 beam with 50 nm rms of defocus; its peak is the Strehl ratio:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(  # Noll index 4: 50 nm rms of defocus
    ...     {4: 50e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> spread = psf.point_spread(wave, shape=65, normalisation="ideal-peak")
    >>> spread.shape, spread.error_estimate < 1e-3
    ((65, 65), True)
    >>> print(f"{1e6 * spread.pitch:.2f} um, peak {spread.intensity.max():.2f}")
    1.25 um, peak 0.66

    A fast beam: the spot of polarised light is longer along the polarisation.

    >>> fast = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=8e-3
    ... )
    >>> spread = psf.point_spread(fast, shape=65, normalisation="ideal-peak", polarisation="x")
    >>> row, column = spread.intensity[32], spread.intensity[:, 32]
    >>> print(f"{spread.model}: {row[34]:.2f} along x, {column[34]:.2f} along y")
    high-aperture: 0.58 along x, 0.51 along y
    """
    if isinstance(wavefront, Residual):
        residual = wavefront
    else:
        residual = split(expect("wavefront", wavefront, "Wavefront"))
    wave = residual.wavefront
    one_of("method", method, METHODS)
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    if max_seconds is not None:
        positive("max_seconds", max_seconds, unit="s")
    polarisation = check_model(model, method, polarisation)
    check_cone(residual)
    pitch, shape = _sampling(residual, method, tol, pitch, shape, pixel_integrated)
    if not pixel_integrated and normalisation != "ideal-peak":
        check_nyquist(residual, pitch, normalisation)
    whole = holds_rays(residual, pitch, shape)
    if not whole:
        _check_part(residual, method, pitch, shape)
    rule = None
    if pixel_integrated:
        rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
    task = Task(residual, tol, pitch, shape, rule, whole)
    fits_memory(
        f"a point spread of {shape[0]} x {shape[1]} samples",
        32.0 * shape[0] * shape[1],
        "use a smaller shape",
    )
    longest = seconds_limit(60.0) if max_seconds is None else max_seconds
    result = modelled(task, method, model, polarisation, normalisation, longest)
    scale = 1.0
    if normalisation != "ideal-peak":
        scale = result.level * (wave.flux if normalisation == "flux" else 1.0)
    intensity = np.ascontiguousarray(result.mean if scale == 1.0 else result.mean * scale)
    intensity.setflags(write=False)  # PointSpread then keeps it without a copy
    return PointSpread(
        intensity=intensity,
        pitch=pitch,
        method=result.method,
        error_estimate=result.error,
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(np.sum(result.mean)) * result.level,
        regime=task.regime,
        reason=result.reason,
        model=result.model,
        model_error=result.model_error,
    )


def _model_figure(model: str, error: float) -> str:
    """Return the figure of a card: the model and its error."""
    if model != "scalar":
        return model
    return f"{model}, error {f'{error:.1e} of the peak' if math.isfinite(error) else 'unknown'}"


def _check_part(residual: Residual, method: str, pitch: float, shape: tuple[int, int]) -> None:
    """Refuse a window that loses rays, unless a method that sums the field at points is named."""
    first = next(iter(ABLE[residual.wavefront.layout]))
    if method not in ("nufft", first):
        part = f", or method='{first}', which computes any part of the image"
        check_rays(residual, pitch, shape, part)


def _sampling(
    residual: Residual,
    method: str,
    tol: float,
    pitch: float | None,
    shape: int | tuple[int, int] | None,
    pixel_integrated: bool,
) -> tuple[float, tuple[int, int]]:
    """Return the pitch, m, and the shape (ny, nx), checked if given, by default otherwise."""
    if pitch is not None:
        pitch = in_range("pitch", pitch, 1e-100, 1e100, unit="m")
    elif method == "fft" and not pixel_integrated and (period := residual.full_period):
        pitch, size = period
        if shape is None:
            return pitch, (size, size)
    else:
        pitch = min(residual.airy_unit / 4, residual.nyquist_pitch / 2)
    if shape is not None:
        return pitch, shape_of(shape)
    if pixel_integrated:
        n = window_side(residual, pitch, tol)
        return pitch, (n, n)
    return pitch, default_shape(residual, pitch)


def check_nyquist(residual: Residual, pitch: float, normalisation: str) -> None:
    """Refuse point samples too far apart for their sum to be an energy."""
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.3g} m is wider than the Nyquist pitch {residual.nyquist_pitch:.3g} "
            f"m, so the samples do not add up to the energy of '{normalisation}'; use "
            "pixel_integrated=True, or normalisation='ideal-peak' for point samples"
        )
