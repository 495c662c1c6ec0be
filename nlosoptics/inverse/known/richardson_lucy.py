"""Richardson-Lucy deconvolution of a framed image."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..._checks import counted, in_range, positive, whole
from ..._progress import Progress
from ...errors import SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.checkpoints import goes_on, started_from, state_of
from ..data.forward import TorchForwardModel, model_shape, torch_model
from ..data.measurement import Measurement, measurement, total
from ..data.reconstruction import Reconstruction, concluded, without_object
from ..data.status import MOST_RESIDUAL, Ending
from .wiener import background_estimate


@single_thread()
def richardson_lucy(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    accelerated: bool = True,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int = 1000,
    tolerance: float = 1e-5,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a non-negative object by Richardson-Lucy iteration, stopped at the noise level.

    Parameters
    ----------
    image : ndarray or Tensor
        (H, W), any unit.
    model : ForwardModel or TorchForwardModel
        Of shape (H, W); a field of point spreads is taken as well.
    accelerated : bool
        Whether to extrapolate each step along the last two iterates.
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units; None: estimated by
        `estimate_noise`.
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
        Stop also when the relative change of the object per iteration is below this value.
    start : array_like, mapping or None
        Initial object, (H, W) in image units, or a saved state; see `inverse.data.checkpoints`.
        Where it is dark it stays dark.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.

    Returns
    -------
    Reconstruction
        "converged": the first iterate with a residual at the noise level, or one that no longer
        changes, in which case its score may differ from 1. "unconverged": the iterate with the
        least ``objective``.

    Raises
    ------
    SamplingError
        If an array does not fit the model.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    wiener : Linear filter that weighs the noise.
    tv_deconvolve : Non-negative, with total variation.

    Notes
    -----
    ``x <- x A'(w y/(A x + b))/A'w`` [1]_ [2]_ conserves flux and sign; w are the pixel weights of a
    noise map. ``A'w`` accounts for light lost at the frame, so that padded edges do not ring. The
    background's strength is updated by the same step and starts from its estimate with the Wiener
    filter; a remote start would need thousands of iterations. Noise can make dark pixels negative,
    which the method does not allow. Instead of clipping, a pedestal that lifts the darkest pixel to
    one noise sigma is added to image and model [3]_. Early stopping is the regularisation; further
    iterations would fit the noise. The acceleration follows Biggs and Andrews [4]_. ``objective``
    is the weighted divergence between model and image, in units of the image's range.

    References
    ----------
    .. [1] Richardson, J. Opt. Soc. Am. 62 (1972) 55.
    .. [2] Lucy, Astronomical Journal 79 (1974) 745.
    .. [3] Snyder, Hammoud and White, J. Opt. Soc. Am. A 10 (1993) 1014.
    .. [4] Biggs and Andrews, Applied Optics 36 (1997) 1766.
    """
    started = time.perf_counter()
    max_iterations = whole("max_iterations", max_iterations)
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)
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
    first = started_from(start, model_shape(model), data.data.device)
    steps = _Maximisation(data, model, accelerated, first)
    converged = steps.run(max_iterations, tolerance, progress)
    return concluded(
        data,
        steps.best.double() * steps.scale,
        model=model,
        background=steps.background(),
        gain=gain,
        ending=Ending(converged=converged, history=steps.history, most_residual=MOST_RESIDUAL),
        started=started,
    )


