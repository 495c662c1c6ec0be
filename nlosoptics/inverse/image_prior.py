"""Deconvolution by an untrained network: the deep image prior."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .._checks import in_range, positive, whole
from .._random import checked_seed
from ..imaging.forward_model import ForwardModel
from ._threads import single_thread
from .measurements import Measurement, measurement
from .reconstructions import Reconstruction, assemble, without_object
from .torch_model import TorchForwardModel, model_shape, torch_model
from .unets import UNetObject
from .wiener_filter import wiener

Progress = Callable[[float, str], None]

# Part of a step that the running average takes over, and steps before it starts.
_AVERAGE = 0.04
_AVERAGE_FROM = 25
# Steps over which a plateau is told, and its learning rate at the last step.
_PLATEAU = 50
_LAST_RATE = 0.05
# Rounding of total variation at 0, of the object's range.
_SMOOTH = 1e-3


@single_thread()
def deep_image_prior(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    noise_sigma: Any = None,
    tv_weight: float = 0.1,
    base: int = 8,
    depth: int = 4,
    learning_rate: float = 0.03,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int = 300,
    tolerance: float = 0.01,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Object that an untrained U-net makes of an image, fitted to that image alone.

    Parameters
    ----------
    image : ndarray or Tensor
        (H, W), any unit.
    model : ForwardModel or TorchForwardModel
        Of shape (H, W).
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units; None: estimated by
        `estimate_noise`.
    tv_weight : float
        Weight of the total variation, dimensionless as in `tv_deconvolve`; 0 for the network alone.
    base, depth : int
        Of the network, see `UNet`.
    learning_rate : float
        Of Adam's first step; it falls along a cosine to a twentieth.
    background : float or array_like
        Known background, one number or (H, W), image units.
    fit_background : bool
        Whether the strength of a further background is unknown and fitted besides.
    background_shape : array_like or None
        (H, W), non-negative, shape of that further background; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object's largest value becomes 1.
    max_iterations : int
        Steps of Adam.
    tolerance : float
        By how much the residual may exceed the noise, as a part of it, where the fit stops and is
        converged; and how much it may still fall over 50 steps where it is converged on a plateau.
    seed : int
        Of the network's first weights.
    progress : callable or None
        Called now and then with the fraction done and a line of text.

    Returns
    -------
    Reconstruction
        ``physical_parameters`` also holds ``iterations``.

    Raises
    ------
    SamplingError
        If an array does not fit the model.
    SceneError
        If a value is out of range or not finite.

    Notes
    -----
    The network [1]_ is fed with `wiener`'s estimate and not with noise: it then starts from what is
    sharp already (half of the steps to equal correlation). Adam minimises
    ``sum (g A x + b - y)^2 / (2 sigma_i^2) + tv_weight TV(g x)/sigma`` over the weights of the
    network x, with gain and background at their least-squares values in every step. Nothing but the
    noise says when to stop (discrepancy principle): a network fits noise in the end [1]_. A running
    average of the iterates is kept besides, and of it and the best iterate the one of the lower
    objective is returned [2]_. On a processor the same seed gives the same bits; networks run in
    single precision, so noise under 1e-4 of the image's range is not reached.

    References
    ----------
    .. [1] Ulyanov, Vedaldi and Lempitsky, Int. J. Comput. Vis. 128 (2020) 1867.
    .. [2] Cheng, Gadelha, Maji and Sheldon, CVPR 2019, 5443.
    """
    started = time.perf_counter()
    checked_seed(seed)
    max_iterations = whole("max_iterations", max_iterations)
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)
    tv_weight = in_range("tv_weight", tv_weight, 0.0)
    learning_rate = in_range("learning_rate", learning_rate, 0.0, 1.0, open_low=True)
    gain = None if gain is None else positive("gain", gain)
    options = {"fit_background": fit_background, "background_shape": background_shape}
    data = measurement(
        image, model_shape(model), noise_sigma=noise_sigma, background=background, **options
    )
    if data.is_background():
        return without_object(data, model=model, gain=gain, started=started)
    sharp = wiener(
        data.data, model, noise_sigma=_sigmas(data), max_iterations=100, tolerance=1e-3, **options
    )
    guide = sharp.object.to(torch.float32)
    fit = _Fit(
        UNetObject(guide, base=base, depth=depth, seed=seed), data, model, tv_weight, learning_rate
    )
    converged = fit.run(max_iterations, tolerance, progress)
    level = fit.chosen()
    seen = torch_model(model, level.device, torch.float64)(level)
    return assemble(
        data,
        level,
        model=model,
        background=data.background_strength(data.data - seen),
        gain=gain,
        status="converged" if converged else "unconverged",
        history=fit.history,
        started=started,
        iterations=float(len(fit.history["residual"])),
    )


