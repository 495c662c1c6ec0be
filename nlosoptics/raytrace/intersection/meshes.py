"""Intersections of rays with triangle meshes: first hits, all hits, and occlusion."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, numbers
from ..._nouns import Noun
from ...errors import SceneError
from .intersections import Hits, _rays, flat_rays
from .prepared_meshes import prepared_mesh
from .triangles import NO_LIMIT, Facets, Found, NoRayError

if TYPE_CHECKING:
    import trimesh

T = TypeVar("T")
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeshHits(Hits):
    """First intersections of rays with a triangle mesh, as `intersect_mesh` returns them.

    The other fields are those of `Hits`; its ``normals`` are on the side from which the ray comes,
    and its ``status`` is ``Hits.HIT`` or ``Hits.MISS``.

    Parameters
    ----------
    triangle : ndarray of int32, shape (...)
        Row of ``mesh.faces`` that holds the triangle; -1 without a hit.

    See Also
    --------
    intersect_mesh : First hits of rays on a mesh.
    Hits : Hits on a wall.
    """

    triangle: NDArray[np.int32]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.triangle.flags.writeable = False


def intersect_mesh(
    mesh: trimesh.Trimesh, origins: ArrayLike, directions: ArrayLike, *, min_distance: float = 0.0
) -> MeshHits:
    """Find the first triangle that every ray hits, from either side.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Triangle mesh, world frame, m. The search structures of the latest meshes are cached.
    origins : array_like, (..., 3)
        Starting points of the rays, world frame, m.
    directions : array_like, (..., 3)
        Direction vectors in the world frame, of any length but zero. The shapes of ``origins`` and
        ``directions`` broadcast.
    min_distance : float
        Hits closer to the origin of the ray than this are ignored, m; useful for rays that start on
        the mesh. The default 0 keeps all.

    Returns
    -------
    MeshHits
        First hits. They lie in the planes of the triangles to float64 rounding. A ray through an
        edge or a vertex hits one of the adjacent triangles.

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, a direction is zero, or the mesh has no area.

    See Also
    --------
    all_hits : All intersections of every ray.
    occluded : Whether a mesh blocks the line between two points.

    Notes
    -----
    Large meshes, of more than 256 triangles, are first searched in single precision by the library
    Embree, where it is installed (there is no wheel for Linux on ARM processors). A ray may then
    be assigned a wrong triangle, or none, in two cases: where two sheets of the mesh are closer to
    each other than 1e-6 of its extent, and where the ray passes within this distance of a sharp
    corner or of the mesh's silhouette as seen along the ray. Smaller meshes are searched
    in float64 and have no such cases. Separate parts smaller than 1e-3 of the mesh's extent, such
    as a bead above a floor, are searched at their own scale.

    A ray that starts on a triangle may miss this triangle, or hit it at a distance of the order of
    rounding errors. Give ``min_distance`` to ignore such hits. Hits on all other triangles are
    found.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics import raytrace
    >>> box = trimesh.creation.box((1.0, 1.0, 1.0))
    >>> hits = raytrace.intersect_mesh(box, (0.1, 0.2, 2.0), [(0, 0, -1), (0, 1, 0)])
    >>> hits.hit.tolist(), round(float(hits.distance[0]), 6)
    ([True, False], 1.5)
    """
    nearest = in_range("min_distance", min_distance, 0.0, unit="m")
    distance, points, normals, triangle = _first(
        prepared_mesh(mesh).facets, origins, directions, nearest
    )
    status = np.where(triangle < 0, Hits.MISS, Hits.HIT).astype(np.int8)
    return MeshHits(distance, points, normals, status, triangle)


def first_triangles(
    facets: Facets, origins: Array, directions: Array, *, min_distance: float
) -> tuple[Array, NDArray[np.int32]]:
    """Return distance (n,), m, and triangle (n,) of the first hits, as for `intersect_mesh`."""
    distance, _, _, triangle = _first(facets, origins, directions, min_distance, placed=False)
    return distance, triangle


def _first(
    facets: Facets,
    origins: ArrayLike,
    directions: ArrayLike,
    nearest: float,
    farthest: Array = NO_LIMIT,
    *,
    placed: bool = True,
) -> Found:
    """Return the first hits of `Facets.first` in the shape of the rays; points only if placed."""
    o, d, shape = flat_rays(origins, directions)
    count = len(o)
    rows = count if placed else 0
    distance, triangle = np.empty(count), np.empty(count, dtype=np.int32)
    points, normals = np.empty((rows, 3)), np.empty((rows, 3))

    def work(part: slice) -> None:
        hits = (distance[part], points[part], normals[part], triangle[part])
        facets.first(o[part], d[part], nearest, farthest[part], hits=hits)

    _in_parts(work, count, origins, directions)
    if placed:
        points, normals = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    return distance.reshape(shape), points, normals, triangle.reshape(shape)


@dataclass(frozen=True, eq=False)
class AllHits(Noun):
    """All intersections of rays with a triangle mesh, as `all_hits` returns them.

    The arrays are read-only and list h hits, sorted by ray and then by distance.

    Parameters
    ----------
    ray : ndarray of int64, (h,)
        Index of the ray that each hit belongs to, in the flattened (C order) array of rays.
    distance : ndarray, (h,)
        Distance from the origin of the ray to the hit, m.
    points : ndarray, (h, 3)
        Hit points, world frame, m.
    triangle : ndarray of int32, (h,)
        Row of ``mesh.faces`` that holds the triangle.

    See Also
    --------
    all_hits : All hits of rays on a mesh.
    """

    ray: NDArray[np.int64]
    distance: Array
    points: Array
    triangle: NDArray[np.int32]

    def __post_init__(self) -> None:
        for array in (self.ray, self.distance, self.points, self.triangle):
            array.flags.writeable = False


def all_hits(
    mesh: trimesh.Trimesh, origins: ArrayLike, directions: ArrayLike, *, min_distance: float = 0.0
) -> AllHits:
    """Find all intersections of every ray with a mesh, from either side.

    Parameters
    ----------
    mesh, origins, directions, min_distance
        Triangle mesh and rays, as for `intersect_mesh`.

    Returns
    -------
    AllHits
        Hits of all rays, sorted by ray and then by distance.

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, a direction is zero, or the mesh has no area.

    See Also
    --------
    intersect_mesh : First hits of rays on a mesh.
    occluded : Whether a mesh blocks lines of sight.

    Notes
    -----
    Hits at the same distance, to rounding, from the same side (front or back of the triangles)
    count once. This applies to a ray through a shared edge or vertex and to coincident sheets. A
    ray may graze an edge at which one adjacent triangle faces the ray and the other faces away. It
    enters and leaves the mesh there, which counts as two hits. A ray from outside a closed mesh
    therefore has an even number of hits. A triangle whose plane contains the ray is not hit.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics import raytrace
    >>> box = trimesh.creation.box((1.0, 1.0, 1.0))
    >>> hits = raytrace.all_hits(box, (0.1, 0.2, 2.0), [(0, 0, -1), (0, 1, 0)])
    >>> hits.ray.tolist(), hits.distance.round(6).tolist()
    ([0, 0], [1.5, 2.5])
    """
    nearest = in_range("min_distance", min_distance, 0.0, unit="m")
    o, d, _ = flat_rays(origins, directions)
    facets = prepared_mesh(mesh).facets

    def work(part: slice) -> tuple[NDArray[Any], ...]:
        return facets.all(o[part], d[part], nearest)

    # handles zero rays: np.concatenate needs at least one part
    parts = _in_parts(work, len(o), origins, directions) or [work(slice(0, 0))]
    counts, distance, points, triangle = (np.concatenate(a) for a in zip(*parts, strict=True))
    return AllHits(np.repeat(np.arange(len(o)), counts), distance, points, triangle)


def occluded(mesh: trimesh.Trimesh, origins: ArrayLike, targets: ArrayLike) -> NDArray[np.bool_]:
    """Return whether a mesh blocks the straight line between each origin and its target.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Triangle mesh, world frame, m.
    origins, targets : array_like, (..., 3)
        First and second ends of the lines, world frame, m; their shapes broadcast. Ends may lie on
        the mesh, because intersections very close to an end are ignored. The limit is 1e-9 of half
        the mesh's extent, plus the rounding error of the coordinates.

    Returns
    -------
    ndarray of bool, (...)
        True where the mesh blocks the line.

    Raises
    ------
    SceneError
        If a point holds NaN or infinity, or a target equals its origin.

    See Also
    --------
    intersect_mesh : First hits of rays on a mesh.
    nlosoptics.imaging.cast_shadows : Fractions of light that occluders let through.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics import raytrace
    >>> box = trimesh.creation.box((1.0, 1.0, 1.0))
    >>> raytrace.occluded(box, (0.0, 0.0, 2.0), [(0.0, 0.0, -2.0), (0.0, 2.0, 2.0)]).tolist()
    [True, False]
    """
    o, p = numbers("origins", origins), numbers("targets", targets)
    try:
        paths = p - o
    except ValueError:
        raise SceneError(
            f"origins {o.shape} and targets {p.shape} do not broadcast; give equal shapes"
        ) from None
    return blocked(prepared_mesh(mesh).facets, np.broadcast_to(o, paths.shape), paths)


def blocked(facets: Facets, origins: Array, paths: Array) -> NDArray[np.bool_]:
    """Return whether a mesh blocks paths (..., 3) from origins (..., 3), m; see `occluded`."""
    # hits nearer than this to an end count as on it
    gap = 1e-9 * facets.reach + 1e-14 * float(np.abs(origins).max(initial=0.0))
    lengths = np.sqrt((paths * paths).sum(axis=-1)) - gap
    triangle = _first(facets, origins, paths, gap, lengths.reshape(-1), placed=False)[3]
    return np.asarray(triangle.reshape(lengths.shape) >= 0)


def _in_parts(
    work: Callable[[slice], T], count: int, origins: ArrayLike, directions: ArrayLike
) -> list[T]:
    """Return the results of ``work`` for consecutive slices of the rays, computed on all cores."""
    # more rays at once are better sorted; fewer are not worth another thread
    pieces = max(-(-count // (1 << 17)), min(threads(), -(-count // (1 << 13))))
    ends = [count * k // max(pieces, 1) for k in range(pieces + 1)]
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    try:
        alone = len(parts) == 1 or threads() == 1
        return list(map(work, parts) if alone else worker_pool().map(work, parts))
    except NoRayError:
        _rays(origins, directions)  # raises an error that names the first bad ray
        raise


_lock = threading.Lock()
_threads: list[ThreadPoolExecutor] = []


def threads() -> int:
    """Return the number of threads of `worker_pool`: the cores, or fewer by NUMBA_NUM_THREADS."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    asked = int(os.environ.get("NUMBA_NUM_THREADS", cores))
    return max(1, min(asked, cores))


def worker_pool() -> ThreadPoolExecutor:
    """Return the thread pool for blocks of rays, created at the first call."""
    with _lock:
        if not _threads:
            _threads.append(ThreadPoolExecutor(threads()))
        return _threads[0]


if hasattr(os, "register_at_fork"):
    # a forked child has none of the parent's threads and must create its own pool
    os.register_at_fork(after_in_child=_threads.clear)
