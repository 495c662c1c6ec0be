"""Rough walls: unbounded random reliefs, each determined by its seed, without stored heights."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import in_range, positive, whole
from ..._random import philox
from ...errors import SceneError
from ...kernels.codes import BUMPS, EXTREME, FACETS
from ..parts._quantities import Angle, Length
from .analytic import Array, Wall, _term


def relief_limits(row: Array) -> tuple[float, float]:
    """Return bounds of a relief's term: magnitude of the height, m, and curvature, 1/m.

    No draw exceeds the height. Facets are plane; on bumps the bound is 8.65 times the rms of the
    second derivative, which a correlation area exceeds with a probability of about 1e-15.
    """
    length, rms = row[1], row[2]
    if row[0] == FACETS:
        return float(EXTREME * rms), 0.0
    # the weights of the draws sum to 2 sqrt(pi), apart from a ripple of less than 1e-8
    height = 2.0 * math.sqrt(math.pi) * (1.0 + 1e-7) * EXTREME * rms
    return float(height), float(EXTREME * math.sqrt(12.0) * rms / length**2)


class _Relief(Wall):
    """Base class of random reliefs."""

    #: Predicted seconds to find a ray's wall point, and per point of a phase screen.
    ray_seconds: ClassVar[float]
    screen_seconds: ClassVar[float]

    seed: int

    def _offset(self) -> tuple[float, float]:
        """Return the random place of the lattice in units of its cell, each in [0, 1)."""
        address = np.array([0, 0, 0, 303], dtype=np.uint32)
        words = philox(address, self.seed).astype(np.float64)
        along, across = (
            np.floor(w / 64) * 2.0**27 + np.floor(v / 32) for w, v in (words[:2], words[2:])
        )
        return float(along / 2.0**53), float(across / 2.0**53)

    def _row(self, kind: int, length: float, rms: float, offset: tuple[float, float]) -> Array:
        """Return the relief's height term, (1, 8)."""
        return _term(kind, length, rms, self.seed & 0xFFFFFFFF, self.seed >> 32, *offset)

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the height h(x, y), (...), m, positive toward the room.

        The values equal those of `derivatives` bit for bit. For many points this method is faster,
        since each random number is drawn only once.

        Parameters
        ----------
        x, y : array_like, (...)
            World coordinates, m; shapes broadcast.

        Raises
        ------
        SceneError
            If a coordinate is not finite, or a point is more than 2^31 cells of the random lattice
            from the origin.
        """
        from ...kernels.relief import relief_heights

        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise SceneError("x or y holds NaN or infinity; give finite coordinates in m")
        out = np.empty(x.size)
        relief_heights(self.compiled()[0][0], np.ravel(x), np.ravel(y), out)
        if not np.isfinite(out).all():
            i = int(np.argmax(~np.isfinite(out)))
            raise SceneError(
                f"x = {x.flat[i]:g} m, y = {y.flat[i]:g} m is more than 2^31 cells of the relief "
                "from the origin; use larger cells or stay nearer"
            )
        return out.reshape(x.shape)

    @property
    def max_height(self) -> float:
        """Upper bound on the magnitude of the height, m, which no random height exceeds."""
        return relief_limits(self.compiled()[0][0])[0]

    @property
    def max_curvature(self) -> float:
        """Bound on the second derivatives of the height, 1/m.

        It is 0 for plane facets. For smooth random heights it is 8.65 times the rms of the second
        derivatives, which are larger at a point with a probability of about 1e-15.
        """
        return relief_limits(self.compiled()[0][0])[1]


@dataclass(frozen=True)
class FacetWall(_Relief):
    """Wall of plane random facets: equilateral triangles whose corners have random heights.

    Parameters
    ----------
    cell : float
        Side of a triangular facet, m.
    slope_rms : float
        Rms slope of the facets along each axis, rad, 0 to 1. The slopes are Gaussian and isotropic.
    seed : int
        Seed of the random heights, 0 to 2^64 - 1. The same seed gives the same surface.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.

    Attributes
    ----------
    node_rms : float
        Rms height of the triangles' corners, m.
    height_rms : float
        Rms height averaged over the area of the triangles, m.

    Raises
    ------
    SceneError
        If a value is out of range.

    Notes
    -----
    The corners of the triangles form a lattice. Their heights are independent Gaussian draws of rms
    s. With triangles of side c, the slope along each axis has the rms ``sqrt(2) s / c``. The rms of
    the height is s at a corner, s/sqrt(3) in the middle of a facet, and s/sqrt(2) averaged over the
    area. The seed determines the height of every corner and the position of the lattice. The
    position is uniformly distributed, so that the ensemble of all seeds has the same statistics at
    every point of the wall.

    See Also
    --------
    GaussianWall : Smooth random heights with a Gaussian autocorrelation.

    Examples
    --------
    >>> from nlosoptics.scene import FacetWall
    >>> wall = FacetWall(1e-3, 2e-3, seed=1)
    >>> round(1e6 * wall.node_rms, 3), round(1e6 * wall.height_rms, 3)
    (1.414, 1.0)
    >>> bool(abs(wall.height(0.3, 0.4)) <= wall.max_height)
    True
    """

    ray_seconds: ClassVar[float] = 2e-6
    screen_seconds: ClassVar[float] = 7e-8

    cell: Length
    slope_rms: Angle
    _: KW_ONLY
    seed: int = 0
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "cell", positive("wall.cell", self.cell, unit="m"))
        slope = in_range("wall.slope_rms", self.slope_rms, 0.0, 1.0, unit="rad")
        object.__setattr__(self, "slope_rms", slope)
        object.__setattr__(self, "seed", whole("wall.seed", self.seed, 0, 2**64 - 1))
        self._check_size()

    @property
    def node_rms(self) -> float:
        """Rms height of the triangles' corners, m."""
        return self.cell * self.slope_rms / math.sqrt(2.0)

    @property
    def height_rms(self) -> float:
        """Rms height averaged over the area of the triangles, m."""
        return self.node_rms / math.sqrt(2.0)

    def compiled(self) -> tuple[Array, Array]:
        """Return the parameters of the facets as the arrays described in `Wall.compiled`."""
        a, b = self._offset()
        offset = (self.cell * (a + 0.5 * b), self.cell * math.sqrt(0.75) * b)
        return self._row(FACETS, self.cell, self.node_rms, offset), np.zeros(1)

    @property
    def _max_crease(self) -> float:
        """Gradient of a facet whose opposite nodes have the extreme draws of both signs."""
        return 2.0 * EXTREME * self.node_rms / (math.sqrt(0.75) * self.cell)

    @property
    def finest_period(self) -> float:
        """Shortest period of the corners' heights, m: sqrt(3) times ``cell``; infinite if flat."""
        return math.sqrt(3.0) * self.cell if self.slope_rms else math.inf

    @property
    def is_flat(self) -> bool:
        """Whether the rms slope is zero, so that every height is zero."""
        return self.slope_rms == 0.0


