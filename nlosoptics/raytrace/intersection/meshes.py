"""Hits of rays on triangle meshes, the first or all, and what meshes hide from each other."""

from __future__ import annotations

import itertools
import os
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range
from ..._nouns import Noun
from ...errors import SceneError
from .intersections import Hits, _rays, flat_rays
from .triangles import Facets, NoRayError

if TYPE_CHECKING:
    import trimesh

T = TypeVar("T")
Array = NDArray[np.float64]
CHUNK: Final = 1 << 17  # rays at a time, so that theirs stay in cache
OFFSET: Final = 1e-9  # of half the mesh's extent: end of a path that counts as on the mesh


@dataclass(frozen=True, eq=False)
class MeshHits(Hits):
    """Where rays meet a mesh; as `Hits`, with normals against the rays.

    Parameters
    ----------
    distance, points, normals, status
        As in `Hits`; the status is 0, hit, or 1, miss.
    triangle : ndarray of int32, (...)
        Index into ``mesh.faces``, -1 where there is no hit.
    """

    triangle: NDArray[np.int32]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.triangle.flags.writeable = False


def intersect_mesh(
    mesh: trimesh.Trimesh,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    min_distance: float = 0.0,
) -> MeshHits:
    """First triangle that every ray meets, from either side.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        World, m. What is built for it is kept until it changes or goes.
    origins, directions : array_like, (..., 3)
        World, m; directions of any length but zero. The shapes broadcast.
    min_distance : float
        Hits nearer than this are passed over, m: for rays that leave the mesh.

    Returns
    -------
    MeshHits
        On the exact plane of a triangle to rounding. Edges and vertices belong to their triangles.

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, a direction is zero, or the mesh has no area.

    Notes
    -----
    Sheets that do not touch and are closer than 1e-6 of the mesh's extent, the outlines of parts in
    front of others, and corners of an outline sharper than 120 degrees are resolved to that only,
    in meshes of more than 256 triangles. A ray that starts on the mesh meets it there, at 0; at
    less than 10 degrees to a triangle it may pass it by.
    """
    nearest = in_range("min_distance", min_distance, 0.0, unit="m")
    o, d, shape = flat_rays(origins, directions)
    facets = _facets(mesh)
    count = len(o)
    distance, points, normals = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    triangle, status = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int8)

    def work(part: slice) -> None:
        from . import _triangle_kernels

        rows = facets.first(o[part], d[part], nearest)
        _triangle_kernels.finish(
            rows, distance[part], points[part], normals[part], triangle[part], status[part]
        )

    _in_parts(work, count, origins, directions)
    return MeshHits(
        distance.reshape(shape),
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        status.reshape(shape),
        triangle.reshape(shape),
    )


@dataclass(frozen=True, eq=False)
class AllHits(Noun):
    """Every hit of rays on a mesh; read-only arrays, sorted by ray, then by distance.

    Parameters
    ----------
    ray : ndarray of int64, (h,)
        Index of the ray, of all rays in C order.
    distance : ndarray, (h,)
        From the origin along the unit direction, m.
    points : ndarray, (h, 3)
        World, m.
    triangle : ndarray of int32, (h,)
        Index into ``mesh.faces``.
    """

    ray: NDArray[np.int64]
    distance: Array
    points: Array
    triangle: NDArray[np.int32]

    def __post_init__(self) -> None:
        for array in (self.ray, self.distance, self.points, self.triangle):
            array.flags.writeable = False


