"""Status of a reconstruction with a known point spread, from tests that follow from the model.

Four questions are asked: does the fit explain the image to the noise, did the solver settle, is the
object one that the model allows, and does the noise leave enough of it. Some errors leave no trace
in one image: a camera that is not linear changes the object's grey values, and another object can
have the same image by a wrong point spread. `benchmarks/inverse/mismatches.py` counts how often.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arrays import Values, as_double, as_numpy
from .models import AnyModel, image_of, widened
from .noisy_image import NoisyImage
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
Status = Literal[
    "converged", "trivial", "unconverged", "too_few_photons", "does_not_fit", "ambiguous"
]


@dataclass(frozen=True)
class Limits:
    """Limits of the tests.

    ``residual``: largest rms residual over the noise of a fit that is brought to the noise level.
    ``unexplained``: power of the residual beyond the noise, over that of the image's detail, up to
    which a larger residual is harmless. ``drift``, ``change``, ``iterations``: A fit that ran out
    of iterations is settled after at least so many, if the residual drifted by less than this
    fraction over the last fifth of them (the rms noise of 64 x 64 pixels has a standard error of
    0.011), and if the median of the last changes is below ``change``. ``border``: largest
    brightness of the object at the frame's edge over its mean, in a padded frame. ``negative``:
    largest share of the object's power in negative pixels, apart from that of the noise. ``share``:
    least correlation of a linear estimate with the truth, expected for a typical object.
    ``expected``: least expected correlation of a fit with a second fit. ``noise_ratio``,
    ``errors``, ``count``: the noise beyond the optics' cut-off may differ from the stated one by
    this ratio and by so many standard errors; at least so many frequencies are needed. ``wider``:
    width of the point spread of the second fit, relative to the model's.
    """

    residual: float = 1.05
    unexplained: float = 1e-3
    drift: float = 0.02
    change: float = 5e-4
    iterations: int = 100
    border: float = 1.1
    negative: float = 0.03
    share: float = 0.73
    expected: float = 0.92
    noise_ratio: float = 1.2
    errors: float = 6.0
    count: float = 96.0
    wider: float = math.sqrt(2.0)


LIMITS = Limits()


@dataclass(frozen=True, eq=False, kw_only=True)
class Ending:
    """End of a solver's iterations, as `judged` needs it.

    ``converged``: whether it met its own tolerance. ``history``: records of the iterations:
    ``residual`` (over the noise) and ``change`` (relative). ``most_residual``: largest rms residual
    over the noise, for a solver that brings it to the noise level. None for a filter and for a
    weight that the caller chose: residuals are then not tested. ``again``: for a solver that brings
    the residual to the noise by its weight of edges: function of a `NoisyImage` and an image model
    that returns the object (H, W) and the background, image units, of the same fit to that image.
    """

    converged: bool
    history: Mapping[str, Sequence[float]]
    most_residual: float | None = None
    again: Callable[[NoisyImage, AnyModel], tuple[Values, float]] | None = None

    def settled(self) -> bool:
        """Return whether more iterations would hardly change the object, see `Limits`."""
        changes = self.history["change"][-20:]
        return self.converged or (self.steady() and sorted(changes)[10] <= LIMITS.change)

    def steady(self) -> bool:
        """Return whether the solver has converged, or the residual no longer changes."""
        residuals = self.history["residual"]
        if self.converged or len(residuals) < LIMITS.iterations:
            return self.converged
        earlier = residuals[int(0.8 * len(residuals))]
        return abs(earlier - residuals[-1]) <= LIMITS.drift * residuals[-1]


class Judgement(NamedTuple):
    """Status of a fit, the reasons against "converged", and the estimated error of a sharp fit.

    ``expected_correlation`` and ``error`` (H, W), image units, hold if the model is right; None
    without a second fit.
    """

    status: Status
    reasons: tuple[str, ...]
    expected_correlation: float | None = None
    error: Array | None = None


def judged(
    data: NoisyImage, level: Values, strength: float, model: AnyModel, ending: Ending
) -> Judgement:
    """Return the status of a fit with a known point spread, and the reasons against "converged".

    ``data``: image and noise. ``level`` (H, W): fitted object times gain, image units.
    ``strength``: fitted strength of the unknown background, image units. ``model``: image model, of
    which only the mean point spread is used in the tests of spectra. ``ending``: how the solver
    ended.

    The image does not fit the model if

    - the noise beyond the optics' cut-off is not the stated one;
    - the residual of a fit that is brought to the noise exceeds it, by more than 0.1 % of the power
      of the image's detail;
    - the object is bright at the edge of a padded frame, outside which the model assumes darkness;
    - more of the object's power is negative than noise makes negative.

    The image has too few photons if a second fit, to the image of the object by a wider point
    spread with other noise, lets expect a low correlation with the truth: the wider one takes about
    as much from the object as blur and noise have taken from it already. Without a second fit, the
    Wiener filter must recover enough of an object with the spectrum 1/f^2.
    """
    data, level = data.in_numpy(), as_double(as_numpy(level))
    if not level.any():
        return Judgement(
            "too_few_photons", ("the fit explains the image without an object; expose longer",)
        )
    tests = _Tests(data, level, strength, model)
    if not ending.steady() or ending.again is None:
        return Judgement(*tests.status(ending, None))
    wider = widened(model, LIMITS.wider)
    again = as_double(as_numpy(ending.again(tests.repetition(wider), wider)[0]))
    expected = tests.expected_correlation(again)
    return Judgement(*tests.status(ending, expected), expected, np.abs(again - level))


class _Tests:
    """Tests of a fitted object ``level``, and the spectra that they need, over the noise."""

    def __init__(self, data: NoisyImage, level: Array, strength: float, model: AnyModel) -> None:
        self._data, self._level, self._padded = data, level, model.boundary == "padded"
        shape, variance = level.shape, data.sigma**2
        self._twice = half_weights(shape)
        image_power = periodic_power(data.without_background())
        signal = expected_signal(image_power, passed_power(model), variance, shape)
        self._beyond = beyond_optics(signal, variance)
        self._background = data.background(strength)
        explained = image_of(model, level) + self._background
        self._rms = data.score(explained)
        detail = float((self._twice * signal).sum()) / (variance * level.size)
        self._unexplained = (self._rms**2 - 1.0) / max(detail, 1e-3)
        residual = data.whitened((data.data - explained) / data.sigma)
        self._left = power(residual) * (residual.size / data.counted)
        # Excluded pixels hold the mean, and their steps would spread over all frequencies.
        masked = data.counted < residual.size
        # The noise of the image has the mean variance of the pixels, which exceeds sigma^2 if a few
        # bright pixels have most of the photon noise.
        mean_variance = data.noise_power() / level.size
        self._noise = self._left if masked else (image_power - signal) / mean_variance
        weights, gain = self._twice * object_power(shape), signal / (signal + variance)
        #: expected correlation of an object and its Wiener estimate; a single pixel has no detail
        self._share = math.sqrt((weights * gain).sum() / weights.sum()) if weights.any() else 1.0

    def repetition(self, model: AnyModel) -> NoisyImage:
        """Return a model's image of the fitted object with other noise of the same strength."""
        noise = np.random.default_rng(20).normal(size=self._level.shape) * self._data.sigma
        if self._data.weights is not None:
            root = np.sqrt(self._data.weights)
            noise = np.divide(noise, root, out=np.zeros_like(noise), where=root > 0.0)
        image = image_of(model, self._level) + self._background
        least = self._data.least
        if least is not None:  # the camera would saturate there in this image too, or not at all
            least = np.minimum(least, image)
        return replace(self._data, data=image + noise, least=least)

    def expected_correlation(self, again: Array) -> float:
        """Return the correlation with the truth to expect, from the object of a second fit.

        Both this fit and the linear estimate tell what blur and noise take from an object. One
        minus the correlation scatters by a factor of 1.7 about the value from both. Saturated
        pixels double it.
        """
        one, other = self._level - self._level.mean(), again - again.mean()
        norm = math.sqrt(float((one**2).sum() * (other**2).sum()))
        unlike = max(1.0 - float((one * other).sum()) / max(norm, 1e-300), 0.0)
        lack: float = 0.88 * (unlike * (1.0 - self._share)) ** (2.0 / 3.0)
        return 1.0 - min(lack if self._data.least is None else 2.0 * lack, 1.0)

    def status(self, ending: Ending, expected: float | None) -> tuple[Status, tuple[str, ...]]:
        """Return status and reasons; ``expected`` is the expected correlation of a sharp fit."""
        if ending.steady():
            faults = tuple(self._faults(ending))
            if faults:
                return "does_not_fit", faults
        if not ending.settled():
            count = len(ending.history["residual"])
            return "unconverged", (
                f"the residual is {self._rms:.3g} times the noise after {count} iterations, and "
                "still changes; give more iterations",
            )
        negative = float((np.minimum(self._level, 0.0) ** 2).sum() / (self._level**2).sum())
        noise = 0.5 * (1.0 - self._share**2)  # of the power; as often negative as positive
        if negative > LIMITS.negative + noise:
            return "does_not_fit", (
                f"{100 * negative:.2g} % of the object's power is negative, limit "
                f"{100 * (LIMITS.negative + noise):.2g} % with this noise; the point spread is "
                "wrong",
            )
        if negative > LIMITS.negative:
            return "too_few_photons", (
                f"{100 * negative:.2g} % of the object's power is negative, limit "
                f"{100 * LIMITS.negative:g} %; the object is mostly noise: expose longer, or use "
                "tv_deconvolve",
            )
        most, least = self._share, LIMITS.share
        if expected is not None:
            most, least = expected, LIMITS.expected
        if most < least:
            return "too_few_photons", (
                f"the noise hides detail of the object: expected correlation {most:.2f} with the "
                f"truth, least {least:.2f}; expose longer",
            )
        return "converged", ()

    def _faults(self, ending: Ending) -> Iterator[str]:
        # Filters that fit the noise as well leave no noise to compare. Others do, and the frame
        # cuts the fitted image off, which spreads its power over all frequencies.
        noise = self._noise if ending.again is None else self._left
        count = float(self._twice[self._beyond].sum())
        if count >= LIMITS.count and not self._data.sigma_estimated:
            beyond = float((self._twice * noise)[self._beyond].sum()) / count
            most = max(LIMITS.errors * math.sqrt(2.0 / count), 2.0 * math.log(LIMITS.noise_ratio))
            if beyond <= 0.0 or abs(math.log(beyond)) > most:
                yield (
                    f"beyond the optics' cut-off the image has {max(beyond, 0.0):.2f} of the "
                    "stated noise's power; check noise_sigma, or whether the image is of this scene"
                )
        far = self._unexplained > LIMITS.unexplained
        if ending.most_residual is not None and self._rms > ending.most_residual and far:
            yield (
                f"the residual is {self._rms:.3g} times the noise, limit "
                f"{ending.most_residual:g}; the point spread, the camera's response or the "
                "background differs from the model"
            )
        level = self._level
        width = max(1, round(min(level.shape) / 32))
        inside = level[width:-width, width:-width]
        edge = (level.sum() - inside.sum()) / (level.size - inside.size)
        if self._padded and edge > LIMITS.border * level.mean():
            ratio = edge / level.mean() if level.mean() > 0.0 else math.inf
            yield (
                f"the object is {ratio:.2f} times as bright at the frame's edge as on average, "
                f"limit {LIMITS.border:g}; there is a veil (give background_shape) or light from "
                "outside the frame, or the point spread is wrong"
            )
