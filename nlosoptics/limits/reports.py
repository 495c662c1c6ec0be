"""Feasibility report: what can be recovered from a scene's image, before any fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import positive
from .._html import Figures, Shown
from .._nouns import Noun
from ..errors import SceneError
from ..imaging import SpeckleImage, form_image
from ..imaging.detector import noise_variance
from ..imaging.geometry import chief_rays, picture_coordinates, pixel_centres
from ..psf import (
    PointSpread,
    SceneOptics,
    Wavefront,
    mtf,
    scene_point_spread,
    wide_point_spread,
)
from ..scene import PlanarObject, Scene
from . import frequency_table
from .modulation import (
    Noise,
    object_scale,
    picture_modes,
    spectra,
    stroke_width,
    transfer_on,
)
from .relay import lambert_relay_transfer, plate, relay_modes
from .verdicts import Case, verdict
from .wave_bounds import DEFOCUS, wave_bounds

Array = NDArray[np.float64]

TOL = 1e-2  # error tolerance of the point spread, relative to its peak


@dataclass(frozen=True, eq=False, kw_only=True)
class Feasibility(Noun, Shown):
    """Information in a scene's image about the hidden object and the wall's wave.

    Parameters
    ----------
    recoverable : bool
        Whether a fit with known point spread is expected to reach a correlation of at least 0.9
        with the true object.
    verdict : str
        "recoverable", or "not recoverable: ..." with the changes that would help.
    score : float
        Predicted correlation of that fit.
    photons : float
        Photons of the object's image on the detector in one exposure.
    electrons : mapping of str to float
        Expected electrons in the whole image by source: ``signal`` (the object's image),
        ``diffuse``, ``spot``, ``glare``, ``dark``.
    brightest : float
        Electrons in the brightest pixel of the object's unblurred image.
    veil : float
        Fraction of the light on the detector that is not the object's image: diffuse light of the
        wall, laser spot and glare.
    saturated : float
        Expected fraction of saturated pixels.
    noise : mapping of str to float
        Mean rms noise of a pixel, electrons: ``photons``, ``readout``, ``speckle``, ``total``.
    stroke : float
        Mean width of the object's bright parts, m.
    frequency : ndarray, (n,)
        Spatial frequencies on the object, increasing from 0 to the pixels' Nyquist frequency,
        cycles/m: even steps, and octaves of the frequency that the strokes need, 1/(2 stroke).
    modulation : ndarray, (n,)
        Modulation transfer through mirror-like lobes, lens and pixels; 0 without such a lobe.
    relay_modulation : ndarray, (n,)
        Modulation transfer of a matt wall, for the diffuse light.
    signal_to_noise : ndarray, (n,)
        Signal-to-noise ratio of a full-contrast sinusoid over the object with the same total
        light, using all pixels that show the object.
    relay_signal_to_noise : ndarray, (n,)
        Signal-to-noise ratio of that sinusoid in the diffuse light, using all pixels.
    limit : float
        Highest frequency at which either ratio is at least 1, cycles/m; 0 if there is none.
    modes : int
        Independent patterns on 24 x 24 object cells, of contrast 0.3, that exceed the noise.
    diffuse_modes : int
        Number of these modes that wide lobes alone would carry.
    wave_bounds : mapping of int to float
        Cramer-Rao bounds for the wave's Zernike coefficients from one image of a known object:
        standard deviation in waves rms by Noll index; infinity without information. Empty if the
        wall forms no image.
    two_frame_bounds : mapping of int to float
        Cramer-Rao bounds from two images, the second with a known defocus of half a wave rms.

    See Also
    --------
    feasibility : Predict what an image can show.
    nlosoptics.views.feasibility : Modulation and noise against frequency.
    """

    recoverable: bool
    verdict: str
    score: float
    photons: float
    electrons: Mapping[str, float]
    brightest: float
    veil: float
    saturated: float
    noise: Mapping[str, float]
    stroke: float
    frequency: Array
    modulation: Array
    relay_modulation: Array
    signal_to_noise: Array
    relay_signal_to_noise: Array
    limit: float
    modes: int
    diffuse_modes: int
    wave_bounds: Mapping[int, float]
    two_frame_bounds: Mapping[int, float]

    def __post_init__(self) -> None:
        for name in ("electrons", "noise", "wave_bounds", "two_frame_bounds"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in (
            "frequency",
            "modulation",
            "relay_modulation",
            "signal_to_noise",
            "relay_signal_to_noise",
        ):
            getattr(self, name).flags.writeable = False

    def __str__(self) -> str:
        """Return verdict, key figures and the table of frequencies as text."""
        e, n = self.electrons, self.noise
        lines = [
            self.verdict,
            f"predicted correlation   {self.score:.3f}",
            f"photons of the picture  {self.photons:.3g}, brightest pixel "
            f"{self.brightest:.3g} electrons",
            f"electrons               signal {e['signal']:.3g}, diffuse {e['diffuse']:.3g}, spot "
            f"{e['spot']:.3g}, glare {e['glare']:.3g}, dark {e['dark']:.3g}; veil {self.veil:.2g}",
            f"noise of a pixel        {n['total']:.3g} electrons rms: photons {n['photons']:.3g}, "
            f"readout {n['readout']:.3g}, speckle {n['speckle']:.3g}",
            f"modes above noise       {self.modes}, by diffuse light alone {self.diffuse_modes}",
            f"resolution              {self.limit:.3g} cycles/m; {self._strokes()}",
        ]
        for name, bounds in (
            ("wave, one frame", self.wave_bounds),
            ("wave, two frames", self.two_frame_bounds),
        ):
            if bounds:
                told = ", ".join(f"Z{index} {value:.2g}" for index, value in bounds.items())
                lines.append(f"{name:23s} {told} waves rms at least")
        lines += frequency_table.lines(
            self.stroke,
            self.frequency,
            (self.modulation, self.signal_to_noise),
            (self.relay_modulation, self.relay_signal_to_noise),
        )
        return "\n".join(lines)

    def _strokes(self) -> str:
        """Width of the strokes and the frequency that they need, as text."""
        if self.stroke <= 0.0:
            return "the object has no bright strokes"
        needed = frequency_table.needed(self.stroke)
        return f"strokes are {1e3 * self.stroke:.3g} mm wide and need {needed:.3g} cycles/m"

    def _figures(self) -> Figures:
        e = self.electrons
        figures = {
            "verdict": self.verdict,
            "predicted correlation": f"{self.score:.3f}",
            "photons of the picture": f"{self.photons:.3g}",
            "brightest pixel": f"{self.brightest:.3g} electrons",
            "veil": f"{100 * self.veil:.2g} % of the light",
            "electrons": ", ".join(f"{name} {e[name]:.3g}" for name in e),
            "modes above noise": f"{self.modes}, by diffuse light alone {self.diffuse_modes}",
            "resolution": f"{self.limit:.3g} cycles/m; {self._strokes()}",
        }
        alt = "Modulation against frequency on the object, with the noise limit"
        return Figures("Feasibility", figures, alt)

    def figures(self) -> dict[str, Any]:
        """Return all fields as numbers, lists and text for JSON; infinity and NaN become None."""

        def plain(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {str(key): plain(inner) for key, inner in value.items()}
            if isinstance(value, np.ndarray):
                return [plain(float(inner)) for inner in value]
            return None if isinstance(value, float) and not math.isfinite(value) else value

        return {name: plain(getattr(self, name)) for name in self.__dataclass_fields__}


def feasibility(scene: Scene, *, exposure: float | None = None) -> Feasibility:
    """Predict before any fit what an image of the scene reveals about the object and the wall.

    Parameters
    ----------
    scene : Scene
        Scene. Its hidden object serves as an example of the objects to recover.
    exposure : float, optional
        Exposure, s; by default the camera's.

    Returns
    -------
    Feasibility
        Verdict, photons, noise, modulation, modes above the noise and bounds for the wave.

    Raises
    ------
    NlosError
        If the point spread or the image cannot be computed; see `psf.scene_point_spread` and
        `imaging.form_image`.

    See Also
    --------
    lambert_relay_transfer : Transfer function of a diffuse wall.
    lobe_relay_transfer : Transfer function of a mirror-like lobe.
    nlosoptics.views.feasibility : Modulation and noise against frequency.

    Notes
    -----
    Signal and noise come from `imaging.form_image`, the modulation from the point spread at the
    object's reference point. Modes are independent patterns of the object, counted if their signal
    exceeds the noise. For wide lobes the modes are the singular vectors of the wall's response on a
    grid of object cells. For mirror-like lobes they are sine patterns on the same grid. The larger
    count is reported.

    Examples
    --------
    >>> from nlosoptics import Scene, limits
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> found = limits.feasibility(scene)
    >>> found.verdict, found.diffuse_modes
    ('recoverable', 6)
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    if exposure is not None:
        camera = replace(scene.camera, exposure=positive("exposure", exposure, unit="s"))
        scene = replace(scene, camera=camera)
    optics = SceneOptics(scene)
    found = scene_point_spread(optics, tol=TOL)
    image = form_image(scene, found.point_spread)
    view = _View(optics, found.wavefront, found.point_spread, image)
    modulation, strength = view.modulation(), view.strength()
    relay, diffuse = view.relay_modulation(), view.diffuse_strength()
    picture = view.picture
    by_diffuse = view.diffuse_modes()
    recoverable, words = verdict(
        Case(
            picture=picture,
            sharp=view.sharp_transfer(),
            mirror=view.mirror,
            slope=view.slope,
            reach=view.reach,
            stroke=view.stroke,
            full=view.full,
            diffuse_modes=by_diffuse,
        )
    )
    ledger = image.ledger
    stray = ledger["diffuse"] + ledger["spot"] + ledger["glare"]
    lit = stray + ledger["signal"]
    return Feasibility(
        recoverable=recoverable,
        verdict=words,
        score=picture.score() if view.mirror > 0.0 else 0.0,
        photons=ledger["signal"] / scene.camera.quantum_efficiency,
        electrons={k: ledger[k] for k in ("signal", "diffuse", "spot", "glare", "dark")},
        brightest=float(image.ideal.max()),
        veil=stray / lit if lit > 0.0 else 0.0,
        saturated=view.full,
        noise=picture.noise.figures(),
        stroke=view.stroke,
        frequency=view.frequency,
        modulation=modulation,
        relay_modulation=relay,
        signal_to_noise=modulation * strength,
        relay_signal_to_noise=relay * diffuse,
        limit=_limit(view.frequency, np.maximum(modulation * strength, relay * diffuse)),
        modes=max(view.picture_modes(modulation), by_diffuse),
        diffuse_modes=by_diffuse,
        wave_bounds=view.wave_bounds((0.0,)),
        two_frame_bounds=view.wave_bounds((0.0, DEFOCUS)),
    )


class _View:
    """Intermediate results for the report on one scene, computed when needed."""

    def __init__(
        self, optics: SceneOptics, wave: Wavefront, spread: PointSpread, image: SpeckleImage
    ) -> None:
        self._optics, self._wave, self._spread, self._image = optics, wave, spread, image
        self._scene = scene = optics.scene
        self._scale = object_scale(scene)
        camera, dark = scene.camera, image.ledger["dark"] / image.ideal.size
        # dark current is part of the background; its shot noise counts with the photons'
        light = np.maximum(image.expected - dark, 0.0)  # rounding may leave negative values
        self._light = light
        self._freedom = image.speckle_contrast**-2 if image.speckle_contrast > 0.0 else None
        still = np.zeros((1, 1))
        self.picture = spectra(
            image,
            spread,
            self._scale,
            Noise(
                photons=float(image.expected.mean()),
                readout=float(noise_variance(camera, still, 0.0, None)[0, 0]),
                speckle=0.0 if self._freedom is None else float((light**2).mean()) / self._freedom,
            ),
        )
        self.mirror = scene.wall_material.specular_reflectance
        self.slope = max(scene.mirror_slopes, default=0.0)
        self.distance = float(scene.object_point[2])
        self.reach = self._reach()
        self.stroke = self._stroke()
        well = camera.full_well * camera.binning**2
        self.full = float((image.expected >= well).mean())
        top = 0.5 / (image.pitch * self._scale)
        self.frequency = frequency_table.frequencies(self.stroke, top)
        self._shown = self._object_pixels()

    def _reach(self) -> float:
        """Blur on the object per lobe slope, m/rad, rms over both axes."""
        seen = self._optics.reference.view
        turn = seen.cos_sum * float(np.linalg.norm(seen.footprint)) / math.sqrt(2.0)
        return turn * abs(self._wave.image_distance) * self._scale

    def _stroke(self) -> float:
        hidden = self._scene.hidden
        if isinstance(hidden, PlanarObject):
            return stroke_width(hidden.reflectance, hidden.size[0] / hidden.reflectance.shape[1])
        return stroke_width(self._image.ideal, self._image.pitch * self._scale)

    def _object_pixels(self) -> NDArray[np.bool_]:
        """Mask of the image pixels that show the object."""
        hidden = self._scene.hidden
        if not isinstance(hidden, PlanarObject):
            return np.asarray(self._image.ideal > 0.0)
        rays = chief_rays(self._scene, *pixel_centres(self._scene.camera))
        column, row = picture_coordinates(hidden, rays)
        rows, columns = hidden.reflectance.shape
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column <= columns) & (row >= 0) & (row <= rows)
        return np.asarray(inside)

    def modulation(self) -> Array:
        """Modulation of the image at `frequency`, rms of both axes; 0 without mirror-like lobes."""
        if self.mirror == 0.0:
            return np.zeros_like(self.frequency)
        along, across = (
            mtf(self._spread, self.frequency * self._scale, azimuth=a) for a in (0.0, math.pi / 2)
        )
        return np.asarray(np.hypot(along, across) / math.sqrt(2.0))

    def relay_modulation(self) -> Array:
        """Modulation transfer of a matt wall at `frequency`."""
        return lambert_relay_transfer(self.frequency, self.distance)

    def strength(self) -> float:
        """Signal-to-noise ratio of a full-contrast sinusoid in the image if it were not blurred."""
        return self._strength(self._image.ledger["ideal"], self._shown)

    def diffuse_strength(self) -> float:
        """Signal-to-noise ratio of a full-contrast sinusoid in the diffuse light, all pixels."""
        everywhere = np.ones_like(self._shown)
        return self._strength(self._image.ledger["diffuse"], everywhere)

    def _strength(self, electrons: float, where: NDArray[np.bool_]) -> float:
        count = int(np.count_nonzero(where))
        if count == 0 or electrons <= 0.0:
            return 0.0
        variance = float((self._image.noise_sigma[where] ** 2).mean())
        return electrons / math.sqrt(2.0 * count * variance)

    def diffuse_modes(self) -> int:
        """Number of modes above the noise through wide lobes."""
        return relay_modes(self._scene, light=self._light, freedom=self._freedom)

    def picture_modes(self, modulation: Array) -> int:
        """Number of modes above the noise in the image formed by mirror-like lobes."""
        hidden = self._scene.hidden
        mean = 1.0
        if isinstance(hidden, PlanarObject):
            mean = max(float(hidden.reflectance.mean()), 1e-12)
        white = self.strength() * math.sqrt(2.0) / mean
        return picture_modes(modulation, self.frequency, plate(self._scene)[2], white)

    def sharp_transfer(self) -> Array:
        """Modulus of the image's transfer function if the lobes had no slopes."""
        if self.slope == 0.0:
            return self.picture.transfer
        spread = wide_point_spread(
            self._wave, pitch=self._image.pitch, shape=self._spread.shape, tol=TOL
        )
        return transfer_on(spread, self.picture.grid)

    def wave_bounds(self, frames: tuple[float, ...]) -> dict[int, float]:
        """Bounds for the wave's coefficients from frames of known defocus; empty without image."""
        if self.mirror == 0.0 or self._image.ledger["ideal"] == 0.0:
            return {}
        return wave_bounds(
            self.picture,
            self._wave,
            scale=self._scale,
            pitch=self._image.pitch,
            blur=self.slope * self.reach,
            defocus=frames,
        )


def _limit(frequency: Array, ratio: Array) -> float:
    """Highest frequency at which a falling ratio reaches 1, interpolated; 0 if it never does."""
    above = np.nonzero(ratio >= 1.0)[0]
    if not len(above):
        return 0.0
    last = int(above[-1])
    if last + 1 == len(ratio):
        return float(frequency[-1])
    high, low = math.log(ratio[last]), math.log(max(float(ratio[last + 1]), 1e-300))
    step = frequency[last + 1] - frequency[last]
    return float(frequency[last] + step * high / (high - low))
