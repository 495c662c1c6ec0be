"""Search structures of a triangle mesh: an Embree scene, float64 triangles and a tree of boxes.

Embree computes in float32 and finds the triangle; the hit point is computed in float64. If Embree's
hit is so close to an edge that its rounding matters, or if it finds no hit close to an edge, a
float64 search decides. Where Embree is not installed, the float64 search finds all hits, more
slowly.
"""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Found = tuple[Array, Array, Array, NDArray[np.int32]]
ASIDE: Final = 1e-6  # lateral displacement of rays, in half extents; 16 roundings of float32
MARGIN: Final = 3e-6  # largest lateral error of Embree, in half extents, including ASIDE
SMALL: Final = 1e-3  # parts below this share of the mesh's extent need a finer scale than Embree's
NO_LIMIT: Final = np.empty(0)


class NoRayError(Exception):
    """A ray has NaN, infinity or a zero direction; the caller raises an error that names it."""


class Facets:
    """Search structures of a mesh, or of ``some`` of its triangles.

    Embree's errors are relative to the extent of its scene. Parts that are far smaller than the
    mesh, such as a bead on a floor, are kept as ``parts``, each with its own structures. If
    ``exact``, or if Embree is not installed, all rays are searched in float64. `SceneError` if
    vertices are not finite or no triangle has an area.
    """

    def __init__(
        self, mesh: trimesh.Trimesh, some: NDArray[np.int64] | None = None, *, exact: bool = False
    ) -> None:
        faces = np.asarray(mesh.faces)
        some = np.arange(len(faces)) if some is None else some
        corners = np.asarray(mesh.vertices, dtype=np.float64)[faces[some]]
        if not np.isfinite(corners).all():
            raise SceneError("the mesh has NaN or infinite vertices; repair it")
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
        self.names = some[proper[order]].astype(np.int32)
        self.sorts = len(order) > 10_000  # sorting the rays then saves more than it costs
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
        self.limits = np.concatenate([low - pad, high + pad])[None]
        exact = exact or find_spec("embreex") is None
        self.exact = exact
        parts, many = ([], []) if exact else _small_parts(corners, self.edges)
        self.parts = [Facets(mesh, self.names[part].astype(np.int64)) for part in parts]
        self.parts += [Facets(mesh, self.names[part].astype(np.int64), exact=True) for part in many]
        self.scene: Any = None if exact or self.parts else self._scene(corners)

    def _scene(self, corners: Array) -> Any:
        """Return the Embree scene of the triangles ``corners`` (n, 3, 3)."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # the robust flag prevents rays from passing between adjacent triangles
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, ((corners - self.centre) / self.reach).astype(np.float32))
        # the first run builds the tree, which must not happen in two threads at once
        scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        return scene

    def first(
        self,
        origins: Array,
        directions: Array,
        nearest: float,
        farthest: Array = NO_LIMIT,
        *,
        hits: Found,
        fresh: bool = True,
    ) -> None:
        """Find the first triangle of every ray from ``nearest`` to ``farthest``, m.

        An empty ``farthest`` is no limit. ``hits`` is filled with distances (n,), m, points and
        unit normals (n, 3), unless these have no rows, and triangles (n,) of the mesh, -1 without a
        hit. Only if ``fresh`` are rays without a hit overwritten. `NoRayError` if a ray has NaN,
        infinity or a zero direction.
        """
        from . import _triangle_kernels

        for k, part in enumerate(self.parts):
            part.first(origins, directions, nearest, farthest, hits=hits, fresh=fresh and k == 0)
            beyond = farthest if len(farthest) else math.inf
            farthest = np.where(hits[3] >= 0, hits[0], beyond)
        if self.parts:
            return
        loose, rays = np.empty((2, len(origins), 8), dtype=np.float32)
        bins = np.empty(len(origins), dtype=np.int16)
        kept = _triangle_kernels.enter(
            origins,
            directions,
            self.limits,
            self.centre,
            self.reach,
            ASIDE * self.reach,
            loose,
            bins if self.sorts else bins[:0],
            rays,
            hits,
            fresh,
        )
        if kept < 0:
            raise NoRayError
        if not kept:
            return
        rays = rays[:kept]
        if self.exact:
            ids = np.full(kept, -1, dtype=np.int32)
        else:
            ids = self.scene.run(rays[:, :3], rays[:, 3:6])
        facets, ends = (self.rows, self.edges, self.names), (origins, directions)
        margin = MARGIN * self.reach
        doubtful = _triangle_kernels.place(
            *facets, *ends, rays, ids, margin, nearest, farthest, hits, fresh
        )
        if not doubtful:
            return
        rays, ids = rays[:doubtful], ids[:doubtful]
        unsure = ids >= 0
        missed = np.flatnonzero(~unsure)
        if self.exact or len(self.rows) <= 256:  # faster than displaced rays
            unsure[:] = True
        elif len(missed):
            unsure[missed] = self._near(rays[missed])
        index = rays.view(np.int32)[unsure, _triangle_kernels.INDEX]
        _triangle_kernels.search(*facets, self.boxes, *ends, index, nearest, farthest, hits)

    def _near(self, rays: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the rays without a hit of which a displaced copy has one."""
        from . import _triangle_kernels

        near = np.zeros(len(rays), dtype=bool)
        moved = np.empty((len(rays), 6), np.float32)
        for turn in (0.0, 2 * math.pi / 3, 4 * math.pi / 3):
            _triangle_kernels.aside(rays, 3 * MARGIN, turn, moved)
            near |= self.scene.run(moved[:, :3], moved[:, 3:]) >= 0
        return near

    def all(
        self, origins: Array, directions: Array, nearest: float
    ) -> tuple[NDArray[np.int64], Array, Array, NDArray[np.int32]]:
        """Find all hits of all rays beyond the distance ``nearest``, m, sorted by ray and distance.

        Return the number of hits of each ray, and distances, points (m) and triangles of all hits.
        """
        from . import _triangle_kernels

        counts, units = np.empty(len(origins), dtype=np.int64), np.empty((len(origins), 3))
        hits = _triangle_kernels.search_all(
            self.rows, self.edges, self.boxes, origins, directions, nearest, units, counts
        )
        if (counts < 0).any():
            raise NoRayError
        distance = hits[:, 0].copy()
        points = np.repeat(origins, counts, axis=0)
        points += distance[:, None] * np.repeat(units, counts, axis=0)
        return counts, distance, points, self.names[hits[:, 2].astype(np.int64)]


