"""Hidden meshes with their materials, joined and checked before light is sent to them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene import Material
from ..scene._material import BECKMANN, GGX, OREN_NAYAR_FULL

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HiddenSurfaces:
    """Triangles of all hidden meshes; both sides of each scatter.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        All triangles, m, in the order of the meshes.
    lobes : ndarray
        (k, 4), the lobes of all materials.
    spans : ndarray of int64
        (n, 2), the rows of ``lobes`` of each triangle, from the first to before the last.
    alphas : ndarray
        (n,), of the narrowest lobe of each triangle, rad; 1 of wide ones.
    """

    mesh: trimesh.Trimesh
    lobes: Array
    spans: NDArray[np.int64]
    alphas: Array

    @property
    def corners(self) -> Array:
        """(n, 3, 3), m."""
        return np.array(self.mesh.vertices[self.mesh.faces], dtype=np.float64)


def hidden_surfaces(surfaces: Iterable[tuple[trimesh.Trimesh, Material]]) -> HiddenSurfaces:
    """Join hidden meshes and check that light can reach them.

    Parameters
    ----------
    surfaces : iterable of (trimesh.Trimesh, Material)
        World, m. In front of the relay wall z = 0, which they may touch.

    Raises
    ------
    SceneError
        If there is none, a mesh has vertices that are not finite, triangles without area or behind
        the wall, or a material is a mirror of zero slope.
    """
    import trimesh

    pairs = _pairs(surfaces)
    vertices, faces, lobes, spans, alphas = [], [], [], [], []
    n_vertices = n_lobes = 0
    for number, (mesh, material) in enumerate(pairs):
        points = _checked(number, mesh)
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
            f"surfaces = {type(surfaces).__name__} are not pairs; give a list of (mesh, material)"
        ) from None
    if not pairs:
        raise SceneError("surfaces are empty; give at least one (mesh, material)")
    return pairs


def _checked(number: int, mesh: Any) -> Array:
    """Vertices of a mesh that light can be sent to."""
    import trimesh

    name = f"surfaces[{number}]"
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"{name} of type {type(mesh).__name__} holds no triangles; give a Trimesh")
    points = np.array(mesh.vertices, dtype=np.float64)
    corners = points[np.asarray(mesh.faces)]
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if len(bad):
        raise SceneError(
            f"{name} has NaN or infinite vertices in {len(bad)} triangles, first in faces[{bad[0]}]"
            "; mend the mesh"
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
            f"{name} has {len(thin)} triangles without an area, first faces[{thin[0]}]; remove them"
        )
    return points


def _lobes(number: int, material: Any) -> Array:
    if not isinstance(material, Material):
        raise SceneError(
            f"surfaces[{number}] has the material {type(material).__name__}; give scene.Lambert, "
            "OrenNayar, Ward, SpecularMicrofacet or SumMaterial"
        )
    rows = material.lobe_table()
    mirror = np.isin(rows[:, 0], (BECKMANN, GGX)) & (rows[:, 2] == 0.0) & (rows[:, 1] > 0.0)
    if mirror.any():
        raise SceneError(
            f"surfaces[{number}] is a mirror of slope_rms = 0, whose light has no density over the "
            "surface; give it a slope from 1e-3 rad"
        )
    return rows


def _narrowest(rows: Array) -> float:
    """Least alpha of a lobe that reflects, at most 1, which is wide."""
    alphas = [1.0]
    for kind, strength, slope, _ in rows:
        if kind > OREN_NAYAR_FULL and strength > 0.0 and slope > 0.0:
            alphas.append(float(slope) * (math.sqrt(2.0) if kind in (BECKMANN, GGX) else 1.0))
    return min(alphas)
