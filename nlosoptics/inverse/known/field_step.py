"""Object step of total variation for a point spread that varies over the field."""

from __future__ import annotations

import math

from ..data.arrays import Values, as_double, irfft2, like, rfft2, total
from .conjugate_gradients import conjugate_direction

# Factor by which each solve reduces the residual, within _MOST_STEPS steps and single precision. It
# starts from the previous object, which changes little.
_FALL = 0.1
_MOST_STEPS = 6


class FieldStep:
    """Solver of the linear object step for a field of point spreads.

    It minimises ``p |A x - a|^2 + x' R x - 2 x' b`` over objects x, where A is the convolution with
    the field on the whole FFT grid and R is diagonal in Fourier space. Outside the frame, where the
    final object is zero, each weight of the field is replaced by its mean. ``weights`` (K, H, W)
    and ``transfer`` (K, rows, columns//2 + 1) are those of the image model. ``prototype`` is an
    array on the FFT grid, (rows, columns), in the library and precision of the computation.
    """

    def __init__(self, weights: Values, transfer: Values, prototype: Values) -> None:
        rows, columns = weights.shape[-2:]
        means = weights.mean((-2, -1))[:, None, None]
        extended = means + 0.0 * as_double(prototype)
        extended[:, :rows, :columns] = weights
        self._weights = like(extended, prototype)
        self._transfer = like(transfer, rfft2(prototype))

    def solve(
        self,
        image: Values,
        pull: Values,
        penalty: float,
        rest: Values,
        inverse: Values,
        start: tuple[Values, Values],
    ) -> tuple[Values, Values]:
        """Return the minimising object and its image, both on the FFT grid, (rows, columns).

        ``image``, ``pull`` and ``penalty`` are a, b and p; ``rest`` and ``inverse``, (rows,
        columns//2 + 1), the half spectra of R and of the preconditioner, which is positive.
        ``start`` is an earlier result.
        """
        free, seen = start[0] + 0.0, start[1] + 0.0
        residual = penalty * self._adjoint(image - seen) + pull - _filtered(free, rest)
        direction, product, goal = 0.0 * free, math.inf, 0.0
        for number in range(_MOST_STEPS):
            step = _filtered(residual, inverse)
            direction, product = conjugate_direction(residual, step, direction, product)
            goal = goal if number else _FALL**2 * product
            if product <= goal or product == 0.0:
                break
            moved = self._forward(direction)
            turned = penalty * self._adjoint(moved) + _filtered(direction, rest)
            length = product / total(direction * turned)
            free += length * direction
            seen += length * moved
            residual = residual - length * turned
        return free, seen

    def _forward(self, picture: Values) -> Values:
        parts = rfft2(self._weights * picture) * self._transfer
        return irfft2(parts.sum(0), picture.shape[-1])

    def _adjoint(self, image: Values) -> Values:
        spectra = rfft2(image) * self._transfer.conj()
        return (irfft2(spectra, image.shape[-1]) * self._weights).sum(0)


def _filtered(picture: Values, response: Values) -> Values:
    return irfft2(rfft2(picture) * response, picture.shape[-1])