def _small_parts(corners: Array, edges: Array) -> tuple[list[NDArray[np.int64]], ...]:
    """Return groups of triangles that need search structures of their own; none for most meshes."""
    span = float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max())
    if edges.min() >= SMALL * span:
        return [], []
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    # Equal corners have equal keys; those of others differ but for rare chances, which only join
    # two parts.
    x, y, z = np.moveaxis(corners, -1, 0)
    _, number = np.unique(x + math.sqrt(2) * y + math.sqrt(3) * z, return_inverse=True)
    number = number.reshape(-1, 3)
    links = number[:, :2].ravel(), number[:, 1:].ravel()
    nodes = int(number.max()) + 1
    graph = coo_matrix((np.ones(len(links[0]), dtype=bool), links), shape=(nodes, nodes))
    count, label = connected_components(graph, directed=False)
    label = label[number[:, 0]]
    low, high = np.full((count, 3), math.inf), np.full((count, 3), -math.inf)
    np.minimum.at(low, label, corners.min(axis=1))
    np.maximum.at(high, label, corners.max(axis=1))
    small = (high - low).max(axis=1) < SMALL * span
    if not small.any():
        return [], []
    within = small[label]
    rest = np.flatnonzero(~within)
    groups = [rest] if len(rest) else []
    if (high[small].max(axis=0) - low[small].min(axis=0)).max() < 0.5 * span:
        return [*groups, np.flatnonzero(within)], []
    if small.sum() > 16:  # each Embree scene costs every ray the test of a box
        return groups, [np.flatnonzero(within)]
    return [*groups, *(np.flatnonzero(label == k) for k in np.flatnonzero(small))], []


def _along_a_curve(points: Array, low: Array, high: Array) -> NDArray[np.int64]:
    """Return the order of points along a Morton curve, which keeps neighbours in space together."""
    span = np.where(high > low, high - low, 1.0)
    cells = ((points - low) / span * (2**20 - 1)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        bits = cells[:, axis]
        # spreads the 20 bits to every third bit position
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
    """Return the boxes (m, 6) of a complete binary tree, root first, four triangles per leaf."""
    leaves = 1 << max(0, math.ceil(math.log2(max(1, math.ceil(len(corners) / 4)))))
    # empty leaves are filled with a corner of the last triangle, which enlarges no box
    fill = np.broadcast_to(corners[-1, 0], (4 * leaves - len(corners), 3))
    low = np.concatenate([corners.min(axis=1) - rounding, fill])
    high = np.concatenate([corners.max(axis=1) + rounding, fill])
    levels = []
    width = 4
    while True:
        low = low.reshape(-1, width, 3).min(axis=1)
        high = high.reshape(-1, width, 3).max(axis=1)
        levels.append(np.concatenate([low, high], axis=1))
        if len(low) == 1:
            return np.ascontiguousarray(np.concatenate(levels[::-1]))
        width = 2
