"""Richardson-Lucy deconvolution of a framed image."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._progress import Progress
from ...errors import SceneError
from ...imaging.forward_model import ForwardModel
from ...psf import PointSpread
from ..data.arrays import norm, total
from ..data.driver import History, Solver, solved, started_from, stop_rule
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction
from ..data.status import Ending
from .photographs import fitted
from .wiener import background_estimate

Array = NDArray[np.float64]


def richardson_lucy(
    image: Any,
    model: ForwardModel | PointSpread | Array,
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

    def fit(data: NoisyImage, model: ForwardModel) -> dict[str, Any]:
        return solved(_Maximisation(data, model, rule, accelerated, start), progress)

    return fitted(fit, image, model)


class _Maximisation(Solver):
    """Richardson-Lucy iteration. Internally the image is divided by its range.

    ``_before`` and ``_move`` are the last object before extrapolation and its last step; ``_best``
    has the least objective so far, or ended the fit.
    """

    report = "Richardson-Lucy: residual {residual:.3g} of the noise"

    def __init__(
        self,
        data: NoisyImage,
        model: ForwardModel,
        rule: tuple[int, float],
        accelerated: bool,
        start: Any,
    ) -> None:
        self.data = data
        self.max_iterations, self._tolerance = rule
        self._accelerated = accelerated
        self._scale = data.span()
        self._sigma = data.sigma / self._scale
        self._model = model
        self._level = background_estimate(data, model)
        image = (data.data - data.background(self._level)) / self._scale
        self._pedestal = self._sigma + max(0.0, -float(image.min()))
        self._image = image + self._pedestal
        # The fitted background starts one noise sigma below its estimate. It is positive, so that
        # the multiplicative iteration can lower the background too.
        if data.fit_background:
            self._image += self._sigma * data.background_shape
        ceiling = self._model.adjoint(data.weighted(np.ones_like(image)))
        # An object pixel without light in the frame cannot be determined; it stays dark.
        self._reached = ceiling > 1e-6 * ceiling.max()
        self._ceiling = np.where(self._reached, ceiling, 1.0)
        self._current = self._begun(image, start)
        self._before, self._move = self._current, 0.0 * self._current
        self._best, self._best_strength, self._strength = self._current, self._sigma, self._sigma
        self._least, self.residual, self._change = math.inf, math.inf, math.inf

    def _begun(self, image: Array, start: Any) -> Array:
        """Return the initial object, uniform if none is given."""
        if start is None:
            reached = self._reached.astype(np.float64)
            light = total(np.maximum(image, 0.0))
            return np.asarray(light / total(self._model.forward(reached)) * reached)
        first = started_from(start, self._model.shape)
        current = np.maximum(first / self._scale, 0.0) * self._reached
        if not current.any():
            raise SceneError(
                f"start has no light (largest value {float(first.max()):g}), and what is dark "
                "stays dark; leave it out"
            )
        return np.asarray(current)

    def step(self) -> tuple[float, float, float]:
        """Make one iteration; return objective, residual and change of the object before it."""
        ratio, objective, self.residual = self._misfit()
        drawn = np.maximum(self._model.adjoint(ratio), 0.0)
        new = np.where(self._reached, self._current * drawn / self._ceiling, 0.0)
        self._change = norm(new - self._before) / max(norm(new), 1e-30)
        if objective < self._least or self.done():
            self._least = objective
            self._best, self._best_strength = self._current, self._strength
        move = new - self._current
        reach = _reach(self._move, move) if self._accelerated else 0.0
        self._current = np.maximum(new + reach * (new - self._before), 0.0)
        self._before, self._move = new, move
        if self.data.fit_background:
            shape = self.data.background_shape
            self._strength *= total(shape * ratio) / total(self.data.weighted(shape))
        return objective, self.residual, self._change

    def done(self) -> bool:
        """Return whether the residual is at the noise, or the object no longer changes."""
        return self.residual <= 1.0 or self._change <= self._tolerance

    def level(self) -> Array:
        """Return the object (H, W) in image units."""
        return self._best * self._scale

    def answer(self, level: Array, history: History) -> dict[str, Any]:
        """Return the mean of the fitted background in image units."""
        moved = (self._best_strength - self._sigma) * self._scale
        ending = Ending(converged=self.done(), history=history, to_noise=True)
        return {"background": self._level + moved, "ending": ending}

    def _misfit(self) -> tuple[Array, float, float]:
        """Return weighted ratio image/model (H, W), divergence, and rms residual over the noise.

        The divergence is the weighted generalised Kullback-Leibler divergence of image and model.
        """
        model = self._model.forward(self._current) + self._pedestal
        if self.data.fit_background:
            model = model + self._strength * self.data.background_shape
        # FFT rounding errors may lower the model below the pedestal, which is at least one sigma.
        model = np.maximum(model, 0.5 * self._pedestal)
        ratio = self._image / model
        residual = self._image - model
        squares = total(self.data.weighted(residual * residual)) / self.data.counted
        divergence = total(self.data.weighted(self._image * np.log(ratio) - residual))
        return self.data.weighted(ratio), divergence, math.sqrt(squares) / self._sigma


def _reach(earlier: Array, later: Array) -> float:
    """Return the extrapolation factor, 0 to 1, computed from the last two steps."""
    return min(max(total(later * earlier) / max(total(earlier * earlier), 1e-30), 0.0), 1.0)
