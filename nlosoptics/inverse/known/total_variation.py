"""Total-variation deconvolution of a framed image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..._checks import positive
from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ...psf import PointSpread
from ..data.driver import History, Solver, run, solved, started_from, stop_rule
from ..data.models import mean_transfer
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction
from ..data.status import Ending
from . import _splitting_kernels as kernels
from .field_step import FieldStep
from .photographs import fitted

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
    model: ForwardModel | PointSpread | NDArray[Any],
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
    model : ForwardModel, PointSpread or ndarray
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
        Initial object, (H, W), in image units, or a saved state (see `Stop`), whose object is
        taken. None: the solver chooses it.
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

    def fit(data: NoisyImage, model: ForwardModel) -> dict[str, Any]:
        return solved(_Splitting(data, model, rule, tv_weight, start), progress)

    return fitted(fit, image, model)


def sharpest(
    data: NoisyImage, model: ForwardModel, rule: tuple[int, float] = _RULE
) -> tuple[Array, float, float]:
    """Return object, background and weight of `tv_deconvolve`, not judged; 0 if none is seen."""
    if data.is_background(model):
        return 0.0 * data.data, float(data.background_strength(data.data)), 0.0
    answer = solved(_Splitting(data, model, rule, None), None)
    return answer["level"], answer["background"], answer["tv_weight"]


class _Splitting(Solver):
    """Alternating direction method of multipliers (ADMM) for total variation.

    Dual variables are scaled by their penalties. Internally the image is divided by its range and
    the kernel by its largest transfer modulus. Total variation has weight 1, and half the squared
    residual has the weight ``multiplier``. The state consists of copies of image, gradient and
    object, with their duals and penalties; `FieldStep` starts from ``last``, object and image of
    its last step; ``measure`` is compared with the tolerance.
    """

    records = ("variation", "residual", "change")
    changing: tuple[str, ...] = (
        *("signed", "predicted", "edges", "data_dual", "sign_dual", "edge_dual", "background"),
        *("multiplier", "data_penalty", "edge_penalty", "sign_penalty"),
    )  # attributes that a second fit takes on
    report = "total variation: residual {residual:.3f}, change {change:.1e}"

    def __init__(
        self,
        data: NoisyImage,
        model: ForwardModel,
        rule: tuple[int, float],
        tv_weight: float | None,
        start: Any = None,
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
        self._image = ((data.data - data.background(self._level)) / self._scale).astype(kind)
        self._shape = data.background_shape.astype(kind)
        self._weights = data.weights.astype(kind)
        self._saturated = None
        if data.least is not None:
            least = (data.least - data.background(self._level)) / self._scale
            saturated = np.isfinite(least)
            self._saturated = np.where(saturated)
            self._image = np.where(saturated, least.astype(kind), self._image)
        self._measured = self._image, self._shape, self._weights
        self._sums = np.empty((3, model.grid[1]))
        transfer = mean_transfer(model)
        self._response = float(abs(transfer).max())
        transfer = transfer / self._response
        self._transfer = transfer.astype(fft.rfft2(self._dark).dtype)
        self._power = (transfer.real**2 + transfer.imag**2).astype(kind)
        self._laplacian = _laplacian(model.grid).astype(kind)
        self._field = None
        if model.weights is not None:
            self._field = FieldStep(model.weights, model.transfer / self._response, self._dark)
        self._given = None if tv_weight is None else self._response / (self._sigma * tv_weight)
        if self._given is None:
            rest = data.whitened(data.without_background()) / data.sigma
            whole = float((rest**2).sum())
            # at least the standard error of the noise
            signal = max(whole - data.counted, math.sqrt(2.0 * rest.size))
            left = max(whole - signal - _taken(signal, model.shape), data.counted / 2)
            self._target = self._sigma * math.sqrt(left)
        self._factored: tuple[tuple[float, ...], tuple[Array, Array, Array]] | None = None
        self._begin(None if start is None else started_from(start, model.shape))

    def _begin(self, first: Array | None) -> None:
        """Set the initial state, from an object or by a mild inverse filter.

        Negative values and values outside the frame are removed. The predicted image starts as the
        image itself. The image of ``first`` would leave nothing to do in the first step, and the
        iteration would appear to have converged.
        """
        self.predicted = self._dark + 0.0
        self.predicted[self._frame] = self._image
        if first is None:
            spectrum = self._transfer.conj() * fft.rfft2(self.predicted)
            spectrum /= self._power + 1e-2
            begun = fft.irfft2(spectrum, self._dark.shape)[self._frame]
        else:
            begun = first * (self._response / self._scale)
        self.signed = self._dark + 0.0
        self.signed[self._frame] = np.maximum(begun, 0.0)
        framed = self.signed[self._frame].ravel()
        highest = math.ceil(0.99 * framed.size) - 1
        brightness = float(np.partition(framed, highest)[highest]) or 1.0
        if self._given is None:
            self.data_penalty = 1.0 / (self._sigma * brightness)
            self.multiplier = self.data_penalty / _TUNING.data
        else:
            self.multiplier = self._given
            self.data_penalty = _TUNING.data * self.multiplier
        self.edges = np.stack([np.roll(self.signed, -1, axis) - self.signed for axis in (0, 1)])
        self.data_dual, self.sign_dual = 0.0 * self._image, self._dark + 0.0
        self.edge_dual = 0.0 * self.edges
        self.edge_penalty, self.sign_penalty = _TUNING.edge / brightness, _TUNING.sign / brightness
        self.last = self._dark, self._dark
        self.background, self.measure = 0.0, math.inf

    def step(self) -> tuple[float, float, float]:
        """Make one iteration; return total variation, residual and change of the object."""
        wanted, pulled = self.predicted.copy(), np.empty_like(self._dark)
        wanted[self._frame] -= self.data_dual
        edges = self.edges, self.edge_dual, self.edge_penalty
        kernels.pull(*edges, self.signed, self.sign_dual, self.sign_penalty, pulled)
        free, seen = self._object_step(wanted, pulled)
        residual = self._data_step(seen)
        variation, *_ = self._summed(
            kernels.shrink_edges, free, self.edges, self.edge_dual, 1 / self.edge_penalty
        )
        sums = self._summed(
            kernels.keep_positive, free, self.signed, self.sign_dual, *self._image.shape
        )
        size, change, distance = map(math.sqrt, sums)
        change, distance = (length / max(size, 1e-30) for length in (change, distance))
        self.measure = max(change, distance)
        if self._given is None:
            expected = self._target / (self._sigma * math.sqrt(self._counted))
            self.measure = max(self.measure, _TUNING.residual * abs(residual - expected))
        if self.count < 100 and self.count % 10 == 9:
            # adapt the data penalty to the multiplier, by at most a factor of 3
            ratio = _TUNING.data * self.multiplier / self.data_penalty
            ratio = min(max(ratio, 1.0 / 3.0), 3.0)
            self.data_penalty *= ratio
            self.data_dual /= ratio
        return variation, residual, change

    def done(self) -> bool:
        """Return whether object, sign and residual have settled."""
        # The first change is due to the data alone and is tiny if the weight is large.
        return self.measure <= self._tolerance and self.count > 1

    def level(self) -> Array:
        """Return the object (H, W) in image units."""
        return self.signed[self._frame].astype(np.float64) * (self._scale / self._response)

    def answer(self, level: Array, history: History) -> dict[str, Any]:
        """Return background, dimensionless weight of total variation, and history.

        The objective is computed with the final weight, since in some steps the weight is
        undefined.
        """
        tv_weight = self._response / (self._sigma * max(self.multiplier, 1e-30))
        price = tv_weight / (self._response * self._sigma)
        variations, residuals, changes = history.values()
        objective = [
            0.5 * self.data.counted * residual**2 + price * variation
            for residual, variation in zip(residuals, variations, strict=True)
        ]
        ending = Ending(
            converged=self.done(),
            history={"objective": objective, "residual": residuals, "change": changes},
        )
        if self._given is None:
            ending = replace(ending, to_noise=True, again=self._nearby)
        background = self._level + self.background * self._scale
        return {"background": background, "tv_weight": tv_weight, "ending": ending}

    def _nearby(self, data: NoisyImage, model: ForwardModel) -> Array:
        """Return the object (H, W), image units, of a coarser fit to another image.

        It begins at the state of this fit, whose arrays it changes.
        """
        if data.is_background(model):  # the wider point spread has taken all detail
            return 0.0 * data.data
        rule = self.max_iterations, _TUNING.coarser * self._tolerance
        again = _Splitting(data, model, rule, None)
        for name in self.changing:
            setattr(again, name, getattr(self, name))
        run(again)
        return again.level()

    def _factors(self) -> tuple[Array, Array, Array]:
        """Return the half spectra of R, of the preconditioner and of the data filter.

        They are computed again only when a penalty has changed.
        """
        penalties = self.data_penalty, self.edge_penalty, self.sign_penalty
        if self._factored is None or self._factored[0] != penalties:
            rest = self.edge_penalty * self._laplacian + self.sign_penalty
            inverse = 1.0 / (self.data_penalty * self._power + rest)
            filtered = self.data_penalty * self._transfer.conj() * inverse
            self._factored = penalties, (rest, inverse, filtered)
        return self._factored[1]

    def _object_step(self, wanted: Array, pulled: Array) -> tuple[Array, Array]:
        """Return the object whose image and gradients best match their targets, and its image.

        The targets are on the FFT grid: the image, and gradients and values, transposed and times
        their penalties.
        """
        rest, inverse, filtered = self._factors()
        if self._field is not None:
            self.last = self._field.solve(
                wanted, pulled, self.data_penalty, rest, inverse, self.last
            )
            return self.last
        free, seen = fft.rfft2(wanted), fft.rfft2(pulled)
        kernels.mix(free, seen, filtered, inverse, self._transfer)
        return fft.irfft2(free, self._dark.shape), fft.irfft2(seen, self._dark.shape)

    def _data_step(self, seen: Array) -> float:
        """Move the predicted image toward the measured one until the residual equals the noise.

        The background and, if searched for, the multiplier are updated too. Returns the rms
        residual before, over the noise.
        """
        predicted, dual = self.predicted, self.data_dual
        ratio, level = self.multiplier / self.data_penalty, self.background
        if self._saturated is not None:  # these pixels count only below their least values
            here = self._saturated
            moved = (
                predicted[here] + kernels.RELAXATION * (seen[here] - predicted[here]) + dual[here]
            )
            below = moved + level * self._shape[here] < self._image[here]
            self._weights[here] = 1.0 * below
        square, product, norm = self._summed(
            kernels.relax_image, seen, predicted, dual, *self._measured, level, ratio
        )
        if self.data.fit_background:
            self.background = product / (norm or 1.0)  # a veil can be dark in all pixels that count
        if self._given is None:
            self._seek_multiplier()
        ratio = self.multiplier / self.data_penalty
        kernels.split_misfit(predicted, dual, *self._measured, self.background, ratio)
        return math.sqrt(square / self._counted) / self._sigma

    def _summed(self, kernel: Any, *arguments: Any) -> list[float]:
        """Call a kernel; return the sums of what it adds up for each column."""
        self._sums[...] = 0.0
        kernel(*arguments, self._sums)
        sums: list[float] = self._sums.sum(axis=1).tolist()
        return sums

    def _seek_multiplier(self) -> None:
        """Set the multiplier for which the residual after the data step equals the noise, rms.

        Newton's method for 1/norm, which is nearly linear in the multiplier: exactly for uniform
        noise.
        """
        for _ in range(2):
            ratio = self.multiplier / self.data_penalty
            square, slope, _ = self._summed(
                kernels.weigh_misfit, self.predicted, *self._measured, self.background, ratio
            )
            if slope <= 0.0:
                return
            step = (1.0 / self._target - square**-0.5) * square**1.5 / slope
            self.multiplier = max(self.multiplier + self.data_penalty * step, 0.0)


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
