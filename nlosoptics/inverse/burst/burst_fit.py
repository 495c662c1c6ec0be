"""Fit of one object to a burst of images through independent speckle."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, optimize

from ..._checks import whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ..data.arrays import check_finite, real_array
from ..data.driver import goes_on, state_of
from ..data.reconstruction import Reconstruction, frozen, registered_correlation
from ..data.status import Status
from .speckle_likelihood import BurstLikelihood, speckle_power

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """Numbers of the fit and of its tests.

    ``flux``: error of the object's sum, which the mean image determines. ``rounds``, ``steps``: the
    model of the power in the third cumulant is renewed at most so often, after so many steps.
    ``rounding``: part of the object's maximum below which differences are no edges. ``settled``:
    largest distance from 1 of the correlation of the last two rounds' objects. ``information``:
    least information about the phases, nats for each frequency above the noise; 0.25 leaves errors
    of about 1 rad. ``skewness``: least third cumulant over the model's. ``margin``: least logarithm
    of the odds against the object turned by half a turn, unless object and turned object correlate
    by more than ``symmetric``. ``expected``: least expected correlation with the truth.
    """

    flux: float = 0.03
    rounds: int = 10
    steps: int = 60
    rounding: float = 1e-3
    settled: float = 5e-3
    information: float = 0.25
    skewness: float = 0.6
    margin: float = 5.0
    symmetric: float = 0.95
    expected: float = 0.9


SETTINGS = Settings()


def burst_fit(
    images: ArrayLike,
    spread: Any,
    *,
    independent_patterns: int = 1,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a still object from many images of it through different parts of a rough wall.

    Each part of a wall that is rougher than the wavelength blurs the object by another speckle
    pattern. The patterns are unknown; their statistics are not.

    Parameters
    ----------
    images : array_like (K, H, W)
        Images of one object, in any unit that is proportional to light, without background
        (subtract it; its noise may remain). At least 6; 16 are often enough. Between two exposures
        the camera moves along the wall by more than the part of it that the lens sees
        from one object point. A shift of the whole image does not matter.
    spread : PointSpread
        Any point spread of the lens at the images' pixels, such as `scene_point_spread` or
        `mean_point_spread` return. Only its ``wavelength``, ``f_number``, ``pitch`` and
        ``pixel_integrated`` are used: they determine the spectrum of fully developed speckle.
    independent_patterns : int
        Number of patterns that one exposure averages, such as 2 for unpolarised light.
    seed : int
        Seed of the random starts.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop`; the status is then "unconverged".

    Returns
    -------
    Reconstruction
        Object (H, W) within the middle half of the frame, with a maximum of 1. Its true position is
        unknown; its orientation is not.

        ``status`` is "too_few_photons" if images and light determine too little of the object;
        "does_not_fit" if the light is less skewed than speckle through the object, as with an
        object that changes or a wall that is too smooth; "ambiguous" if the object turned by half a
        turn is about as likely; "unconverged" if the fit was stopped or has not settled.

        ``score`` and ``agreement`` are the correlation between the objects of the first and the
        second half of the burst. Each half is fitted from a start of its own and from the answer of
        the whole, and the more probable answer counts. Other ``physical_parameters``:
        ``expected_correlation`` with the truth, ``sqrt(2 a/(1 + a))`` for the agreement a;
        ``information`` about the phases, nats for each frequency above the noise; ``skewness``,
        third cumulant over the model's, for the object of one half and the images of the other;
        ``turn_margin``, logarithm of the odds against the object turned by half a turn, likewise;
        ``symmetry``, correlation of the object with the turned one; ``noise_sigma``, rms noise of a
        pixel of the fluctuations, relative to the mean image.

    Raises
    ------
    SamplingError
        If ``images`` are not (K, H, W) with K of 6 or more and sides of 16 or more, or the pixels
        are wider than 0.6 lambda N, with the wavelength lambda and the F-number N.
    SceneError
        If an image is not finite, or the mean image is not positive.

    See Also
    --------
    evidence_fit : Object and a smooth wall together, from one or two images.
    phase_retrieval : Object from a single speckle image.

    Notes
    -----
    Relative to the smooth mean image, each image is the convolution of the object with a stationary
    speckle pattern of known statistics. Averaged over the burst, the power spectrum determines the
    modulus of the object's spectrum [1]_, and the bispectrum its phase [2]_, with neither support
    nor twin. Both are used at once, in a likelihood of the object in which the unknown patterns are
    integrated out: that of the power of each frequency, plus the first term of the Edgeworth
    expansion in the third cumulant, whose constant follows from the theory of speckle. It is
    maximised over non-negative objects whose sum the mean image gives, with the prior
    ``TV^(-n/2)``, the scale-free prior of total variation TV for n pixels.

    The pattern must be the same for all points of the object: where the memory effect is narrower
    than the object, the fit does not hold. The point spread must be several times wider than the
    object, and the wall rougher than the wavelength, without a sharp core.

    References
    ----------
    .. [1] Labeyrie, Astronomy and Astrophysics 6 (1970) 85.
    .. [2] Lohmann, Weigelt and Wirnitzer, Applied Optics 22 (1983) 4028.

    Examples
    --------
    Constant images have no speckle, and so no object:

    >>> import numpy as np
    >>> from nlosoptics import inverse, psf
    >>> lens = psf.Wavefront.from_zernike(
    ...     {}, wavelength=632.8e-9, pupil_radius=7.5e-3, image_distance=53e-3
    ... )
    >>> spread = psf.point_spread(lens, pitch=1.1e-6, shape=32, pixel_integrated=True)
    >>> images = np.random.default_rng(0).poisson(400.0, (8, 32, 32))
    >>> inverse.burst_fit(images, spread).status
    'too_few_photons'
    """
    started = time.perf_counter()
    values, cutoff = _checked(images, spread)
    patterns = whole("independent_patterns", independent_patterns)
    search = _Search(values.shape[1:], generator(checked_seed(seed), 0x62757273), progress)
    speckle = speckle_power(
        search.shape, cutoff, pixel_integrated=bool(spread.pixel_integrated), patterns=patterns
    )
    half = len(values) // 2
    whole_burst, *halves = (
        BurstLikelihood.of(part, speckle, cutoff) for part in (values, values[:half], values[half:])
    )
    level = search.run(whole_burst, search.start())
    if search.change > SETTINGS.settled:  # once more, from another start
        level = search.run(whole_burst, search.start())
    settled = search.change <= SETTINGS.settled
    levels = [search.better(part, search.start(), level) for part in halves]
    tests = _tests(whole_burst, halves, level, levels)
    status, reasons = _status(tests, settled and not search.stopped)
    brightest = float(level.max())
    return Reconstruction(
        object=level / (brightest if brightest > 0.0 else 1.0),
        physical_parameters={**tests, "noise_sigma": math.sqrt(whole_burst.noise)},
        status=status,
        score=tests["agreement"],
        history=frozen({"objective": search.costs}),
        seconds=time.perf_counter() - started,
        reasons=reasons,
    )


