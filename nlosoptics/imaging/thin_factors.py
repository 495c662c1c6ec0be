"""Randomised singular value decomposition of an operator from cells to pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._random import generator

Array = NDArray[np.float64]


def thin_factors(operator: Any, tol: float) -> tuple[Array, Array]:
    """Return matrices of low rank whose product is an operator, see `WallTransport.factors`."""
    cells, pixels = operator.cell_shape, operator.pixel_shape
    n_pixels, n_cells = operator.shape
    count, most = 32, min(operator.shape)
    while True:
        count = min(2 * count, most)
        trial = generator(0, 611).standard_normal((count, *cells))
        base = np.linalg.qr(operator.forward(trial).reshape(count, n_pixels).T)[0]
        again = operator.adjoint(base.T.reshape(-1, *pixels))
        base = np.linalg.qr(operator.forward(again).reshape(-1, n_pixels).T)[0]
        small = operator.adjoint(base.T.reshape(-1, *pixels)).reshape(-1, n_cells)
        left, values, right = np.linalg.svd(small, full_matrices=False)
        rank = int(np.count_nonzero(values > tol * values[0]))
        # the last of the trial's values are too small
        if rank <= 0.8 * count or count == most:
            return base @ (left[:, :rank] * values[:rank]), right[:rank]
