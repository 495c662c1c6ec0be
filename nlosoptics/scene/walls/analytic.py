"""Relay walls: smooth mean surfaces z = h(x, y) about the plane z = 0, facing +z.

``height > 0`` is toward the room. A wall knows its shape only; what it is made of is
`Scene.wall_material`.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import one_of, pair, positive, real
from ..._nouns import Noun
from ...errors import SceneError

if TYPE_CHECKING:
    import trimesh

from ...kernels.codes import CYLINDER, GRID, PLANE, SPHERE, WAVE

Array = NDArray[np.float64]


def _term(kind: int, *parameters: float) -> Array:
    row = np.zeros((1, 8))
    row[0, 0] = kind
    row[0, 1 : 1 + len(parameters)] = parameters
    return row


class Wall(Noun):
    """Base of all relay walls.

    Attributes
    ----------
    size : (float, float) or None
        Extent in x and y, m, centred on the origin; None for an unbounded wall.
    """

    size: tuple[float, float] | None
    #: Whether `compiled` has the height.
    is_compiled = True

    def compiled(self) -> tuple[Array, Array]:
        """Height function as the kernels take it.

        Returns
        -------
        terms : ndarray, (n, 8)
            A summand a row: its kind, one of `PLANE` to `GRID`, and its parameters in SI units.
        tables : ndarray, (m,)
            Samples of grids, at the places that their rows name.

        Raises
        ------
        SceneError
            If the wall is one of Python functions, as a `CallableWall` is.
        """
        raise NotImplementedError

    @property
    def max_curvature(self) -> float:
        """Bound on the principal curvatures, 1/m, over the wall; 0 for a plane."""
        raise NotImplementedError

    def _max_bend(self, size: tuple[float, float]) -> float:
        """Bound on the second derivatives of the height, 1/m, over ``size``."""
        return self.max_curvature

    @property
    def finest_period(self) -> float:
        """Shortest lateral scale on which the height turns around, m; inf if it never does."""
        return math.inf

    @property
    def is_flat(self) -> bool:
        """Whether the height is zero everywhere."""
        return False

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Whether (x, y), m, lies within the wall's edges."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if self.size is None:
            return np.ones(np.broadcast(x, y).shape, dtype=bool)
        return np.asarray((abs(x) <= self.size[0] / 2) & (abs(y) <= self.size[1] / 2))

    def derivatives(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height and its derivatives (h, hx, hy, hxx, hxy, hyy), shape (..., 6).

        Parameters
        ----------
        x, y : array_like
            World coordinates, m.

        Raises
        ------
        SceneError
            Where the wall has no height, as beyond the rim of a sphere.
        """
        from ...kernels import heights

        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise SceneError("x or y holds NaN or infinity; give finite coordinates in m")
        out = np.empty((x.size, 6))
        heights.surfaces(*self.compiled(), np.ravel(x), np.ravel(y), out)
        missing = ~np.isfinite(out[:, 0])
        if missing.any():
            i = int(np.argmax(missing))
            raise SceneError(
                f"the wall has no height at x = {x.flat[i]:g} m, y = {y.flat[i]:g} m; "
                "stay inside its radius or mesh"
            )
        return out.reshape(*x.shape, 6)

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height h(x, y), m, toward the room."""
        return self.derivatives(x, y)[..., 0]

    def normal(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Unit normal toward the room, shape (..., 3), world frame."""
        d = self.derivatives(x, y)
        normal = np.stack([-d[..., 1], -d[..., 2], np.ones(d.shape[:-1])], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def to_mesh(self, *, max_sag_error: float) -> trimesh.Trimesh:
        """Triangulate the wall on a regular grid.

        Parameters
        ----------
        max_sag_error : float
            Largest distance between the mesh and the surface, m. Half a cell of side c lies within
            c / sqrt(2) of its longest side's middle, so that second derivatives of at most b part
            it from the surface by at most b c^2 / 4.

        Returns
        -------
        trimesh.Trimesh
            Vertices on the surface, normals toward the room.

        Raises
        ------
        SceneError
            If the wall is unbounded.
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
        if bend > 0:
            cell = min(math.sqrt(4 * max_sag_error / bend), self.finest_period / 4)
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
        if self.size is not None:
            object.__setattr__(self, "size", pair("wall.size", self.size))


@dataclass(frozen=True)
class FlatWall(Wall):
    """The plane z = 0.

    Parameters
    ----------
    size : float or (float, float), optional
        Full extent in x and y, m; None for an unbounded wall.
    """

    _: KW_ONLY
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """One plane."""
        return _term(PLANE), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """Zero."""
        return 0.0

    @property
    def is_flat(self) -> bool:
        """True."""
        return True


@dataclass(frozen=True)
class _CurvedWall(Wall):
    radius: float
    _: KW_ONLY
    size: tuple[float, float] | None = None
    shape: str = "sphere"
    axis: str = "y"

    _sign = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("wall.radius", self.radius, unit="m"))
        one_of("wall.shape", self.shape, ("sphere", "cylinder"))
        one_of("wall.axis", self.axis, ("x", "y"))
        self._check_size()
        if self.size is not None and self._rim_sq(self.size) >= self.radius**2:
            raise SceneError(
                f"wall.size reaches {math.sqrt(self._rim_sq(self.size)):g} m from the vertex, "
                f"limit wall.radius = {self.radius:g} m; use a smaller wall or a larger radius"
            )

    def _rim_sq(self, size: tuple[float, float]) -> float:
        """Square of the largest distance from the vertex across the curvature, m^2."""
        x, y = size
        if self.shape == "sphere":
            return (x * x + y * y) / 4
        across = x if self.axis == "y" else y
        return across * across / 4

    def compiled(self) -> tuple[Array, Array]:
        """One sphere or cylinder."""
        curvature = self._sign / self.radius
        if self.shape == "sphere":
            return _term(SPHERE, curvature), np.zeros(1)
        along_x = self.axis == "x"
        return _term(CYLINDER, curvature, float(not along_x), float(along_x)), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """1/radius, the principal curvature everywhere."""
        return 1.0 / self.radius

    def _max_bend(self, size: tuple[float, float]) -> float:
        cosine_sq = 1.0 - self._rim_sq(size) / self.radius**2
        return math.inf if cosine_sq <= 0 else 1.0 / (self.radius * cosine_sq**1.5)


@dataclass(frozen=True)
class ConcaveWall(_CurvedWall):
    """Sphere or cylinder, hollow toward the room, vertex at the origin.

    Parameters
    ----------
    radius : float
        Radius of curvature, m.
    size : float or (float, float), optional
        Full extent in x and y, m; None for as far as the surface goes.
    shape : {"sphere", "cylinder"}
    axis : {"x", "y"}, default "y"
        Direction of a cylinder's axis; a sphere has none.
    """


@dataclass(frozen=True)
class ConvexWall(_CurvedWall):
    """Sphere or cylinder, bulging toward the room, vertex at the origin.

    Parameters are those of `ConcaveWall`.
    """

    _sign = -1.0


@dataclass(frozen=True)
class WavyWall(Wall):
    """One-dimensional wave, h = amplitude cos(2 pi s/period + phase).

    Parameters
    ----------
    amplitude : float
        Half of peak to valley, m; its sign is a shift of phase.
    period : float
        Wavelength of the wave, m.
    phase : float, default 0
        Phase at the origin, rad.
    size : float or (float, float), optional
        Full extent in x and y, m.
    direction : float, default 0
        Angle from +x toward +y of the coordinate s, rad.
    """

    amplitude: float
    period: float
    phase: float = 0.0
    _: KW_ONLY
    size: tuple[float, float] | None = None
    direction: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", real("wall.amplitude", self.amplitude))
        object.__setattr__(self, "period", positive("wall.period", self.period, unit="m"))
        object.__setattr__(self, "phase", real("wall.phase", self.phase))
        object.__setattr__(self, "direction", real("wall.direction", self.direction))
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """One wave."""
        k = 2 * math.pi / self.period
        kx, ky = k * math.cos(self.direction), k * math.sin(self.direction)
        return _term(WAVE, self.amplitude, kx, ky, self.phase), np.zeros(1)

    @property
    def max_curvature(self) -> float:
        """|amplitude| (2 pi/period)^2, reached on the crests."""
        return abs(self.amplitude) * (2 * math.pi / self.period) ** 2

    @property
    def finest_period(self) -> float:
        """The period."""
        return self.period if self.amplitude else math.inf

    @property
    def is_flat(self) -> bool:
        """Whether the amplitude is zero."""
        return self.amplitude == 0.0


@dataclass(frozen=True, init=False)
class SumWall(Wall):
    """Sum of the heights of several walls, such as two crossed waves.

    Parameters
    ----------
    *terms : Wall
        Summands; their own sizes do not count.
    size : float or (float, float), optional
        Full extent in x and y, m.
    """

    terms: tuple[Wall, ...]
    size: tuple[float, float] | None

    def __init__(self, *terms: Any, size: Any = None) -> None:
        if len(terms) == 1 and isinstance(terms[0], (list, tuple)):
            terms = tuple(terms[0])
        if not terms or not all(isinstance(t, Wall) for t in terms):
            raise SceneError(f"SumWall got {terms!r}; give at least one wall")
        if not all(term.is_compiled for term in terms):
            raise SceneError("SumWall cannot add a CallableWall; add the others in its functions")
        object.__setattr__(self, "terms", terms)
        object.__setattr__(self, "size", size)
        self._check_size()

    def compiled(self) -> tuple[Array, Array]:
        """Terms of all summands, their tables joined."""
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
        """Sum of the summands' bounds."""
        return sum(term.max_curvature for term in self.terms)

    def _max_bend(self, size: tuple[float, float]) -> float:
        return sum(term._max_bend(size) for term in self.terms)

    @property
    def finest_period(self) -> float:
        """The shortest of the summands'."""
        return min(term.finest_period for term in self.terms)

    @property
    def is_flat(self) -> bool:
        """Whether every summand is."""
        return all(term.is_flat for term in self.terms)
