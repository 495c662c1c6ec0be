"""Blocks of rays of one object point: for the flux through the lens, and for pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import BECKMANN, GROUPS
from . import _light_kernels as light_kernels
from . import _point_kernels as kernels
from . import _surround_kernels as surround
from .blocks import Job, Rays
from .trace import BLOCK

Array = NDArray[np.float64]
#: Share of the light that is aimed at where glossy lobes send it to the lens; one binary digit.
AIM: Final = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What every block of a point's rays needs.

    Parameters
    ----------
    job : Job
    source : ndarray, (7,)
        Position, normal, and 1 for even light; see `_point_kernels`.
    whole : ndarray, (4,)
        Rectangle of all of the wall, low x and y, width and height, over which light is spread
        evenly; without area where it goes as it shines.
    image_box, gloss_box : ndarray, (4,)
        Rectangles of the wall by which smooth mirrors show the point to the lens, and glossy
        mirror-like lobes for the most part; without area where there are none.
    matt : ndarray, (n, 4)
        The wall's lobes that are not mirror-like.
    mirror_image : bool
    window : (float, float, float, int)
        Low x and y, pitch and columns of the pixels.
    rows : int
    each : int
        Rays of a pixel, even.
    """

    job: Job
    source: Array
    whole: Array
    image_box: Array
    gloss_box: Array
    matt: Array
    mirror_image: bool
    window: tuple[float, float, float, int]
    rows: int
    each: int

    @property
    def columns(self) -> int:
        """Number of sums: one for each count of reflections, and what misses the pixels."""
        return self.job.max_bounces + 2

    @property
    def smooth(self) -> bool:
        """Whether the wall has a smooth mirror's lobe."""
        lobes = self.job.around.world.wall
        return bool(((lobes[:, 2] == 0.0) & (lobes[:, 0] >= BECKMANN)).any())

    @property
    def mirrors(self) -> int:
        """Smooth mirrors that the lens looks through, at most."""
        sees_itself = self.job.around.plan.wall_to_wall
        return self.job.max_bounces - 1 if self.smooth and sees_itself else 0


def flux_of(
    task: Task, first: int, end: int
) -> tuple[Array, NDArray[np.int64], Array, Counter[str]]:
    """Sums of units and groups, mirror images by group and pixel, and counted queries."""
    block = _Block(task, first, end - first)
    most, plan = task.job.max_bounces, task.job.around.plan
    world, sampler = task.job.around.world, task.job.sampler
    if task.mirror_image and task.smooth:
        block.image()
    light = block.start()
    eyes = list(block.mirrored(block.look_around())) if task.mirrors else []
    for depth, eye in enumerate(eyes, start=1):
        if depth + 1 <= most:
            block.from_source(eye, world.wall)
            block.book_seen(depth + 1)
    by_mirrors = np.ones(block.n, dtype=bool)
    for bounce in range(1, most + 1):
        image = task.mirror_image or bounce > 1
        counted = (world.wall if image else task.matt, task.matt if bounce == 1 else world.wall)
        found = (*block.ends, *block.at, block.imaged)
        kernels.to_lens(world, sampler, first, counted, plan.glossy, light, *found)
        block.clear(light)
        block.book(bounce)
        block.keep()
        for depth, eye in enumerate(eyes, start=1):
            if bounce + depth + 1 <= most:
                block.connect(light, eye)
                block.book_seen(bounce + depth + 1)
        if not (plan.glossy or plan.wall_to_wall):
            break
        onward = block.rays.onward(light, bounce)
        kernels.lens_hits(
            world,
            counted,
            plan.glossy,
            bounce == 1,
            light,
            block.rays.leave,
            onward,
            block.rays.fates,
            by_mirrors,
            block.value,
            *block.at,
            block.imaged,
        )
        block.book(bounce)
        block.keep()
        if not plan.wall_to_wall:
            break
        light = onward
    sums = block.sums.reshape(-1, GROUPS, task.columns)
    cells = [np.zeros(0, dtype=np.int64), *(c for c, _ in block.kept)]
    powers = [np.zeros(0), *(p for _, p in block.kept)]
    return sums, np.concatenate(cells), np.concatenate(powers), block.rays.counts