def all_hits(
    mesh: trimesh.Trimesh,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    min_distance: float = 0.0,
) -> AllHits:
    """Every triangle that every ray meets, from either side.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        World, m. What is built for it is kept until it changes or goes.
    origins, directions : array_like, (..., 3)
        World, m; directions of any length but zero. The shapes broadcast.
    min_distance : float
        Hits nearer than this are passed over, m.

    Returns
    -------
    AllHits

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, a direction is zero, or the mesh has no area.

    Notes
    -----
    Triangles that a ray meets from the same side and at the same distance, to rounding, count once:
    so does a ray through an edge or a vertex that triangles share, and through sheets that
    coincide. Where it only touches an outline it enters and leaves there, which counts twice. So
    rays from outside a closed mesh meet it an even number of times. A triangle in whose plane a
    ray lies is not met.
    """
    nearest = in_range("min_distance", min_distance, 0.0, unit="m")
    o, d, _ = flat_rays(origins, directions)
    facets = _facets(mesh)

    def work(part: slice) -> tuple[NDArray[Any], ...]:
        return facets.all(o[part], d[part], nearest)

    # handles zero rays: np.concatenate needs at least one part
    parts = _in_parts(work, len(o), origins, directions) or [work(slice(0, 0))]
    counts, distance, points, triangle = (np.concatenate(a) for a in zip(*parts, strict=True))
    return AllHits(np.repeat(np.arange(len(o)), counts), distance, points, triangle)


def occluded(mesh: trimesh.Trimesh, origins: ArrayLike, targets: ArrayLike) -> NDArray[np.bool_]:
    """Whether the mesh stands between each origin and its target.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        World, m.
    origins, targets : array_like, (..., 3)
        World, m; the shapes broadcast. What the mesh has within 1e-9 of its extent of either end,
        or within the rounding of their coordinates, is not in between, so that both may lie on it.

    Returns
    -------
    ndarray of bool, (...)

    Raises
    ------
    SceneError
        If a point holds NaN or infinity, or a target equals its origin.
    """
    o, p = (np.asarray(v, dtype=np.float64) for v in (origins, targets))
    try:
        paths = p - o
    except ValueError:
        raise SceneError(
            f"origins {o.shape} and targets {p.shape} do not broadcast; give equal shapes"
        ) from None
    start, path, shape = flat_rays(np.broadcast_to(o, paths.shape), paths)
    facets = _facets(mesh)
    gap = OFFSET * facets.reach + 1e-14 * float(np.abs(start).max(initial=0.0))
    lengths = np.sqrt((path * path).sum(axis=-1)) - gap
    hidden = np.empty(len(start), dtype=bool)

    def work(part: slice) -> None:
        rows = facets.first(start[part], path[part], gap, lengths[part])
        hidden[part] = rows.view(np.int64)[:, -1] >= 0

    _in_parts(work, len(start), o, paths)
    return hidden.reshape(shape)


def _in_parts(
    work: Callable[[slice], T], count: int, origins: ArrayLike, directions: ArrayLike
) -> list[T]:
    """What ``work`` makes of slices of rays, on the processor's cores."""
    pieces = -(-count // CHUNK)
    ends = [count * k // max(pieces, 1) for k in range(pieces + 1)]
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    try:
        return list(worker_pool().map(work, parts) if len(parts) > 1 else map(work, parts))
    except NoRayError:
        _rays(origins, directions)  # names the first one
        raise


_lock = threading.Lock()
_threads: list[ThreadPoolExecutor] = []
_built: dict[int, tuple[weakref.ref[Any], int, Facets]] = {}


def threads() -> int:
    """How many threads `worker_pool` has."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    asked = int(os.environ.get("NUMBA_NUM_THREADS", cores))
    return max(1, min(asked, cores))


def worker_pool() -> ThreadPoolExecutor:
    """Threads for blocks of rays, as many as cores; made at the first need."""
    with _lock:
        if not _threads:
            _threads.append(ThreadPoolExecutor(threads()))
        return _threads[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.clear)  # threads do not survive a fork


def _facets(mesh: trimesh.Trimesh) -> Facets:
    """What was built for the mesh, or is now."""
    key, state = id(mesh), hash(mesh)
    kept = _built.get(key)
    if kept is not None and kept[0]() is mesh and kept[1] == state:
        return kept[2]
    facets = Facets(mesh)
    _built[key] = (weakref.ref(mesh, lambda _: _built.pop(key, None)), state, facets)
    return facets
