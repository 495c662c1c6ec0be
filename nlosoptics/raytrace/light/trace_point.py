"""Light of one point of the hidden object, traced by the relay wall onto the detector."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, one_of, positive, vector, whole
from ..._nouns import Noun
from ..._progress import Progress
from ...errors import SceneError
from ...kernels.codes import GROUPS
from ...scene import Lambert, PlanarObject, Scene
from ..fans.footprints import lens_footprint
from .trace import MOST, in_blocks, job_of, mean_of

if TYPE_CHECKING:
    from .point_blocks import Task

Array = NDArray[np.float64]
Emission = Literal["lambertian", "isotropic"]
EMISSIONS = ("lambertian", "isotropic")
#: Least rays of a pixel: fewer pairs of them do not tell its standard error.
LEAST = 16
#: Most of them, since those of a pixel are held at once.
LARGEST = 1 << 16
#: Sides of a wall, over the point's distance from it, up to which light goes evenly over the wall.
WIDE = 4.0
SPECK = 1e-9  # m, the size of what is left of the object


@dataclass(frozen=True, eq=False, kw_only=True)
class PointTrace(Noun):
    """Where the light of one object point lands, the point shining with 1 W.

    Parameters
    ----------
    energy, energy_error : ndarray, (ny, nx)
        Power on each pixel and its standard error, W; row 0 at the lowest y.
    pitch : float
        Side of a pixel, m.
    first : (float, float)
        Centre (x, y) of pixel [0, 0] on the detector's plane, from the camera's axis, m.
    flux, flux_error : float
        Power that the lens passes, wherever it lands, and its standard error, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1,)
        ``flux`` by the number of reflections, and its standard errors, W.
    missed, missed_error : float
        The part of ``flux`` that lands outside the pixels, and its standard error, W.
    n_rays : int
        Rays of the flux.
    rays_per_pixel : int
    seconds : float
        Wall-clock time.
    queries : mapping of str to int
        How often rays were held against each kind of surface, by name.
    """

    energy: Array
    energy_error: Array
    pitch: float
    first: tuple[float, float]
    flux: float
    flux_error: float
    by_bounce: Array
    by_bounce_error: Array
    missed: float
    missed_error: float
    n_rays: int
    rays_per_pixel: int
    seconds: float
    queries: Mapping[str, int]

    def __post_init__(self) -> None:
        for array in (self.energy, self.energy_error, self.by_bounce, self.by_bounce_error):
            array.flags.writeable = False

    @property
    def x(self) -> Array:
        """Centres of the columns, m."""
        return self.first[0] + self.pitch * np.arange(self.energy.shape[1], dtype=np.float64)

    @property
    def y(self) -> Array:
        """Centres of the rows, m."""
        return self.first[1] + self.pitch * np.arange(self.energy.shape[0], dtype=np.float64)


def trace_point(
    scene: Scene,
    object_point: ArrayLike | None = None,
    *,
    emission: Emission = "lambertian",
    mirror_image: bool = True,
    pitch: float | None = None,
    shape: tuple[int, int] | None = None,
    first: tuple[float, float] | None = None,
    n_rays: int = 1 << 16,
    max_bounces: int = 3,
    seed: int = 0,
    progress: Progress | None = None,
) -> PointTrace:
    """Follow the light of one object point by the wall to the detector.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        World, m; by default the hidden object's reference point.
    emission : {"lambertian", "isotropic"}
        How 1 W leaves the point: about the picture's normal (a mesh's points shine along -z), or
        alike into all directions.
    mirror_image : bool
        Whether to count what one reflection by the wall's mirror-like lobes sends to the lens. It
        makes the point's mirror image, which `psf.hybrid_point_spread` takes from waves instead.
    pitch : float, optional
        Side of a pixel, m; the camera's image pixel by default.
    shape : (int, int), optional
        Pixels (ny, nx); by default the camera's.
    first : (float, float), optional
        Centre (x, y) of pixel [0, 0], m; by default the pixels are centred on the camera's axis.
    n_rays : int
        Rays for the flux, and for the pixels together; a pixel gets 16 to 65536 of its own.
    max_bounces : int
        Reflections by the wall, 1 to 64; further ones occur on walls that see themselves alone.
    seed : int
        0 to 2^64 - 1. The same seed gives the same bits on any number of threads.
    progress : callable(str, float), optional
        Told "flux" or "pixels" and the fraction done.

    Returns
    -------
    PointTrace

    Raises
    ------
    SceneError
        If an option is out of range or the point is behind the wall.
    MemoryLimitError
        If the pixels would not fit in memory.

    Notes
    -----
    For the flux, vertices of the light, evenly over a wall that is not too wide, are joined to
    points of the lens; where a lobe is glossy,
    half of the light is aimed at where the wall shows the point, and walks that find the lens share
    the paths by the balance heuristic (Veach 1997, ch. 9). Smooth mirrors have rays of their own,
    aimed at their image. What one reflection by mirror-like lobes brings reaches the pixels from
    there. For all else every pixel has rays of its own, from the lens to what the pixel sees, which
    are joined to the point and to vertices of its light. Behind the thin lens light lands where its
    ray meets the plane in focus, drawn back through the lens's centre, so a wall out of focus is
    blurred. The hidden object itself is not in the way. Light that meets smooth mirrors alone, two
    or more of them, is found by chance, on walls that see themselves; where one of them is glossy,
    single pixels are far noisier than the rest. Rays of a pixel go evenly over what it sees: of a
    point much nearer to the wall than a pixel is wide there, they may find no light at all and no
    error either, which the sum of ``energy`` and ``missed`` far below ``flux`` tells.
    """
    from .point_blocks import Task, flux_of, pixels_of

    begun = time.perf_counter()
    one_of("emission", emission, EMISSIONS)
    whole("n_rays", n_rays, 1, MOST)
    alone = point_scene(scene, object_point)
    job = job_of(alone, max_bounces, "sobol", seed)
    pitch, (ny, nx), first = _window(alone, pitch, shape, first)
    each = min(max(LEAST, n_rays // (ny * nx) // 2 * 2), LARGEST)
    image_box, gloss_box = _boxes(alone)
    matt = alone.wall_material.diffuse
    task = Task(
        job=job,
        source=np.array([*alone.object_point, *point_normal(scene), emission == "isotropic"]),
        whole=_whole(alone),
        image_box=image_box,
        gloss_box=gloss_box,
        matt=np.zeros((0, 4)) if matt is None else matt.lobe_table(),
        mirror_image=mirror_image,
        window=(first[0] - pitch / 2, first[1] - pitch / 2, pitch, nx),
        rows=ny,
        each=each,
    )
    counts = Counter[str]()
    total, landed = np.zeros((GROUPS, task.columns)), np.zeros(GROUPS * ny * nx)
    for units, cells, powers, asked in in_blocks(flux_of, task, 0, n_rays):
        for unit in units:
            total += unit
        np.add.at(landed, cells, powers)
        counts += asked
        if progress is not None:
            progress("flux", min(1.0, counts["rays"] / n_rays))
    energy, variance = np.zeros(ny * nx), np.zeros(ny * nx)
    done, number = 0, job.sampler
    # Sobol points would give neighbours the same errors
    alike = replace(job, sampler=(number[0], number[1][:, :0], number[2][:, :0]))
    for mean, square, asked in in_blocks(pixels_of, replace(task, job=alike), 0, ny * nx):
        energy[done : done + len(mean)], variance[done : done + len(mean)] = mean, square
        done += len(mean)
        counts += asked
        if progress is not None:
            progress("pixels", done / (ny * nx))
    if landed.any():  # mirror images are a rare sight for pixels, so walks bring them
        mean, spread = _mean_map(landed.reshape(GROUPS, -1), n_rays)
        energy += mean
        variance += spread
    del counts["rays"]
    return _result(task, total, energy, variance, n_rays, time.perf_counter() - begun, counts)


def _mean_map(landed: Array, n_rays: int) -> tuple[Array, Array]:
    """Mean of what rays bring to pixels, by groups (groups, n), and its variance as `mean_of`."""
    groups = min(n_rays, GROUPS)
    mean, spread = landed.sum(axis=0) / n_rays, np.zeros(landed.shape[1])
    for one in landed[:groups]:  # not all at once, which would hold the groups four times
        spread += (one * (groups / n_rays) - mean) ** 2
    return mean, spread / (groups * (groups - 3)) if groups > 3 else np.full_like(mean, np.inf)


def point_scene(scene: Scene, object_point: ArrayLike | None) -> Scene:
    """The scene of one object point: a black speck there instead of the object, the focus kept.

    Raises
    ------
    SceneError
        If the scene is none, or the point is not finite or behind the wall.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    o = (
        scene.object_point
        if object_point is None
        else np.array(vector("object_point", object_point))
    )
    height = 0.0
    if not scene.wall.is_flat and bool(scene.wall.contains(o[0], o[1])):
        height = float(np.nan_to_num(scene.wall.height(o[0], o[1])))
    if o[2] <= max(height, 0.0) + SPECK:
        raise SceneError(
            f"object_point has z = {o[2]:g} m, behind the wall, whose height there is {height:g} "
            "m; move it into the room"
        )
    speck = PlanarObject(np.zeros((1, 1)), SPECK, position=tuple(o.tolist()), material=Lambert(0.0))
    camera = replace(scene.camera, focus_distance=scene.focus_distance)
    return replace(scene, hidden=speck, camera=camera)


