"""Rendering of captures from meshes: checks, and the assembly of all bounces."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import Vector, in_range, one_of, pair, positive, real, vector, whole
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError, SceneError
from ...scene import Material
from ..capture.capture import Pairing, TransientCapture
from ..capture.wall_points import pair_shape, points_on_wall
from .multiple_bounces import LEAST, MultipleBounces, multiple_bounces
from .surfaces import hidden_surfaces
from .three_bounces import ThreeBounces, three_bounces

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Setting:
    """Checked wall points, and the factor from G to the requested quantity."""

    laser_points: Array
    sensor_points: Array
    pairing: Pairing
    lasers: Array  # (pairs, 3), m
    sensors: Array
    legs: Array  # (pairs,), outer legs included in the times, m
    factor: float  # requested quantity over G without the wall's albedo

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the capture behind its time axis."""
        lasers, sensors = self.laser_points.shape[:-1], self.sensor_points.shape[:-1]
        return pair_shape(self.pairing, lasers, sensors)

    def bins(self, values: Array) -> Array:
        """Convert G (pairs, n_bins) to the requested quantity (n_bins, *shape)."""
        scaled = np.ascontiguousarray((values * self.factor).T)
        return scaled.reshape(len(scaled), *self.shape)

    def details(self, three: ThreeBounces | None) -> dict[str, Any]:
        """Return the details of three bounces for a capture; empty if they were not computed."""
        if three is None:
            return {}
        return {
            "error_estimate": self.factor * three.error.reshape(self.shape),
            "before": self.factor * three.before.reshape(self.shape),
            "after": self.factor * three.after.reshape(self.shape),
            "parts": three.parts.reshape(self.shape),
            "shadows": three.shadows,
        }


