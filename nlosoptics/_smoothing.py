"""Gaussian smoothing of images without scipy.ndimage, whose import takes 0.15 s."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def gaussian_smoothed(image: Array, sigma: float, *, truncate: float = 4.0) -> Array:
    """Return the convolution of an image with a Gaussian, continued by reflection at the edges.

    The result has the bits of ``scipy.ndimage.gaussian_filter``.

    Parameters
    ----------
    image : ndarray, (ny, nx)
        Image, float64.
    sigma : float
        Standard deviation of the Gaussian, pixels.
    truncate : float
        Radius at which the Gaussian is cut off, in standard deviations.

    Returns
    -------
    ndarray, (ny, nx)
    """
    radius = int(truncate * sigma + 0.5)
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 / (sigma * sigma) * offsets**2)
    weights /= weights.sum()
    for _ in range(2):  # along the first axis, then along the second
        padded = np.pad(image, ((radius, radius), (0, 0)), mode="symmetric")
        rows = len(image)
        smooth = padded[radius : radius + rows] * weights[radius]
        for step in range(radius, 0, -1):  # scipy's order, from the outside inwards
            pair = padded[radius - step :][:rows] + padded[radius + step :][:rows]
            pair *= weights[radius - step]
            smooth += pair
        image = smooth.T
    return np.ascontiguousarray(image)
