"""Noise of each pixel of a camera image, from the image and what the scene file says of the camera.

The expected light of a pixel is the mean of the reading around it, with a Gaussian window of 1.5
pixels. The noise of the pixel itself has little weight in it, so that a pixel does not count for
more because its reading is low.
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ..imaging import CameraImage, ForwardModel
from ..imaging.images import reading_noise, room_light
from ..inverse.data.noise import estimate_noise, surrounded
from ..scene import Scene

Array = NDArray[np.float64]


def electron_noise(scene: Scene, electrons: Array) -> Array:
    """Return the rms noise of each pixel of a reading in electrons, dark current subtracted."""
    return reading_noise(scene, _local_mean(electrons), room_light(scene))


def camera_noise(scene: Scene, image: CameraImage, model: ForwardModel) -> Array | None:
    """Estimate the noise of each pixel (ny, nx) of a camera image, in counts; infinite if masked.

    The image, minus its dark frame, gives the mean noise, and the camera its dependence on the
    light. The electrons per count follow from both, since they need not be known for an image file.
    The noise is uniform if no number of electrons per count explains the mean, and None if there is
    none.
    """
    values = surrounded(image.values, image.masked)
    sigma = estimate_noise(values, model)
    if sigma == 0.0:
        return None
    light, room = _local_mean(values), room_light(scene)

    def noise(gain: float) -> Array:
        """Noise in counts for a number of electrons per count."""
        return reading_noise(scene, gain * light, room) / gain

    # Photon noise in counts falls with the electrons per count, so that the mean noise does too.
    low, high = math.log(1e-6), math.log(1e6)
    found = np.full(values.shape, sigma)
    if np.mean(noise(math.exp(high)) ** 2) < sigma**2 < np.mean(noise(math.exp(low)) ** 2):
        for _ in range(50):
            middle = 0.5 * (low + high)
            if np.mean(noise(math.exp(middle)) ** 2) > sigma**2:
                low = middle
            else:
                high = middle
        found = noise(math.exp(low))
    return np.where(image.masked, np.inf, found)


def _local_mean(values: Array) -> Array:
    return np.maximum(scipy.ndimage.gaussian_filter(values, 1.5), 0.0)
