"""Monte Carlo tracing of the light of one object point via the relay wall to the detector."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, one_of, positive, shown, vector, whole
from ..._nouns import Noun
from ..._progress import Progress
from ...errors import SceneError
from ...kernels.codes import GROUPS
from ...scene import Lambert, PlanarObject, Scene
from ..fans.footprints import lens_footprint
from .trace import MOST, in_blocks, job_of, mean_map, mean_of

if TYPE_CHECKING:
    from .point_blocks import Task

Array = NDArray[np.float64]
Emission = Literal["lambertian", "isotropic"]
EMISSIONS = ("lambertian", "isotropic")
SPECK = 1e-9  # m, side of the black square that replaces the hidden object


@dataclass(frozen=True, eq=False, kw_only=True)
class PointTrace(Noun):
    """Camera image of a single object point that emits 1 W, by Monte Carlo ray tracing.

    `trace_point` computes it. Its option ``emission`` makes the point a Lambertian or an
    isotropic source.

    Parameters
    ----------
    energy, energy_error : ndarray, (ny, nx)
        Power on each pixel and its standard error, W; row 0 at the lowest y of the detector.
    pitch : float
        Side of a pixel, m.
    first : (float, float)
        Centre (x, y) of pixel [0, 0] in the detector plane, relative to the optical axis, m.
    flux, flux_error : float
        Power transmitted by the lens, inside and outside the pixels, and its standard error, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1,)
        Element j is the part of ``flux`` that the wall reflected j times, and its standard error,
        W.
    missed, missed_error : float
        Part of ``flux`` that falls outside the pixels, and its standard error, W.
    n_rays : int
        Number of rays used for the flux.
    rays_per_pixel : int
        Number of rays used for each pixel.
    seconds : float
        Wall-clock time, s.
    queries : mapping of str to int
        Number of intersection tests by kind of surface, with the keys of `RayPaths.queries`.

    See Also
    --------
    trace_point : Light of one object point to the detector.
    nlosoptics.psf.hybrid_point_spread : PSF by mirror-like and diffuse reflection.
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
        """Centres of the pixel columns, (nx,), m."""
        return self.first[0] + self.pitch * np.arange(self.energy.shape[1], dtype=np.float64)

    @property
    def y(self) -> Array:
        """Centres of the pixel rows, (ny,), m."""
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
    """Compute the camera image of one object point via the wall, by Monte Carlo ray tracing.

    The result is a point spread function by geometrical optics, without diffraction. It includes
    both diffuse and mirror-like reflection by the wall.

    Parameters
    ----------
    scene : Scene
        Scene to trace; its laser is not used.
    object_point : array_like, (3,), optional
        Emitting point, world frame (origin at the centre of the relay wall, z toward the room, y
        up), m. By default the centre of the hidden image, or the centroid of the hidden mesh.
    emission : {"lambertian", "isotropic"}
        Angular distribution of the 1 W that the point emits: Lambertian about the normal of the
        hidden image (-z for a mesh), or equal in all directions.
    mirror_image : bool
        Whether to include the mirror image of the point: light that reaches the lens after one
        reflection by the mirror-like part of the wall's material.
        `nlosoptics.psf.hybrid_point_spread` sets this to False, because it computes that light from
        waves.
    pitch : float, optional
        Side of a pixel, m; by default that of the camera's image pixels.
    shape : (int, int), optional
        Number of pixels (ny, nx); by default the camera's.
    first : (float, float), optional
        Centre (x, y) of pixel [0, 0] in the detector plane, m; by default the pixels are centred
        on the optical axis.
    n_rays : int
        Number of rays for the power through the lens, `PointTrace.flux`. About as many again are
        divided among the pixels, with at least 16 and at most 65536 for each.
    max_bounces : int
        Largest number of reflections at the wall, 1 to 64. More than one occurs only on walls that
        can illuminate themselves.
    seed : int
        Seed of the random numbers, as for `trace`.
    progress : callable(str, float), optional
        Called with ``"flux"`` or ``"pixels"`` and the completed fraction, 0 to 1.

    Returns
    -------
    PointTrace
        Power per pixel and power through the lens, with standard errors.

    Raises
    ------
    SceneError
        If an option is out of range, the point is behind the wall, or an occluder reflects light.
    MemoryLimitError
        If the pixels would not fit in memory.

    See Also
    --------
    trace : Light from the laser to the detector.
    nlosoptics.psf.hybrid_point_spread : PSF by mirror-like and diffuse reflection.

    Notes
    -----
    The power through the lens, ``flux``: rays from the object point are spread uniformly over the
    wall (on a wide wall, in proportion to the point's emission). Each wall point that they meet is
    connected to a point of the lens. If the wall has a glossy lobe, half of the rays are aimed at
    the part of the wall in which the lens sees the mirror image of the point. Reflected rays that
    hit the lens are then counted in addition to the connections. Each of the two is weighted by its
    probability density relative to the sum of both (balance heuristic), so that no light is counted
    twice. A smooth mirror gets additional rays, aimed at the mirror image.

    The power on each pixel, ``energy``: light of one mirror-like reflection is taken from the same
    rays as ``flux``. For all other light, separate rays are traced from the lens into the field of
    view of each pixel. The wall points that they meet are connected to the object point and to wall
    points that it lights. The lens is an ideal thin lens: all rays through one point of the plane
    in focus meet at one point of the detector. A wall in another plane is therefore blurred.

    The method has three limits:

    - The hidden object does not block light.
    - On walls that can illuminate themselves, no rays are aimed at paths with two or more
      mirror-like reflections, so that few rays find them. If a mirror-like part of the wall's
      material has an rms slope above 0, such paths make single pixels far noisier than the others.
    - A pixel sees a patch of the wall. If the object point is much closer to the wall than this
      patch is wide, the rays of the pixel may miss the bright part of the patch, and the standard
      error does not show it. A sign: the sum of ``energy`` over all pixels plus ``missed``, the
      part of ``flux`` that falls outside the pixels, is far below ``flux``.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> image = raytrace.trace_point(scene, pitch=4e-3, shape=(3, 3), n_rays=1024, seed=0)
    >>> image.energy.shape, image.rays_per_pixel, image.y.round(6).tolist()
    ((3, 3), 112, [-0.004, 0.0, 0.004])
    """
    from .point_blocks import Task, flux_of, pixels_of

    begun = time.perf_counter()
    one_of("emission", emission, EMISSIONS)
    whole("n_rays", n_rays, 1, MOST)
    smooth = point_scene(scene, object_point)
    alone = smooth.with_relief()
    job = job_of(alone, max_bounces, "sobol", seed, chained=False)
    pitch, (ny, nx), first = _window(alone, pitch, shape, first)
    # fewer pairs have unreliable errors; all rays of a pixel are in memory at the same time
    each = min(max(16, n_rays // (ny * nx) // 2 * 2), 1 << 16)
    image_box, gloss_box = _boxes(smooth)
    matt = alone.wall_material.diffuse
    task = Task(
        job=job,
        source=np.array([*alone.object_point, *point_normal(scene), emission == "isotropic"]),
        whole=_whole(alone),
        image_box=image_box,
        gloss_box=gloss_box,
        matt=np.zeros((0, 7)) if matt is None else matt.lobe_table(),
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
    # with Sobol points the errors of neighbouring pixels would be correlated
    alike = replace(job, sampler=(number[0], number[1][:, :0], number[2][:, :0]))
    for mean, square, asked in in_blocks(pixels_of, replace(task, job=alike), 0, ny * nx):
        energy[done : done + len(mean)], variance[done : done + len(mean)] = mean, square
        done += len(mean)
        counts += asked
        if progress is not None:
            progress("pixels", done / (ny * nx))
    if landed.any():  # the rays of a pixel rarely find mirror images; the rays of the flux do
        mean, spread = mean_map(landed.reshape(GROUPS, -1), n_rays)
        energy += mean
        variance += spread
    del counts["rays"]
    return _result(task, total, energy, variance, n_rays, time.perf_counter() - begun, counts)


def point_scene(scene: Scene, object_point: ArrayLike | None) -> Scene:
    """Return the scene with a tiny black square at the object point as its hidden object.

    The camera keeps its focus distance. `SceneError` if the point is behind the wall, or an
    occluder reflects light.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    scene.check_black_occluders()
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
    """Return the axis of a point's emission, (3,): normal of the image, -z for a mesh."""
    if isinstance(scene.hidden, PlanarObject):
        return np.array(scene.hidden.axes[2])
    return np.array([0.0, 0.0, -1.0])


def _whole(scene: Scene) -> Array:
    """Return the wall's rectangle (low x, low y, width, height), m, for uniform sampling."""
    size, distance = scene.wall.size, float(scene.object_point[2])
    if size is None or max(size) > 4.0 * distance:
        return np.zeros(4)
    return np.array([-size[0] / 2, -size[1] / 2, size[0], size[1]])


def _boxes(scene: Scene) -> tuple[Array, Array]:
    """Return the rectangles of the wall in which the lens sees the point mirrored."""
    relieved = scene.with_relief()
    slopes = [lobe.slope_rms for lobe in relieved.wall_material.mirror_lobes]
    none = np.zeros(4)
    if not slopes:
        return none, none
    try:
        lit = lens_footprint(scene.wall, scene.object_point, scene.camera)
    except SceneError:  # no mirror image to aim at
        return none, none
    middle = lit.points.mean(axis=0)
    legs = [float(np.linalg.norm(p - middle)) for p in (scene.object_point, scene.camera.position)]
    # a facet shifts the reflection point by its slope times this length, m
    shift = 2.0 * legs[0] * legs[1] / sum(legs)
    reach = 3.0 * max(slopes) * shift
    wider = 0.0
    if scene.wall_roughness is not None and relieved.wall is not scene.wall:
        wider = scene.wall_roughness.steepest * shift
    boxes = [none, none]
    for k, (wanted, more) in enumerate(((min(slopes) == 0.0, wider), (reach > 0.0, reach))):
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
    """Return pixel pitch, shape and centre of the first pixel, checked and with defaults."""
    camera = scene.camera
    pitch = camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    given = camera.shape if shape is None else shape
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise SceneError(f"shape = {shown(shape)}; give pixels (ny, nx)")
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
    """Return the result with means and standard errors of all sums."""
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
