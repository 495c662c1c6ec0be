"""Hidden meshes with their materials: checks, joining, and data for the kernels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted
from ...errors import SceneError
from ...kernels.codes import BECKMANN, GGX
from ...raytrace import intersect_mesh
from ...scene import Lambert, Material

if TYPE_CHECKING:
    import trimesh

    from ._bounce_kernels import Surfaces
    from .scan import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BounceSurfaces:
    """Meshes that paths can meet, and their data for the kernels."""

    # Hidden triangles, followed by those of a relay wall that reflects between them, if any
    met: trimesh.Trimesh
    kernel: Surfaces  # Data of the triangles for the kernels
    gap: float  # Hits nearer than this are ignored, m

    def first_hits(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int32]]:
        """Return distance, m, and triangle of the first hit of rays (n, 3); -1 for no hit."""
        hits = intersect_mesh(self.met, origins, directions, min_distance=self.gap)
        return hits.distance, hits.triangle


def bounce_surfaces(
    surfaces: HiddenSurfaces,
    wall_points: Array,
    wall_albedo: float,
    wall_size: tuple[float, float] | None,
) -> BounceSurfaces:
    """Join hidden surfaces and a relay wall for paths of several bounces."""
    from ...raytrace.intersection.triangles import Facets
    from ._bounce_kernels import Surfaces

    corners, lobes, spans = surfaces.corners, surfaces.lobes, surfaces.spans
    n_hidden = len(corners)
    if wall_size is not None:
        x, y = 0.5 * wall_size[0], 0.5 * wall_size[1]
        a, b, c, d = ([-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0])
        corners = np.concatenate([corners, [[a, b, c], [a, c, d]]])
        lobes = np.concatenate([lobes, Lambert(wall_albedo).lobe_table()])
        spans = np.concatenate([spans, np.tile([len(lobes) - 1, len(lobes)], (2, 1))])
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(first, second)
    doubled = np.sqrt((across * across).sum(axis=1))
    normals = across / doubled[:, None]
    shares = np.insert(np.cumsum(doubled[:n_hidden]), 0, 0.0)
    facets = Facets(surfaces.mesh)
    kernel = Surfaces(
        lobes=np.ascontiguousarray(lobes),
        spans=np.ascontiguousarray(spans, dtype=np.int64),
        triangles=np.ascontiguousarray(np.concatenate([corners[:, 0], first, second], axis=1)),
        normals=np.ascontiguousarray(normals),
        sides=_sides(corners, normals, wall_points),
        shares=shares / shares[-1],
        area=0.5 * float(shares[-1]),
        rows=facets.rows,
        boxes=facets.boxes,
    )
    met = surfaces.mesh if wall_size is None else _mesh(corners)
    extent = float(np.abs(corners[:n_hidden]).max())
    return BounceSurfaces(met=met, kernel=kernel, gap=1e-9 * extent)


def _sides(corners: Array, normals: Array, points: Array) -> NDArray[np.int64]:
    """Return the side of each triangle's plane on which all points lie: 1, -1, or 0 for both."""
    # testing the bounding box of the points is enough: at worst it reports both sides
    low, high = points.min(axis=0), points.max(axis=0)
    box = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    heights = np.einsum("tk,bk->tb", normals, box) - (normals * corners[:, 0]).sum(axis=1)[:, None]
    above, below = (heights > 0.0).any(axis=1), (heights < 0.0).any(axis=1)
    return np.where(above & below, 0, np.where(below, -1, 1)).astype(np.int64)


def _mesh(corners: Array) -> trimesh.Trimesh:
    import trimesh

    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)


Index = NDArray[np.int64]
#: Triangles (n, 9), tree of boxes, extent in m, neighbours (n, 3), start of each triangle's
#: intersection lines (n + 1,), and these lines (u, v, u, v).
Mesh = tuple[Array, Array, float, Index, Index, Array]


def occluders(surfaces: HiddenSurfaces) -> tuple[Mesh, Index]:
    """Return the data for `_visibility_kernels.see`, and the index in the mesh of its triangles."""
    from ...raytrace.intersection.triangles import Facets
    from ._visibility_kernels import crossings

    facets = Facets(surfaces.mesh)
    names = facets.names.astype(np.int64)
    corners = surfaces.corners[names]
    reach = float(np.abs(corners).max())
    begins, lines = np.zeros(len(names) + 1, dtype=np.int64), np.empty((0, 4))
    crossings(facets.rows, facets.boxes, reach, begins, lines)
    begins = np.cumsum(begins)
    if begins[-1]:
        lines = np.empty((begins[-1], 4))
        crossings(facets.rows, facets.boxes, reach, begins, lines)
    return (facets.rows, facets.boxes, reach, neighbours(corners), begins, lines), names


