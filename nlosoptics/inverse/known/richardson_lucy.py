"""Richardson-Lucy deconvolution of a framed image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..._progress import Progress
from ...errors import SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.arrays import norm, total, weighted
from ..data.driver import Iterate, Run, Solver, reconstructed, solved, stop_rule
from ..data.forward import TorchForwardModel, torch_model
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction
from ..data.status import Ending
from .wiener import background_estimate


@single_thread()
def richardson_lucy(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    accelerated: bool = True,
    max_iterations: int = 1000,
    tolerance: float = 1e-5,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a non-negative object by Richardson-Lucy iteration, stopped at the noise level.

    Parameters
    ----------
    image, model, progress
        See `tv_deconvolve`.
    accelerated : bool
        Whether to accelerate the convergence by extrapolation from the last two iterates.
    max_iterations : int
        Maximum number of iterations.
    tolerance : float
        Stop also when the relative change of the object per iteration is below this value.
    start : array_like, mapping or None
        See `tv_deconvolve`. Pixels that are 0 in an initial object remain 0.

    Returns
    -------
    Reconstruction
        Object, status and score. The score is the rms residual divided by the noise. With the
        status "converged", the object is the first iterate whose residual is at the noise level (a
        score of about 1), or an iterate that no longer changes, whose score may differ from 1. With
        "unconverged", it is the iterate with the least ``objective``.

    See Also
    --------
    wiener : Linear filter that weighs the noise.
    tv_deconvolve : Non-negative deconvolution with total variation.

    Notes
    -----
    The iteration is ``x <- x A'(w y/(A x + b))/A'w`` [1]_ [2]_, for the object x, image y, image
    model A with transpose A', background b and pixel weights w, which are 1 without a noise map. It
    keeps the object non-negative and conserves the total intensity. The divisor A'w accounts for
    light that leaves the image at its edges, which therefore do not ring. The strength of an
    unknown background is updated in the same way. It starts from an estimate with the Wiener
    filter, because a bad start would need thousands of iterations.

    A constant that lifts every pixel to at least one standard deviation of the noise is added to
    image and model, since the method needs positive pixels [3]_. The iteration stops at the noise
    level. The acceleration follows Biggs and Andrews [4]_. ``objective`` in the history is the
    weighted Kullback-Leibler divergence between image and model, in units of the image's range.

    References
    ----------
    .. [1] Richardson, J. Opt. Soc. Am. 62 (1972) 55.
    .. [2] Lucy, Astronomical Journal 79 (1974) 745.
    .. [3] Snyder, Hammoud and White, J. Opt. Soc. Am. A 10 (1993) 1014.
    .. [4] Biggs and Andrews, Applied Optics 36 (1997) 1766.
    """
    rule = stop_rule(max_iterations, tolerance)

    def solve(data: NoisyImage) -> dict[str, Any]:
        return solved(_Maximisation(data, model, rule, accelerated), start, progress)

    return reconstructed(solve, image, model)


@dataclass(eq=False, kw_only=True)
class _Estimate(Iterate):
    """State of the iteration.

    ``before`` and ``move`` are the last object before extrapolation and its last step; ``best`` has
    the least objective so far, or ended the fit.
    """

    current: Tensor
    before: Tensor
    move: Tensor
    best: Tensor
    strength: float
    best_strength: float
    least: float = math.inf
    residual: float = math.inf
    change: float = math.inf


