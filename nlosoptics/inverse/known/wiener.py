"""Wiener deconvolution of a framed image."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ...psf import PointSpread
from ..data.arrays import half_spectrum_weights, norm, total
from ..data.driver import History, Solver, run, solved, started_from, stop_rule
from ..data.models import mean_transfer
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside
from .field_step import conjugate_direction
from .photographs import fitted

Array = NDArray[np.float64]


def wiener(
    image: Any,
    model: ForwardModel | PointSpread | Array,
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
    image equals the measured variance minus that of the noise; if no background is fitted, mean
    squares take the place of variances.

    The equations of the minimum are solved by conjugate gradients, with the classical Wiener filter
    as preconditioner, which is the exact solution of a periodic image with uniform noise. If
    ``model.boundary`` is "padded", the object is assumed to be 0 outside the image, so that the
    edges cause no ringing.

    References
    ----------
    .. [1] Field, J. Opt. Soc. Am. A 4 (1987) 2379.
    """
    rule = stop_rule(max_iterations, tolerance)

    def fit(data: NoisyImage, model: ForwardModel) -> dict[str, Any]:
        return solved(_NormalEquations(data, model, rule, start), progress)

    return fitted(fit, image, model)


def background_estimate(data: NoisyImage, model: ForwardModel) -> float:
    """Return the fitted strength of the unknown background, image units; 0 if it is known.

    It is the background that explains what the image of the Wiener-filtered object leaves.
    """
    if not data.fit_background:
        return 0.0
    # The background is then within a tenth of the noise; fine detail takes ten times longer.
    problem = _NormalEquations(data, model, (300, 1e-4))
    run(problem)
    return beside(data, problem.solution, model)[0]


class _NormalEquations(Solver):
    """Normal equations of the Wiener filter, with the background eliminated.

    The matrix is ``A' W A + sigma^2 S^-1`` for objects inside the frame, with image model A, pixel
    weights W and prior spectrum S. They are solved by preconditioned conjugate gradients; ``left``
    is the residual over the right-hand side.
    """

    every = 1
    report = "Wiener filter: residual {left:.1e}"

    def __init__(
        self, data: NoisyImage, model: ForwardModel, rule: tuple[int, float], start: Any = None
    ) -> None:
        self.max_iterations, self._tolerance = rule
        self.data, self.model = data, model
        rows, columns = model.grid
        # The mean transfer function of a field of point spreads is used for preconditioning and
        # for the scale of the prior.
        transfer = mean_transfer(model)
        power = transfer.real**2 + transfer.imag**2
        squares = np.fft.fftfreq(rows)[:, None] ** 2 + np.fft.rfftfreq(columns) ** 2
        prior = 1.0 / (squares + (1.0 / max(model.shape)) ** 2)
        passed = power * prior * half_spectrum_weights(columns)
        of_mean, steady = float(passed[0, 0]), 0.0 * data.data
        if data.fit_background:  # the object's mean is not counted as variance of the prior
            steady, passed[0, 0] = data.background(data.background_strength(data.data)), 0.0
        # an even kernel over a periodic frame, or one pixel
        light = total(passed) if total(passed) > 1e-12 * of_mean else of_mean
        # A detected object may be fainter than the error of the whole frame's mean square.
        excess = max(data.score(steady) ** 2 - 1.0, math.sqrt(2.0 / data.counted))
        # Parseval: sum |H|^2 S = samples * (summed variance of the image); S = strength * prior.
        self._penalty = light / (data.counted * excess * prior)
        self._preconditioner = 1.0 / (power + self._penalty)
        self._right_side = model.adjoint(self._cleaned(data.data))
        solution = 0.0 * data.data if start is None else started_from(start, model.shape)
        seen, self._penalised = model.forward(solution), self._filtered(solution, self._penalty)
        self._residual = self._right_side - self._normal(seen, self._penalised)
        self.solution, self._misfit = solution, data.data - seen
        self._direction, self._product = 0.0 * self._residual, math.inf
        self.left = math.inf if bool(self._residual.any()) else 0.0

    def step(self) -> tuple[float, float, float]:
        """Minimise along the next direction; return objective, residual and change."""
        step = self._filtered(self._residual, self._preconditioner)
        self._direction, self._product = direction, product = conjugate_direction(
            self._residual, step, self._direction, self._product
        )
        seen = self.model.forward(direction)
        penalised = self._filtered(direction, self._penalty)
        image = self._normal(seen, penalised)
        length = product / total(direction * image)
        self.solution += length * direction
        self._misfit -= length * seen
        self._penalised += length * penalised
        self._residual = self._residual - length * image
        self.left = norm(self._residual) / norm(self._right_side)
        squared = max(total(self._cleaned(self._misfit) * self._misfit), 0.0)
        prior = total(self.solution * self._penalised)
        return (
            0.5 * (squared + prior) / self.data.sigma**2,
            math.sqrt(squared / self.data.counted) / self.data.sigma,
            abs(length) * norm(direction) / max(norm(self.solution), 1e-300),
        )

    def done(self) -> bool:
        """Return whether the residual of the normal equations is below the tolerance."""
        return self.left <= self._tolerance

    def level(self) -> Array:
        """Return the object (H, W) in image units."""
        return self.solution

    def fraction(self) -> float:
        """Return the completed fraction, of the fall of the residual or of the iterations."""
        return max(math.log(min(self.left, 1.0)) / math.log(self._tolerance), super().fraction())

    def answer(self, level: Array, history: History) -> dict[str, Any]:
        """Return the background that fits best beside the object."""
        return {"background": beside(self.data, level, self.model)[0]}

    def _cleaned(self, image: Array) -> Array:
        """Return the weighted image minus its best-fitting background."""
        return self.data.weighted(
            image - self.data.background(self.data.background_strength(image))
        )

    def _normal(self, seen: Array, penalised: Array) -> Array:
        """Return the matrix times an object, given its image and ``sigma^2 S^-1`` times it."""
        return self.model.adjoint(self._cleaned(seen)) + penalised

    def _filtered(self, picture: Array, response: Array) -> Array:
        rows, columns = self.model.shape
        spectrum = scipy.fft.rfft2(picture, self.model.grid) * response
        filtered: Array = scipy.fft.irfft2(spectrum, self.model.grid)
        return filtered[:rows, :columns]