def _checked(images: ArrayLike, spread: Any) -> tuple[Array, float]:
    """Return images (K, H, W) and the cut-off, cycles per pixel."""
    values = real_array("images", images)
    if values.ndim != 3 or len(values) < 6 or min(values.shape[1:]) < 16:
        raise SamplingError(
            f"images have shape {values.shape}, must be (K, H, W) with K of 6 or more and sides of "
            "16 or more; stack all images of the burst"
        )
    check_finite("images", values, "replace or leave out the image")
    smallest = float(values.mean(axis=(1, 2)).min())
    if smallest <= 0.0:
        raise SceneError(
            f"images have a mean of {smallest:.3g}, must be above 0; leave dark images out, and "
            "subtract no more than the background"
        )
    try:
        cutoff = float(spread.pitch) / (float(spread.wavelength) * float(spread.f_number))
    except AttributeError:
        raise SceneError(
            f"spread of type {type(spread).__name__} is no point spread; give a PointSpread at "
            "the images' pixels"
        ) from None
    if not 0.0 < cutoff <= 0.6:
        raise SamplingError(
            f"spread has pixels of {cutoff:.3g} lambda N, limit 0.6, so that images do not resolve "
            "speckle; use narrower pixels or a smaller stop"
        )
    return values, cutoff