class _Fit:
    """Weights of a network on their way to an image.

    Inside, the image is divided by the noise, so that half the squared residual is its likelihood.
    """

    def __init__(
        self,
        network: UNetObject,
        data: Measurement,
        model: ForwardModel | TorchForwardModel,
        tv_weight: float,
        learning_rate: float,
    ) -> None:
        device = data.data.device
        self._network = network
        self._model = torch_model(model, device, torch.float32)
        self._sigma = data.sigma if data.sigma > 0.0 else 1.0
        level = data.background(data.background_strength(data.data))
        self._image = ((data.data - level) / self._sigma).float()
        self._weights = None if data.weights is None else data.weights.float()
        shape = data.background_shape
        self._shape = torch.ones_like(self._image) if shape is None else shape.float()
        self._shape = self._shape if data.fit_background else torch.zeros_like(self._image)
        self._tv_weight = tv_weight
        self._rate = learning_rate
        self._adam = torch.optim.Adam(network.parameters(), learning_rate, fused=True)
        self._best: tuple[float, Tensor | None] = (math.inf, None)
        self._average: Tensor | None = None
        self.history: dict[str, list[float]] = {"objective": [], "residual": [], "change": []}

    def run(self, max_iterations: int, tolerance: float, progress: Progress | None) -> bool:
        """Step until the residual is the noise's, or stands still; whether it came to that."""
        before: Tensor | None = None
        for iteration in range(max_iterations):
            share = 0.5 + 0.5 * math.cos(math.pi * iteration / max_iterations)
            rate = self._rate * (_LAST_RATE + (1.0 - _LAST_RATE) * share)
            self._adam.param_groups[0]["lr"] = rate
            objective, residual, level = self._step()
            self._keep(iteration, objective, level)
            change = math.inf if before is None else float((level - before).norm() / level.norm())
            before = level
            for name, value in zip(self.history, (objective, residual, change), strict=True):
                self.history[name].append(value)
            done = residual <= 1.0 + tolerance
            if progress is not None and (done or iteration % 10 == 9):
                progress(
                    1.0 if done else (iteration + 1) / max_iterations,
                    f"deep image prior: residual {residual:.3f} after {iteration + 1} iterations",
                )
            if done:
                return True
        return self._on_plateau(tolerance)

    def chosen(self) -> Tensor:
        """Running average or best iterate, whichever has the lower objective, image units."""
        objective, level = self._best
        if self._average is not None:
            with torch.no_grad():
                averaged = self._objective(self._average)[0].item()
            if averaged <= objective:
                level = self._average
        if level is None:
            level = torch.zeros_like(self._image)
        return level.double() * self._sigma

    def _step(self) -> tuple[float, float, Tensor]:
        """One step of Adam; objective, residual and level of the object before it."""
        self._adam.zero_grad()
        objective, residual, level = self._objective(self._network())
        objective.backward()  # type: ignore[no-untyped-call]
        self._adam.step()
        return objective.item(), residual.sqrt().item(), level.detach()

    def _objective(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Objective per pixel, mean squared residual, and object over the noise."""
        seen = self._without_background(self._model(picture))
        image = self._without_background(self._image)
        norm = self._weighted(seen * seen).sum()
        gain = self._weighted(seen * image).sum() / norm.clamp_min(torch.finfo(norm.dtype).tiny)
        # light is never negative: an object that is the image's opposite is none at all
        gain = gain.clamp_min(0.0)
        residual = image - gain * seen
        square = self._weighted(residual * residual).mean()
        level = gain * picture
        objective = 0.5 * square
        if self._tv_weight > 0.0:
            smooth = _SMOOTH * gain.detach()
            edges = total_variation(level, smooth) / level.numel()
            objective = objective + self._tv_weight * edges
        return objective, square, level

    def _without_background(self, values: Tensor) -> Tensor:
        """Values less the background that fits them best."""
        weighted = self._weighted(self._shape)
        norm = (weighted * self._shape).sum()
        if not bool(norm > 0.0):
            return values
        return values - self._shape * ((weighted * values).sum() / norm)

    def _weighted(self, values: Tensor) -> Tensor:
        return values if self._weights is None else values * self._weights

    def _keep(self, iteration: int, objective: float, level: Tensor) -> None:
        if math.isfinite(objective) and objective < self._best[0]:
            self._best = (objective, level)
        if self._average is None and iteration >= _AVERAGE_FROM:
            self._average = level.clone()
        elif self._average is not None:
            self._average.lerp_(level, _AVERAGE)

    def _on_plateau(self, tolerance: float) -> bool:
        """Whether the residual fell by no more than the tolerance over the last steps."""
        residuals = self.history["residual"]
        if len(residuals) < 2 * _PLATEAU:
            return False
        earlier, later = residuals[-2 * _PLATEAU : -_PLATEAU], residuals[-_PLATEAU:]
        return min(earlier) <= (1.0 + tolerance) * min(later)


def total_variation(picture: Tensor, smooth: Tensor | float) -> Tensor:
    """Isotropic total variation of a picture (..., H, W) within its frame.

    Gradients under ``smooth`` count quadratically: the root's own slope at 0 is infinite.
    """
    down = torch.diff(picture, dim=-2)[..., :, :-1]
    along = torch.diff(picture, dim=-1)[..., :-1, :]
    square = down * down + along * along
    return ((square + smooth * smooth).sqrt() - smooth).sum(dim=(-2, -1))


def _sigmas(data: Measurement) -> Any:
    """Noise as solvers take it."""
    if data.weights is None:
        return data.sigma if data.sigma > 0.0 else None
    return data.sigma / data.weights.sqrt()
