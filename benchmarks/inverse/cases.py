"""Images of known objects by unknown walls, for fits of the wall: made by the simulator forward.

    from cases import case, start
    data = case("F", 7, rms_waves=0.5, defocus=(0.0, 0.5 * WAVELENGTH))

The camera is that of examples/scenes/letter_speckle.toml (lambda N = 2 pixels), its region of
interest `size` pixels a side. What is inverted did not make the data: wave and picture go through
`psf.point_spread` and `imaging.form_image` on pixels four times finer, pixels are summed, the frame
is twice as wide as what is kept (light enters and leaves over the edges), the wave holds what no
fitted mode has, and it changes over the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from nlosoptics import Scene, imaging, psf

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "examples" / "scenes" / "letter_speckle.toml"
OBJECTS = ROOT / "examples" / "objects"
WAVELENGTH = 632.8e-9
MODES = tuple(range(4, 22))  # Noll, n = 2..5: what a smooth wall is made of, and is fitted by
HIGHER = tuple(range(22, 46))  # n = 6..8


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """Data of one fit, and the truth.

    ``images`` (K, H, W) are electrons, with ``defocus`` (K,), m rms of Noll 4, and
    ``noise_sigma`` (K,). ``truth`` (H, W) is the picture as the camera would see it without blur.
    ``coefficients`` (18,) are Noll 4 to 21 of the wall at the frame's centre, waves rms; ``pupil``
    are options of `inverse.PupilPSF.from_zernike`, m.
    """

    images: np.ndarray
    truth: np.ndarray
    defocus: np.ndarray
    noise_sigma: np.ndarray
    coefficients: np.ndarray
    pupil: dict[str, float]


def case(
    object_name: str,
    wall_seed: int,
    *,
    rms_waves: float,
    size: int = 64,
    noise: float = 0.01,
    defocus: tuple[float, ...] = (0.0,),
    noise_seed: int | None = None,
    higher: float = 0.04,
    field_variation: float = 0.02,
    surround: float = 0.01,
    fine: int = 4,
) -> Case:
    """Images of one object by one wall.

    ``object_name`` is a picture of examples/objects or of the test objects in NLOSOPTICS_DATA, or a
    path. The same ``wall_seed`` is the same wall, whatever the object; ``rms_waves`` is that of the
    wave at the exit pupil, without piston and tilt. The picture fills ``size`` pixels along each
    side. ``noise`` is rms over the blurred image's maximum, ``defocus`` the known extra Noll-4 of
    each image, m rms. ``higher`` is the rms of the modes n = 6..8 over that of the wall,
    ``field_variation`` the rms by which the wave changes from the frame's centre to its edges,
    waves, and ``surround`` the radiance around the frame over that of white; ``fine`` are samples
    per pixel.
    """
    if max(np.abs(defocus)) > 1e-4:
        raise ValueError(f"defocus = {defocus} m; give metres rms, waves * WAVELENGTH")
    scene = _scene(object_name, size, fine, surround)
    pupil = psf.exit_pupil(scene)
    optics = {
        "wavelength": scene.laser.wavelength,
        "pupil_radius": pupil.radius,
        "image_distance": pupil.image_distance,
    }
    images, sigmas, truth = [], [], None
    number = _object_number(object_name)
    noise_seed = wall_seed if noise_seed is None else noise_seed
    rng = np.random.default_rng([noise_seed, number, 1])
    shape = _Wall(np.random.default_rng([wall_seed, 0, 0]), rms_waves, higher, field_variation)
    for extra in defocus:
        field = _field(shape, extra, optics, scene, fine)
        taken = imaging.form_image(scene, field, seed=0)
        clean = _binned(taken.signal + taken.background, size, fine)
        truth = _binned(taken.ideal, size, fine)
        sigmas.append(float(noise * clean.max()))
        images.append(clean + sigmas[-1] * rng.normal(size=clean.shape))
    return Case(
        images=np.array(images),
        truth=truth / truth.max(),
        defocus=np.asarray(defocus, dtype=float),
        noise_sigma=np.array(sigmas),
        coefficients=_projected(shape.wave((0.0, 0.0), 0.0, optics)),
        pupil={**optics, "pitch": fine * scene.camera.image_pitch},
    )


def start(truth: np.ndarray, error_waves: float, seed: int) -> np.ndarray:
    """Coefficients off by a random vector of a given length: waves rms of the difference."""
    offset = np.random.default_rng([seed, 2]).normal(size=np.shape(truth))
    length = np.linalg.norm(offset, axis=-1, keepdims=True)
    return truth + error_waves * offset / length


class _Wall:
    """Wave of one wall as a function of the place in the frame."""

    def __init__(
        self, rng: np.random.Generator, rms_waves: float, higher: float, field_variation: float
    ) -> None:
        low = rng.normal(size=len(MODES))
        high = rng.normal(size=len(HIGHER))
        # one direction of change across the frame, one up it
        self._drift = rng.normal(size=(2, len(MODES)))
        self._drift *= field_variation / np.linalg.norm(self._drift, axis=1, keepdims=True)
        self._modes = np.concatenate(
            [
                low * rms_waves / np.linalg.norm(low),
                high * higher * rms_waves / np.linalg.norm(high),
            ]
        )

    def wave(self, place: tuple[float, float], extra: float, optics: dict[str, Any]) -> Any:
        """Wavefront at a place of the frame, -1 to 1 across and up, with known defocus, m."""
        length = optics["wavelength"]
        modes = self._modes.copy()
        modes[: len(MODES)] += place[0] * self._drift[0] + place[1] * self._drift[1]
        given = {j: float(c) * length for j, c in zip(MODES + HIGHER, modes, strict=True)}
        given[4] += extra
        return psf.Wavefront.from_zernike(given, **optics)


def _field(wall: _Wall, extra: float, optics: dict[str, Any], scene: Scene, fine: int) -> Any:
    """Point spreads at 2 x 2 nodes of the picture, which is twice as wide as the frame."""
    nodes = np.array([-1.0, 1.0]) / np.sqrt(2.0)
    pitch, side = scene.camera.image_pitch, scene.camera.pixels[0]
    modes = []
    for up in nodes:
        for across in nodes:
            wave = wall.wave((2.0 * across, 2.0 * up), extra, optics)
            wide = max(2 * side, psf.window_shape(wave, pitch=fine * pitch, tol=1e-2) * fine)
            wide += wide % 2
            spread = psf.point_spread(
                wave, model="scalar", pitch=pitch, shape=wide, pixel_integrated=True
            )
            cut = slice(wide // 2 - side, wide // 2 + side)
            modes.append(spread.intensity[cut, cut])
    weights = np.eye(4).reshape(4, 2, 2)
    return psf.PointSpreadField(
        modes=np.array(modes),
        weights=weights,
        across=nodes,
        up=nodes.copy(),
        pitch=pitch,
        truncation_error=0.0,
        error_estimate=spread.error_estimate,
    )


@lru_cache(maxsize=8)
def _scene(object_name: str, size: int, fine: int, surround: float) -> Scene:
    """The scene with a frame of twice `size` pixels, `fine` samples to each."""
    scene = Scene.load(SCENE)
    camera = replace(
        scene.camera,
        pixels=(2 * size * fine, 2 * size * fine),
        pixel_pitch=scene.camera.pixel_pitch / fine,
        dark_current=scene.camera.dark_current / fine**2,
    )
    picture = _picture(object_name)
    rows, columns = picture.shape
    if rows != columns:
        raise ValueError(f"{object_name} has {rows} x {columns} pixels; give a square picture")
    wide = np.full((2 * rows, 2 * columns), surround)
    inner = (slice(rows // 2, rows // 2 + rows), slice(columns // 2, columns // 2 + columns))
    wide[inner] = picture
    depth = float((scene.mirrored_object_point - np.array(camera.position)) @ camera.axis)
    frame = 2 * size * scene.camera.image_pitch * depth / scene.image_distance
    return replace(
        scene, camera=camera, hidden=replace(scene.hidden, image=wide, size=(frame,) * 2)
    )


def _picture(name: str) -> np.ndarray:
    """A picture by name, 0 to 1, row 0 on top."""
    import os

    from PIL import Image

    folders = [OBJECTS]
    if "NLOSOPTICS_DATA" in os.environ:
        folders.append(Path(os.environ["NLOSOPTICS_DATA"]) / "test_objects")
    paths = [Path(name), *(folder / f"{name}.png" for folder in folders)]
    for path in paths:
        if path.is_file():
            with Image.open(path) as opened:
                return np.asarray(opened.convert("L"), dtype=np.float64) / 255.0
    raise FileNotFoundError(f"no picture {name!r}; looked at {', '.join(map(str, paths))}")


def _object_number(name: str) -> int:
    return sum(ord(letter) * 31**i for i, letter in enumerate(Path(name).stem)) % 2**31


def _binned(fine_image: np.ndarray, size: int, fine: int) -> np.ndarray:
    """The frame's pixels: sums of finer ones, of the middle of the wider frame."""
    pixels = fine_image.reshape(2 * size, fine, 2 * size, fine).sum(axis=(1, 3))
    inner = slice(size // 2, size // 2 + size)
    return pixels[inner, inner]


def _projected(wave: psf.Wavefront) -> np.ndarray:
    """Noll 4 to 21 of a wave on polar nodes, waves rms."""
    rho = np.hypot(wave.u, wave.v) / wave.pupil_radius
    theta = np.arctan2(wave.v, wave.u)
    area = wave.weights.sum()
    values = [
        float((wave.weights * wave.aberration * psf.zernike(j, rho, theta)).sum() / area)
        for j in MODES
    ]
    return np.array(values) / wave.wavelength
