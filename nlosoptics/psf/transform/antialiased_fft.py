"""Images of polynomial waves from grids with softened rims, by FFTs.

They are padded to a period of a whole number of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import Array
from ..aperture.quadrature_nodes import frozen
from ..wave.detilted import Residual
from ..window import antialiased_disc
from ..window.grids import Pass, intensity
from ..window.pixels import PixelRule
from ..window.window import Window
from .antialiased_pupil import SoftWave

#: Points per cell in the table of a softened rim; six-point interpolation then has error 2e-15.
STEPS = 256


@dataclass(frozen=True)
class Grid:
    """Pupil grid with softened rims.

    Parameters
    ----------
    period : float
        Period of the image, m.
    radius : float
        Radius of the pupil, cells.
    reach : int
        Half width of the softened rim, cells.
    """

    period: float
    radius: float
    reach: int = antialiased_disc.REACH

    @property
    def centre(self) -> int:
        """Number of cells on either side of the middle one, including the softened rim."""
        return math.ceil(self.radius) + self.reach

    @property
    def error(self) -> float:
        """Bound of the field error due to the truncated rim."""
        return antialiased_disc.cut(self.radius, self.reach)


def padded(residual: Residual, samples: Window, period: float, reach: int) -> Grid:
    """Return the grid for FFTs: a period of at least ``period``, Airy units, and of fast size."""
    unit = residual.airy_unit
    # sizes that are multiples of four are the fastest
    size = 4 * int(ducc0.fft.good_size(math.ceil(period * unit / samples.pitch / 4)))
    return Grid(size * samples.pitch, size * samples.pitch / (2 * unit), reach)


def n_bytes(samples: Window, grid: Grid, rule: PixelRule | None) -> float:
    """Return the peak memory of `image`, bytes, with a constant for tables and blocks."""
    size, (ny, nx) = round(grid.period / samples.pitch), samples.shape
    rows = min(size, 2 * grid.centre + 1)
    return 8.0 * ny * nx * (1.0 if rule is None else 4.0 / rule.factor) + 2**26 + 16.0 * rows * size


def image(
    residual: Residual, wave: SoftWave, samples: Window, grid: Grid, rule: PixelRule | None
) -> Array:
    """Compute the image of a polynomial wave by padded FFTs.

    Parameters
    ----------
    residual : Residual
        Wave, for the pupil and the tilt's shift.
    wave : SoftWave
        Its polynomials.
    samples : Window
        Image points, finer than the pixels if a rule is given.
    grid : Grid
        Result of `padded`.
    rule : PixelRule or None
        Average over pixels; None for point samples.

    Returns
    -------
    ndarray, (ny, nx)
        Intensity, 1 at the ideal peak.
    """
    size = round(grid.period / samples.pitch)
    rows = min(size, 2 * grid.centre + 1)
    fits_memory(
        f"the transform of {rows} x {size} samples",
        n_bytes(samples, grid, rule),
        "use a smaller shape",
    )
    values = np.zeros((rows, rows), dtype=np.complex128)
    total = _fill(values, residual, wave, samples, grid)
    forward = residual.wavefront.image_distance > 0

    def padded(count: int) -> Pass:
        """Return the transform of rows, padded to the period, to ``count`` samples."""

        def transform(lines: NDArray[np.complex128]) -> NDArray[np.complex128]:
            work = np.zeros((len(lines), size), dtype=np.complex128)
            work[:, :rows] = lines
            ducc0.fft.c2c(work, axes=(1,), forward=forward, out=work, nthreads=1)
            return work[:, :count]

        return transform

    ny, nx = samples.shape
    mean = intensity(values, padded(nx), padded(ny), samples.shape, rule)
    mean /= total**2
    return mean


def _fill(
    values: NDArray[np.complex128],
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    grid: Grid,
) -> float:
    """Add the pupil function to ``values`` and return the sum of its amplitude.

    The middle cell is `Grid.centre` on both axes. A linear phase moves the first image sample to
    frequency 0 of the transform.
    """
    from . import _antialiased_kernels

    pupil = residual.wavefront
    edges = (1.0, pupil.obscuration) if pupil.obscuration > 0 else (1.0,)
    rims = [_rim_table(edge * grid.radius, grid.reach) for edge in edges]
    # A bound may be an integer, for which numba would compile the kernel again.
    lows, highs = (np.array([rim[i] for rim in rims], dtype=np.float64) for i in (0, 1))
    width = max(rim[2].size for rim in rims)
    tables = np.zeros((len(rims), width))
    for row, rim in zip(tables, rims, strict=True):
        row[: rim[2].size] = rim[2]
    turns = wave.aberration / pupil.wavelength
    per_length = math.copysign(grid.radius / grid.period, pupil.image_distance)
    for axis, place in (((1, 0), 0), ((0, 1), 1)):
        turns[axis] -= per_length * (samples.first[place] - residual.shift[place])
    work = np.empty((6, max(2 * grid.centre + 1, len(turns), len(wave.amplitude))))
    return float(
        _antialiased_kernels.soft_pupil(
            turns,
            wave.amplitude,
            1 / grid.radius,
            lows,
            highs,
            float(STEPS),
            tables,
            grid.centre,
            work,
            values,
        )
    )


@lru_cache(maxsize=64)
def _rim_table(radius: float, reach: int) -> tuple[float, float, Array]:
    """Return the inner and outer radius of a softened rim, cells, and the table of its values.

    The table extends two points beyond both radii.
    """
    disc = antialiased_disc.SoftDisc(radius, reach)
    r = np.abs(disc.low + (np.arange(math.ceil((disc.high - disc.low) * STEPS) + 6) - 2) / STEPS)
    return disc.low, disc.high, frozen(disc.rim(r))
