"""Random phase screens of a rough wall, and their fields at the pupil."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import ducc0
import numpy as np

from ..._checks import fits_memory
from ..._random import generator
from ..._vectors import Array, ComplexArray
from ...errors import SceneError
from .view import RoughView

#: Largest ``max(1, s^2) (1 - C)`` between neighbours: a pitch of l/(3 s) for the Gaussian C.
STEP: Final = 1 / 9
#: A coarser lattice with spectral interpolation is used if its pitch is at most `widest_pitch`
#: over DENSER and at least LEAST_STRIDE pupil cells.
DENSER: Final = 1.5
LEAST_STRIDE: Final = 4
#: Lines of a field that are interpolated at a time, few enough for the processor's cache.
LINES: Final = 64


@dataclass(frozen=True, eq=False)
class Screens:
    """Periodic random screens on a lattice of pupil points."""

    # (n, n//2 + 1); Square root of the discrete power spectrum of the heights, in units of
    # height_rms.
    heights: Array
    phase_rms: float  # Rms phase s, rad
    # Lattice pitch in the pupil and wavelength, m.
    pitch: float
    wavelength: float
    distance: Array  # (2, 2); Effective distance from wall to pupil, m, see `spreading_matrix`

    @property
    def size(self) -> int:
        """Lattice points per side, one period."""
        return int(self.heights.shape[0])

    def draw(self, seed: int) -> Iterator[ComplexArray]:
        """Yield fields (n, n) of independent random walls at the pupil points, of mean power 1."""
        random = generator(seed, 403)  # stream of rough walls
        n = self.size
        while True:
            waves = ducc0.fft.r2c(random.standard_normal((n, n)), nthreads=1)
            waves *= self.heights
            heights = ducc0.fft.c2r(waves, lastsize=n, forward=False, inorm=2, nthreads=1)
            field = phase_field(heights, self.phase_rms)
            yield propagated(field, self.distance, self.pitch, self.wavelength)


def phase_field(phase: Array, factor: float = 1.0) -> ComplexArray:
    """Return ``exp(-i factor phase)`` of an array (n, n), rad."""
    from ..wave import _wave_kernels

    field = np.empty(phase.shape, dtype=np.complex128)
    _wave_kernels.unit_wave(phase.ravel(), -factor / (2 * math.pi), field.ravel())
    return field


def propagated(
    field: ComplexArray, distance: Array, pitch: float, wavelength: float
) -> ComplexArray:
    """Return a periodic field (n, n) after propagation to the pupil, computed in place.

    A component of frequency q is delayed by ``pi lambda q^T d q``.
    """
    from ..wave import _wave_kernels

    ducc0.fft.c2c(field, out=field, nthreads=1)
    q = np.fft.fftfreq(len(field), pitch)
    xx, xy, yy = wavelength / 2 * distance[[0, 0, 1], [0, 1, 1]]
    _wave_kernels.delayed(field, q, q, xx, 2 * xy, yy)
    ducc0.fft.c2c(field, out=field, forward=False, inorm=2, nthreads=1)
    return field


def stride(view: RoughView, pitch: float) -> int:
    """Return the spacing of the screen's lattice in pupil cells of a pitch, m.

    It is above 1 if the field is smooth enough for spectral interpolation from a coarser lattice.
    """
    cells = math.floor(min(widest_pitch(view) / (DENSER * pitch), 1e9))
    while cells >= LEAST_STRIDE:
        # cut the torus where C is 1e-12; a step of 1e-6 would add to the spectrum
        steps = _steps(_torus(view, 0, cells * pitch, 0.0, 1e-12)) * cells * pitch
        light = view.diffuse_transfer(view.lags(steps, steps[:, None]))
        waves = np.abs(ducc0.fft.c2c(light.astype(np.complex128), nthreads=1))
        outer = np.abs(np.fft.fftfreq(steps.size)) > 0.45
        if waves[outer].sum() + waves[:, outer].sum() <= 1e-9 * waves.sum():
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
        self.size, self.cells, self.count = size, cells, count
        # phases that shift a field by a fraction of the lattice's spacing
        shifts = np.arange(1, cells)[:, None] / cells
        self.turns = np.exp(2j * math.pi * np.fft.fftfreq(size) * shifts)

    def __call__(self, field: ComplexArray) -> ComplexArray:
        """Interpolate a field (size, size) to the pupil points (count, count)."""
        rows = np.empty((self.size, self.count), dtype=np.complex128)
        for a in range(0, self.size, LINES):
            rows[a : a + LINES] = self._along(field[a : a + LINES])
        out = np.empty((self.count, self.count), dtype=np.complex128)
        for a in range(0, self.count, LINES):
            out[:, a : a + LINES] = self._along(np.ascontiguousarray(rows[:, a : a + LINES].T)).T
        return out

    def _along(self, lines: ComplexArray) -> ComplexArray:
        """Interpolate lines (n, size) to (n, count) points."""
        out = np.empty((len(lines), self.count), dtype=np.complex128)
        waves = ducc0.fft.c2c(lines, axes=(1,), inorm=2, nthreads=1)
        out[:, :: self.cells] = lines[:, : -(-self.count // self.cells)]
        for j in range(1, self.cells):
            part = out[:, j :: self.cells]
            shifted = ducc0.fft.c2c(waves * self.turns[j - 1], axes=(1,), forward=False, nthreads=1)
            part[...] = shifted[:, : part.shape[1]]
        return out


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


def throw(view: RoughView, halo_angle: float) -> float:
    """Return the distance in the pupil, m, over which the screen spreads a halo of a half angle.

    ``halo_angle`` is the radius of the halo over the image distance, rad.
    """
    return float(np.linalg.norm(spreading_matrix(view), 2)) * halo_angle


def screens(view: RoughView, cells: int, pitch: float, wavelength: float, reach: float) -> Screens:
    """Prepare screens that cover ``cells`` lattice points per side.

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
    if missing > 2e-3:
        raise SceneError(
            f"roughness.autocorrelation implies negative power, {missing:.2g} of the variance, "
            f"limit {2e-3:g}, which no surface has; smooth the measured C"
        )
    positive = np.maximum(spectrum, 0.0)
    positive /= float(np.sum(positive * twice)) / n**2  # restores the variance
    return Screens(
        np.sqrt(positive), view.rayleigh_parameter, pitch, wavelength, spreading_matrix(view)
    )


def _torus(view: RoughView, cells: int, pitch: float, reach: float, level: float = 1e-6) -> int:
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