@dataclass(frozen=True)
class GaussianWall(_Relief):
    """Wall with smooth random heights: a stationary Gaussian process, computed from a seed.

    The autocorrelation of the heights at distance r is ``exp(-r^2/l^2)``, with correlation length
    l. No heights are stored, so that the wall may have any extent.

    Parameters
    ----------
    height_rms : float
        Rms height, m.
    correlation_length : float
        Distance l at which the autocorrelation of the heights has fallen to 1/e, m.
    seed : int
        Seed of the random heights, 0 to 2^64 - 1. The same seed gives the same surface.
    size : float or (float, float), optional
        Full extent of the wall in x and y, m; one number for a square. By default the wall is
        unbounded.

    Attributes
    ----------
    slope_rms : float
        Rms slope along each axis, ``sqrt(2) height_rms / l``, rad.

    Raises
    ------
    SceneError
        If a value is out of range, or the rms slope exceeds 1.

    Notes
    -----
    Independent Gaussian draws on a square lattice of pitch l/2 are convolved with the kernel
    ``exp(-2 r^2/l^2)``. The seed determines all draws and the position of the lattice. For one
    position of the lattice, the variance of the height varies along the wall by 2e-4 of its value.
    The position is uniformly distributed, so that the ensemble of all seeds has the same statistics
    at every point of the wall, and exactly the stated autocorrelation.

    See Also
    --------
    FacetWall : Wall of plane random facets.
    HeightMapWall.random : Random heights stored on a grid, with other autocorrelations too.

    Examples
    --------
    >>> from nlosoptics.scene import GaussianWall
    >>> wall = GaussianWall(1e-6, 1e-3, seed=1)
    >>> round(1e3 * wall.slope_rms, 3)
    1.414
    """

    ray_seconds: ClassVar[float] = 8e-5
    screen_seconds: ClassVar[float] = 2.2e-7

    height_rms: Length
    correlation_length: Length
    _: KW_ONLY
    seed: int = 0
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        height = in_range("wall.height_rms", self.height_rms, 0.0, unit="m")
        length = positive("wall.correlation_length", self.correlation_length, unit="m")
        object.__setattr__(self, "height_rms", height)
        object.__setattr__(self, "correlation_length", length)
        object.__setattr__(self, "seed", whole("wall.seed", self.seed, 0, 2**64 - 1))
        if not self.slope_rms <= 1.0:
            raise SceneError(
                f"wall.height_rms = {height:g} m with wall.correlation_length = {length:g} m has "
                f"the slope rms {self.slope_rms:g}, limit 1; use lower heights or a longer length"
            )
        self._check_size()

    @property
    def slope_rms(self) -> float:
        """Rms slope along each axis, rad."""
        return math.sqrt(2.0) * self.height_rms / self.correlation_length

    def compiled(self) -> tuple[Array, Array]:
        """Return the parameters of the heights as the arrays described in `Wall.compiled`."""
        length = self.correlation_length
        a, b = self._offset()
        offset = (0.5 * length * a, 0.5 * length * b)
        return self._row(BUMPS, length, self.height_rms, offset), np.zeros(1)

    @property
    def finest_period(self) -> float:
        """Shortest relevant period of the heights, m: the correlation length; infinite if flat.

        Shorter periods have a spectral density below exp(-pi^2) = 5e-5 of the maximum.
        """
        return self.correlation_length if self.height_rms else math.inf

    @property
    def is_flat(self) -> bool:
        """Whether every height is zero."""
        return self.height_rms == 0.0
