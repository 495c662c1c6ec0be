"""Blocks of rays whose detected light is sorted by pixel and by path length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import GROUPS, UNIT
from ..light import _light_kernels as kernels
from ..light.blocks import Job, Rays, Traced, follow
from ..light.trace import in_blocks
from ._image_kernels import sort_light

Array = NDArray[np.float64]
Cells = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Film:
    """Sums of detected power by group of rays, layer, and pixel or bin.

    Layer 0 is the light that never met the hidden object; layer k is the other light after k
    reflections.
    """

    job: Job
    shape: tuple[int, int]
    #: Start and width of a bin, m, number of bins, and whether lengths include the outer legs.
    bins: tuple[float, float, int, bool]
    image: Array = field(init=False)  # (groups, layers, ny, nx), W times rays
    #: (groups, layers, n_bins + 2), W times rays; the first and last are outside all bins.
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
        for result, (cells, slots, powers) in in_blocks(_imaged, self, start, end):
            np.add.at(image, cells, powers)
            np.add.at(histogram, slots, powers)
            yield result


def _imaged(film: Film, first: int, end: int) -> tuple[Traced, tuple[Cells, Cells, Array]]:
    """Trace the rays ``first`` to ``end - 1``; return their results and their detected light."""
    block = ImagedRays(film, first, end - first)
    result = follow(block)
    cells, slots, powers, rays = (np.concatenate(part) for part in zip(*block.landed, strict=True))
    order = np.argsort(rays // UNIT, kind="stable")
    return result, (cells[order], slots[order], powers[order])


class ImagedRays(Rays):
    """Block of rays that sorts its detected light by pixel and by path length."""

    def __init__(self, film: Film, first: int, n: int) -> None:
        super().__init__(film.job, first, n)
        self.watched, self.film = True, film
        none = np.zeros(0, dtype=np.int64)
        self.landed: list[tuple[Cells, Cells, Array, Cells]] = [(none, none, np.zeros(0), none)]

    def take_detected(
        self, power: Array, length: Array, vertices: list[Array], ends: Array, bounce: int
    ) -> None:
        """Find pixel and bin of detected light; `Rays.take_detected` describes the arguments."""
        super().take_detected(power, length, vertices, ends, bounce)
        met = np.any([vertex[:, kernels.MET] > 0.0 for vertex in vertices], axis=0)
        cells, slots, rays = np.empty((3, self.n), dtype=np.int64)
        powers = np.empty(self.n)
        count = sort_light(
            self.around.world.camera,
            self.first,
            (np.where(met, bounce, 0), self.job.max_bounces + 1),
            power,
            # of one order in memory, so that the kernel is compiled once
            np.ascontiguousarray(length),
            vertices[0][:, kernels.LENGTH],
            vertices[-1],
            np.ascontiguousarray(ends),
            self.film.shape,
            self.film.bins,
            cells,
            slots,
            powers,
            rays,
        )
        self.landed.append((cells[:count], slots[:count], powers[:count], rays[:count]))
