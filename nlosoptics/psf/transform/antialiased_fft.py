"""Images of polynomial waves from grids with softened rims, by FFT or by matrix products.

`padded_image` uses FFTs padded to a period of a whole number of samples. `folded_image` uses
products with cosines and sines, which is faster for a pupil of few cells. Its cells and its image
points are both symmetric about their centres, so the transform separates into even and odd parts
with a quarter of the operations.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import ducc0
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import product_into, read_only, row_blocks
from ..wave.detilted import Residual
from ..window import antialiased_disc
from ..window.pixels import PixelRule
from ..window.window import Window
from .antialiased_pupil import SoftWave

Array = NDArray[np.float64]

#: Points per cell in the table of a softened rim; six-point interpolation then has error 2e-15.
STEPS = 256

_own = threading.local()


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


def whole(residual: Residual, period: float, reach: int) -> Grid:
    """Return the grid for matrix products, with a whole number of cells per radius.

    Calls with different periods then often share the cached table of the rim.
    """
    cells = math.ceil(period / 2)
    return Grid(2 * cells * residual.airy_unit, cells, reach)


def padded_bytes(samples: Window, grid: Grid, rule: PixelRule | None) -> float:
    """Return the peak memory of `padded_image`, bytes."""
    size = round(grid.period / samples.pitch)
    rows = min(size, 2 * grid.centre + 1)
    return _image_bytes(samples, rule) + 16.0 * rows * size


def folded_bytes(samples: Window, grid: Grid, rule: PixelRule | None) -> float:
    """Return the peak memory of `folded_image`, bytes."""
    rows, (ny, nx) = 2 * grid.centre + 1, samples.shape
    cells = rows * (2 * rows + 2 * nx) + (ny + nx) * grid.centre
    return _image_bytes(samples, rule) + 16.0 * cells


def _image_bytes(samples: Window, rule: PixelRule | None) -> float:
    """Return the memory of the image, bytes, with a constant for tables and blocks."""
    ny, nx = samples.shape
    return 8.0 * ny * nx * (1.0 if rule is None else 4.0 / rule.factor) + 2**26


def padded_image(
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
        padded_bytes(samples, grid, rule),
        "use a smaller shape",
    )
    # Rows are u, so that the second transform yields rows of the image.
    values = _workspace("values", (rows, size), complex)
    values[...] = 0.0
    total = _fill(values[:, :rows], residual, wave, samples, grid, (0.0, 0.0))
    forward = residual.wavefront.image_distance > 0
    return _padded_intensity(values, samples.shape, forward, rule, 1 / total**2)


def _padded_intensity(
    values: NDArray[np.complex128],
    shape: tuple[int, int],
    forward: bool,
    rule: PixelRule | None,
    scale: float,
) -> Array:
    """Transform ``values`` (u, v) along both axes and return ``scale |.|^2`` of the first samples.

    Rows of ``values`` are as long as the period; the other axis is padded to it. The result has
    the given shape, or that of the pixels if a rule is given. ``values`` is overwritten.
    """
    from . import _antialiased_kernels

    (_, size), (ny, nx) = values.shape, shape
    ducc0.fft.c2c(values, axes=(1,), forward=forward, out=values, nthreads=1)
    step = min(ny, max(16, 2**16 // size // 8 * 8))  # for the cache and vector registers
    padded = _workspace("padded", (step, size), complex)
    # Each block of rows is averaged along y at once, so the fine image need not fit into memory.
    image, line = np.zeros((ny if rule is None else rule.count(ny), nx)), np.empty(nx)
    for start in range(0, ny, step):
        part = padded[: min(step, ny - start)]
        _antialiased_kernels.turned(values[:, start : start + step], part)
        ducc0.fft.c2c(part, axes=(1,), forward=forward, out=part, nthreads=1)
        if rule is None:
            _antialiased_kernels.squares(part, scale, image[start : start + step])
        else:
            weights = rule.factor, read_only(rule.taps)
            _antialiased_kernels.pixel_rows(part, scale, start, *weights, line, image)
    return image if rule is None else rule.mean(image)


def folded_image(
    residual: Residual, wave: SoftWave, samples: Window, grid: Grid, rule: PixelRule | None
) -> Array:
    """Compute the image of a polynomial wave by products with cosines and sines.

    The parameters and the result are those of `padded_image`, with a ``grid`` from `whole`.
    """
    from . import _antialiased_kernels

    (ny, nx), centre = samples.shape, grid.centre
    rows = 2 * centre + 1
    fits_memory(
        f"the transform of {rows} x {rows} samples",
        folded_bytes(samples, grid, rule),
        "use a smaller shape",
    )
    values = _workspace("values", (rows, rows), complex)
    values[...] = 0.0
    total = _fill(values, residual, wave, samples, grid, ((nx - 1) / 2, (ny - 1) / 2))
    sides = _workspace("sides", (rows, rows), complex)
    even, odd = sides[: centre + 1], sides[centre + 1 :]
    _antialiased_kernels.folded(values, even, odd)
    step = math.copysign(samples.pitch / grid.period, residual.wavefront.image_distance)
    half = _workspace("half", (2, (nx + 1) // 2, rows), complex)
    for table, part, out in zip(_waves(nx, centre, step), (even, odd), half, strict=True):
        product_into(table, part.view(np.float64), out.view(np.float64))
    columns = _workspace("columns", (rows, 2 * nx))
    evens, odds = columns[: centre + 1], columns[centre + 1 :]
    _antialiased_kernels.refolded(half[0], half[1], evens, odds)
    return _unfolded(_waves(ny, centre, step), evens, odds, ny, rule, 1 / total**2)


def _unfolded(
    tables: tuple[Array, Array],
    evens: Array,
    odds: Array,
    ny: int,
    rule: PixelRule | None,
    scale: float,
) -> Array:
    """Transform folded columns (c + 1, 2 nx) and (c, 2 nx) to ``ny`` rows of ``scale |.|^2``.

    The first nx columns are real parts and the others imaginary parts.
    """
    from . import _antialiased_kernels

    nx = evens.shape[1] // 2
    # Each block of rows is averaged along x at once, so the fine image need not fit into memory.
    half = np.empty((ny, nx if rule is None else rule.count(nx)))
    blocks = row_blocks((ny + 1) // 2, 2 * nx, len(evens))
    parts = _workspace("parts", (2, blocks[0][1], 2 * nx))
    fine = _workspace("fine", (2, blocks[0][1], nx))
    for start, stop in blocks:
        a, b = parts[:, : stop - start]
        np.matmul(tables[0][start:stop], evens, out=a)
        np.matmul(tables[1][start:stop], odds, out=b)
        above = half[ny // 2 + start : ny // 2 + stop]
        below = half[(ny + 1) // 2 - stop : (ny + 1) // 2 - start]
        if rule is None:
            _antialiased_kernels.split_squares(a, b, scale, above, below)
            continue
        up, down = fine[:, : stop - start]
        _antialiased_kernels.split_squares(a, b, scale, up, down)
        above[...], below[...] = rule.mean(up), rule.mean(down)
    return half if rule is None else rule.mean_down(half)


def _waves(count: int, centre: int, step: float) -> tuple[Array, Array]:
    """Return cosines ((count + 1)//2, centre + 1) and sines (.., centre) of half the image points.

    ``step`` is the phase in turns per point and cell, signed as the image distance.
    """
    from . import _antialiased_kernels

    half = (count + 1) // 2
    cosines, sines = np.empty((half, centre + 1)), np.empty((half, centre))
    _antialiased_kernels.waves(0.0 if count % 2 else step / 2, step, cosines, sines)
    return cosines, sines


def _fill(
    values: NDArray[np.complex128],
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    grid: Grid,
    origin: tuple[float, float],
) -> float:
    """Add the pupil function to ``values`` and return the sum of its amplitude.

    The middle cell is `Grid.centre` on both axes. A linear phase moves the image sample ``origin``
    (column, row) to frequency 0 of the transform.
    """
    from . import _antialiased_kernels

    pupil = residual.wavefront
    rims = [_rim_table(grid.radius, grid.reach)]
    if pupil.obscuration > 0:
        rims.append(_rim_table(pupil.obscuration * grid.radius, grid.reach))
    # A bound may be an integer, for which numba would compile the kernel again.
    lows, highs = (np.array([rim[i] for rim in rims], dtype=np.float64) for i in (0, 1))
    width = max(rim[2].size for rim in rims)
    tables = np.zeros((len(rims), width))
    for row, rim in zip(tables, rims, strict=True):
        row[: rim[2].size] = rim[2]
    turns = wave.aberration / pupil.wavelength
    per_length = math.copysign(grid.radius / grid.period, pupil.image_distance)
    for axis, place in (((1, 0), 0), ((0, 1), 1)):
        first = samples.first[place] + origin[place] * samples.pitch
        turns[axis] -= per_length * (first - residual.shift[place])
    work = np.empty((6, max(2 * grid.centre + 1, len(turns), len(wave.amplitude))))
    return float(
        _antialiased_kernels.soft_pupil(
            np.ascontiguousarray(turns.T),
            np.ascontiguousarray(wave.amplitude.T),
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
    place = (2 * r - disc.low - disc.high) / (disc.high - disc.low)
    table = chebyshev.chebval(place, disc.series)
    table.setflags(write=False)
    return disc.low, disc.high, table


def _workspace(name: str, shape: tuple[int, ...], kind: type = float) -> NDArray[Any]:
    """Return a thread's own array, which later calls use again if it is small.

    New pages of memory would take a third of a small transform's time.
    """
    need = math.prod(shape) * np.dtype(kind).itemsize
    if need > 2**22:
        return np.empty(shape, dtype=kind)
    kept = getattr(_own, name, None)
    if kept is None or kept.nbytes < need:
        kept = np.empty(need, dtype=np.uint8)
        setattr(_own, name, kept)
    return np.asarray(kept[:need].view(kind).reshape(shape))
