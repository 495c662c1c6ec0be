"""Screens and views of given rough walls, point by point, and their closed forms."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx
from scipy import fft

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.rough import relief
from nlosoptics.psf.rough.relief import ReliefView
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.rough.view import RoughView
from nlosoptics.scene import FacetWall, GaussianWall, HeightMapWall

WAVELENGTH = 5.3e-7
FOOTPRINT = np.array([[0.7, 0.2], [-0.15, 0.45]])
DISTANCE = np.array([[0.6, 0.13], [0.13, 0.35]])
ORIGIN = np.array([4e-3, -7e-3])
AXES = np.array([[0.8, 0.3], [-0.35, 0.9]])
COS_SUM = 1.6


def map_wall():
    """Map of 0.04 x 0.06 m."""
    y, x = np.meshgrid(np.linspace(-1, 1, 49), np.linspace(-1, 1, 33), indexing="ij")
    return HeightMapWall(2e-7 * np.sin(3 * x + 1) * np.cos(4 * y) + 1e-7 * x, 0.04 / 32)


WALLS = {
    "facets": FacetWall(1.1e-3, 3e-4, seed=5),
    "bumps": GaussianWall(9e-8, 1.4e-3, seed=2),
    "map": map_wall(),
}


def view_of(wall, s=None):
    if s is None:
        s = 2 * math.pi / WAVELENGTH * COS_SUM * wall.height_rms
    return ReliefView(wall, FOOTPRINT, s, DISTANCE, ORIGIN, AXES)


@pytest.mark.parametrize("name", ["facets", "bumps"])
def test_heights_of_the_lattice(name):
    """Full heights over the points in use and the margin, which fall to 0 beyond it."""
    view, cells, pitch, centre = view_of(WALLS[name]), 11, 1.3e-3, 4.4
    screen = relief.relief_screen(view, cells, pitch, WAVELENGTH, centre)
    margin, band = relief.margins(view, pitch, WAVELENGTH)
    n = fft.next_fast_len(cells + 2 * (margin + band))
    assert (screen.size, screen.margin, screen.cells) == (n, margin, cells)
    half = (n - cells) // 2
    step = np.array([i if i < cells + half else i - n for i in range(n)])
    out = np.array([max(-i, i - cells + 1, margin) - margin for i in step])
    fall = np.array([math.cos(min(o / max(1, half - margin), 1) * math.pi / 2) ** 2 for o in out])
    m = AXES.T @ FOOTPRINT

    def height(i, j):
        p = ORIGIN + m @ (np.array([step[j], step[i]]) - centre) * pitch
        return float(WALLS[name].height(p[0], p[1]))

    base = height(cells // 2, cells // 2)
    found = screen.heights()
    for i, j in [(0, 0), (5, 5), (10, 3), *np.random.default_rng(1).integers(0, n, (40, 2))]:
        expected = (height(i, j) - base) * fall[i] * fall[j]
        assert found[i, j] == approx(expected, abs=1e-9 * np.abs(found).max())
    assert found[5, 5] == 0
    per_metre = 2 * math.pi / WAVELENGTH * COS_SUM
    field = np.exp(-1j * per_metre * found)
    assert fall.min() < 0.1
    q = np.fft.fftfreq(n, pitch)
    back = np.linalg.inv(FOOTPRINT)
    d = back @ DISTANCE @ back.T
    turn = d[0, 0] * q**2 + 2 * d[0, 1] * q * q[:, None] + d[1, 1] * q[:, None] ** 2
    field = np.fft.ifft2(np.fft.fft2(field) * np.exp(-1j * math.pi * WAVELENGTH * turn))
    assert_allclose(screen.field(), field, atol=1e-9)
    assert_allclose(next(screen.draw()), field, atol=1e-9)


def test_lattice_on_a_map():
    """Beyond the map, points that need full heights are refused; others take those of its edge."""
    wall = map_wall()
    view = view_of(wall)
    screen = relief.ReliefScreen(view, 30, 9, 2, 1.5e-3, WAVELENGTH, 4.0)
    m, found = AXES.T @ FOOTPRINT, screen.heights()
    step = np.array([i if i < 19 else i - 30 for i in range(30)])
    base = float(wall.height(*ORIGIN))
    for i, j in np.random.default_rng(3).integers(0, 30, (30, 2)):
        p = ORIGIN + m @ (np.array([step[j], step[i]]) - 4.0) * 1.5e-3
        p = np.clip(p, [-0.02 * (1 - 1e-12), -0.03 * (1 - 1e-12)], [0.02, 0.03])
        out = [max(-k, k - 8, 2) - 2 for k in (step[i], step[j])]
        fall = math.prod(math.cos(min(o / 8, 1) * math.pi / 2) ** 2 for o in out)
        expected = (float(wall.height(*np.minimum(p, [0.02 - 1e-12, 0.03 - 1e-12]))) - base) * fall
        assert found[i, j] == approx(expected, abs=1e-5 * np.abs(found).max())
    size = r"the height map of 0.04 x 0.06 m ends before x = .*, y = .* m, whose light reaches the"
    with pytest.raises(SceneError, match=size) as refusal:
        relief.ReliefScreen(view, 30, 9, 2, 6e-3, WAVELENGTH, 4.0).heights()
    x, y = (float(str(refusal.value).split(f"{c} = ")[1].split(" m")[0]) for c in "xy")
    assert abs(x) > 0.02 or abs(y) > 0.03
    for moved in ((0.0199, 0.0), (0.0, 0.0299), (-0.0199, 0.0), (0.0, -0.0299)):
        small = ReliefView(wall, 1e-3 * FOOTPRINT, 1.0, DISTANCE, np.array(moved), AXES)
        relief.ReliefScreen(small, 9, 9, 0, 1e-3, WAVELENGTH, 4.0).heights()
        out = ReliefView(wall, 1e-3 * FOOTPRINT, 1.0, DISTANCE, np.array(moved) * 1.01, AXES)
        with pytest.raises(SceneError, match="ends before"):
            relief.ReliefScreen(out, 9, 9, 0, 1e-3, WAVELENGTH, 4.0).heights()


@pytest.mark.parametrize("s", [0.0, 0.999, 1.001, 3.0])
@pytest.mark.parametrize("name", ["gaussian", "exponential"])
def test_transfer_of_statistics(name, s):
    """``exp(-s^2 (1 - C)) - exp(-s^2)`` over the lags of vectors in the pupil."""
    rough = psf.Roughness(1e-7, 1.2e-3, name)
    view = RoughView(rough, FOOTPRINT, s, DISTANCE)
    du, dv = np.array([[0.0, 1e-3, -2e-3]]), np.array([[1e-3, -1e-3, 5e-4]])
    lags = np.linalg.norm(FOOTPRINT @ np.stack([du.ravel(), dv.ravel()]), axis=0)[None]
    assert_allclose(view.lags(du, dv), lags, rtol=1e-12)
    c = np.exp(-((lags / 1.2e-3) ** (2 if name == "gaussian" else 1)))
    expected = np.exp(-(s**2) * (1 - c)) - math.exp(-(s**2))
    assert_allclose(view.scattered_transfer(du, dv), expected, atol=1e-14)
    assert_allclose(view.diffuse_transfer(lags), expected, atol=1e-14)
    assert view.coherent_fraction == approx(math.exp(-(s**2)), rel=1e-12)
    assert view.scattered_fraction == approx(1 - math.exp(-(s**2)), abs=1e-14)
    assert view.has_tails == (name == "exponential")
    assert view.length == 1.2e-3


WAVE = psf.Wavefront.from_zernike(
    {4: 2e-8}, wavelength=WAVELENGTH, pupil_radius=4e-3, image_distance=0.06
)


ROUGH = psf.Roughness(1e-7, 1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((WAVE, ROUGH, None, 2.0), "footprint is missing, but a wavefront does not hold the wall"),
        ((WAVE, ROUGH, 0.5, None), "cos_sum is missing, but a wavefront"),
        (("wave", ROUGH, 0.5, 2.0), "source is a str; give a Scene, or a Wavefront with its foot"),
        ((WAVE, "rough", 0.5, 2.0), "roughness is a str; give a Roughness, a FacetWall, a Gau"),
        ((WAVE, ROUGH, 0.5, 0.0), "cos_sum = 0 is out of range"),
        ((WAVE, ROUGH, 0.5, 2.001), "cos_sum = 2"),
        ((WAVE, ROUGH, [0.5, 0.5], 2.0), r"footprint has shape \(2,\); give a number or a finite"),
        ((WAVE, ROUGH, [[0.5, np.nan], [0, 1]], 2.0), r"footprint has shape \(2, 2\)"),
        ((WAVE, ROUGH, [[0.5, 1.0], [1.0, 2.0]], 2.0), "is singular; give an invertible matrix"),
        ((WAVE, ROUGH, 0.5, 2.0, [[1, 0.2], [0.2 + 2e-9, 1]]), "m is not symmetric; take it from"),
        ((WAVE, ROUGH, 0.5, 2.0, 0.0), "effective_distance = .* is singular"),
    ],
)
def test_refuses_a_source(given, message):
    with pytest.raises(SceneError, match=message):
        rough_source(*given)


def test_geometry_is_not_given_with_a_scene(flat_scene):
    for name in ("footprint", "cos_sum", "effective_distance"):
        given = dict.fromkeys(("footprint", "cos_sum", "effective_distance")) | {name: 1.0}
        with pytest.raises(SceneError, match=f"{name} is given with a scene, which defines it"):
            rough_source(flat_scene, ROUGH, **given)


@pytest.mark.parametrize("pattern", [True, False])
def test_source_of_a_scene(flat_scene, pattern):
    wall = WALLS["bumps"]
    source, seen = (
        rough_source(flat_scene, wall, None, None, pattern=pattern),
        psf.wall_view(flat_scene),
    )
    s = 2 * math.pi / 632.8e-9 * seen.cos_sum * wall.height_rms
    assert source.view.rayleigh_parameter == approx(s, rel=1e-12)
    assert_allclose(source.view.footprint, seen.footprint)
    assert_allclose(source.view.effective_distance, seen.effective_distance)
    assert source.refined(lambda one: one) is source.residual
    if pattern:
        assert_allclose(source.view.origin, seen.point[:2])
        assert_allclose(source.view.axes, seen.tangents[:, :2])
