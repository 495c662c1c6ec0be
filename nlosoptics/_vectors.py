"""Types of arrays, products of many vectors or matrices, and views for compiled kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Multiplications per block of a matrix product. OpenBLAS shares larger products among threads, and
#: the rounding would then depend on their number.
BLOCK_PRODUCT = 2**18


def dot(a: Array, b: Array) -> Any:
    """Return the scalar products (...) of vectors (..., 3); shapes broadcast.

    A numpy sum over an axis of length 3 gives the same bits but takes 18 times as long.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def product(left: Array, right: Array) -> Array:
    """Return ``left @ right`` with the same bits for any number of threads.

    Leading axes broadcast as in `numpy.matmul`.
    """
    rows, inner, columns = *left.shape[-2:], right.shape[-1]
    if rows * inner * columns <= BLOCK_PRODUCT:
        return np.asarray(left @ right)
    step = max(1, BLOCK_PRODUCT // max(columns * inner, 1))
    blocks = [left[..., start : start + step, :] @ right for start in range(0, rows, step)]
    return np.concatenate(blocks, axis=-2)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view.

    numba compiles a kernel once for arrays that can be written and once more for those that cannot;
    with such views it is compiled once.
    """
    view = array.view()
    view.flags.writeable = False
    return view
