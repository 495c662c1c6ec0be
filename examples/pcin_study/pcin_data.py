"""Exposures of the study: the scenes of examples/scenes through `nlosoptics.simulate`.

Two scales. "paper": camera, light and geometry of Wu et al. 2024 as the scene files have them, a
region of interest about the axis. "wall": the same walls and distances, the lens stopped down to
where these walls make waves of half a wavelength rms, and pixels at Nyquist of its Airy disc, on
which a wall's wave can be fitted.

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
from nlosoptics.runs import simulate
from nlosoptics.scene import Scene, WavyWall

Array = NDArray[np.float64]

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
TOL = 4e-3  # error of the simulated image; its noise is 3 % and more
MODES = tuple(range(4, 22))  # Noll, n = 2..5
STOP = 7.4e-3  # m, scale "wall": the concave wall makes 0.50 waves rms, the convex 0.49
# W, scale "wall": its pixels have 1/1054 of the paper's area and the stop 1/11.4; so much light
# gives a white pixel the 1100 electrons that it has in the paper's geometry at 40 ms
POWER = 60.0
# The file's wavy wall, 0.1 mm, makes less than 0.1 waves rms under this stop. Here the axis meets a
# crest, so that the view stays where it is, with a radius of 2.0 m, near what the caustic allows.
WAVY = {"amplitude": 0.8e-3, "phase": 0.0}
DIVERSITY = 0.5  # waves rms, focus of the second frame


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


def study_scene(
    scale: str, name: str, wall: str, size: int, exposure: float, *, fine: int = 1, focus: float = 0
) -> Scene:
    """Scene of an object and a wall.

    Parameters
    ----------
    scale : {"paper", "wall"}
    name : str
        A key of `OBJECTS`.
    wall : str
        One of `WALLS`.
    size : int
        Image pixels a side.
    exposure : float
        s.
    fine : int
        Detector pixels along each side of an image pixel.
    focus : float
        Change of the lens's focus, 1/m.
    """
    scene = Scene.load(SCENES / f"{OBJECTS[name]}.toml")
    bent = Scene.load(SCENES / f"letter_{wall}.toml").wall
    camera = replace(scene.camera, exposure=exposure)
    if scale == "paper":
        scene = replace(scene, wall=bent)
        width, pixels = camera.pixel_pitch, size * camera.binning
    else:
        if isinstance(bent, WavyWall):
            bent = replace(bent, **WAVY)
        width = nyquist_pixel(scene)
        pixels = size
        camera = replace(camera, stop_diameter=STOP, binning=1)
        frame = size * width * _depth(scene) / scene.image_distance
        scene = replace(
            scene,
            wall=bent,
            # incoherent light: a bare laser's speckle would be as wide as these pixels
            laser=replace(scene.laser, power=POWER, independent_patterns=None),
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
    if scale == "wall":
        scene = _aimed(scene)
    return _refocused(scene, focus) if focus else scene


def nyquist_pixel(scene: Scene) -> float:
    """Half of lambda times the working F-number of the stop, m, less what rounding needs."""
    return 0.999 * scene.laser.wavelength * scene.image_distance / STOP / 2.0


@lru_cache(maxsize=64)
def exposure_of(
    scale: str, name: str, wall: str, size: int, milliseconds: int, *, second: bool = False
) -> Exposure:
    """Simulate an exposure; ``second`` is the one with a changed focus."""
    focus = focus_step() if second else 0.0
    where = (scale, name, wall, size, milliseconds * 1e-3)
    seed = zlib.crc32(repr((*where, second)).encode())
    found = nlos.simulate(study_scene(*where, fine=FINE, focus=focus), TOL, seed=seed)
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
def known_model(scale: str, name: str, wall: str, size: int) -> imaging.ForwardModel:
    """Image model of the scene's own point spread, at the image's pixels."""
    return reconstructing.known_model(study_scene(scale, name, wall, size, 40e-3), tol=TOL)


@lru_cache(maxsize=64)
def veil(scale: str, name: str, wall: str, size: int) -> Array | None:
    """Shape of the wall's diffuse light in the image."""
    shape = simulate.veil_shape(study_scene(scale, name, wall, size, 40e-3))
    return shape if shape.any() else None


def fitted_pupil(size: int) -> inverse.PupilPSF:
    """Point spread with an unknown wave, scale "wall": all modes start at 0."""
    scene = study_scene("wall", "letter", "flat", size, 40e-3)
    pupil = psf.exit_pupil(scene)
    return inverse.PupilPSF.from_zernike(
        MODES,
        wavelength=scene.laser.wavelength,
        pupil_radius=pupil.radius,
        image_distance=pupil.image_distance,
        pitch=scene.camera.image_pitch,
        shape=size,
        pixel_integrated=True,
    )


def wall_waves(wall: str, size: int) -> Array:
    """The wall's wave in the fitted modes, waves rms."""
    scene = study_scene("wall", "letter", wall, size, 40e-3)
    found = inverse.PupilPSF.from_scene(scene, MODES, pitch=scene.camera.image_pitch, shape=size)
    return np.asarray(found.coefficients.detach().numpy(), dtype=np.float64)


@lru_cache(maxsize=4)
def defocus_waves(size: int) -> float:
    """Noll 4 that the second frame's focus adds by a flat wall, waves rms."""
    scene = study_scene("wall", "letter", "flat", size, 40e-3, focus=focus_step())
    found = inverse.PupilPSF.from_scene(scene, MODES, pitch=scene.camera.image_pitch, shape=size)
    return float(found.coefficients.detach()[0])


def focus_step() -> float:
    """Change of focus, 1/m, that defocuses the stop by `DIVERSITY` waves rms."""
    wavelength = Scene.load(SCENES / "letter_flat.toml").laser.wavelength
    return 2.0 * np.sqrt(12.0) * DIVERSITY * wavelength / (STOP / 2.0) ** 2


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
