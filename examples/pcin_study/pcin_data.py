"""Exposures of the study: the scenes of examples/scenes through `nlosoptics.simulate`.

Three scales. "paper": camera, light and geometry of Wu et al. 2024 as the scene files have them, a
region of interest about the axis. "smooth" and "rough": the same walls and distances, but another
stop, with pixels at Nyquist of its Airy disc, on which a wall's wave can be fitted. At "smooth" the
walls make waves of half a wavelength rms. At "rough" they also have facets whose speckle fills the
frame, and the object is so small that one speckle pattern nearly holds for all of it.

What is fitted did not make the data: the detector is simulated with pixels half as wide, with the
noise of each, and four of them are summed.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import nlosoptics as nlos
from nlosoptics import imaging, inverse, psf, reconstructing
from nlosoptics.runs.veil import veil_shape
from nlosoptics.scene import Scene, WavyWall

Array = NDArray[np.float64]
Place = tuple[str, str, str, int, int]  # scale, object, wall, pixels a side, seed of the facets

SCENES = Path(__file__).parents[1] / "scenes"
OBJECTS = {
    "letter": "letter_flat",
    "posed": "letter_posed",
    "cartoon": "cartoon_flat",
    "hanzi": "hanzi_flat",
    "tilted": "letter_tilted",
}
WALLS = ("flat", "concave", "convex", "wavy")
FINE = 2  # simulated pixels along each side of an image pixel
# Errors of the simulated image, whose noise is 3 % and more.
TOL = {"paper": 4e-3, "smooth": 4e-3, "rough": 4e-3}
MODES = tuple(range(4, 22))  # Noll, n = 2..5
# The file's wavy wall, 0.1 mm, makes less than 0.1 waves rms under this stop. Here the axis meets a
# crest, so that the view stays where it is, with a radius of 2.0 m, near what the caustic allows.
WAVY = {"amplitude": 0.8e-3, "phase": 0.0}
DIVERSITY = 0.5  # waves rms, focus of the second frame


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Choices of a scale whose pixels resolve the wave.

    ``stop`` is the lens's, m; ``power`` the laser's, W; ``fill`` the object picture's share of the
    frame's side; ``facets`` changes the roughness of letter_rough.toml, None: a smooth wall.
    """

    stop: float
    power: float
    fill: float = 1.0
    facets: dict[str, str] | None = None


