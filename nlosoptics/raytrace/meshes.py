"""First hit of rays on triangle meshes, and what meshes hide from each other.

Embree, which computes in float32, says which triangle; float64 says where. Where Embree's answer
is within its own rounding of an edge, or it sees nothing near an edge, a float64 search decides.
"""

from __future__ import annotations

import math
import os
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import in_range
from ..errors import SceneError
from .intersections import Hits, _rays, flat_rays

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
CHUNK: Final = 1 << 17  # rays at a time, so that theirs stay in cache
ASIDE: Final = 1e-6  # of half the mesh's extent: sixteen roundings of float32
MARGIN: Final = 3e-6  # of the same: ASIDE, and Embree's rounding
FEW: Final = 256  # triangles, among which a float64 search costs less than to ask Embree around
OFFSET: Final = 1e-9  # of the same: end of a path that counts as on the mesh


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
    in meshes of more than 256 triangles.
    """
    nearest = in_range("min_distance", min_distance, 0.0, unit="m")
    o, d, shape = flat_rays(origins, directions)
    facets = _facets(mesh)
    count = len(o)
    distance, points, normals = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    triangle, status = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int8)

    def work(part: slice) -> None:
        from . import _kernels

        units, found, t = facets.first(o[part], d[part], nearest, None)
        _kernels.finish(
            facets.rows,
            o[part],
            units,
            facets.names,
            found,
            t,
            points[part],
            normals[part],
            triangle[part],
            status[part],
        )
        distance[part] = t

    _in_parts(work, count, origins, directions)
    return MeshHits(
        distance.reshape(shape),
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        status.reshape(shape),
        triangle.reshape(shape),
    )


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
        hidden[part] = facets.first(start[part], path[part], gap, lengths[part])[1] >= 0

    _in_parts(work, len(start), o, paths)
    return hidden.reshape(shape)


def _in_parts(
    work: Callable[[slice], None], count: int, origins: ArrayLike, directions: ArrayLike
) -> None:
    """Do ``work`` on slices of rays, on the processor's cores."""
    parts = [slice(a, min(a + CHUNK, count)) for a in range(0, count, CHUNK)]
    try:
        if len(parts) == 1:
            work(parts[0])
        elif parts:
            list(_pool().map(work, parts))
    except _BadRayError:
        _rays(origins, directions)  # names the first one
        raise


class _BadRayError(Exception):
    """A ray that is no ray; the shell finds and names it."""


_lock = threading.Lock()
_threads: list[ThreadPoolExecutor] = []
_built: dict[int, tuple[weakref.ref[Any], int, _Facets]] = {}


def _pool() -> ThreadPoolExecutor:
    with _lock:
        if not _threads:
            cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
            asked = int(os.environ.get("NUMBA_NUM_THREADS", cores))
            _threads.append(ThreadPoolExecutor(max(1, min(asked, cores))))
        return _threads[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.clear)  # threads do not survive a fork


def _facets(mesh: trimesh.Trimesh) -> _Facets:
    """What was built for the mesh, or is now."""
    key, state = id(mesh), hash(mesh)
    kept = _built.get(key)
    if kept is not None and kept[0]() is mesh and kept[1] == state:
        return kept[2]
    facets = _Facets(mesh)
    _built[key] = (weakref.ref(mesh, lambda _: _built.pop(key, None)), state, facets)
    return facets


