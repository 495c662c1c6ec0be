"""Status of a reconstruction with a known point spread, from tests that follow from the model.

Three questions are asked: does the model fit the image, is there an object, did the solver settle.
A fit of object and wall asks a fourth, whether another answer fits as well (`blind.verdict`). What
lies beyond is a number, the expected correlation with the truth, and holds if the model is right.
Some errors leave no trace in one image: a camera that is not linear changes the object's grey
values, and another object can have the same image by a wrong point spread.
`benchmarks/inverse/mismatches.py` counts how often.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...imaging.forward_model import ForwardModel
from .models import (
    beyond_optics,
    expected_signal,
    half_weights,
    object_power,
    passed_power,
    periodic_power,
    power,
    widened,
)
from .noisy_image import NoisyImage

Array = NDArray[np.float64]

#: How a solver ended and whether its answer holds; see `inverse.Reconstruction`.
Status = Literal["converged", "does_not_fit", "too_few_photons", "ambiguous", "unconverged"]


@dataclass(frozen=True)
class Limits:
    """Limits of the tests, and what each follows from.

    ``residual``: largest rms residual over the noise of a fit that is brought to the noise. The
    noise of 64 x 64 pixels is known to 2 % (one standard error of 500 frequencies is 3 %).
    ``unexplained``: power of the residual beyond the noise, over that of the image's detail, up to
    which a larger residual is harmless: no point spread is known better than to 3 % rms.
    ``errors``: standard errors by which light beyond the optics' cut-off must exceed noise; noise
    alone does in one image of 10^9. ``edge``: largest brightness of the object at the frame's edge
    minus that beside it or half the mean, over the mean; a padded model assumes darkness beyond, so
    that light from there gathers at the edge. ``negative``: largest share of the object's power in
    negative pixels, apart from noise; overshoots at the edges of a band-limited object have 1 to 2
    %. ``drift``, ``change``: a fit that used all its iterations has settled if the residual changed
    by less than this fraction over the last fifth of them, and if the median of the object's
    changes there was smaller than ``change``, the default tolerance of `tv_deconvolve`.
    ``correlation``: least expected correlation; at 0.87 a quarter of the object's variance is lost.
    ``spread``: two thirds of the answers have one minus the correlation within this factor of the
    expected value.
    """

    residual: float = 1.05
    unexplained: float = 1e-3
    errors: float = 6.0
    edge: float = 0.1
    negative: float = 0.03
    drift: float = 0.02
    change: float = 5e-4
    correlation: float = 0.87
    spread: float = 1.8


LIMITS = Limits()


@dataclass(frozen=True, eq=False, kw_only=True)
class Ending:
    """End of a solver's iterations, as `judged` needs it.

    ``converged``: whether it met its own tolerance. ``history``: records of the iterations:
    ``residual`` (over the noise) and ``change`` (relative). ``to_noise``: whether the solver brings
    the residual to the noise; if not, because it is a filter or the caller chose the weight,
    residuals are not tested. ``again``: for a solver that does so by its weight of edges: function
    of a `NoisyImage` and an image model that returns the object (H, W), image units, of the same
    fit to that image.
    """

    converged: bool
    history: Mapping[str, Sequence[float]]
    to_noise: bool = False
    again: Callable[[NoisyImage, ForwardModel], Array] | None = None

    def steady(self) -> bool:
        """Return whether the solver has converged, or the residual no longer changes."""
        last = self._last("residual")
        return self.converged or abs(last[0] - last[-1]) <= LIMITS.drift * last[-1]

    def settled(self) -> bool:
        """Return whether more iterations would hardly change the object, see `Limits`."""
        return self.converged or (
            self.steady() and float(np.median(self._last("change"))) <= LIMITS.change
        )

    def _last(self, name: str) -> Sequence[float]:
        values = self.history[name]
        return values[-max(20, len(values) // 5) :] or (math.inf, 0.0)


class Judgement(NamedTuple):
    """Status of a fit, the reasons against "converged", and the expected quality of its object.

    ``expected_correlation`` and ``error`` (H, W), image units, hold if the model is right, and are
    None if it is not or the fit has not ended; the latter also without a second fit.
    """

    status: Status
    reasons: tuple[str, ...]
    expected_correlation: float | None = None
    error: Array | None = None


def judged(
    data: NoisyImage, level: Array, strength: float, model: ForwardModel, ending: Ending
) -> Judgement:
    """Return the status of a fit with a known point spread, and the reasons against "converged".

    ``data``: image and noise. ``level`` (H, W): fitted object times gain, image units.
    ``strength``: fitted strength of the unknown background, image units. ``model``: image model, of
    which only the mean point spread is used in the tests of spectra. ``ending``: how the solver
    ended.

    The model does not fit if

    - the residual of a fit that is brought to the noise exceeds it, by more than 0.1 % of the power
      of the image's detail;
    - the residual has the spectrum of light, not of noise, beyond the optics' cut-off;
    - the object is brighter at the edge of a padded frame than beside it: the model assumes
      darkness outside, and light from there gathers at the edge;
    - more of the object's power is negative than noise makes negative.

    With a blur below a pixel, any image fits: it is the object. The expected correlation follows
    from that of a typical object, of spectrum 1/f^2, with its Wiener estimate, and from a second
    fit, to the image of the object by a wider point spread with other noise: the wider one takes
    about as much from the object as blur and noise have taken from it already.
    """
    if not level.any():
        reason = "the fit explains the image without an object; expose longer"
        return Judgement("too_few_photons", (reason,))
    shape, variance, passed = level.shape, data.sigma**2, passed_power(model)
    twice, typical = half_weights(shape), object_power(shape)
    signal = expected_signal(periodic_power(data.without_background()), passed, variance, shape)
    weights, gain = twice * typical, signal / (signal + variance)
    # a single pixel has no detail
    share = math.sqrt((weights * gain).sum() / weights.sum()) if weights.any() else 1.0
    light = model.forward(level) + data.background(strength)
    count = max(float(twice.sum()), 1.0)
    blurred = float((twice * passed).sum()) / count < 0.25 * float(passed[0, 0])  # > four pixels
    if ending.steady() and blurred:
        residual = data.whitened((data.data - light) / data.sigma)
        beyond = twice * beyond_optics(signal, variance)
        detail = float((twice * signal).sum()) / (variance * level.size)
        spectrum = power(residual)
        # below 0.1 % of the image's amplitude, light beyond the cut-off is that of the pixels
        seen = float((beyond * spectrum).sum()) > 1e-6 * detail * level.size
        errors = _structure(spectrum, beyond, np.sqrt(typical)) if seen else 0.0
        faults = (
            *_residual_faults(data.score(light), detail, ending),
            *_light_faults(errors),
            *_object_faults(level, model.boundary == "padded", 0.5 * (1.0 - share**2)),
        )
        if faults:
            return Judgement("does_not_fit", faults)
    if not ending.settled():
        reason = (
            f"the residual is {data.score(light):.3g} times the noise after "
            f"{len(ending.history['residual'])} iterations, and object or residual still change; "
            "give more iterations"
        )
        return Judgement("unconverged", (reason,))
    unlike, error = 1.0 - share, None
    if ending.again is not None:
        wider = widened(model)
        again = ending.again(repetition(data, level, strength, wider), wider)
        unlike, error = 1.0 - _correlation(level, again), np.abs(again - level)
    # both tell what blur and noise take from an object; saturated pixels double it
    lack = 0.88 * (unlike * (1.0 - share)) ** (2.0 / 3.0)
    expected = 1.0 - min(lack if data.least is None else 2.0 * lack, 1.0)
    if expected < LIMITS.correlation:
        reason = (
            f"the noise hides most of the object: expected correlation {expected:.2f} with the "
            f"truth, least {LIMITS.correlation:.2f}; expose longer"
        )
        return Judgement("too_few_photons", (reason,), expected, error)
    return Judgement("converged", (), expected, error)


def repetition(data: NoisyImage, level: Array, strength: float, model: ForwardModel) -> NoisyImage:
    """Return a model's image of an object with other noise of the same strength."""
    noise = np.random.default_rng(20).normal(size=level.shape) * data.sigma
    root = np.sqrt(data.weights)
    noise = np.divide(noise, root, out=np.zeros_like(noise), where=root > 0.0)
    image = model.forward(level) + data.background(strength)
    least = data.least
    if least is not None:  # the camera would saturate there in this image too, or not at all
        least = np.minimum(least, image)
    return replace(data, data=image + noise, least=least)