SCALES = {
    # The concave wall makes 0.50 waves rms, the convex 0.49. Pixels have 1/1054 of the paper's area
    # and the stop 1/11.4; with so much light a white pixel has the 1100 electrons of the paper's
    # geometry at 40 ms.
    "smooth": Optics(stop=7.4e-3, power=60.0),
    # A wider stop lets one pattern hold over more pixels: within 4.3 mm, the letter has 0.8 mm.
    # With so much light the brightest speckle of the letter has 1100 electrons at 40 ms.
    "rough": Optics(
        stop=15e-3,
        power=1800.0,
        fill=0.375,
        facets={"wall.roughness.cell": "0.5 mm", "wall.material[1].slope_rms": "0.8 mrad"},
    ),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Exposure:
    """One exposure and its truth, electrons, (n, n).

    ``noise`` is what the camera's data sheet says of it, rms over the frame: photons and readout.
    ``scene`` is the one whose pixels the arrays have: that of the fits, not of the simulation.
    """

    image: Array
    truth: Array
    noise: float
    scene: Scene
    seconds: float


def study_scene(place: Place, exposure: float, *, fine: int = 1, focus: float = 0) -> Scene:
    """Scene of an object and a wall.

    Parameters
    ----------
    place : (str, str, str, int, int)
        Scale; a key of `OBJECTS`; one of `WALLS`; image pixels a side; seed of the facets.
    exposure : float
        s.
    fine : int
        Detector pixels along each side of an image pixel.
    focus : float
        Change of the lens's focus, 1/m.
    """
    scale, name, wall, size, seed = place
    scene = Scene.load(SCENES / f"{OBJECTS[name]}.toml")
    bent = Scene.load(SCENES / f"letter_{wall}.toml").wall
    camera = replace(scene.camera, exposure=exposure)
    scene = replace(scene, wall=bent)
    if scale == "paper":
        width, pixels = camera.pixel_pitch, size * camera.binning
    else:
        optics = SCALES[scale]
        if isinstance(bent, WavyWall):
            scene = replace(scene, wall=replace(bent, **WAVY))
        if optics.facets is not None:
            rough = Scene.load(
                SCENES / "letter_rough.toml", {**optics.facets, "wall.roughness.seed": seed}
            )
            scene = replace(
                scene, wall_material=rough.wall_material, wall_roughness=rough.wall_roughness
            )
        width, pixels = nyquist_pixel(scene, optics.stop), size
        camera = replace(camera, stop_diameter=optics.stop, binning=1)
        frame = optics.fill * size * width * _depth(scene) / scene.image_distance
        scene = replace(
            scene,
            # incoherent light: a bare laser's speckle would be as wide as these pixels
            laser=replace(scene.laser, power=optics.power, independent_patterns=None),
            hidden=replace(scene.hidden, size=(frame, frame)),
        )
    camera = replace(
        camera,
        pixels=(pixels * fine, pixels * fine),
        pixel_pitch=width / fine,
        read_noise=camera.read_noise / fine,
        dark_current=camera.dark_current / fine**2,
        full_well=camera.full_well / fine**2,
    )
    scene = replace(scene, camera=camera)
    if scale != "paper":
        scene = _aimed(scene)
    return _refocused(scene, focus) if focus else scene


def nyquist_pixel(scene: Scene, stop: float) -> float:
    """Half of lambda times the working F-number of the stop, m, less what rounding needs."""
    return 0.999 * scene.laser.wavelength * scene.image_distance / stop / 2.0


@lru_cache(maxsize=256)
def exposure_of(place: Place, milliseconds: int, seed: int, *, second: bool = False) -> Exposure:
    """Simulate an exposure with noise by a seed; ``second`` is the one with a changed focus."""
    scale = place[0]
    focus = focus_step(scale) if second else 0.0
    where = (place, milliseconds * 1e-3)
    drawn = zlib.crc32(repr((*where, seed, second)).encode())
    found = nlos.simulate(study_scene(*where, fine=FINE, focus=focus), TOL[scale], seed=drawn)
    image, fitted = _summed(found.image.electrons), study_scene(*where, focus=focus)
    readout = fitted.camera.read_noise * fitted.camera.binning
    return Exposure(
        image=image,
        truth=_summed(found.image.ideal),
        noise=math.sqrt(max(float(image.mean()), 0.0) + readout**2),
        scene=fitted,
        seconds=sum(found.timings.values()),
    )


@lru_cache(maxsize=64)
def known_model(place: Place, *, mean: bool = False) -> imaging.ForwardModel:
    """Image model of the scene's own point spreads, or of their mean, at the image's pixels."""
    return reconstructing.known_model(study_scene(place, 40e-3), tol=TOL[place[0]], mean=mean)


@lru_cache(maxsize=64)
def veil(place: Place) -> Array | None:
    """Shape of the wall's diffuse light in the image."""
    shape = veil_shape(study_scene(place, 40e-3))
    return shape if shape.any() else None


def flat_scene(scale: str, size: int, *, focus: float = 0.0) -> Scene:
    """Scene of the letter and a flat wall without facets."""
    scene = study_scene((scale, "letter", "flat", size, 0), 40e-3, focus=focus)
    return replace(scene, wall_roughness=None)


def fitted_pupil(scale: str, size: int, *, cells: int = 0) -> inverse.PupilPSF:
    """Point spread with an unknown wave, at 0: of 18 modes, or of the angles of cells x cells."""
    scene = flat_scene(scale, size)
    pupil = psf.exit_pupil(scene)
    known = {
        "wavelength": scene.laser.wavelength,
        "pupil_radius": pupil.radius,
        "image_distance": pupil.image_distance,
        "pitch": scene.camera.image_pitch,
        "shape": size,
        "pixel_integrated": True,
    }
    if not cells:
        return inverse.PupilPSF.from_zernike(MODES, **known)
    pitch = 2.0 * pupil.radius / (cells - 1)
    return inverse.PupilPSF.from_angles(np.zeros((cells, cells, 2)), angle_pitch=pitch, **known)


def wall_waves(wall: str, size: int) -> Array:
    """The smooth wall's wave in the fitted modes, waves rms."""
    return _waves(study_scene(("smooth", "letter", wall, size, 0), 40e-3), size)


@lru_cache(maxsize=4)
def defocus_waves(scale: str, size: int) -> float:
    """Noll 4 that the second frame's focus adds by a flat wall, waves rms."""
    return float(_waves(flat_scene(scale, size, focus=focus_step(scale)), size)[0])


def focus_step(scale: str) -> float:
    """Change of focus, 1/m, that defocuses the stop by `DIVERSITY` waves rms."""
    wavelength = Scene.load(SCENES / "letter_flat.toml").laser.wavelength
    return 2.0 * np.sqrt(12.0) * DIVERSITY * wavelength / (SCALES[scale].stop / 2.0) ** 2


def _waves(scene: Scene, size: int) -> Array:
    found = inverse.PupilPSF.from_scene(scene, MODES, pitch=scene.camera.image_pitch, shape=size)
    return np.asarray(found.coefficients.detach().numpy(), dtype=np.float64)


def _refocused(scene: Scene, step: float) -> Scene:
    """Focused elsewhere, the picture as large as before: frames are laid on one another."""
    moved = replace(scene.camera, focus_distance=1.0 / (1.0 / _depth(scene) + step))
    other = replace(scene, camera=moved)
    pitch = moved.pixel_pitch * other.image_distance / scene.image_distance
    return replace(scene, camera=replace(moved, pixel_pitch=pitch))


def _aimed(scene: Scene) -> Scene:
    """The object moved in its plane to where the middle of the image looks by way of the wall."""
    ray = imaging.geometry.chief_rays(scene, np.zeros(1), np.zeros(1))
    start, along = ray.points[0, 0], ray.reflected[0, 0]
    place = start + along * (scene.hidden.position[2] - start[2]) / along[2]
    return replace(scene, hidden=replace(scene.hidden, position=tuple(float(x) for x in place)))


def _depth(scene: Scene) -> float:
    """From the lens to the object's mirror image along the axis, m."""
    away = scene.mirrored_object_point - np.array(scene.camera.position)
    return float(away @ scene.camera.axis)


def _summed(pixels: Array) -> Array:
    n = len(pixels) // FINE
    return np.asarray(pixels.reshape(n, FINE, n, FINE).sum(axis=(1, 3)))
