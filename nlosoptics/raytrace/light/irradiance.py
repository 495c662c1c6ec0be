"""Maps of the irradiance on the relay wall by light that returns to it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, one_of, pair, whole, whole_pair
from ..._nouns import Noun
from ...errors import SceneError
from ...kernels.codes import GROUPS
from ...scene import Lambert, Scene
from .trace import MOST, MOST_BOUNCES, in_blocks, job_of, mean_map, mean_of

if TYPE_CHECKING:
    from .blocks import Job

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class WallIrradiance(Noun):
    """Map of the irradiance on the relay wall, as `wall_irradiance` returns it.

    Parameters
    ----------
    x, y : ndarray, (nx,) and (ny,)
        Centres of the cells, world frame, m.
    irradiance : ndarray, (ny, nx)
        Power that arrives on each cell, divided by the area of the wall's surface in it, W/m^2; row
        0 at the lowest y. With ``source="laser"``, the laser beam that lights the wall directly is
        left out.
    standard_error : ndarray, (ny, nx)
        Standard error of ``irradiance``, W/m^2.
    power, power_error : float
        Power on all cells together and its standard error, W.
    n_rays : int
        Number of rays traced.
    seconds : float
        Wall-clock time, s.

    See Also
    --------
    wall_irradiance : Map of the light that returns to the wall.
    """

    x: Array
    y: Array
    irradiance: Array
    standard_error: Array
    power: float
    power_error: float
    n_rays: int
    seconds: float

    def __post_init__(self) -> None:
        for array in (self.x, self.y, self.irradiance, self.standard_error):
            array.flags.writeable = False


def wall_irradiance(
    scene: Scene,
    *,
    shape: tuple[int, int] = (64, 64),
    size: tuple[float, float] | None = None,
    source: Literal["laser", "object"] = "laser",
    n_rays: int = 1 << 18,
    max_bounces: int = 2,
    sampler: Literal["sobol", "philox"] = "sobol",
    seed: int = 0,
) -> WallIrradiance:
    """Compute a map of the irradiance on the relay wall, by Monte Carlo ray tracing.

    Parameters
    ----------
    scene : Scene
        Scene to trace.
    shape : (int, int)
        Number of cells of the map, (ny, nx).
    size : (float, float), optional
        Width and height of the map, centred on the origin, m; by default the size of the wall.
    source : {"laser", "object"}
        ``"laser"``: the laser's light that returns to the wall after one or more reflections. The
        direct irradiance of the laser spot is left out. ``"object"``: the laser is off, and the
        hidden object emits as a Lambertian source. Its radiant exitance is 1 W/m^2, times the
        reflectance of each point of a hidden image.
    n_rays : int
        Number of rays.
    max_bounces : int
        Largest number of reflections before light arrives at the wall: 1 to 62, or 0 to 62 with
        ``source="object"``, where 0 gives the direct light of the object alone.
    sampler, seed
        Random numbers, as for `trace`.

    Returns
    -------
    WallIrradiance
        Irradiance and its standard error in every cell.

    Raises
    ------
    SceneError
        If an option is out of range, or the wall is unbounded and no size is given.
    MemoryLimitError
        If the map would not fit in memory.

    See Also
    --------
    trace : Light from the laser to the detector.

    Notes
    -----
    The arriving light is sampled in two ways. Each point that reflects a ray is connected to a
    random point of the wall, and rays that happen to hit the wall are counted. Each of the two is
    weighted by its probability density relative to the sum of both (balance heuristic), so that no
    light is counted twice. The standard errors come from 32 independent groups of rays. On a rough
    wall, the irradiance is the power per area of the mean surface.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> light = raytrace.wall_irradiance(scene, shape=(4, 6), n_rays=1024)
    >>> light.irradiance.shape, light.x.round(3).tolist()
    ((4, 6), [-0.583, -0.35, -0.117, 0.117, 0.35, 0.583])
    """
    scene = expect("scene", scene, "Scene")
    one_of("source", source, ("laser", "object"))
    ny, nx = whole_pair("shape", shape)
    whole("n_rays", n_rays, 1, MOST)
    whole("max_bounces", max_bounces, 0 if source == "object" else 1, MOST_BOUNCES - 2)
    size = scene.wall.size if size is None else pair("size", size)
    if size is None:
        raise SceneError(
            "wall.size is unbounded, so the map has no extent; give size, its width and height in m"
        )
    fits_memory(f"a map of {nx} x {ny} cells (shape)", 8 * GROUPS * nx * ny, "map fewer cells")
    begun = time.perf_counter()
    if source == "laser":
        scene.check_laser_light()
    else:
        scene = replace(scene, hidden=replace(scene.hidden, material=Lambert(1.0)))
    # the walk must be long enough to include the last arrival at the wall
    job = job_of(scene, max_bounces + 2, sampler, seed)
    step = np.divide(size, (nx, ny))
    corner = -np.divide(size, 2)

    def work(job: Job, first: int, end: int) -> tuple[NDArray[np.int64], Array]:
        return _arrivals(job, first, end, source, max_bounces, (corner, step, (ny, nx)))

    sums = np.zeros(GROUPS * ny * nx)
    for cells, powers in in_blocks(work, job, 0, n_rays):
        np.add.at(sums, cells, powers)
    maps = sums.reshape(GROUPS, ny, nx)
    x, y = (c + s * (np.arange(n) + 0.5) for c, s, n in zip(corner, step, (nx, ny), strict=True))
    areas = step[0] * step[1] / _upright(scene, x, y)
    mean, variance = mean_map(maps, n_rays)
    power, power_error = mean_of(maps.sum(axis=(1, 2)), n_rays)
    return WallIrradiance(
        x=x,
        y=y,
        irradiance=mean / areas,
        standard_error=np.sqrt(variance) / areas,
        power=power,
        power_error=power_error,
        n_rays=n_rays,
        seconds=time.perf_counter() - begun,
    )


def _upright(scene: Scene, x: Array, y: Array) -> Array:
    """Return the cosine of the wall's tilt at the map's cell centres, (ny, nx)."""
    if scene.wall.is_flat:
        return np.ones((len(y), len(x)))
    xs, ys = np.meshgrid(x, y)
    cosines = np.asarray(scene.wall.normal(xs, ys))[..., 2]
    return np.where(np.isfinite(cosines), cosines, 1.0)


def _arrivals(
    job: Job,
    first: int,
    end: int,
    source: str,
    max_bounces: int,
    grid: tuple[Array, Array, tuple[int, int]],
) -> tuple[NDArray[np.int64], Array]:
    """Return map cells and powers, W, of all light that a block of rays brings to the wall."""
    from . import _light_kernels as kernels
    from . import _point_kernels as arriving
    from . import _surround_kernels as surround
    from .blocks import Rays

    rays, n, around = Rays(job, first, end - first), end - first, job.around
    if source == "laser":
        light = rays.from_laser()
    else:
        light = np.zeros((n, kernels.VERTEX))
        norm = around.world.norm
        if norm > 0.0:
            arriving.glow(around.world, job.sampler, first, 1.0 / norm, light)
        else:
            light[:, kernels.SURFACE] = surround.NOTHING
    corner, step, shape = grid
    area = float(np.prod(step * shape[::-1]))
    targets = _targets(job, first, n, corner, step * shape[::-1])
    arrived, power = [], np.empty(n)

    def collect(points: Array, power: Array) -> None:
        """Append the map cells and powers, W, of light that arrives at wall points (n, 3), m."""
        cells, powers = np.empty(n, dtype=np.int64), np.empty(n)
        count = arriving.cells_of(points, power, first, *grid, cells, powers)
        arrived.append((cells[:count], powers[:count]))

    # the laser's first vertex is a reflection, whereas the object's is the source itself
    for bounce in range(1, max_bounces + (1 if source == "laser" else 2)):
        arriving.to_wall(around.world, light, targets, power, rays.starts, rays.ends)
        on_wall = light[:, kernels.SURFACE] == surround.WALL
        around.clear(rays.starts, rays.ends, on_wall, power, rays.counts)
        collect(targets, power)
        light = rays.onward(light, bounce)
        arriving.arrivals(light, 1.0 / area, power)
        collect(light, power)
    return np.concatenate([c for c, _ in arrived]), np.concatenate([p for _, p in arrived])


def _targets(job: Job, first: int, n: int, corner: Array, size: Array) -> Array:
    """Return one wall vertex per ray, spread uniformly in x and y over the map."""
    from . import _light_kernels as kernels
    from . import _point_kernels as arriving
    from . import _surround_kernels as surround

    wall, xy = job.scene.wall, np.empty((n, 2))
    arriving.spots(job.sampler, first, corner, size, xy)
    targets = np.zeros((n, kernels.VERTEX))
    targets[:, :2] = xy
    targets[:, 5] = 1.0
    on = np.asarray(wall.contains(xy[:, 0], xy[:, 1]))
    if not wall.is_flat:
        targets[:, 2] = wall.height(xy[:, 0], xy[:, 1])
        targets[:, kernels.N] = wall.normal(xy[:, 0], xy[:, 1])
        on &= np.isfinite(targets[:, :6]).all(axis=1)
    targets[:, kernels.SURFACE] = np.where(on, surround.WALL, surround.NOTHING)
    targets[:, kernels.DENSITY] = targets[:, 5] / float(size.prod())
    return targets