def pixels_of(task: Task, first: int, end: int) -> tuple[Array, Array, Counter[str]]:
    """Means of the pixels ``first`` up to ``end``, their variances, and counted queries."""
    at_once = max(1, BLOCK // task.each)
    means, variances, counts = [], [], Counter[str]()
    for start in range(first, end, at_once):
        count = min(at_once, end - start)
        found, asked = _seen_by_pixels(task, start * task.each, count * task.each)
        found = found.reshape(count, task.each // 2, 2).mean(axis=2)
        mean = found.mean(axis=1)
        means.append(mean)
        variances.append(((found - mean[:, None]) ** 2).sum(axis=1))
        counts += asked
    del counts["rays"]
    pairs = task.each // 2
    scale = pairs * (pairs - 3)  # Student's factor as of `mean_of`
    return np.concatenate(means), np.concatenate(variances) / scale, counts


def _seen_by_pixels(task: Task, first: int, n: int) -> tuple[Array, Counter[str]]:
    """Power that each of the pixels' rays stands for, W, and counted queries."""
    block, world = _Block(task, first, n), task.job.around.world
    most = task.job.max_bounces
    eyes = [block.look_at_pixels()]
    found = block.from_source(eyes[0], task.matt).copy()
    if most == 1 or not task.job.around.plan.wall_to_wall:
        return found, block.rays.counts
    eyes += block.mirrored(eyes[0])
    for depth, eye in enumerate(eyes):
        if 1 <= depth < most:
            found += block.from_source(eye, world.wall)
    light = block.start()
    for bounce in range(1, most):
        for depth, eye in enumerate(eyes):
            if bounce + depth + 1 <= most:
                found += block.connect(light, eye)
        light = block.rays.onward(light, bounce)
    return found, block.rays.counts


class _Block:
    """Rays of a block, with what the kernels fill."""

    def __init__(self, task: Task, first: int, n: int) -> None:
        self.task, self.first, self.n = task, first, n
        self.rays = Rays(task.job, first, n)
        self.value = np.empty(n)
        self.ends = (self.value, self.rays.starts, self.rays.ends)
        self.at = (np.empty(n), np.empty(n))
        self.seen_at = (np.empty(n), np.empty(n))
        self.imaged = np.zeros(n)
        self.cells = np.empty(n, dtype=np.int64)
        self.sums = np.zeros((self.rays.sums.shape[0], task.columns))
        self.kept: list[tuple[NDArray[np.int64], Array]] = []

    def image(self) -> None:
        """Book the image that smooth mirrors make by one reflection."""
        rays, powers, world = self.rays, np.empty(self.n), self.task.job.around.world
        # walls that bend may show the point elsewhere as well
        light = self._shine(self.task.image_box, AIM if self.task.image_box.all() else 0.0)
        kernels.mirrored(world, light, rays.origins, rays.directions, powers, rays.live)
        hits = rays._hits(light)
        found = (self.value, *self.at, self.imaged)
        kernels.image_hits(world, rays.directions, rays.origins, powers, hits, *found)
        self.book(1)
        self.keep()

    def start(self) -> Array:
        """First vertices of the point's light."""
        return self._shine(self.task.gloss_box, AIM if self.task.gloss_box.all() else 0.0)

    def _shine(self, box: Array, share: float) -> Array:
        task, rays, n = self.task, self.rays, self.n
        aims, aimed = np.zeros((n, 3)), np.zeros(n, dtype=bool)
        where = (task.whole, box, share)
        kernels.shine(
            task.job.sampler, self.first, task.source, *where, rays.directions, aims, aimed
        )
        if aimed.any():
            wall = task.job.scene.wall
            aims[aimed, 2] = 0.0 if wall.is_flat else wall.height(*aims[aimed, :2].T)
        reach = np.empty(n)
        kernels.toward(task.source, aims, aimed, rays.directions, reach, rays.live)
        rays.origins[:] = task.source[:3]
        light = np.zeros((n, light_kernels.VERTEX))
        hits = rays._hits(None)
        kernels.arrive(task.source, *where, rays.directions, reach, rays.live, hits, light)
        rays._settle(light)
        return light

    def look_around(self) -> Array:
        """Vertices seen from the lens over its whole front."""
        rays, powers = self.rays, np.empty(self.n)
        world = self.task.job.around.world
        where = (rays.origins, rays.directions)
        kernels.look_around(world, self.task.job.sampler, self.first, *where, powers)
        kernels.landings(world, *where, *self.seen_at)
        return self._seen(powers)

    def look_at_pixels(self) -> Array:
        """Vertices that pixels see."""
        task, rays, powers = self.task, self.rays, np.empty(self.n)
        kernels.look_at_pixels(
            task.job.around.world,
            task.job.sampler,
            self.first,
            task.each,
            task.window,
            rays.origins,
            rays.directions,
            powers,
        )
        return self._seen(powers)

    def mirrored(self, eye: Array) -> Iterator[Array]:
        """Vertices seen from the lens by one smooth mirror, by two, and so on."""
        rays, powers, world = self.rays, np.empty(self.n), self.task.job.around.world
        for _ in range(self.task.mirrors):
            kernels.mirrored(world, eye, rays.origins, rays.directions, powers, rays.live)
            eye = self._seen(powers, eye)
            yield eye

    def _seen(self, powers: Array, left: Array | None = None) -> Array:
        rays, new = self.rays, np.zeros((self.n, light_kernels.VERTEX))
        np.greater(powers, 0.0, out=rays.live)
        hits = rays._hits(left)
        light_kernels.look(rays.origins, rays.directions, powers, np.ones(self.n), hits, new)
        rays._settle(new)
        return new

    def from_source(self, eye: Array, lobes: Array) -> Array:
        """Power from the point straight to vertices that the lens sees."""
        kernels.from_source(self.task.source, lobes, eye, *self.ends)
        self.clear(None)
        return self.value

    def connect(self, light: Array, eye: Array) -> Array:
        """Power from vertices of the light to those that the lens sees."""
        kernels.connect(self.task.job.around.world, light, eye, *self.ends)
        self.clear(light)
        return self.value

    def clear(self, starts: Array | None) -> None:
        """Take out connections that something stands in the way of."""
        on_wall = np.zeros(self.n, dtype=bool)
        if starts is not None:
            np.equal(starts[:, light_kernels.SURFACE], surround.WALL, out=on_wall)
        rays = self.rays
        self.task.job.around.clear(rays.starts, rays.ends, on_wall, self.value, rays.counts)

    def book(self, bounce: int) -> None:
        """Add the present values, which land where `at` says."""
        self._book(bounce, self.at)

    def book_seen(self, bounce: int) -> None:
        """The same of values that land where `seen_at` says, of vertices seen from the lens."""
        self._book(bounce, self.seen_at)

    def _book(self, bounce: int, at: tuple[Array, Array]) -> None:
        task = self.task
        kernels.book(
            self.value,
            *at,
            task.window,
            task.rows,
            bounce,
            task.job.max_bounces,
            self.first,
            self.sums,
            self.cells,
        )

    def keep(self) -> None:
        """Keep group and pixel of the imaged share of the values just booked."""
        rows = np.flatnonzero((self.cells >= 0) & (self.imaged > 0.0))
        if len(rows):
            pixels = self.task.rows * self.task.window[3]
            cells = (self.first + rows) % GROUPS * pixels + self.cells[rows]
            self.kept.append((cells, self.value[rows] * self.imaged[rows]))
