"""Blocks of rays of one object point, for the flux through the lens and for pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import BECKMANN, GROUPS
from . import _connection_kernels as connecting
from . import _light_kernels as light_kernels
from . import _point_kernels as kernels
from . import _surround_kernels as surround
from .blocks import Job, Rays
from .trace import BLOCK

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Data common to all blocks of rays of one object point."""

    job: Job
    source: Array  # (7,): position (m) and normal, 1 for isotropic or 0 for Lambertian emission
    #: Rectangles of the wall (low x, low y, width, height), m, or 0: the whole wall, to be sampled
    #: uniformly, and where the lens sees the point by smooth mirrors and by glossy lobes.
    whole: Array
    image_box: Array
    gloss_box: Array
    matt: Array  # lobes of the wall that are not mirror-like
    mirror_image: bool  # whether to include the mirror image of the point
    window: tuple[float, float, float, int]  # low x and y of the pixels, pitch (m), columns
    rows: int  # of pixels
    each: int  # rays per pixel, an even number

    @property
    def columns(self) -> int:
        """Number of sums: one per number of reflections, and one for light outside the pixels."""
        return self.job.max_bounces + 2

    @property
    def smooth(self) -> bool:
        """Whether the wall has a lobe that is a smooth mirror."""
        lobes = self.job.around.world.wall
        return bool(((lobes[:, 2] == 0.0) & (lobes[:, 0] >= BECKMANN)).any())

    @property
    def mirrors(self) -> int:
        """Largest number of consecutive mirror reflections of an eye path."""
        sees_itself = self.job.around.plan.wall_to_wall
        return self.job.max_bounces - 1 if self.smooth and sees_itself else 0