def neighbours(corners: Array) -> Index:
    """Return the neighbour of each triangle across each side, coded as in `_visibility_kernels`.

    Returns (n, 3): neighbour across the side from each corner to the next, or `ALONE`.
    """
    from ._visibility_kernels import ALONE, FLIPPED

    # adding 0.0 maps -0.0 to 0.0, which np.unique would keep apart
    _, points = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    points = points.reshape(-1, 3)
    first, last = points.ravel(), np.roll(points, -1, axis=1).ravel()
    sides = np.stack([np.minimum(first, last), np.maximum(first, last)], axis=1)
    _, side, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(side.reshape(-1), kind="stable")
    pairs = order[count[side.reshape(-1)[order]] == 2].reshape(-1, 2)
    found = np.full(first.size, ALONE, dtype=np.int64)
    around = first[pairs[:, 0]] != first[pairs[:, 1]]  # consistent orientation: opposite ways
    for here, there in (pairs.T, pairs.T[::-1]):
        found[here] = np.where(around, there // 3, FLIPPED - there // 3)
    return found.reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class HiddenSurfaces:
    """Triangles of all hidden meshes; both sides of each scatter."""

    mesh: trimesh.Trimesh  # All triangles, world frame, m, in the order of the meshes
    lobes: Array  # (k, 4): lobes of all materials
    # (n, 2): range of rows in ``lobes`` for each triangle; the end is exclusive
    spans: NDArray[np.int64]
    alphas: Array  # (n,): alpha of the narrowest lobe of each triangle, rad; 1 for wide lobes

    @property
    def corners(self) -> Array:
        """Corners of the triangles, (n, 3, 3), m."""
        return np.array(self.mesh.vertices[self.mesh.faces], dtype=np.float64)


def hidden_surfaces(
    surfaces: Iterable[tuple[trimesh.Trimesh, Material]], frame: Frame | None = None
) -> HiddenSurfaces:
    """Check and join hidden meshes, in the frame of a wall, by default that of the world."""
    import trimesh

    pairs = _pairs(surfaces)
    vertices, faces, lobes, spans, alphas = [], [], [], [], []
    n_vertices = n_lobes = 0
    for number, (mesh, material) in enumerate(pairs):
        points = _checked(number, mesh, frame)
        rows = _lobes(number, material)
        triangles = np.asarray(mesh.faces, dtype=np.int64)
        vertices.append(points)
        faces.append(triangles + n_vertices)
        lobes.append(rows)
        spans.append(np.tile([n_lobes, n_lobes + len(rows)], (len(triangles), 1)))
        alphas.append(np.full(len(triangles), _narrowest(rows)))
        n_vertices += len(points)
        n_lobes += len(rows)
    joined = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    return HiddenSurfaces(
        joined, np.concatenate(lobes), np.concatenate(spans), np.concatenate(alphas)
    )


def _pairs(surfaces: Any) -> list[tuple[Any, Any]]:
    try:
        pairs = [(mesh, material) for mesh, material in surfaces]
    except (TypeError, ValueError):
        raise SceneError(
            f"surfaces of type {type(surfaces).__name__} are not pairs; give a list of (mesh, "
            "material)"
        ) from None
    if not pairs:
        raise SceneError("surfaces are empty; give at least one (mesh, material)")
    return pairs


def _checked(number: int, mesh: Any, frame: Frame | None) -> Array:
    """Return the vertices of a mesh after checking them."""
    import trimesh

    name = f"surfaces[{number}]"
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"{name} of type {type(mesh).__name__} holds no triangles; give a Trimesh")
    points = np.array(mesh.vertices, dtype=np.float64)
    if frame is not None:
        points = frame.inside(points)
    corners = points[np.asarray(mesh.faces)]
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if len(bad):
        raise SceneError(
            f"{name} has NaN or infinite vertices in {len(bad)} triangles, first in faces[{bad[0]}]"
            "; repair the mesh"
        )
    extent = float(np.abs(corners).max())
    low = corners[..., 2].min(axis=1)
    behind = np.flatnonzero(low < -1e-9 * extent)
    if len(behind):
        raise SceneError(
            f"{name} reaches behind the wall, to z = {low.min():g} m at faces[{low.argmin()}], "
            "limit 0; move it into the room or cut it off at z = 0"
        )
    flat = np.flatnonzero(corners[..., 2].max(axis=1) <= 1e-9 * extent)
    if len(flat):
        raise SceneError(f"{name} lies in the wall z = 0 at faces[{flat[0]}]; move it away")
    sides = corners - corners[:, [1, 2, 0]]
    longest = (sides * sides).sum(axis=2).max(axis=1)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.sqrt((across * across).sum(axis=1))
    thin = np.flatnonzero(areas <= 1e-12 * longest)
    if len(thin):
        raise SceneError(
            f"{name} has {counted(len(thin), 'triangle')} without an area, first "
            f"faces[{thin[0]}]; remove them"
        )
    return points


def _lobes(number: int, material: Any) -> Array:
    if not isinstance(material, Material):
        raise SceneError(
            f"surfaces[{number}] has the material {type(material).__name__}; give scene.Lambert, "
            "OrenNayar, Ward, SpecularMicrofacet, Retroreflector or SumMaterial"
        )
    rows = material.lobe_table()
    mirror = np.isin(rows[:, 0], (BECKMANN, GGX)) & (rows[:, 2] == 0.0) & (rows[:, 1] > 0.0)
    if mirror.any():
        raise SceneError(
            f"surfaces[{number}] is a mirror of slope_rms = 0, must be above 0, because a mirror "
            "has no reflectance density; give a slope_rms of 1e-3 rad or more"
        )
    return rows


def _narrowest(rows: Array) -> float:
    """Return the least alpha of the reflecting lobes, at most 1, which counts as wide."""
    alphas = [1.0]
    for kind, strength, slope in rows[:, :3]:
        if kind >= BECKMANN and strength > 0.0 and slope > 0.0:
            alphas.append(float(slope) * (math.sqrt(2.0) if kind in (BECKMANN, GGX) else 1.0))
    return min(alphas)
