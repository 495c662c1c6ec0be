"""Directions of preconditioned conjugate gradients."""

from __future__ import annotations

from ..data.arrays import Values, total


def conjugate_direction(
    residual: Values, step: Values, direction: Values, last: float
) -> tuple[Values, float]:
    """Return the next direction of preconditioned conjugate gradients, and its product.

    ``step`` is the preconditioned residual, and the product that of residual and ``step``. Before
    the first step ``direction`` is zero and ``last``, the product of the last step, is infinite.
    """
    product = total(residual * step)
    return step + (product / last) * direction, product
