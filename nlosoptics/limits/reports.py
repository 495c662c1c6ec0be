"""Feasibility report: what can be recovered from a scene's image, before any fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from .._checks import positive
from .._html import Figures, Shown
from .._nouns import Noun
from ..errors import SceneError
from ..imaging.detector import noise_variance
from ..imaging.geometry import picture_coordinates
from ..imaging.images import light_levels
from ..imaging.objects import plate
from ..imaging.radiometry import laser_spot
from ..imaging.stray import spot_image
from ..psf import SceneOptics, rms_aberration
from ..scene import PlanarObject, Scene
from . import frequency_table
from .blind import BlindForecast, blind_forecast
from .modulation import Noise, object_scale, padded, picture_modes, spectra, stroke_width
from .relay import count_modes, lambert_relay_transfer, relay_light, relay_score
from .transfer import scene_transfer
from .verdicts import Case, verdict
from .wave_bounds import wave_bounds

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Feasibility(Noun, Shown):
    """Report, before any fit, on what a scene's image shows of the hidden object and the wall.

    `feasibility` computes it, and ``print`` shows it as text. The wall reflects light in two ways.
    Its mirror-like reflection forms an image of the object. Its diffuse reflection spreads the
    object's light over the whole detector and shows coarse detail only.

    Parameters
    ----------
    recoverable : bool
        Whether a fit with known wall is expected to reach a correlation of at least 0.9 with the
        true object, from the image or from the diffuse light.
    verdict : str
        "recoverable", or "not recoverable: ..." with the changes that would help.
    score : float
        Predicted correlation between the true object and the result of a fit to the image with
        known point spread function; 0 if the wall forms no image.
    score_spread : float
        Standard deviation to expect of the correlation of such a fit about ``score``.
    relay_score : float
        Predicted correlation between the true object and the result of `inverse.shadow_fit` for the
        diffuse light. In this fit the object is divided into cells, 24 along its longer side. The
        light that each cell causes on the detector is taken as known, with the shadows of
        occluders, and total variation sharpens the object. No constant is fitted.
    photons : float
        Number of photons of the object's image on the detector in one exposure.
    electrons : mapping of str to float
        Expected electrons in the whole image by source: ``signal`` (the object's image),
        ``diffuse`` (diffuse reflection of the wall), ``spot`` (image of the laser spot),
        ``ambient`` (ambient light on the wall), ``glare`` (scattering in the lens) and ``dark``
        (dark current).
    brightest : float
        Electrons in the brightest pixel of the object's unblurred image.
    veil : float
        Fraction of the light on the detector that is not the object's image, but comes from the
        wall's diffuse reflection, the laser spot and glare.
    saturated : float
        Expected fraction of saturated pixels.
    noise : mapping of str to float
        Rms noise of a pixel by cause, electrons: ``photons`` (shot noise), ``readout``, ``speckle``
        and ``total``. Variances are averaged over the image.
    stroke : float
        Mean width of the bright parts of the object, such as the strokes of a letter, m.
    frequency : ndarray, (n,)
        Spatial frequencies on the object at which the arrays below are given, cycles/m. They
        increase from 0 to the Nyquist frequency of the pixels.
    modulation : ndarray, (n,)
        Modulation transfer function of the image: mirror-like reflection, lens and pixels together.
        0 if the wall forms no image.
    relay_modulation : ndarray, (n,)
        Modulation transfer function of a diffuse wall.
    signal_to_noise : ndarray, (n,)
        Signal-to-noise ratio with which the image shows a sinusoidal pattern in place of the
        object. The pattern has full contrast and emits as much light as the object. The ratio
        combines all pixels that show the object.
    relay_signal_to_noise : ndarray, (n,)
        Signal-to-noise ratio with which the diffuse light shows the same pattern. It combines all
        pixels of the detector.
    limit : float
        Resolution limit, cycles/m: the frequency at which the larger of the two signal-to-noise
        ratios first falls below 1. 0 if it is below 1 even for the coarsest patterns, and the
        highest frequency if it is nowhere below 1.
    modes : int
        Number of independent patterns of the object, each with an rms contrast of 0.3, that are
        shown above the noise: by the image or by the diffuse light, whichever shows more. All
        patterns consist of square cells of uniform brightness, 24 along the object's longer side:
        sine patterns for the image, the patterns of ``diffuse_modes`` for the diffuse light.
    diffuse_modes : int
        Number of such patterns that the diffuse light alone shows, including the shadows of
        occluders. They are the singular vectors of the mapping from cells to detector.
    wave_bounds : mapping of int to float
        Least possible standard deviation (Cramer-Rao bound) of each Zernike coefficient of the
        wall's aberration, estimated from one image of a known object: waves rms by Noll index.
        Infinite if the image has no information about it. Empty if the wall forms no image.
    two_frame_bounds : mapping of int to float
        The same bounds for two images, the second with a known defocus of half a wave rms.
    one_frame_fits, two_frame_fits : float
        Fraction, 0 to 1, of blind fits (fits of an unknown object and wall) that succeed if the rms
        aberration is that of this scene's wall: with one image, and with two images of known
        defocus. The fraction is interpolated in stored results of earlier tests; no fit is run. NaN
        if such a case was not tested, or if the aberration is so small that the wall need not be
        fitted.
    blind : str
        Forecast, with its reason, for fits in which neither object nor wall is known.

    See Also
    --------
    feasibility : Predict what an image can show.
    nlosoptics.views.feasibility : Modulation and noise against frequency.
    """

    recoverable: bool
    verdict: str
    score: float
    score_spread: float
    relay_score: float
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
    one_frame_fits: float
    two_frame_fits: float
    blind: str

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
        lines = [self.verdict, *(f"{name:23s} {text}" for name, text in self._rows().items())]
        lines += frequency_table.lines(
            self.stroke,
            self.frequency,
            (self.modulation, self.signal_to_noise),
            (self.relay_modulation, self.relay_signal_to_noise),
        )
        return "\n".join(lines)

    def _rows(self) -> dict[str, str]:
        """Return the key figures as text, by name."""
        e, n = self.electrons, self.noise
        strokes = "the object has no bright strokes"
        if self.stroke > 0.0:
            needed = frequency_table.needed(self.stroke)
            strokes = f"strokes are {1e3 * self.stroke:.3g} mm wide and need {needed:.3g} cycles/m"
        rows = {
            "predicted correlation": f"{self.score:.3f} +- {self.score_spread:.2g} by the image, "
            f"{self.relay_score:.3f} by diffuse light",
            "photons of the picture": f"{self.photons:.3g}, brightest pixel "
            f"{self.brightest:.3g} electrons",
            "electrons": ", ".join(f"{name} {e[name]:.3g}" for name in e)
            + f"; veil {self.veil:.2g}",
            "noise of a pixel": f"{n['total']:.3g} electrons rms: photons {n['photons']:.3g}, "
            f"readout {n['readout']:.3g}, speckle {n['speckle']:.3g}",
            "modes above noise": f"{self.modes}, by diffuse light alone {self.diffuse_modes}",
            "resolution": f"{self.limit:.3g} cycles/m; {strokes}",
        }
        for name, bounds in (
            ("wave, one frame", self.wave_bounds),
            ("wave, two frames", self.two_frame_bounds),
        ):
            if bounds:
                least = ", ".join(f"Z{index} {value:.2g}" for index, value in bounds.items())
                rows[name] = f"{least} waves rms at least"
        return rows | {"wall unknown": self.blind}

    def _figures(self) -> Figures:
        alt = "Modulation against frequency on the object, with the noise limit"
        return Figures("Feasibility", {"verdict": self.verdict, **self._rows()}, alt)

    def figures(self) -> dict[str, Any]:
        """Return all fields as a dictionary that JSON can express: None for infinity and NaN."""

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
        Scene to evaluate. Its hidden object serves as an example of the objects to recover.
    exposure : float, optional
        Exposure time, s; by default that of the scene's camera.

    Returns
    -------
    Feasibility
        Report with verdict, photons, noise, modulation transfer function, resolution and bounds for
        the wall's aberration. ``print`` shows it as text.

    Raises
    ------
    NlosError
        If the point spread function or the image cannot be computed; see `psf.scene_point_spread`
        and `imaging.form_image`.

    See Also
    --------
    lambert_relay_transfer : Transfer function of a diffuse wall.
    lobe_relay_transfer : Transfer function of a glossy wall.
    nlosoptics.views.feasibility : Modulation and noise against frequency.

    Notes
    -----
    Signal and noise are computed as in `imaging.form_image`. To save time, pixels are first binned
    to at most 64 along the longer side, but to no fewer than 3 across a bright stroke of the
    object. The modulation transfer function is that at the centre of a planar object or the
    centroid of a mesh. Of an object that the wall shows in part, which `simulate` refuses, the
    report describes that part.

    The field ``modes`` of the report is the number of independent patterns of the object that the
    light shows above the noise. Patterns are counted in two ways. In the image formed by the
    mirror-like reflection, sine patterns are counted. In the diffuse light, the singular vectors of
    the wall's response to a grid of object cells are counted; this number is ``diffuse_modes``.
    ``modes`` is the larger of the two numbers.

    The field ``score`` predicts the correlation between the true object and the result of
    `inverse.tv_deconvolve` with its default settings. It is a function of the signal and the noise
    at every spatial frequency. Its constants were fitted to reconstructions of one set of scenes.
    ``score_spread`` is the rms difference between prediction and result in another set
    (`benchmarks/inverse/feasibility.py`). In very noisy images the solver may detect no object and
    return zeros, which the prediction does not include: a small ``score`` can be too large.

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
    view = _View(scene)
    modulation, strength = view.modulation(view.frequency), view.strength()
    relay, diffuse = view.relay_modulation(view.frequency), view.diffuse_strength()
    relay_cells = relay_light(
        view.coarse, light=view.light, freedom=view.levels.freedom, ambient=view.levels.ambient
    )
    by_diffuse = 0 if relay_cells is None else count_modes(relay_cells.signal)
    case = view.case(by_diffuse, relay_score(scene, relay_cells, view.levels))
    recoverable, words = verdict(case)
    electrons = view.electrons
    stray = sum(electrons[name] for name in ("diffuse", "spot", "ambient", "glare"))
    lit = stray + electrons["signal"]
    one, two = view.wave_bounds()
    blind = view.blind(two)
    return Feasibility(
        recoverable=recoverable,
        verdict=words,
        score=case.score,
        score_spread=view.picture.spread() if case.score > 0.0 else 0.0,
        relay_score=case.relay_score,
        photons=electrons["signal"] / scene.camera.quantum_efficiency,
        electrons=electrons,
        brightest=float(view.levels.ideal.max()) / view.joined,
        veil=stray / lit if lit > 0.0 else 0.0,
        saturated=view.full,
        noise={name: rms / math.sqrt(view.joined) for name, rms in view.noise.figures().items()},
        stroke=view.stroke,
        frequency=view.frequency,
        modulation=modulation,
        relay_modulation=relay,
        signal_to_noise=modulation * strength,
        relay_signal_to_noise=relay * diffuse,
        limit=view.limit(),
        modes=max(view.picture_modes(modulation), by_diffuse),
        diffuse_modes=by_diffuse,
        wave_bounds=one,
        two_frame_bounds=two,
        one_frame_fits=blind.one_frame,
        two_frame_fits=blind.two_frames,
        blind=blind.text,
    )


class _View:
    """Intermediate results for the report on one scene."""

    def __init__(self, scene: Scene) -> None:
        if scene.wall_material.specular_reflectance > 0.0:
            scene.check_laser_light()
        scene.check_black_occluders()
        self._scene = scene
        # the smooth wall's geometry needs no open path, and nor does diffuse light
        open_scene = scene if scene.mirror_lobes else replace(scene, occluders=())
        self._optics = SceneOptics(open_scene)
        self.mirror = scene.wall_material.specular_reflectance
        self.slope = max(scene.mirror_slopes, default=0.0)
        self.transfer = scene_transfer(self._optics) if self.mirror > 0.0 else None
        self._scale = object_scale(scene)
        hidden, self.stroke = scene.hidden, 0.0
        if isinstance(hidden, PlanarObject):
            texel = hidden.size[0] / hidden.reflectance.shape[1]
            self.stroke = stroke_width(hidden.reflectance, texel)
        self.coarse, self.joined = _coarser(scene, self.stroke, self._scale)
        self.levels = levels = light_levels(self.coarse)
        if not isinstance(hidden, PlanarObject):
            self.stroke = stroke_width(levels.ideal, self._pixel)
        self._sums()
        top = 0.5 / (scene.camera.image_pitch * self._scale)
        self.frequency = frequency_table.frequencies(self.stroke, top)

    @property
    def _pixel(self) -> float:
        """Side of a joined pixel on the object, m."""
        return self.coarse.camera.image_pitch * self._scale

    def _sums(self) -> None:
        """Compute light, noise and the spectra of the image."""
        levels, camera = self.levels, self.coarse.camera
        shape = levels.ideal.shape
        grid = padded(shape)
        u = np.fft.rfftfreq(grid[1], camera.image_pitch).astype(np.float64)
        v = np.fft.fftfreq(grid[0], camera.image_pitch).astype(np.float64)
        passed = np.zeros((len(v), len(u)))
        sharp = passed
        if self.transfer is not None:
            passed, sharp = self.transfer(u, v), self.transfer.sharp(u, v)
        spectrum = scipy.fft.rfft2(levels.ideal, grid) * passed
        blurred = scipy.fft.irfft2(spectrum, grid)[: shape[0], : shape[1]]
        self.blurred = signal = np.maximum(blurred, 0.0)
        self.light = light = signal + levels.stray
        dark = levels.dark
        laser = light - levels.ambient  # the room's light has no speckle
        self._variance = noise_variance(camera, laser, dark + levels.ambient, levels.freedom)
        bright = 0.0 if levels.freedom is None else float((laser**2).mean()) / levels.freedom
        self.noise = Noise(
            photons=float(light.mean()) + dark,
            readout=float(noise_variance(camera, np.zeros(1), 0.0, None)[0]),
            speckle=bright,
        )
        self.picture = spectra(levels.ideal, passed, self._pixel, self.noise)
        self._sharp = sharp
        self.electrons = {
            "signal": float(signal.sum()),
            "diffuse": float(levels.diffuse.sum()),
            "spot": float(levels.spot.sum()),
            "ambient": float(levels.ambient.sum()),
            "glare": levels.glare,
            "dark": dark * light.size,
        }
        self._shown = self._object_pixels()

    @property
    def full(self) -> float:
        """Expected fraction of saturated pixels."""
        camera, levels = self._scene.camera, self.levels
        well = camera.full_well * camera.binning**2
        light = self.light + levels.dark
        if self.joined == 1 or self.electrons["spot"] == 0.0:
            return float((light >= well * self.joined).mean())
        # the spot's image is narrower than joined pixels
        side = math.isqrt(self.joined)
        rest = np.kron((light - levels.spot) / self.joined, np.ones((side, side)))
        image = spot_image(self._scene, laser_spot(self._scene))
        power = self.electrons["spot"] / max(float(image.sum()), 1e-300)
        return float((rest + power * image >= well).mean())

    def _object_pixels(self) -> NDArray[np.bool_]:
        """Mask of the image pixels that show the object."""
        hidden = self._scene.hidden
        if not isinstance(hidden, PlanarObject):
            return np.asarray(self.levels.ideal > 0.0)
        column, row = picture_coordinates(hidden, self.levels.rays)
        rows, columns = hidden.reflectance.shape
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column <= columns) & (row >= 0) & (row <= rows)
        return np.asarray(inside)

    def modulation(self, frequency: Array) -> Array:
        """Modulation of the image, rms of both axes; 0 without mirror-like lobes."""
        if self.transfer is None:
            return np.zeros_like(frequency)
        f, zero = frequency * self._scale, np.zeros(1)
        along, across = self.transfer(f, zero)[0], self.transfer(zero, f)[:, 0]
        return np.asarray(np.hypot(along, across) / math.sqrt(2.0))

    def relay_modulation(self, frequency: Array) -> Array:
        """Modulation transfer of a matt wall."""
        return lambert_relay_transfer(frequency, float(self._scene.object_point[2]))

    def strength(self) -> float:
        """Signal-to-noise ratio of a full-contrast sinusoid in the image if it were not blurred."""
        return self._strength(float(self.levels.ideal.sum()), self._shown)

    def diffuse_strength(self) -> float:
        """Signal-to-noise ratio of a full-contrast sinusoid in the diffuse light, all pixels."""
        return self._strength(self.electrons["diffuse"], np.ones_like(self._shown))

    def _strength(self, electrons: float, where: NDArray[np.bool_]) -> float:
        count = int(np.count_nonzero(where))
        if count == 0 or electrons <= 0.0:
            return 0.0
        return electrons / math.sqrt(2.0 * count * float(self._variance[where].mean()))

    def limit(self) -> float:
        """Frequency at which the signal first falls below the noise, cycles/m."""
        frequency = float(self.frequency[-1]) * np.geomspace(1e-4, 1.0, 400)
        image = self.modulation(frequency) * self.strength()
        relay = self.relay_modulation(frequency) * self.diffuse_strength()
        return first_crossing(frequency, np.maximum(image, relay))

    def case(self, diffuse_modes: int, by_diffuse: float) -> Case:
        """Inputs of the verdict."""
        return Case(
            picture=self.picture,
            sharp=self._sharp,
            mirror=self.mirror,
            slope=self.slope,
            reach=self._reach(),
            stroke=self.stroke,
            full=self.full,
            diffuse_modes=diffuse_modes,
            relay_score=by_diffuse,
            shadowed=bool(self._scene.occluders),
        )

    def _reach(self) -> float:
        """Blur on the object per lobe slope, m/rad, rms over both axes."""
        seen = self._optics.reference
        turn = seen.view.cos_sum * float(np.linalg.norm(seen.view.footprint)) / math.sqrt(2.0)
        return turn * abs(seen.first.wave.image_distance) * self._scale

    def picture_modes(self, modulation: Array) -> int:
        """Number of modes above the noise in the image formed by mirror-like lobes."""
        hidden = self._scene.hidden
        mean = 1.0
        if isinstance(hidden, PlanarObject):
            mean = max(float(hidden.reflectance.mean()), 1e-12)
        white = self.strength() * math.sqrt(2.0) / mean
        return picture_modes(modulation, self.frequency, plate(self._scene)[2], white)

    def wave_bounds(self) -> tuple[dict[int, float], dict[int, float]]:
        """Bounds for the wave's coefficients from one frame and from two; empty without image."""
        if self.transfer is None or not self.levels.ideal.any():
            return {}, {}
        one, two = wave_bounds(
            self.picture,
            self.transfer.wave,
            scale=self._scale,
            pitch=self._scene.camera.image_pitch,
            blur=self.slope * self._reach(),
            defocus=(0.0, 0.5),  # of the second frame, waves rms
        )
        return one, two

    def blind(self, bounds: dict[int, float]) -> BlindForecast:
        """Forecast of blind fits; ``bounds`` are those of two frames."""
        if self.transfer is None or not bounds:
            return blind_forecast(math.nan, math.inf, 0.0, bounds)
        wave = self.transfer.wave
        brightest = float(self.blurred.max()) / self.joined
        noise = math.sqrt(self.noise.variance / self.joined) / max(brightest, 1e-300)
        pitch = self._scene.camera.image_pitch * self._scale
        return blind_forecast(
            rms_aberration(wave) / wave.wavelength,
            noise,
            self.slope * self._reach() / pitch,
            bounds,
        )


def _coarser(scene: Scene, stroke: float, scale: float) -> tuple[Scene, int]:
    """Return the scene with joined pixels, and how many form one of them.

    As many are joined as leave 64 along the longer side and 3 along a stroke of width ``stroke``,
    m, and fill the detector. This keeps the signal-to-noise ratio of every frequency that they
    resolve. ``scale`` is that of `object_scale`.
    """
    camera = scene.camera
    most = max(camera.shape) / 64
    if stroke > 0.0:
        most = min(most, stroke / (3 * camera.image_pitch * scale))
    side = next(
        k
        for k in range(max(math.floor(most), 1), 0, -1)
        if all(n % (camera.binning * k) == 0 for n in camera.pixels)
    )
    joined = replace(scene, camera=replace(camera, binning=camera.binning * side))
    return (joined if side > 1 else scene), side * side


def first_crossing(frequency: Array, ratio: Array) -> float:
    """Return the frequency at which a ratio first falls below 1.

    Returns the frequency, interpolated between logarithms; 0 if the first value is below 1, and the
    last frequency if none is.
    """
    below = np.flatnonzero(ratio < 1.0)
    if not len(below):
        return float(frequency[-1])
    k = int(below[0])
    if k == 0:
        return 0.0
    high, low = math.log(ratio[k - 1]), math.log(max(float(ratio[k]), 1e-300))
    return float(frequency[k - 1] * (frequency[k] / frequency[k - 1]) ** (high / (high - low)))