def flux_of(
    task: Task, first: int, end: int
) -> tuple[Array, NDArray[np.int64], Array, Counter[str]]:
    """Trace the rays from ``first`` up to ``end`` for the flux through the lens.

    Return the sums (units, groups, columns) of powers, W times rays; the cells (group and pixel as
    one number) and powers of the contributions to the mirror image; and numbers of intersection
    tests.
    """
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
            block.book(depth + 1, block.seen_at)
    by_mirrors = np.ones(block.n, dtype=bool)
    for bounce in range(1, most + 1):
        image = task.mirror_image or bounce > 1
        counted = (world.wall if image else task.matt, task.matt if bounce == 1 else world.wall)
        outputs = (*block.ends, *block.at, block.imaged)
        kernels.to_lens(world, sampler, first, counted, plan.glossy, light, *outputs)
        block.clear(light)
        block.book(bounce)
        block.keep()
        for depth, eye in enumerate(eyes, start=1):
            if bounce + depth + 1 <= most:
                block.connect(light, eye)
                block.book(bounce + depth + 1, block.seen_at)
        if not (plan.glossy or plan.wall_to_wall):
            break
        onward = block.rays.onward(light, bounce)
        walk = (light, block.rays.leave, onward, block.rays.fates, by_mirrors)
        seen = (block.value, *block.at, block.imaged)
        kernels.lens_hits(world, counted, plan.glossy, bounce == 1, *walk, *seen)
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
    """Return mean powers of the pixels ``first`` up to ``end``, their variances, and test counts.

    Powers are in W. The rays of a pixel form antithetic pairs; the variance is that of the pairs.
    """
    at_once = max(1, BLOCK // task.each)
    means, variances, counts = [], [], Counter[str]()
    for start in range(first, end, at_once):
        count = min(at_once, end - start)
        estimates, asked = _seen_by_pixels(task, start * task.each, count * task.each)
        estimates = estimates.reshape(count, task.each // 2, 2).mean(axis=2)
        mean = estimates.mean(axis=1)
        means.append(mean)
        variances.append(((estimates - mean[:, None]) ** 2).sum(axis=1))
        counts += asked
    del counts["rays"]
    pairs = task.each // 2
    scale = pairs * (pairs - 3)  # with Student's factor, as in `mean_of`
    return np.concatenate(means), np.concatenate(variances) / scale, counts


def _seen_by_pixels(task: Task, first: int, n: int) -> tuple[Array, Counter[str]]:
    """Return an estimate of the pixel's power from each ray, (n,), W, and the test counts."""
    block, world = _Block(task, first, n), task.job.around.world
    most = task.job.max_bounces
    eyes = [block.look_at_pixels()]
    estimates = block.from_source(eyes[0], task.matt).copy()
    if most == 1 or not task.job.around.plan.wall_to_wall:
        return estimates, block.rays.counts
    eyes += block.mirrored(eyes[0])
    for depth, eye in enumerate(eyes):
        if 1 <= depth < most:
            estimates += block.from_source(eye, world.wall)
    light = block.start()
    for bounce in range(1, most):
        for depth, eye in enumerate(eyes):
            if bounce + depth + 1 <= most:
                estimates += block.connect(light, eye)
        light = block.rays.onward(light, bounce)
    return estimates, block.rays.counts


class _Block:
    """Block of rays of one object point, with the arrays that the kernels fill."""

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
        """Add the image that smooth mirrors form by one reflection."""
        rays, powers, world = self.rays, np.empty(self.n), self.task.job.around.world
        # a curved wall may form further images outside the box, so that only a share is aimed
        light = self._shine(self.task.image_box, 0.5 if self.task.image_box.all() else 0.0)
        kernels.mirrored(world, light, rays.origins, rays.directions, powers, rays.live)
        hits = rays._hits(light)
        outputs = (self.value, *self.at, self.imaged)
        kernels.image_hits(world, rays.directions, rays.origins, powers, hits, *outputs)
        self.book(1)
        self.keep()

    def start(self) -> Array:
        """Return the first vertices, (n, VERTEX), of the object point's light."""
        return self._shine(self.task.gloss_box, 0.5 if self.task.gloss_box.all() else 0.0)

    def _shine(self, box: Array, share: float) -> Array:
        """Return first vertices on the wall; a ``share`` of the rays is aimed at ``box``."""
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
        """Return vertices seen from the lens in random directions of its front hemisphere."""
        rays, powers = self.rays, np.empty(self.n)
        world = self.task.job.around.world
        where = (rays.origins, rays.directions)
        kernels.look_around(world, self.task.job.sampler, self.first, *where, powers)
        kernels.landings(world, *where, *self.seen_at)
        return self._seen(powers)

    def look_at_pixels(self) -> Array:
        """Return the vertices that the pixels see, with `Task.each` rays per pixel."""
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
        """Yield vertices seen from the lens after one mirror reflection, after two, and so on."""
        rays, powers, world = self.rays, np.empty(self.n), self.task.job.around.world
        for _ in range(self.task.mirrors):
            kernels.mirrored(world, eye, rays.origins, rays.directions, powers, rays.live)
            eye = self._seen(powers, eye)
            yield eye

    def _seen(self, powers: Array, left: Array | None = None) -> Array:
        """Return the vertices that eye rays hit."""
        rays, new = self.rays, np.zeros((self.n, light_kernels.VERTEX))
        np.greater(powers, 0.0, out=rays.live)
        hits = rays._hits(left)
        light_kernels.look(rays.origins, rays.directions, powers, np.ones(self.n), hits, new)
        rays._settle(new)
        return new

    def from_source(self, eye: Array, lobes: Array) -> Array:
        """Return the power that the point sends to the detector via the vertices ``eye``, W."""
        kernels.from_source(self.task.source, lobes, eye, *self.ends)
        self.clear(None)
        return self.value

    def connect(self, light: Array, eye: Array) -> Array:
        """Return the power that light vertices send to the detector via the vertices ``eye``, W."""
        world, length = self.task.job.around.world, self.rays.length
        value, *ends = self.ends
        connecting.connect(world, light, eye, eye, False, False, value, length, *ends)
        self.clear(light)
        return self.value

    def clear(self, starts: Array | None) -> None:
        """Set the powers of blocked connections to zero.

        ``starts`` are the vertices from which the connections start, or None for the object point.
        """
        on_wall = np.zeros(self.n, dtype=bool)
        if starts is not None:
            np.equal(starts[:, light_kernels.SURFACE], surround.WALL, out=on_wall)
        rays = self.rays
        self.task.job.around.clear(rays.starts, rays.ends, on_wall, self.value, rays.counts)

    def book(self, bounce: int, at: tuple[Array, Array] | None = None) -> None:
        """Add the attribute ``value`` to the sums of light after ``bounce`` reflections.

        ``at`` is the pair (x, y) of detector positions, m, by default the attribute.
        """
        task, (x, y) = self.task, self.at if at is None else at
        where = (task.window, task.rows, bounce, task.job.max_bounces, self.first)
        kernels.book(self.value, x, y, *where, self.sums, self.cells)

    def keep(self) -> None:
        """Store group, pixel and power of the light that mirror-like lobes image."""
        rows = np.flatnonzero((self.cells >= 0) & (self.imaged > 0.0))
        if len(rows):
            pixels = self.task.rows * self.task.window[3]
            cells = (self.first + rows) % GROUPS * pixels + self.cells[rows]
            self.kept.append((cells, self.value[rows] * self.imaged[rows]))
