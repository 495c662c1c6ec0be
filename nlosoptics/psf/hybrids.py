"""Point spread of a whole wall material: waves for its mirror-like lobes, rays for the rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory, in_range, one_of, positive
from ..errors import SamplingError, SceneError
from ..raytrace import PointTrace, ray_plan, trace_point
from ..raytrace.points import EMISSIONS, Emission, mirror_lobes, point_normal, point_scene
from ..scene import Scene, SpecularMicrofacet
from .aberration import wavefront
from .aiming import aim, pupil_points
from .facet_waves import wall_view
from .obstruction import hides
from .point_spreads import PointSpread, point_spread
from .pupils import exit_pupil
from .residuals import split
from .rough_means import Halo, converged
from .rough_views import RoughView
from .roughness import Roughness
from .transfers import transfer
from .wavefronts import Wavefront
from .windows import Window, check_rays, shape_of, window_side

Array = NDArray[np.float64]
NORMALISATIONS: Final = ("unit-sum", "flux")
#: Rayleigh parameter of a lobe of a given slope: the halo has its slopes' shape to 1/s^2.
ROUGH_LIMIT: Final = 1e3
#: Radius of the halo's window over `RoughView.halo`, 3 standard deviations of a Gaussian C.
REACH: Final = 1.5
WIDE: Final = 6.0  # the same of any other
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


@dataclass(frozen=True, eq=False)
class _Mirror:
    """The wall as a mirror: its wave, and W through the lens from 1 W by reflectance 1."""

    scene: Scene
    wave: Wavefront
    flux: float
    image: tuple[float, float]


@dataclass(frozen=True, eq=False)
class _Waves:
    """What waves tell of the mirror image, W, and their largest error, W a pixel."""

    coherent: Array
    halo: Array
    error: float
    coherent_flux: float
    halo_flux: float


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
    progress: Callable[[str, float], None] | None = None,
) -> HybridPointSpread:
    """Image of an object point by all that the wall's material does.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        World, m; by default the hidden object's reference point.
    roughness : Roughness, optional
        Heights on the mirror-like lobes, in place of the slopes that the material gives them. By
        default a lobe without slope is smooth, and one with a slope scatters all its light with
        Gaussian slopes.
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
        If an option is out of range, an occluder or the field stop cuts a part of the mirror image,
        or a lobe has tails that no slope tells.
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
    alone = point_scene(scene, object_point)
    pitch = alone.camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    size = alone.camera.shape if shape is None else shape_of(shape)
    fits_memory(f"parts of {size[0]} x {size[1]} pixels", 128.0 * math.prod(size), "use fewer")
    smooth, rough = _lobes(alone, roughness)
    normal = point_normal(scene) if emission == "lambertian" else None
    mirror = _mirror(alone, normal)
    waves = _waves(mirror, smooth, rough, pitch, size, tol)
    options: dict[str, Any] = {"emission": emission, "n_rays": n_rays, "max_bounces": max_bounces}
    traced, every = None, None
    if alone.wall_material.diffuse is not None or ray_plan(alone).wall_to_wall:
        first = (mirror.image[0] - size[1] // 2 * pitch, mirror.image[1] - size[0] // 2 * pitch)
        window = {"pitch": pitch, "shape": size, "first": first}
        traced = _trace(scene, alone, seed, progress, mirror_image=False, **window, **options)
    if check:
        every = _trace(scene, alone, seed ^ OTHER, progress, shape=(1, 1), **options)
    found = _assembled(mirror, waves, traced, every, pitch, normalisation)
    if progress is not None:
        progress("hybrid", 1.0)
    return found


def _lobes(scene: Scene, roughness: Roughness | None) -> tuple[float, list[tuple[float, Any]]]:
    """Reflectance of the smooth mirrors, and (reflectance, roughness or slope) of rough ones."""
    material = scene.wall_material
    lobes = mirror_lobes(material)
    if roughness is not None:
        total = sum(reflectance for reflectance, _ in lobes)
        return 0.0, [(total, roughness)] if total > 0.0 else []
    for part in getattr(material, "parts", (material,)):
        tails = isinstance(part, SpecularMicrofacet) and part.distribution == "ggx"
        if tails and part.specular_reflectance > 0.0 and part.slope_rms > 0.0:
            raise SceneError(
                f"wall_material has a mirror-like GGX lobe of slope_rms = {part.slope_rms:g} rad, "
                "whose long tails no Gaussian slopes make; give roughness, or use 'beckmann'"
            )
    smooth = sum(reflectance for reflectance, slope in lobes if slope == 0.0)
    return smooth, [lobe for lobe in lobes if lobe[1] > 0.0]


def _mirror(scene: Scene, normal: Array | None) -> _Mirror:
    """Wave and flux of the wall as a mirror of reflectance 1, seen from the scene's one point."""
    pupil = exit_pupil(scene)
    layout = "polar" if pupil.stop == "lens" and pupil.vignetting == 0.0 else "grid"
    try:
        wave = wavefront(scene, nodes=layout)
    except SamplingError:  # an edge that only the curved wall's rays meet
        if layout == "grid":
            raise
        wave = wavefront(scene, nodes="grid")
    o, centre, axis = scene.object_point, np.array(scene.camera.position), scene.camera.axis
    zoom = pupil.image_distance / scene.image_distance
    lit = wave.weights > 0.0
    on_lens = np.stack([wave.u[lit], wave.v[lit]], axis=1) / zoom
    lens = pupil_points(centre, axis, np.concatenate([np.zeros((1, 2)), on_lens]))
    rays = aim(scene.wall, o, lens, axis)
    if hides(scene, o, rays.points, lens):
        light = np.zeros(len(on_lens))
    else:
        light = _intensity(rays.points[1:] - o, normal) * rays.spreading[1:]
        light *= _past_the_field_stop(scene, rays.points[1:], lens[1:])
    area = wave.weights[lit] / zoom**2
    toward = rays.points[0] - centre
    e1, e2, _ = scene.camera.frame
    scale = -scene.image_distance / float(toward @ axis)
    return _Mirror(
        scene,
        wave,
        scene.camera.transmission * float(np.sum(area * light)),
        (scale * float(toward @ e1), scale * float(toward @ e2)),
    )


def _intensity(lines: Array, normal: Array | None) -> Array:
    """Radiant intensity along lines (n, 3) from a point of 1 W, W/sr; even without a normal."""
    if normal is None:
        return np.full(len(lines), 0.25 / math.pi)
    cosines = lines @ normal / np.linalg.norm(lines, axis=1)
    return np.asarray(np.maximum(cosines, 0.0) / math.pi)


def _past_the_field_stop(scene: Scene, on_wall: Array, on_lens: Array) -> float:
    """Whether the camera's baffle lets the mirror image pass, 1 or 0."""
    if scene.camera.field_stop is None:
        return 1.0
    lines = on_wall - on_lens
    cosines = lines @ scene.camera.axis / np.linalg.norm(lines, axis=1)
    passed = cosines >= math.cos(scene.camera.field_stop / 2)
    if passed.any() and not passed.all():
        raise SceneError(
            f"camera.field_stop = {scene.camera.field_stop:g} rad cuts {100 - 100 * passed.mean():.2g}"
            " % of the mirror image's light, limit 0 or 100 %; open it or aim the camera elsewhere"
        )
    return float(passed.all())


def _waves(
    mirror: _Mirror,
    smooth: float,
    rough: list[tuple[float, Any]],
    pitch: float,
    shape: tuple[int, int],
    tol: float,
) -> _Waves:
    """Coherent part and halo, W."""
    coherent, halo, error = np.zeros(shape), np.zeros(shape), 0.0
    fluxes = [0.0, 0.0]
    if mirror.flux == 0.0 or (smooth == 0.0 and not rough):
        return _Waves(coherent, halo, error, 0.0, 0.0)
    residual = split(mirror.wave)
    check_rays(residual, pitch, shape)
    side = window_side(residual, pitch, tol)
    core = None
    views = [(r * mirror.flux, _view(mirror, given)) for r, given in rough]
    bright = smooth * mirror.flux
    bright += sum(w * math.exp(-(v.rayleigh_parameter**2)) for w, v in views)
    if bright > 0.0:
        inner = (min(side, shape[0]), min(side, shape[1]))
        core = point_spread(mirror.wave, tol=tol, pitch=pitch, shape=inner, pixel_integrated=True)
        coherent[_middle(shape, inner)] = bright * core.intensity
        fluxes[0], error = bright, core.error_estimate * float(coherent.max())
    smooth_transfer = transfer(residual)
    for watts, view in views:
        if view.rayleigh_parameter == 0.0:
            continue
        named = isinstance(view.roughness.autocorrelation, str)
        gaussian = named and view.roughness.autocorrelation == "gaussian"
        half = math.ceil((REACH if gaussian else WIDE) * view.halo(mirror.wave) / pitch)
        inner = (min(side + 2 * half, shape[0]), min(side + 2 * half, shape[1]))
        sum_over = Halo(residual, smooth_transfer, view, Window.centred(pitch, inner), True)
        found, missed = converged(sum_over, np.zeros(inner), tol)
        if missed > tol:
            raise SamplingError(
                f"the halo of the rough mirror reaches an error of {missed:.2g}, limit tol = "
                f"{tol:g}; use tol = {missed:.2g}"
            )
        halo[_middle(shape, inner)] += watts * found
        fluxes[1] += watts * -math.expm1(-(view.rayleigh_parameter**2))
        error += watts * missed * float(found.max())
    return _Waves(coherent, halo, error, *fluxes)


def _middle(shape: tuple[int, int], inner: tuple[int, int]) -> tuple[slice, slice]:
    """Where a window lies in a larger one of the same centre."""
    rows, columns = (
        slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(shape, inner, strict=True)
    )
    return rows, columns


def _view(mirror: _Mirror, given: Roughness | float) -> RoughView:
    """Roughness, or that of Gaussian slopes alone, as the pupil sees it."""
    seen = wall_view(mirror.scene)
    per_metre = 2 * math.pi / mirror.wave.wavelength * seen.cos_sum
    if not isinstance(given, Roughness):
        height = ROUGH_LIMIT / per_metre
        given = Roughness(height, math.sqrt(2.0) * height / given)
    return RoughView(given, seen.footprint, per_metre * given.height_rms)


def _trace(
    scene: Scene,
    alone: Scene,
    seed: int,
    progress: Callable[[str, float], None] | None,
    **options: Any,
) -> PointTrace:
    return trace_point(scene, alone.object_point, seed=seed, progress=progress, **options)


def _assembled(
    mirror: _Mirror,
    waves: _Waves,
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
        wavelength=mirror.wave.wavelength,
        f_number=mirror.wave.f_number,
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
    )
