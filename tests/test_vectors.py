"""Products of matrices whose bits do not depend on the number of threads."""

import numpy as np
import pytest

from nlosoptics._vectors import BLOCK_PRODUCT, product, product_into, row_blocks


@pytest.mark.parametrize(("rows", "columns", "inner"), [(1, 2, 2), (128, 512, 34), (7, 8000, 901)])
def test_product_blocks_hold_every_row(rows, columns, inner):
    blocks = row_blocks(rows, columns, inner)
    assert [i for start, stop in blocks for i in range(start, stop)] == list(range(rows))
    longest = max(stop - start for start, stop in blocks)
    assert longest == 1 or longest * columns * inner <= BLOCK_PRODUCT


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


@pytest.mark.parametrize("shape", [(3, 5, 7), (130, 700, 90), (900, 64, 5), (1, 300, 4000)])
def test_products_into_an_array_are_products(shape):
    rows, inner, columns = shape
    rng = np.random.default_rng(2)
    left, right = rng.normal(size=(2, rows, inner)), rng.normal(size=(inner, columns))
    out = np.full((2, rows, columns + 3), np.nan)[
        :, :, 2:-1
    ]  # neither axis is contiguous as a whole
    product_into(left, right, out)
    assert np.abs(out - left @ right).max() < 1e-11  # rounding of 700 terms of order 1
