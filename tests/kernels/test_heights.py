"""Heights of walls, with and without the kinds of terms that need tables."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics.kernels import heights
from nlosoptics.scene import ConcaveWall, ConvexWall, FacetWall, GaussianWall, SumWall, WavyWall

SIZE = (1.0, 1.0)
SMOOTH = SumWall(
    ConcaveWall(3.0, size=SIZE),
    ConvexWall(4.0, size=SIZE, shape="cylinder"),
    WavyWall(1e-3, 0.2, direction=0.4, size=SIZE),
    size=SIZE,
)


def test_heights_without_tables_have_the_same_bits() -> None:
    """Without tables numba compiles a part of the function; its results must not change."""
    terms, tables = SMOOTH.compiled()
    assert heights.tables_for(terms, tables) is None
    x, y = np.random.default_rng(0).uniform(-0.6, 0.6, (2, 1000))
    found, expected = np.empty((2, 1000, 6))
    heights.surfaces(terms, None, x, y, found)
    heights.surfaces(terms, tables, x, y, expected)
    assert np.isfinite(expected).all()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("relief", [FacetWall(0.01, 0.02), GaussianWall(1e-3, 0.05)])
def test_reliefs_keep_their_tables(relief) -> None:
    """Reliefs store no samples, but belong to the kinds that are compiled with tables."""
    terms, tables = SumWall(SMOOTH, relief, size=SIZE).compiled()
    assert heights.tables_for(terms, tables) is tables
