"""Point spread function of all lobes of a wall: waves for mirror-like lobes, rays for the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import expect, fits_memory, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed
from ..._vectors import Array
from ...errors import SceneError
from ...raytrace import PointTrace, ray_plan, trace_point
from ...raytrace.light.trace import MOST, MOST_BOUNCES
from ...raytrace.light.trace_point import EMISSIONS, Emission, point_normal, point_scene
from ...scene import Scene
from ..pupil.scene_optics import PointOptics, SceneOptics
from ..pupil.wall_wavefront import AimedWave
from ..rough.mean import RoughPointSpread, detilted_mean
from ..rough.roughness import Roughness
from ..rough.source import rough_view
from ..rough.view import RoughView
from ..transform.point_spread import PointSpread
from ..wave.regime import regime
from ..window.window import check_rays, middle, shape_of, window_side
from .scene_psf import error_of_sum, mirror_lobes


@dataclass(frozen=True, eq=False)
class MirrorImage:
    """Mirror image of one object point by a wall of reflectance 1."""

    aimed: AimedWave  # Wave and rays of the object point
    flux: float  # Power through the lens from a point that emits 1 W, W
    # (float, float); Position at which the chief ray meets the detector, from the camera's axis,
    # m.
    image: tuple[float, float]


def mirror_image(seen: PointOptics, aimed: AimedWave, normal: Array | None) -> MirrorImage:
    """Compute the flux and the position of an object point's mirror image at reflectance 1."""
    scene, wave, rays = seen.scene, aimed.wave, aimed.rays
    lit = wave.weights > 0.0
    light = np.zeros(int(lit.sum()))
    if not aimed.hidden:
        mine = lit[aimed.in_lens]
        hits, lens = rays.points[1:][mine], aimed.on_lens[1:][mine]
        light = _intensity(hits - seen.object_point, normal) * rays.spreading[1:][mine]
        light *= _past_the_field_stop(scene, hits, lens)
    area = wave.weights[lit] / seen.zoom**2
    toward = rays.points[0] - np.array(scene.camera.position)
    e1, e2, axis = scene.camera.frame
    scale = -scene.image_distance / float(toward @ axis)
    return MirrorImage(
        aimed,
        scene.camera.transmission * float(np.sum(area * light)),
        (scale * float(toward @ e1), scale * float(toward @ e2)),
    )


def _intensity(lines: Array, normal: Array | None) -> Array:
    """Return the radiant intensity (n,), W/sr, along directions (n, 3) from a point of 1 W.

    Emission is Lambertian about ``normal``, or isotropic if it is None.
    """
    if normal is None:
        return np.full(len(lines), 0.25 / math.pi)
    cosines = lines @ normal / np.linalg.norm(lines, axis=1)
    return np.asarray(np.maximum(cosines, 0.0) / math.pi)


def _past_the_field_stop(scene: Scene, on_wall: Array, on_lens: Array) -> float:
    """Return 1 if the camera's field stop passes the mirror image, 0 if it blocks it."""
    if scene.camera.field_stop is None:
        return 1.0
    lines = on_wall - on_lens
    cosines = lines @ scene.camera.axis / np.linalg.norm(lines, axis=1)
    passed = cosines >= math.cos(scene.camera.field_stop / 2)
    if passed.any() and not passed.all():
        raise SceneError(
            f"camera.field_stop = {scene.camera.field_stop:g} rad cuts "
            f"{100 - 100 * passed.mean():.2g} % of the mirror image's rays, must be 0 or 100 %; "
            "open the field stop or change camera.aim"
        )
    return float(passed.all())


def mirrored(
    mirror: MirrorImage,
    lobes: list[tuple[float, RoughView]],
    pitch: float,
    shape: tuple[int, int],
    tol: float,
) -> list[tuple[float, RoughPointSpread]]:
    """Return the power of each lobe's mirror image, W, and its point spread by waves.

    The point spreads cover the middle of the window, as far as they are not negligible.
    """
    if mirror.flux == 0.0 or not lobes:
        return []
    residual, parts = mirror.aimed.residual, []
    check_rays(residual, pitch, shape)
    side = window_side(residual, pitch, tol, mirror.aimed.outline)
    for reflectance, view in lobes:
        # in units of `RoughView.halo`, for a Gaussian C and for any other
        half = math.ceil((6 if view.has_tails else 1.5) * view.halo(residual.wavefront) / pitch)
        inner = min(side + 2 * half, shape[0]), min(side + 2 * half, shape[1])
        mean = detilted_mean(residual, view, tol, pitch, inner, pixel_integrated=True)
        parts.append((reflectance * mirror.flux, mean))
    return parts


