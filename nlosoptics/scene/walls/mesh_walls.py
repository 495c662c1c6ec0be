"""Triangle meshes: loading, checking, and the smooth wall surface behind one."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive
from ...errors import SceneError
from ...kernels.codes import GRID
from ..parts._sources import bare_mesh, equal_sources, source
from .analytic import Array, Wall, _term

if TYPE_CHECKING:
    import trimesh

from ..parts.meshes import load_mesh


@dataclass(frozen=True, eq=False)
class MeshWall(Wall):
    """Relay wall given by a mesh that is a height field over z = 0.

    Waves need a smooth surface, which triangles are not: the vertices are joined by a bicubic
    surface with continuous slopes, and `fit_residual` says how far that can be from the truth.
    `mesh_error` says how far the triangles themselves are from it, which rays on them meet.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        File (STL, OBJ, PLY) or mesh, m, world frame, facing +z.
    scale : float
        Factor on the mesh's coordinates, for files in other units.
    """

    mesh: Any
    _: KW_ONLY
    scale: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", source(self.mesh))
        positive("wall.scale", self.scale)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeshWall):
            return NotImplemented
        return self.scale == other.scale and equal_sources(self.mesh, other.mesh)

    __hash__ = None  # type: ignore[assignment]

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"mesh": bare_mesh(self.mesh)}

    @cached_property
    def triangles(self) -> trimesh.Trimesh:
        """The mesh itself, scaled."""
        mesh = load_mesh("wall.mesh", self.mesh)
        if self.scale != 1.0:
            mesh = mesh.copy()
            mesh.vertices = mesh.vertices * self.scale
        return mesh

    @property
    def size(self) -> tuple[float, float]:  # type: ignore[override]
        """Extent in x and y that is centred on the origin and covered by the mesh, m."""
        low, high = self.triangles.bounds
        reach = np.minimum(-low[:2], high[:2])
        if not (reach > 0).all():
            raise SceneError(
                f"wall.mesh spans x {low[0]:g} to {high[0]:g} m and y {low[1]:g} to {high[1]:g} m; "
                "it must surround the origin"
            )
        return (2 * float(reach[0]), 2 * float(reach[1]))

    @cached_property
    def _fit(self) -> tuple[Array, Array, float, float]:
        """Term, table, residual and curvature bound of the bicubic surface."""
        from scipy.interpolate import RectBivariateSpline

        mesh = self.triangles
        self._check_height_field(mesh)
        points = np.unique(np.asarray(mesh.vertices, dtype=np.float64), axis=0)
        size = self.size
        span = max(size)
        x, y = (_distinct(points[:, i], 1e-7 * span) for i in (0, 1))
        if len(x) * len(y) == len(points) and min(len(x), len(y)) >= 8:
            columns = np.searchsorted(x, points[:, 0] - 1e-7 * span)
            rows = np.searchsorted(y, points[:, 1] - 1e-7 * span)
            z = np.empty((len(x), len(y)))
            z[columns, rows] = points[:, 2]
            spline = RectBivariateSpline(x, y, z)
            every_other = RectBivariateSpline(x[::2], y[::2], z[::2, ::2])
            # vertices that a fit through every other one was not shown
            end_x, end_y = x[::2][-1], y[::2][-1]
            seen = np.ix_(x <= end_x, y <= end_y)
            guess = every_other(x[x <= end_x], y[y <= end_y])
            residual = float(abs(guess - z[seen]).max())
            counts = (len(x), len(y))
        else:
            spline, residual, counts = _scattered_fit(points, size)
        nodes_x = np.linspace(-size[0] / 2, size[0] / 2, max(counts[0], 8))
        nodes_y = np.linspace(-size[1] / 2, size[1] / 2, max(counts[1], 8))
        channels = [
            spline(nodes_x, nodes_y, dx=dx, dy=dy).T.ravel()
            for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1))
        ]
        bends = [spline(nodes_x, nodes_y, dx=dx, dy=2 - dx) for dx in (0, 1, 2)]
        curvature = float(np.max(np.maximum(abs(bends[0]), abs(bends[2])) + abs(bends[1])))
        term = _term(
            GRID,
            nodes_x[0],
            nodes_y[0],
            nodes_x[1] - nodes_x[0],
            nodes_y[1] - nodes_y[0],
            len(nodes_x),
            len(nodes_y),
            0,
        )
        return term, np.concatenate(channels), residual, curvature

    @staticmethod
    def _check_height_field(mesh: trimesh.Trimesh) -> None:
        upward = np.asarray(mesh.face_normals)[np.asarray(mesh.area_faces) > 0][:, 2]
        if not (np.all(upward > 0) or np.all(upward < 0)):
            raise SceneError(
                f"wall.mesh folds back: {int(min((upward > 0).sum(), (upward <= 0).sum()))} of "
                f"{len(upward)} triangles face the other way in z; give a single-valued height"
            )

    def compiled(self) -> tuple[Array, Array]:
        """One bicubic grid, that of the smooth surface."""
        return self._fit[0], self._fit[1]

    @property
    def fit_residual(self) -> float:
        """How far the smooth surface may be from the wall that the mesh samples, m.

        On a regular grid of vertices: the largest misfit, at the vertices left out, of the surface
        through every other vertex, which overstates that through all of them. Otherwise the largest
        misfit of a least-squares bicubic spline with fewer coefficients than vertices.
        """
        return self._fit[2]

    @cached_property
    def mesh_error(self) -> float:
        """Mean distance in z between the triangles and the smooth surface, m.

        What the height of a hit on a triangle gets wrong; a reflected path, twice that. On a
        square grid of pitch h over a radius of curvature R it is h^2 / 6R: the mean, over a right
        triangle, of the sag of a paraboloid below its chords.
        """
        corners = np.asarray(self.triangles.triangles, dtype=np.float64)
        first, second = (corners[:, i, :2] - corners[:, 0, :2] for i in (1, 2))
        areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        total = whole = 0.0
        # three points of a triangle, by which the mean of a quadratic is exact
        for shares in np.eye(3) / 2 + 1 / 6:
            x, y, z = np.einsum("k,nkc->cn", shares, corners)
            inside = np.asarray(self.contains(x, y))
            gap = np.abs(z[inside] - self.height(x[inside], y[inside]))
            total += float((areas[inside] * gap).sum())
            whole += float(areas[inside].sum())
        return total / whole

    def wave_grade(self, wavelength: float) -> bool:
        """Whether the smooth surface is known to a twentieth of a wavelength (m), as waves need."""
        return self.fit_residual <= positive("wavelength", wavelength) / 20

    @property
    def max_curvature(self) -> float:
        """Largest curvature of the smooth surface at its nodes, 1/m."""
        return self._fit[3]

    @property
    def finest_period(self) -> float:
        """Eight cells of the smooth surface, m."""
        return 8 * float(max(self._fit[0][0, 3], self._fit[0][0, 4]))


def _distinct(values: Array, tolerance: float) -> NDArray[np.float64]:
    """Sorted values without those closer than ``tolerance`` to the one before."""
    ordered = np.sort(values)
    return np.asarray(ordered[np.append(True, np.diff(ordered) > tolerance)])


def _scattered_fit(points: Array, size: tuple[float, float]) -> tuple[Any, float, tuple[int, int]]:
    """Least-squares bicubic spline of scattered vertices, its largest misfit and node counts."""
    import warnings

    from scipy.interpolate import LSQBivariateSpline

    per_knot = 6  # vertices for every coefficient, so that the misfit means something
    n = math.sqrt(len(points) / per_knot)
    if n < 4:
        raise SceneError(
            f"wall.mesh has {len(points)} vertices, too few for a smooth surface; give at least 100"
        )
    ratio = math.sqrt(size[0] / size[1])
    counts = (max(2, round(n * ratio)), max(2, round(n / ratio)))
    low, high = points.min(axis=0), points.max(axis=0)
    knots_x, knots_y = (np.linspace(low[i], high[i], counts[i] + 2)[1:-1] for i in (0, 1))
    with warnings.catch_warnings():
        # a rank-deficient fit shows in the misfit
        warnings.simplefilter("ignore")
        spline = LSQBivariateSpline(points[:, 0], points[:, 1], points[:, 2], knots_x, knots_y)
    residual = float(abs(spline.ev(points[:, 0], points[:, 1]) - points[:, 2]).max())
    return spline, residual, (4 * counts[0], 4 * counts[1])
