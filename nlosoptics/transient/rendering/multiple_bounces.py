"""Light that meets hidden surfaces twice or more before it comes back to the wall: Monte Carlo."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, in_range, pair, positive, whole
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError, SceneError
from ..capture.wall_points import pair_shape, points_on_wall
from .surfaces import HiddenSurfaces, bounce_surfaces

if TYPE_CHECKING:
    from .batches import Job

Array = NDArray[np.float64]
LEAST: Final = 8  # batches, whose spread is the standard error
WORK: Final = 6e11  # units of a nanosecond or so, ten minutes of a core, unless told otherwise
MOST: Final = 1 << 27
PILOT: Final = 1 << 12  # paths that tell how open a scene is
MOST_ORDER: Final = 32
MOST_RAYS: Final = 1 << 40


class MultipleBounces(NamedTuple):
    """What `multiple_bounces` found.

    Parameters
    ----------
    by_bounce, standard_error : dict of int to ndarray
        From the number of reflections to (n_bins, *laser_shape, *sensor_shape), confocal
        (n_bins, *shape): irradiance per watt that leaves the laser's spot, 1/m^2, over each bin.
    details : dict
        ``"paths"`` drawn, ``"batches"``, ``"reached"``: by number of reflections the largest
        relative L1 error expected of a sensor that light reaches, infinite where it reaches none
        within the bins, and ``"stopped"``: "tol", "paths" where those ran out before, or "dark"
        where some number of reflections brought no light into the bins, and the others ``tol``.
    """

    by_bounce: dict[int, Array]
    standard_error: dict[int, Array]
    details: dict[str, Any]


def multiple_bounces(
    surfaces: HiddenSurfaces,
    laser_points: ArrayLike,
    sensor_points: ArrayLike,
    *,
    pairing: str = "all",
    wall_albedo: float = 1.0,
    wall_size: float | tuple[float, float] | None = None,
    starts: ArrayLike = 0.0,
    delta_t: float,
    n_bins: int,
    orders: Iterable[int] = (4, 5),
    tol: float | None = 1e-2,
    n_rays: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> MultipleBounces:
    """Light that comes back to the wall after several reflections, by Monte Carlo.

    Parameters
    ----------
    surfaces : HiddenSurfaces
        In front of the wall z = 0, world, m.
    laser_points, sensor_points : array_like, (..., 3)
        On the wall, m.
    pairing : {"all", "confocal"}
        Each laser point at each sensor point, or each at its own.
    wall_albedo : float
        Of the Lambertian wall, 0 to 1, where light meets it on the way: that at the laser's spot
        is left out, as in `three_bounces`.
    wall_size : float or (float, float), optional
        Sides of the wall about the origin, m, where light may be reflected on the way, as in wall,
        object, wall, object, wall. None: the wall reflects at laser points alone.
    starts : float or array_like
        Where the first bin begins, m of optical path between the wall's points; one for all, or
        one for each pair.
    delta_t : float
        Width of a bin, m.
    n_bins : int
    orders : iterable of int
        Numbers of reflections, 4 to 32, those on the wall at the laser's spot and at the sensor's
        point included.
    tol : float, optional
        Wanted relative L1 error of every pair of points in every order, 1e-5 to 1.
    n_rays : int, optional
        Paths to draw, at most; with ``tol=None`` as many. By default what takes some ten minutes of
        a core, by the numbers of points and orders.
    seed : int
        0 to 2^64 - 1. The same seed gives the same bits on any number of threads.
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    MultipleBounces
        Its ``details`` tell whether ``tol`` was reached or the paths ran out.

    Raises
    ------
    SceneError
        If an option is out of range, a surface is behind the wall or a smooth mirror, or points
        are off the wall.
    SamplingError
        If shapes do not fit.
    MemoryLimitError
        If the bins would not fit in memory.

    Notes
    -----
    The wall's spot has the radiance 1/pi per watt and area. Vertices are drawn where the
    sensors see the scene, as rays of all of them; the density of each vertex is that of all sensors
    together, and every vertex is joined to every sensor (balance heuristic, Veach 1997, ch. 9).
    From each several paths go on along the lobes, and their vertices are joined to every laser
    point. Where rays leave the scene, a share of both is drawn over the surfaces' area instead.
    Batches have Sobol points scrambled on their own; their spread gives the standard error. What is
    more often lit than seen trades places, as light can be followed either way. Where both are many
    or are pairs, lasers close to a surface are the noisier ones: their spots are not aimed at.
    """
    chosen = _orders(orders)
    if tol is not None:
        tol = in_range("tol", tol, 1e-5, 1.0)
    lit = points_on_wall("laser_points", laser_points)
    seen = points_on_wall("sensor_points", sensor_points)
    shape = pair_shape(pairing, lit.shape[:-1], seen.shape[:-1])
    lasers, sensors = lit.reshape(-1, 3), seen.reshape(-1, 3)
    rows = _rows(pairing, len(lasers), len(sensors))
    count = whole("n_bins", n_bins)
    fits_memory(
        f"{len(chosen)} orders of {len(rows)} pairs of points in {count} bins",
        32.0 * len(chosen) * len(rows) * count,
        "take fewer points, bins or orders",
    )
    budget = _affordable(len(chosen), min(len(lasers), len(sensors)), len(rows))
    if n_rays is not None:
        budget = whole("n_rays", n_rays, LEAST, MOST_RAYS)
    job, back = _job(
        surfaces,
        (lasers, sensors, rows, _starts(starts, len(rows))),
        turned=pairing == "all" and len(lasers) > len(sensors),
        wall=(in_range("wall_albedo", wall_albedo, 0.0, 1.0), wall_size),
        bins=(positive("delta_t", delta_t, unit="m"), count),
        orders=chosen,
        budget=budget,
        seed=checked_seed(seed),
    )
    total, squares, batches, paths, reached = _run(job, tol, budget, progress)
    by_bounce, errors = {}, {}
    for k, number in enumerate(chosen):
        # the radiance of the wall's spot is 1/pi
        error = np.sqrt(_variance(total[k], squares[k], batches))
        by_bounce[number] = (total[k] / (math.pi * batches))[back].T.reshape(count, *shape)
        errors[number] = (error / math.pi)[back].T.reshape(count, *shape)
    details = {
        "paths": paths,
        "batches": batches,
        "reached": dict(zip(chosen, reached, strict=True)),
        "stopped": _stopped(reached, tol),
    }
    return MultipleBounces(by_bounce, errors, details)


def _job(
    surfaces: HiddenSurfaces,
    points: tuple[Array, Array, NDArray[np.int64], Array],
    *,
    turned: bool,
    wall: tuple[float, Any],
    bins: tuple[float, int],
    orders: tuple[int, ...],
    budget: int,
    seed: int,
) -> tuple[Job, NDArray[np.int64]]:
    """What batches need, and the order that brings its pairs back to the caller's.

    ``turned`` follows light from the lasers to the sensors.
    """
    from .batches import Job

    lasers, sensors, rows, starts = points
    if turned:
        lasers, sensors, rows = sensors, lasers, rows[:, ::-1]
    size = None if wall[1] is None else pair("wall_size", wall[1])
    order = np.argsort(rows[:, 0], kind="stable")
    n_seen, n_each = _sizes(len(sensors), budget)
    job = Job(
        around=bounce_surfaces(surfaces, sensors, wall[0], size),
        lasers=lasers,
        sensors=sensors,
        rows=np.ascontiguousarray(rows[order]),
        orders=orders,
        starts=starts[order],
        rate=1.0 / bins[0],
        n_bins=bins[1],
        seed=seed,
        n_seen=n_seen,
        n_each=n_each,
        aimed=(0.0, 0.0),
    )
    return dataclasses.replace(job, aimed=_aimed(job)), np.argsort(order)


def _run(
    job: Job, tol: float | None, budget: int, progress: Progress | None
) -> tuple[Array, Array, int, int, list[float]]:
    """Sums of bins and of their squares, the numbers of batches and paths, the errors reached."""
    from .batches import add_batch

    total = np.zeros((len(job.orders), len(job.rows), job.n_bins))
    squares = np.zeros_like(total)
    each = job.n_seen * job.n_each
    most = max(LEAST, budget // each)
    paths, done, goal = 0, 0, LEAST if tol is not None else most
    while True:
        for number in range(done, goal):
            paths += add_batch(job, number, total, squares)
            if progress is not None:
                progress("paths of several bounces", (number + 1) / max(goal, number + 1))
        done = goal
        reached = [_l1(total[k], squares[k], done) for k in range(len(job.orders))]
        # orders without any contribution do not delay convergence
        worst = max((error for error in reached if error < math.inf), default=0.0)
        if done >= most or (tol is not None and worst <= tol):
            return total, squares, done, paths, reached
        # what the square root law asks for, a little more, at most four times what is done
        wanted = math.ceil(1.05 * done * min(4.0, (worst / tol) ** 2)) if tol is not None else most
        goal = min(most, max(done + 1, wanted))


def _variance(total: Array, squares: Array, n: int) -> Array:
    """Square of the standard error of means of ``n`` batches, with Student's factor.

    As of `raytrace.trace`: deviations measured in it have unit variance.
    """
    # rounding can take the difference below 0 where all batches are alike
    spread = np.maximum(squares - total * total / n, 0.0)
    return np.asarray(spread / (n * (n - 3.0)))


def _stopped(reached: list[float], tol: float | None) -> str:
    """Why no more paths were drawn."""
    if tol is None or any(tol < error < math.inf for error in reached):
        return "paths"
    return "dark" if math.inf in reached else "tol"


def _l1(total: Array, squares: Array, n: int) -> float:
    """Largest relative L1 error expected of a lit pair, infinite where none is.

    A Gaussian's mean size is sqrt(2/pi) sigma.
    """
    light = total.sum(axis=1) / n
    errors = np.sqrt(_variance(total, squares, n)).sum(axis=1)
    lit = light > 0.0
    if not lit.any():
        return math.inf
    return math.sqrt(2.0 / math.pi) * float((errors[lit] / light[lit]).max())


def _affordable(n_orders: int, n_lasers: int, n_pairs: int) -> int:
    """Paths that are worth `WORK`, by what legs, connections and bins were measured to take."""
    each = 1000.0 + 150.0 * n_lasers + 2.0 * n_pairs
    return int(min(max(WORK / (n_orders * each), 1 << 16), MOST))


def _sizes(n_sensors: int, budget: int) -> tuple[int, int]:
    """Vertices that sensors see in a batch, and paths from each.

    A vertex costs a ray for each sensor; as many paths as cost about that go on from it.
    """
    n_each = min(max(1, n_sensors // 16), 64)
    n_seen = min(max(64, (1 << 20) // n_sensors), 1 << 14)
    each = max(1, budget // LEAST)
    n_each = min(n_each, max(1, each // 16))
    return max(1, min(n_seen, each // n_each)), n_each


def _aimed(job: Job) -> tuple[float, float]:
    """Shares drawn over the surfaces' area: as many as rays would miss, three quarters at most."""
    from .batches import openness

    seen, between = openness(dataclasses.replace(job, n_seen=PILOT, n_each=1))
    return _share(seen), _share(between)


def _share(missed: float) -> float:
    return min(0.75, missed) if missed > 0.02 else 0.0


def _orders(orders: Iterable[int]) -> tuple[int, ...]:
    chosen = sorted({whole("orders", number, 4, MOST_ORDER) for number in orders})
    if not chosen:
        raise SceneError("orders are empty; give such as (4, 5)")
    return tuple(chosen)


def _starts(values: ArrayLike, n_pairs: int) -> Array:
    starts = np.asarray(values, dtype=np.float64)
    if starts.size not in (1, n_pairs):
        raise SamplingError(
            f"starts has {starts.size} values; give one, or {n_pairs}, one of each pair"
        )
    if not np.isfinite(starts).all():
        raise SceneError("starts have values that are not finite")
    return np.ascontiguousarray(np.broadcast_to(starts.ravel(), n_pairs))


def _rows(pairing: str, n_lasers: int, n_sensors: int) -> NDArray[np.int64]:
    """Pairs (n, 2) of laser and sensor in the order of the result."""
    if pairing == "confocal":
        return np.stack([np.arange(n_lasers), np.arange(n_lasers)], axis=1)
    return np.stack(np.divmod(np.arange(n_lasers * n_sensors), n_sensors), axis=1)