@dataclass(frozen=True, eq=False, kw_only=True)
class HybridPointSpread(PointSpread):
    """Point spread function (PSF) of all light from a wall: mirror-like, scattered and diffuse.

    It has all fields of `PointSpread`, and the following. ``intensity`` is the sum of ``coherent``,
    ``halo`` and ``diffuse``. All arrays are read-only and have the unit of ``normalisation``.

    Parameters
    ----------
    coherent : ndarray, (ny, nx)
        Part that is reflected as by a smooth mirror, computed by waves.
    halo : ndarray, (ny, nx)
        Part that the roughness of the mirror-like reflection scatters, averaged over all walls of
        this roughness.
    diffuse : ndarray, (ny, nx)
        All other light: diffuse reflection, and several reflections. It is computed by random ray
        tracing.
    standard_error : ndarray, (ny, nx)
        Standard error of ``diffuse``.
    coherent_flux, halo_flux, diffuse_flux : float
        Energy of each part in the whole image plane, in the unit of ``normalisation``.
    diffuse_flux_error : float
        Standard error of ``diffuse_flux``.
    traced_flux, traced_flux_error : float
        Energy of all light in the whole image plane by an independent ray trace, and its standard
        error, in the unit of ``normalisation``. They check the sum of the three parts. Without the
        check they are 0 and infinity.
    flux : float
        Power through the lens, W, if the point emits 1 W in total. The argument ``emission`` of
        `hybrid_point_spread` says into which directions this light is emitted.

    See Also
    --------
    hybrid_point_spread : PSF of all lobes of the wall.
    nlosoptics.views.point_spread : Map of a PSF.
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

    _images = ("intensity", "coherent", "halo", "diffuse", "standard_error")


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
    """Compute the image of an object point by all light that the wall reflects.

    Mirror-like reflection is computed by waves. Diffuse reflection and several reflections are
    computed by ray tracing.

    Parameters
    ----------
    scene : Scene
        Scene with the wall, its material and the camera.
    object_point : array_like, (3,), optional
        As in `scene_point_spread`.
    roughness : Roughness, optional
        Statistics of the wall's heights. They replace ``slope_rms``, the rms slope of the
        microfacets in the mirror-like lobes (parts) of the wall's material. By default this slope
        blurs the image, as in `scene_point_spread`.
    emission : {"lambertian", "isotropic"}
        Directions into which the point emits: like a matt surface that faces along the normal of
        the planar hidden object (-z for a mesh), or equally in all directions.
    tol : float
        Largest error of the part computed by waves, relative to its peak; above 0, at most 1.
    n_rays : int
        Number of traced rays. The standard error falls as 1/sqrt(n_rays).
    max_bounces : int
        Largest number of reflections of a traced ray.
    pitch : float, optional
        Pixel side, m; by default that of the camera's image.
    shape : int or (int, int), optional
        Pixels (ny, nx), by default as many as the camera has. The chief ray, which passes the
        centre of the lens, meets the centre of pixel [ny//2, nx//2].
    normalisation : {"unit-sum", "flux"}
        Quantity that has the value 1: all energy that passes the lens ("unit-sum"), or the energy
        that would pass the lens if the wall were smooth and had the reflectance 1 ("flux"). Both
        energies are those behind the lens, after its transmission loss.
    check : bool
        Whether to trace all light once more by rays alone, as a check. It gives ``traced_flux``.
    seed : int
        Random seed of the traced rays.
    progress : callable(str, float), optional
        Called with the name of the stage and the completed fraction, 0 to 1.

    Returns
    -------
    HybridPointSpread
        Sum of three parts, and each part, integrated over pixels: the coherent image, as by a
        smooth mirror; the halo, which is mirror-like reflection scattered by roughness; and all
        other light, computed by ray tracing.

    Raises
    ------
    SceneError
        If an option is out of range, no light reaches the lens, or an occluder or the field stop
        blocks only a part of the mirror-like reflection that meets the lens.
    CausticError, NotWaveGradeError, SamplingError
        If the wave's aberration has no single value, a mesh wall is not accurate enough for waves,
        or ``tol`` cannot be reached.

    See Also
    --------
    scene_point_spread : PSF of the mirror-like reflection only.

    Notes
    -----
    One mirror-like reflection sends a power through the lens that is the product of three factors:
    the reflectance of the wall, the transmission of the lens, and the integral of the point's
    radiant intensity (W/sr) over the solid angle of the rays that reach the lens. For each part of
    the pupil, this solid angle follows from the amplitude of `wavefront`. The fraction
    ``exp(-s^2)`` of this power is coherent, with s the rms phase due to the roughness; the rest is
    the halo. A rough wall sends the same power to the pupil as a smooth one, to second order in the
    slope, if the wall is large enough: as much light is scattered into the pupil as out of it.

    The energies of the parts add. They do not interfere, because light scattered inside the
    material has no fixed phase relation to light reflected at its surface.
    """
    one_of("normalisation", normalisation, ("unit-sum", "flux"))
    one_of("emission", emission, EMISSIONS)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    whole("n_rays", n_rays, 1, MOST)
    whole("max_bounces", max_bounces, 1, MOST_BOUNCES)
    seed = checked_seed(seed)
    if roughness is not None:
        expect("roughness", roughness, "Roughness")
    alone = point_scene(scene, object_point)
    pitch = alone.camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    size = alone.camera.shape if shape is None else shape_of(shape)
    fits_memory(f"a shape of {size[0]} x {size[1]} pixels", 128.0 * math.prod(size), "use fewer")
    normal = point_normal(scene) if emission == "lambertian" else None
    seen = SceneOptics(alone).reference
    lobes = [(lobe.share, lobe.view) for lobe in mirror_lobes(seen)]
    if roughness is not None:
        view = rough_view(seen.first.wave, seen.view, roughness)
        lobes = [(sum(share for share, _ in lobes), view)] if lobes else []

    def waves(aimed: AimedWave) -> tuple[MirrorImage, list[tuple[float, RoughPointSpread]]]:
        mirror = mirror_image(seen, aimed, normal)
        return mirror, mirrored(mirror, lobes, pitch, size, tol)

    mirror, parts = seen.refined(waves)[1]
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
        # the rays of the check must be independent of those of the result
        every = run(shape=(1, 1), seed=seed ^ 1 << 63)
    found = _assembled(mirror, parts, traced, every, pitch, size, normalisation)
    if progress is not None:
        progress("hybrid", 1.0)
    return found


def _assembled(
    mirror: MirrorImage,
    parts: list[tuple[float, RoughPointSpread]],
    traced: PointTrace | None,
    every: PointTrace | None,
    pitch: float,
    shape: tuple[int, int],
    normalisation: str,
) -> HybridPointSpread:
    """Combine all parts in the unit of ``normalisation``."""
    coherent, halo, diffuse, spread = np.zeros((4, *shape))
    for watts, mean in parts:
        where = middle(shape, mean.shape)
        coherent[where] += watts * mean.coherent
        halo[where] += watts * mean.diffuse
    coherent_flux = sum(watts * mean.coherent_fraction for watts, mean in parts)
    halo_flux = sum(watts * (1.0 - mean.coherent_fraction) for watts, mean in parts)
    diffuse_flux, diffuse_error = 0.0, 0.0
    if traced is not None:
        diffuse, spread = traced.energy, traced.energy_error
        diffuse_flux, diffuse_error = traced.flux, traced.flux_error
    found = (0.0, math.inf) if every is None else (every.flux, every.flux_error)
    flux = coherent_flux + halo_flux + diffuse_flux
    if flux == 0.0:
        raise SceneError(
            "no light from the object point passes the lens; check camera.aim, wall_material and "
            "occluders"
        )
    unit = flux if normalisation == "unit-sum" else mirror.flux
    if unit == 0.0:
        raise SceneError(
            "normalisation = 'flux' needs a mirror image, but none reaches the lens; use 'unit-sum'"
        )
    reason = "no mirror image reaches the lens"
    if parts:
        ways = [mean.reason for _, mean in parts]
        reason = "; ".join(["waves for the mirror image, rays for all other paths", *ways])
    total = coherent + halo + diffuse
    peak = float(total.max())
    return HybridPointSpread(
        intensity=total / unit,
        pitch=pitch,
        method="hybrid",
        error_estimate=error_of_sum(parts, "error_estimate", peak),
        model_error=error_of_sum(parts, "model_error", peak),
        normalisation=normalisation,
        wavelength=mirror.aimed.wave.wavelength,
        f_number=mirror.aimed.wave.f_number,
        pixel_integrated=True,
        enclosed_energy=float(total.sum()) / flux,
        coherent=coherent / unit,
        halo=halo / unit,
        diffuse=diffuse / unit,
        standard_error=spread / unit,
        coherent_flux=coherent_flux / unit,
        halo_flux=halo_flux / unit,
        diffuse_flux=diffuse_flux / unit,
        diffuse_flux_error=diffuse_error / unit,
        traced_flux=found[0] / unit,
        traced_flux_error=found[1] / unit,
        flux=flux,
        regime=regime(mirror.aimed.residual, pitch),
        reason=reason,
    )
