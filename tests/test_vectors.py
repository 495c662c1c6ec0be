"""Products of matrices whose bits do not depend on the number of threads."""

import numpy as np
import pytest

from nlosoptics._vectors import product


@pytest.mark.parametrize("shape", [(3, 4, 5, 6), (2, 90, 80, 70)])
def test_products_in_blocks_are_products(shape):
    batch, rows, inner, columns = shape
    draw = np.random.default_rng(1)
    left, right = draw.normal(size=(batch, rows, inner)), draw.normal(size=(inner, columns))
    expected = np.einsum("bri,ic->brc", left, right)
    # rounding of sums of at most 80 terms of order 1
    assert np.abs(product(left, right) - expected).max() < 1e-12
    other = draw.normal(size=(batch, inner, columns))
    expected = np.einsum("ri,bic->brc", left[0], other)
    assert np.abs(product(left[0], other) - expected).max() < 1e-12
