"""Relay wall, its points and the time bins of a capture to render."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import Vector, in_range, pair, positive, real, vector, whole
from ...errors import SceneError
from ..capture.capture import Pairing
from ..capture.wall_points import checked_points, pair_shape, points_on_wall

Array = NDArray[np.float64]


class Frame(NamedTuple):
    """Frame of a relay wall: its unit axes as rows, the last into the room, and its origin, m."""

    axes: Array
    origin: Array

    def inside(self, points: ArrayLike) -> Array:
        """Return points (..., 3) of the world in this frame."""
        return np.asarray((np.asarray(points) - self.origin) @ self.axes.T)


@dataclass(frozen=True, eq=False, kw_only=True)
class Scan:
    """Relay wall, its points and the time bins of a capture to render.

    Parameters
    ----------
    laser_points, sensor_points : array_like
        Points on the wall that are lit, (*laser_shape, 3), and observed, (*sensor_shape, 3), m;
        `wall_grid` makes a square grid of them. A single point may have shape (3,).
    t_start, delta_t : float
        Start of bin 0 and width of a bin, m of optical path.
    n_bins : int
        Number of bins.
    pairing : {"all", "confocal"}
        "all": every laser point with every sensor point. "confocal": laser point i with sensor
        point i only.
    outer_legs : bool
        Whether times include the outer legs: the paths from ``laser_origin`` to the wall and from
        the wall to ``sensor_origin``. If False, times begin at the laser point and end at the
        sensor point.
    laser_origin, sensor_origin : (float, float, float), optional
        Positions of laser and sensor, world frame, m. Both are required with ``outer_legs``.
    wall_albedo : float
        Albedo of the wall, above 0 and at most 1.
    wall_size : float or (float, float), optional
        Sides of a wall about the origin, m, that also reflects light between hidden surfaces, as in
        wall, object, wall, object, wall. None: it reflects only at laser and sensor points.
    wall_normal : (float, float, float), optional
        Direction from a tilted wall into the room; all points lie in one plane across it. None: the
        wall is the plane z = 0, and the room at z > 0. A ``wall_size`` is about that point of a
        tilted wall's plane which is nearest to the origin.

    Raises
    ------
    SceneError, SamplingError
        If a value is invalid, the points do not lie on one wall, or they do not form pairs.

    See Also
    --------
    render : Capture of hidden meshes at these points.

    Examples
    --------
    >>> from nlosoptics.transient import Scan, wall_grid
    >>> points = wall_grid(side=1.0, count=4)
    >>> scan = Scan(
    ...     laser_points=(0, 0, 0), sensor_points=points, t_start=1.0, delta_t=0.01, n_bins=200
    ... )
    >>> scan.shape
    (200, 4, 4)
    """

    laser_points: Any
    sensor_points: Any
    t_start: float
    delta_t: float
    n_bins: int
    pairing: Pairing = "all"
    outer_legs: bool = False
    laser_origin: Vector | None = None
    sensor_origin: Vector | None = None
    wall_albedo: float = 1.0
    wall_size: float | tuple[float, float] | None = None
    wall_normal: Vector | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "t_start", real("t_start", self.t_start))
        put(self, "delta_t", positive("delta_t", self.delta_t, unit="m"))
        put(self, "n_bins", whole("n_bins", self.n_bins))
        put(self, "outer_legs", bool(self.outer_legs))
        put(self, "wall_albedo", in_range("wall_albedo", self.wall_albedo, 0.0, 1.0, open_low=True))
        if self.wall_size is not None:
            put(self, "wall_size", pair("wall_size", self.wall_size))
        for name in ("laser_origin", "sensor_origin", "wall_normal"):
            if getattr(self, name) is not None:
                put(self, name, vector(name, getattr(self, name)))
        if self.wall_normal is not None and not any(self.wall_normal):
            raise SceneError("wall_normal is (0, 0, 0), must not be; give a direction")
        on_wall = points_on_wall if self.wall_normal is None else checked_points
        for name in ("laser_points", "sensor_points"):
            put(self, name, on_wall(name, getattr(self, name)))
        pair_shape(self.pairing, self.laser_points.shape[:-1], self.sensor_points.shape[:-1])
        for name in ("laser_points", "sensor_points"):
            off = float(np.abs(self.frame.inside(getattr(self, name))[..., 2]).max())
            if off > 1e-9:
                raise SceneError(
                    f"{name} are up to {off:g} m off the plane of the first laser point across "
                    "wall_normal, limit 1e-09 m; move them onto it"
                )
        if self.outer_legs:
            for name in ("laser_origin", "sensor_origin"):
                self._check_origin(name)

    def _check_origin(self, name: str) -> None:
        origin = getattr(self, name)
        if origin is None:
            raise SceneError(f"outer_legs = True needs {name}; give its position (x, y, z) in m")
        height = float(self.frame.inside(origin)[2])
        if not height > 0.0:
            which = f"{name}[z]" if self.wall_normal is None else f"height of {name} over the wall"
            raise SceneError(
                f"{which} = {height:g} m is out of range, must be above 0; move it in front of the "
                "wall"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the capture: bins, then points."""
        lasers, sensors = self.laser_points.shape[:-1], self.sensor_points.shape[:-1]
        return (self.n_bins, *pair_shape(self.pairing, lasers, sensors))

    @cached_property
    def frame(self) -> Frame:
        """Frame of the wall: its origin is the point of its plane next to the world's origin."""
        if self.wall_normal is None:
            return Frame(np.eye(3), np.zeros(3))
        n = np.array(self.wall_normal) / math.hypot(*self.wall_normal)
        right = np.cross((0.0, 1.0, 0.0), n)
        if not right.any():
            right = np.array([1.0, 0.0, 0.0])
        right /= np.linalg.norm(right)
        origin = n * (n @ self.laser_points.reshape(-1, 3)[0])
        return Frame(np.stack([right, np.cross(n, right), n]), origin)

    def in_wall_frame(self, points: Array) -> Array:
        """Return points (..., 3) in the frame of the wall, in its plane z = 0."""
        inside = self.frame.inside(points)
        inside[..., 2] = 0.0
        return inside

    @property
    def pairs(self) -> tuple[Array, Array, Array]:
        """Points of laser and sensor (n, 3) for all pairs, wall's frame, and outer legs (n,), m."""
        both = (self.laser_points.reshape(-1, 3), self.sensor_points.reshape(-1, 3))
        legs = [np.zeros(len(points)) for points in both]
        if self.outer_legs:
            origins: Any = (self.laser_origin, self.sensor_origin)
            legs = [np.linalg.norm(p - o, axis=1) for p, o in zip(both, origins, strict=True)]
        first, second = (self.in_wall_frame(points) for points in both)
        if self.pairing == "all":
            repeats = len(second)
            second = np.tile(second, (len(first), 1))
            legs[1] = np.tile(legs[1], len(first))
            first, legs[0] = np.repeat(first, repeats, axis=0), np.repeat(legs[0], repeats)
        return first, second, legs[0] + legs[1]
