"""Batches of random paths between points of the relay wall, over several hidden surfaces."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..._random import scrambled_sobol
from ...raytrace.intersection.meshes import worker_pool
from . import _bounce_kernels as kernels
from .surfaces import BounceSurfaces

Array = NDArray[np.float64]
STREAM: Final = 1 << 33  # stream of the random generator; batch i uses stream STREAM + i
ROWS: Final = 1 << 20  # largest number of vertices times wall points at a time
SLICE: Final = 1 << 11  # least number of rows per task on several threads


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """Data shared by all batches; paths are traced backwards, from ``sensors`` to ``lasers``."""

    around: BounceSurfaces  # Surfaces that paths can meet
    lasers: Array  # (n, 3): points at which paths end and start, m
    sensors: Array
    rows: NDArray[np.int64]  # (pairs, 2): indices (laser, sensor), sorted by laser
    orders: tuple[int, ...]  # Numbers of reflections, increasing
    starts: Array  # (pairs,): start of bin 0, m of optical path
    rate: float  # Bins per m
    n_bins: int  # Number of bins, and seed of the random numbers
    seed: int
    # Number of first vertices in a batch, and mean number of paths that continue from each
    n_seen: int
    n_each: int
    # (float, float): Fractions of first and of further vertices that are sampled over the surfaces'
    # area
    aimed: tuple[float, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class Paths:
    """Paths of a batch, before their connection to lasers."""

    seen: Array  # (vertices, VERTEX): first vertices
    # (vertices + 1,): paths ``spread[j]`` to ``spread[j + 1] - 1`` leave vertex j
    spread: NDArray[np.int64]
    first: Array  # (paths, 3): unit vectors in which paths leave their first vertex
    # (ndarray, ndarray): (sensors, vertices) each: factors cos cos/r^2 between sensors and first
    # vertices, 1/m^2, and their distances, m
    table: tuple[Array, Array]
    ends: list[Array]  # (paths, VERTEX) for each order: last vertices


def add_batch(job: Job, number: int, total: Array, squares: Array) -> int:
    """Add a batch's bins and their squares to arrays (orders, pairs, n_bins); return its paths."""
    sampler = _sampler(job, number)
    paths = _walked(job, sampler, *_seen(job, sampler))
    if not len(paths.first):  # no first vertex sends light to a sensor
        return 0
    # process as many lasers at a time as the memory for their connections allows
    step = max(1, 4 * ROWS // (len(paths.first) * len(job.orders)))
    for start in range(0, len(job.lasers), step):
        found = _joined(job, paths.ends, job.lasers[start : start + step])
        first, last = np.searchsorted(job.rows[:, 0], [start, start + step])
        if last > first:
            _gather(job, paths, found, start, slice(int(first), int(last)), total, squares)
    return len(paths.first)


def _sampler(job: Job, number: int) -> tuple[Any, ...]:
    """Return the Sobol sampler of a batch, with its own scrambling."""
    columns, shifts = scrambled_sobol(job.seed, STREAM + number, 1)
    return np.uint64(job.seed), np.ascontiguousarray(columns), np.ascontiguousarray(shifts)


def openness(job: Job) -> tuple[float, float]:
    """Return the fractions of rays that leave the scene, from sensors and from first vertices."""
    sampler = _sampler(job, -1)
    seen = _points(job, sampler)
    hit = seen[:, kernels.TRIANGLE] >= 0.0
    leaving = np.empty((len(seen), kernels.LEAVE))
    views = np.zeros((len(seen), kernels.VIEWS, 3))
    views[..., :] = seen[:, None, kernels.N]
    new = _leg(job, sampler, kernels.DRAWS_SEEN, views, seen, leaving)[0]
    again = new[:, kernels.TRIANGLE] >= 0.0
    n_hit = int(hit.sum())
    between = 1.0 - float(again.sum()) / n_hit if n_hit else 1.0
    return 1.0 - n_hit / len(seen), between


def _seen(job: Job, sampler: Any) -> tuple[Array, tuple[Array, Array]]:
    """Return first vertices, and their factors and distances to all sensors."""
    seen = _points(job, sampler)
    shape = (len(job.sensors), len(seen))
    factor, distance = np.empty(shape), np.empty(shape)

    def work(part: slice) -> None:
        kernels.seen_from(job.around.kernel, job.sensors[part], seen, factor[part], distance[part])

    on_threads(work, len(job.sensors), len(seen))
    # density of vertices per area: rays from all sensors, plus samples over the area
    density = (1.0 - job.aimed[0]) / np.pi * factor.mean(axis=0)
    both = job.around.kernel.sides[seen[:, kernels.TRIANGLE].astype(np.int64)] == 0
    density += job.aimed[0] / job.around.kernel.area * np.where(both, 0.5, 1.0)
    unseen = ~(factor > 0.0).any(axis=0)
    seen[unseen, kernels.TRIANGLE] = -1.0
    density[unseen] = np.inf
    seen[:, kernels.WEIGHT] = 1.0 / (len(seen) * density)
    return seen, (factor, distance)


def _spread(job: Job, seen: Array, factor: Array) -> NDArray[np.int64]:
    """Return the ranges (vertices + 1,) of paths that leave each first vertex.

    The few vertices near a sensor contribute most to it. The number of paths from a vertex
    therefore grows with the root mean square of its weight at all sensors.
    """
    weight = seen[:, kernels.WEIGHT] * np.sqrt(np.einsum("cj,cj->j", factor, factor))
    if not weight.any():
        return np.zeros(len(seen) + 1, dtype=np.int64)
    # one path each, and the remaining ones by weight
    rest = len(seen) * (job.n_each - 1) * (weight / weight.sum())
    counts = np.where(weight > 0.0, 1 + rest.astype(np.int64), 0)
    return np.append(0, np.cumsum(counts))


def _points(job: Job, sampler: Any) -> Array:
    """Sample first vertices, by rays from sensors or over the surfaces' area."""
    n, kernel = job.n_seen, job.around.kernel
    origins, directions = np.empty((n, 3)), np.empty((n, 3))
    triangle = np.empty(n, dtype=np.int64)
    kernels.look(kernel, sampler, job.aimed[0], job.sensors, 0, origins, directions, triangle)
    rays = np.flatnonzero(triangle < 0)
    distance, met = job.around.first_hits(origins[rays], directions[rays])
    met = np.where(met < kernel.shares.size - 1, met, -1)  # only hidden triangles, not the wall
    hit = met >= 0
    triangle[rays] = met
    origins[rays[hit]] += distance[hit, None] * directions[rays[hit]]
    seen = np.zeros((n, kernels.VERTEX))
    seen[:, kernels.P], seen[:, kernels.N] = origins, directions
    normals = kernel.normals[met]
    against = (directions[rays] * normals).sum(axis=1, keepdims=True) > 0.0
    seen[rays, kernels.N] = np.where(against, -normals, normals)
    seen[:, kernels.TRIANGLE] = triangle
    seen[:, kernels.WEIGHT] = 1.0
    return seen


def _walked(job: Job, sampler: Any, seen: Array, table: tuple[Array, Array]) -> Paths:
    """Continue paths from the first vertices, and collect their vertices of each order."""
    spread = _spread(job, seen, table[0])
    counts = np.diff(spread)
    vertices = np.repeat(seen, counts, axis=0)
    vertices[:, kernels.WEIGHT] /= np.repeat(counts, counts)
    leaving = np.empty((len(vertices), kernels.LEAVE))
    views = np.zeros((len(seen), kernels.VIEWS, 3))
    kernels.view(sampler, job.sensors, table[0], seen, views)
    views = np.repeat(views, counts, axis=0)
    ends, first = [], np.empty((0, 3))
    for order in range(4, job.orders[-1] + 1):
        number = kernels.DRAWS_SEEN + kernels.DRAWS_A_LEG * (order - 4)
        vertices, directions = _leg(job, sampler, number, views, vertices, leaving)
        views = views[:0]
        if order == 4:
            first = directions
        if order in job.orders:
            ends.append(vertices)
    return Paths(seen=seen, spread=spread, first=first, table=table, ends=ends)


def _leg(
    job: Job, sampler: Any, number: int, views: Array, vertices: Array, leaving: Array
) -> tuple[Array, Array]:
    """Extend paths by one leg; return the new vertices and the directions (paths, 3) to them."""
    kernel, aimed = job.around.kernel, job.aimed[1]
    origins, directions = np.zeros((len(vertices), 3)), np.zeros((len(vertices), 3))

    def send(part: slice) -> None:
        draws, rays = (sampler, part.start, number), (origins[part], directions[part])
        kernels.leave(kernel, draws, aimed, views[part], vertices[part], leaving[part], rays)

    on_threads(send, len(vertices), 1)
    live = leaving[:, kernels.SENT] > 0.0
    distance = np.zeros(len(vertices))
    triangle = np.full(len(vertices), -1, dtype=np.int32)
    distance[live], triangle[live] = job.around.first_hits(origins[live], directions[live])
    new = np.zeros_like(vertices)

    def land(part: slice) -> None:
        hits = (directions[part], distance[part], triangle[part])
        kernels.arrive(kernel, aimed, vertices[part], leaving[part], hits, new[part])

    on_threads(land, len(vertices), 1)
    return new, directions


def _joined(job: Job, ends: list[Array], lasers: Array) -> tuple[Array, Array]:
    """Connect paths to lasers; return weights and lengths (lasers, orders, paths)."""
    n = len(ends[0])
    value, length = np.empty((2, len(lasers), len(ends), n))
    for order in range(len(ends)):
        for at, laser in enumerate(lasers):

            def work(part: slice, at: int = at, order: int = order, laser: Array = laser) -> None:
                kernels.connect(
                    job.around.kernel,
                    laser,
                    ends[order][part],
                    value[at, order, part],
                    length[at, order, part],
                )

            on_threads(work, n, 1)
    return value, length


def _gather(
    job: Job,
    paths: Paths,
    found: tuple[Array, Array],
    start: int,
    span: slice,
    total: Array,
    squares: Array,
) -> None:
    """Add the paths of the pairs ``span`` to the bins; ``found`` begins at laser ``start``."""
    # of one layout, so that numba compiles the kernel once
    rows = np.ascontiguousarray(job.rows[span] - np.array([start, 0]))
    starts = job.starts[span]
    into, again = total[:, span], squares[:, span]
    walked = (paths.seen, paths.spread, paths.first)
    table = (*paths.table, job.sensors)

    def work(part: slice) -> None:
        pairs, sums = (rows[part], starts[part], job.rate), (into[:, part], again[:, part])
        kernels.gather_pairs(job.around.kernel, walked, pairs, table, found, *sums)

    on_threads(work, len(rows), len(paths.first))


def on_threads(work: Callable[[slice], None], count: int, weight: int) -> None:
    """Call ``work`` for slices of ``count`` rows, on several threads if there is enough work."""
    pieces = max(1, min(count, count * weight // SLICE, 16))
    ends = [count * k // pieces for k in range(pieces + 1)]
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    if len(parts) == 1:
        work(parts[0])
        return
    list(worker_pool().map(work, parts))
