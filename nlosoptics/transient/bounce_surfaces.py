"""Hidden meshes and the relay wall as paths of several reflections meet them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from .._checks import in_range, pair
from ..errors import SceneError
from ..raytrace import intersect_mesh, occluded
from ..scene import Lambert, Material
from ..scene._material import BECKMANN, GGX

if TYPE_CHECKING:
    import trimesh

    from ._bounce_kernels import Surfaces

Array = NDArray[np.float64]
GAP: Final = 1e-9  # of the scene's extent: what paths leave is not met nearer than this
BEHIND: Final = 1e-9  # of the scene's extent: rounding of vertices on the wall


@dataclass(frozen=True, eq=False)
class BounceSurfaces:
    """Meshes that light can meet and what kernels know of them.

    Parameters
    ----------
    hidden : trimesh.Trimesh
        All hidden triangles, which alone can stand in the way.
    met : trimesh.Trimesh
        The same and, after them, those of a relay wall that reflects on the way.
    kernel : Surfaces
    gap : float
        Hits nearer than this are passed over, m.
    """

    hidden: trimesh.Trimesh
    met: trimesh.Trimesh
    kernel: Surfaces
    gap: float

    def first_hits(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int32]]:
        """Distance and triangle, -1 for none, where rays (n, 3) first end."""
        hits = intersect_mesh(self.met, origins, directions, min_distance=self.gap)
        return hits.distance, hits.triangle

    def clear(self, value: Array, starts: Array, ends: Array) -> None:
        """Set values (n,) to 0 where hidden surfaces stand between points (n, 3)."""
        rows = np.flatnonzero(value > 0.0)
        if len(rows):
            value[rows[occluded(self.hidden, starts[rows], ends[rows])]] = 0.0


def bounce_surfaces(
    surfaces: Sequence[tuple[Any, Material]], wall_albedo: float, wall_size: Any
) -> BounceSurfaces:
    """Join hidden meshes, m, world, and a wall of ``wall_size`` (m, or None) about the origin."""
    from ._bounce_kernels import Surfaces

    albedo = in_range("wall_albedo", wall_albedo, 0.0, 1.0)
    parts = [_part(k, *entry) for k, entry in enumerate(_pairs(surfaces))]
    corners = [part for part, _ in parts]
    materials = [material for _, material in parts]
    n_hidden = sum(len(part) for part in corners)
    if wall_size is not None:
        x, y = (0.5 * side for side in pair("wall_size", wall_size))
        a, b, c, d = ([-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0])
        corners.append(np.array([[a, b, c], [a, c, d]]))
        materials.append(Lambert(albedo))
    owner = np.repeat(np.arange(len(corners)), [len(part) for part in corners])
    points = np.concatenate(corners)
    across = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    doubled = np.sqrt((across * across).sum(axis=1))
    area = 0.5 * float(doubled[:n_hidden].sum())
    if area == 0.0:
        raise SceneError("the hidden surfaces have no area; give meshes with triangles")
    shares = np.insert(np.cumsum(doubled[:n_hidden]), 0, 0.0)
    shares /= shares[-1]
    lobes = [material._lobes() for material in materials]
    kernel = Surfaces(
        lobes=np.ascontiguousarray(np.concatenate(lobes)),
        starts=np.array([0, *itertools.accumulate(len(rows) for rows in lobes)]),
        owner=owner.astype(np.int64),
        triangles=np.ascontiguousarray(
            np.concatenate(
                [points[:, 0], points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], axis=1
            )
        ),
        normals=across / np.where(doubled > 0.0, doubled, 1.0)[:, None],
        shares=shares,
        area=area,
    )
    extent = float(np.abs(points[:n_hidden]).max())
    if points[:n_hidden, :, 2].min() < -BEHIND * extent:
        raise SceneError(
            f"a hidden surface reaches to z = {points[:n_hidden, :, 2].min():g} m, behind the wall "
            "z = 0; move it in front"
        )
    hidden = _mesh(points[:n_hidden])
    met = hidden if wall_size is None else _mesh(points)
    return BounceSurfaces(hidden=hidden, met=met, kernel=kernel, gap=GAP * extent)


def _pairs(surfaces: Any) -> list[tuple[Any, Any]]:
    try:
        pairs = [(mesh, material) for mesh, material in surfaces]
    except (TypeError, ValueError):
        pairs = []
    if not pairs:
        raise SceneError(
            "surfaces hold no pair of a mesh and a material; give such as "
            "[(trimesh.Trimesh, scene.Lambert(0.8))]"
        )
    return pairs


def _part(number: int, mesh: Any, material: Any) -> tuple[Array, Material]:
    """Corners (n, 3, 3) of a mesh, and its material, checked."""
    place = f"surfaces[{number}]"
    if not hasattr(mesh, "faces") or not hasattr(mesh, "vertices"):
        raise SceneError(f"{place} has a {type(mesh).__name__} as its mesh; give a trimesh.Trimesh")
    if not isinstance(material, Material):
        raise SceneError(
            f"{place} has a {type(material).__name__} as its material; give one of "
            "nlosoptics.scene, such as Lambert(0.8)"
        )
    corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    if not len(corners):
        raise SceneError(f"{place} has no triangles; give a surface mesh")
    if not np.isfinite(corners).all():
        raise SceneError(f"{place} has NaN or infinite vertices; mend it")
    lobes = material._lobes()
    if ((lobes[:, 2] == 0.0) & (lobes[:, 1] > 0.0) & np.isin(lobes[:, 0], (BECKMANN, GGX))).any():
        raise SceneError(
            f"{place} has a smooth mirror, slope_rms = 0, which no spot of the wall can be joined "
            "to; give it a slope, such as 0.01"
        )
    return corners, material


def _mesh(points: Array) -> trimesh.Trimesh:
    import trimesh

    faces = np.arange(3 * len(points)).reshape(-1, 3)
    return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
