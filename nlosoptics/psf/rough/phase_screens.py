"""Random phase screens of a rough wall, and their light at the pupil."""

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
#: C below which screens that are so far apart count as independent.
INDEPENDENT: Final = 1e-6
#: Variance that a C may ask below zero, of waves that no surface can have.
NEGATIVE: Final = 2e-3
#: ``max(1, s^2) (1 - C)`` between neighbours, at most: a pitch of l/(3 s) for the Gaussian C.
STEP: Final = 1 / 9
#: Share of that pitch at which a field is known between its points, and cells that this must save.
DENSER: Final = 1.5
LEAST_STRIDE: Final = 4
#: Light in the last tenth of a lattice's band, at most, for what lies between its points.
BEYOND: Final = 1e-9
#: C at which that light is looked at on a torus; a step of 1e-6 would pass for waves.
NOTHING: Final = 1e-12
#: Of the values between.
EPSILON: Final = 1e-12


@dataclass(frozen=True, eq=False)
class Screens:
    """Periodic random screens on a lattice of pupil points.

    Parameters
    ----------
    heights : ndarray
        Square root of the heights' discrete spectrum, in units of height_rms, (n, n//2 + 1).
    phase_rms : float
        s, rad.
    spreading : ndarray or None
        Phase that the way from wall to pupil adds to each wave of the screen, rad, (n, n); None
        where it is left out.
    """

    heights: Array
    phase_rms: float
    spreading: Array | None

    def draw(self, seed: int) -> Iterator[ComplexArray]:
        """Fields at the pupil points, one independent wall after the other, of mean power 1."""
        random = generator(seed, SCREENS)
        n = self.heights.shape[0]
        turn = None if self.spreading is None else np.exp(-1j * self.spreading)
        while True:
            waves = ducc0.fft.r2c(random.standard_normal((n, n)), nthreads=1)
            waves *= self.heights
            heights = ducc0.fft.c2r(waves, lastsize=n, forward=False, inorm=2, nthreads=1)
            field = np.exp(-1j * self.phase_rms * heights)
            if turn is not None:
                ducc0.fft.c2c(field, out=field, nthreads=1)
                field *= turn
                ducc0.fft.c2c(field, out=field, forward=False, inorm=2, nthreads=1)
            yield field


def stride(view: RoughView, pitch: float) -> int:
    """Pupil cells of a pitch, m, from one point of the screen's lattice to the next.

    1, unless the field is so smooth that a wider lattice holds all its waves: then every pupil
    point follows from them.
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
    """Fields at pupil points, from their values at every ``cells``-th of them.

    Parameters
    ----------
    size : int
        Points of the wide lattice a side, a period.
    cells : int
        As of `stride`.
    count : int
        Pupil points a side.
    """

    def __init__(self, size: int, cells: int, count: int) -> None:
        turns = np.arange(count) * (2 * math.pi / (size * cells))
        self.coord = np.stack([axis.ravel() for axis in np.meshgrid(turns, turns, indexing="ij")])
        self.size, self.count = size, count

    def __call__(self, field: ComplexArray) -> ComplexArray:
        """(size, size) to (count, count), by the field's own waves."""
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
    """Pupil pitch that resolves the screen, m: l/(3 M) for s < 1, l/(3 s M) beyond."""
    if view.rayleigh_parameter == 0:
        return math.inf
    lag = view.roughness.lag_of(STEP / max(1.0, view.rayleigh_parameter**2))
    return lag / float(np.linalg.norm(view.footprint, 2))


def spreading_matrix(view: RoughView) -> Array:
    """Effective distance in pupil coordinates, m: ``M^-1 d_eff M^-T``."""
    if view.effective_distance is None:
        raise SceneError(
            "effective_distance is missing; a wavefront does not say how far it is from the wall, "
            "take it from psf.wall_view"
        )
    back = np.linalg.inv(view.footprint)
    return np.asarray(back @ view.effective_distance @ back.T)


def throw(view: RoughView, halo_angle: float) -> float:
    """How far apart, in the pupil, the screen throws light of a halo of that half angle, m."""
    return float(np.linalg.norm(spreading_matrix(view), 2)) * halo_angle


def screens(view: RoughView, cells: int, pitch: float, wavelength: float, reach: float) -> Screens:
    """Prepare screens that cover ``cells`` lattice points a side.

    Parameters
    ----------
    view : RoughView
    cells : int
        Pupil points a side that will be looked at.
    pitch : float
        Between them, m.
    wavelength : float
        m.
    reach : float
        `throw`, m, which the screen goes beyond them on every side; 0 leaves the way from wall to
        pupil out, so that the pupil has the wall's phase.

    Notes
    -----
    Heights are white noise filtered by the square root of the spectrum of C(M d) on a torus, on
    which the field's correlation is exact up to the pupil's width. The way to the pupil is a
    convolution with ``exp(i k w^T d_eff^-1 w/2)`` on the wall, so it multiplies the wave of
    frequency q by ``exp(-i pi lambda q^T d_eff q)``.
    """
    n = _torus(view, cells, pitch, reach)
    steps = _steps(n)
    lags = view.lags(steps * pitch, (steps * pitch)[:, None])
    spectrum = ducc0.fft.r2c(view.roughness.correlation(lags), nthreads=1).real
    # columns that stand for a frequency and its negative count twice
    twice = np.full(spectrum.shape[1], 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    missing = -float(np.sum(np.minimum(spectrum, 0.0) * twice)) / n**2
    if missing > NEGATIVE:
        raise SceneError(
            f"roughness.autocorrelation asks for waves of negative power, {missing:.2g} of the "
            f"variance, limit {NEGATIVE:g}; no surface has it, smooth the measured C"
        )
    positive = np.maximum(spectrum, 0.0)
    positive /= float(np.sum(positive * twice)) / n**2  # what was left out, given back
    spreading = None
    if reach > 0:
        matrix = spreading_matrix(view)
        u, v = np.meshgrid(steps / (n * pitch), steps / (n * pitch))
        form = matrix[0, 0] * u**2 + 2 * matrix[0, 1] * u * v + matrix[1, 1] * v**2
        spreading = math.pi * wavelength * form
    return Screens(np.sqrt(positive), view.rayleigh_parameter, spreading)


def _torus(
    view: RoughView, cells: int, pitch: float, reach: float, level: float = INDEPENDENT
) -> int:
    """Lattice points a side on which the screen is periodic, C at the level half way round."""
    independent = view.roughness.reach(level)
    if math.isinf(independent):
        raise SceneError(
            f"roughness.autocorrelation stays above {level:g} up to 1000 correlation "
            "lengths; give one that ends"
        )
    gap = independent * float(np.linalg.norm(np.linalg.inv(view.footprint), 2))
    least = max(cells + (2 * reach + gap) / pitch, 2 * gap / pitch)
    fits_memory(
        f"a screen of {least:.6g} x {least:.6g} cells, {pitch:.3g} m in the pupil",
        100.0 * least * least,
        "use psf.mean_point_spread, which draws none, or longer or lower roughness",
    )
    return int(ducc0.fft.good_size(math.ceil(least)))


def _steps(n: int) -> Array:
    """Lattice points of a period, in pitches, from -n/2 to n/2, 0 first."""
    steps = np.arange(n, dtype=np.float64)
    steps[(n + 1) // 2 :] -= n
    return steps
