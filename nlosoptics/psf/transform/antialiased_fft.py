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
from typing import Any, NamedTuple

import ducc0
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import row_blocks
from ..wave.detilted import Residual
from ..window import antialiased_disc
from ..window.pixels import PixelRule
from ..window.window import Window
from .antialiased_pupil import SoftWave

Array = NDArray[np.float64]

#: Bound of the field error of single precision; 1e-7 was measured.
SINGLE_ERROR = 1e-6
#: Points per cell in the table of a softened rim; six-point interpolation then has error 2e-15.
STEPS = 256
#: Largest workspace array that is kept for the next call, bytes.
WORKSPACE_BYTES = 2**22
#: Memory of a block of columns, bytes, small enough for the processor's cache.
BLOCK_BYTES = 2**19

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
    single : bool
        Whether to use single precision and to soften the rim over fewer cells.
    """

    period: float
    radius: float
    single: bool

    @property
    def reach(self) -> int:
        """Half width of the softened rim, cells."""
        return antialiased_disc.SHORT_REACH if self.single else antialiased_disc.REACH

    @property
    def centre(self) -> int:
        """Number of cells on either side of the middle one, including the softened rim."""
        return math.ceil(self.radius) + self.reach

    @property
    def kind(self) -> np.dtype[Any]:
        """Complex dtype of the pupil's values."""
        return np.dtype("c8" if self.single else "c16")

    @property
    def error(self) -> float:
        """Bound of the field error due to the truncated rim and to single precision."""
        return antialiased_disc.cut(self.radius, self.reach) + (
            SINGLE_ERROR if self.single else 0.0
        )


def padded(residual: Residual, samples: Window, period: float, single: bool) -> Grid:
    """Return the grid for FFTs: a period of at least ``period``, Airy units, and of fast size."""
    unit = residual.airy_unit
    # sizes that are multiples of four are the fastest
    size = 4 * int(ducc0.fft.good_size(math.ceil(period * unit / samples.pitch / 4)))
    return Grid(size * samples.pitch, size * samples.pitch / (2 * unit), single)


def whole(residual: Residual, period: float, single: bool) -> Grid:
    """Return the grid for matrix products, with a whole number of cells per radius.

    Calls with different periods then often share the cached table of the rim.
    """
    cells = math.ceil(period / 2)
    return Grid(2 * cells * residual.airy_unit, cells, single)


def padded_bytes(samples: Window, grid: Grid, rule: PixelRule | None) -> float:
    """Return the peak memory of `padded_image`, bytes."""
    size = round(grid.period / samples.pitch)
    rows = min(size, 2 * grid.centre + 1)
    return _image_bytes(samples, rule) + float(grid.kind.itemsize) * rows * size


def folded_bytes(samples: Window, grid: Grid, rule: PixelRule | None) -> float:
    """Return the peak memory of `folded_image`, bytes."""
    rows, (ny, nx) = 2 * grid.centre + 1, samples.shape
    cells = rows * (rows + 2 * nx) + (ny + nx) * grid.centre
    return _image_bytes(samples, rule) + float(grid.kind.itemsize) * cells


def _image_bytes(samples: Window, rule: PixelRule | None) -> float:
    """Return the memory of the image, bytes, with a constant for tables and workspaces."""
    ny, nx = samples.shape
    return 8.0 * ny * nx * (1.0 if rule is None else 4.0 / rule.factor) + 2**26