def _correlation(level: Array, again: Array) -> float:
    first, second = level - level.mean(), again - again.mean()
    norm = math.sqrt(float((first**2).sum() * (second**2).sum()))
    return min(float((first * second).sum()) / max(norm, 1e-300), 1.0)


def _structure(spectrum: Array, counts: Array, weights: Array) -> float:
    """Return by how many standard errors a half spectrum follows ``weights``, and is not white.

    ``counts`` (H, W//2 + 1): how often each frequency counts.
    """
    count, whole = float(counts.sum()), float((counts * spectrum).sum())
    if whole == 0.0:
        return 0.0
    weights = weights - float((counts * weights).sum()) / count
    error = math.sqrt(2.0 * float((counts * weights**2).sum()))
    return float((counts * weights * spectrum).sum()) * count / whole / max(error, 1e-300)


def _residual_faults(rms: float, detail: float, ending: Ending) -> Iterator[str]:
    unexplained = (rms**2 - 1.0) / max(detail, 1e-3)
    if ending.to_noise and rms > LIMITS.residual and unexplained > LIMITS.unexplained:
        yield (
            f"the residual is {rms:.3g} times the noise, limit {LIMITS.residual:g}; the point "
            "spread, the camera's response or the background differs from the model"
        )


def _light_faults(errors: float) -> Iterator[str]:
    if errors > LIMITS.errors:
        yield (
            f"beyond the optics' cut-off the image has light, {errors:.3g} standard errors above "
            f"white noise, limit {LIMITS.errors:g}; its noise is correlated, as compression makes "
            "it, the camera's response differs from the model, or the image is of another scene"
        )


def _object_faults(level: Array, padded: bool, noise: float) -> Iterator[str]:
    """Yield what is wrong with an object; ``noise`` is the share of its power that is noise."""
    width = max(1, round(min(level.shape) / 32))
    sums, sizes = [], []
    for rim in (0, width, 3 * width):
        inside = level[rim : len(level) - rim, rim : level.shape[1] - rim]
        sums.append(float(inside.sum()))
        sizes.append(inside.size)
    edge, beside = ((sums[i] - sums[i + 1]) / max(sizes[i] - sizes[i + 1], 1) for i in (0, 1))
    mean = max(sums[0], 1e-300) / level.size
    excess = edge / mean - max(beside / mean, 0.5)  # less is spurious light of speckle
    if padded and excess > LIMITS.edge:
        yield (
            f"the object is brighter at the frame's edge than beside it, by {excess:.2g} of its "
            f"mean, limit {LIMITS.edge:g}; there is a veil (give background_shape) or light from "
            "outside the frame, or the point spread is wrong"
        )
    negative = float((np.minimum(level, 0.0) ** 2).sum() / (level**2).sum())
    if negative > LIMITS.negative + noise:
        yield (
            f"{100 * negative:.2g} % of the object's power is negative, limit "
            f"{100 * (LIMITS.negative + noise):.2g} % with this noise; the point spread is wrong"
        )
