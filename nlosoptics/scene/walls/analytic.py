"""Relay walls with analytic shapes: surfaces z = h(x, y) near the plane z = 0, facing +z.

``h > 0`` is toward the room. A wall holds only its shape; its scattering is
`Scene.wall_material`.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import one_of, pair, positive, real
from ..._nouns import Noun
from ...errors import SceneError

if TYPE_CHECKING:
    import trimesh

from ...kernels.codes import CYLINDER, GRID, PLANE, SPHERE, WAVE
from ..parts._quantities import Angle, Length

Array = NDArray[np.float64]


def _term(kind: int, *parameters: float) -> Array:
    """Return one row, (1, 8), of the table of height terms that the kernels take."""
    row = np.zeros((1, 8))
    row[0, 0] = kind
    row[0, 1 : 1 + len(parameters)] = parameters
    return row


class Wall(Noun):
    """Relay wall: the surface that scatters light from the hidden object to the camera.

    This is the common base class of the walls listed under See Also. The surface is a height
    h(x, y) above the plane z = 0, positive toward the room.

    Attributes
    ----------
    size : (float, float) or None
        Full width (x) and height (y) of the rectangular wall, m, centred on the origin; None for an
        unbounded wall.

    See Also
    --------
    FlatWall : Plane wall.
    ConcaveWall, ConvexWall, WavyWall : Curved walls.
    HeightMapWall : Wall from heights on a grid, measured or random.
    CallableWall : Wall from Python functions.
    MeshWall : Wall from a triangle mesh.
    """

    size: tuple[float, float] | None
    #: Whether kernels can evaluate the height, from the arrays that `compiled` returns.
    is_compiled = True
    #: Whether the wall is a height above each point of the plane z = 0, as waves need it.
    has_height = True

    @property
    def true_triangles(self) -> trimesh.Trimesh | None:
        """Triangles that rays meet in place of a height, world frame, m; None for other walls."""
        return None

    def compiled(self) -> tuple[Array, Array]:
        """Return the height function as arrays, the form in which compiled code needs it.

        Returns
        -------
        terms : ndarray, (n, 8)
            One row per term of a sum of heights: a code for the kind of surface (a constant of
            `kernels.codes`), then its parameters in SI units.
        tables : ndarray, (m,)
            Samples of all terms that are given on a grid. The row of such a term holds the index at
            which its samples start.

        Raises
        ------
        SceneError
            If the height is a Python function (`CallableWall`).
        """
        raise NotImplementedError

    @property
    def max_curvature(self) -> float:
        """Upper bound on the magnitude of the principal curvatures, 1/m; 0 for a plane."""
        raise NotImplementedError

    def _max_bend(self, size: tuple[float, float]) -> float:
        """Return an upper bound on the second derivatives of the height over ``size``, 1/m."""
        return self.max_curvature

    @property
    def _max_crease(self) -> float:
        """Upper bound on the gradient of the part of the height whose slopes jump; 0 without it."""
        return 0.0

    @property
    def finest_period(self) -> float:
        """Shortest lateral period of the height, m; infinite if it does not oscillate."""
        return math.inf

    @property
    def is_flat(self) -> bool:
        """Whether the height is zero everywhere."""
        return False

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Return whether points lie within the wall's edges.

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.
        """
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if self.size is None:
            return np.ones(np.broadcast(x, y).shape, dtype=bool)
        return np.asarray((abs(x) <= self.size[0] / 2) & (abs(y) <= self.size[1] / 2))

    def derivatives(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the height and its derivatives (h, hx, hy, hxx, hxy, hyy), (..., 6).

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.

        Returns
        -------
        ndarray, (..., 6)
            Height h in m, its slopes, and its second derivatives in 1/m.

        Raises
        ------
        SceneError
            If a coordinate is not finite, or the wall has no height there, for example beyond the
            rim of a sphere.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise SceneError("x or y holds NaN or infinity; give finite coordinates in m")
        out = self.surface_values(np.ravel(x), np.ravel(y))
        missing = ~np.isfinite(out[:, 0])
        if missing.any():
            i = int(np.argmax(missing))
            raise SceneError(
                f"the wall has no height at x = {x.flat[i]:g} m, y = {y.flat[i]:g} m; "
                "stay inside its radius, height map or mesh"
            )
        return out.reshape(*x.shape, 6)

    def surface_values(self, x: Array, y: Array) -> Array:
        """Return h, hx, hy, hxx, hxy, hyy, (n, 6), at n points; NaN where the wall has no height.

        Unlike `derivatives`, it raises no error at such points.

        Parameters
        ----------
        x, y : ndarray, (n,)
            World coordinates, m.
        """
        if self.is_flat:
            return np.zeros((len(x), 6))  # spares a first run the compilation of all shapes
        from ...kernels import heights

        out = np.empty((len(x), 6))
        terms, tables = self.compiled()
        heights.surfaces(terms, heights.tables_for(terms, tables), x, y, out)
        return out

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the height h(x, y), (...), m, positive toward the room.

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.
        """
        return self.derivatives(x, y)[..., 0]

    def normal(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the surface's unit normals toward the room, (..., 3), world frame.

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.
        """
        d = self.derivatives(x, y)
        normal = np.stack([-d[..., 1], -d[..., 2], np.ones(d.shape[:-1])], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def to_mesh(self, *, max_sag_error: float) -> trimesh.Trimesh:
        """Triangulate the wall on a regular grid.

        Parameters
        ----------
        max_sag_error : float
            Largest allowed distance in z between the mesh and the surface, m.

        Returns
        -------
        trimesh.Trimesh
            Mesh with vertices on the surface, world frame, m, and normals toward the room.

        Raises
        ------
        SceneError
            If the wall is unbounded, or reaches beyond the radius of a sphere or cylinder.
        MemoryLimitError
            If the mesh would not fit in memory.

        Notes
        -----
        The mesh splits square cells of side c into two triangles each. Every point of a triangle is
        within c / sqrt(2) of the midpoint of its longest side. With a bound b on the second
        derivatives of the height, the distance to the surface is therefore at most b c^2 / 4. A
        wall of plane facets with slopes up to g has creases, which can increase this distance by at
        most g c / sqrt(2).
        """
        import trimesh

        from ..._checks import fits_memory

        positive("max_sag_error", max_sag_error, unit="m")
        if self.size is None:
            raise SceneError("an unbounded wall has no mesh; give the wall a size in m")
        counts = (2, 2)
        bend = self._max_bend(self.size)
        if math.isinf(bend):
            raise SceneError(f"wall.size = {self.size} m exceeds a summand's radius; shrink it")
        crease = self._max_crease / math.sqrt(2.0)
        if max(bend, crease) > 0:
            # the positive root c of bend c^2 / 4 + crease c = max_sag_error
            root = math.sqrt(crease * crease + bend * max_sag_error)
            cell = min(2 * max_sag_error / (crease + root), self.finest_period / 4)
            counts = tuple(math.ceil(extent / cell) + 1 for extent in self.size)  # type: ignore[assignment]
        fits_memory("the wall's mesh", 200.0 * counts[0] * counts[1], "allow a larger sag error")
        x, y = (np.linspace(-s / 2, s / 2, n) for s, n in zip(self.size, counts, strict=True))
        gx, gy = np.meshgrid(x, y)
        vertices = np.stack([gx, gy, self.height(gx, gy)], axis=-1).reshape(-1, 3)
        corner = (np.arange(len(y) - 1)[:, None] * len(x) + np.arange(len(x) - 1)).ravel()
        a, b, c, d = corner, corner + 1, corner + len(x) + 1, corner + len(x)
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        return trimesh.Trimesh(vertices, faces, process=False)

    def _check_size(self) -> None:
        """Store ``size`` as a pair of extents above 0, m; raise `SceneError` otherwise."""
        if self.size is not None:
            object.__setattr__(self, "size", pair("wall.size", self.size))


@dataclass(frozen=True)
class FlatWall(Wall):
    """Flat wall: the plane z = 0.

    Parameters
    ----------
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.

    Raises
    ------
    SceneError
        If the size is not above 0.

    See Also
    --------
    ConcaveWall : Sphere or cylinder that focuses.
    HeightMapWall : Wall from measured heights.
    """

    _: KW_ONLY
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """Return the plane as the arrays described in `Wall.compiled`."""
        return _term(PLANE), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """Curvature of the plane, which is 0 (1/m)."""
        return 0.0

    @property
    def is_flat(self) -> bool:
        """True: the height is zero everywhere."""
        return True


@dataclass(frozen=True)
class _CurvedWall(Wall):
    """Base class of spherical and cylindrical walls."""

    radius: Length
    _: KW_ONLY
    size: tuple[float, float] | None = None
    shape: str = "sphere"
    axis: Annotated[str, ("x", "y")] = "y"

    _sign = 1.0

    def __post_init__(self) -> None:
        bend = "convex" if self._sign > 0 else "concave"
        remedy = f"a {bend} wall has a shape of its own, or give the signed wall.curvature"
        radius = positive("wall.radius", self.radius, unit="m", remedy=remedy)
        object.__setattr__(self, "radius", radius)
        one_of("wall.shape", self.shape, ("sphere", "cylinder"))
        one_of("wall.axis", self.axis, ("x", "y"))
        self._check_size()
        if self.size is not None and self._rim_sq(self.size) >= self.radius**2:
            raise SceneError(
                f"wall.size reaches {math.sqrt(self._rim_sq(self.size)):g} m from the vertex, "
                f"limit wall.radius = {self.radius:g} m; use a smaller wall or a larger radius"
            )

    def _rim_sq(self, size: tuple[float, float]) -> float:
        """Return the square of the largest distance from the vertex, or from the axis, m^2."""
        x, y = size
        if self.shape == "sphere":
            return (x * x + y * y) / 4
        across = x if self.axis == "y" else y
        return across * across / 4

    def compiled(self) -> tuple[Array, Array]:
        """Return the sphere or cylinder as one row of parameters; see `Wall.compiled`."""
        curvature = self._sign / self.radius
        if self.shape == "sphere":
            return _term(SPHERE, curvature), np.zeros(1)
        along_x = self.axis == "x"
        return _term(CYLINDER, curvature, float(not along_x), float(along_x)), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """Principal curvature, 1/radius everywhere, 1/m."""
        return 1.0 / self.radius

    def _max_bend(self, size: tuple[float, float]) -> float:
        """Return the largest second derivative, at the rim, 1/m; infinite beyond the radius."""
        cosine_sq = 1.0 - self._rim_sq(size) / self.radius**2
        return math.inf if cosine_sq <= 0 else 1.0 / (self.radius * cosine_sq**1.5)


@dataclass(frozen=True)
class ConcaveWall(_CurvedWall):
    """Concave wall: part of a sphere or cylinder, hollow toward the room, vertex at the origin.

    Parameters
    ----------
    radius : float
        Radius of curvature, m.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default a sphere is a
        full hemisphere: its points lie up to one radius from the z axis. A cylinder is by
        default unbounded along its axis, and has the cross-section of a full half circle.
    shape : {"sphere", "cylinder"}
        Kind of surface: part of a sphere, or part of a cylinder.
    axis : {"x", "y"}, default "y"
        Direction of a cylinder's axis; without effect for a sphere.

    Raises
    ------
    SceneError
        If a value is out of range or the size reaches beyond the radius.

    See Also
    --------
    ConvexWall : Sphere or cylinder that defocuses.
    SumWall : Sum of several walls' heights.

    Examples
    --------
    >>> from nlosoptics.scene import ConcaveWall
    >>> wall = ConcaveWall(5.0, size=1.0)
    >>> round(1e3 * float(wall.height(0.1, 0.0)), 4)
    1.0001
    >>> round(float(wall.normal(0.1, 0.0)[0]), 4)
    -0.02
    """


@dataclass(frozen=True)
class ConvexWall(_CurvedWall):
    """Convex wall: part of a sphere or cylinder, bulging toward the room, vertex at the origin.

    Parameters
    ----------
    radius : float
        Radius of curvature, m.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default a sphere is a
        full hemisphere: its points lie up to one radius from the z axis. A cylinder is by
        default unbounded along its axis, and has the cross-section of a full half circle.
    shape : {"sphere", "cylinder"}
        Kind of surface: part of a sphere, or part of a cylinder.
    axis : {"x", "y"}, default "y"
        Direction of a cylinder's axis; without effect for a sphere.

    Raises
    ------
    SceneError
        If a value is out of range or the size reaches beyond the radius.

    See Also
    --------
    ConcaveWall : Sphere or cylinder that focuses.
    SumWall : Sum of several walls' heights.
    """

    _sign = -1.0


@dataclass(frozen=True)
class WavyWall(Wall):
    """Wall whose height is a sine wave along one direction.

    The height is ``amplitude cos(2 pi s/period + phase)``, with s the distance from the origin
    along the direction of the wave.

    Parameters
    ----------
    amplitude : float
        Half the peak-to-valley height of the wave, m; a negative value shifts the phase by pi.
    period : float
        Period of the wave, m.
    phase : float, default 0
        Phase of the wave at the origin, rad; with 0 there is a crest.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.
    direction : float, default 0
        Direction in which the height varies, as an angle from +x toward +y, rad.

    Raises
    ------
    SceneError
        If a value is not finite, or period or size are not above 0.

    See Also
    --------
    SumWall : Sum of several walls' heights.
    CallableWall : Wall from Python functions.
    """

    amplitude: Length
    period: Length
    phase: Angle = 0.0
    _: KW_ONLY
    size: tuple[float, float] | None = None
    direction: Angle = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", real("wall.amplitude", self.amplitude))
        object.__setattr__(self, "period", positive("wall.period", self.period, unit="m"))
        object.__setattr__(self, "phase", real("wall.phase", self.phase))
        object.__setattr__(self, "direction", real("wall.direction", self.direction))
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """Return the parameters of the wave as the arrays described in `Wall.compiled`."""
        k = 2 * math.pi / self.period
        kx, ky = k * math.cos(self.direction), k * math.sin(self.direction)
        return _term(WAVE, self.amplitude, kx, ky, self.phase), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """Largest curvature, |amplitude| (2 pi/period)^2, at crests and troughs, 1/m."""
        return abs(self.amplitude) * (2 * math.pi / self.period) ** 2

    @property
    def finest_period(self) -> float:
        """Period of the wave, m; infinite if the amplitude is zero."""
        return self.period if self.amplitude else math.inf

    @property
    def is_flat(self) -> bool:
        """Whether the amplitude is zero."""
        return self.amplitude == 0.0


@dataclass(frozen=True, init=False)
class SumWall(Wall):
    """Wall whose height is the sum of the heights of several walls, for example two crossed waves.

    Parameters
    ----------
    *terms : Wall
        Walls whose heights are added; their own sizes are ignored.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.

    Raises
    ------
    SceneError
        If a term is not a wall, or is a `CallableWall`.

    See Also
    --------
    WavyWall : Sinusoidal wall.
    HeightMapWall : Wall from measured heights.

    Examples
    --------
    >>> import math
    >>> from nlosoptics.scene import SumWall, WavyWall
    >>> wave, crossed = WavyWall(1e-4, 0.25), WavyWall(1e-4, 0.25, direction=math.pi / 2)
    >>> wall = SumWall(wave, crossed, size=1.0)
    >>> round(1e3 * float(wall.height(0.0, 0.0)), 3)
    0.2
    """

    terms: tuple[Wall, ...]
    size: tuple[float, float] | None

    def __init__(self, *terms: Any, size: Any = None) -> None:
        if len(terms) == 1 and isinstance(terms[0], (list, tuple)):
            terms = tuple(terms[0])
        if not terms or not all(isinstance(t, Wall) for t in terms):
            raise SceneError(f"SumWall got {terms!r}; give at least one wall")
        if not all(term.is_compiled for term in terms):
            raise SceneError(
                "SumWall cannot add a CallableWall; add the other heights in its functions instead"
            )
        object.__setattr__(self, "terms", terms)
        object.__setattr__(self, "size", size)
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """Return the arrays of all terms, concatenated; see `Wall.compiled`."""
        rows, tables, offset = [], [np.zeros(1)], 1
        for term in self.terms:
            row, table = term.compiled()
            row = row.copy()
            row[row[:, 0] == GRID, 7] += offset
            rows.append(row)
            tables.append(table)
            offset += len(table)
        return np.concatenate(rows), np.concatenate(tables)

    @property
    def max_curvature(self) -> float:
        """Upper bound on the principal curvatures, 1/m: the sum of the terms' bounds."""
        return sum(term.max_curvature for term in self.terms)

    def _max_bend(self, size: tuple[float, float]) -> float:
        """Return the sum of the summands' bounds on the second derivatives, 1/m."""
        return sum(term._max_bend(size) for term in self.terms)

    @property
    def _max_crease(self) -> float:
        """Sum of the summands' bounds."""
        return sum(term._max_crease for term in self.terms)

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the sum of the terms' heights, (...), m, positive toward the room.

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.
        """
        # not from `derivatives`, since reliefs are much faster at many points together
        return np.asarray(sum((term.height(x, y) for term in self.terms), 0.0))

    @property
    def finest_period(self) -> float:
        """Shortest period of the terms, m; infinite if no term oscillates."""
        return min(term.finest_period for term in self.terms)

    @property
    def is_flat(self) -> bool:
        """Whether every term is flat."""
        return all(term.is_flat for term in self.terms)
