"""Ratios of image area to pupil area over cells of rays, against plain sums over their corners."""

import numpy as np
from pytest import approx

from nlosoptics.psf.wave._wave_kernels import patch_jacobian_extremes


def test_patches_of_unequal_cells():
    """Cells of random corners, each with an area of its own; the outermost rays do not count."""
    rng = np.random.default_rng(2)
    patches, rows, columns = 3, 5, 6
    x = np.arange(rows)[:, None] + 0.3 * rng.random((patches, rows, columns))
    y = np.arange(columns) + 0.3 * rng.random((patches, rows, columns))
    areas = rng.uniform(0.5, 4.0, (patches, rows - 3, columns - 3))
    ratios = []
    for p, i, j in np.ndindex(areas.shape):
        # corners in turn around the cell, whose area is the shoelace sum
        turn = [(i + 1, j + 1), (i + 1, j + 2), (i + 2, j + 2), (i + 2, j + 1)]
        u, v = (np.array([a[p, k, m] for k, m in turn]) for a in (x, y))
        twice = (u * np.roll(v, -1) - v * np.roll(u, -1)).sum()
        ratios.append(twice / areas[p, i, j])
    assert patch_jacobian_extremes(x, y, areas) == approx((min(ratios), max(ratios)), rel=1e-12)
