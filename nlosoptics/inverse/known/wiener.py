"""Wiener deconvolution of a framed image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.arrays import half_spectrum_weights, norm, total
from ..data.driver import Iterate, Run, Solver, reconstructed, run, solved, stop_rule
from ..data.forward import TorchForwardModel, torch_model
from ..data.models import mean_transfer
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside
from .conjugate_gradients import conjugate_direction


@single_thread()
def wiener(
    image: Any,
    model: ForwardModel | TorchForwardModel,
    *,
    max_iterations: int = 300,
    tolerance: float = 1e-6,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object with the Wiener filter, for objects of power spectrum 1/f^2.

    Parameters
    ----------
    image, model, start, progress
        See `tv_deconvolve`.
    max_iterations : int
        Maximum number of iterations.
    tolerance : float
        Stop when the residual of the filter's linear equations, relative to their right-hand side,
        is below this value.

    Returns
    -------
    Reconstruction
        Object, status and score. The object may have negative values. In ``history``, ``objective``
        is half the function that is minimised, see Notes.

    See Also
    --------
    inverse_filter : Division by the transfer function.
    tv_deconvolve : Non-negative deconvolution with total variation.

    Notes
    -----
    The filter minimises ``|A x + b - y|^2/sigma^2 + x' S^-1 x`` over the object x and background b,
    for the image y, image model A and noise sigma. S is the expected power spectrum of the object.
    It is proportional to 1/(f^2 + f_0^2) at spatial frequency f, as in natural scenes [1]_, with
    f_0 one cycle per longer side of the image. S is scaled such that the predicted variance of the
    image equals the measured variance minus that of the noise. If the image is uniform up to noise
    and no background is fitted, the mean square of the image takes the place of its variance.

    The equations of the minimum are solved by conjugate gradients, with the classical Wiener filter
    as preconditioner, which is the exact solution of a periodic image with uniform noise. If
    ``model.boundary`` is "padded", the object is assumed to be 0 outside the image, so that the
    edges cause no ringing.

    References
    ----------
    .. [1] Field, J. Opt. Soc. Am. A 4 (1987) 2379.
    """
    rule = stop_rule(max_iterations, tolerance)

    def solve(data: NoisyImage) -> dict[str, Any]:
        return solved(_NormalEquations(data, model, rule), start, progress)

    return reconstructed(solve, image, model)


def background_estimate(data: NoisyImage, model: ForwardModel | TorchForwardModel) -> float:
    """Return the fitted strength of the unknown background, image units; 0 if it is known.

    It is the background that explains what the image of the Wiener-filtered object leaves.
    """
    if not data.fit_background:
        return 0.0
    # The background is then within a tenth of the noise; fine detail takes ten times longer.
    problem = _NormalEquations(data, model, (300, 1e-4))
    return beside(data, run(problem).state.solution, problem.model)[0]


@dataclass(eq=False, kw_only=True)
class _Gradients(Iterate):
    """State of the conjugate gradients; ``left`` is the residual over the right-hand side."""

    solution: Tensor
    misfit: Tensor
    penalised: Tensor
    residual: Tensor
    direction: Tensor
    product: float = math.inf
    left: float


