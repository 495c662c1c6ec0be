"""Images of waves on cells from an antialiased grid, by matrix products.

Quadrature nodes are spread onto a few grid cells each by a kernel whose spectrum is small where the
image of a grid repeats, and the spectrum is divided out of the image. As in `antialiased_fft`, the
transform is a product with cosines and sines, which is fast for a window of few Airy units. Its
error does not depend on the outline or on the wave.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import product
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import shared_cell_nodes
from ..aperture.quadrature_nodes import KEPT, frozen, gauss_legendre
from ..wave.detilted import Residual
from ..window.pixels import PixelRule
from ..window.window import Window
from . import quadrature
from .antialiased_fft import SINGLE_ERROR, Waves, folded_intensity, waves, workspace
from .nufft import phasors_about

Array = NDArray[np.float64]

#: Image periods over the window's width. A shorter one makes fewer cells and needs a wider kernel.
OVERSAMPLINGS = (1.5, 1.75, 2.0)
#: Widths of the kernel, cells; of wider ones rounding would decide.
WIDTHS = range(3, 14)
#: Radius, over the rms distance of the rays, within which an image may be as bright as its peak.
WIDE = 1.5
#: Bytes of the widest vector registers.
REGISTER = 64
#: Number of places from the middle of a window to its edge at which repeats are bounded.
PLACES = 16


class SpreadGrid(NamedTuple):
    """Pupil grid for spread nodes.

    Attributes
    ----------
    pitch : float
        Side of a cell, m.
    centre : int
        Number of cells on either side of the middle one.
    width : int
        Width of the kernel, cells.
    oversampling : float
        Image period over the window's width.
    single : bool
        Whether single precision is used.
    """

    pitch: float
    centre: int
    width: int
    oversampling: float
    single: bool

    @property
    def rounding(self) -> float:
        """Bound of the field's error by rounding, relative to the ideal peak."""
        return SINGLE_ERROR if self.single else 0.0

    @property
    def least_error(self) -> float:
        """Bound of the field's error in the middle, relative to the ideal peak."""
        return 2 * float(leaks(self.width, self.oversampling)[0]) + self.rounding

    def errors(self, shape: tuple[int, int], blocks: tuple[int, int]) -> Array:
        """Bound the field's error by repeats and rounding in blocks of a window of a shape."""
        found = leaks(self.width, self.oversampling)
        across, along = (found[_outer(n, blocks[i], max(shape))] for i, n in enumerate(shape))
        return np.asarray(across[:, None] + along + self.rounding)


