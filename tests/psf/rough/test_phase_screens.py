"""Phase screens against sums by numpy on the same torus, and the sizes of their lattices."""

import math
from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx
from scipy import fft

from nlosoptics import psf
from nlosoptics._random import generator
from nlosoptics.errors import SceneError
from nlosoptics.psf.rough import phase_screens
from nlosoptics.psf.rough.view import RoughView

WAVELENGTH = 5.3e-7
FOOTPRINT = np.array([[0.7, 0.2], [-0.15, 0.45]])
DISTANCE = np.array([[0.6, 0.13], [0.13, 0.35]])
L = 1.3e-3


def view(s=1.7, autocorrelation="exponential", *, distance=DISTANCE, footprint=FOOTPRINT, length=L):
    return RoughView(psf.Roughness(1e-7, length, autocorrelation), footprint, s, distance)


def torus_lags(n, pitch):
    """Lags on the wall of a periodic lattice's steps, rows v."""
    steps = np.fft.fftfreq(n) * n * pitch
    u, v = np.meshgrid(steps, steps)
    wall = np.stack([u, v], axis=-1) @ FOOTPRINT.T
    return np.hypot(wall[..., 0], wall[..., 1])


@pytest.mark.parametrize("s", [0.0, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_widest_pitch(name, s):
    """1 - C is 1/9 between neighbours, and ``1/(9 s^2)`` of high roughness."""
    found = phase_screens.widest_pitch(view(s, name))
    if s == 0:
        assert found == math.inf
        return
    fall = -math.log1p(-1 / 9 / max(1.0, s**2))
    lag = L * (math.sqrt(fall) if name == "gaussian" else fall)
    assert found == approx(lag / np.linalg.svd(FOOTPRINT)[1][0], rel=1e-9)


@pytest.mark.parametrize(("cells", "pitch"), [(25, 2.1e-3), (34, 1.7e-3)], ids=["odd", "even"])
@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_spectrum_and_draw(name, cells, pitch):
    """White noise is filtered by the root of the torus's power, and the field is propagated."""
    seen = view(1.7, name)
    found = phase_screens.screens(seen, cells, pitch, WAVELENGTH, 1e-2)
    n = found.size
    power = np.fft.fft2(seen.roughness.correlation(torus_lags(n, pitch))).real
    power = np.maximum(power, 0)
    power *= n**2 / power.sum()  # the variance is 1
    assert_allclose(found.heights, np.sqrt(power[:, : n // 2 + 1]), atol=1e-7 * n)
    random = generator(11, 403)
    q = np.fft.fftfreq(n, pitch)
    qu, qv = np.meshgrid(q, q)
    d = np.linalg.inv(FOOTPRINT) @ DISTANCE @ np.linalg.inv(FOOTPRINT).T
    turn = d[0, 0] * qu**2 + 2 * d[0, 1] * qu * qv + d[1, 1] * qv**2
    for field in islice(found.draw(11), 2):
        waves = np.fft.fft2(random.standard_normal((n, n))) * np.sqrt(power)
        wall = np.exp(-1.7j * np.fft.ifft2(waves).real)
        delayed = np.fft.fft2(wall) * np.exp(-1j * math.pi * WAVELENGTH * turn)
        assert_allclose(field, np.fft.ifft2(delayed), atol=1e-6)
    assert math.pi * WAVELENGTH * abs(turn).max() > 0.1


def test_negative_power():
    """Just more of it than the limit is refused; less is left out, and the variance is kept."""
    pitch, found = 1.5e-3, []
    for share in (0.05, 0.6):

        def dome(r, share=share):
            return (1 - share) * np.exp(-((r / L) ** 2)) + share * np.where(
                r < 2 * L, 1 - (r / (2 * L)) ** 2, 0.0
            )

        seen = view(1.0, dome)
        independent = seen.roughness.reach(1e-6) * np.linalg.norm(np.linalg.inv(FOOTPRINT), 2)
        n = fft.next_fast_len(math.ceil(max(30 + independent / pitch, 2 * independent / pitch)))
        power = np.fft.fft2(dome(torus_lags(n, pitch))).real
        missing = -np.minimum(power, 0).sum() / n**2
        found.append(missing)
        if missing < 2e-3:
            screens = phase_screens.screens(seen, 30, pitch, WAVELENGTH, 0.0)
            kept = np.maximum(power, 0)
            kept *= n**2 / kept.sum()
            assert_allclose(screens.heights, np.sqrt(kept[:, : n // 2 + 1]), atol=1e-6 * n)
        else:
            with pytest.raises(
                SceneError, match=f"negative power, {missing:.2g} of the variance, limit 0.002, wh"
            ):
                phase_screens.screens(seen, 30, pitch, WAVELENGTH, 0.0)
    assert found[0] < 2e-3 < found[1]


def test_autocorrelation_that_does_not_end():
    with pytest.raises(SceneError, match="stays above 1e-06 up to 1000 correlation lengths; give"):
        phase_screens.screens(view(1.0, lambda r: 1 / (1 + r / L)), 9, 1e-3, WAVELENGTH, 0.0)


@pytest.mark.parametrize("s", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("pitch", [7e-5, 1.1e-4])
@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_stride(name, pitch, s):
    """The widest of the halved lattices whose band holds all but 1e-9 of the diffuse light."""
    seen = view(s, name, length=4e-3)
    cells = math.floor(phase_screens.widest_pitch(seen) / (1.5 * pitch))
    expected = 1
    while cells >= 4:
        fall = math.log(1e12)
        lag = 4e-3 * (math.sqrt(fall) if name == "gaussian" else fall)
        gap = lag * np.linalg.norm(np.linalg.inv(FOOTPRINT), 2)
        n = fft.next_fast_len(math.ceil(2 * gap / (cells * pitch)))
        light = np.exp(-(s**2) * seen.roughness.structure(torus_lags(n, cells * pitch)))
        light -= math.exp(-(s**2))
        waves = np.abs(np.fft.fft2(light))
        outer = np.abs(np.fft.fftfreq(n)) > 0.45
        if waves[outer].sum() + waves[:, outer].sum() <= 1e-9 * waves.sum():
            expected = cells
            break
        cells //= 2
    assert phase_screens.stride(seen, pitch) == expected


@pytest.mark.parametrize(("size", "cells", "count"), [(67, 3, 130), (64, 2, 128), (9, 4, 33)])
def test_interpolation_in_blocks(size, cells, count):
    """Plane waves of a lattice above and below the 64 lines that are interpolated at a time."""
    along = np.exp(2j * math.pi * 2 * np.arange(count) / (size * cells))
    across = np.exp(-2j * math.pi * 3 * np.arange(count) / (size * cells))
    j = np.arange(size) * cells
    lattice = np.exp(2j * math.pi * (2 * j - 3 * j[:, None]) / (size * cells))
    found = phase_screens.Between(size, cells, count)(lattice)
    assert_allclose(found, across[:, None] * along, atol=1e-12)
