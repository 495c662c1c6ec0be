"""The front door of rendered captures: `render`."""

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
from .multiple_bounces import LEAST, MOST_ORDER, MOST_RAYS, MultipleBounces, multiple_bounces
from .surfaces import hidden_surfaces
from .three_bounces import ThreeBounces, three_bounces

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Setting:
    """Pairs of wall points, as checked, and what a pair's light is multiplied by."""

    laser_points: Array
    sensor_points: Array
    pairing: Pairing
    lasers: Array  # (pairs, 3)
    sensors: Array
    legs: Array  # (pairs,), m of path outside the hidden scene that the times hold
    factors: Array  # (pairs,), what is measured over G without the wall's albedo

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the axes behind the bins."""
        lasers, sensors = self.laser_points.shape[:-1], self.sensor_points.shape[:-1]
        return pair_shape(self.pairing, lasers, sensors)

    def bins(self, values: Array) -> Array:
        """(pairs, n_bins) of G as (n_bins, *shape) of what is measured."""
        scaled = np.ascontiguousarray((values * self.factors[:, None]).T)
        return scaled.reshape(len(scaled), *self.shape)

    def each(self, values: Array) -> Array:
        """(pairs,) of G as (*shape) of what is measured."""
        return np.asarray(values * self.factors).reshape(self.shape)

    def scaled(self, values: Array) -> Array:
        """(n_bins, *shape) of G as what is measured."""
        return values * self.factors.reshape(self.shape)

    def told(self, three: ThreeBounces | None) -> dict[str, Any]:
        """What a capture's details say of three bounces, where they were wanted."""
        if three is None:
            return {}
        return {
            "error_estimate": self.each(three.error),
            "before": self.each(three.before),
            "after": self.each(three.after),
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
    keep_laser_cosine: bool = False,
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
    """Time-resolved light at points of a Lambertian relay wall, by way of hidden meshes.

    Parameters
    ----------
    surfaces : iterable of (trimesh.Trimesh, Material)
        Hidden meshes, world, m, and how they scatter: both sides of every triangle alike. They
        stand in front of the wall z = 0, which they may touch.
    laser_points, sensor_points : array_like
        (*laser_shape, 3) and (*sensor_shape, 3), m, on the wall z = 0. One point may be (3,).
    pairing : {"all", "confocal"}
        Each laser point seen at each sensor point, or each at its own.
    wall_albedo : float
        Of the relay wall, 0 to 1.
    t_start, delta_t : float
        Where the first bin begins and how wide a bin is, m of optical path.
    n_bins : int
    min_bounces, max_bounces : int
        Fewest and most reflections of a path, the wall's two included, 3 to 32. Above 3, light of
        fewer is left out: further seeds need not repeat three bounces, which draw nothing at
        random.
    quantity : {"irradiance", "radiance", "radiosity"}
        At the sensor points: irradiance, W/m^2; radiance, W/(m^2 sr), which is the wall's albedo
        over pi times that; radiosity, the albedo times that. Of a pulse that brings 1 J (or 1 W)
        to the wall.
    keep_laser_cosine : bool
        Whether the laser is a point source of 1 W/sr that lights 1 m^2 of the wall, so that all is
        multiplied by cos/d^2 of the leg from ``laser_origin`` to the laser point, 1/m^2.
    outer_legs : bool
        Whether times hold the legs from ``laser_origin`` to the wall and from the wall to
        ``sensor_origin``.
    laser_origin, sensor_origin : (float, float, float), optional
        m; needed by the two options before.
    tol, tol_multiple : float
        Relative error, L1 over the bins of each pair of points: of three bounces, and of each
        number of bounces beyond, where it is the expected one.
    n_rays : int, optional
        Most paths of more than three bounces to draw; by default what takes some ten minutes of
        a core.
    wall_size : float or (float, float), optional
        Sides of the wall about the origin, m, where light may be reflected on the way, as in wall,
        object, wall, object, wall. None: the wall reflects at laser and sensor points alone.
    seed : int
        Of what is drawn at random: nothing, for three bounces. The same seed gives the same bits on
        any number of threads.
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    TransientCapture
        With ``by_bounce`` and ``standard_error``, which is 0 for three bounces. ``details`` has of
        three bounces, where they are wanted, in arrays of the pairs' shape, ``"error_estimate"``
        (summed over the bins, what the last two passes differ by), ``"before"`` and ``"after"``
        (light outside the bins) and ``"parts"`` (of the surface), and ``"shadows"``, whether they
        were looked for. Of more bounces, ``"multiple_bounces"`` has the number of paths, the errors
        reached, and what ended them: "tol", "paths" where those ran out before, or "dark" where
        some number of reflections brought no light into the bins.

    Raises
    ------
    SceneError
        If a surface, a point or an option is wrong, or no light comes back.
    SamplingError
        If all light misses the bins, or ``tol`` is out of reach.
    MemoryLimitError
        If the bins do not fit.

    Notes
    -----
    The wall takes part at the laser and at the sensor point, and between where ``wall_size`` says
    so: it stands in nobody's way, and three bounces are wall, hidden surface, wall. Those are found
    by quadrature, more by Monte Carlo (`multiple_bounces`).
    """
    start = time.perf_counter()
    bin_0 = real("t_start", t_start)
    width = positive("delta_t", delta_t, unit="m")
    count = whole("n_bins", n_bins)
    wanted = in_range("tol", tol, 1e-9, 0.5)
    wanted_multiple = in_range("tol_multiple", tol_multiple, 1e-5, 1.0)
    key = checked_seed(seed)
    paths = None if n_rays is None else whole("n_rays", n_rays, LEAST, MOST_RAYS)
    size = None if wall_size is None else pair("wall_size", wall_size)
    fewest = whole("min_bounces", min_bounces, 3, MOST_ORDER)
    most = whole("max_bounces", max_bounces, fewest, MOST_ORDER)
    one_of("quantity", quantity, ("irradiance", "radiance", "radiosity"))
    hidden = hidden_surfaces(surfaces)
    rho = in_range("wall_albedo", wall_albedo, 0.0, 1.0, open_low=True)
    scale = rho * {"irradiance": 1.0, "radiance": rho / math.pi, "radiosity": rho}[quantity]
    origins = (
        None if laser_origin is None else vector("laser_origin", laser_origin),
        None if sensor_origin is None else vector("sensor_origin", sensor_origin),
    )
    setting = _setting(
        laser_points, sensor_points, pairing, origins, scale, bool(keep_laser_cosine), outer_legs
    )
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
    by_bounce |= {n: setting.scaled(light) for n, light in more.by_bounce.items()}
    errors = [setting.scaled(error) for error in more.standard_error.values()]
    H = by_bounce[fewest].copy()
    for n in range(fewest + 1, most + 1):
        H += by_bounce[n]
    details = setting.told(three) | {
        "multiple_bounces": more.details,
        "wall_albedo": rho,
        "keep_laser_cosine": bool(keep_laser_cosine),
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
    keep_laser_cosine: bool,
    outer_legs: bool,
) -> _Setting:
    """Check the wall points and pair them."""
    lights = points_on_wall("laser_points", laser_points)
    seen = points_on_wall("sensor_points", sensor_points)
    pair_shape(pairing, lights.shape[:-1], seen.shape[:-1])
    first, second = lights.reshape(-1, 3), seen.reshape(-1, 3)
    if pairing == "confocal":
        lasers, sensors = first, second
    else:
        lasers = np.repeat(first, len(second), axis=0)
        sensors = np.tile(second, (len(first), 1))
    legs, factors = np.zeros(len(lasers)), np.full(len(lasers), scale)
    if outer_legs:
        legs += _distance("laser_origin", origins[0], lasers, "outer_legs")
        legs += _distance("sensor_origin", origins[1], sensors, "outer_legs")
    if keep_laser_cosine:
        away = _distance("laser_origin", origins[0], lasers, "keep_laser_cosine")
        factors *= float(np.asarray(origins[0])[2]) / away**3
    return _Setting(lights, seen, pairing, lasers, sensors, legs, factors)


def _distance(name: str, origin: Vector | None, points: Array, option: str) -> Array:
    """From a device to wall points, m."""
    if origin is None:
        raise SceneError(f"{option} needs {name}; give where it stands, (x, y, z) in m")
    if not origin[2] > 0.0:
        raise SceneError(f"{name}[z] = {origin[2]:g} m is out of range, must be above 0")
    lines = points - np.asarray(origin)
    return np.asarray(np.sqrt((lines * lines).sum(axis=-1)))


def _check_light(
    three: ThreeBounces | None,
    setting: _Setting,
    bounces: tuple[int, int],
    span: tuple[float, float],
) -> None:
    """Raise where no light comes back, or none within the bins."""
    held = "" if not setting.legs.any() else " (times hold the outer legs)"
    if three is None:
        raise SamplingError(
            f"no light of {bounces[0]} to {bounces[1]} bounces arrives in the bins, which hold "
            f"paths from {span[0]:g} to {span[1]:g} m; change t_start or n_bins, draw more n_rays, "
            f"or give the light a second surface, as by wall_size{held}"
        )
    if three.G.any():
        return
    early, late = bool(three.before.any()), bool(three.after.any())
    if not (early or late):
        raise SceneError(
            "no light comes back: every triangle is hidden or seen edge-on from the wall points, "
            "or has a material of albedo 0; turn or move the surfaces"
        )
    when = "before and after" if early and late else "before" if early else "after"
    raise SamplingError(
        f"all light arrives {when} the bins, which hold paths from {span[0]:g} to {span[1]:g} m; "
        f"change t_start or n_bins{held}"
    )