def point_normal(scene: Scene) -> Array:
    """Direction about which a point of the object shines: the picture's normal, a mesh's -z."""
    if isinstance(scene.hidden, PlanarObject):
        return np.array(scene.hidden.axes[2])
    return np.array([0.0, 0.0, -1.0])


def _whole(scene: Scene) -> Array:
    """Rectangle of a wall that is small enough to be lit evenly, else one of no width."""
    size, distance = scene.wall.size, float(scene.object_point[2])
    if size is None or max(size) > WIDE * distance:
        return np.zeros(4)
    return np.array([-size[0] / 2, -size[1] / 2, size[0], size[1]])


def _boxes(scene: Scene) -> tuple[Array, Array]:
    """Where the wall shows the point to the lens, by smooth mirrors and by glossy lobes.

    Rectangles (low x, low y, width, height), m; of no width without such a lobe or such an image.
    """
    slopes = [lobe.slope_rms for lobe in scene.wall_material.mirror_lobes]
    none = np.zeros(4)
    if not slopes:
        return none, none
    try:
        lit = lens_footprint(scene.wall, scene.object_point, scene.camera)
    except SceneError:  # no image; the light finds the wall by itself
        return none, none
    middle = lit.points.mean(axis=0)
    legs = [float(np.linalg.norm(p - middle)) for p in (scene.object_point, scene.camera.position)]
    # facets three standard deviations off send light this far along the wall
    reach = 6.0 * max(slopes) * legs[0] * legs[1] / sum(legs)
    boxes = [none, none]
    for k, (wanted, more) in enumerate(((min(slopes) == 0.0, 0.0), (reach > 0.0, reach))):
        margin = more + 0.02 * (lit.high - lit.low) + 1e-6
        low, high = lit.low - margin, lit.high + margin
        if scene.wall.size is not None:
            edge = np.array(scene.wall.size) / 2
            low, high = np.maximum(low, -edge), np.minimum(high, edge)
        boxes[k] = np.array([*low, *(high - low)]) if wanted else none
    return boxes[0], boxes[1]


