"""Point spread of a whole wall material: waves for its mirror-like lobes, rays for the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory, in_range, one_of, positive, whole
from .._progress import Progress
from .._random import checked_seed
from ..errors import SceneError
from ..raytrace import PointTrace, ray_plan, trace_point
from ..raytrace.points import EMISSIONS, Emission, point_normal, point_scene
from ..raytrace.tracing import MOST, MOST_BOUNCES
from ..scene import Scene
from .aberration import AimedWave
from .hybrid_waves import MirrorImage, WaveParts, image_lobes, mirror_image, wave_parts
from .point_spreads import PointSpread
from .regimes import regime
from .roughness import Roughness
from .scene_optics import SceneOptics
from .windows import shape_of

Array = NDArray[np.float64]
NORMALISATIONS: Final = ("unit-sum", "flux")
#: Turns the seed into that of the check's rays, which must not be those of the result.
OTHER: Final = 1 << 63


@dataclass(frozen=True, eq=False, kw_only=True)
class HybridPointSpread(PointSpread):
    """Image of a point by a wall of several lobes, with its parts.

    Parameters
    ----------
    coherent : ndarray
        (ny, nx), read-only: light of the smooth mirror, by waves.
    halo : ndarray
        What the roughness of the mirror-like lobes scatters, on average over walls.
    diffuse : ndarray
        All other light, traced: of diffuse lobes, and of more than one reflection.
    standard_error : ndarray
        Of ``diffuse``.
    coherent_flux, halo_flux, diffuse_flux : float
        Light of each part in the whole image plane, in the unit of ``normalisation``.
    diffuse_flux_error : float
        Its standard error.
    traced_flux, traced_flux_error : float
        The same light by a trace of all lobes with rays of its own, and its standard error: a check
        of the sum of the three. 0 and infinity where it was not asked for.
    flux : float
        Power through the lens of a point that shines with 1 W, W.
    """

    coherent: Array
    halo: Array
    diffuse: Array
    standard_error: Array
    coherent_flux: float
    halo_flux: float
    diffuse_flux: float
    diffuse_flux_error: float
    traced_flux: float
    traced_flux_error: float
    flux: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("coherent", "halo", "diffuse", "standard_error"):
            array = np.array(getattr(self, name), dtype=np.float64, order="C")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


def hybrid_point_spread(
    scene: Scene,
    object_point: ArrayLike | None = None,
    *,
    roughness: Roughness | None = None,
    emission: Emission = "lambertian",
    tol: float = 1e-3,
    n_rays: int = 1 << 16,
    max_bounces: int = 3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Literal["unit-sum", "flux"] = "unit-sum",
    check: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> HybridPointSpread:
    """Image of an object point by all that the wall's material does.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        World, m; by default the hidden object's reference point.
    roughness : Roughness, optional
        Heights on the mirror-like lobes, in place of the slopes that the material gives them. By
        default a lobe without slope is smooth, and one with a slope scatters all its light by its
        slopes, as of `lobe_point_spread`.
    emission : {"lambertian", "isotropic"}
        As of `raytrace.trace_point`.
    tol : float
        Largest error of the wave part, relative to its peak.
    n_rays, max_bounces, seed
        As of `raytrace.trace_point`.
    pitch : float, optional
        Pixel side, m; by default the camera's image pixel.
    shape : int or (int, int), optional
        Pixels (ny, nx); by default the camera's.
    normalisation : {"unit-sum", "flux"}
        What 1 means: all that passes the lens, wherever it lands; or what a smooth wall of
        reflectance 1 would send through it.
    check : bool
        Whether to trace all lobes as well, for ``traced_flux``.
    progress : callable(str, float), optional
        Told the stage and the fraction done.

    Returns
    -------
    HybridPointSpread
        Integrated over pixels; the chief ray's image is the centre of pixel [ny//2, nx//2].

    Raises
    ------
    SceneError
        If an option is out of range, or an occluder or the field stop cuts a part of the mirror
        image.
    CausticError, NotWaveGradeError, SamplingError
        Where the mirror image has no wave, or no transform reaches ``tol``.
    MemoryLimitError
        If the pixels would not fit in memory.

    Notes
    -----
    One reflection by the mirror-like lobes sends ``R T Int I(p) s(p) dp`` through the lens, I the
    radiant intensity toward the pupil point p and s the spreading of ray tubes (`psf.wavefront`
    has its root as the amplitude). Of this ``exp(-s^2)`` is coherent and the rest is halo
    (`mean_point_spread`). A rough wall sends the pupil what a smooth one does, to second order in
    the slope: light that is scattered out is made up for by light scattered in, as long as the
    wall reaches far enough. All other light is traced. The parts' energies add, for a rough
    surface and the body below it share no phase.
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    one_of("emission", emission, EMISSIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    whole("n_rays", n_rays, 1, MOST)
    whole("max_bounces", max_bounces, 1, MOST_BOUNCES)
    seed = checked_seed(seed)
    alone = point_scene(scene, object_point)
    pitch = alone.camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    size = alone.camera.shape if shape is None else shape_of(shape)
    fits_memory(f"parts of {size[0]} x {size[1]} pixels", 128.0 * math.prod(size), "use fewer")
    smooth, rough = image_lobes(alone, roughness)
    normal = point_normal(scene) if emission == "lambertian" else None
    seen = SceneOptics(alone).reference

    def parts(aimed: AimedWave) -> tuple[MirrorImage, WaveParts]:
        mirror = mirror_image(seen, aimed, normal)
        return mirror, wave_parts(seen, mirror, smooth, rough, pitch, size, tol)

    mirror, waves = seen.refined(parts)[1]
    run = partial(
        trace_point,
        scene,
        alone.object_point,
        emission=emission,
        n_rays=n_rays,
        max_bounces=max_bounces,
        progress=progress,
    )
    traced = every = None
    if alone.wall_material.diffuse is not None or ray_plan(alone).wall_to_wall:
        first = (mirror.image[0] - size[1] // 2 * pitch, mirror.image[1] - size[0] // 2 * pitch)
        traced = run(mirror_image=False, pitch=pitch, shape=size, first=first, seed=seed)
    if check:
        every = run(shape=(1, 1), seed=seed ^ OTHER)
    found = _assembled(mirror, waves, traced, every, pitch, normalisation)
    if progress is not None:
        progress("hybrid", 1.0)
    return found


def _assembled(
    mirror: MirrorImage,
    waves: WaveParts,
    traced: PointTrace | None,
    every: PointTrace | None,
    pitch: float,
    normalisation: str,
) -> HybridPointSpread:
    """All parts in the unit that was asked for."""
    dark = np.zeros(waves.coherent.shape)
    diffuse, spread = (dark, dark) if traced is None else (traced.energy, traced.energy_error)
    diffuse_flux = (0.0, 0.0) if traced is None else (traced.flux, traced.flux_error)
    found = (0.0, math.inf) if every is None else (every.flux, every.flux_error)
    flux = waves.coherent_flux + waves.halo_flux + diffuse_flux[0]
    if flux == 0.0:
        raise SceneError(
            "no light of the object point passes the lens; check camera.aim, wall_material and "
            "what stands in the way"
        )
    unit = flux if normalisation == "unit-sum" else mirror.flux
    if unit == 0.0:
        raise SceneError(
            "normalisation = 'flux' needs a mirror image, and none reaches the lens; use 'unit-sum'"
        )
    total = waves.coherent + waves.halo + diffuse
    return HybridPointSpread(
        intensity=total / unit,
        pitch=pitch,
        method="hybrid",
        error_estimate=waves.error / float(total.max()) if waves.error > 0.0 else 0.0,
        normalisation=normalisation,
        wavelength=mirror.aimed.wave.wavelength,
        f_number=mirror.aimed.wave.f_number,
        pixel_integrated=True,
        enclosed_energy=float(total.sum()) / flux,
        coherent=waves.coherent / unit,
        halo=waves.halo / unit,
        diffuse=diffuse / unit,
        standard_error=spread / unit,
        coherent_flux=waves.coherent_flux / unit,
        halo_flux=waves.halo_flux / unit,
        diffuse_flux=diffuse_flux[0] / unit,
        diffuse_flux_error=diffuse_flux[1] / unit,
        traced_flux=found[0] / unit,
        traced_flux_error=found[1] / unit,
        flux=flux,
        regime=regime(mirror.aimed.residual, pitch),
        reason=waves.reason,
    )
