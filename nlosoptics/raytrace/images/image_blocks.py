"""Blocks of rays whose detected light is sorted by pixel and by path length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import GROUPS, UNIT
from ..light import _light_kernels as kernels
from ..light.blocks import Job, Rays, Traced, follow
from ..light.trace import in_blocks
from . import _image_kernels as image_kernels

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Bins = tuple[float, float, int, bool]
NO_CELLS: Cells = np.zeros(0, dtype=np.int64)
#: Cells of the image, cells of the histogram, and powers of detected paths.
Landed = tuple[Cells, Cells, Array]


@dataclass(frozen=True, eq=False)
class Film:
    """Sums of detected power by group of rays, layer, and pixel or bin.

    Layer 0 is the light that never met the hidden object; layer k is the other light after k
    reflections.

    Parameters
    ----------
    job : Job
        Scene and options.
    shape : (int, int)
        Rows and columns of the image.
    bins : (float, float, int, bool)
        Start of the first bin and width of a bin, m, number of bins, and whether path lengths
        include the outer legs.

    Attributes
    ----------
    image : ndarray, (groups, layers, ny, nx)
        Sums of pixels, W times rays.
    histogram : ndarray, (groups, layers, n_bins + 2)
        Sums of bins, W times rays; the first and the last one are of the light outside all bins.
    """

    job: Job
    shape: tuple[int, int]
    bins: Bins
    image: Array = field(init=False)
    histogram: Array = field(init=False)

    def __post_init__(self) -> None:
        sums = (GROUPS, self.job.max_bounces + 1)
        object.__setattr__(self, "image", np.zeros((*sums, *self.shape)))
        object.__setattr__(self, "histogram", np.zeros((*sums, self.bins[2] + 2)))

    def exposed(self, start: int, end: int) -> Iterator[Traced]:
        """Trace the rays from ``start`` to ``end``, add their light, and yield all other results.

        Contributions are added in the order of the rays, in units of `UNIT`, so that the sums do
        not depend on the number of threads.
        """
        image, histogram = self.image.reshape(-1), self.histogram.reshape(-1)
        for found, (cells, slots, powers) in in_blocks(_imaged, self, start, end):
            np.add.at(image, cells, powers)
            np.add.at(histogram, slots, powers)
            yield found


def _imaged(film: Film, first: int, end: int) -> tuple[Traced, Landed]:
    """Trace the rays ``first`` to ``end - 1`` and return their results and their detected light."""
    block = ImagedRays(film.job, film.shape, film.bins, first, end - first)
    found = follow(block)
    return found, in_order(block.landed, NO_CELLS, NO_CELLS, np.zeros(0), NO_CELLS)


def in_order(landed: Sequence[tuple[Array | Cells, ...]], *none: Array | Cells) -> Any:
    """Return the landed light of all calls, in units of `UNIT` rays, without the rays' numbers.

    ``landed`` has the arrays of each call, the last of them the numbers of the rays; ``none`` are
    those of a call in which no light landed.
    """
    *parts, rays = (np.concatenate(part) for part in zip(none, *landed, strict=True))
    order = np.argsort(rays // UNIT, kind="stable")
    return tuple(part[order] for part in parts)


def met_object(vertices: list[Array]) -> NDArray[np.bool_]:
    """Return which rays' paths met the hidden object."""
    return np.asarray(np.any([vertex[:, kernels.MET] > 0.0 for vertex in vertices], axis=0))


class FilmRays(Rays):
    """Block of rays that finds the pixels of its detected light.

    Parameters
    ----------
    job : Job
        Scene and options.
    shape, bins : tuple
        As in `Film`.
    first : int
        Number of the first ray.
    n : int
        Number of rays.
    """

    def __init__(self, job: Job, shape: tuple[int, int], bins: Bins, first: int, n: int) -> None:
        super().__init__(job, first, n)
        self.watched = True
        self.shape, self.bins = shape, bins
        self.landed: list[tuple[Array | Cells, ...]] = []

    def sorted(
        self,
        layers: tuple[Cells, int],
        power: Array,
        length: Array,
        vertices: list[Array],
        ends: Array,
    ) -> tuple[Cells, Cells, Array, Cells]:
        """Return cell of the image, cell of the histogram, power and ray of the light that landed.

        ``layers`` are the layer of every ray and their number; `Rays.take_detected` describes the
        other arguments.
        """
        cells, slots, rays = np.empty((3, self.n), dtype=np.int64)
        powers = np.empty(self.n)
        count = image_kernels.sort_light(
            self.around.world.camera,
            self.first,
            layers,
            power,
            # of one layout in memory, so that the kernel is compiled once
            np.ascontiguousarray(length),
            vertices[0][:, kernels.LENGTH],
            vertices[-1],
            np.ascontiguousarray(ends),
            self.shape,
            self.bins,
            cells,
            slots,
            powers,
            rays,
        )
        return cells[:count], slots[:count], powers[:count], rays[:count]


class ImagedRays(FilmRays):
    """Block of rays that sorts its detected light by pixel and by path length."""

    def take_detected(
        self, power: Array, length: Array, vertices: list[Array], ends: Array, bounce: int
    ) -> None:
        """Find pixel and bin of detected light; `Rays.take_detected` describes the arguments."""
        super().take_detected(power, length, vertices, ends, bounce)
        layers = np.where(met_object(vertices), bounce, 0), self.job.max_bounces + 1
        self.landed.append(self.sorted(layers, power, length, vertices, ends))
