"""Two passes of a one-dimensional transform, and the intensity, without the whole field."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from .pixels import PixelRule

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Transforms the last axis of (rows, n) to (rows, m).
Pass = Callable[[ComplexArray], ComplexArray]

#: Memory of a block of rows, few enough to stay in the cache.
BLOCK_BYTES = 2**22


def intensity(
    values: ComplexArray,
    along_x: Pass,
    along_y: Pass,
    shape: tuple[int, int],
    rule: PixelRule | None,
) -> Array:
    """|transform|^2 of the given shape, averaged over pixels when a rule is given, (ny, nx).

    Columns are transformed in blocks and squared at once, so that the field of a wide window is
    never held.
    """
    ny, nx = shape
    rows = values.shape[0]
    half = np.empty((rows, nx), dtype=np.complex128)
    for block in _blocks(rows, nx):
        half[block] = along_x(values[block])
    strips = []
    for block in _blocks(nx, ny):
        strip = along_y(half[:, block].T)
        energy = strip.real**2 + strip.imag**2
        strips.append(energy if rule is None else rule.mean(energy))
    image = np.ascontiguousarray(np.concatenate(strips).T)
    return image if rule is None else rule.mean(image)


def _blocks(count: int, length: int) -> Iterator[slice]:
    step = max(1, BLOCK_BYTES // (16 * length))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))
