"""Total-variation deconvolution of a framed image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive
from ..._progress import Progress
from ...psf import PointSpread
from ..data.arrays import irfft2, rfft2
from ..data.driver import Iterate, Run, Solver, reconstructed, run, solved, stop_rule
from ..data.models import AnyModel, mean_transfer, numpy_model
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction
from ..data.status import Ending
from ._splitting_kernels import RELAXATION, mix, pull
from .field_step import FieldStep
from .photographs import is_kernel, photograph
from .splitting_steps import Steps, gradient

Array = NDArray[Any]

_RULE = (700, 5e-4)  # default number of iterations and tolerance


@dataclass(frozen=True)
class _Tuning:
    """Numbers of the splitting, from sweeps over smooth and speckle kernels, 128^2 and 512^2.

    ``sign`` and ``edge`` are the penalties of x = p and grad x = d, per unit of the object's
    brightness. The data penalty is ``data`` of the multiplier in every tenth of the first hundred
    iterations, then stays: with constant penalties the method of multipliers converges.
    ``residual`` weighs the mismatch of the residual in the stopping criterion. The second fit,
    which serves the status, is ``coarser``.
    """

    sign: float = 5.0
    edge: float = 10.0
    data: float = 0.2
    residual: float = 0.05
    coarser: float = 8.0


_TUNING = _Tuning()


def tv_deconvolve(
    image: Any,
    model: AnyModel | PointSpread | NDArray[Any],
    *,
    tv_weight: float | None = None,
    max_iterations: int = _RULE[0],
    tolerance: float = _RULE[1],
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct the non-negative object of least total variation that fits an image.

    Total variation is the sum of the gradient's magnitude over the pixels. It suppresses noise and
    keeps sharp edges. This is the recommended solver if the point spread function is known.

    Parameters
    ----------
    image : Measurement, ndarray or Tensor
        Camera image, (H, W), with its noise and background. With a point spread alone, also
        (H, W, 3), or a `nlosoptics.imaging.CameraImage`.
    model : ForwardModel, TorchForwardModel, PointSpread or ndarray
        Image model of shape (H, W): the convolution of an object with the known point spread
        function, which may vary over the object. Or the point spread alone, on the pixels of the
        image, centre at ``[ky//2, kx//2]``, in any unit: then the image is a photograph, part of a
        larger view, see Notes.
    tv_weight : float or None
        Weight of the total variation, dimensionless; larger values give a smoother object. None:
        the weight at which the residual equals the noise (discrepancy principle).
    max_iterations : int
        Maximum number of iterations.
    tolerance : float
        Accuracy at which the solver stops, as a fraction of the object's norm. Each iteration
        computes an object that may have small negative values, and one without them, which is the
        result. The solver stops when the change of the result per iteration and its difference from
        the other object are both below this fraction. If ``tv_weight`` is None, the rms residual
        must also differ from its target by less than ``20 tolerance`` times the noise.
    start : array_like, mapping or None
        Initial object, (H, W), in image units, or a saved state of this solver (see `Stop`), from
        which the fit resumes with the same result bit for bit. None: the solver chooses it.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop` to end the fit.

    Returns
    -------
    Reconstruction
        Object, status and score; ``physical_parameters`` also contains ``tv_weight`` and, with the
        automatic weight, ``object_error``, (H, W), the error of each pixel of the object if the
        model is right.

    See Also
    --------
    wiener : Linear filter that weighs the noise.
    richardson_lucy : Multiplicative, non-negative iteration.
    registered_correlation : Correlation with the truth.

    Notes
    -----
    The solver minimises ``sum_i (g A x + b - y)_i^2 / (2 sigma_i^2) + tv_weight TV(g x)/sigma``
    over non-negative objects x on the image's pixels and over the background b. Here y is the
    image, A the image model, g the gain and sigma_i the noise of pixel i. The number sigma is given
    by 1/sigma^2, the mean of 1/sigma_i^2, and TV is the isotropic total variation. The algorithm is
    the alternating direction method of multipliers [1]_. If the PSF varies over the object, each
    step takes a few iterations of conjugate gradients. The automatic weight is adjusted in every
    step [2]_.

    The automatic weight aims at a residual slightly below the noise, because a fit always follows
    some of the noise: the sum of ``(residual/sigma_i)^2`` shall be the number of pixels, minus that
    along the image's outline, or less for faint images. For 128 x 128 pixels the rms residual is
    then 0.984 of the noise.

    With the automatic weight, a second fit serves the status and the estimates of the error: the
    fitted object is imaged by a point spread that is sqrt(2) times as wide, with other noise, and
    fitted again, with 8 times the tolerance. Blur and noise have taken some detail of the truth
    from the first object, and the wider point spread takes a similar amount from this object:
    ``object_error`` is the modulus of the difference.

    Saturated pixels count only where the fitted image is below their level.

    With a point spread alone the fit continues beyond the frame by half the point spread's width,
    where no pixel was measured [3]_, so that light from there does no harm, for any size of image.
    No background is fitted: it is part of the object. If a smooth veil, a polynomial of order 4,
    explains more than 1 % of the total variation of the answer, it is taken from the object into
    ``physical_parameters["veil"]``, of the image's shape, image units. Colours are fitted one by
    one, and the numbers of the answer are those of the colour that fits worst.

    The computation runs on one thread in single precision, or in double precision if the noise is
    below 1e-4 of the image's range. ``objective`` in
    the history is evaluated at the final weight, so it may rise while the weight is adjusted.

    References
    ----------
    .. [1] Almeida and Figueiredo, IEEE Trans. Image Process. 22 (2013) 3074.
    .. [2] Wen and Chan, IEEE Trans. Image Process. 21 (2012) 1770.
    .. [3] Almeida and Figueiredo, IEEE Trans. Image Process. 22 (2013) 3074, section IV.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import ForwardModel
    >>> from nlosoptics.inverse import Measurement, registered_correlation, tv_deconvolve
    >>> truth = np.zeros((24, 24))
    >>> truth[6:18, 10:14] = 1.0
    >>> model = ForwardModel(np.full((3, 3), 1 / 9), shape=truth.shape)
    >>> image = model.forward(truth) + np.random.default_rng(0).normal(0.0, 0.01, truth.shape)
    >>> found = tv_deconvolve(Measurement(image, noise_sigma=0.01), model)
    >>> found.status, registered_correlation(found, truth) > 0.99
    ('converged', True)
    """
    rule = stop_rule(max_iterations, tolerance)
    tv_weight = None if tv_weight is None else positive("tv_weight", tv_weight)

    def fit(data: NoisyImage, model: AnyModel) -> dict[str, Any]:
        return solved(_Splitting(data, model, rule, tv_weight), start, progress)

    if is_kernel(model):
        return photograph(fit, image, model)
    known = cast("AnyModel", model)
    return reconstructed(partial(fit, model=known), image, known, in_numpy=True)


