"""Products of many vectors or matrices, and views for compiled kernels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Multiplications per block of a matrix product. OpenBLAS shares larger products among threads, and
#: the rounding would then depend on their number.
BLOCK_PRODUCT = 2**18


def dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> Any:
    """Return the scalar products (...) of vectors (..., 3); shapes broadcast.

    A numpy sum over an axis of length 3 gives the same bits but takes 18 times as long.
    """
    total = a[..., 0] * b[..., 0]
    total += a[..., 1] * b[..., 1]
    total += a[..., 2] * b[..., 2]
    return total


def row_blocks(rows: int, columns: int, inner: int) -> list[tuple[int, int]]:
    """Divide the rows of a product into blocks of at most `BLOCK_PRODUCT` multiplications.

    ``inner`` is the number of terms of each sum.
    """
    step = max(1, BLOCK_PRODUCT // max(columns * inner, 1))
    return [(start, min(start + step, rows)) for start in range(0, rows, step)]


def product(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``left @ right`` with the same bits for any number of threads.

    Leading axes broadcast as in `numpy.matmul`.
    """
    rows, inner, columns = *left.shape[-2:], right.shape[-1]
    if rows * inner * columns <= BLOCK_PRODUCT:
        return np.asarray(left @ right)
    blocks = row_blocks(rows, columns, inner)
    return np.concatenate([left[..., a:b, :] @ right for a, b in blocks], axis=-2)


def product_into(left: NDArray[Any], right: NDArray[Any], out: NDArray[Any]) -> None:
    """Fill ``out`` with ``left @ right`` by blocks that are nearly square.

    Leading axes broadcast, and the bits are the same for any number of threads. The last axis of
    ``out`` must be contiguous.
    """
    rows, inner, columns = *left.shape[-2:], right.shape[-1]
    most = max(BLOCK_PRODUCT // max(inner, 1), 64)
    tall = _even_step(rows, max(math.isqrt(most), most // max(columns, 1)))
    wide = _even_step(columns, max(most // tall, 1))
    for top in range(0, rows, tall):
        for start in range(0, columns, wide):
            here = ..., slice(top, top + tall), slice(start, start + wide)
            np.matmul(left[here[0], here[1], :], right[here[0], :, here[2]], out=out[here])


def _even_step(length: int, most: int) -> int:
    """Return the largest step up to ``most`` that divides a length into nearly equal parts."""
    return max(1, -(-length // -(-length // max(most, 1))))


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view.

    numba compiles a kernel once for arrays that can be written and once more for those that cannot;
    with such views it is compiled once.
    """
    view = array.view()
    view.flags.writeable = False
    return view
