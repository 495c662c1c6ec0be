"""Wiener deconvolution of a framed image."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..._checks import counted, in_range, positive, whole
from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.checkpoints import goes_on, started_from, state_of
from ..data.forward import TorchForwardModel, model_shape, torch_model
from ..data.measurement import Measurement, measurement, total
from ..data.reconstruction import Reconstruction, beside, concluded, without_object
from ..data.status import Ending

# Transmitted power, relative to that of the mean, that is only rounding error.
_ROUNDING = 1e-12


@single_thread()
def wiener(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int = 300,
    tolerance: float = 1e-6,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object with the Wiener filter for a 1/f^2 power spectrum.

    Parameters
    ----------
    image : ndarray or Tensor
        Image, (H, W), any unit.
    model : ForwardModel or TorchForwardModel
        Image model with the shape (H, W).
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units; None: estimated by
        `estimate_noise`. Infinite for pixels to ignore, such as saturated ones.
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
        Stop when the residual of the normal equations, relative to their right-hand side, is below
        this value.
    start : array_like, mapping or None
        Initial object, (H, W) in image units, or a saved state; see `inverse.data.checkpoints`.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.

    Returns
    -------
    Reconstruction
        The object may have negative values. ``objective`` is half the squared residual in units of
        the noise, plus half the object's squared norm under the prior.

    Raises
    ------
    SamplingError
        If an array does not fit the model.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    inverse_filter : Division by the transfer function.
    tv_deconvolve : Non-negative, with total variation.

    Notes
    -----
    Minimises ``|A x + b - y|^2/sigma^2 + x' S^-1 x``. The prior spectrum S is proportional to
    1/(f^2 + f_0^2) with f_0 one cycle per frame, as in natural scenes [1]_. Its strength matches
    the image's variance in excess of the noise; for an image that is uniform up to noise, without a
    background to fit, it matches the mean square instead. A circular frame without weights is the
    classical filter, solved in one step. For a padded frame or a field of point spreads, the filter
    with the mean point spread preconditions conjugate gradients over objects inside the frame. No
    edge tapering is needed, and edges do not ring.

    References
    ----------
    .. [1] Field, J. Opt. Soc. Am. A 4 (1987) 2379.
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
    problem = _NormalEquations(data, torch_model(model, data.data.device, torch.float64))
    first = started_from(start, model_shape(model), data.data.device)
    level, history, converged = _conjugate_gradients(
        problem, max_iterations, tolerance, first, progress
    )
    return concluded(
        data,
        level,
        model=model,
        background=beside(data, level, problem.model)[0],
        gain=gain,
        ending=Ending(converged=converged, history=history),
        started=started,
    )


def background_estimate(data: Measurement, model: TorchForwardModel) -> float:
    """Return the fitted strength of the unknown background, image units; 0 if it is known.

    It is the background that explains what the image of the Wiener-filtered object leaves.
    """
    if not data.fit_background:
        return 0.0
    problem = _NormalEquations(data, model)
    # The background is then within a tenth of the noise; fine detail takes ten times longer.
    level, _, _ = _conjugate_gradients(problem, 300, 1e-4, None, None)
    return data.background_strength(data.data - model(level))


class _NormalEquations:
    """Normal equations of the Wiener filter, with the background eliminated.

    The matrix is ``A' W A + sigma^2 S^-1`` for objects inside the frame, with image model A, pixel
    weights W and prior spectrum S.
    """

    def __init__(self, data: Measurement, model: TorchForwardModel) -> None:
        self.data = data
        self.model = model
        rows, columns = model.grid
        device = data.data.device
        # The mean transfer function of a field of point spreads is used for preconditioning and
        # for the scale of the prior.
        transfer = model.mean_transfer
        power = transfer.real**2 + transfer.imag**2
        row_frequencies = torch.fft.fftfreq(rows, dtype=torch.float64, device=device)[:, None]
        column_frequencies = torch.fft.rfftfreq(columns, dtype=torch.float64, device=device)
        corner = 1.0 / max(model.shape)
        prior = 1.0 / (row_frequencies**2 + column_frequencies**2 + corner**2)
        # A half spectrum holds every column but the first, and the last of an even grid, once
        # for two.
        twice = torch.full((columns // 2 + 1,), 2.0, dtype=torch.float64, device=device)
        twice[0] = 1.0
        if columns % 2 == 0:
            twice[-1] = 1.0
        of_mean = float(power[0, 0] * prior[0, 0])
        passed = total(power * prior * twice) - of_mean
        # The object's mean is not counted as variance of the prior.
        steady: Tensor | float = data.weighted_mean(data.data)
        if data.fit_background:
            steady = data.background(data.background_strength(data.data))
        elif data.is_noise_about(steady):  # only the mean is left to scale the prior
            steady, passed = 0.0, passed + of_mean
        if passed <= _ROUNDING * of_mean:  # an even kernel over a periodic frame, or one pixel
            passed = of_mean
        # A detected object may be fainter than the error of the whole frame's mean square.
        excess = max(data.score(steady) ** 2 - 1.0, math.sqrt(2.0 / data.counted))
        # Parseval: sum |H|^2 S = samples * (summed variance of the image); S = strength * prior.
        samples = rows * columns
        strength = samples * data.counted * data.sigma**2 * excess / passed
        self._penalty = data.sigma**2 * samples / (strength * prior)
        self._preconditioner = 1.0 / (power + self._penalty)
        self.right_side = model.adjoint(self.cleaned(data.data))

    def cleaned(self, image: Tensor) -> Tensor:
        """Return the weighted image minus its best-fitting background."""
        image = image - self.data.background(self.data.background_strength(image))
        return self.data.weighted(image)

    def normal(self, seen: Tensor, penalised: Tensor) -> Tensor:
        """Return the matrix times an object, given its image and the result of `penalised`."""
        return self.model.adjoint(self.cleaned(seen)) + penalised

    def penalised(self, level: Tensor) -> Tensor:
        """Return ``sigma^2 S^-1`` times an object, with the prior spectrum S."""
        return self._filtered(level, self._penalty)

    def preconditioned(self, residual: Tensor) -> Tensor:
        """Apply the Wiener filter of a periodic frame with uniform noise, as a preconditioner."""
        return self._filtered(residual, self._preconditioner)

    def _filtered(self, picture: Tensor, response: Tensor) -> Tensor:
        rows, columns = self.model.shape
        grid = self.model.grid
        filtered: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture, s=grid) * response, s=grid)
        return filtered[:rows, :columns]


def _conjugate_gradients(
    problem: _NormalEquations,
    max_iterations: int,
    tolerance: float,
    first: Tensor | None,
    progress: Progress | None,
) -> tuple[Tensor, dict[str, list[float]], bool]:
    """Solve the normal equations; return object, history, and whether the tolerance was met.

    The object is in image units. ``first`` is the initial object, or None for zero.
    """
    history: dict[str, list[float]] = {"objective": [], "residual": [], "change": []}
    data = problem.data
    level = torch.zeros_like(data.data) if first is None else first.clone()
    seen, level_penalised = problem.model(level), problem.penalised(level)
    misfit = data.data - seen
    residual = problem.right_side - problem.normal(seen, level_penalised)
    start = math.sqrt(total(problem.right_side * problem.right_side))
    direction = torch.zeros_like(residual)
    last = math.inf
    for iteration in range(max_iterations):
        step = problem.preconditioned(residual)
        product = total(residual * step)
        if product == 0.0:  # started from the solution itself
            return level, history, True
        direction = step + (product / last) * direction
        seen = problem.model(direction)
        penalised = problem.penalised(direction)
        image = problem.normal(seen, penalised)
        length = product / total(direction * image)
        last = product
        level += length * direction
        misfit -= length * seen
        level_penalised += length * penalised
        residual = residual - length * image
        squared = max(total(problem.cleaned(misfit) * misfit), 0.0)
        prior = total(level * level_penalised)
        history["objective"].append(0.5 * (squared + prior) / data.sigma**2)
        history["residual"].append(math.sqrt(squared / data.counted) / data.sigma)
        history["change"].append(abs(length) * float(direction.norm() / level.norm()))
        left = math.sqrt(total(residual * residual)) / start
        done = math.log(min(left, 1.0)) / math.log(tolerance) if left > tolerance else 1.0
        on = goes_on(
            progress,
            f"Wiener filter: residual {left:.1e} after {counted(iteration + 1, 'iteration')}",
            min(max(done, (iteration + 1) / max_iterations), 1.0),
            partial(state_of, level),
        )
        if left <= tolerance or not on:
            return level, history, left <= tolerance
    return level, history, False
