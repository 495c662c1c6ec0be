"""Light beyond a window, against point spreads computed in wide windows."""

from __future__ import annotations

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.transform.wide_pixels import tail_pixels
from nlosoptics.psf.walls.diffraction_tail import _sides, field_with_tail, with_tail

WAVELENGTH, UNIT = 632.8e-9, 2 * 632.8e-9  # lambda N
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
TOL = 1e-9  # of the peak: thousands of faint pixels add up


def spread(waves, pitch, side, **options):
    wave = psf.Wavefront.from_zernike({j: w * WAVELENGTH for j, w in waves.items()}, **SYSTEM)
    return psf.point_spread(
        wave, pitch=pitch * UNIT, shape=side, pixel_integrated=True, tol=TOL, **options
    )


@pytest.mark.parametrize("shape", [(5, 5), (4, 6), (3, 8)])
def test_tail_carries_all_that_lies_beyond(shape):
    for side in (301, 1201):
        # beyond a square of half side h lies 4 sqrt(2)/h of 1/r^3
        a, b = ((n // 2 + 0.5, n - n // 2 - 0.5) for n in shape)
        total = sum(np.hypot(x, y) / (x * y) for x in a for y in b)
        found = tail_pixels((side, side), (a, b))
        # rounding of a closed form
        assert found.sum() == approx(1 - 8 * np.sqrt(2) / side / total, abs=1e-12)
        for row, column in ((3, 5), (-5, -3)):  # of either side, by quadrature
            y, x = side // 2 + row, side // 2 + column
            grid = (np.arange(100) + 0.5) / 100 - 0.5
            mean = np.mean(np.hypot(row + grid[:, None], column + grid) ** -3)
            # the midpoint rule's 1e-4 squared times the second derivative
            assert found[y, x] == approx(mean / total, rel=1e-4)
        assert found[side // 2, side // 2] == 0.0
        assert np.count_nonzero(found == 0.0) == shape[0] * shape[1]


@pytest.mark.thorough
@pytest.mark.parametrize("pitch", [2, 5])
@pytest.mark.parametrize("waves", [{}, {4: 0.15, 8: 0.08}], ids=["flat", "bent"])
def test_rings_of_the_tail_are_those_of_a_wide_window(waves, pitch):
    narrow, wide = (spread(waves, pitch, n) for n in (21, 201))
    found = with_tail(narrow, 201)
    assert found.intensity[90:111, 90:111] == approx(narrow.intensity, abs=0)
    y, x = np.indices(wide.shape) - 100
    rings = np.maximum(np.abs(x), np.abs(y))
    for near, far in ((11, 20), (21, 50), (51, 100)):
        ring = (rings >= near) & (rings <= far)
        # rays of the bent wave land some 8 lambda N out: more light near the inner window, and so
        # less farther out, in second order
        limit = 0.03 + (8 / (11 * pitch)) ** 2
        assert found.intensity[ring].sum() == approx(wide.intensity[ring].sum(), rel=limit)
    missing = 1 - narrow.enclosed_energy
    assert np.abs(found.intensity - wide.intensity).sum() < 0.15 * missing
    assert found.enclosed_energy == approx(wide.enclosed_energy, abs=0.05 * missing)


def test_field_carries_the_tails_of_its_points(flat_scene):
    field = psf.point_spread_field(flat_scene, 3, pitch=20e-6, checks=0)
    side = field.modes.shape[1] + 40
    wide = field_with_tail(field, side)
    for across, up in ((0.0, 0.0), (0.7, -0.4)):
        narrow = field.point_spread(across, up)
        found = wide.point_spread(across, up)
        margin = (side - len(narrow)) // 2
        inner = slice(margin, -margin)
        assert found[inner, inner] == approx(narrow, abs=1e-15)
        share = tail_pixels((side, side), _sides(narrow.shape)).sum()
        # missing light is interpolated as the weights are
        assert found.sum() - narrow.sum() == approx((1 - narrow.sum()) * share, rel=1e-6)


def test_window_is_as_wide_as_tol_and_image_ask():
    narrow = spread({}, 2, 21)
    missing = 1 - narrow.enclosed_energy
    found = psf.widened(narrow, tol=missing / 10, shape=(999, 999))
    assert found.shape[0] == approx(210, abs=2)
    assert 1 - found.enclosed_energy == approx(missing / 10, rel=0.05)
    assert psf.widened(narrow, tol=missing / 10, shape=(50, 40)).shape == (99, 99)
    assert psf.widened(narrow, tol=2 * missing, shape=(50, 40)) is narrow


def test_refuses():
    narrow = spread({}, 2, 21)
    with pytest.raises(SamplingError, match="unit-sum"):
        with_tail(spread({}, 2, 21, normalisation="ideal-peak"), 31)
    with pytest.raises(MemoryLimitError, match="larger tol, or an image of fewer pixels"):
        psf.widened(narrow, tol=1e-12, shape=(10**8, 10**8))
    rough = psf.mean_point_spread(
        psf.Wavefront.from_zernike({}, **SYSTEM),
        psf.Roughness(50e-9, 1e-3),
        footprint=0.5,
        cos_sum=2.0,
        pitch=2 * UNIT,
        shape=21,
        pixel_integrated=True,
    )
    with pytest.raises(SceneError, match="RoughPointSpread.* shape = 31"):
        with_tail(rough, 31)