def sharpest(
    data: NoisyImage, model: AnyModel, rule: tuple[int, float] = _RULE, tv_weight: Any = None
) -> tuple[Array, float, float]:
    """Return object, background and weight of `tv_deconvolve`, not judged; 0 if none is seen."""
    data = data.in_numpy()
    if data.is_background(model):
        return 0.0 * data.data, float(data.background_strength(data.data)), 0.0
    answer = solved(_Splitting(data, model, rule, tv_weight), None, None)
    return answer["level"], answer["background"], answer["tv_weight"]


@dataclass(eq=False, kw_only=True)
class _Split(Iterate):
    """State of the splitting: copies of image, gradient and object, their duals and penalties.

    ``free`` and ``seen`` are object and image of the last step for a field of point spreads;
    ``measure`` is compared with the tolerance.
    """

    signed: Array
    predicted: Array
    edges: Array
    data_dual: Array
    sign_dual: Array
    edge_dual: Array
    free: Array | None
    seen: Array | None
    background: float = 0.0
    multiplier: float
    data_penalty: float
    edge_penalty: float
    sign_penalty: float
    measure: float = math.inf


class _Splitting(Solver[_Split]):
    """Alternating direction method of multipliers (ADMM) for total variation.

    Dual variables are scaled by their penalties. Internally the image is divided by its range and
    the kernel by its largest transfer modulus. Total variation has weight 1, and half the squared
    residual has the weight ``multiplier``.
    """

    name, records = "tv_deconvolve", ("variation", "residual", "change")
    report = "total variation: residual {residual:.3f}, change {change:.1e}"

    def __init__(
        self, data: NoisyImage, model: AnyModel, rule: tuple[int, float], tv_weight: float | None
    ) -> None:
        self.data, self._model = data, model
        self.max_iterations, self._tolerance = rule
        self._scale = data.span()
        self._sigma = data.sigma / self._scale
        self._counted = data.counted
        # A background far above the noise would exhaust single precision, so it is subtracted.
        self._level = data.border_strength()
        self._frame = tuple(slice(None, length) for length in model.shape)
        kind = data.working_dtype()
        self._dark = np.zeros(model.grid, kind)
        ones = np.ones(model.shape)
        self._image = ((data.data - data.background(self._level)) / self._scale).astype(kind)
        self._shape = (ones * data.background(1.0)).astype(kind)
        self._weights = data.weighted(ones).astype(kind)
        self._saturated = None
        if data.least is not None:
            least = (data.least - data.background(self._level)) / self._scale
            saturated = np.isfinite(least)
            self._saturated = np.where(saturated)
            self._image = np.where(saturated, least.astype(kind), self._image)
        self._steps = Steps(self._image, self._shape, self._weights, model.grid[1])
        twin = numpy_model(model)
        transfer = mean_transfer(twin)
        self._response = float(abs(transfer).max())
        transfer = transfer / self._response
        self._transfer = transfer.astype(rfft2(self._dark).dtype)
        self._power = (transfer.real**2 + transfer.imag**2).astype(kind)
        self._laplacian = _laplacian(model.grid).astype(kind)
        self._field = None
        if twin.weights is not None:
            self._field = FieldStep(twin.weights, twin.transfer / self._response, self._dark)
        self._given = None if tv_weight is None else self._response / (self._sigma * tv_weight)
        if self._given is None:
            rest = data.whitened(data.without_background()) / data.sigma
            whole = float((rest**2).sum())
            # at least the standard error of the noise
            signal = max(whole - data.counted, math.sqrt(2.0 * rest.size))
            left = max(whole - signal - _taken(signal, model.shape), data.counted / 2)
            self._target = self._sigma * math.sqrt(left)
        self._factored: tuple[tuple[float, ...], tuple[Array, Array, Array]] | None = None

    def init(self, first: Array | None) -> _Split:
        """Return the initial state, from an object or by a mild inverse filter.

        Negative values and values outside the frame are removed. The predicted image starts as the
        image itself. The image of ``first`` would leave nothing to do in the first step, and the
        iteration would appear to have converged.
        """
        predicted = self._dark + 0.0
        predicted[self._frame] = self._image
        if first is None:
            spectrum = self._transfer.conj() * rfft2(predicted)
            spectrum /= self._power + 1e-2
            begun = irfft2(spectrum, predicted.shape[-1])[self._frame]
        else:
            begun = first * (self._response / self._scale)
        signed = self._dark + 0.0
        signed[self._frame] = np.maximum(begun, 0.0)
        framed = signed[self._frame].ravel()
        highest = math.ceil(0.99 * framed.size) - 1
        brightness = float(np.partition(framed, highest)[highest]) or 1.0
        edges = gradient(signed)
        if self._given is None:
            data_penalty = 1.0 / (self._sigma * brightness)
            multiplier = data_penalty / _TUNING.data
        else:
            multiplier = self._given
            data_penalty = _TUNING.data * multiplier
        return _Split(
            signed=signed,
            predicted=predicted,
            edges=edges,
            data_dual=0.0 * self._image,
            sign_dual=self._dark + 0.0,
            edge_dual=0.0 * edges,
            free=None if self._field is None else self._dark + 0.0,
            seen=None if self._field is None else self._dark + 0.0,
            multiplier=multiplier,
            data_penalty=data_penalty,
            edge_penalty=_TUNING.edge / brightness,
            sign_penalty=_TUNING.sign / brightness,
        )

    def resumed(self, state: _Split) -> None:
        """Use a given weight instead of the saved one, which may be that of another fit."""
        if self._given is not None and self._given != state.multiplier:
            state.multiplier, state.measure = self._given, math.inf

    def step(self, state: _Split) -> tuple[float, float, float]:
        """Make one iteration; return total variation, residual and change of the object."""
        steps, wanted, pulled = self._steps, state.predicted.copy(), np.empty_like(self._dark)
        wanted[self._frame] -= state.data_dual
        edges = state.edges, state.edge_dual, state.edge_penalty
        pull(*edges, state.signed, state.sign_dual, state.sign_penalty, pulled)
        free, seen = self._object_step(state, wanted, pulled)
        residual = self._data_step(state, seen)
        variation = steps.shrink_edges(free, state.edges, state.edge_dual, 1 / state.edge_penalty)
        sums = steps.keep_positive(free, state.signed, state.sign_dual)
        size, change, distance = map(math.sqrt, sums)
        change, distance = (length / max(size, 1e-30) for length in (change, distance))
        state.measure = max(change, distance)
        if self._given is None:
            expected = self._target / (self._sigma * math.sqrt(self._counted))
            state.measure = max(state.measure, _TUNING.residual * abs(residual - expected))
        if state.count < 100 and state.count % 10 == 9:
            _adapt(state)
        return variation, residual, change

    def done(self, state: _Split) -> bool:
        """Return whether object, sign and residual have settled."""
        # The first change is due to the data alone and is tiny if the weight is large.
        return state.measure <= self._tolerance and state.count > 1

    def level(self, state: _Split) -> Array:
        """Return the object (H, W) in image units."""
        return state.signed[self._frame].astype(np.float64) * (self._scale / self._response)

    def answer(self, found: Run[_Split], level: Array) -> dict[str, Any]:
        """Return background, dimensionless weight of total variation, and history.

        The objective is computed with the final weight, since in some steps the weight is
        undefined.
        """
        tv_weight = self._response / (self._sigma * max(found.state.multiplier, 1e-30))
        price = tv_weight / (self._response * self._sigma)
        variations, residuals, changes = found.history.values()
        objective = [
            0.5 * self.data.counted * residual**2 + price * variation
            for residual, variation in zip(residuals, variations, strict=True)
        ]
        ending = Ending(
            converged=self.done(found.state),
            history={"objective": objective, "residual": residuals, "change": changes},
        )
        if self._given is None:
            again = partial(self._nearby, found.state)
            ending = replace(ending, to_noise=True, again=again)
        background = self._background(found.state)
        return {"background": background, "tv_weight": tv_weight, "ending": ending}

    def _background(self, state: _Split) -> float:
        return self._level + state.background * self._scale

    def _nearby(self, state: _Split, data: NoisyImage, model: AnyModel) -> tuple[Array, float]:
        """Return object (H, W) and background, image units, of a coarser fit to another image.

        It begins at a state of this fit, whose arrays it changes.
        """
        rule = self.max_iterations, _TUNING.coarser * self._tolerance
        again = _Splitting(data, model, rule, None)
        begun = replace(state, count=0, measure=math.inf)
        if state.free is not None:  # the last step's image is that of this fit's model
            begun.free, begun.seen = self._dark + 0.0, self._dark + 0.0
        found = run(again, begun).state
        return again.level(found), again._background(found)

    def _factors(self, state: _Split) -> tuple[Array, Array, Array]:
        """Return the half spectra of R, of the preconditioner and of the data filter.

        They are computed again only when a penalty has changed.
        """
        penalties = state.data_penalty, state.edge_penalty, state.sign_penalty
        if self._factored is None or self._factored[0] != penalties:
            rest = state.edge_penalty * self._laplacian + state.sign_penalty
            inverse = 1.0 / (state.data_penalty * self._power + rest)
            filtered = state.data_penalty * self._transfer.conj() * inverse
            self._factored = penalties, (rest, inverse, filtered)
        return self._factored[1]

    def _object_step(self, state: _Split, wanted: Array, pulled: Array) -> tuple[Array, Array]:
        """Return the object whose image and gradients best match their targets, and its image.

        The targets are on the FFT grid: the image, and gradients and values, transposed and times
        their penalties.
        """
        rest, inverse, filtered = self._factors(state)
        if self._field is not None and state.free is not None and state.seen is not None:
            state.free, state.seen = self._field.solve(
                wanted, pulled, state.data_penalty, rest, inverse, (state.free, state.seen)
            )
            return state.free, state.seen
        free, seen = rfft2(wanted), rfft2(pulled)
        mix(free, seen, filtered, inverse, self._transfer)
        columns = self._dark.shape[-1]
        return irfft2(free, columns), irfft2(seen, columns)

    def _data_step(self, state: _Split, seen: Array) -> float:
        """Move the predicted image toward the measured one until the residual equals the noise.

        The background and, if searched for, the multiplier are updated too. Returns the rms
        residual before, over the noise.
        """
        steps, predicted, dual = self._steps, state.predicted, state.data_dual
        ratio, level = state.multiplier / state.data_penalty, state.background
        if self._saturated is not None:  # these pixels count only below their least values
            here = self._saturated
            moved = predicted[here] + RELAXATION * (seen[here] - predicted[here]) + dual[here]
            below = moved + level * self._shape[here] < self._image[here]
            self._weights[here] = 1.0 * below
        square, best = steps.relax_image(seen, predicted, dual, level, ratio)
        if self.data.fit_background:
            state.background = best
        if self._given is None:
            self._seek_multiplier(state)
        ratio = state.multiplier / state.data_penalty
        steps.split_misfit(predicted, dual, state.background, ratio)
        return math.sqrt(square / self._counted) / self._sigma

    def _seek_multiplier(self, state: _Split) -> None:
        """Set the multiplier for which the residual after the data step equals the noise, rms.

        Newton's method for 1/norm, which is nearly linear in the multiplier: exactly for uniform
        noise.
        """
        for _ in range(2):
            ratio = state.multiplier / state.data_penalty
            square, slope = self._steps.weigh_misfit(state.predicted, state.background, ratio)
            if slope <= 0.0:
                return
            step = (1.0 / self._target - square**-0.5) * square**1.5 / slope
            state.multiplier = max(state.multiplier + state.data_penalty * step, 0.0)


def _adapt(state: _Split) -> None:
    """Adapt the data penalty to the multiplier, by at most a factor of 3."""
    ratio = _TUNING.data * state.multiplier / state.data_penalty
    ratio = min(max(ratio, 1.0 / 3.0), 3.0)
    state.data_penalty *= ratio
    state.data_dual /= ratio


def _taken(signal: float, shape: tuple[int, int]) -> float:
    """Return how much of the noise, in units of its variance, the fit takes for the object.

    An object of few edges has about as many free values as its frame has pixels along the border.
    They share the energy ``signal``, over the noise's variance, evenly. A Wiener filter then passes
    noise of the square of its gain: nearly 0 in faint light, and 1 in strong light.
    """
    values = 2.0 * sum(shape)
    return values * (signal / (signal + values)) ** 2


def _laplacian(grid: tuple[int, int]) -> Array:
    """Return the transfer function of the negative discrete Laplacian, (rows, columns//2 + 1)."""
    rows = np.arange(grid[0]) * (2.0 * math.pi / grid[0])
    columns = np.arange(grid[1] // 2 + 1) * (2.0 * math.pi / grid[1])
    return np.asarray((2.0 - 2.0 * np.cos(rows))[:, None] + (2.0 - 2.0 * np.cos(columns)))
