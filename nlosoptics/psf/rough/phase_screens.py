"""Random phase screens of a rough wall, and their fields at the pupil."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._random import generator
from ...errors import SceneError
from .view import RoughView

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SCREENS: Final = 403  # stream of the random generator
#: Value of C below which heights are treated as independent.
INDEPENDENT: Final = 1e-6
#: Largest fraction of the variance in components of negative power, which no surface can have.
NEGATIVE: Final = 2e-3
#: Largest ``max(1, s^2) (1 - C)`` between neighbours: a pitch of l/(3 s) for the Gaussian C.
STEP: Final = 1 / 9
#: A coarser lattice with spectral interpolation is used if its pitch is at most `widest_pitch`
#: over DENSER and at least LEAST_STRIDE pupil cells.
DENSER: Final = 1.5
LEAST_STRIDE: Final = 4
#: Largest fraction of the power in the last tenth of a coarser lattice's band.
BEYOND: Final = 1e-9
#: Value of C at which the torus for that test is cut; a step of 1e-6 would add to the spectrum.
NOTHING: Final = 1e-12
#: Relative accuracy of the interpolation.
EPSILON: Final = 1e-12


@dataclass(frozen=True, eq=False)
class Screens:
    """Periodic random screens on a lattice of pupil points.

    Parameters
    ----------
    heights : ndarray, (n, n//2 + 1)
        Square root of the discrete power spectrum of the heights, in units of height_rms.
    phase_rms : float
        Rms phase s, rad.
    spreading : ndarray, (n, n), or None
        Phase added to each plane wave of the screen by propagation from wall to pupil, rad; None
        for geometric propagation.
    """

    heights: Array
    phase_rms: float
    spreading: Array | None

    @property
    def size(self) -> int:
        """Lattice points per side, one period."""
        return int(self.heights.shape[0])

    def draw(self, seed: int) -> Iterator[ComplexArray]:
        """Yield fields (n, n) of independent random walls at the pupil points, of mean power 1."""
        random = generator(seed, SCREENS)
        n = self.size
        turn = None if self.spreading is None else np.exp(-1j * self.spreading)
        while True:
            waves = ducc0.fft.r2c(random.standard_normal((n, n)), nthreads=1)
            waves *= self.heights
            heights = ducc0.fft.c2r(waves, lastsize=n, forward=False, inorm=2, nthreads=1)
            field = np.exp(-1j * self.phase_rms * heights)
            yield field if turn is None else propagated(field, turn)


def propagated(field: ComplexArray, turn: ComplexArray) -> ComplexArray:
    """Return a periodic field (n, n) after propagation, computed in place.

    ``turn`` holds the factor of each plane wave, (n, n) in FFT order.
    """
    ducc0.fft.c2c(field, out=field, nthreads=1)
    field *= turn
    ducc0.fft.c2c(field, out=field, forward=False, inorm=2, nthreads=1)
    return field


def stride(view: RoughView, pitch: float) -> int:
    """Return the spacing of the screen's lattice in pupil cells of a pitch, m.

    It is above 1 if the field is smooth enough for spectral interpolation from a coarser lattice.
    """
    cells = math.floor(min(widest_pitch(view) / (DENSER * pitch), 1e9))
    while cells >= LEAST_STRIDE:
        steps = _steps(_torus(view, 0, cells * pitch, 0.0, NOTHING)) * cells * pitch
        light = view.diffuse_transfer(view.lags(steps, steps[:, None]))
        waves = np.abs(ducc0.fft.c2c(light.astype(np.complex128), nthreads=1))
        outer = np.abs(np.fft.fftfreq(steps.size)) > 0.45
        if waves[outer].sum() + waves[:, outer].sum() <= BEYOND * waves.sum():
            return cells
        cells //= 2
    return 1


class Between:
    """Spectral interpolation of periodic fields from a coarse lattice to the pupil points.

    Parameters
    ----------
    size : int
        Points per side of the coarse lattice, one period.
    cells : int
        Spacing of the lattice in pupil cells, from `stride`.
    count : int
        Pupil points per side.
    """

    def __init__(self, size: int, cells: int, count: int) -> None:
        turns = np.arange(count) * (2 * math.pi / (size * cells))
        self.coord = np.stack([axis.ravel() for axis in np.meshgrid(turns, turns, indexing="ij")])
        self.size, self.count = size, count

    def __call__(self, field: ComplexArray) -> ComplexArray:
        """Interpolate a field (size, size) to the pupil points (count, count)."""
        waves = ducc0.fft.c2c(field, inorm=2, nthreads=1)
        values = ducc0.nufft.u2nu(
            grid=waves,
            coord=self.coord.T,
            forward=False,
            epsilon=EPSILON,
            nthreads=1,
            fft_order=True,
        )
        return np.asarray(values.reshape(self.count, self.count))


def widest_pitch(view: RoughView) -> float:
    """Return the widest pupil pitch that resolves the screen, m.

    For a Gaussian C it is l/(3 M) for s < 1 and l/(3 s M) for s > 1.
    """
    if view.rayleigh_parameter == 0:
        return math.inf
    lag = view.roughness.lag_of(STEP / max(1.0, view.rayleigh_parameter**2))
    return lag / float(np.linalg.norm(view.footprint, 2))


def spreading_matrix(view: RoughView) -> Array:
    """Return the effective distance in pupil coordinates (2, 2), m, ``M^-1 d_eff M^-T``."""
    if view.effective_distance is None:
        raise SceneError(
            "effective_distance is missing, but a wavefront does not hold the distance to the "
            "wall; take it from psf.wall_view"
        )
    back = np.linalg.inv(view.footprint)
    return np.asarray(back @ view.effective_distance @ back.T)


def spreading_phase(view: RoughView, n: int, pitch: float, wavelength: float) -> Array:
    """Return the phase by which propagation to the pupil delays each plane wave, (n, n), rad.

    The lattice has n points of a pitch, m, per side; plane waves are in FFT order. A component of
    frequency q is delayed by ``pi lambda q^T d_eff q``.
    """
    matrix = spreading_matrix(view)
    u = np.fft.fftfreq(n, pitch)
    v = u[:, None]
    form = matrix[0, 0] * u**2 + 2 * matrix[0, 1] * u * v + matrix[1, 1] * v**2
    return np.asarray(math.pi * wavelength * form)


def throw(view: RoughView, halo_angle: float) -> float:
    """Return the distance in the pupil, m, over which the screen spreads a halo of a half angle.

    ``halo_angle`` is the radius of the halo over the image distance, rad.
    """
    return float(np.linalg.norm(spreading_matrix(view), 2)) * halo_angle


def screens(view: RoughView, cells: int, pitch: float, wavelength: float, reach: float) -> Screens:
    """Prepare screens that cover ``cells`` lattice points per side.

    Parameters
    ----------
    view : RoughView
        View of the roughness.
    cells : int
        Lattice points per side that will be used.
    pitch : float
        Lattice pitch in the pupil, m.
    wavelength : float
        m.
    reach : float
        Margin of the screen on every side, from `throw`, m; 0 for geometric propagation, in which
        the pupil has the phase of the wall.

    Returns
    -------
    Screens

    Raises
    ------
    SceneError
        If no surface has the autocorrelation, or it does not fall to 0.
    MemoryLimitError
        If the screen would not fit into memory.

    Notes
    -----
    Heights are white noise filtered by the square root of the spectrum of C(M d) on a torus. The
    torus is large enough for the field's correlation to be exact over the pupil's width.
    Propagation to the pupil is a convolution with ``exp(i k w^T d_eff^-1 w/2)`` on the wall. It
    multiplies the component of frequency q by ``exp(-i pi lambda q^T d_eff q)``.
    """
    n = _torus(view, cells, pitch, reach)
    steps = _steps(n)
    lags = view.lags(steps * pitch, (steps * pitch)[:, None])
    spectrum = ducc0.fft.r2c(view.roughness.correlation(lags), nthreads=1).real
    # a column of the half spectrum that represents a frequency and its negative counts twice
    twice = np.full(spectrum.shape[1], 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    missing = -float(np.sum(np.minimum(spectrum, 0.0) * twice)) / n**2
    if missing > NEGATIVE:
        raise SceneError(
            f"roughness.autocorrelation implies negative power, {missing:.2g} of the variance, "
            f"limit {NEGATIVE:g}, which no surface has; smooth the measured C"
        )
    positive = np.maximum(spectrum, 0.0)
    positive /= float(np.sum(positive * twice)) / n**2  # restores the variance
    spreading = None
    if reach > 0:
        spreading = spreading_phase(view, n, pitch, wavelength)
    return Screens(np.sqrt(positive), view.rayleigh_parameter, spreading)


def _torus(
    view: RoughView, cells: int, pitch: float, reach: float, level: float = INDEPENDENT
) -> int:
    """Return the lattice points per side of the periodic screen.

    The period includes the margin ``reach``, m, and the lag at which C falls to ``level``.
    """
    independent = view.roughness.reach(level)
    if math.isinf(independent):
        raise SceneError(
            f"roughness.autocorrelation stays above {level:g} up to 1000 correlation "
            "lengths; give one that falls to 0"
        )
    gap = independent * float(np.linalg.norm(np.linalg.inv(view.footprint), 2))
    least = max(cells + (2 * reach + gap) / pitch, 2 * gap / pitch)
    fits_memory(
        f"a phase screen of {least:.6g} x {least:.6g} cells of {pitch:.3g} m in the pupil",
        100.0 * least * least,
        "use psf.mean_point_spread, which needs no screen, or longer or lower roughness",
    )
    return int(ducc0.fft.good_size(math.ceil(least)))


def _steps(n: int) -> Array:
    """Return the lattice indices of a period in FFT order, from 0 and then from -n/2."""
    steps = np.arange(n, dtype=np.float64)
    steps[(n + 1) // 2 :] -= n
    return steps
