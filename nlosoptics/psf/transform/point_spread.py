"""Point spread functions of an exit-pupil wave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, in_range, one_of, positive, seconds_limit
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..wave.detilted import Residual, split
from ..wave.regime import Regime, regime
from ..wave.wavefront import Wavefront
from ..window.pixels import pixel_rule
from ..window.window import Window, check_rays, default_shape, shape_of, window_side
from . import fft
from .runners import Surface, Task, transform
from .selection import automatic

Array = NDArray[np.float64]
Method = Literal["auto", "quadrature", "fft", "mdft", "nufft", "airy", "geometric", "huygens"]
Normalisation = Literal["unit-sum", "ideal-peak", "flux"]
METHODS = ("auto", "quadrature", "fft", "mdft", "nufft", "airy", "geometric", "huygens")
NORMALISATIONS = ("unit-sum", "ideal-peak", "flux")


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSpread(Noun, Shown):
    """Image of a point.

    Parameters
    ----------
    intensity : ndarray
        (ny, nx), read-only, row 0 at the lowest y; the reference point is at [ny//2, nx//2].
    pitch : float
        m.
    method : str
        Transform that made it.
    error_estimate : float
        Bound of max |dI|/max I against the wave that the nodes sample. A pixel map
        (`Wavefront.from_map`) is that wave itself; what its pixels miss is not known here.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        What 1 means: the energy in the whole image plane, the peak without aberration, or the
        energy that a clear disc of the pupil's radius passes.
    wavelength : float
        m.
    f_number : float
    pixel_integrated : bool
        Whether values are integrals over pixels rather than point samples times pixel area.
    enclosed_energy : float
        Share of the energy that passes the pupil which falls into the window, by the sum of all
        values. Their errors add up: it may be off by hundreds of times ``error_estimate``, 1e-3 at
        the default ``tol``, and a smaller one gives more digits.
    regime : Regime
        What kind of wave it is, in numbers.
    reason : str
        Why this method, and what rules the others out or what they would have cost, in one line.
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

    def __post_init__(self) -> None:
        given = np.asarray(self.intensity)
        if given.flags.writeable or given.base is not None or not given.flags.c_contiguous:
            given = np.array(given, dtype=np.float64, order="C")
            given.setflags(write=False)
        object.__setattr__(self, "intensity", np.asarray(given, dtype=np.float64))

    @property
    def shape(self) -> tuple[int, int]:
        """Samples (ny, nx)."""
        ny, nx = self.intensity.shape
        return ny, nx

    @property
    def x(self) -> Array:
        """Coordinates along a row, m."""
        return Window.centred(self.pitch, self.shape).x

    @property
    def y(self) -> Array:
        """Coordinates along a column, m."""
        return Window.centred(self.pitch, self.shape).y

    def _figures(self) -> Figures:
        ny, nx = self.shape
        kind = self.regime
        waves = f"{kind.peak_to_valley:.3g} waves peak to valley, {kind.rms:.3g} rms"
        if kind.folded:
            waves += ", folded by a caustic"
        if kind.rayleigh_parameter > 0.0:
            waves += f", Rayleigh parameter {kind.rayleigh_parameter:.3g}"
        samples = "pixels" if self.pixel_integrated else "samples"
        figures = {
            "method": self.method,
            "why": self.reason,
            "error": f"{self.error_estimate:.1e} of the peak",
            "regime": waves,
            "pitch": f"{1e6 * self.pitch:.4g} µm, {kind.pixel:.3g} lambda N",
            samples: f"{ny} x {nx}",
            "energy within": f"{100 * self.enclosed_energy:.4g} %",
            "light": f"{1e9 * self.wavelength:.4g} nm at F/{self.f_number:.3g}",
        }
        alt = f"Point spread function, {ny} x {nx} {samples}, logarithmic colours"
        return Figures("Point spread", figures, alt)


def point_spread(
    wavefront: Wavefront,
    *,
    method: Method = "auto",
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
    image_surface: Surface | None = None,
    max_seconds: float | None = None,
) -> PointSpread:
    """Point spread of an exit-pupil wave.

    Parameters
    ----------
    wavefront : Wavefront
        ``wavefront.removed`` is not put back.
    method : str
        ``auto`` is the cheapest whose estimated error is at most ``tol``.

        - ``quadrature`` sums polar nodes, or those of cells, exactly, as many as the window needs.
        - ``fft`` zero-pads a grid, ``mdft`` takes a grid to any pitch. A polar wave is put on a
          grid for them, by ``fft`` as fine as ``tol`` asks where aberration and amplitude are
          polynomials; a grid is never put on polar nodes, nor cells on a grid.
        - ``nufft`` sums the nodes as they are, scattered ones and traced rays too.
        - ``airy`` is the closed form of a wave without aberration.
        - ``geometric`` is where rays land, diffraction left out; ``auto`` tries it above 20 waves
          with ``pixel_integrated``.
        - ``huygens`` sends spherical waves to ``image_surface``; it is slow and ``auto`` leaves it
          out. See `huygens_point_spread`.
    tol : float
        Largest max |dI|/max I that ``auto`` accepts, and that others aim at where it saves time.
    pitch : float, optional
        Image sampling or pixel side, m. Default a quarter of lambda N; for the ``fft`` of a grid
        wavefront, the nearest fast size below half of it.
    shape : int or (int, int), optional
        (ny, nx). Default at least 256 a side with all rays and their tails inside; with
        ``pixel_integrated`` that of `window_shape`; for the ``fft`` of a grid wavefront without a
        pitch, the full period.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        ``unit-sum`` and ``flux`` are energy per pixel, with 1 or `Wavefront.flux` in the whole
        plane; ``ideal-peak`` is relative to the peak of the same pupil without aberration.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.
    image_surface : callable, optional
        Height z(x, y) over the image plane away from the pupil's plane along +z, m, of arrays of x
        and y, m; for ``huygens`` only, with a shape. The intensity there counts per area of the
        image plane.
    max_seconds : float, optional
        Predicted seconds on one core beyond which ``auto`` refuses before it computes anything; a
        named method is run whatever it takes. Default 60, or what is left to a whole run.

    Returns
    -------
    PointSpread

    Raises
    ------
    SceneError
        If an option is out of range or does not fit the method.
    SamplingError
        If the wave is sampled too coarsely, the window too narrow for its rays or the pitch too
        wide, if no transform reaches ``tol``, or if that would take more than ``max_seconds``.
    MemoryLimitError
        Before anything is allocated that would not fit.

    Notes
    -----
    ``U(x) = sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))``, d the signed image distance, so a tilt
    W = a u moves the spot to x = a d. Piston is dropped and tilt applied as an exact shift [1]_.

    The error of scattered nodes is taken from the same wave interpolated to the round or annular
    pupil of ``pupil_radius`` and ``obscuration``: nodes of another outline find it large.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 4.3.
    """
    one_of("method", method, METHODS)
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    if max_seconds is not None:
        positive("max_seconds", max_seconds, unit="s")
    _check_surface(method, shape, image_surface)
    return detilted_point_spread(
        split(wavefront),
        method=method,
        tol=tol,
        pitch=pitch,
        shape=shape,
        normalisation=normalisation,
        pixel_integrated=pixel_integrated,
        image_surface=image_surface,
        max_seconds=max_seconds,
    )


def detilted_point_spread(
    residual: Residual,
    *,
    method: Method = "auto",
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
    image_surface: Surface | None = None,
    max_seconds: float | None = None,
) -> PointSpread:
    """Point spread of a wave whose piston and tilt are already separated.

    Parameters
    ----------
    residual : Residual
        From `split`; several point spreads of one wave share it.
    method, tol, pitch, shape, normalisation, pixel_integrated, image_surface, max_seconds
        The options of `point_spread`, already checked.

    Returns
    -------
    PointSpread
    """
    wavefront = residual.wavefront
    pitch, shape = _sampling(residual, method, tol, pitch, shape, pixel_integrated)
    if not pixel_integrated and normalisation != "ideal-peak":
        _check_nyquist(residual, pitch, normalisation)
    if image_surface is None:  # elsewhere than in the image plane rays land elsewhere
        check_rays(residual, pitch, shape)
    rule = None
    if pixel_integrated:
        rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
    task = Task(residual, tol, pitch, shape, rule, image_surface)
    fits_memory(
        f"a point spread of {shape[0]} x {shape[1]} samples",
        32.0 * shape[0] * shape[1],
        "use a smaller shape",
    )
    kind = regime(residual, pitch)
    if method == "auto":
        result, reason = automatic(
            task, kind, seconds_limit(60.0) if max_seconds is None else max_seconds
        )
    else:
        result, reason = transform(task, method), f"{method} was asked for"
    scale = 1.0
    if normalisation != "ideal-peak":
        scale = result.level * (wavefront.flux if normalisation == "flux" else 1.0)
    intensity = np.ascontiguousarray(result.mean if scale == 1.0 else result.mean * scale)
    intensity.setflags(write=False)  # so that it need not be copied
    return PointSpread(
        intensity=intensity,
        pitch=pitch,
        method=result.method,
        error_estimate=result.error,
        normalisation=normalisation,
        wavelength=wavefront.wavelength,
        f_number=wavefront.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(np.sum(result.mean)) * result.level,
        regime=kind,
        reason=reason,
    )


def _check_surface(method: str, shape: object, surface: Surface | None) -> None:
    if surface is None:
        return
    if method != "huygens":
        raise SceneError(
            f"image_surface with method = '{method}', which knows the image plane alone; use "
            "method='huygens'"
        )
    if shape is None:
        raise SceneError(
            "image_surface without a shape: where rays land on it is not known here; give a shape"
        )


def _sampling(
    residual: Residual,
    method: str,
    tol: float,
    pitch: float | None,
    shape: int | tuple[int, int] | None,
    pixel_integrated: bool,
) -> tuple[float, tuple[int, int]]:
    """Pitch and shape, given or by default."""
    if pitch is not None:
        pitch = positive("pitch", pitch, unit="m")
    elif method == "fft" and residual.wavefront.layout == "grid" and not pixel_integrated:
        size = fft.default_size(residual)
        pitch = fft.image_pitch(residual, size)
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


def _check_nyquist(residual: Residual, pitch: float, normalisation: str) -> None:
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.3g} m is wider than Nyquist's {residual.nyquist_pitch:.3g} m, so "
            f"samples do not add up to the energy of '{normalisation}'; use pixel_integrated=True, "
            "or normalisation='ideal-peak' for point samples"
        )
