"""Status of a reconstruction with a known point spread, from tests that can fail.

Fits of least total variation are judged by the sum of several signs of a wrong model, each of which
is too weak alone; see `signs`. Other fits are judged by their residual, by the noise beyond the
optics' cut-off, and by light at the frame's edge. `benchmarks/inverse/mismatches.py` counts how
often the status is right, on objects, walls and mismatches that no limit was set with.

Some errors leave no trace in one image. A camera that is not linear changes the object's grey
values. If the model lacks a part of the blur, the object has a halo around all of its parts; that
is a sign, but a soft object behind the model's blur looks similar. Light that is absent from the
frame's edges, such as a veil in its middle, is fitted as part of the object.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .arrays import Values, as_double, as_numpy
from .models import AnyModel, image_of, widened
from .noisy_image import NoisyImage
from .signs import WIDER, as_if_steady, border, doubt, expected_correlation, risk, signs, told
from .spectra import (
    beyond_optics,
    expected_signal,
    half_weights,
    object_power,
    passed_power,
    periodic_power,
    power,
)

Array = NDArray[np.float64]

#: How a solver ended and whether its answer holds; see `inverse.Reconstruction`.
Status = Literal["converged", "trivial", "unconverged", "too_few_photons", "does_not_fit"]


@dataclass(frozen=True)
class _Band:
    """Band of frequencies by their expected ratio of signal to noise.

    ``most`` limits the mean power of the residual over the noise's, for very many frequencies.
    """

    name: str
    low: float
    high: float
    most: float


_BANDS = (
    _Band("coarse", 3.0, 30.0, 1.3),
    _Band("fine", 0.3, 3.0, 1.2),
    _Band("finest", 0.02, 0.3, 1.05),
)
_MOST_ERRORS = 6.0  # standard errors of a mean power beyond its limit
_LEAST_COUNT = 24.0  # frequencies for a test
#: Largest rms residual over the noise of a fit that is brought to the noise level.
MOST_RESIDUAL = 1.05
# Largest relative drift of the residual over the last fifth of the iterations. The rms of the noise
# in 64 x 64 pixels has a standard error of 0.011.
_MOST_DRIFT = 0.02
# Largest median change per iteration of a fit that ran out of iterations, and their least number.
_MOST_CHANGE, _LEAST_ITERATIONS = 5e-4, 100
# Largest brightness of the object at the frame's edge relative to its mean, in a padded frame.
_MOST_BORDER = 1.1
# Least expected correlation of object and Wiener estimate. A sharp fit restores edges that a filter
# does not, but half of the power of a typical object's detail must exceed the noise.
_LEAST_SHARE, _LEAST_SHARP_SHARE = 0.73, math.sqrt(0.5)
# Least correlation with the truth that a sharp fit must let expect.
_LEAST_EXPECTED = 0.9
# Factor by which the lack of correlation is larger than expected if pixels are saturated.
_SATURATED = 2.0
# Largest share of a linear estimate's power in negative pixels, apart from that of the noise.
_MOST_NEGATIVE = 0.03
# Largest ratio of measured and stated noise beyond the optics, or of two parts of that noise.
_MOST_NOISE_RATIO = 1.2
_OTHER_NOISE = 20  # seed of the noise of a repetition


@dataclass(frozen=True, eq=False, kw_only=True)
class Ending:
    """End of a solver's iterations, as `judged` needs it.

    Parameters
    ----------
    converged : bool
        Whether it met its own tolerance.
    history : mapping of str to sequence of float
        Records of the iterations: ``residual`` (over the noise) and ``change`` (relative).
    most_residual : float or None
        Largest rms residual over the noise, for a solver that brings it to the noise level. None
        for a filter and for a weight that the caller chose: residuals are then not tested.
    again : callable or None
        For a solver that prefers objects with few edges and brings the residual to the noise, so
        that `signs` apply: function of a `NoisyImage` and an image model that returns the object
        (H, W) and the background, image units, of the same fit to that image.
    """

    converged: bool
    history: Mapping[str, Sequence[float]]
    most_residual: float | None = None
    again: Callable[[NoisyImage, AnyModel], tuple[Values, float]] | None = None

    def settled(self) -> bool:
        """Return whether more iterations would hardly change the object.

        A fit that has run out of iterations is settled if its last changes are below 5e-4 and the
        residual has stayed within 2 % during the last fifth of the iterations.
        """
        still = self.stalled() and sorted(self.history["change"][-20:])[10] <= _MOST_CHANGE
        return self.converged or still

    def steady(self) -> bool:
        """Return whether the solver has converged, or the residual no longer changes."""
        return self.converged or self.stalled()

    def stalled(self) -> bool:
        """Return whether the residual no longer changes."""
        residuals = self.history["residual"]
        if len(residuals) < _LEAST_ITERATIONS:
            return False
        earlier = residuals[int(0.8 * len(residuals))]
        return abs(earlier - residuals[-1]) <= _MOST_DRIFT * residuals[-1]


@dataclass(frozen=True, eq=False)
class Judgement:
    """Status of a fit, the reasons against "converged", and the estimated error of a sharp fit.

    Parameters
    ----------
    status : {"converged", "unconverged", "too_few_photons", "does_not_fit"}
        "does_not_fit" if a test of the model failed; otherwise "too_few_photons" if the noise
        hides most of the object.
    reasons : tuple of str
        A sentence for each failed test, with the value, the limit and a likely cause.
    expected_correlation : float or None
        Correlation with the truth to expect if the model is right; None without a second fit.
    error : ndarray or None, (H, W)
        Estimated error of each pixel of the object, image units; None without a second fit.
    """

    status: Status
    reasons: tuple[str, ...]
    expected_correlation: float | None = None
    error: Array | None = None


def judged(
    data: NoisyImage, level: Values, strength: float, model: AnyModel, ending: Ending
) -> Judgement:
    """Return the status of a fit with a known point spread, and the reasons against "converged".

    Parameters
    ----------
    data : NoisyImage
        Image and noise.
    level : ndarray or Tensor, (H, W)
        Fitted object times gain, image units.
    strength : float
        Fitted strength of the unknown background, image units.
    model : ForwardModel or TorchForwardModel
        Image model, of which only the mean point spread is used in the tests of spectra.
    ending : Ending
        How the solver ended.

    Notes
    -----
    The stated noise must be that of the frequencies beyond the optics' cut-off.

    A sharp fit does not fit the scene if the sum of its signs, `signs.doubt`, is positive: of such
    answers at least 3 in 10 had a correlation below 0.85 with the truth in tests with equally many
    right and wrong answers. The last reason states this probability. One of the signs needs a
    second fit, to the image of the object by a wider point spread with other noise. If the sum is
    positive only because this fit gives another object, and noise alone can explain this, the image
    has too few photons. It also has too few if the `expected_correlation` is low, or if the Wiener
    filter would recover too little of an object with the spectrum 1/f^2: of an object that the
    noise hides from both fits, the second one shows no loss.

    For other fits

    - no more of the object's power may be negative than noise makes negative;
    - the Wiener filter would recover enough of an object with the spectrum 1/f^2;
    - the noise beyond the cut-off must be white;
    - the object must not be bright at the edge of a padded frame;
    - the residual of a fit that is brought to the noise must not exceed it, neither in all nor in
      one of three bands that the optics pass.

    Tests of spectra use the frame's periodogram, whose values are independent exponential
    variables for white noise, also if its variance differs from pixel to pixel. A mean over n
    frequencies has the relative standard error sqrt(2/n).
    """
    data, level = data.in_numpy(), as_double(as_numpy(level))
    if not level.any():
        return Judgement(
            "too_few_photons", ("the fit explains the image without an object; expose longer",)
        )
    spectrum = Spectra(data, level, strength, model)
    again = None
    # of a fit whose residual still changes a second one would tell nothing
    if ending.steady() and ending.again is not None:
        wider = widened(model, WIDER)
        again = as_double(as_numpy(ending.again(spectrum.repetition(wider), wider)[0]))
    values = None if ending.again is None else spectrum.signs(level if again is None else again)
    status, reasons = _status(spectrum, level, values, model, ending)
    if values is None or again is None:
        return Judgement(status, reasons)
    expected = spectrum.expected_correlation(values)
    return Judgement(status, reasons, expected, np.abs(again - level))


def _status(
    spectrum: Spectra,
    level: Array,
    values: Mapping[str, float] | None,
    model: AnyModel,
    ending: Ending,
) -> tuple[Status, tuple[str, ...]]:
    """Return status and reasons; ``values`` are the signs of a sharp fit."""
    share = spectrum.share()
    if ending.steady():
        faults = list(spectrum.stated_noise_faults(explained=values is not None))
        if values is not None:
            expected = spectrum.expected_correlation(values)
            # The noise can hide no more than what a linear estimate would miss.
            hidden = values["unsteady"] ** 2 <= 1.0 - share
            noisy = hidden and doubt(as_if_steady(values)) <= 0.0 < doubt(values)
            if not faults and (noisy or (doubt(values) <= 0.0 and expected < _LEAST_EXPECTED)):
                return "too_few_photons", tuple(told({"unsteady": values["unsteady"]}))
            if doubt(values) > 0.0:
                faults += [*told(values), *spectrum.colour_faults()]
                faults.append(
                    f"of answers with such signs {100 * risk(values):.0f} % were wrong in tests, "
                    "with a correlation below 0.85"
                )
        else:
            faults += [*spectrum.colour_faults(), *_edge_faults(level, model)]
            if ending.most_residual is not None:
                faults += spectrum.residual_faults(ending.most_residual)
        if faults:
            return "does_not_fit", tuple(faults)
    if not ending.settled():
        return "unconverged", (spectrum.unfinished(len(ending.history["residual"])),)
    negative = _negative_share(level)
    noise = 0.5 * (1.0 - share**2)  # of the power; noise is as often negative as positive
    if negative > _MOST_NEGATIVE + noise:
        return "does_not_fit", (
            f"{100 * negative:.2g} % of the object's power is negative, limit "
            f"{100 * (_MOST_NEGATIVE + noise):.2g} % with this noise; the point spread is wrong",
        )
    if negative > _MOST_NEGATIVE:
        return "too_few_photons", (
            f"{100 * negative:.2g} % of the object's power is negative, limit "
            f"{100 * _MOST_NEGATIVE:g} %; the object is mostly noise: expose longer, or use "
            "tv_deconvolve",
        )
    least = _LEAST_SHARE if values is None else _LEAST_SHARP_SHARE
    if share < least:
        return "too_few_photons", (
            f"the noise hides most of the object: expected correlation {share:.2f} of a linear "
            f"estimate, least {least:.2f}; expose longer",
        )
    return "converged", ()


class Spectra:
    """Power spectra of the image, of the expected signal and of the residual, over the noise."""

    def __init__(self, data: NoisyImage, level: Array, strength: float, model: AnyModel) -> None:
        self._data, self._level = data, level
        self._shape = data.data.shape
        self._twice = half_weights(self._shape)
        passed = passed_power(model)
        self._passed = passed / passed.max()
        variance = data.sigma**2
        image_power = periodic_power(data.without_background())
        signal = expected_signal(image_power, passed, variance, self._shape)
        self._ratio = signal / variance
        self._beyond = beyond_optics(signal, variance)
        self._background = data.background(strength)
        explained = image_of(model, level) + self._background
        residual = data.whitened((data.data - explained) / data.sigma)
        self._rms = data.score(explained)
        self._left = power(residual) * (residual.size / data.counted)
        # Excluded pixels hold the mean, and their steps would spread over all frequencies.
        masked = data.counted < residual.size
        # The image is not weighted: its noise has the mean variance of the pixels, which exceeds
        # sigma^2 if a few bright pixels have most of the photon noise.
        self._mean_variance = data.noise_power() / self._level.size
        self._noise = self._left if masked else (image_power - signal) / self._mean_variance

    def repetition(self, model: AnyModel) -> NoisyImage:
        """Return a model's image of the fitted object with other noise of the same strength."""
        noise = np.random.default_rng(_OTHER_NOISE).normal(size=self._shape) * self._data.sigma
        if self._data.weights is not None:
            root = np.sqrt(self._data.weights)
            noise = np.divide(noise, root, out=np.zeros(self._shape), where=root > 0.0)
        image = image_of(model, self._level) + self._background
        least = self._data.least
        if least is not None:  # the camera would saturate there in this image too, or not at all
            least = np.minimum(least, image)
        return replace(self._data, data=image + noise, least=least)

    def signs(self, again: Array) -> dict[str, float]:
        """Return the signs of a wrong model in a sharp fit, with its object of `repetition`."""
        excess = float((self._twice * self._ratio).sum()) / self._level.size
        return signs(self._level, again, residual=self._rms, excess=excess, passed=self.passed())

    def expected_correlation(self, values: Mapping[str, float]) -> float:
        """Return the correlation with the truth to expect of a sharp fit with these `signs`."""
        lack = 1.0 - expected_correlation(values["unsteady"], self.share())
        if self._data.least is not None:
            lack *= _SATURATED
        return 1.0 - min(lack, 1.0)

    def passed(self) -> float:
        """Return the share of the power of the object's detail that the optics pass, 0 to 1."""
        detail = self._twice * power(self._level)
        return float((detail * self._passed).sum()) / max(float(detail.sum()), 1e-300)

    def stated_noise_faults(self, *, explained: bool) -> Iterator[str]:
        """Compare the image beyond the cut-off with the stated noise.

        With ``explained``, the fitted image is subtracted: the frame cuts it off, which spreads its
        power over all frequencies. Filters that fit the noise as well leave no noise to compare.
        """
        power_there = self._mean(self._left if explained else self._noise, self._beyond)
        enough = power_there[1] >= 4 * _LEAST_COUNT and not self._data.sigma_estimated
        if enough and _differ(power_there, (1.0, math.inf)):
            yield (
                f"beyond the optics' cut-off the image has {max(power_there[0], 0.0):.2f} of the "
                "stated noise's power; check noise_sigma, or whether the image is of this scene"
            )

    def colour_faults(self) -> Iterator[str]:
        """Compare the image beyond the cut-off with white noise."""
        y = np.abs(np.fft.fftfreq(self._shape[0]))[:, None]
        x = np.fft.rfftfreq(self._shape[1])[None]
        far = np.hypot(y, x)
        if float(self._twice[self._beyond].sum()) < 4 * _LEAST_COUNT:
            return
        inner = far <= np.median(far[self._beyond])
        for kind, one, other in (
            ("near the cut-off and far from it", inner, ~inner),
            ("along rows and along columns", y > x, y < x),
        ):
            first = self._mean(self._noise, self._beyond & one)
            second = self._mean(self._noise, self._beyond & other)
            if min(first[1], second[1]) >= 2 * _LEAST_COUNT and _differ(first, second):
                yield (
                    "the optics pass nothing beyond their cut-off, but the image there is not "
                    f"white noise: its power {kind} is {first[0]:.2f} and {second[0]:.2f} of the "
                    "noise's; the noise is coloured, or the image is sharper than the scene allows"
                )

    def residual_faults(self, most_residual: float) -> Iterator[str]:
        """Compare the residual with the noise, in all and in the bands that the optics pass."""
        if self._rms > most_residual:
            yield (
                f"the residual is {self._rms:.3g} times the noise, limit {most_residual:g}; the "
                "fit does not explain the image"
            )
        for band in _BANDS:
            inside = (self._ratio >= band.low) & (self._ratio < band.high)
            mean, count = self._mean(self._left, inside)
            if count < _LEAST_COUNT:
                continue
            most = band.most * math.exp(_MOST_ERRORS * math.sqrt(2.0 / count))
            if mean > most:
                yield (
                    f"the residual of the {band.name} detail has {mean:.2f} of the noise's power, "
                    f"limit {most:.2f}; the point spread, the camera's response or the background "
                    "differs from the model"
                )

    def unfinished(self, count: int) -> str:
        """Return what an unfinished fit, or a network without iterations, leaves."""
        left = f"the residual is {self._rms:.3g} times the noise"
        if count == 0:
            return f"{left}: the network does not explain this image; train it for this scene"
        return f"{left} after {count} iterations, and still changes; give more iterations"

    def share(self) -> float:
        """Return the expected correlation of an object and its Wiener estimate, 0 to 1."""
        weights = self._twice * object_power(self._shape)
        if not weights.any():  # a single pixel has no detail that noise could hide
            return 1.0
        gain = self._ratio / (1.0 + self._ratio)
        return math.sqrt(float((weights * gain).sum() / weights.sum()))

    def _mean(self, values: Array, mask: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the mean of a half spectrum in a mask, and the number of its frequencies."""
        count = float(self._twice[mask].sum())
        return float((self._twice * values)[mask].sum()) / max(count, 1.0), count


def _edge_faults(level: Array, model: AnyModel) -> Iterator[str]:
    """Find light at the edge of a padded frame, outside which the model assumes darkness."""
    edge = border(level) if level.mean() > 0.0 else math.inf
    if model.boundary == "padded" and edge > _MOST_BORDER:
        yield (
            f"the object is {edge:.2f} times as bright at the frame's edge as on average, limit "
            f"{_MOST_BORDER:g}; there is a veil (give background_shape) or light from outside the "
            "frame, or the point spread is wrong"
        )


def _negative_share(level: Array) -> float:
    """Return the share of an object's power, sum of squares, in negative pixels."""
    return float((np.minimum(level, 0.0) ** 2).sum() / (level**2).sum())


def _differ(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Return whether two mean powers, each with its number of frequencies, differ.

    Both the difference of six standard errors and the ratio of rms values must exceed their limits.
    """
    if min(first[0], second[0]) <= 0.0:
        return True
    logarithm = abs(math.log(first[0] / second[0]))
    error = math.sqrt(2.0 / first[1] + 2.0 / second[1])
    return logarithm > max(_MOST_ERRORS * error, 2.0 * math.log(_MOST_NOISE_RATIO))
