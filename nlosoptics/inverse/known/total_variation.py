"""Total-variation deconvolution of a framed image."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ..._checks import counted, in_range, positive, whole
from ..._progress import Progress
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.checkpoints import State, goes_on, kept_numbers, started_from, state_of
from ..data.forward import TorchForwardModel, model_shape, torch_model
from ..data.measurement import Measurement, measurement, real_array, total
from ..data.reconstruction import Reconstruction, concluded, without_object
from ..data.status import MOST_RESIDUAL, Ending

# Factor by which each solve reduces the residual, within _MOST_STEPS steps and single precision. It
# starts from the previous object, which changes little.
_FALL = 0.1
_MOST_STEPS = 6


class FieldStep:
    """Solver of the linear object step for a field of point spreads.

    It minimises ``p |A x - a|^2 + x' R x - 2 x' b`` over objects x, where A is the convolution with
    the field on the whole FFT grid and R is diagonal in Fourier space. Outside the frame, where the
    final object is zero, each weight of the field is replaced by its mean. Each solution is the
    start of the next one.

    Parameters
    ----------
    model : TorchForwardModel
        Model of a field, float64.
    response : float
        Factor by which the transfer functions are divided.
    dtype : torch.dtype
        Real type of the computation.
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
        self._free = torch.zeros(model.grid, dtype=dtype, device=weights.device)
        self._image = torch.zeros_like(self._free)

    def solve(
        self, image: Tensor, pull: Tensor, penalty: float, rest: Tensor, inverse: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the minimising object and its image, both on the FFT grid.

        Parameters
        ----------
        image, pull : Tensor, (rows, columns)
            The vectors a and b.
        penalty : float
            The factor p.
        rest, inverse : Tensor, (rows, columns//2 + 1)
            Half spectra of R and of the preconditioner, which is positive.
        """
        free, seen = self._free.clone(), self._image.clone()
        residual = penalty * self._adjoint(image - seen) + pull - self._filtered(free, rest)
        step = self._filtered(residual, inverse)
        direction, product = step, total(residual * step)
        goal = _FALL**2 * product
        for _ in range(_MOST_STEPS):
            if product <= goal or product == 0.0:
                break
            moved = self._forward(direction)
            turned = penalty * self._adjoint(moved) + self._filtered(direction, rest)
            length = product / total(direction * turned)
            free += length * direction
            seen += length * moved
            residual = residual - length * turned
            step = self._filtered(residual, inverse)
            last, product = product, total(residual * step)
            direction = step + (product / last) * direction
        self._free, self._image = free, seen
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

# Attributes that, together with the image, determine the next iteration.
_PICTURES = ("signed", "predicted", "edges", "data_dual", "sign_dual", "edge_dual")
_NUMBERS = ("background", "multiplier", "data_penalty", "edge_penalty", "sign_penalty")


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
        Initial object, (H, W) in image units, or a saved state; see `inverse.data.checkpoints`.
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

    The target of the discrepancy principle allows for noise that the fit absorbs: the expected sum
    of squared residuals, one per pixel, is reduced by the number of pixels along the frame's
    outline (rms 0.984 of the noise at 128 x 128). Otherwise weak images would be over-smoothed. The
    computation uses float32 unless the noise is below 1e-4 of the image's range. ``objective`` is
    evaluated at the final weight, so it may rise while the weight is being adjusted.

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
    started = time.perf_counter()
    max_iterations = whole("max_iterations", max_iterations)
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)
    tv_weight = None if tv_weight is None else positive("tv_weight", tv_weight)
    gain = None if gain is None else positive("gain", gain)
    data = measurement(
        image,
        model,
        noise_sigma=noise_sigma,
        background=background,
        fit_background=fit_background,
        background_shape=background_shape,
    )
    if data.is_background(model):
        return without_object(data, model=model, gain=gain, started=started)
    level = started_from(start, model_shape(model), data.data.device)
    splitting = _Splitting(data, model, tv_weight, level)
    first = splitting.go_on(start) if isinstance(start, Mapping) else 0
    converged = False
    for iteration in range(first, max_iterations):
        change = splitting.iterate()
        # The first change is due to the data alone and is tiny if the weight is large.
        converged = change <= tolerance and iteration > 0
        last = converged or iteration + 1 == max_iterations
        told = last or iteration % 10 == 9
        if iteration < _ADAPT_UNTIL and iteration % _ADAPT_EVERY == _ADAPT_EVERY - 1:
            splitting.adapt()
        done = 1.0 if last else (iteration + 1) / max_iterations
        if told and not splitting.report(progress, done, iteration + 1):
            break
        if converged:
            break
    ending = Ending(
        converged=converged,
        history=splitting.history(),
        most_residual=MOST_RESIDUAL if tv_weight is None else None,
        sharp=tv_weight is None,
    )
    return concluded(
        data,
        splitting.level(),
        model=model,
        background=splitting.background(),
        gain=gain,
        ending=ending,
        started=started,
        tv_weight=splitting.tv_weight(),
    )


class _Splitting:
    """State of the alternating direction method of multipliers (ADMM) for total variation.

    Dual variables are scaled by their penalties. Internally the image is divided by its range and
    the kernel by its largest transfer modulus. Total variation has weight 1, and half the squared
    residual has the weight ``multiplier``.
    """

    def __init__(
        self,
        data: Measurement,
        model: ForwardModel | TorchForwardModel,
        tv_weight: float | None,
        level: Tensor | None,
    ) -> None:
        self._scale = data.span()
        self._sigma = data.sigma / self._scale
        dtype = data.working_dtype()
        self._fit_background = data.fit_background
        # A background far above the noise would exhaust single precision, so it is subtracted.
        self._level = data.border_strength()
        self._background = 0.0
        shape = data.background_shape
        self._shape = None if shape is None else shape.to(dtype)
        self._image = ((data.data - data.background(self._level)) / self._scale).to(dtype)
        self._weights = None if data.weights is None else data.weights.to(dtype)
        self._grid = model.grid
        self._frame = tuple(slice(None, length) for length in model.shape)
        twin = torch_model(model, data.data.device, torch.float64)
        transfer = twin.mean_transfer
        self._response = float(transfer.abs().max())
        transfer = transfer / self._response
        self._field = None
        if twin.weights is not None:
            self._field = FieldStep(twin, self._response, dtype)
        self._transfer = transfer.to(dtype.to_complex())
        self._power = (transfer.real**2 + transfer.imag**2).to(dtype)
        self._laplacian = _laplacian(self._grid, data.data.device).to(dtype)
        self._count = data.counted
        self._start(level)
        self._sought = tv_weight is None
        outline = 2 * sum(model.shape)
        freedom = max(self._count - outline, self._count / 2)
        self._target = self._sigma * math.sqrt(freedom)
        if tv_weight is None:
            self._data_penalty = 1.0 / (self._sigma * self._brightness)
            self._multiplier = self._data_penalty / _DATA_SHARE
        else:
            self._multiplier = self._response / (self._sigma * tv_weight)
            self._data_penalty = _DATA_SHARE * self._multiplier
        self._factorise()
        self._residuals: list[float] = []
        self._variations: list[float] = []
        self._changes: list[float] = []

    def _start(self, level: Tensor | None) -> None:
        """Set the initial object, from ``level`` (H, W) in image units or by a mild inverse filter.

        Negative values and values outside the frame are removed. The predicted image starts as the
        image itself. The image of ``level`` would leave nothing to do in the first step, and the
        iteration would appear to have converged.
        """
        self._predicted = torch.zeros(
            self._grid, dtype=self._image.dtype, device=self._image.device
        )
        self._predicted[self._frame] = self._image
        spectrum = self._transfer.conj() * torch.fft.rfft2(self._predicted)
        spectrum /= self._power + 1e-2
        first = torch.fft.irfft2(spectrum, s=self._grid)
        if level is not None:
            first = torch.zeros_like(self._predicted)
            first[self._frame] = (level * (self._response / self._scale)).to(first.dtype)
        self._signed = self._allowed(first)
        framed = self._signed[self._frame].flatten()
        bright = float(framed.kthvalue(math.ceil(0.99 * framed.numel())).values)
        self._brightness = bright if bright > 0.0 else 1.0
        self._sign_penalty = _SIGN_PENALTY / self._brightness
        self._edge_penalty = _EDGE_PENALTY / self._brightness
        self._edges = _gradient(self._signed)
        self._data_dual = torch.zeros_like(self._image)
        self._sign_dual = torch.zeros_like(self._signed)
        self._edge_dual = torch.zeros_like(self._edges)

    def _factorise(self) -> None:
        self._rest = self._edge_penalty * self._laplacian + self._sign_penalty
        self._inverse = 1.0 / (self._data_penalty * self._power + self._rest)
        self._filter = self._data_penalty * self._transfer.conj() * self._inverse

    def iterate(self) -> float:
        """Run one iteration; return the change that `tv_deconvolve` compares with its tolerance."""
        wanted = self._predicted.clone()
        wanted[self._frame] -= self._data_dual
        pull = _transposed_gradient(self._edges - self._edge_dual) * self._edge_penalty
        pull += self._sign_penalty * (self._signed - self._sign_dual)
        free, predicted = self._object_step(wanted, pull)
        self._data_step(predicted)
        self._variations.append(self._edge_step(_gradient(free)))
        change, distance = self._sign_step(free)
        self._changes.append(change)
        if not self._sought:
            return max(change, distance)
        expected = self._target / (self._sigma * math.sqrt(self._count))
        return max(change, distance, _RESIDUAL_SHARE * abs(self._residuals[-1] - expected))

    def _object_step(self, wanted: Tensor, pull: Tensor) -> tuple[Tensor, Tensor]:
        """Return the object whose image and gradients best match their targets, and its image.

        ``wanted`` is the target image and ``pull`` the target gradients and values, transposed and
        times their penalties, on the FFT grid.
        """
        if self._field is not None:
            return self._field.solve(wanted, pull, self._data_penalty, self._rest, self._inverse)
        spectrum = torch.fft.rfft2(wanted) * self._filter
        spectrum += torch.fft.rfft2(pull) * self._inverse
        free = torch.fft.irfft2(spectrum, s=self._grid)
        return free, torch.fft.irfft2(spectrum * self._transfer, s=self._grid)

    def _data_step(self, predicted: Tensor) -> None:
        """Move the predicted image toward the measured one until the residual equals the noise.

        The background and, if searched for, the multiplier are updated too.
        """
        residual = predicted[self._frame] - self._image + self._shaped(self._background)
        squared = total(self._weighted(residual * residual))
        self._residuals.append(math.sqrt(squared / self._count) / self._sigma)
        relaxed = _relaxed(predicted, self._predicted)
        relaxed[self._frame] += self._data_dual
        misfit = relaxed[self._frame] - self._image
        if self._fit_background:
            self._background = -self._strength(misfit)
            misfit += self._shaped(self._background)
        if self._sought:
            self._seek_multiplier(misfit)
        self._data_dual = misfit - misfit * self._shrinkage()
        relaxed[self._frame] -= self._data_dual
        self._predicted = relaxed

    def _shrinkage(self) -> Tensor | float:
        """Return the factor, 0 to 1, by which the data step reduces a misfit."""
        if self._weights is None:
            return self._data_penalty / (self._data_penalty + self._multiplier)
        return self._data_penalty / (self._data_penalty + self._multiplier * self._weights)

    def _shaped(self, strength: float) -> Tensor | float:
        """Return the background of a given strength, as a number or as an image (H, W)."""
        return strength if self._shape is None else strength * self._shape

    def _strength(self, misfit: Tensor) -> float:
        """Return the background strength that best fits a misfit (H, W).

        Pixels are weighted as in the data step.
        """
        if self._weights is not None:
            weights = self._weights * self._shrinkage()
            if self._shape is None:
                return total(weights * misfit) / total(weights)
            weights = weights * self._shape
            return total(weights * misfit) / total(weights * self._shape)
        if self._shape is None:
            return total(misfit) / misfit.numel()
        return total(self._shape * misfit) / total(self._shape * self._shape)

    def _seek_multiplier(self, misfit: Tensor) -> None:
        """Set the multiplier for which the residual after the data step equals the noise, rms."""
        target = self._target
        if self._weights is None:
            norm = math.sqrt(total(misfit * misfit))
            self._multiplier = self._data_penalty * max(norm / target - 1.0, 0.0)
            return
        squares = self._weights * misfit * misfit
        # Newton's method for 1/norm, which is nearly linear in the multiplier (exactly for uniform
        # noise).
        for _ in range(2):
            kept = self._data_penalty / (self._data_penalty + self._multiplier * self._weights)
            square = total(squares * kept**2)
            slope = total(squares * self._weights * kept**3) / self._data_penalty
            if slope <= 0.0:
                return
            step = (1.0 / target - square**-0.5) * square**1.5 / slope
            self._multiplier = max(self._multiplier + step, 0.0)

    def _edge_step(self, gradient: Tensor) -> float:
        """Shrink the gradients (soft threshold); return their total variation."""
        relaxed = _relaxed(gradient, self._edges) + self._edge_dual
        # vector_norm over the first axis is ten times slower on a processor.
        length = torch.addcmul(relaxed[0].square(), relaxed[1], relaxed[1]).sqrt_()
        left = (length - 1.0 / self._edge_penalty).clamp_min_(0.0)
        self._edges = relaxed * (left / length.clamp_min_(torch.finfo(length.dtype).tiny))
        self._edge_dual = relaxed - self._edges
        return total(left)

    def _sign_step(self, free: Tensor) -> tuple[float, float]:
        """Update the non-negative object.

        Returns its change and its distance from the unconstrained object ``free``, both relative to
        its norm.
        """
        relaxed = _relaxed(free, self._signed) + self._sign_dual
        before, self._signed = self._signed, self._allowed(relaxed)
        self._sign_dual = relaxed - self._signed
        norm = max(_norm(self._signed), 1e-30)
        return _norm(self._signed - before) / norm, _norm(free - self._signed) / norm

    def report(self, progress: Progress | None, done: float, count: int) -> bool:
        """Call the progress callback; return False if it asks to stop.

        ``done`` is the completed fraction and ``count`` the number of iterations.
        """
        return goes_on(
            progress,
            f"total variation: residual {self._residuals[-1]:.3f}, change "
            f"{self._changes[-1]:.1e} after {counted(count, 'iteration')}",
            done,
            lambda: self._state(count),
        )

    def _state(self, count: int) -> State:
        """Return the solver's state after ``count`` iterations, from which a fit can resume."""
        numbers = [getattr(self, f"_{name}") for name in _NUMBERS]
        pictures = {name: getattr(self, f"_{name}") for name in _PICTURES}
        return state_of(self.level(), **pictures, numbers=[*numbers, count])

    def go_on(self, state: Mapping[str, Any]) -> int:
        """Resume from a saved state; return the number of its iterations.

        A state that holds an object alone counts as 0 iterations.
        """
        if not {*_PICTURES, "numbers"} <= set(state):
            return 0
        *numbers, count = kept_numbers(state, len(_NUMBERS) + 1, "tv_deconvolve")
        for name in _PICTURES:
            mine = getattr(self, f"_{name}")
            kept = torch.tensor(real_array(f"start's {name}", state[name])).to(mine)
            if kept.shape != mine.shape:
                raise SamplingError(
                    f"start's {name} has shape {tuple(kept.shape)}, this fit's has "
                    f"{tuple(mine.shape)}; it is of another model, leave it out"
                )
            if not bool(torch.isfinite(kept).all()):
                raise SceneError(f"start's {name} holds values that are not finite; leave it out")
            setattr(self, f"_{name}", kept)
        given = self._multiplier
        for name, number in zip(_NUMBERS, numbers, strict=True):
            setattr(self, f"_{name}", number)
        if not self._sought:
            self._multiplier = given  # the saved one may belong to another weight
        self._factorise()
        return int(count)

    def adapt(self) -> None:
        """Adapt the data penalty to the multiplier, by at most a factor of 3."""
        ratio = _DATA_SHARE * self._multiplier / self._data_penalty
        ratio = min(max(ratio, 1.0 / 3.0), 3.0)
        self._data_penalty *= ratio
        self._data_dual /= ratio
        self._factorise()

    def level(self) -> Tensor:
        """Return the object (H, W) in image units."""
        return self._signed[self._frame].double() * (self._scale / self._response)

    def background(self) -> float:
        """Return the mean of the fitted background in image units, without the known background."""
        return self._level + self._background * self._scale

    def tv_weight(self) -> float:
        """Return the dimensionless weight of total variation that corresponds to the multiplier."""
        return self._response / (self._sigma * max(self._multiplier, 1e-30))

    def history(self) -> dict[str, list[float]]:
        """Return the records of all iterations.

        The objective is computed with the final weight, since in some steps the weight is
        undefined.
        """
        price = self.tv_weight() / (self._response * self._sigma)
        objective = [
            0.5 * self._count * residual**2 + price * variation
            for residual, variation in zip(self._residuals, self._variations, strict=True)
        ]
        return {"objective": objective, "residual": self._residuals, "change": self._changes}

    def _allowed(self, picture: Tensor) -> Tensor:
        allowed = torch.zeros_like(picture)
        allowed[self._frame] = picture[self._frame].clamp_min(0.0)
        return allowed

    def _weighted(self, values: Tensor) -> Tensor:
        return values if self._weights is None else values * self._weights


def _relaxed(new: Tensor, old: Tensor) -> Tensor:
    return torch.lerp(old, new, _RELAXATION)


def _norm(values: Tensor) -> float:
    return math.sqrt(total(values * values))


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
