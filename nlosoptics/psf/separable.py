"""Two passes of a one-dimensional transform, and the intensity, without the whole field."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .pixels import PixelRule

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Transforms the last axis of (rows, n) to (rows, m).
Pass = Callable[[ComplexArray], ComplexArray]

BLOCK_BYTES = 2**24


def intensity(
    values: ComplexArray, along_x: Pass, along_y: Pass, rule: PixelRule | None
) -> Array:
    """|transform|^2, averaged over pixels when a rule is given, (ny, nx).

    Columns are transformed in blocks and squared at once, so that the field of a wide window is
    never held.
    """
    half = along_x(values)
    columns = half.shape[1]
    strips = []
    block = max(1, BLOCK_BYTES // (16 * max(half.shape[0], 1)))
    for start in range(0, columns, block):
        strip = along_y(np.ascontiguousarray(half[:, start : start + block].T))
        energy = strip.real**2 + strip.imag**2
        strips.append(energy if rule is None else rule.mean(energy))
    image = np.ascontiguousarray(np.concatenate(strips).T)
    return image if rule is None else rule.mean(image)
