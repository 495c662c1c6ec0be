"""Monte Carlo rendering of paths with two or more reflections between those at the wall."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import counted, fits_memory
from ..._progress import Progress
from ..capture.wall_points import pair_shape, points_on_wall
from .surfaces import HiddenSurfaces, bounce_surfaces

if TYPE_CHECKING:
    from .batches import Job

Array = NDArray[np.float64]
LEAST: Final = 8  # least number of batches, whose spread gives the standard error


class MultipleBounces(NamedTuple):
    """Intensity by number of reflections, and its standard error."""

    # Irradiance per watt that leaves the laser's spot, 1/m^2, integrated over each bin, by number
    # of reflections; (n_bins, *laser_shape, *sensor_shape), confocal (n_bins, *shape)
    by_bounce: dict[int, Array]
    standard_error: dict[int, Array]
    # ``"paths"`` and ``"batches"``: their numbers. ``"reached"``: by number of reflections, the
    # largest expected relative L1 error among pairs with a contribution; infinite if there are
    # none. ``"stopped"``: "tol" if all errors are below ``tol``; "paths" if the paths were used up
    # first; "dark" if some number of reflections contributes nothing and the others reached ``tol``
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
    """Compute the light that returns to the wall after four or more reflections, by Monte Carlo.

    Returns the intensity and standard error; ``details`` tells whether ``tol`` was reached.

    The laser's spot has radiance 1/pi per watt and area. The first vertices are sampled by rays
    from all sensors. The density of a vertex is the mean over all sensors, and each vertex is
    connected to every sensor (balance heuristic, Veach 1997, ch. 9). Several paths continue from
    each vertex along the lobes of the material; all their vertices are connected to every laser
    point. If many rays leave the scene, a fraction of both kinds of vertices is sampled over the
    area of the surfaces instead. Each batch has its own scrambled Sobol points; the spread between
    batches gives the standard error.

    If there are more laser than sensor points, both are swapped, which reciprocity allows. If both
    are numerous or confocal, laser points close to a surface have the largest noise, because
    sampling does not favour directions to them.
    """
    lit = points_on_wall("laser_points", laser_points)
    seen = points_on_wall("sensor_points", sensor_points)
    shape = pair_shape(pairing, lit.shape[:-1], seen.shape[:-1])
    lasers, sensors = lit.reshape(-1, 3), seen.reshape(-1, 3)
    if pairing == "confocal":
        rows = np.stack([np.arange(len(lasers))] * 2, axis=1)
    else:
        rows = np.stack(np.divmod(np.arange(len(lasers) * len(sensors)), len(sensors)), axis=1)
    chosen = tuple(orders)
    fits_memory(
        f"{counted(len(chosen), 'order')} of {counted(len(rows), 'pair')} of points in "
        f"{counted(n_bins, 'bin')}",
        32.0 * len(chosen) * len(rows) * n_bins,
        "give fewer points, bins or orders",
    )
    if n_rays is None:  # most of a minute of a core, from measured costs in ns
        ends = sorted((len(lasers), len(sensors)))
        hit = 150.0 * max(1.0, math.log2(len(surfaces.mesh.faces)) / 4.0)
        each = len(chosen) * (5.0 * hit + hit * ends[0] + 2.5 * len(rows))
        each += hit * ends[1] / _sizes(ends[1], 1 << 40)[1]
        n_rays = int(min(max(4e10 / each, 1 << 16), 1 << 27))
    begins = np.ascontiguousarray(np.broadcast_to(np.asarray(starts, float).ravel(), len(rows)))
    job, back = _job(
        surfaces,
        (lasers, sensors, rows, begins),
        turned=pairing == "all" and len(lasers) > len(sensors),
        wall=(wall_albedo, wall_size),
        bins=(delta_t, n_bins),
        orders=chosen,
        budget=n_rays,
        seed=seed,
    )
    total, squares, batches, paths, reached = _run(job, tol, n_rays, progress)
    by_bounce, errors = {}, {}
    for k, number in enumerate(chosen):
        # the radiance of the wall's spot is 1/pi
        error = np.sqrt(_variance(total[k], squares[k], batches))
        by_bounce[number] = (total[k] / (math.pi * batches))[back].T.reshape(n_bins, *shape)
        errors[number] = (error / math.pi)[back].T.reshape(n_bins, *shape)
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
    """Return the data shared by all batches, and the order that restores the caller's pairs.

    With ``turned``, laser and sensor points are swapped, so that paths start at the lasers.
    """
    from .batches import Job

    lasers, sensors, rows, starts = points
    if turned:
        lasers, sensors, rows = sensors, lasers, rows[:, ::-1]
    order = np.argsort(rows[:, 0], kind="stable")
    n_seen, n_each = _sizes(len(sensors), budget)
    job = Job(
        around=bounce_surfaces(surfaces, sensors, *wall),
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
    """Return sums over batches of bins and squared bins, numbers of batches and paths, errors."""
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
        # errors fall as 1/sqrt(batches): predict the number with 5 % reserve, at most fourfold
        wanted = math.ceil(1.05 * done * min(4.0, (worst / tol) ** 2)) if tol is not None else most
        goal = min(most, max(done + 1, wanted))


def _variance(total: Array, squares: Array, n: int) -> Array:
    """Return the squared standard error of the mean of ``n`` batches.

    It has n - 3 instead of n - 1 in the denominator. Deviations over standard errors follow
    Student's t distribution with n - 1 degrees of freedom and thus have unit variance.
    """
    # rounding can make the difference negative if all batches are equal
    spread = np.maximum(squares - total * total / n, 0.0)
    return np.asarray(spread / (n * (n - 3.0)))


def _stopped(reached: list[float], tol: float | None) -> str:
    """Return the reason to stop: "tol", "paths" or "dark", see `MultipleBounces`."""
    if tol is None or any(tol < error < math.inf for error in reached):
        return "paths"
    return "dark" if math.inf in reached else "tol"


def _l1(total: Array, squares: Array, n: int) -> float:
    """Return the largest expected relative L1 error of a lit pair, infinite if none is lit.

    The mean absolute value of a Gaussian deviate is sqrt(2/pi) sigma.
    """
    light = total.sum(axis=1) / n
    errors = np.sqrt(_variance(total, squares, n)).sum(axis=1)
    lit = light > 0.0
    if not lit.any():
        return math.inf
    return math.sqrt(2.0 / math.pi) * float((errors[lit] / light[lit]).max())


def _sizes(n_sensors: int, budget: int) -> tuple[int, int]:
    """Return the number of first vertices in a batch, and of paths from each of them.

    A vertex costs one shadow ray per sensor. The paths that continue from it cost about the same.
    """
    n_each = min(max(1, n_sensors // 2), 64)
    n_seen = min(max(64, (1 << 18) // n_sensors), 1 << 14)
    each = max(1, budget // LEAST)
    n_each = min(n_each, max(1, each // 16))
    return max(1, min(n_seen, each // n_each)), n_each


def _aimed(job: Job) -> tuple[float, float]:
    """Return the fractions of first and further vertices to sample over the surfaces' area.

    They equal the fractions of rays that leave the scene, up to 3/4; small ones are set to 0.
    """
    from .batches import openness

    seen, between = openness(dataclasses.replace(job, n_seen=1 << 12, n_each=1))
    first, further = (min(0.75, missed) if missed > 0.02 else 0.0 for missed in (seen, between))
    return first, further