def render(
    surfaces: Iterable[tuple[trimesh.Trimesh, Material]],
    *,
    laser_points: ArrayLike,
    sensor_points: ArrayLike,
    pairing: Pairing = "all",
    wall_albedo: float = 1.0,
    t_start: float,
    delta_t: float,
    n_bins: int,
    min_bounces: int = 3,
    max_bounces: int = 5,
    quantity: Literal["irradiance", "radiance", "radiosity"] = "irradiance",
    outer_legs: bool = False,
    laser_origin: Vector | None = None,
    sensor_origin: Vector | None = None,
    tol: float = 1e-3,
    tol_multiple: float = 1e-2,
    n_rays: int | None = None,
    wall_size: float | tuple[float, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> TransientCapture:
    """Compute the light over time that hidden meshes scatter back to a Lambertian relay wall.

    The laser lights points of the wall, and the light returns to points of the wall via the meshes.
    Times are given as optical path, the length that the light has travelled: 1 m is 3.34 ns.

    Parameters
    ----------
    surfaces : iterable of (trimesh.Trimesh, Material)
        Hidden meshes, world frame, m, and their materials: any of `nlosoptics.scene` except a
        mirror of zero slope. Both sides of a triangle scatter alike. Meshes lie in front of the
        wall z = 0 and may touch it.
    laser_points, sensor_points : array_like
        Points on the wall z = 0 that are lit, (*laser_shape, 3), and observed, (*sensor_shape, 3),
        m; `wall_grid` makes a square grid of them. A single point may have shape (3,).
    pairing : {"all", "confocal"}
        "all": every laser point with every sensor point. "confocal": laser point i with sensor
        point i only.
    wall_albedo : float
        Albedo of the relay wall, above 0 and at most 1.
    t_start, delta_t : float
        Start of bin 0 and width of a bin, m of optical path.
    n_bins : int
        Number of bins.
    min_bounces, max_bounces : int
        Least and greatest number of reflections (bounces) of a path, 3 to 32, including the two at
        the wall. ``min_bounces`` above 3 omits shorter paths, for example to average several seeds
        without computing three bounces again, which use no random numbers.
    quantity : {"irradiance", "radiance", "radiosity"}
        Quantity at the sensor points, per W of laser power on the wall: irradiance E in W/m^2,
        radiance ``wall_albedo E/pi`` in W/(m^2 sr), or radiosity ``wall_albedo E`` in W/m^2.
        A bin has the sum over all paths whose length lies in the bin; it is not divided by the
        width of the bin. For a laser of constant power, the quantity is the sum of all bins. For a
        short pulse, a bin of the irradiance is the energy per area that arrives within the bin, per
        J of the pulse.
    outer_legs : bool
        Whether times include the outer legs: the paths from ``laser_origin`` to the wall and from
        the wall to ``sensor_origin``. If False, times begin at the laser point and end at the
        sensor point.
    laser_origin, sensor_origin : (float, float, float), optional
        Positions of laser and sensor, world frame, m. Both are required with ``outer_legs``.
    tol, tol_multiple : float
        Errors allowed for each pair of points: sum of the absolute errors of all bins, relative to
        the sum of their values. ``tol`` is for the light of three bounces. ``tol_multiple`` is for
        the light of four bounces, of five, and so on; each of these parts must meet it. They are
        computed with random numbers, so that it limits the expected error.
    n_rays : int, optional
        Largest number of random paths with more than three bounces, at least 8. None: as many as
        take about ten minutes on one core.
    wall_size : float or (float, float), optional
        Sides of a wall about the origin, m, that also reflects light between hidden surfaces, as in
        wall, object, wall, object, wall. None: the wall reflects only at laser and sensor points.
    seed : int
        Seed of the random paths, 0 to 2^64 - 1. Results are identical for any number of threads.
        Three bounces use no random numbers.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    TransientCapture
        Capture with the histograms ``H``, their parts by number of bounces ``by_bounce``, and the
        ``standard_error`` of H (0 for three bounces); see `TransientCapture`. Its ``details``
        tell how it was computed. For three bounces they have arrays with one value for each pair of
        points: "error_estimate" (change in the last refinement, summed over bins), "before" and
        "after" (signal outside the bins), and "parts" (number of parts into which the surfaces were
        divided); "shadows" is True if the meshes were searched for shadows. For more bounces,
        "multiple_bounces" has the number of paths, the errors reached and the reason to stop: "tol"
        if ``tol_multiple`` was reached, "paths" if ``n_rays`` was reached first, or "dark" if some
        number of bounces contributes nothing to the bins.

    Raises
    ------
    SceneError
        If a surface, a point or an option is invalid, or no light returns to the wall.
    SamplingError
        If all light arrives outside the bins, or ``tol`` cannot be reached.
    MemoryLimitError
        If the bins exceed the free memory.

    See Also
    --------
    render_scene : Simulated capture of a scene.
    Detector : Photon counts of a capture.

    Notes
    -----
    The wall never blocks light. Three bounces (wall, hidden surface, wall) are integrated by
    adaptive quadrature, more bounces by Monte Carlo.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics.scene import Lambert
    >>> from nlosoptics.transient import render, wall_grid
    >>> corners = [[-0.1, -0.1, 0.5], [0.1, -0.1, 0.5], [0.1, 0.1, 0.5], [-0.1, 0.1, 0.5]]
    >>> plate = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])
    >>> capture = render(
    ...     [(plate, Lambert(0.8))],
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=wall_grid(side=0.4, count=2),
    ...     t_start=0.95,
    ...     delta_t=0.05,
    ...     n_bins=8,
    ...     max_bounces=3,
    ... )
    >>> capture.H.shape
    (8, 2, 2)
    >>> print(capture.H.sum(axis=0).round(4))
    [[0.0407 0.0407]
     [0.0407 0.0407]]
    """
    start = time.perf_counter()
    bin_0 = real("t_start", t_start)
    width = positive("delta_t", delta_t, unit="m")
    count = whole("n_bins", n_bins)
    wanted = in_range("tol", tol, 1e-9, 0.5)
    wanted_multiple = in_range("tol_multiple", tol_multiple, 1e-5, 1.0)
    key = checked_seed(seed)
    paths = None if n_rays is None else whole("n_rays", n_rays, LEAST, 1 << 40)
    size = None if wall_size is None else pair("wall_size", wall_size)
    fewest = whole("min_bounces", min_bounces, 3, 32)
    most = whole("max_bounces", max_bounces, fewest, 32)
    one_of("quantity", quantity, ("irradiance", "radiance", "radiosity"))
    hidden = hidden_surfaces(surfaces)
    rho = in_range("wall_albedo", wall_albedo, 0.0, 1.0, open_low=True)
    scale = rho * {"irradiance": 1.0, "radiance": rho / math.pi, "radiosity": rho}[quantity]
    origins = (
        None if laser_origin is None else vector("laser_origin", laser_origin),
        None if sensor_origin is None else vector("sensor_origin", sensor_origin),
    )
    setting = _setting(laser_points, sensor_points, pairing, origins, scale, outer_legs)
    bins: dict[str, Any] = {"starts": bin_0 - setting.legs, "delta_t": width, "n_bins": count}
    three, more = None, MultipleBounces({}, {}, {})
    if fewest == 3:
        points = setting.lasers, setting.sensors
        three = three_bounces(hidden, *points, **bins, tol=wanted, progress=progress)
    if most > 3:
        more = multiple_bounces(
            hidden,
            setting.laser_points,
            setting.sensor_points,
            pairing=setting.pairing,
            wall_albedo=rho,
            wall_size=size,
            **bins,
            orders=range(max(4, fewest), most + 1),
            tol=wanted_multiple,
            n_rays=paths,
            seed=key,
            progress=progress,
        )
    if not any(light.any() for light in more.by_bounce.values()):
        _check_light(three, setting, (fewest, most), (bin_0, bin_0 + count * width))
    by_bounce = {} if three is None else {3: setting.bins(three.G)}
    by_bounce |= {n: setting.factor * light for n, light in more.by_bounce.items()}
    errors = [setting.factor * error for error in more.standard_error.values()]
    H = by_bounce[fewest].copy()
    for n in range(fewest + 1, most + 1):
        H += by_bounce[n]
    details = setting.details(three) | {
        "multiple_bounces": more.details,
        "wall_albedo": rho,
        "seconds": time.perf_counter() - start,
    }
    return TransientCapture(
        H=H,
        laser_points=setting.laser_points,
        sensor_points=setting.sensor_points,
        delta_t=width,
        t_start=bin_0,
        pairing=setting.pairing,
        quantity=quantity,
        outer_legs=bool(outer_legs),
        laser_origin=origins[0],
        sensor_origin=origins[1],
        by_bounce=by_bounce,
        standard_error=np.sqrt(sum((error**2 for error in errors), np.zeros_like(H))),
        details=details,
    )


def _setting(
    laser_points: ArrayLike,
    sensor_points: ArrayLike,
    pairing: Any,
    origins: tuple[Vector | None, Vector | None],
    scale: float,
    outer_legs: bool,
) -> _Setting:
    """Check the wall points, form their pairs, and compute outer legs and factors."""
    lights = points_on_wall("laser_points", laser_points)
    seen = points_on_wall("sensor_points", sensor_points)
    pair_shape(pairing, lights.shape[:-1], seen.shape[:-1])
    first, second = lights.reshape(-1, 3), seen.reshape(-1, 3)
    if pairing == "confocal":
        lasers, sensors = first, second
    else:
        lasers = np.repeat(first, len(second), axis=0)
        sensors = np.tile(second, (len(first), 1))
    legs = np.zeros(len(lasers))
    if outer_legs:
        legs += _distance("laser_origin", origins[0], lasers)
        legs += _distance("sensor_origin", origins[1], sensors)
    return _Setting(lights, seen, pairing, lasers, sensors, legs, scale)


def _distance(name: str, origin: Vector | None, points: Array) -> Array:
    """Return the distances from a laser or sensor to wall points, m."""
    if origin is None:
        raise SceneError(f"outer_legs = True needs {name}; give its position (x, y, z) in m")
    if not origin[2] > 0.0:
        raise SceneError(
            f"{name}[z] = {origin[2]:g} m is out of range, must be above 0; move it in front of "
            "the wall"
        )
    lines = points - np.asarray(origin)
    return np.asarray(np.sqrt((lines * lines).sum(axis=-1)))


def _check_light(
    three: ThreeBounces | None,
    setting: _Setting,
    bounces: tuple[int, int],
    span: tuple[float, float],
) -> None:
    """Raise if no light returns to the wall, or none within the bins."""
    if three is not None and three.G.any():
        return
    if three is not None and not (three.before.any() or three.after.any()):
        raise SceneError(
            "no light returns: every triangle is hidden or seen edge-on from the wall points, or "
            "has a material of albedo 0; rotate or move the surfaces"
        )
    legs = " (times include the outer legs)" if setting.legs.any() else ""
    when, more = "", ", raise n_rays, or add a second surface, for example by wall_size"
    if three is not None:
        when, more = f" (all arrives {'before' if three.before.any() else 'after'} them)", ""
    raise SamplingError(
        f"no light of {bounces[0]} to {bounces[1]} bounces arrives in the bins{when}, which hold "
        f"paths from {span[0]:g} to {span[1]:g} m{legs}; change t_start or n_bins{more}"
    )
