"""Object step of total variation for point spreads over a field, by conjugate gradients."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..data.arrays import total

Array = NDArray[Any]


def conjugate_direction(
    residual: Array, step: Array, direction: Array, last: float
) -> tuple[Array, float]:
    """Return the next direction of preconditioned conjugate gradients, and its product.

    ``step`` is the preconditioned residual, and the product that of residual and ``step``. Before
    the first step ``direction`` is zero and ``last``, the product of the last step, is infinite.
    """
    product = total(residual * step)
    return step + (product / last) * direction, product


class FieldStep:
    """Solver of the linear object step for a field of point spreads.

    It minimises ``p |A x - a|^2 + x' R x - 2 x' b`` over objects x, where A is the convolution with
    the field on the whole FFT grid and R is diagonal in Fourier space. Outside the frame, where the
    final object is zero, each weight of the field is replaced by its mean. ``weights`` (K, H, W)
    and ``transfer`` (K, rows, columns//2 + 1) are those of the image model. ``prototype`` is an
    array on the FFT grid, (rows, columns), in the precision of the computation.
    """

    def __init__(self, weights: Array, transfer: Array, prototype: Array) -> None:
        rows, columns = weights.shape[-2:]
        self._weights = np.empty((len(weights), *prototype.shape), prototype.dtype)
        self._weights[...] = weights.mean((-2, -1))[:, None, None]
        self._weights[:, :rows, :columns] = weights
        self._transfer = transfer.astype(fft.rfft2(prototype).dtype)

    def solve(
        self,
        image: Array,
        pull: Array,
        penalty: float,
        rest: Array,
        inverse: Array,
        start: tuple[Array, Array],
    ) -> tuple[Array, Array]:
        """Return the minimising object and its image, both on the FFT grid, (rows, columns).

        ``image``, ``pull`` and ``penalty`` are a, b and p; ``rest`` and ``inverse``, (rows,
        columns//2 + 1), the half spectra of R and of the preconditioner, which is positive.
        ``start`` is an earlier result.
        """
        free, seen = start[0] + 0.0, start[1] + 0.0
        residual = penalty * self._adjoint(image - seen) + pull - _filtered(free, rest)
        direction, product, goal = 0.0 * free, math.inf, 0.0
        # each solve starts from the previous object, which changes little
        for number in range(6):
            step = _filtered(residual, inverse)
            direction, product = conjugate_direction(residual, step, direction, product)
            goal = goal if number else 0.1**2 * product
            if product <= goal or product == 0.0:
                break
            moved = self._forward(direction)
            turned = penalty * self._adjoint(moved) + _filtered(direction, rest)
            length = product / total(direction * turned)
            free += length * direction
            seen += length * moved
            residual = residual - length * turned
        return free, seen

    def _forward(self, picture: Array) -> Array:
        parts = fft.rfft2(self._weights * picture) * self._transfer
        image: Array = fft.irfft2(parts.sum(0), picture.shape)
        return image

    def _adjoint(self, image: Array) -> Array:
        spectra = fft.rfft2(image) * self._transfer.conj()
        picture: Array = (fft.irfft2(spectra, image.shape) * self._weights).sum(0)
        return picture


def _filtered(picture: Array, response: Array) -> Array:
    filtered: Array = fft.irfft2(fft.rfft2(picture) * response, picture.shape)
    return filtered
