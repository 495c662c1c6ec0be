"""Gaussian smoothing in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from nlosoptics._smoothing import gaussian_smoothed


@pytest.mark.parametrize("shape", [(64, 64), (37, 90), (5, 40), (1, 3)])
@pytest.mark.parametrize(("sigma", "truncate"), [(1.5, 4.0), (1.5, 3.5), (0.4, 4.0)])
def test_equals_scipy_bit_for_bit(shape: tuple[int, int], sigma: float, truncate: float) -> None:
    """Sums in another order would change last bits; small images are reflected several times."""
    image = np.random.default_rng(3).gamma(2.0, size=shape)
    before = image.copy()
    expected = ndimage.gaussian_filter(image, sigma, truncate=truncate, mode="reflect")
    assert np.array_equal(gaussian_smoothed(image, sigma, truncate=truncate), expected)
    assert np.array_equal(image, before)