class _Maximisation(Solver[_Estimate]):
    """Richardson-Lucy iteration. Internally the image is divided by its range."""

    name = "richardson_lucy"
    report = "Richardson-Lucy: residual {residual:.3g} of the noise"

    def __init__(
        self,
        data: NoisyImage,
        model: ForwardModel | TorchForwardModel,
        rule: tuple[int, float],
        accelerated: bool,
    ) -> None:
        self.data = data
        self.max_iterations, self._tolerance = rule
        self._accelerated = accelerated
        dtype, device = data.working_dtype(), data.data.device
        self._scale = data.span()
        self._sigma = data.sigma / self._scale
        self._model = torch_model(model, device, dtype)
        self._weights = None if data.weights is None else data.weights.to(dtype)
        self._level = background_estimate(data, model)
        image = ((data.data - data.background(self._level)) / self._scale).to(dtype)
        self._pedestal = self._sigma + max(0.0, -float(image.min()))
        self._image = image + self._pedestal
        # The fitted background starts one noise sigma below its estimate. It is positive, so that
        # the multiplicative iteration can lower the background too.
        self._shape: Tensor | None = None
        if data.fit_background:
            self._shape = torch.ones_like(image) * data.background(1.0)
            self._shape = self._shape.to(dtype)
            self._image += self._sigma * self._shape
        self._ceiling = self._model.adjoint(weighted(torch.ones_like(image), self._weights))
        # An object pixel without light in the frame cannot be determined; it stays dark.
        self._reached = self._ceiling > 1e-6 * self._ceiling.max()
        reached = self._reached.to(dtype)
        self._flat = total(image.clamp_min(0.0)) / total(self._model(reached)) * reached

    def init(self, first: Tensor | None) -> _Estimate:
        """Return the initial state; its object is uniform if none is given."""
        current = self._flat
        if first is not None:
            current = (first / self._scale).to(current).clamp_min(0.0) * self._reached
            if not bool(current.any()):
                raise SceneError(
                    f"start has no light (largest value {float(first.max()):g}), and what is dark "
                    "stays dark; leave it out"
                )
        return _Estimate(
            current=current,
            before=current,
            move=torch.zeros_like(current),
            best=current,
            strength=self._sigma,
            best_strength=self._sigma,
        )

    def step(self, state: _Estimate) -> tuple[float, float, float]:
        """Make one iteration; return objective, residual and change of the object before it."""
        ratio, objective, state.residual = self._misfit(state)
        drawn = self._model.adjoint(ratio).clamp_min_(0.0)
        new = torch.where(self._reached, state.current * drawn / self._ceiling, 0.0)
        state.change = norm(new - state.before) / max(norm(new), 1e-30)
        if objective < state.least or self.done(state):
            state.least = objective
            state.best, state.best_strength = state.current, state.strength
        move = new - state.current
        reach = _reach(state.move, move) if self._accelerated else 0.0
        state.current = (new + reach * (new - state.before)).clamp_min_(0.0)
        state.before, state.move = new, move
        if self._shape is not None:
            drawn_level = total(self._shape * ratio)
            state.strength *= drawn_level / total(weighted(self._shape, self._weights))
        return objective, state.residual, state.change

    def done(self, state: _Estimate) -> bool:
        """Return whether the residual is at the noise, or the object no longer changes."""
        return state.residual <= 1.0 or state.change <= self._tolerance

    def level(self, state: _Estimate) -> Tensor:
        """Return the object (H, W) in image units."""
        return state.best.double() * self._scale

    def answer(self, found: Run[_Estimate], level: Tensor) -> dict[str, Any]:
        """Return the mean of the fitted background in image units."""
        moved = (found.state.best_strength - self._sigma) * self._scale
        converged = self.done(found.state)
        ending = Ending(converged=converged, history=found.history, to_noise=True)
        return {"background": self._level + moved, "ending": ending}

    def _misfit(self, state: _Estimate) -> tuple[Tensor, float, float]:
        """Return weighted ratio image/model (H, W), divergence, and rms residual over the noise.

        The divergence is the weighted generalised Kullback-Leibler divergence of image and model.
        """
        model = self._model(state.current) + self._pedestal
        if self._shape is not None:
            model = model + state.strength * self._shape
        # FFT rounding errors may lower the model below the pedestal, which is at least one sigma.
        model = model.clamp_min_(0.5 * self._pedestal)
        ratio = self._image / model
        residual = self._image - model
        squares = total(weighted(residual * residual, self._weights)) / self.data.counted
        divergence = total(weighted(self._image * ratio.log() - residual, self._weights))
        return weighted(ratio, self._weights), divergence, math.sqrt(squares) / self._sigma


def _reach(earlier: Tensor, later: Tensor) -> float:
    """Return the extrapolation factor, 0 to 1, computed from the last two steps."""
    return min(max(total(later * earlier) / max(total(earlier * earlier), 1e-30), 0.0), 1.0)