class _Maximisation:
    """State of the Richardson-Lucy iteration. Internally the image is divided by its range."""

    def __init__(
        self,
        data: Measurement,
        model: ForwardModel | TorchForwardModel,
        accelerated: bool,
        first: Tensor | None,
    ) -> None:
        dtype, device = data.working_dtype(), data.data.device
        self.scale = data.span()
        self._accelerated = accelerated
        self._sigma = data.sigma / self.scale
        self._counted = data.counted
        self._model = torch_model(model, device, dtype)
        self._weights = None if data.weights is None else data.weights.to(dtype)
        self._level = background_estimate(data, torch_model(model, device, torch.float64))
        image = ((data.data - data.background(self._level)) / self.scale).to(dtype)
        self._pedestal = self._sigma + max(0.0, -float(image.min()))
        self._image = image + self._pedestal
        # The fitted background starts one noise sigma below its estimate. It is positive, so that
        # the multiplicative iteration can lower the background too.
        self._shape: Tensor | None = None
        if data.fit_background:
            shape = data.background_shape
            self._shape = torch.ones_like(image) if shape is None else shape.to(dtype)
            self._image += self._sigma * self._shape
        self._strength = self._best_strength = self._sigma
        self._ceiling = self._model.adjoint(self._weighted(torch.ones_like(image)))
        # An object pixel without light in the frame cannot be determined; it stays dark.
        self._reached = self._ceiling > 1e-6 * self._ceiling.max()
        reached = self._reached.to(dtype)
        flat = total(image.clamp_min(0.0)) / total(self._model(reached))
        self._object = self.best = flat * reached
        if first is not None:
            self._object = self.best = (first / self.scale).to(dtype).clamp_min(0.0) * reached
            if not bool(self._object.any()):
                raise SceneError(
                    f"start has no light (largest value {float(first.max()):g}), and what is dark "
                    "stays dark; leave it out"
                )
        self.history: dict[str, list[float]] = {"objective": [], "residual": [], "change": []}

    def run(self, max_iterations: int, tolerance: float, progress: Progress | None) -> bool:
        """Iterate until the residual equals the noise or the object stops changing.

        Returns False if the iterations ran out, or the callback stopped the fit, before that.
        """
        before = self._object
        moves: list[Tensor] = []
        least = math.inf
        for iteration in range(max_iterations):
            ratio, objective, residual = self._misfit()
            if objective < least:
                least = objective
                self.best, self._best_strength = self._object, self._strength
            new = self._step(ratio)
            moves = [*moves[-1:], new - self._object]
            change = _norm(new - before) / max(_norm(new), 1e-30)
            self.history["objective"].append(objective)
            self.history["residual"].append(residual)
            self.history["change"].append(change)
            done = residual <= 1.0 or change <= tolerance
            if done:
                self.best, self._best_strength = self._object, self._strength
            last = done or iteration + 1 == max_iterations
            on = True
            if last or iteration % 10 == 9:
                on = goes_on(
                    progress,
                    f"Richardson-Lucy: residual {residual:.3g} of the noise after "
                    f"{counted(iteration + 1, 'iteration')}",
                    1.0 if last else (iteration + 1) / max_iterations,
                    partial(state_of, self.best.double() * self.scale),
                )
            if done or not on:
                return done
            reach = _reach(moves) if self._accelerated else 0.0
            self._object = (new + reach * (new - before)).clamp_min_(0.0)
            before = new
            self._strength *= self._background_step(ratio)
        return False

    def background(self) -> float:
        """Return the mean of the fitted background in image units."""
        return self._level + (self._best_strength - self._sigma) * self.scale

    def _misfit(self) -> tuple[Tensor, float, float]:
        """Return weighted ratio image/model (H, W), divergence, and rms residual over the noise.

        The divergence is the weighted generalised Kullback-Leibler divergence of image and model.
        """
        model = self._model(self._object) + self._pedestal
        if self._shape is not None:
            model = model + self._strength * self._shape
        # FFT rounding errors may lower the model below the pedestal, which is at least one sigma.
        model = model.clamp_min_(0.5 * self._pedestal)
        ratio = self._image / model
        residual = self._image - model
        squares = total(self._weighted(residual * residual)) / self._counted
        divergence = total(self._weighted(self._image * ratio.log() - residual))
        return self._weighted(ratio), divergence, math.sqrt(squares) / self._sigma

    def _step(self, ratio: Tensor) -> Tensor:
        """Return the next object: the current one times the back-projected ``ratio`` (H, W)."""
        drawn = self._model.adjoint(ratio).clamp_min_(0.0)
        return torch.where(self._reached, self._object * drawn / self._ceiling, 0.0)

    def _background_step(self, ratio: Tensor) -> float:
        """Return the factor by which an iteration changes the strength of the background."""
        if self._shape is None:
            return 1.0
        return total(self._shape * ratio) / total(self._weighted(self._shape))

    def _weighted(self, values: Tensor) -> Tensor:
        return values if self._weights is None else values * self._weights


def _reach(moves: list[Tensor]) -> float:
    """Return the extrapolation factor, 0 to 1, computed from the last two steps."""
    if len(moves) < 2:
        return 0.0
    earlier, later = moves
    return min(max(total(later * earlier) / max(total(earlier * earlier), 1e-30), 0.0), 1.0)


def _norm(values: Tensor) -> float:
    return math.sqrt(total(values * values))