class _NormalEquations(Solver[_Gradients]):
    """Normal equations of the Wiener filter, with the background eliminated.

    The matrix is ``A' W A + sigma^2 S^-1`` for objects inside the frame, with image model A, pixel
    weights W and prior spectrum S. They are solved by preconditioned conjugate gradients.
    """

    name, every = "wiener", 1
    report = "Wiener filter: residual {left:.1e}"

    def __init__(
        self, data: NoisyImage, model: ForwardModel | TorchForwardModel, rule: tuple[int, float]
    ) -> None:
        self.max_iterations, self._tolerance = rule
        self.data = data
        self.model = model = torch_model(model, data.data.device, torch.float64)
        rows, columns = model.grid
        device = data.data.device
        # The mean transfer function of a field of point spreads is used for preconditioning and
        # for the scale of the prior.
        transfer = mean_transfer(model)
        power = transfer.real**2 + transfer.imag**2
        row_frequencies = torch.fft.fftfreq(rows, dtype=torch.float64, device=device)[:, None]
        column_frequencies = torch.fft.rfftfreq(columns, dtype=torch.float64, device=device)
        corner = 1.0 / max(model.shape)
        prior = 1.0 / (row_frequencies**2 + column_frequencies**2 + corner**2)
        twice = torch.from_numpy(half_spectrum_weights(columns)).to(device)
        of_mean = float(power[0, 0] * prior[0, 0])
        passed = total(power * prior * twice) - of_mean
        # The object's mean is not counted as variance of the prior.
        steady: Tensor | float = data.weighted_mean(data.data)
        if data.fit_background:
            steady = data.background(data.background_strength(data.data))
        elif data.is_noise_about(steady):  # only the mean is left to scale the prior
            steady, passed = 0.0, passed + of_mean
        if passed <= 1e-12 * of_mean:  # an even kernel over a periodic frame, or one pixel
            passed = of_mean
        # A detected object may be fainter than the error of the whole frame's mean square.
        excess = max(data.score(steady) ** 2 - 1.0, math.sqrt(2.0 / data.counted))
        # Parseval: sum |H|^2 S = samples * (summed variance of the image); S = strength * prior.
        samples = rows * columns
        strength = samples * data.counted * data.sigma**2 * excess / passed
        self._penalty = data.sigma**2 * samples / (strength * prior)
        self._preconditioner = 1.0 / (power + self._penalty)
        self._right_side = model.adjoint(self._cleaned(data.data))

    def init(self, first: Tensor | None) -> _Gradients:
        """Return the initial state; its object is zero if none is given."""
        solution = torch.zeros_like(self.data.data) if first is None else first.clone()
        seen, penalised = self.model(solution), self._filtered(solution, self._penalty)
        residual = self._right_side - self._normal(seen, penalised)
        return _Gradients(
            solution=solution,
            misfit=self.data.data - seen,
            penalised=penalised,
            residual=residual,
            direction=torch.zeros_like(residual),
            left=math.inf if bool(residual.any()) else 0.0,
        )

    def step(self, state: _Gradients) -> tuple[float, float, float]:
        """Minimise along the next direction; return objective, residual and change."""
        step = self._filtered(state.residual, self._preconditioner)
        state.direction, state.product = direction, product = conjugate_direction(
            state.residual, step, state.direction, state.product
        )
        seen = self.model(direction)
        penalised = self._filtered(direction, self._penalty)
        image = self._normal(seen, penalised)
        length = product / total(direction * image)
        state.solution += length * direction
        state.misfit -= length * seen
        state.penalised += length * penalised
        state.residual = state.residual - length * image
        state.left = norm(state.residual) / norm(self._right_side)
        squared = max(total(self._cleaned(state.misfit) * state.misfit), 0.0)
        prior = total(state.solution * state.penalised)
        return (
            0.5 * (squared + prior) / self.data.sigma**2,
            math.sqrt(squared / self.data.counted) / self.data.sigma,
            abs(length) * float(direction.norm() / state.solution.norm()),
        )

    def done(self, state: _Gradients) -> bool:
        """Return whether the residual of the normal equations is below the tolerance."""
        return state.left <= self._tolerance

    def level(self, state: _Gradients) -> Tensor:
        """Return the object (H, W) in image units."""
        return state.solution

    def fraction(self, state: _Gradients) -> float:
        """Return the completed fraction, of the fall of the residual or of the iterations."""
        fallen = math.log(min(state.left, 1.0)) / math.log(self._tolerance)
        return max(fallen, super().fraction(state))

    def answer(self, found: Run[_Gradients], level: Tensor) -> dict[str, Any]:
        """Return the background that fits best beside the object."""
        return {"background": beside(self.data, level, self.model)[0]}

    def _cleaned(self, image: Tensor) -> Tensor:
        """Return the weighted image minus its best-fitting background."""
        image = image - self.data.background(self.data.background_strength(image))
        cleaned: Tensor = self.data.weighted(image)
        return cleaned

    def _normal(self, seen: Tensor, penalised: Tensor) -> Tensor:
        """Return the matrix times an object, given its image and ``sigma^2 S^-1`` times it."""
        return self.model.adjoint(self._cleaned(seen)) + penalised

    def _filtered(self, picture: Tensor, response: Tensor) -> Tensor:
        rows, columns = self.model.shape
        grid = self.model.grid
        filtered: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture, s=grid) * response, s=grid)
        return filtered[:rows, :columns]
