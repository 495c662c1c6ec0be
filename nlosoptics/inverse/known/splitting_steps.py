"""Elementwise steps of the splitting for total variation.

An iteration of the method of multipliers (ADMM) consists of Fourier transforms and of these steps.
Arrays are changed in place. ``free`` and ``seen`` are the object and its image that solve the
quadratic part, on the FFT grid (rows, columns), whose first corner is the frame (H, W). New values
are over-relaxed: moved `RELAXATION` times as far from the old ones.
"""

# ruff: noqa: D102  (the methods of KernelSteps are those of Steps)

from __future__ import annotations

import numpy as np

from ..data.arrays import Values, library, total
from . import _splitting_kernels as kernels
from ._splitting_kernels import RELAXATION, TINY


def gradient(picture: Values) -> Values:
    """Return periodic forward differences along y and x, (2, rows, columns)."""
    here = library(picture)
    return here.stack([here.roll(picture, -1, axis) - picture for axis in (0, 1)])


class Steps:
    """Steps on tensors or arrays.

    ``image``, ``shape`` and ``weights``, (H, W), are the measured image, the background's shape and
    the weights of the pixels. In methods, ``level`` is the background's strength and ``ratio`` the
    multiplier over the data penalty: a pixel keeps 1/(1 + ratio weight) of its misfit.
    """

    def __init__(self, image: Values, shape: Values, weights: Values) -> None:
        self.measured = image, shape, weights
        self.frame = tuple(slice(None, length) for length in image.shape)

    @staticmethod
    def pull(
        edges: Values,
        edge_dual: Values,
        edge_penalty: float,
        signed: Values,
        sign_dual: Values,
        sign_penalty: float,
        out: Values,
    ) -> None:
        """Compute what targets ask of the object: their transposes times their penalties.

        The targets are those of its gradients (2, rows, columns) and of its values, each with dual
        and penalty.
        """
        y, x = edges - edge_dual
        roll = library(y).roll
        out[...] = edge_penalty * (roll(y, 1, 0) - y + roll(x, 1, 1) - x)
        out += sign_penalty * (signed - sign_dual)

    @staticmethod
    def mix(
        image: Values, pull: Values, filtered: Values, inverse: Values, transfer: Values
    ) -> None:
        """Turn the half spectra of target image and pull into those of ``free`` and ``seen``."""
        image[...] = filtered * image + inverse * pull
        pull[...] = transfer * image

    def shrink_edges(self, free: Values, edges: Values, edge_dual: Values, most: float) -> float:
        """Shorten the gradients of an object by ``most``; return their total variation."""
        moved = edges + RELAXATION * (gradient(free) - edges) + edge_dual
        length = library(free).sqrt((moved * moved).sum(0))
        left = (length - most).clip(0.0, None)
        edges[...] = moved * (left / length.clip(TINY, None))
        edge_dual[...] = moved - edges
        return total(left)

    def keep_positive(
        self, free: Values, signed: Values, sign_dual: Values
    ) -> tuple[float, float, float]:
        """Set the object that is non-negative, and zero outside the frame.

        Returns the sums of squares of the object, of its change and of ``free`` minus the object.
        """
        moved = signed + RELAXATION * (free - signed) + sign_dual
        new = 0.0 * moved
        new[self.frame] = moved[self.frame].clip(0.0, None)
        sums = total(new**2), total((new - signed) ** 2), total((free - new) ** 2)
        sign_dual[...] = moved - new
        signed[...] = new
        return sums

    def relax_image(
        self, seen: Values, predicted: Values, dual: Values, level: float, ratio: float
    ) -> tuple[float, float]:
        """Move the predicted image, and add the dual (H, W).

        Returns the sum of squares of the misfit before, and the best strength of the background.
        """
        image, shape, weights = self.measured
        misfit = seen[self.frame] + level * shape - image
        predicted += RELAXATION * (seen - predicted)
        predicted[self.frame] += dual
        part = weights * shape / (1.0 + ratio * weights)
        # a veil can be dark in all pixels that count
        best = total(part * (image - predicted[self.frame])) / (total(part * shape) or 1.0)
        return total(weights * misfit * misfit), best

    def weigh_misfit(self, predicted: Values, level: float, ratio: float) -> tuple[float, float]:
        """Return the sum of squares of what is kept of the misfit, and minus half its slope.

        The slope is the derivative with respect to ``ratio``.
        """
        image, shape, weights = self.measured
        kept = 1.0 / (1.0 + ratio * weights)
        part = weights * (kept * (predicted[self.frame] + level * shape - image)) ** 2
        return total(part), total(part * kept * weights)

    def split_misfit(self, predicted: Values, dual: Values, level: float, ratio: float) -> None:
        """Leave what is kept of the misfit in the predicted image, and the rest in the dual."""
        image, shape, weights = self.measured
        misfit = predicted[self.frame] + level * shape - image
        dual[...] = misfit - misfit / (1.0 + ratio * weights)
        predicted[self.frame] -= dual


class KernelSteps(Steps):
    """`Steps` on numpy arrays, by kernels; ``columns`` is the width of the FFT grid."""

    pull = staticmethod(kernels.pull)
    mix = staticmethod(kernels.mix)

    def __init__(self, image: Values, shape: Values, weights: Values, columns: int) -> None:
        super().__init__(image, shape, weights)
        self._right = np.empty(columns, image.dtype)
        self._sums = np.empty((3, columns))

    def _summed(self, kernel: Values, *arguments: Values) -> list[float]:
        """Call a kernel; return its sums."""
        self._sums[...] = 0.0
        kernel(*arguments, self._sums)
        sums: list[float] = self._sums.sum(axis=1).tolist()
        return sums

    def shrink_edges(self, free: Values, edges: Values, edge_dual: Values, most: float) -> float:
        return self._summed(kernels.shrink_edges, free, edges, edge_dual, most, self._right)[0]

    def keep_positive(
        self, free: Values, signed: Values, sign_dual: Values
    ) -> tuple[float, float, float]:
        high, wide = self.measured[0].shape
        size, change, distance = self._summed(
            kernels.keep_positive, free, signed, sign_dual, high, wide
        )
        return size, change, distance

    def relax_image(
        self, seen: Values, predicted: Values, dual: Values, level: float, ratio: float
    ) -> tuple[float, float]:
        square, above, below = self._summed(
            kernels.relax_image, seen, predicted, dual, *self.measured, level, ratio
        )
        return square, above / (below or 1.0)

    def weigh_misfit(self, predicted: Values, level: float, ratio: float) -> tuple[float, float]:
        square, slope, _ = self._summed(
            kernels.weigh_misfit, predicted, *self.measured, level, ratio
        )
        return square, slope

    def split_misfit(self, predicted: Values, dual: Values, level: float, ratio: float) -> None:
        kernels.split_misfit(predicted, dual, *self.measured, level, ratio)
