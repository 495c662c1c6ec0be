"""Hidden surfaces and the relay wall as paths of several reflections meet them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from ..raytrace import intersect_mesh, occluded
from ..scene import Lambert
from .hidden_surfaces import HiddenSurfaces

if TYPE_CHECKING:
    import trimesh

    from ._bounce_kernels import Surfaces

Array = NDArray[np.float64]
GAP: Final = 1e-9  # of the scene's extent: what paths leave is not met nearer than this
ASKED: Final = 4096  # triangles up to which kernels look for shadows by themselves


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
    surfaces: HiddenSurfaces,
    wall_points: Array,
    wall_albedo: float,
    wall_size: tuple[float, float] | None,
) -> BounceSurfaces:
    """Join hidden surfaces and a wall of ``wall_size`` (x, y), m, or None, about the origin.

    ``wall_points`` (n, 3), m, are those that see the surfaces.
    """
    from ..raytrace.triangles import Facets
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
        asked=n_hidden <= ASKED,
    )
    met = surfaces.mesh if wall_size is None else _mesh(corners)
    extent = float(np.abs(corners[:n_hidden]).max())
    return BounceSurfaces(hidden=surfaces.mesh, met=met, kernel=kernel, gap=GAP * extent)


def _sides(corners: Array, normals: Array, points: Array) -> NDArray[np.int64]:
    """Side of each triangle's plane on which all points are: 1, -1, or 0 where there are both."""
    # the points' box will do: its corners are on the side that all points are on, or on both
    low, high = points.min(axis=0), points.max(axis=0)
    box = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    heights = np.einsum("tk,bk->tb", normals, box) - (normals * corners[:, 0]).sum(axis=1)[:, None]
    above, below = (heights > 0.0).any(axis=1), (heights < 0.0).any(axis=1)
    return np.where(above & below, 0, np.where(below, -1, 1)).astype(np.int64)


def _mesh(corners: Array) -> trimesh.Trimesh:
    import trimesh

    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
