"""Relay walls given by triangle meshes, and the smooth surfaces fitted to them."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, positive
from ...errors import SceneError
from ...kernels.codes import GRID
from ..parts._sources import bare_mesh, equal_sources, source
from .analytic import Array, Wall, _term

if TYPE_CHECKING:
    import trimesh

from ..parts.meshes import load_mesh


@dataclass(frozen=True, eq=False)
class MeshWall(Wall):
    """Relay wall given by a triangle mesh, as a smooth surface or as the triangles themselves.

    Waves need a smooth surface with a single height above each point of the plane z = 0, so a
    bicubic surface with continuous slopes is fitted to the vertices. It is stored on a regular grid
    in x and y. The wall is the largest rectangle that is centred on the origin and within the
    mesh's extent in x and y (`size`): parts of the mesh outside are not used, and inside there must
    be no large holes. The property `fit_residual` estimates the error of this fit, m. The property
    `mesh_error` is the mean distance in z between the flat triangles and the fitted surface, m.

    With ``smooth=False``, nothing is fitted, and rays meet the triangles from both sides. The mesh
    may then fold back, like a scan with undercuts. Only `raytrace.trace` and `raytrace.trace_image`
    can use such a wall. All other methods refuse it, because it has no height function.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        Mesh file (STL, OBJ, PLY) or mesh, in the world frame, m. Its outline in x and y
        must surround the origin.
    scale : float
        Factor applied to the mesh's coordinates, for example 1e-3 for a file in millimetres.
    smooth : bool
        Whether a smooth surface is fitted to the mesh, as waves need it. False: rays meet the
        triangles themselves, which may fold back.

    Raises
    ------
    SceneError
        If ``scale`` is not above 0 or ``smooth`` is no bool. A missing file, too few vertices, or a
        mesh that folds back, has large holes, is round or does not surround the origin is found at
        the first use.

    See Also
    --------
    HeightMapWall : Wall from measured heights.
    MeshObject : Hidden triangle mesh.
    """

    mesh: Any
    _: KW_ONLY
    scale: float = 1.0
    smooth: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", source(self.mesh))
        positive("wall.scale", self.scale)
        if not isinstance(self.smooth, bool):
            raise SceneError(f"wall.smooth = {self.smooth!r}; give True or False")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeshWall):
            return NotImplemented
        same = (self.scale, self.smooth) == (other.scale, other.smooth)
        return same and equal_sources(self.mesh, other.mesh)

    __hash__ = None  # type: ignore[assignment]

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"mesh": bare_mesh(self.mesh)}

    @property
    def has_height(self) -> bool:  # type: ignore[override]
        """Whether the wall is a height above each point of the plane z = 0: if it is smooth."""
        return self.smooth

    @property
    def true_triangles(self) -> trimesh.Trimesh | None:
        """Triangles that rays meet, world frame, m; None if the wall is smooth."""
        return None if self.smooth else self.triangles

    @cached_property
    def triangles(self) -> trimesh.Trimesh:
        """Scaled mesh in the world frame, m."""
        mesh = load_mesh("wall.mesh", self.mesh)
        if self.scale != 1.0:
            mesh = mesh.copy()
            mesh.vertices = mesh.vertices * self.scale
        return mesh

    @property
    def size(self) -> tuple[float, float]:  # type: ignore[override]
        """Width and height of the largest rectangle about the origin in the mesh's extent, m."""
        low, high = self.triangles.bounds
        reach = np.minimum(-low[:2], high[:2])
        if not (reach > 1e-9 * (high - low).max()).all():
            raise SceneError(
                f"wall.mesh spans x {low[0]:g} to {high[0]:g} m and y {low[1]:g} to {high[1]:g} m; "
                "it must surround the origin and face along z; shift or turn the mesh"
            )
        return (2 * float(reach[0]), 2 * float(reach[1]))

    @cached_property
    def _fit(self) -> tuple[Array, Array, float, float]:
        """Height term, table, residual (m) and curvature (1/m) of the fitted bicubic surface."""
        if not self.smooth:
            raise SceneError(
                "wall.smooth is false, so that the wall has triangles but no height function, and "
                "only raytrace.trace and trace_image can use it; set wall.smooth = true"
            )
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
            spline, counts = RectBivariateSpline(x, y, z), (len(x), len(y))
            every_other = RectBivariateSpline(x[::2], y[::2], z[::2, ::2])
            # compare at all vertices inside the grid of every other one, to avoid extrapolation
            seen_x, seen_y = x <= x[::2][-1], y <= y[::2][-1]
            guess = every_other(x[seen_x], y[seen_y])
            residual = float(abs(guess - z[np.ix_(seen_x, seen_y)]).max())
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
        steps = nodes_x[1] - nodes_x[0], nodes_y[1] - nodes_y[0]
        term = _term(GRID, nodes_x[0], nodes_y[0], *steps, len(nodes_x), len(nodes_y), 0)
        return term, np.concatenate(channels), residual, curvature

    @staticmethod
    def _check_height_field(mesh: trimesh.Trimesh) -> None:
        """Raise `SceneError` unless all triangles face the same way in z."""
        upward = np.asarray(mesh.face_normals)[np.asarray(mesh.area_faces) > 0][:, 2]
        if not (np.all(upward > 0) or np.all(upward < 0)):
            raise SceneError(
                f"wall.mesh folds back: {int(min((upward > 0).sum(), (upward <= 0).sum()))} of "
                f"{len(upward)} triangles face the other way in z; give a single-valued height, or "
                "wall.smooth = false to trace rays alone"
            )

    def compiled(self) -> tuple[Array, Array]:
        """Return the fitted surface as the arrays described in `Wall.compiled`."""
        return self._fit[0], self._fit[1]

    @property
    def fit_residual(self) -> float:
        """Estimated error of the fitted surface relative to the wall that the mesh samples, m.

        If the vertices lie on a regular grid, a second surface is fitted to every other vertex, and
        its largest misfit at the remaining vertices is returned. This overestimates the error of
        the surface through all vertices. For other meshes it is the largest misfit of a
        least-squares bicubic spline, which has fewer coefficients than there are vertices.
        """
        return self._fit[2]

    @cached_property
    def mesh_error(self) -> float:
        """Mean distance in z between the triangles and the fitted surface, m.

        This is the height error of rays that are intersected with the triangles; the error of a
        reflected ray's path length is up to twice as large. For vertices on a square grid of pitch
        h and a radius of curvature R it is h^2/(6R), the mean sag of a paraboloid over a right
        triangle.
        """
        corners = np.asarray(self.triangles.triangles, dtype=np.float64)
        first, second = (corners[:, i, :2] - corners[:, 0, :2] for i in (1, 2))
        areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        total = whole = 0.0
        # three-point quadrature over a triangle, exact for quadratic functions
        for shares in np.eye(3) / 2 + 1 / 6:
            x, y, z = np.einsum("k,nkc->cn", shares, corners)
            inside = np.asarray(self.contains(x, y))
            gap = np.abs(z[inside] - self.height(x[inside], y[inside]))
            total += float((areas[inside] * gap).sum())
            whole += float(areas[inside].sum())
        return total / whole

    def wave_grade(self, wavelength: float) -> bool:
        """Return whether `fit_residual` is at most a twentieth of a wavelength, as waves need it.

        Parameters
        ----------
        wavelength : float
            Wavelength, m.

        Raises
        ------
        SceneError
            If the wavelength is not above 0, or the mesh cannot be fitted.
        """
        return self.fit_residual <= positive("wavelength", wavelength) / 20

    @property
    def max_curvature(self) -> float:
        """Upper bound on the fitted surface's curvature at the points of its regular grid, 1/m."""
        return self._fit[3]

    @property
    def finest_period(self) -> float:
        """Shortest period that the fitted surface is assumed to resolve, m.

        It is eight cells of the regular grid on which the surface is stored.
        """
        return 8 * float(max(self._fit[0][0, 3], self._fit[0][0, 4]))


