"""Point spread functions of an exit-pupil wave."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .._checks import fits_memory, in_range, one_of, positive
from ..errors import MemoryLimitError, SamplingError
from . import airy, estimates, fft, mdft, quadrature
from .pixels import PixelRule, pixel_rule
from .pupil_grids import PupilGrid, grid_size, pupil_grid, pupil_grid_from_polar
from .residuals import Residual, split
from .wavefronts import Wavefront
from .windows import Window, check_rays, default_shape, shape_of, window_side

Array = NDArray[np.float64]
Method = Literal["auto", "quadrature", "fft", "mdft", "airy"]
Normalisation = Literal["unit-sum", "ideal-peak", "flux"]
METHODS = ("auto", "quadrature", "fft", "mdft", "airy")
NORMALISATIONS = ("unit-sum", "ideal-peak", "flux")

#: Fewest pupil samples across when a polar wave is put on a grid.
LEAST_SAMPLES = 512


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSpread:
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
        Share of the energy that passes the pupil which falls into the window.
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

    def __post_init__(self) -> None:
        intensity = np.array(self.intensity, dtype=np.float64, order="C")
        intensity.setflags(write=False)
        object.__setattr__(self, "intensity", intensity)

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


@dataclass(frozen=True, eq=False)
class _Task:
    """What every transform is asked for."""

    residual: Residual
    tol: float
    pitch: float
    shape: tuple[int, int]
    rule: PixelRule | None

    @property
    def pixels(self) -> Window:
        return Window.centred(self.pitch, self.shape)

    @property
    def samples(self) -> Window:
        """Points at which the intensity is needed."""
        return self.pixels if self.rule is None else self.rule.window(self.pitch, self.shape)

    @property
    def level(self) -> float:
        """Share of the transmitted energy in a pixel of ideal-peak mean 1."""
        return self.residual.pixel_share(self.pitch)

    def bound(self, intensity: Array, field_error: Array | float, energy_error: float) -> float:
        pixel = 0.0 if self.rule is None else self.pitch / self.residual.airy_unit
        return estimates.intensity_error(
            intensity, field_error, energy_error, pixel=pixel, level=self.level
        )

    def means(self, field: NDArray[np.float64] | NDArray[np.complex128]) -> Array:
        """Intensity of a field at `samples`, averaged over pixels where asked."""
        fine = field.real**2 + field.imag**2
        if self.rule is None:
            return fine
        half = self.rule.mean(fine)
        return self.rule.mean(np.ascontiguousarray(half.T)).T


def point_spread(
    wavefront: Wavefront,
    *,
    method: Method = "auto",
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> PointSpread:
    """Fraunhofer point spread of an exit-pupil wave.

    Parameters
    ----------
    wavefront : Wavefront
        Polar nodes or a grid. ``wavefront.removed`` is not put back.
    method : {"auto", "quadrature", "fft", "mdft", "airy"}
        ``quadrature`` sums polar nodes exactly; ``fft`` zero-pads a grid; ``mdft`` takes a grid to
        any pitch; ``airy`` is the closed form of a wave without aberration; ``auto`` is the
        cheapest whose estimated error is at most ``tol``. A polar wave is put on a grid where
        ``fft`` and ``mdft`` need one; a grid is never put on polar nodes.
    tol : float
        Largest max |dI|/max I that ``auto`` accepts.
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

    Returns
    -------
    PointSpread

    Raises
    ------
    SamplingError
        If the wave is sampled too coarsely, the window too narrow for its rays or the pitch too
        wide, or if no transform reaches ``tol``.
    MemoryLimitError
        Before anything is allocated that would not fit.

    Notes
    -----
    ``U(x) = sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))``, d the signed image distance, so a tilt
    W = a u moves the spot to x = a d. Piston is dropped and tilt applied as an exact shift [1]_.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 4.3.
    """
    one_of("method", method, METHODS)
    one_of("normalisation", normalisation, NORMALISATIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    residual = split(wavefront)
    pitch, shape = _sampling(residual, method, tol, pitch, shape, pixel_integrated)
    if not pixel_integrated and normalisation != "ideal-peak":
        _check_nyquist(residual, pitch, normalisation)
    check_rays(residual, pitch, shape)
    rule = None
    if pixel_integrated:
        rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
    task = _Task(residual, tol, pitch, shape, rule)
    fits_memory(
        f"a point spread of {shape[0]} x {shape[1]} samples",
        32.0 * shape[0] * shape[1],
        "use a smaller shape",
    )
    used, mean, error = _automatic(task) if method == "auto" else _transform(task, method)
    scale = 1.0
    if normalisation != "ideal-peak":
        scale = task.level * (wavefront.flux if normalisation == "flux" else 1.0)
    return PointSpread(
        intensity=mean * scale,
        pitch=pitch,
        method=used,
        error_estimate=error,
        normalisation=normalisation,
        wavelength=wavefront.wavelength,
        f_number=wavefront.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(np.sum(mean)) * task.level,
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


def _transform(task: _Task, method: str) -> tuple[str, Array, float]:
    """Run one transform: its name, mean intensity (1 at the ideal peak), and error estimate."""
    run: dict[str, Callable[[_Task], tuple[Array, float]]] = {
        "airy": _airy,
        "quadrature": _quadrature,
        "fft": _fft,
        "mdft": _mdft,
    }
    mean, error = run[method](task)
    return method, mean, error


def _automatic(task: _Task) -> tuple[str, Array, float]:
    """Cheapest transform whose estimate is within tol."""
    candidates: list[tuple[float, str]] = []
    if task.residual.wavefront.layout == "polar":
        if airy.error_bound(task.residual) <= task.tol:
            candidates.append((airy.seconds(task.samples), "airy"))
        candidates.append((quadrature.seconds(task.residual, task.samples), "quadrature"))
        candidates.append((_grid_seconds(task), "fft"))
    else:
        # The same sum; fft is the faster where the pitch fits it.
        candidates = [(1.0, "fft"), (2.0, "mdft")] if task.rule is None else [(1.0, "mdft")]
    reached = math.inf
    refusals = []
    for _, method in sorted(candidates):
        try:
            result = _transform(task, method)
        except (SamplingError, MemoryLimitError) as refusal:
            refusals.append(refusal)
            continue
        if result[2] <= task.tol:
            return result
        reached = min(reached, result[2])
    if math.isinf(reached):
        raise refusals[-1]
    raise SamplingError(
        f"no transform reaches tol = {task.tol:g}, the best estimate is {reached:.2g}; use tol = "
        f"{reached:.2g}, or more pupil nodes (now {' x '.join(map(str, _counts(task)))})"
    )


def _counts(task: _Task) -> tuple[int, ...]:
    return task.residual.wavefront.u.shape


def _airy(task: _Task) -> tuple[Array, float]:
    residual = task.residual
    if residual.wavefront.layout != "polar":
        raise SamplingError(
            "the closed form needs a polar wavefront, whose rim is known exactly; sample it with "
            "nodes='polar', or use method='mdft'"
        )
    bound = airy.error_bound(residual)
    if math.isinf(bound):
        raise SamplingError(
            f"the residual aberration reaches {_waves(residual):.3g} waves, too much for the "
            "closed form; use method='quadrature'"
        )
    samples = task.samples
    fits_memory("the closed form", 64.0 * samples.shape[0] * samples.shape[1], "use fewer pixels")
    return task.means(airy.field(residual, samples)), bound


def _quadrature(task: _Task) -> tuple[Array, float]:
    residual = task.residual
    if residual.wavefront.layout != "polar":
        raise SamplingError(
            "quadrature needs a polar wavefront and this one is a grid, which has lost its rim; "
            "sample it with nodes='polar', or use method='mdft'"
        )
    epsilon = quadrature.epsilon(residual, task.samples, task.tol)
    mean = task.means(quadrature.field(residual, task.samples, epsilon))
    lost = residual.truncation
    rounding = 20 * epsilon
    return mean, task.bound(mean, lost, lost**2) + rounding


def _fft(task: _Task) -> tuple[Array, float]:
    residual, samples = task.residual, task.samples
    fft.check_padding(residual, samples.pitch)
    if residual.wavefront.layout == "polar":
        size = _polar_size(task)
        grid = pupil_grid_from_polar(residual, _period_pitch(residual, size * samples.pitch))
        _check_jump(task, grid.jump, None)
    else:
        if task.rule is not None:
            raise SamplingError(
                "the fft of a grid wavefront has its own image pitch, which does not divide "
                "pixels; use method='mdft' for pixel_integrated=True"
            )
        size = fft.padded_size(residual, samples.pitch)
        _check_jump(task, *residual.grid_jump())
        _check_period(task)
        grid = pupil_grid(residual)
    fits_memory(
        f"the transform of {grid.values.shape[0]} x {size} samples",
        48.0 * grid.values.shape[0] * size,
        "use a smaller shape",
    )
    mean = fft.intensity_in(residual, grid, samples, size, task.rule)
    return mean, _grid_bound(task, mean, grid)


def _mdft(task: _Task) -> tuple[Array, float]:
    residual, samples = task.residual, task.samples
    if residual.wavefront.layout == "polar":
        period = _polar_size(task) * samples.pitch
        grid = pupil_grid_from_polar(residual, _period_pitch(residual, period))
        _check_jump(task, grid.jump, None)
    else:
        _check_jump(task, *residual.grid_jump())
        _check_period(task)
        grid = pupil_grid(residual)
    n = grid.values.shape[0]
    fits_memory(
        f"the transform of {n} samples to {samples.shape[0]} x {samples.shape[1]}",
        48.0 * n * (n + max(samples.shape)),
        "use a smaller shape",
    )
    mean = mdft.intensity_in(residual, grid, samples, task.rule)
    return mean, _grid_bound(task, mean, grid)


def _grid_bound(task: _Task, mean: Array, grid: PupilGrid) -> float:
    field, energy = estimates.edge_errors(task.residual, grid, task.pixels.x, task.pixels.y)
    lost = task.residual.truncation
    bound = task.bound(mean, field + lost, energy + lost**2)
    if task.rule is None:
        return bound
    return bound + estimates.damping_error(task.residual, grid, task.pitch)


def _polar_size(task: _Task) -> int:
    """Padded size for a polar wave: period over image samples, wide enough for window and rays."""
    residual, samples = task.residual, task.samples
    reach = max(samples.reach_from(residual.shift))
    # The window within the half period, the spot's far rim within that of its near one (see
    # `rims.leak`), and the rim no coarser than the least samples.
    period = max(
        2 * reach,
        4.4 * residual.rays.reach + 16 * residual.airy_unit,
        LEAST_SAMPLES * residual.airy_unit,
    )
    return int(np.ceil(period / samples.pitch - 1e-9))


def _period_pitch(residual: Residual, period: float) -> float:
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / period


def _grid_seconds(task: _Task) -> float:
    residual, samples = task.residual, task.samples
    size = _polar_size(task)
    n = grid_size(residual.wavefront.pupil_radius, _period_pitch(residual, size * samples.pitch))
    return 1e-2 + 1.2e-7 * n * n + 2e-8 * size * (n + samples.shape[1])


def _check_jump(task: _Task, jump: float, pixel: tuple[int, int] | None) -> None:
    if jump > 0.5:
        n = task.residual.wavefront.u.shape[0]
        where = f" at pixel {pixel}" if pixel is not None else ""
        need = math.ceil(n * jump / 0.5)
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves{where}, limit 0.50; use {need} or more pupil "
            f"samples (now {n}), or polar nodes"
        )


def _check_period(task: _Task) -> None:
    """The window clear of the repeats that the pupil's samples make of the spot."""
    residual = task.residual
    wave = residual.wavefront
    period = wave.wavelength * abs(wave.image_distance) / wave.pupil_pitch
    need = max(task.pixels.reach_from(residual.shift)) + residual.rays.reach
    if need > period * (1 + 1e-9):
        n = wave.u.shape[0]
        raise SamplingError(
            f"the pupil samples repeat the spot every {period:.3g} m, inside the window, which "
            f"needs {need:.3g} m; use {math.ceil(n * need / period)} or more pupil samples (now "
            f"{n}), or a smaller shape"
        )


def _waves(residual: Residual) -> float:
    return float(np.abs(residual.aberration).max()) / residual.wavefront.wavelength
