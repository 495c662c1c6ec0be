"""Directions of preconditioned conjugate gradients."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

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
