"""The mirror image of an object point, by waves: its smooth core and its halo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError, SceneError
from ..scene import MirrorLobe, Scene
from .aberration import AimedWave
from .estimates import rounded_up
from .halos import Halo
from .lobes import ROUGH, lobe_roughness, split_lobes
from .point_spreads import detilted_point_spread
from .rough_views import RoughView, rough_view
from .roughness import Roughness
from .scene_optics import PointOptics
from .transfers import transfer
from .wavefronts import Wavefront
from .windows import Window, check_rays, middle, window_side

Array = NDArray[np.float64]
#: Radius of the halo's window over `RoughView.halo`, 3 standard deviations of a Gaussian C.
REACH: Final = 1.5
WIDE: Final = 6.0  # the same of any other C


@dataclass(frozen=True, eq=False)
class MirrorImage:
    """The wall as a mirror of reflectance 1, seen from one object point.

    Parameters
    ----------
    aimed : AimedWave
        Wave and rays of the object point.
    flux : float
        Power through the lens from a point of 1 W, W.
    image : (float, float)
        Where the chief ray meets the detector, from the camera's axis, m.
    """

    aimed: AimedWave
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


def mirror_image(seen: PointOptics, aimed: AimedWave, normal: Array | None) -> MirrorImage:
    """Flux and place of the mirror image of an object point.

    Parameters
    ----------
    seen : PointOptics
        Optics of the object point.
    aimed : AimedWave
        Its wave.
    normal : ndarray, (3,), or None
        Direction about which the point shines as a Lambert emitter; None for even light.

    Returns
    -------
    MirrorImage
    """
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
    seen: PointOptics,
    mirror: MirrorImage,
    smooth: float,
    rough: list[tuple[float, Roughness | MirrorLobe]],
    pitch: float,
    shape: tuple[int, int],
    tol: float,
) -> WaveParts:
    """Coherent part and halo of a mirror image.

    Parameters
    ----------
    seen : PointOptics
        Optics of the object point.
    mirror : MirrorImage
    smooth, rough
        Lobes, from `image_lobes`.
    pitch : float
        Pixel side, m.
    shape : (int, int)
        Pixels (ny, nx).
    tol : float
        Largest error relative to the peak.

    Returns
    -------
    WaveParts
    """
    coherent, halo, error = np.zeros(shape), np.zeros(shape), 0.0
    fluxes = [0.0, 0.0]
    if mirror.flux == 0.0 or (smooth == 0.0 and not rough):
        return WaveParts(coherent, halo, error, 0.0, 0.0, "no mirror image reaches the lens")
    residual = mirror.aimed.residual
    check_rays(residual, pitch, shape)
    side = window_side(residual, pitch, tol, mirror.aimed.outline)
    core = None
    wave = residual.wavefront
    views = [(r * mirror.flux, _view(seen, wave, given)) for r, given in rough]
    bright = smooth * mirror.flux
    bright += sum(w * math.exp(-(v.rayleigh_parameter**2)) for w, v in views)
    if bright > 0.0:
        inner = (min(side, shape[0]), min(side, shape[1]))
        core = detilted_point_spread(
            residual, tol=tol, pitch=pitch, shape=inner, pixel_integrated=True
        )
        coherent[middle(shape, inner)] = bright * core.intensity
        fluxes[0], error = bright, core.error_estimate * float(coherent.max())
    smooth_transfer = transfer(residual)
    for watts, view in views:
        if view.rayleigh_parameter == 0.0:
            continue
        named = isinstance(view.roughness.autocorrelation, str)
        gaussian = named and view.roughness.autocorrelation == "gaussian"
        half = math.ceil((REACH if gaussian else WIDE) * view.halo(wave) / pitch)
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


def _view(seen: PointOptics, wave: Wavefront, given: Roughness | MirrorLobe) -> RoughView:
    """Roughness, or that of a lobe's slopes alone, as the pupil sees it."""
    if not isinstance(given, Roughness):
        per_metre = 2 * math.pi / wave.wavelength * seen.view.cos_sum
        given = lobe_roughness(given, ROUGH, ROUGH / per_metre)
    return rough_view(wave, seen.view, given)
