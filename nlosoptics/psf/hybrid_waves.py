"""The mirror image of an object point, by waves: its smooth core and its halo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError, SceneError
from ..scene import MirrorLobe, Scene
from .aberration import wavefront
from .aiming import aim, pupil_points
from .estimates import rounded_up
from .facet_waves import wall_view
from .halos import Halo
from .lobes import ROUGH, lobe_roughness, split_lobes
from .obstruction import hides
from .point_spreads import point_spread
from .pupils import exit_pupil
from .residuals import split
from .rough_views import RoughView
from .roughness import Roughness
from .transfers import transfer
from .wavefronts import Wavefront
from .windows import Window, check_rays, middle, window_side

Array = NDArray[np.float64]
#: Radius of the halo's window over `RoughView.halo`, 3 standard deviations of a Gaussian C.
REACH: Final = 1.5
WIDE: Final = 6.0  # the same of any other C


@dataclass(frozen=True, eq=False)
class MirrorImage:
    """The wall as a mirror: its wave, and W through the lens from 1 W by reflectance 1."""

    scene: Scene
    wave: Wavefront
    flux: float
    image: tuple[float, float]


@dataclass(frozen=True, eq=False)
class WaveParts:
    """What waves tell of the mirror image, W, and their largest error, W a pixel."""

    coherent: Array
    halo: Array
    error: float
    coherent_flux: float
    halo_flux: float
    reason: str


def image_lobes(
    scene: Scene, roughness: Roughness | None
) -> tuple[float, list[tuple[float, Roughness | MirrorLobe]]]:
    """Reflectance of the smooth mirrors, and (reflectance, roughness or lobe) of rough ones."""
    if roughness is not None:
        total = scene.wall_material.specular_reflectance
        return 0.0, [(total, roughness)] if total > 0.0 else []
    rough, smooth = split_lobes(scene)
    return smooth, [(lobe.specular_reflectance, lobe) for lobe in rough]


def mirror_image(scene: Scene, normal: Array | None) -> MirrorImage:
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
    return MirrorImage(
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
            f"camera.field_stop = {scene.camera.field_stop:g} rad cuts "
            f"{100 - 100 * passed.mean():.2g} % of the mirror image's light, limit 0 or 100 %; "
            "open it or aim the camera elsewhere"
        )
    return float(passed.all())


def wave_parts(
    mirror: MirrorImage,
    smooth: float,
    rough: list[tuple[float, Roughness | MirrorLobe]],
    pitch: float,
    shape: tuple[int, int],
    tol: float,
) -> WaveParts:
    """Coherent part and halo, W."""
    coherent, halo, error = np.zeros(shape), np.zeros(shape), 0.0
    fluxes = [0.0, 0.0]
    if mirror.flux == 0.0 or (smooth == 0.0 and not rough):
        return WaveParts(coherent, halo, error, 0.0, 0.0, "no mirror image reaches the lens")
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
        coherent[middle(shape, inner)] = bright * core.intensity
        fluxes[0], error = bright, core.error_estimate * float(coherent.max())
    smooth_transfer = transfer(residual)
    for watts, view in views:
        if view.rayleigh_parameter == 0.0:
            continue
        named = isinstance(view.roughness.autocorrelation, str)
        gaussian = named and view.roughness.autocorrelation == "gaussian"
        half = math.ceil((REACH if gaussian else WIDE) * view.halo(mirror.wave) / pitch)
        inner = (min(side + 2 * half, shape[0]), min(side + 2 * half, shape[1]))
        window = Window.centred(pitch, inner)
        sum_over = Halo(residual, view, window, True, smooth_transfer.reach)
        found, nodes, _, missed = sum_over.converged(smooth_transfer.at, np.zeros(inner), tol)
        missed += float(np.abs(nodes.factor).sum()) * smooth_transfer.error
        missed /= float(found.max())
        if missed > tol:
            raise SamplingError(
                f"the halo of the rough mirror reaches an error of {missed:.2g}, limit tol = "
                f"{tol:g}; use tol = {rounded_up(1.5 * missed)}"
            )
        halo[middle(shape, inner)] += watts * found
        fluxes[1] += watts * -math.expm1(-(view.rayleigh_parameter**2))
        error += watts * missed * float(found.max())
    reason = "waves for the mirror image, rays for all other light"
    if core is not None:
        reason += f"; core: {core.reason}"
    return WaveParts(coherent, halo, error, fluxes[0], fluxes[1], reason)


def _view(mirror: MirrorImage, given: Roughness | MirrorLobe) -> RoughView:
    """Roughness, or that of a lobe's slopes alone, as the pupil sees it."""
    seen = wall_view(mirror.scene)
    per_metre = 2 * math.pi / mirror.wave.wavelength * seen.cos_sum
    if not isinstance(given, Roughness):
        given = lobe_roughness(given, ROUGH, ROUGH / per_metre)
    return RoughView(given, seen.footprint, per_metre * given.height_rms)