def padded_image(
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    grid: Grid,
    rule: PixelRule | None,
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
    values = workspace("values", (rows, size), grid.kind)
    values[...] = 0.0
    total = _fill(values[:, :rows], residual, wave, samples, grid, (0.0, 0.0))
    return _padded_intensity(
        values, samples.shape, residual.wavefront.image_distance > 0, rule, 1 / total**2
    )


def folded_image(
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    grid: Grid,
    rule: PixelRule | None,
) -> Array:
    """Compute the image of a polynomial wave by products with cosines and sines.

    Parameters
    ----------
    residual : Residual
        Wave, for the pupil and the tilt's shift.
    wave : SoftWave
        Its polynomials.
    samples : Window
        Image points, finer than the pixels if a rule is given.
    grid : Grid
        Result of `whole`.
    rule : PixelRule or None
        Average over pixels; None for point samples.

    Returns
    -------
    ndarray, (ny, nx)
        Intensity, 1 at the ideal peak.
    """
    ny, nx = samples.shape
    centre = grid.centre
    rows = 2 * centre + 1
    fits_memory(
        f"the transform of {rows} x {rows} samples",
        folded_bytes(samples, grid, rule),
        "use a smaller shape",
    )
    kind = grid.kind
    values = workspace("values", (rows, rows), kind)
    values[...] = 0.0
    total = _fill(values, residual, wave, samples, grid, ((ny - 1) / 2, (nx - 1) / 2))
    side = math.copysign(samples.pitch / grid.period, residual.wavefront.image_distance)
    tables = waves(ny, centre, side, kind), waves(nx, centre, side, kind)
    return folded_intensity(values, samples.shape, tables, rule, 1 / total**2)


def folded_intensity(
    values: NDArray[np.complexfloating],
    shape: tuple[int, int],
    tables: tuple[Waves, Waves],
    rule: PixelRule | None,
    scale: float,
) -> Array:
    """Transform ``values`` (2 c + 1, 2 c + 1) by cosines and sines; return ``scale |.|^2``.

    Parameters
    ----------
    values : ndarray
        Pupil function, its middle cell at [c, c].
    shape : (int, int)
        Points (ny, nx), symmetric about frequency 0.
    tables : (Waves, Waves)
        Results of `waves` for y and for x.
    rule : PixelRule or None
        Average over pixels; None for point samples.
    scale : float
        Factor of the intensity.
    """
    from . import _antialiased_kernels

    ny, nx = shape
    rows, kind = len(values), values.dtype
    centre = rows // 2
    even = workspace("even", (centre + 1, rows), kind)
    odd = workspace("odd", (centre, rows), kind)
    _antialiased_kernels.folded(values, even, odd)
    half_even = workspace("half even", ((nx + 1) // 2, rows), kind)
    half_odd = workspace("half odd", ((nx + 1) // 2, rows), kind)
    for part, source, out in zip(tables[1], (even, odd), (half_even, half_odd), strict=True):
        reals, out = source.view(part.dtype), out.view(part.dtype)
        for start, stop in row_blocks(len(part), 2 * rows, centre + 1):
            np.matmul(part[start:stop], reals, out=out[start:stop])
    real = half_even.real.dtype
    evens = workspace("even", (centre + 1, 2 * nx), real)
    odds = workspace("odd", (centre, 2 * nx), real)
    _antialiased_kernels.refolded(half_even, half_odd, evens, odds)
    return _unfolded(tables[0], evens, odds, ny, rule, scale)


def _unfolded(
    table: Waves,
    evens: NDArray[np.floating],
    odds: NDArray[np.floating],
    ny: int,
    rule: PixelRule | None,
    scale: float,
) -> Array:
    """Transform folded columns (c + 1, 2 nx) and (c, 2 nx) to ``ny`` rows.

    The first nx columns are real parts and the others imaginary parts. The result is
    ``scale |.|^2``.
    """
    from . import _antialiased_kernels

    nx = evens.shape[1] // 2
    # Each block of rows is averaged along x at once, so the fine image need not fit into memory.
    across = nx if rule is None else rule.count(nx)
    half = np.empty((ny, across))
    blocks = row_blocks((ny + 1) // 2, 2 * nx, len(evens))
    rows = blocks[0][1]
    part_even = workspace("part even", (rows, 2 * nx), evens.dtype)
    part_odd = workspace("part odd", (rows, 2 * nx), evens.dtype)
    fine = np.empty((0 if rule is None else 2, rows, nx))
    for start, stop in blocks:
        a, b = part_even[: stop - start], part_odd[: stop - start]
        np.matmul(table.cosines[start:stop], evens, out=a)
        np.matmul(table.sines[start:stop], odds, out=b)
        above = half[ny // 2 + start : ny // 2 + stop]
        below = half[(ny + 1) // 2 - stop : (ny + 1) // 2 - start]
        if rule is None:
            _antialiased_kernels.split_squares(a, b, scale, above, below)
            continue
        up, down = fine[:, : stop - start]
        _antialiased_kernels.split_squares(a, b, scale, up, down)
        above[...], below[...] = rule.mean(up), rule.mean(down)
    return half if rule is None else rule.mean_down(half)


class Waves(NamedTuple):
    """Cosines ((count + 1)//2, centre + 1) and sines (.., centre) for half of the image points."""

    cosines: NDArray[np.floating]
    sines: NDArray[np.floating]


def waves(
    count: int, centre: int, step: float, kind: np.dtype[Any], gain: Array | None = None
) -> Waves:
    """Return the tables of `folded_intensity` for one axis.

    Parameters
    ----------
    count : int
        Number of image points.
    centre : int
        Number of cells on either side of the middle one.
    step : float
        Phase in turns per point and cell, signed as the image distance.
    kind : dtype
        Complex dtype of the transform.
    gain : ndarray, ((count + 1)//2,), optional
        Factors of the field, from the middle point outward.
    """
    from . import _antialiased_kernels

    half, real = (count + 1) // 2, np.empty(0, kind).real.dtype
    cosines, sines = np.empty((half, centre + 1), real), np.empty((half, centre), real)
    _antialiased_kernels.waves(0.0 if count % 2 else step / 2, step, cosines, sines)
    if gain is not None:
        cosines *= gain[:, None]
        sines *= gain[:, None]
    return Waves(cosines, sines)


def _fill(
    values: NDArray[np.complexfloating],
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    grid: Grid,
    origin: tuple[float, float],
) -> float:
    """Add the pupil function to ``values`` and return the sum of its amplitude.

    The middle cell is `Grid.centre` on both axes. A linear phase moves the image sample ``origin``
    (row, column) to frequency 0 of the transform.
    """
    from . import _antialiased_kernels

    pupil = residual.wavefront
    found = [_rim_table(grid.radius, grid.reach)]
    if pupil.obscuration > 0:
        found.append(_rim_table(pupil.obscuration * grid.radius, grid.reach))
    # A bound may be an integer, for which numba would compile the kernel again.
    lows, highs = (np.array([rim[i] for rim in found], dtype=np.float64) for i in (0, 1))
    width = max(rim[2].size for rim in found)
    tables = np.zeros((len(found), width))
    for row, rim in zip(tables, found, strict=True):
        row[: rim[2].size] = rim[2]
    turns = wave.aberration / pupil.wavelength
    per_length = math.copysign(grid.radius / grid.period, pupil.image_distance)
    for axis, place in (((1, 0), 0), ((0, 1), 1)):
        first = samples.first[place] + origin[1 - place] * samples.pitch
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


def _padded_intensity(
    values: NDArray[np.complexfloating],
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

    size = values.shape[1]
    ny, nx = shape
    ducc0.fft.c2c(values, axes=(1,), forward=forward, out=values, nthreads=1)
    step = max(8, BLOCK_BYTES // (16 * size))
    # Each block of rows is averaged along x at once, so the fine image need not fit into memory.
    across = nx if rule is None else rule.count(nx)
    half = np.empty((ny, across))
    energy = np.empty((0 if rule is None else step, nx))
    padded = workspace("padded", (step, size), values.dtype)
    for start in range(0, ny, step):
        part = padded[: min(step, ny - start)]
        _antialiased_kernels.turned(values[:, start : start + step], part)
        ducc0.fft.c2c(part, axes=(1,), forward=forward, out=part, nthreads=1)
        if rule is None:
            _antialiased_kernels.squares(part, scale, half[start : start + step])
            continue
        fine = energy[: len(part)]
        _antialiased_kernels.squares(part, scale, fine)
        half[start : start + step] = rule.mean(fine)
    return half if rule is None else rule.mean_down(half)


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


def workspace(name: str, shape: tuple[int, int], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return a thread-local array, reused by later calls if small, which saves page faults."""
    need = shape[0] * shape[1] * kind.itemsize
    if need > WORKSPACE_BYTES:
        return np.empty(shape, dtype=kind)
    held = getattr(_own, name, None)
    if held is None or held.nbytes < need:
        held = np.empty(need, dtype=np.uint8)
        setattr(_own, name, held)
    return np.asarray(held[:need].view(kind).reshape(shape))
