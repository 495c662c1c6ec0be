"""Monte Carlo light transport from laser to detector, with any number of reflections."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, fits_memory, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, scrambled_sobol
from ...errors import SceneError
from ...kernels.codes import GROUPS
from ...scene import Scene
from ..fans.paths import RayPaths
from ..intersection.meshes import worker_pool
from .surroundings import Surroundings

if TYPE_CHECKING:
    from .blocks import Job, Traced
    from .kept_paths import Kept

Array = NDArray[np.float64]
Found = TypeVar("Found")
Given = TypeVar("Given")
BLOCK: Final = 4096  # rays per task; a multiple of UNIT
WAITING: Final = 8  # largest number of blocks at once
FIRST: Final = 1 << 10  # rays before the first check of the error; a multiple of UNIT
MOST: Final = 1 << 36  # largest number of rays
GIVE_UP: Final = 1 << 18  # rays without any detected light after which tracing to tol fails
MOST_BOUNCES: Final = 64  # largest number of reflections
#: Skewness of the groups above which errors are widened; 1.4 % of normal groups exceed it.
SKEWED: Final = 1.0


def trace(
    scene: Scene,
    *,
    n_rays: int | None = None,
    tol: float | None = None,
    max_seconds: float | None = None,
    max_bounces: int = 5,
    keep_paths: bool = False,
    analog: bool = False,
    sampler: Literal["sobol", "philox"] = "sobol",
    seed: int = 0,
    progress: Progress | None = None,
) -> RayPaths:
    """Trace the laser's light by Monte Carlo until it is detected, absorbed or leaves the scene.

    Parameters
    ----------
    scene : Scene
        Scene to trace.
    n_rays : int, optional
        Number of rays. With ``tol`` or ``max_seconds`` it is the largest number. None: 65536, or
        2^36 with ``tol`` or ``max_seconds``.
    tol : float, optional
        Target for the relative standard error of the flux from the hidden object to the detector,
        1e-6 to 1. None: no target.
    max_seconds : float, optional
        Time limit, s; the result of the rays traced by then is returned. None: no limit.
    max_bounces : int, default 5
        Largest number of reflections, 1 to 64. Three correspond to wall, object, wall.
    keep_paths : bool
        Whether to return single paths (vertices, lobes, lengths, powers), for example to plot them:
        all paths with ``analog``, else the detected ones. The other results then differ within
        their errors. Without paths, memory does not grow with the number of rays. With ``tol`` or
        ``max_seconds``, also give ``n_rays``, so small that the paths fit into memory.
    analog : bool
        Whether to follow rays only as physical light propagates. Such rays meet the object and the
        lens by chance alone, which is slow, but `RayPaths.ledger` then adds up to the laser's power
        within rounding. By default, rays are also aimed at the object and connected to the lens,
        and weak rays are ended at random (Russian roulette); the expected results are the same.
    sampler : {"sobol", "philox"}
        ``"sobol"``: scrambled Sobol points, which usually give less noise. ``"philox"``:
        independent random numbers.
    seed : int
        Seed of the random numbers, 0 to 2^64 - 1. The same seed gives bitwise identical results
        for any number of threads.
    progress : callable(str, float), optional
        Called with ``"rays"`` and the completed fraction, 0 to 1.

    Returns
    -------
    RayPaths
        Detected flux, power balance, and single paths if they were kept.

    Raises
    ------
    SceneError
        If an option is out of range, or a part of the scene is behind the wall. With ``tol``, also
        if no light reaches the detector via the hidden object, or if light can take paths that no
        sampling method aims at, so that rays find them only rarely (`RayPlan.unreached`).
    MemoryLimitError
        If the paths to keep would not fit in memory.

    See Also
    --------
    ray_plan : Intersection tests that the scene requires.
    trace_point : Light of a single object point, resolved by pixels.

    Notes
    -----
    The method is bidirectional path tracing [1]_. A material is a sum of lobes, each with its own
    angular distribution. Rays leave the wall either in directions drawn from its lobes or toward
    the object; their power accounts for the probability of both. Each point that reflects a ray is
    connected to another point of the scene, which is found by tracing a ray backwards from the
    detector through the lens. The connections give the detected power. After the first reflection
    of the laser's light, each point is connected to the points of four backward rays, unless a lobe
    is glossy or paths are kept. Rays from the laser spot to a hidden mesh are drawn in proportion
    to the light that each patch of triangles would send on to the middle of the field of view.

    If a lobe is glossy, the same light is sampled in two further ways. The backward rays are
    reflected once before they are connected, and the points that reflect rays are connected
    directly to the lens. Where several ways lead to the same path, each is weighted by its
    probability density relative to the sum of all (balance heuristic), so that no light is counted
    twice. From the fourth reflection on, weak rays are ended at random, and the power of those that
    remain is raised to compensate for this (Russian roulette).

    Mirror-like lobes of wall and object can reflect light one after the other. If the lobes are
    narrow, random connections hardly find such paths. The reflection points of such paths are
    therefore computed. Between a given point of the ray and a given point of the lens, Newton's
    method solves the law of reflection, and the Jacobian of the solution gives the power [2]_. On
    walls that may have several solutions, Newton's method starts at random points, and weights keep
    the estimate unbiased [3]_. `RayPlan.unreached` lists the kinds of paths that no method aims at,
    so that rays find them only rarely. ``tol`` is refused if ``max_bounces`` allows any of them.

    The standard error is that of the mean over 32 independent groups of rays, times
    ``sqrt(31/29)``, the standard deviation of Student's distribution for 32 groups. It is infinite
    for fewer than 4 rays. If the means of the groups have a skewness s above 1 or below -1, rare
    paths dominate the error, and this estimate is too small. It is then multiplied by
    ``sqrt(1 + 0.75 (s^2 - 1))``, and `RayPaths.uncertain` names the results concerned.

    References
    ----------
    .. [1] Veach, Robust Monte Carlo methods for light transport simulation (1997), ch. 9 and 10.
    .. [2] Hanika, Droske, Fascione, Manifold next event estimation, Computer Graphics Forum 34, 87
       (2015).
    .. [3] Zeltner, Georgiev, Jakob, Specular manifold sampling, ACM Trans. Graph. 39, 149 (2020).

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> light = raytrace.trace(scene, n_rays=16384, max_bounces=3, seed=0)
    >>> light.n_rays, light.stopped, light.standard_error < 0.2 * light.flux
    (16384, 'rays', True)
    """
    from .blocks import traced

    job = job_of(scene, max_bounces, sampler, seed, analog=analog, keep_paths=keep_paths)
    scene.check_laser_light()
    return until_done(job, partial(in_blocks, traced, job), n_rays, tol, max_seconds, progress)


def until_done(
    job: Job,
    blocks: Callable[[int, int], Iterable[Traced]],
    n_rays: int | None,
    tol: float | None,
    max_seconds: float | None,
    progress: Progress | None,
) -> RayPaths:
    """Trace rays until a limit is reached; `trace` describes the limits and ``progress``.

    ``blocks(start, end)`` yields the traced blocks of rays from ``start`` to ``end`` in their
    order.
    """
    max_bounces, keep_paths, analog = job.max_bounces, job.keep_paths, job.analog
    if tol is not None:
        in_range("tol", tol, 1e-6, 1.0)
        _refuse_darkness(job.scene)
        _refuse_unreached(job, tol)
    if max_seconds is not None:
        positive("max_seconds", max_seconds, unit="s")
    open_end = tol is not None or max_seconds is not None
    most = whole("n_rays", n_rays, 1, MOST) if n_rays is not None else MOST if open_end else 1 << 16
    if keep_paths:
        fits_memory(
            f"paths of {counted(most, 'ray')} (n_rays)"
            if most < MOST
            else "paths without a limit (n_rays)",
            most * (max_bounces + 4) * 26 * (1 if analog else max_bounces),
            "trace fewer rays, or keep_paths=False",
        )
    begun = time.perf_counter()
    total, counts, kept = np.zeros((GROUPS, job.columns)), Counter[str](), []
    done, stopped, report = 0, "rays", progress or (lambda stage, share: None)
    goal = min(most, FIRST) if open_end else most
    while True:
        for sums, asked, paths in blocks(done, goal):
            for unit in sums:
                total += unit
            counts += asked
            kept += paths
            spent = time.perf_counter() - begun
            if tol is None:
                share = spent / max_seconds if max_seconds is not None else 0.0
                report("rays", min(1.0, max(share, counts["rays"] / most)))
            if max_seconds is not None and spent > max_seconds:
                stopped = "time"
                break
        done = counts["rays"]
        if stopped == "time" or done >= most:
            break
        if tol is not None:
            flux, error = mean_of(total[:, : max_bounces + 1].sum(axis=1), done)
            if flux > 0.0 and error <= tol * flux:
                stopped = "tol"
                break
            report("rays", min(0.99, (tol * flux / error) ** 2) if error > 0.0 else 0.0)
            if flux == 0.0 and done >= GIVE_UP:
                raise SceneError(
                    f"no light of {done} rays reached the detector via the hidden object, but tol "
                    "requires a flux above 0; check camera.aim and the occluders, or give n_rays "
                    "instead of tol"
                )
        goal = min(most, 2 * done)
    report("rays", 1.0)
    return result_of(job, total, counts, kept, stopped, time.perf_counter() - begun)


def job_of(
    scene: Scene,
    max_bounces: int,
    sampler: str,
    seed: int,
    *,
    analog: bool = False,
    keep_paths: bool = False,
    chained: bool = True,
) -> Job:
    """Check the options common to all tracers, and return the prepared scene with its relief.

    ``chained`` tells whether chains of mirror-like reflections are solved for.
    """
    from .blocks import Job

    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    scene = scene.with_relief()
    scene.check_in_front()
    whole("max_bounces", max_bounces, 1, MOST_BOUNCES)
    one_of("sampler", sampler, ("sobol", "philox"))
    seed = checked_seed(seed)
    columns, shifts = scrambled_sobol(seed, 302, GROUPS)
    if sampler == "philox":
        columns, shifts = columns[:, :0], shifts[:, :0]
    return Job(
        scene=scene,
        around=Surroundings(scene, analog=analog, chained=chained),
        sampler=(np.uint64(seed), np.ascontiguousarray(columns), np.ascontiguousarray(shifts)),
        max_bounces=max_bounces,
        analog=analog,
        keep_paths=keep_paths,
    )


def _refuse_darkness(scene: Scene) -> None:
    """Raise `SceneError` if the wall or the hidden object reflects no light at all."""
    for name, material in (
        ("wall_material", scene.wall_material),
        ("hidden.material", scene.hidden.material),
    ):
        if material.is_black:
            raise SceneError(f"{name} reflects nothing, so no light can arrive; raise its albedo")
    if getattr(scene.hidden, "reflectance", np.ones(1)).max() == 0.0:
        raise SceneError(
            "hidden.image is black, so no light can arrive; give an image with bright pixels"
        )


def _refuse_unreached(job: Job, tol: float) -> None:
    """Raise `SceneError` if paths exist that only chance finds, since ``tol`` may miss them."""
    for least, text in job.around.chains.unreached:
        if least <= job.max_bounces and not job.analog:
            raise SceneError(
                f"tol = {tol:g} cannot be promised, because the rays find by chance only {text}; "
                f"give n_rays instead of tol, or max_bounces = {least - 1} to leave it out"
            )


def in_blocks(
    work: Callable[[Given, int, int], Found], job: Given, start: int, end: int
) -> Iterator[Found]:
    """Yield the results of ``work(job, first, end)`` for blocks of rays, computed on all cores.

    The results come in the order of the rays, so that sums do not depend on the number of threads.
    """
    parts = [(a, min(a + BLOCK, end)) for a in range(start, end, BLOCK)]
    if len(parts) == 1:
        yield work(job, *parts[0])
        return
    pool, waiting = worker_pool(), []
    try:
        for part in parts:
            waiting.append(pool.submit(work, job, *part))
            if len(waiting) >= WAITING:
                yield waiting.pop(0).result()
        while waiting:
            yield waiting.pop(0).result()
    finally:
        for task in waiting:
            task.cancel()


def mean_of(sums: Array, rays: int) -> tuple[float, float]:
    """Return the mean over the rays and its standard error, in the unit of the sums.

    ``sums`` (units, groups) are sums over groups of rays, and ``rays`` is the number of all rays.
    With g groups, the error contains the factor sqrt((g - 1)/(g - 3)) of Student's distribution.
    Deviations divided by it then have unit variance. It is widened if the groups are skewed, since
    their spread then underestimates the error: rare paths dominate it, and some were not met.
    """
    groups = min(rays, len(sums))
    mean = math.fsum(sums) / rays
    if groups < 4:
        return mean, math.inf
    spread = math.fsum((group_means(sums, rays) - mean) ** 2) / (groups * (groups - 3))
    excess = max(0.0, skewness_of(sums, rays) ** 2 - SKEWED**2)
    # so that 95 % intervals of rare reflections hold; see benchmarks/trace_coverage.py
    return mean, math.sqrt(spread * (1.0 + 0.75 * excess))


def skewness_of(sums: Array, rays: int) -> float:
    """Return the skewness of the means over groups of rays, 0 if they are equal.

    The arguments are those of `mean_of`.
    """
    means = group_means(sums, rays)
    deviations = means - math.fsum(means) / len(means)
    largest = float(np.abs(deviations).max())
    if len(means) < 4 or largest <= 1e-14 * float(np.abs(means).max()):
        return 0.0
    deviations = deviations / largest  # no underflow of the cubes
    return float((deviations**3).mean() / (deviations**2).mean() ** 1.5)


def group_means(sums: Array, rays: int) -> Array:
    """Return the means over the groups; their sizes differ by at most one ray."""
    groups = min(rays, len(sums))
    return sums[:groups] * (groups / rays)


def mean_map(sums: Array, rays: int) -> tuple[Array, Array]:
    """Return the mean of each pixel over the rays and its variance, in the unit of the sums.

    ``sums`` (groups, ...) are sums over groups of rays, and ``rays`` is the number of all rays. The
    variance contains the factor of Student's distribution of `mean_of`; it is infinite for fewer
    than four groups.
    """
    groups = min(rays, GROUPS)
    mean, spread = sums.sum(axis=0) / rays, np.zeros(sums.shape[1:])
    for one in sums[:groups]:  # one at a time, which needs a quarter of the memory
        spread += (one * (groups / rays) - mean) ** 2
    return mean, spread / (groups * (groups - 3)) if groups > 3 else np.full_like(mean, np.inf)


def result_of(
    job: Job, total: Array, counts: Counter[str], kept: list[Kept], stopped: str, seconds: float
) -> RayPaths:
    """Return the means and standard errors of all sums, and the paths that were kept."""
    from . import _light_kernels as kernels

    rays, most = counts.pop("rays"), job.max_bounces
    bounces = [mean_of(total[:, k], rays) for k in range(most + 1)]
    detected = total[:, : most + 1].sum(axis=1)
    flux = mean_of(detected, rays)
    tail = total[:, most + 1 :]
    stray = mean_of(tail[:, kernels.STRAY], rays)
    columns = {
        "absorbed by wall": tail[:, kernels.ABSORBED_WALL],
        "absorbed by object": tail[:, kernels.ABSORBED_OBJECT],
        "absorbed by occluders": tail[:, kernels.ABSORBED_OCCLUDERS],
        "escaped": tail[:, kernels.ESCAPED],
        "detected": detected + tail[:, kernels.STRAY],
        "blocked": tail[:, kernels.BLOCKED],
        "left": tail[:, kernels.LEFT],
        "unresolved": tail[:, kernels.UNRESOLVED_LIGHT],
    }
    ledger = {name: mean_of(column, rays) for name, column in columns.items()}
    named = {"flux": detected, "stray": tail[:, kernels.STRAY]}
    named |= {f"bounce {k}": total[:, k] for k in range(1, most + 1)}
    uncertain = tuple(n for n, sums in named.items() if abs(skewness_of(sums, rays)) > SKEWED)
    between = mean_of(tail[:, kernels.WALL_TO_WALL], rays)
    trapped = mean_of(tail[:, kernels.TRAPPED], rays)
    length = math.fsum(tail[:, kernels.LENGTHS]) / rays
    if not kept:
        empty, none = np.zeros(0), np.zeros((0, most + 2), dtype=np.int8)
        numbers = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int8)
        kept = [(np.zeros((0, most + 2, 3)), none, none, empty, empty, *numbers)]
    points, surface, lobe, lengths, powers, n_bounces, status = (
        np.concatenate(part) for part in zip(*kept, strict=True)
    )
    return RayPaths(
        points=points,
        path_length=lengths,
        weight=powers / rays,
        n_bounces=n_bounces,
        status=status,
        surface=surface,
        lobe=lobe,
        ledger=MappingProxyType({name: mean for name, (mean, _) in ledger.items()}),
        ledger_error=MappingProxyType({name: error for name, (_, error) in ledger.items()}),
        flux=flux[0],
        standard_error=flux[1],
        by_bounce=np.array([mean for mean, _ in bounces]),
        by_bounce_error=np.array([error for _, error in bounces]),
        stray=stray[0],
        stray_error=stray[1],
        wall_to_wall=between[0],
        trapped=trapped[0],
        trapped_error=trapped[1],
        mean_path_length=length / flux[0] if flux[0] > 0.0 else 0.0,
        n_rays=rays,
        stopped=stopped,
        uncertain=uncertain,
        unreached=tuple(text for least, text in job.around.chains.unreached if least <= most),
        seconds=seconds,
        queries=MappingProxyType(dict(counts)),
    )
