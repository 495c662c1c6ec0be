"""Elementwise steps of the splitting for total variation, by kernels.

An iteration of the method of multipliers (ADMM) consists of Fourier transforms and of these steps.
Arrays are changed in place. ``free`` and ``seen`` are the object and its image that solve the
quadratic part, on the FFT grid (rows, columns), whose first corner is the frame (H, W). New values
are over-relaxed: moved `RELAXATION` times as far from the old ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _splitting_kernels as kernels

Array = NDArray[Any]


def gradient(picture: Array) -> Array:
    """Return periodic forward differences along y and x, (2, rows, columns)."""
    return np.stack([np.roll(picture, -1, axis) - picture for axis in (0, 1)])


class Steps:
    """Steps for one measured image, on an FFT grid of ``columns`` columns.

    ``image``, ``shape`` and ``weights``, (H, W), are the measured image, the background's shape and
    the weights of the pixels. In methods, ``level`` is the background's strength and ``ratio`` the
    multiplier over the data penalty: a pixel keeps 1/(1 + ratio weight) of its misfit.
    """

    def __init__(self, image: Array, shape: Array, weights: Array, columns: int) -> None:
        self._measured = image, shape, weights
        self._right = np.empty(columns, image.dtype)
        self._sums = np.empty((3, columns))

    def _summed(self, kernel: Any, *arguments: Any) -> list[float]:
        """Call a kernel; return its sums."""
        self._sums[...] = 0.0
        kernel(*arguments, self._sums)
        sums: list[float] = self._sums.sum(axis=1).tolist()
        return sums

    def shrink_edges(self, free: Array, edges: Array, edge_dual: Array, most: float) -> float:
        """Shorten the gradients of an object by ``most``; return their total variation."""
        return self._summed(kernels.shrink_edges, free, edges, edge_dual, most, self._right)[0]

    def keep_positive(self, free: Array, signed: Array, sign_dual: Array) -> list[float]:
        """Set the object that is non-negative, and zero outside the frame.

        Returns the sums of squares of the object, of its change and of ``free`` minus the object.
        """
        frame = self._measured[0].shape
        return self._summed(kernels.keep_positive, free, signed, sign_dual, *frame)

    def relax_image(
        self, seen: Array, predicted: Array, dual: Array, level: float, ratio: float
    ) -> tuple[float, float]:
        """Move the predicted image, and add the dual (H, W).

        Returns the sum of squares of the misfit before, and the best strength of the background.
        """
        square, above, below = self._summed(
            kernels.relax_image, seen, predicted, dual, *self._measured, level, ratio
        )
        return square, above / (below or 1.0)  # a veil can be dark in all pixels that count

    def weigh_misfit(self, predicted: Array, level: float, ratio: float) -> tuple[float, float]:
        """Return the sum of squares of what is kept of the misfit, and minus half its slope.

        The slope is the derivative with respect to ``ratio``.
        """
        square, slope, _ = self._summed(
            kernels.weigh_misfit, predicted, *self._measured, level, ratio
        )
        return square, slope

    def split_misfit(self, predicted: Array, dual: Array, level: float, ratio: float) -> None:
        """Leave what is kept of the misfit in the predicted image, and the rest in the dual."""
        kernels.split_misfit(predicted, dual, *self._measured, level, ratio)