def _window(
    scene: Scene,
    pitch: float | None,
    shape: tuple[int, int] | None,
    first: tuple[float, float] | None,
) -> tuple[float, tuple[int, int], tuple[float, float]]:
    """Checked pitch, shape and centre of the first pixel."""
    camera = scene.camera
    pitch = camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    given = camera.shape if shape is None else shape
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise SceneError(f"shape = {shape!r}; give pixels (ny, nx)")
    ny, nx = (whole("shape", n) for n in given)
    fits_memory(f"{ny} x {nx} pixels (shape)", 8.0 * (GROUPS + 8) * ny * nx, "use fewer pixels")
    if first is None:
        return pitch, (ny, nx), (-(nx - 1) / 2 * pitch, -(ny - 1) / 2 * pitch)
    if not isinstance(first, (tuple, list)) or len(first) != 2:
        raise SceneError(f"first = {first!r}; give the centre (x, y) of pixel [0, 0] in m")
    x, y, _ = vector("first", (*first, 0.0))
    return pitch, (ny, nx), (x, y)


def _result(
    task: Task,
    total: Array,
    energy: Array,
    variance: Array,
    n_rays: int,
    seconds: float,
    counts: Counter[str],
) -> PointTrace:
    most = task.job.max_bounces
    low_x, low_y, pitch, columns = task.window
    bounces = [mean_of(total[:, k], n_rays) for k in range(most + 1)]
    flux = mean_of(total[:, : most + 1].sum(axis=1), n_rays)
    missed = mean_of(total[:, most + 1], n_rays)
    return PointTrace(
        energy=energy.reshape(task.rows, columns),
        energy_error=np.sqrt(variance).reshape(task.rows, columns),
        pitch=pitch,
        first=(low_x + pitch / 2, low_y + pitch / 2),
        flux=flux[0],
        flux_error=flux[1],
        by_bounce=np.array([mean for mean, _ in bounces]),
        by_bounce_error=np.array([error for _, error in bounces]),
        missed=missed[0],
        missed_error=missed[1],
        n_rays=n_rays,
        rays_per_pixel=task.each,
        seconds=seconds,
        queries=MappingProxyType(dict(counts)),
    )