def spread_grids(
    residual: Residual, samples: Window, core: float, edge: float, single: bool
) -> list[SpreadGrid]:
    """Return grids of least width for given field errors in the middle and at the edge.

    There is one for each of `OVERSAMPLINGS` that reaches them; else one of the largest width.
    """
    wave = residual.wavefront
    half = max(samples.shape) * samples.pitch / 2
    bright = WIDE * residual.rays.rms + quadrature.BRIGHT * residual.airy_unit
    bright += math.hypot(*residual.shift)
    place = min(math.ceil(bright / half * PLACES), PLACES)
    found: list[SpreadGrid] = []
    for oversampling in OVERSAMPLINGS:
        pitch = wave.wavelength * abs(wave.image_distance) / (2 * oversampling * half)
        cells = math.ceil(residual.aperture.half_width / pitch)
        for width in WIDTHS:
            leak = _leak_list(width, oversampling)
            if 2 * leak[place] <= core and 2 * leak[-1] <= edge:
                break
        else:
            if found or oversampling < OVERSAMPLINGS[-1]:
                continue
        found.append(SpreadGrid(pitch, cells + width // 2 + 1, width, oversampling, single))
    return found


def n_bytes(samples: Window, grid: SpreadGrid, rule: PixelRule | None) -> float:
    """Return the peak memory of `image` without its nodes, bytes."""
    rows, (ny, nx) = 2 * grid.centre + 1, samples.shape
    cells = rows * (rows + 2.0 * nx) + (ny + nx) * grid.centre
    points = 8.0 * ny * nx * (1.0 if rule is None else 4.0 / rule.factor)
    return points + (8 if grid.single else 16) * cells


def image(
    residual: Residual,
    samples: Window,
    counts: tuple[int, ...],
    grid: SpreadGrid,
    rule: PixelRule | None,
) -> Array:
    """Return the intensity (ny, nx), 1 at the ideal peak.

    Parameters
    ----------
    residual : Residual
        Wave on cells.
    samples : Window
        Image points, finer than the pixels if a rule is given.
    counts : (int, int, int)
        Shape of the nodes, see `quadrature.coarse_counts`.
    grid : SpreadGrid
        Result of `spread_grid`.
    rule : PixelRule or None
        Average over pixels; None for point samples.
    """
    from . import _antialiased_kernels

    wave, rows, (ny, nx) = residual.wavefront, 2 * grid.centre + 1, samples.shape
    fits_memory(
        f"the transform of {math.prod(counts)} nodes on {rows} x {rows} cells",
        n_bytes(samples, grid, rule) + (80.0 + 16 * grid.width) * math.prod(counts),
        "use a smaller shape",
    )
    half = (nx - 1) / 2 * samples.pitch, (ny - 1) / 2 * samples.pitch
    middle = samples.first[0] + half[0], samples.first[1] + half[1]
    points = phasors_about(residual, *quadrature.pupil_nodes(residual, counts), middle, grid.single)
    # One row more than the grid has, for the zeros at the end of a node's shares.
    values = workspace("values", (rows + 1, rows), points.dtype)
    values[...] = 0.0
    make = _kept_cells_of if points.size <= KEPT else _cells_of
    shares = make(residual.aperture, counts[1], counts[2], grid)
    _antialiased_kernels.spread(points, *shares, rows, values.view(values.real.dtype).ravel())
    side = samples.pitch * grid.pitch / (wave.wavelength * wave.image_distance)
    tables = _waves(ny, side, grid), _waves(nx, side, grid)
    return folded_intensity(values[:rows], (ny, nx), tables, rule, 1.0)


def _waves(count: int, side: float, grid: SpreadGrid) -> Waves:
    """Return the tables of `folded_intensity`, with the inverse of the kernel's spectrum."""
    few = count * grid.centre <= KEPT
    return (_kept_waves_of if few else _waves_of)(count, side, grid)


def _waves_of(count: int, side: float, grid: SpreadGrid) -> Waves:
    """Return `_waves`, read-only."""
    kind = np.dtype(np.complex64 if grid.single else np.complex128)
    places = np.arange((count + 1) // 2, dtype=np.float64) + (0.0 if count % 2 else 0.5)
    gains = 1 / _spectrum(places * abs(side), grid.width, grid.oversampling)
    found = waves(count, grid.centre, side, kind, gains)
    for part in found:
        part.setflags(write=False)
    return found


_kept_waves_of = lru_cache(maxsize=8)(_waves_of)


class _Spreading(NamedTuple):
    """First cell of each node in the flat grid, (n,), and its shares along u and v.

    Those along u are (n, width). Those along v are followed by zeros, up to a multiple of
    `REGISTER` bytes.
    """

    first: NDArray[np.int64]
    along: NDArray[np.floating]
    across: NDArray[np.floating]


def _cells_of(aperture: Aperture, n_s: int, n_t: int, grid: SpreadGrid) -> _Spreading:
    """Return the shares of an aperture's nodes, read-only."""
    u, v, _ = shared_cell_nodes(aperture, n_s, n_t)
    kind: type[np.floating] = np.float32 if grid.single else np.float64

    def along(place: Array) -> tuple[NDArray[np.int64], NDArray[np.floating]]:
        """First cell and shares of nodes at given places, cells."""
        first = np.ceil(place - grid.width / 2)
        away = first[:, None] + np.arange(grid.width) - place[:, None]
        bend = np.sqrt(np.maximum(1 - (2 * away / grid.width) ** 2, 0.0))
        shares = _kernel(bend, grid.width, grid.oversampling)
        return (first + grid.centre).astype(np.int64), np.asarray(shares, dtype=kind)

    (first_u, along_u), (first_v, along_v) = (along(a.ravel() / grid.pitch) for a in (u, v))
    cells = REGISTER // (2 * along_v.itemsize)
    along_v = np.pad(along_v, ((0, 0), (0, -grid.width % cells)))
    found = _Spreading(first_u * (2 * grid.centre + 1) + first_v, along_u, along_v)
    for part in found:
        part.setflags(write=False)
    return found


_kept_cells_of = lru_cache(maxsize=8)(_cells_of)


def sharpness(width: int, oversampling: float) -> float:
    """Return the exponent of the kernel with the least leak at the window's edge, about.

    It is that of Barnett et al. (2019) for wide kernels; the last factor is a fit to narrow ones.
    """
    return 0.976 * math.pi * width * (1 - 0.5 / oversampling) * (1 - 5 / width**3)


def _kernel(bend: Array, width: int, oversampling: float) -> Array:
    """Return the kernel where ``bend`` is the root of 1 less the square of t over half the width.

    It ends at 0, so that its spectrum falls off with the power 3/2 of the frequency.
    """
    exponent = sharpness(width, oversampling)
    return np.asarray(np.exp(exponent * (bend - 1)) - math.exp(-exponent))


def _spectrum(frequency: Array, width: int, oversampling: float) -> Array:
    """Return the kernel's spectrum at frequencies, turns per cell."""
    phase, values = _sampled_kernel(width, oversampling, float(np.max(frequency)))
    return np.asarray(np.sum(values * np.cos(phase * frequency[:, None]), axis=1))


def _sampled_kernel(width: int, oversampling: float, highest: float) -> tuple[Array, Array]:
    """Return nodes on the kernel, as phases per frequency in turns per cell, and their shares.

    They are enough for its spectrum up to the ``highest`` frequency.
    """
    # with t = width/2 sin(angle) the kernel has no root at its ends
    fraction, weights = gauss_legendre(64 + 8 * width + math.ceil(2 * width * highest))
    angle = math.pi / 2 * fraction
    values = _kernel(np.cos(angle), width, oversampling) * np.cos(angle) * weights
    return math.pi * width * np.sin(angle), math.pi / 2 * width * values


@lru_cache(maxsize=64)
def leaks(width: int, oversampling: float) -> Array:
    """Return the sum of a kernel's repeats from the middle to the window's edge, (PLACES + 1,).

    It is relative to the kernel's spectrum, and the largest value up to each place. Repeats beyond
    40 cells are bounded by their power law.
    """
    places, most = np.linspace(0.0, 0.5 / oversampling, PLACES + 1), 40
    phase, values = _sampled_kernel(width, oversampling, most + float(places[-1]))
    far, near = np.arange(1.0, most + 1)[:, None] * phase, phase[:, None] * places
    # spectra at the sums and differences of both frequencies, by the addition theorem
    even = product(np.cos(far) * values, np.cos(near))
    odd = product(np.sin(far) * values, np.sin(near))
    repeats = np.abs(np.stack([even + odd, even - odd]))
    rest = 4 * most * repeats[:, -8:].max(axis=(0, 1))
    middle = product(values[None], np.cos(near))[0]
    return frozen(np.maximum.accumulate((repeats.sum(axis=(0, 1)) + rest) / middle))


@lru_cache(maxsize=64)
def _leak_list(width: int, oversampling: float) -> list[float]:
    """Return `leaks` as numbers of Python, which are faster to compare."""
    found: list[float] = leaks(width, oversampling).tolist()
    return found


@lru_cache(maxsize=32)
def _outer(count: int, blocks: int, longest: int) -> NDArray[np.int64]:
    """Return the index in `leaks` of the outer edge of each of the blocks of ``count`` pixels.

    ``longest`` is the number of pixels along the longer side of the window.
    """
    first = -(-np.arange(blocks + 1) * count // blocks)
    away = np.abs(2.0 * first - count) / longest
    # Rounding must not move a place to the next one; the tables are continuous.
    places = np.ceil(np.maximum(away[:-1], away[1:]) * PLACES - 1e-9)
    return np.asarray(places, dtype=np.int64)