class _Facets:
    """Triangles of a mesh: Embree's scene, float64 rows and a tree of boxes over them."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
        if not np.isfinite(corners).all():
            raise SceneError("the mesh has NaN or infinite vertices; mend it")
        a, first, second = corners[:, 0], corners[:, 1], corners[:, 2]
        across = np.cross(first - a, second - a)
        proper = np.flatnonzero((across != 0).any(axis=1))
        if not len(proper):
            raise SceneError("the mesh has no triangle with an area; give a surface mesh")
        corners = corners[proper]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.centre = 0.5 * (low + high)
        self.reach = 0.5 * float((high - low).max())
        order = _along_a_curve(corners.mean(axis=1), low, high)
        corners = corners[order]
        self.names = proper[order].astype(np.int32)
        sides = corners - corners[:, [1, 2, 0]]
        self.edges = np.sqrt((sides * sides).sum(axis=-1).max(axis=1))
        self.rows = np.ascontiguousarray(
            np.concatenate(
                [corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]],
                axis=1,
            )
        )
        rounding = 1e-15 * float(np.abs(corners).max())
        self.boxes = _tree(corners, rounding)
        pad = 4 * MARGIN * self.reach + rounding
        self.limits = np.stack([low - pad, high + pad])
        self.scene = self._scene(corners)

    def _scene(self, corners: Array) -> Any:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # the robust flag closes the gaps between triangles
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, ((corners - self.centre) / self.reach).astype(np.float32))
        # builds, which must not happen in two threads at once
        scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        return scene

    def first(
        self, origins: Array, directions: Array, nearest: float, farthest: Array | None
    ) -> tuple[Array, NDArray[np.int64], Array]:
        """Unit directions, rows of the first triangles (-1: none) and their distances."""
        from . import _kernels

        count = len(origins)
        units, distance = np.empty((count, 3)), np.empty(count)
        found = np.full(count, -1)
        if farthest is None:
            farthest = np.full(count, math.inf)
        starts, heads = np.empty((2, count, 3), dtype=np.float32)
        index = np.empty(count, dtype=np.int64)
        kept = _kernels.enter(
            origins,
            directions,
            self.limits,
            self.centre,
            self.reach,
            ASIDE * self.reach,
            units,
            starts,
            heads,
            index,
        )
        if kept < 0:
            raise _BadRayError
        if not kept:
            return units, found, distance
        starts, heads, index = _kernels.gather(starts[:kept], heads[:kept], index[:kept])
        ids = self.scene.run(starts, heads)
        missed = np.flatnonzero(ids < 0)
        missed_rays = index[missed]
        margin = MARGIN * self.reach
        doubtful = _kernels.place(
            self.rows,
            self.edges,
            origins,
            units,
            index,
            ids,
            margin,
            nearest,
            farthest,
            found,
            distance,
        )
        unsure = index[:doubtful][ids[:doubtful] >= 0]
        if len(missed):
            near = np.full(len(missed), len(self.rows) <= FEW)
            moved, along = np.empty((len(missed), 3), np.float32), heads[missed]
            for turn in (0.0, 2 * math.pi / 3, 4 * math.pi / 3) if not near[0] else ():
                _kernels.aside(starts[missed], along, len(missed), 3 * MARGIN, turn, moved)
                near |= self.scene.run(moved, along) >= 0
            unsure = np.concatenate([unsure, missed_rays[near]])
        _kernels.search(
            self.rows,
            self.edges,
            self.boxes,
            origins,
            units,
            unsure,
            nearest,
            farthest,
            found,
            distance,
        )
        return units, found, distance


def _along_a_curve(points: Array, low: Array, high: Array) -> NDArray[np.int64]:
    """Order of points along a Morton curve, by which neighbours in space are neighbours."""
    span = np.where(high > low, high - low, 1.0)
    cells = ((points - low) / span * (2**20 - 1)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        bits = cells[:, axis]
        # spreads twenty bits to every third place
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
        code |= bits << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _tree(corners: Array, rounding: float) -> Array:
    """Boxes of a complete binary tree with four triangles a leaf, root first."""
    leaves = 1 << max(0, math.ceil(math.log2(max(1, math.ceil(len(corners) / 4)))))
    # the last triangle's box fills up the leaves that hold none
    fill = ((0, 4 * leaves - len(corners)), (0, 0))
    low = np.pad(corners.min(axis=1) - rounding, fill, mode="edge")
    high = np.pad(corners.max(axis=1) + rounding, fill, mode="edge")
    levels = []
    width = 4
    while True:
        low = low.reshape(-1, width, 3).min(axis=1)
        high = high.reshape(-1, width, 3).max(axis=1)
        levels.append(np.concatenate([low, high], axis=1))
        if len(low) == 1:
            return np.ascontiguousarray(np.concatenate(levels[::-1]))
        width = 2
