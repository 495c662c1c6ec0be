"""Total-variation deconvolution of a framed image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..._checks import positive
from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.driver import Iterate, Run, Solver, reconstructed, solved, stop_rule
from ..data.forward import TorchForwardModel, torch_model
from ..data.measurement import Measurement, norm, total, weighted
from ..data.reconstruction import Reconstruction
from ..data.status import MOST_RESIDUAL, Ending
from .wiener import conjugate_direction

# Factor by which each solve reduces the residual, within _MOST_STEPS steps and single precision. It
# starts from the previous object, which changes little.
_FALL = 0.1
_MOST_STEPS = 6


class FieldStep:
    """Solver of the linear object step for a field of point spreads.

    It minimises ``p |A x - a|^2 + x' R x - 2 x' b`` over objects x, where A is the convolution with
    the field on the whole FFT grid and R is diagonal in Fourier space. Outside the frame, where the
    final object is zero, each weight of the field is replaced by its mean. ``model`` is that of a
    field, float64; its transfer functions are divided by ``response``.
    """

    def __init__(self, model: TorchForwardModel, response: float, dtype: torch.dtype) -> None:
        weights = model.weights
        if weights is None:
            raise ValueError("a model of one point spread needs no field step")
        self._grid = model.grid
        rows, columns = model.shape
        means = weights.mean(dim=(-2, -1), keepdim=True)
        extended = means.expand(-1, *model.grid).clone()
        extended[:, :rows, :columns] = weights
        self._weights = extended.to(dtype)
        complex_dtype = torch.complex64 if dtype == torch.float32 else torch.complex128
        self._transfer = (model.transfer / response).to(complex_dtype)

    def solve(
        self,
        image: Tensor,
        pull: Tensor,
        penalty: float,
        rest: Tensor,
        inverse: Tensor,
        start: tuple[Tensor, Tensor],
    ) -> tuple[Tensor, Tensor]:
        """Return the minimising object and its image, both on the FFT grid, (rows, columns).

        ``image``, ``pull`` and ``penalty`` are a, b and p; ``rest`` and ``inverse``, (rows,
        columns//2 + 1), the half spectra of R and of the preconditioner, which is positive.
        ``start`` is an earlier result.
        """
        free, seen = start[0].clone(), start[1].clone()
        residual = penalty * self._adjoint(image - seen) + pull - self._filtered(free, rest)
        direction, product, goal = torch.zeros_like(free), math.inf, 0.0
        for number in range(_MOST_STEPS):
            step = self._filtered(residual, inverse)
            direction, product = conjugate_direction(residual, step, direction, product)
            goal = goal if number else _FALL**2 * product
            if product <= goal or product == 0.0:
                break
            moved = self._forward(direction)
            turned = penalty * self._adjoint(moved) + self._filtered(direction, rest)
            length = product / total(direction * turned)
            free += length * direction
            seen += length * moved
            residual = residual - length * turned
        return free, seen

    def _forward(self, picture: Tensor) -> Tensor:
        parts = torch.fft.rfft2(self._weights * picture) * self._transfer
        image: Tensor = torch.fft.irfft2(parts.sum(dim=0), s=self._grid)
        return image

    def _adjoint(self, image: Tensor) -> Tensor:
        spectra = torch.fft.rfft2(image) * self._transfer.conj()
        parts: Tensor = torch.fft.irfft2(spectra, s=self._grid) * self._weights
        return parts.sum(dim=0)

    def _filtered(self, picture: Tensor, response: Tensor) -> Tensor:
        filtered: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture) * response, s=self._grid)
        return filtered


# Penalties of the splitting x = p (sign) and grad x = d (edges), per unit of the object's
# brightness, and over-relaxation. From sweeps over smooth and speckle kernels, 128^2 and 512^2.
_SIGN_PENALTY = 5.0
_EDGE_PENALTY = 10.0
_RELAXATION = 1.7
# The data penalty follows the data multiplier for the first iterations, then stays: with
# constant penalties the method of multipliers converges.
_DATA_SHARE = 0.2
_ADAPT_EVERY = 10
_ADAPT_UNTIL = 100
# Weight of the residual mismatch in the stopping criterion.
_RESIDUAL_SHARE = 0.05


@single_thread()
def tv_deconvolve(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    noise_sigma: Any = None,
    tv_weight: float | None = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int = 700,
    tolerance: float = 5e-4,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct the non-negative object of least total variation that fits an image to its noise.

    Parameters
    ----------
    image : ndarray or Tensor
        Image, (H, W), any unit.
    model : ForwardModel or TorchForwardModel
        Image model with the shape (H, W).
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units; None: estimated by
        `estimate_noise`. Infinite for pixels to ignore, such as saturated ones.
    tv_weight : float or None
        Weight of the total variation, dimensionless. None: chosen by the discrepancy principle, so
        that the residual equals the noise.
    background : float or array_like
        Known background, one number or (H, W), image units.
    fit_background : bool
        Whether to fit the strength of an additional background.
    background_shape : array_like or None
        Shape of the additional background, (H, W), non-negative; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object is scaled to a maximum of 1.
    max_iterations : int
        Maximum number of iterations.
    tolerance : float
        Stop when three values are below this: the object's relative change per iteration, the
        relative distance between the object and its non-negative copy, and 0.05 times the
        residual's distance from its target in units of the noise.
    start : array_like, mapping or None
        Initial object, (H, W) in image units, or a saved state, from which the fit resumes
        bit-identically; see `inverse.data.checkpoints`.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.

    Returns
    -------
    Reconstruction
        Object, status and score; ``physical_parameters`` also contains ``tv_weight``.

    Raises
    ------
    SamplingError
        If an array does not fit the model.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    wiener : Linear filter that weighs the noise.
    richardson_lucy : Multiplicative, non-negative iteration.
    deep_image_prior : Untrained network fitted to one image.
    registered_scores : Correlation, PSNR and SSIM with the truth.

    Notes
    -----
    Minimises ``sum (g A x + b - y)^2 / (2 sigma_i^2) + tv_weight TV(g x)/sigma`` over x >= 0 in the
    frame and b, with the reference noise sigma and isotropic TV. The alternating direction method
    of multipliers splits image, gradient and sign, so that one step is diagonal in Fourier space
    and the frame is a mask [1]_. For a field of point spreads this step takes a few conjugate
    gradients, preconditioned by the mean. The weight is adjusted in every data step, in closed form
    for uniform noise [2]_.

    The target of the discrepancy principle allows for noise that the fit absorbs: the expected
    sum of squared residuals, one per pixel, is reduced by the number of pixels along the
    frame's outline (rms 0.984 of the noise at 128 x 128), and by less in faint light, where the
    fit absorbs less. Otherwise weak images would be over-smoothed, and faint ones grainy. The
    computation uses float32 unless the noise is below 1e-4 of the image's range. ``objective``
    is evaluated at the final weight, so it may rise while the weight is being adjusted.

    References
    ----------
    .. [1] Almeida and Figueiredo, IEEE Trans. Image Process. 22 (2013) 3074.
    .. [2] Wen and Chan, IEEE Trans. Image Process. 21 (2012) 1770.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import ForwardModel
    >>> from nlosoptics.inverse import registered_correlation, tv_deconvolve
    >>> truth = np.zeros((24, 24))
    >>> truth[6:18, 10:14] = 1.0
    >>> model = ForwardModel(np.full((3, 3), 1 / 9), shape=truth.shape)
    >>> image = model.forward(truth) + np.random.default_rng(0).normal(0.0, 0.01, truth.shape)
    >>> found = tv_deconvolve(image, model, noise_sigma=0.01)
    >>> found.status, registered_correlation(found, truth) > 0.99
    ('converged', True)
    """
    rule = stop_rule(max_iterations, tolerance)
    tv_weight = None if tv_weight is None else positive("tv_weight", tv_weight)

    def solve(data: Measurement) -> dict[str, Any]:
        return solved(_Splitting(data, model, rule, tv_weight), start, progress)

    known = noise_sigma, background, fit_background, background_shape, gain
    return reconstructed(solve, image, model, *known)


@dataclass(eq=False, kw_only=True)
class _Split(Iterate):
    """State of the splitting: copies of image, gradient and object, their duals and penalties.

    ``free`` and ``seen`` are object and image of the last step for a field of point spreads;
    ``measure`` is compared with the tolerance.
    """

    signed: Tensor
    predicted: Tensor
    edges: Tensor
    data_dual: Tensor
    sign_dual: Tensor
    edge_dual: Tensor
    free: Tensor | None
    seen: Tensor | None
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
        self,
        data: Measurement,
        model: ForwardModel | TorchForwardModel,
        rule: tuple[int, float],
        tv_weight: float | None,
    ) -> None:
        self.data = data
        self.max_iterations, self._tolerance = rule
        self._scale = data.span()
        self._sigma = data.sigma / self._scale
        dtype = data.working_dtype()
        # A background far above the noise would exhaust single precision, so it is subtracted.
        self._level = data.border_strength()
        self._image = ((data.data - data.background(self._level)) / self._scale).to(dtype)
        shape = data.background_shape
        self._shape = torch.ones_like(self._image) if shape is None else shape.to(dtype)
        self._weights = None if data.weights is None else data.weights.to(dtype)
        self._grid = model.grid
        self._frame = tuple(slice(None, length) for length in model.shape)
        twin = torch_model(model, data.data.device, torch.float64)
        transfer = twin.mean_transfer
        self._response = float(transfer.abs().max())
        transfer = transfer / self._response
        self._field = None if twin.weights is None else FieldStep(twin, self._response, dtype)
        self._transfer = transfer.to(dtype.to_complex())
        self._power = (transfer.real**2 + transfer.imag**2).to(dtype)
        self._laplacian = _laplacian(self._grid, data.data.device).to(dtype)
        self._given = None if tv_weight is None else self._response / (self._sigma * tv_weight)
        self._target = self._sigma * math.sqrt(max(data.counted - _taken(data), data.counted / 2))
        self._factored: tuple[tuple[float, ...], tuple[Tensor, Tensor, Tensor]] | None = None

    def init(self, first: Tensor | None) -> _Split:
        """Return the initial state, from an object or by a mild inverse filter.

        Negative values and values outside the frame are removed. The predicted image starts as the
        image itself. The image of ``first`` would leave nothing to do in the first step, and the
        iteration would appear to have converged.
        """
        predicted = torch.zeros(self._grid, dtype=self._image.dtype, device=self._image.device)
        predicted[self._frame] = self._image
        spectrum = self._transfer.conj() * torch.fft.rfft2(predicted)
        spectrum /= self._power + 1e-2
        begun = torch.fft.irfft2(spectrum, s=self._grid)
        if first is not None:
            begun = torch.zeros_like(predicted)
            begun[self._frame] = (first * (self._response / self._scale)).to(begun.dtype)
        signed = self._allowed(begun)
        framed = signed[self._frame].flatten()
        brightness = float(framed.kthvalue(math.ceil(0.99 * framed.numel())).values)
        brightness = brightness if brightness > 0.0 else 1.0
        edges = _gradient(signed)
        if self._given is None:
            data_penalty = 1.0 / (self._sigma * brightness)
            multiplier = data_penalty / _DATA_SHARE
        else:
            multiplier = self._given
            data_penalty = _DATA_SHARE * multiplier
        return _Split(
            signed=signed,
            predicted=predicted,
            edges=edges,
            data_dual=torch.zeros_like(self._image),
            sign_dual=torch.zeros_like(signed),
            edge_dual=torch.zeros_like(edges),
            free=None if self._field is None else torch.zeros_like(signed),
            seen=None if self._field is None else torch.zeros_like(signed),
            multiplier=multiplier,
            data_penalty=data_penalty,
            edge_penalty=_EDGE_PENALTY / brightness,
            sign_penalty=_SIGN_PENALTY / brightness,
        )

    def resumed(self, state: _Split) -> None:
        """Use a given weight instead of the saved one, which may be that of another fit."""
        if self._given is not None and self._given != state.multiplier:
            state.multiplier, state.measure = self._given, math.inf

    def step(self, state: _Split) -> tuple[float, float, float]:
        """Make one iteration; return total variation, residual and change of the object."""
        wanted = state.predicted.clone()
        wanted[self._frame] -= state.data_dual
        pull = _transposed_gradient(state.edges - state.edge_dual) * state.edge_penalty
        pull += state.sign_penalty * (state.signed - state.sign_dual)
        free, predicted = self._object_step(state, wanted, pull)
        residual = self._data_step(state, predicted)
        variation = _edge_step(state, _gradient(free))
        change, distance = self._sign_step(state, free)
        state.measure = max(change, distance)
        if self._given is None:
            expected = self._target / (self._sigma * math.sqrt(self.data.counted))
            state.measure = max(state.measure, _RESIDUAL_SHARE * abs(residual - expected))
        if state.count < _ADAPT_UNTIL and state.count % _ADAPT_EVERY == _ADAPT_EVERY - 1:
            _adapt(state)
        return variation, residual, change

    def done(self, state: _Split) -> bool:
        """Return whether object, sign and residual have settled."""
        # The first change is due to the data alone and is tiny if the weight is large.
        return state.measure <= self._tolerance and state.count > 1

    def level(self, state: _Split) -> Tensor:
        """Return the object (H, W) in image units."""
        return state.signed[self._frame].double() * (self._scale / self._response)

    def answer(self, found: Run[_Split], level: Tensor) -> dict[str, Any]:
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
            most_residual=MOST_RESIDUAL if self._given is None else None,
            sharp=self._given is None,
        )
        background = self._level + found.state.background * self._scale
        return {"background": background, "tv_weight": tv_weight, "ending": ending}

    def _factors(self, state: _Split) -> tuple[Tensor, Tensor, Tensor]:
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

    def _object_step(self, state: _Split, wanted: Tensor, pull: Tensor) -> tuple[Tensor, Tensor]:
        """Return the object whose image and gradients best match their targets, and its image.

        ``wanted`` is the target image and ``pull`` the target gradients and values, transposed and
        times their penalties, on the FFT grid.
        """
        rest, inverse, filtered = self._factors(state)
        if self._field is not None and state.free is not None and state.seen is not None:
            state.free, state.seen = self._field.solve(
                wanted, pull, state.data_penalty, rest, inverse, (state.free, state.seen)
            )
            return state.free, state.seen
        spectrum = torch.fft.rfft2(wanted) * filtered
        spectrum += torch.fft.rfft2(pull) * inverse
        free = torch.fft.irfft2(spectrum, s=self._grid)
        return free, torch.fft.irfft2(spectrum * self._transfer, s=self._grid)

    def _data_step(self, state: _Split, predicted: Tensor) -> float:
        """Move the predicted image toward the measured one until the residual equals the noise.

        The background and, if searched for, the multiplier are updated too. Returns the rms
        residual before, over the noise.
        """
        residual = predicted[self._frame] - self._image + state.background * self._shape
        squared = total(weighted(residual * residual, self._weights))
        relaxed = _relaxed(predicted, state.predicted)
        relaxed[self._frame] += state.data_dual
        misfit = relaxed[self._frame] - self._image
        if self.data.fit_background:
            state.background = -self._strength(misfit, self._shrinkage(state))
            misfit += state.background * self._shape
        if self._given is None:
            self._seek_multiplier(state, misfit)
        state.data_dual = misfit - misfit * self._shrinkage(state)
        relaxed[self._frame] -= state.data_dual
        state.predicted = relaxed
        return math.sqrt(squared / self.data.counted) / self._sigma

    def _shrinkage(self, state: _Split) -> Tensor | float:
        """Return the factor, 0 to 1, by which the data step reduces a misfit."""
        multiplier = state.multiplier if self._weights is None else state.multiplier * self._weights
        return state.data_penalty / (state.data_penalty + multiplier)

    def _strength(self, misfit: Tensor, shrinkage: Tensor | float) -> float:
        """Return the background strength that best fits a misfit (H, W).

        Pixels are weighted as in the data step.
        """
        weights = self._shape
        if self._weights is not None:
            weights = self._weights * shrinkage * self._shape
        return total(weights * misfit) / total(weights * self._shape)

    def _seek_multiplier(self, state: _Split, misfit: Tensor) -> None:
        """Set the multiplier for which the residual after the data step equals the noise, rms."""
        target = self._target
        if self._weights is None:
            state.multiplier = state.data_penalty * max(norm(misfit) / target - 1.0, 0.0)
            return
        squares = self._weights * misfit * misfit
        # Newton's method for 1/norm, which is nearly linear in the multiplier (exactly for uniform
        # noise).
        for _ in range(2):
            kept = self._shrinkage(state)
            square = total(squares * kept**2)
            slope = total(squares * self._weights * kept**3) / state.data_penalty
            if slope <= 0.0:
                return
            step = (1.0 / target - square**-0.5) * square**1.5 / slope
            state.multiplier = max(state.multiplier + step, 0.0)

    def _sign_step(self, state: _Split, free: Tensor) -> tuple[float, float]:
        """Update the non-negative object.

        Returns its change and its distance from the unconstrained object ``free``, both relative to
        its norm.
        """
        relaxed = _relaxed(free, state.signed) + state.sign_dual
        before, state.signed = state.signed, self._allowed(relaxed)
        state.sign_dual = relaxed - state.signed
        size = max(norm(state.signed), 1e-30)
        return norm(state.signed - before) / size, norm(free - state.signed) / size

    def _allowed(self, picture: Tensor) -> Tensor:
        allowed = torch.zeros_like(picture)
        allowed[self._frame] = picture[self._frame].clamp_min(0.0)
        return allowed


