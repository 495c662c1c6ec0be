"""Simulated training pairs: images of random pictures via random walls, with all noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ... import psf
from ..._checks import positive, whole
from ..._nouns import Noun
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SceneError
from ...imaging import form_image
from ...scene import PlanarObject, Scene

Array = NDArray[np.float32]

PAIRS = 604  # stream of the random pictures and walls
MODES = tuple(range(4, 22))  # Noll, n = 2..5
_PICTURE = 128  # samples of a random picture along a side
_TOL = 1e-2  # of a point spread's peak: the noise is of that size


@dataclass(frozen=True, eq=False, kw_only=True)
class TrainingPairs(Noun):
    """Pairs of camera image and object, to train a network with.

    Parameters
    ----------
    images : ndarray, (N, H, W) float32
        Images of N objects, electrons, [y, x] with row 0 at the lowest y.
    objects : ndarray, (N, H, W) float32
        The objects as they would appear in these images without blur, background and noise. Each is
        scaled to a maximum of 1.

    See Also
    --------
    training_pairs : Simulate images of random objects.
    train_cnn : Train a network on simulated pairs.
    """

    images: Array
    objects: Array


def training_pairs(
    scene: Scene,
    count: int,
    *,
    waves: float = 0.5,
    size: int | None = None,
    modes: Sequence[int] = MODES,
    seed: int = 0,
    progress: Progress | None = None,
) -> TrainingPairs:
    """Simulate camera images of random objects via random walls, as training data for a network.

    Parameters
    ----------
    scene : Scene
        Scene that provides laser, camera and positions. It must have a flat wall without
        ``wall_roughness``, a mirror-like lobe in the wall's material, and a planar object. The
        ``slope_rms`` of every mirror-like lobe must be 0. In each pair the object shows random
        bars, discs and rings, and the wave aberration of a random wall is added.
    count : int
        Number of pairs.
    waves : float
        Largest rms wave aberration of a wall, waves. The rms of each wall is drawn uniformly from
        0 to this value.
    size : int or None
        Side of the training images, pixels, at least 8. The camera image is cropped to the central
        size x size pixels; the pixel pitch does not change. The hidden object shrinks by the factor
        ``size`` divided by the longer side of the image. None: the whole image, and the object as
        it is.
    modes : sequence of int
        Noll indices of the Zernike modes of the random aberrations, which have equal variances.
    seed : int
        Seed of the random numbers. A call with a larger ``count`` gives the same pairs and further
        ones.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1.

    Returns
    -------
    TrainingPairs
        Images and objects.

    Raises
    ------
    SceneError
        If the scene has another kind of wall, lobe or object, or a value is out of range.

    See Also
    --------
    train_cnn : Train a network on simulated pairs.

    Notes
    -----
    Each image is computed as in `simulate`: the point spread function by `psf.point_spread`, to
    1 % of its peak, and the image by `imaging.form_image`, with all of the camera's noise.
    """
    checked_seed(seed)
    count = whole("count", count)
    waves = positive("waves", waves, unit="waves")
    scene = _framed(scene, size)
    pupil = psf.exit_pupil(scene)
    pixels, pitch = scene.camera.shape, scene.camera.image_pitch
    images = np.empty((count, *pixels), dtype=np.float32)
    objects = np.empty_like(images)
    draw = generator(seed, PAIRS)
    done = 0
    while done < count:
        picture = _picture(draw)
        strengths = draw.normal(size=len(modes))
        strengths *= waves * draw.uniform() * scene.laser.wavelength / np.linalg.norm(strengths)
        noise_seed = int(draw.integers(2**63))
        wave = psf.Wavefront.from_zernike(
            {mode: float(value) for mode, value in zip(modes, strengths, strict=True)},
            wavelength=scene.laser.wavelength,
            pupil_radius=pupil.radius,
            image_distance=pupil.image_distance,
        )
        spread = psf.point_spread(
            wave,
            model="scalar",
            pixel_integrated=True,
            pitch=pitch,
            shape=max(2 * max(pixels) + 1, psf.window_shape(wave, pitch=pitch, tol=_TOL)),
            tol=_TOL,
        )
        taken = form_image(scene, spread, picture, seed=noise_seed)
        brightest = taken.ideal.max()
        if brightest == 0.0:
            if done == 0:
                raise SceneError(
                    "the camera sees nothing of the object; move hidden.position into its view"
                )
            continue
        images[done] = taken.electrons
        objects[done] = taken.ideal / brightest
        done += 1
        if progress is not None and (done % 20 == 0 or done == count):
            progress(f"training pairs: {done} of {count}", done / count)
    return TrainingPairs(images=images, objects=objects)


def _framed(scene: Scene, size: int | None) -> Scene:
    """Return the scene, checked, with a region of interest of ``size`` pixels."""
    if not scene.wall.is_flat:
        raise SceneError(
            f"wall of type {type(scene.wall).__name__}: training draws the wall's wave at random; "
            "give a scene with a flat wall"
        )
    if scene.wall_roughness is not None:
        raise SceneError(
            "scene.wall_roughness is given, but training draws the wall's wave at random; leave "
            "the roughness out"
        )
    lobes = scene.wall_material.mirror_lobes
    if not lobes:
        raise SceneError(
            "wall.material has no mirror-like lobe and forms no image; add such a lobe"
        )
    steepest = max(lobe.slope_rms for lobe in lobes)
    if steepest > 0.0:
        raise SceneError(
            f"wall.material has a lobe of slope_rms = {steepest:g} rad, whose blur the training "
            "walls do not have; give a smooth lobe, slope_rms = 0"
        )
    if not isinstance(scene.hidden, PlanarObject):
        raise SceneError(
            f"hidden of type {type(scene.hidden).__name__} has no picture; give a planar object"
        )
    if size is None:
        return scene
    camera = scene.camera
    rows, columns = camera.shape
    size = whole("size", size, 8, min(rows, columns))
    share = size / max(rows, columns)
    sides = scene.hidden.size
    return replace(
        scene,
        camera=replace(camera, pixels=(size * camera.binning, size * camera.binning)),
        hidden=replace(scene.hidden, size=(share * sides[0], share * sides[1])),
    )


def _picture(draw: np.random.Generator) -> NDArray[np.float64]:
    """Return a random picture of one to five bars, discs and rings on black."""
    axis = (np.arange(_PICTURE) + 0.5) / _PICTURE * 2.0 - 1.0
    x, y = np.meshgrid(axis, axis)
    picture = np.zeros_like(x)
    for _ in range(int(draw.integers(1, 6))):
        centre = draw.uniform(-0.45, 0.45, size=2)
        angle = draw.uniform(0.0, np.pi)
        along = (x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)
        across = (y - centre[1]) * np.cos(angle) - (x - centre[0]) * np.sin(angle)
        half, width = draw.uniform(0.15, 0.45), draw.uniform(0.04, 0.15)
        kind = int(draw.integers(3))
        if kind == 0:
            inside = (np.abs(along) < half) & (np.abs(across) < width)
        elif kind == 1:
            inside = np.hypot(along, across) < 2.0 * width
        else:
            inside = np.abs(np.hypot(along, across) - 0.7 * half) < 0.6 * width
        # mostly white, as letters are
        picture[inside] = 1.0 if draw.uniform() < 0.7 else draw.uniform(0.3, 1.0)
    return picture
