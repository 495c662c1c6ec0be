"""Triangle meshes with the arrays that rays need of them, prepared once and cached."""

from __future__ import annotations

import itertools
import math
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect
from .triangles import Facets

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


class Chart(NamedTuple):
    """Map from the unit square to a mesh that keeps areas, and neighbours where it can.

    The square is halved in turns along u and v, at the shares of the areas of the halves of the
    mesh, down to patches of few triangles. Neighbouring points of the square then lie close
    together on the mesh, so that evenly spread points stay so.

    Attributes
    ----------
    triangles : ndarray, (n, 9)
        First corner and the two edges from there, m, patch by patch.
    shares : ndarray, (n + 1,)
        Cumulative shares of these triangles in the area, from 0 to 1.
    firsts : ndarray of int64, (p + 1,)
        First triangle of each patch, and the number of triangles; p is a power of two.
    splits : ndarray, (p,)
        Share of the first half of each part, in the order of a binary heap whose root is 1.
    patches : ndarray of int32, (n,)
        Patch of each triangle, in the order of the mesh.
    centres, normals : ndarray, (p, 3)
        Centroid of each patch, m, and the sum of its triangles' normals times their areas, m^2.
    areas : ndarray, (p,)
        Area of each patch, m^2.
    """

    triangles: Array
    shares: Array
    firsts: NDArray[np.int64]
    splits: Array
    patches: NDArray[np.int32]
    centres: Array
    normals: Array
    areas: Array

    @property
    def area(self) -> float:
        """Area of all triangles, m^2."""
        return float(self.areas.sum())


class PreparedMesh:
    """Triangles of one or several meshes, with the arrays and search structures made from them.

    Each of these is computed when it is first asked for. ``mesh`` must not be changed later.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._mesh = mesh

    @cached_property
    def facets(self) -> Facets:
        """Search structures of all triangles."""
        return Facets(self._mesh)

    @cached_property
    def normals(self) -> Array:
        """Unit normals of the triangles, (n, 3)."""
        return np.array(self._mesh.face_normals, dtype=np.float64)

    @cached_property
    def reach(self) -> float:
        """Largest absolute coordinate, m."""
        return float(np.abs(self._mesh.bounds).max())

    @cached_property
    def chart(self) -> Chart:
        """Triangles in the order in which points are drawn on them."""
        corners = np.asarray(self._mesh.triangles, dtype=np.float64)
        middles = corners.mean(axis=1)
        order, firsts = _halved(middles)
        corners = corners[order]
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across = 0.5 * np.cross(first, second)
        sizes = np.sqrt((across * across).sum(axis=1))
        patches = np.empty(len(order), dtype=np.int32)
        patches[order] = np.repeat(np.arange(len(firsts) - 1, dtype=np.int32), np.diff(firsts))

        def summed(values: Array) -> Array:
            return np.asarray(np.add.reduceat(values, firsts[:-1], axis=0))

        areas = summed(sizes)
        centres = summed(sizes[:, None] * middles[order])
        centres /= np.where(areas > 0.0, areas, 1.0)[:, None]
        return Chart(
            triangles=np.concatenate([corners[:, 0], first, second], axis=1),
            shares=cumulative(sizes),
            firsts=firsts,
            splits=chart_splits(areas),
            patches=patches,
            centres=centres,
            normals=summed(across),
            areas=areas,
        )

    @cached_property
    def ball(self) -> Array:
        """Centre (x, y, z) and radius of a sphere that holds all triangles, (4,), m."""
        return ball_around(np.asarray(self._mesh.triangles, dtype=np.float64).reshape(-1, 3))


def prepared_mesh(*meshes: trimesh.Trimesh) -> PreparedMesh:
    """Return the prepared triangles of the meshes joined in this order (world frame, m).

    The latest ones are cached by their contents, so that a mesh which was changed, in whatever way,
    is prepared anew, and an equal mesh of another scene is not.
    """
    for mesh in meshes:
        expect("mesh", mesh, "Trimesh")
    parts = ((mesh.vertices, mesh.faces) for mesh in meshes)
    return _prepared(
        *(
            (np.asarray(v, np.float64).tobytes(), np.asarray(f, np.int64).tobytes())
            for v, f in parts
        )
    )


@lru_cache(maxsize=8)
def _prepared(*parts: tuple[bytes, bytes]) -> PreparedMesh:
    """Return the triangles of meshes with these bytes of vertices and faces."""
    import trimesh

    vertices = [np.frombuffer(part, np.float64).reshape(-1, 3) for part, _ in parts]
    faces = [np.frombuffer(part, np.int64).reshape(-1, 3) for _, part in parts]
    starts = np.cumsum([0, *(len(part) for part in vertices[:-1])])
    joined = [part + start for part, start in zip(faces, starts, strict=True)]
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(joined), process=False)
    return PreparedMesh(mesh)


def ball_around(points: Array) -> Array:
    """Return centre (x, y, z) and radius of a sphere that holds the points (n, 3), (4,), m."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max()))
    return np.array([*centre, radius])


def chart_splits(weights: Array) -> Array:
    """Return `Chart.splits` at which patches are drawn in proportion to the weights (p,)."""
    splits = np.full(len(weights), 0.5)
    while len(weights) > 1:
        pairs = weights.reshape(-1, 2)
        weights = pairs.sum(axis=1)
        half = splits[len(weights) : 2 * len(weights)]
        np.divide(pairs[:, 0], weights, out=half, where=weights > 0.0)
    return splits


def cumulative(values: Array) -> Array:
    """Return cumulative shares along the last axis, from 0 to 1; uniform if all values are 0."""
    total = values.sum(axis=-1, keepdims=True)
    shares = np.where(total > 0.0, values, 1.0)
    sums = np.cumsum(shares, axis=-1) / shares.sum(axis=-1, keepdims=True)
    sums = np.minimum(np.insert(sums, 0, 0.0, axis=-1), 1.0)
    sums[..., -1] = 1.0  # exact, so that no random number falls beyond the last share
    return np.asarray(sums)


def _halved(points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an order of points (n, 3) and the starts of its patches, made by repeated halving."""
    order, firsts = np.arange(len(points)), [0, len(points)]
    for _ in range(min(12, int(math.log2(len(points))))):
        finer = [0]
        for a, b in itertools.pairwise(firsts):
            part = points[order[a:b]]
            across, middle = part[:, int(np.ptp(part, axis=0).argmax())], (b - a) // 2
            order[a:b] = order[a:b][np.argpartition(across, middle)]
            finer += [a + middle, b]
        firsts = finer
    return order, np.array(firsts, dtype=np.int64)