def _distinct(values: Array, tolerance: float) -> NDArray[np.float64]:
    """Return sorted values without those closer than ``tolerance`` to their predecessor."""
    ordered = np.sort(values)
    return np.asarray(ordered[np.append(True, np.diff(ordered) > tolerance)])


def _scattered_fit(points: Array, size: tuple[float, float]) -> tuple[Any, float, tuple[int, int]]:
    """Fit scattered vertices (n, 3) by a least-squares bicubic spline."""
    import warnings

    from scipy.interpolate import LSQBivariateSpline

    per_knot = 6  # vertices per coefficient; with fewer the misfit would not measure the error
    n = math.sqrt(len(points) / per_knot)
    if n < 4:
        raise SceneError(
            f"wall.mesh has {counted(len(points), 'vertex', 'vertices')}, too few for a smooth "
            "surface; give at least 100"
        )
    ratio = math.sqrt(size[0] / size[1])
    counts = (max(2, round(n * ratio)), max(2, round(n / ratio)))
    low, high = points.min(axis=0), points.max(axis=0)
    # Without vertices the spline is free, and the misfit does not show it. Of random vertices, a
    # cell with a mean of 18 has none once in 7e7 cells.
    bins = [max(2, round(count / math.sqrt(18 / per_knot))) for count in counts]
    filled, cells = np.histogramdd(points[:, :2], bins, [(-side / 2, side / 2) for side in size])
    if not filled.all():
        empty = np.argwhere(filled == 0)[0]
        x, y = (edges[i : i + 2].mean() for edges, i in zip(cells, empty, strict=True))
        raise SceneError(
            f"wall.mesh has no vertices near x = {x:.3g} m, y = {y:.3g} m, where a smooth surface "
            f"of {size[0]:.3g} m by {size[1]:.3g} m needs some; cut the mesh to a rectangle about "
            "the origin, fill its holes, subdivide its large triangles, or give wall.smooth = false"
        )
    knots_x, knots_y = (np.linspace(low[i], high[i], counts[i] + 2)[1:-1] for i in (0, 1))
    with warnings.catch_warnings():
        # a rank-deficient fit needs no warning: its misfit is large
        warnings.simplefilter("ignore")
        spline = LSQBivariateSpline(points[:, 0], points[:, 1], points[:, 2], knots_x, knots_y)
    residual = float(abs(spline.ev(points[:, 0], points[:, 1]) - points[:, 2]).max())
    return spline, residual, (4 * counts[0], 4 * counts[1])
