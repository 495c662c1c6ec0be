"""Polarisation of the camera image, by Monte Carlo light transport."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, fits_memory, real, vector, whole
from ..._nouns import Noun
from ..._progress import Progress
from ...errors import SceneError
from ...kernels.codes import BECKMANN, GROUPS
from ...scene import Scene
from ..fans.paths import RayPaths
from ..light import _light_kernels as kernels
from ..light.blocks import Job, Traced, follow
from ..light.trace import MOST, in_blocks, job_of, mean_map, until_done
from . import _image_kernels as image_kernels
from .image_blocks import NO_CELLS, Cells, FilmRays, in_order, met_object

Array = NDArray[np.float64]
NO_BINS = (0.0, 1.0, 0, True)


@dataclass(frozen=True, eq=False, kw_only=True)
class PolarisedImage(Noun):
    """Stokes parameters of the light on every pixel, as `trace_polarised` returns them.

    The arrays are read-only. Images are ordered [y, x], with row 0 at the lowest y of the detector.
    Light polarised along the camera's axis e1, the first row of ``camera.frame``, has Q = I; along
    e1 + e2 it has U = I. The axes are projected perpendicular to each ray.

    Parameters
    ----------
    power, power_error : ndarray, (4, ny, nx)
        Stokes parameters I, Q, U and V of the light that met the hidden object, as power on each
        pixel, and their standard errors, W.
    stray, stray_error : ndarray, (4, ny, nx)
        Stokes parameters of the light that never met the hidden object, and their standard errors,
        W.
    pitch : float
        Side of an image pixel, m.
    groups : ndarray, (32, 2, ny, nx, 4)
        Means of the 32 groups of rays from which the errors follow, W. Axis 1: stray light, light
        that met the object.
    paths : RayPaths
        Flux, power balance and number of the rays without polarisation, that is, for lobes that
        reflect polarised light as unpolarised light.

    See Also
    --------
    trace_polarised : Stokes parameters of an image.
    """

    power: Array
    power_error: Array
    stray: Array
    stray_error: Array
    pitch: float
    groups: Array
    paths: RayPaths

    def __post_init__(self) -> None:
        for name in ("power", "power_error", "stray", "stray_error", "groups"):
            getattr(self, name).flags.writeable = False

    def through(self, angle: float, *, stray: bool = False) -> tuple[Array, Array]:
        """Return the image through a linear polariser (analyser) in front of the lens.

        Parameters
        ----------
        angle : float
            Angle of the transmitted field from e1 toward e2 of the camera, rad.
        stray : bool
            Whether to return the light that never met the hidden object, instead of the light that
            did.

        Returns
        -------
        power, error : ndarray, (ny, nx)
            Power on each pixel and its standard error, W.
        """
        turn = 2.0 * real("angle", angle)
        weights = 0.5 * np.array([1.0, math.cos(turn), math.sin(turn), 0.0])
        rays = self.paths.n_rays
        sums = (self.groups[:, 0 if stray else 1] @ weights) * (rays / min(rays, GROUPS))
        power, variance = mean_map(sums, rays)
        return power, np.sqrt(variance)


def trace_polarised(
    scene: Scene,
    *,
    laser_axis: Vector | None = None,
    n_rays: int = 1 << 16,
    max_bounces: int = 5,
    sampler: Literal["sobol", "philox"] = "sobol",
    seed: int = 0,
    progress: Progress | None = None,
) -> PolarisedImage:
    """Compute the polarisation of the camera image by Monte Carlo ray tracing.

    Parameters
    ----------
    scene : Scene
        Scene to trace. All glossy lobes must be `nlosoptics.scene.SpecularMicrofacet` with an
        ``index``.
    laser_axis : (float, float, float), optional
        Direction of the laser's electric field, world frame, for linear polarisation; its part
        perpendicular to the beam counts. By default the laser is unpolarised.
    n_rays : int
        Number of rays.
    max_bounces : int, default 5
        Largest number of reflections, 1 to 64.
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
    PolarisedImage
        Stokes parameters of every pixel, and images through a polariser.

    Raises
    ------
    SceneError
        If an option is out of range, a part of the scene is behind the wall, a glossy lobe has no
        refractive index, or ``laser_axis`` is parallel to the beam.
    MemoryLimitError
        If the sums would not fit in memory.

    See Also
    --------
    trace_image : Image and histogram of path lengths, without polarisation.

    Notes
    -----
    The rays are those of `trace`, without its chains of mirror-like reflections;
    ``paths.unreached`` names the light that is therefore found by chance only. Each facet of a lobe
    with a refractive index reflects light by Fresnel's equations [1]_, as a Mueller matrix in its
    plane of incidence. The matrix is scaled so that the facet reflects the fraction ``reflectance``
    of unpolarised light at any angle, as in all other computations. Diffuse lobes (`Lambert`,
    `OrenNayar`) send out unpolarised light.

    The light of the diffuse lobes is therefore divided equally between any two crossed polarisers,
    and the difference between two such images is due to the glossy lobes alone.

    References
    ----------
    .. [1] Born and Wolf, Principles of Optics, 7th ed., sec. 1.5.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from nlosoptics import Scene, raytrace
    >>> from nlosoptics.scene import Lambert
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> matt = replace(scene, wall_material=Lambert(0.7))
    >>> image = raytrace.trace_polarised(matt, laser_axis=(0, 1, 0), n_rays=1024, max_bounces=3)
    >>> bool(image.power[0].sum() > 0.0), bool(abs(image.power[1:]).max() == 0.0)
    (True, True)
    """
    if isinstance(scene, Scene):
        _refuse_unknown(scene)
    whole("n_rays", n_rays, 1, MOST)
    job = job_of(scene, max_bounces, sampler, seed, chained=False)
    ny, nx = job.scene.camera.shape
    fits_memory(
        f"a polarised image of {nx} x {ny} pixels (camera.pixels, camera.binning)",
        8.0 * 8 * (2 * GROUPS + 8) * nx * ny,
        "bin more pixels",
    )
    film = StokesFilm(job, (ny, nx), laser_axis)
    paths = until_done(job, film.exposed, n_rays, None, None, progress)
    found = [mean_map(film.sums[:, k], n_rays) for k in range(2)]
    stray, power = ((np.moveaxis(v, -1, 0).copy() for v in (x, np.sqrt(y))) for x, y in found)
    (stray_mean, stray_error), (mean, error) = stray, power
    return PolarisedImage(
        power=mean,
        power_error=error,
        stray=stray_mean,
        stray_error=stray_error,
        pitch=job.scene.camera.image_pitch,
        groups=film.sums * (min(n_rays, GROUPS) / n_rays),
        paths=paths,
    )


def _refuse_unknown(scene: Scene) -> None:
    """Raise `SceneError` if the polarisation of the light that a lobe reflects is unknown."""
    for name, material in scene.materials.items():
        for lobe in material.lobe_table():
            if lobe[0] >= BECKMANN and lobe[1] > 0.0 and lobe[5] == 0.0:
                raise SceneError(
                    f"{name} has a glossy lobe without a refractive index, so that the "
                    "polarisation of its light is unknown; use SpecularMicrofacet with index, for "
                    "example 1.5 for paint"
                )


class StokesFilm:
    """Sums of the Stokes parameters of detected light by group of rays and pixel.

    Parameters
    ----------
    job : Job
        Scene and options.
    shape : (int, int)
        Rows and columns of the image.
    laser_axis : (float, float, float) or None
        As in `trace_polarised`.

    Attributes
    ----------
    sums : ndarray, (groups, 2, ny, nx, 4)
        Sums for stray light and for light that met the object, W times rays.
    """

    def __init__(self, job: Job, shape: tuple[int, int], laser_axis: Vector | None) -> None:
        self.job, self.shape = job, shape
        beam = job.around.world.laser[3:6]
        self.axis: Vector = tuple(job.around.world.laser[6:9].tolist())
        self.laser = (1.0, 0.0, 0.0, 0.0)
        if laser_axis is not None:
            self.axis = vector("laser_axis", laser_axis)
            size = float(np.linalg.norm(self.axis))
            if not float(np.linalg.norm(np.cross(self.axis, beam))) > 1e-6 * size:
                raise SceneError(
                    f"laser_axis = {self.axis} is parallel to the beam or zero, but light is "
                    "polarised across its direction; give a direction across the beam"
                )
            self.laser = (1.0, 1.0, 0.0, 0.0)
        self.sums = np.zeros((GROUPS, 2, *shape, 4))

    def exposed(self, start: int, end: int) -> Iterator[Traced]:
        """Trace the rays from ``start`` to ``end``, add their light, and yield all other results.

        The sums do not depend on the number of threads; see `image_blocks.Film.exposed`.
        """
        sums = self.sums.reshape(-1, 4)
        for found, (cells, stokes) in in_blocks(_polarised, self, start, end):
            np.add.at(sums, cells, stokes)
            yield found


def _polarised(film: StokesFilm, first: int, end: int) -> tuple[Traced, tuple[Cells, Array]]:
    """Trace the rays ``first`` to ``end - 1`` and return their results and their detected light."""
    block = PolarisedRays(film, first, end - first)
    found = follow(block)
    return found, in_order(block.landed, NO_CELLS, np.zeros((0, 4)), NO_CELLS)


class PolarisedRays(FilmRays):
    """Block of rays that adds up the Stokes parameters of its detected light.

    ``film`` has the pixels and the polarisation of the laser.
    """

    def __init__(self, film: StokesFilm, first: int, n: int) -> None:
        super().__init__(film.job, film.shape, NO_BINS, first, n)
        self.film = film

    def take_detected(
        self, power: Array, length: Array, vertices: list[Array], ends: Array, bounce: int
    ) -> None:
        """Find the pixels of detected light; `Rays.take_detected` describes the arguments."""
        film, n_light = self.film, len(self.walked)
        # only light that a mirror sent to the lens has no connection after the light path's end
        mirrored = np.zeros(self.n, dtype=bool)
        if vertices is self.walked:
            np.greater_equal(self.leave[:, kernels.MIRROR], 0.0, out=mirrored)
        met = met_object(vertices).astype(np.int64)
        ends = np.ascontiguousarray(ends)
        cells, _, powers, rays = self.sorted((met, 2), power, length, vertices, ends)
        stokes = np.empty((self.n, 4))
        image_kernels.path_stokes(
            self.around.world,
            np.ascontiguousarray(power),
            np.stack(vertices),
            n_light,
            mirrored,
            ends,
            film.laser,
            film.axis,
            stokes,
        )
        self.landed.append((cells, stokes[rays] * powers[:, None], rays))