def _edge_step(state: _Split, gradient: Tensor) -> float:
    """Shrink the gradients (soft threshold); return their total variation."""
    relaxed = _relaxed(gradient, state.edges) + state.edge_dual
    # vector_norm over the first axis is ten times slower on a processor.
    length = torch.addcmul(relaxed[0].square(), relaxed[1], relaxed[1]).sqrt_()
    left = (length - 1.0 / state.edge_penalty).clamp_min_(0.0)
    state.edges = relaxed * (left / length.clamp_min_(torch.finfo(length.dtype).tiny))
    state.edge_dual = relaxed - state.edges
    return total(left)


def _adapt(state: _Split) -> None:
    """Adapt the data penalty to the multiplier, by at most a factor of 3."""
    ratio = _DATA_SHARE * state.multiplier / state.data_penalty
    ratio = min(max(ratio, 1.0 / 3.0), 3.0)
    state.data_penalty *= ratio
    state.data_dual /= ratio


def _taken(data: Measurement) -> float:
    """Return how many values of the image the fit takes from the object, not from the noise.

    An object of few edges has about as many free values as its frame has pixels along the border.
    If they share the image's energy evenly, each is taken with the gain of the Wiener filter:
    nearly 0 in faint light, and 1 in strong light.
    """
    rest = data.data - data.background(data.background_strength(data.data))
    energy = max(total(data.weighted(rest * rest)) / data.sigma**2 - data.counted, 0.0)
    values = 2.0 * sum(data.data.shape)
    return values * energy / (energy + values)


def _relaxed(new: Tensor, old: Tensor) -> Tensor:
    return torch.lerp(old, new, _RELAXATION)


def _gradient(picture: Tensor) -> Tensor:
    """Return periodic forward differences along y and x, (2, H, W)."""
    return torch.stack((picture.roll(-1, 0) - picture, picture.roll(-1, 1) - picture))


def _transposed_gradient(field: Tensor) -> Tensor:
    return field[0].roll(1, 0) - field[0] + field[1].roll(1, 1) - field[1]


def _laplacian(grid: tuple[int, int], device: torch.device) -> Tensor:
    """Return the transfer function of the negative discrete Laplacian, (rows, columns//2 + 1)."""
    rows = torch.arange(grid[0], dtype=torch.float64, device=device) * (2.0 * math.pi / grid[0])
    columns = torch.arange(grid[1] // 2 + 1, dtype=torch.float64, device=device)
    columns *= 2.0 * math.pi / grid[1]
    return (2.0 - 2.0 * torch.cos(rows))[:, None] + (2.0 - 2.0 * torch.cos(columns))