class _Search:
    """Fits from random starts, with what their reports need."""

    def __init__(
        self, shape: tuple[int, ...], random: np.random.Generator, progress: Progress | None
    ) -> None:
        self.shape = shape[0], shape[1]
        self.random, self.progress = random, progress
        self.middle = tuple(slice(n // 4, n // 4 + n // 2) for n in shape)
        self.stopped, self.change = False, math.inf
        self.costs: list[float] = []

    def start(self) -> Array:
        """Return a disc (H, W) of random brightness, unit sum, near the size of most objects."""
        y, x = (np.arange(n) - n // 2 for n in self.shape)
        disc = np.hypot(y[:, None], x) < 0.11 * min(self.shape)
        level = disc * self.random.random(self.shape)
        return np.asarray(level / level.sum())

    def better(self, likelihood: BurstLikelihood, *starts: Array) -> Array:
        """Return the answer of least cost from several starts, of those that settled if any did."""
        answers = []
        for start in starts:
            answer = self.run(likelihood, start)
            answers.append(((self.change > SETTINGS.settled, self.costs[-1]), answer))
        return min(answers, key=lambda pair: pair[0])[1]

    def run(self, likelihood: BurstLikelihood, level: Array) -> Array:
        """Return the object (H, W), about unit sum, of the largest likelihood times prior."""
        power = likelihood.spectrum(np.asarray(fft.rfft2(level)))
        for _ in range(SETTINGS.rounds):
            if self.stopped and self.costs:
                break
            before, level = level, self._round(likelihood, level, power)
            # The geometric mean, since the answer overshoots a model that is renewed at once.
            power = np.sqrt(power * likelihood.spectrum(np.asarray(fft.rfft2(level))))
            self.change = 1.0 - registered_correlation(level, before)
            share = min(len(self.costs) / (6 * SETTINGS.rounds), 1.0)  # of at most six runs
            text = "burst: the object, and that of each half"
            self.stopped = not goes_on(self.progress, text, share, partial(state_of, level))
            if self.change <= SETTINGS.settled:
                break
        return level

    def _round(self, likelihood: BurstLikelihood, level: Array, power: Array) -> Array:
        """Make steps with a fixed model of the power in the third cumulant."""
        brightest, middle, frame = float(level.max()), self.middle, np.zeros(self.shape)

        def cost(values: Array) -> tuple[float, Array]:
            frame[middle] = brightest * values.reshape(frame[middle].shape)
            waves = np.asarray(fft.rfft2(frame))
            second, third = likelihood.second(waves), likelihood.third(waves, power)
            variation, slope = _total_variation(frame, SETTINGS.rounding * brightest)
            weight, excess = values.size / 2.0, (float(frame.sum()) - 1.0) / SETTINGS.flux
            value = second[0] + third[0] - weight * math.log(variation) - 0.5 * excess**2
            gradient = second[1] + third[1] - (weight / variation) * slope
            gradient -= excess / SETTINGS.flux
            return -value, -brightest * gradient[middle].ravel()

        result = optimize.minimize(
            cost,
            level[middle].ravel() / brightest,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * level[middle].size,
            options={"maxiter": SETTINGS.steps, "maxcor": 20},
        )
        self.costs.append(float(result.fun))
        answer = np.zeros(self.shape)
        answer[middle] = brightest * result.x.reshape(answer[middle].shape)
        return answer


def _total_variation(level: Array, rounding: float) -> tuple[float, Array]:
    """Return the isotropic total variation of an image (H, W), rounded at 0, and its gradient."""
    down, across = level - np.roll(level, 1, 0), level - np.roll(level, 1, 1)
    length = np.sqrt(down**2 + across**2 + rounding**2)
    value = float((length - rounding).sum()) + rounding
    down, across = down / length, across / length
    return value, down - np.roll(down, -1, 0) + across - np.roll(across, -1, 1)


def _tests(
    burst: BurstLikelihood, halves: list[BurstLikelihood], level: Array, levels: list[Array]
) -> dict[str, float]:
    """Return how far two halves agree, and how the object of each explains images of the other."""
    agreement = registered_correlation(*levels)
    measured = expected = margin = 0.0
    for likelihood, other in zip(halves, reversed(levels), strict=True):
        waves = np.asarray(fft.rfft2(other))
        value, model = likelihood.cumulants(waves)
        measured, expected = measured + value, expected + model
        margin += value - likelihood.cumulants(np.conj(waves))[0]
    waves = np.asarray(fft.rfft2(level))
    information = 0.5 * burst.cumulants(waves)[1] / max(burst.frequencies(waves), 1.0)
    return {
        "agreement": agreement,
        "expected_correlation": math.sqrt(2.0 * agreement / (1.0 + agreement)),
        "information": information,
        "skewness": measured / expected if expected > 0.0 else 0.0,
        "turn_margin": margin,
        "symmetry": registered_correlation(level, level[::-1, ::-1]),
    }


def _status(tests: dict[str, float], settled: bool) -> tuple[Status, tuple[str, ...]]:
    """Return the status, and the reason against "converged"."""
    limits = SETTINGS
    if tests["information"] < limits.information:
        return "too_few_photons", (
            f"each frequency has {tests['information']:.2g} nats about its phase, least "
            f"{limits.information:g}; take more images, or expose longer",
        )
    if tests["skewness"] < limits.skewness:
        return "does_not_fit", (
            f"for the object of the other half, images have {tests['skewness']:.2f} of the third "
            f"cumulant of speckle, least {limits.skewness:g}: object or camera changed, or the "
            "wall is not rough",
        )
    if tests["turn_margin"] < limits.margin and tests["symmetry"] < limits.symmetric:
        return "ambiguous", (
            f"the object turned by half a turn is less likely by {tests['turn_margin']:.2g} nats "
            f"only, least {limits.margin:g}; take more images",
        )
    if tests["expected_correlation"] < limits.expected:
        return "too_few_photons", (
            f"two halves of the burst let expect a correlation of "
            f"{tests['expected_correlation']:.2f}, least {limits.expected:g}; take more images",
        )
    if not settled:
        return "unconverged", ("the object still changed when the fit ended",)
    return "converged", ()
