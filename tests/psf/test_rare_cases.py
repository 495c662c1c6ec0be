"""Cases that few scenes reach: touching outlines, hidden mirror points, edges of data."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import CausticError, NlosError, SamplingError, SceneError
from nlosoptics.psf.aperture import curves
from nlosoptics.psf.pupil.aiming import stationary_points
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.walls.rough_wall import PupilField
from nlosoptics.scene import CallableWall, ConcaveWall, FacetWall, HeightMapWall

SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
SEEN = {"footprint": 0.5, "cos_sum": 1.8, "effective_distance": 0.4}
ROUGH = psf.Roughness(3e-8, 1e-3)


def wave(coefficients=((5, 5e-8),), **changes):
    return psf.Wavefront.from_zernike(dict(coefficients), **SYSTEM | changes)


def polygon(sides, apothem, turn, centre):
    """Corners of a regular polygon about a circle."""
    angles = turn + 2 * math.pi * np.arange(sides) / sides
    far = apothem / math.cos(math.pi / sides)
    return np.array(centre) + far * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@pytest.mark.parametrize("sides", [3, 4, 6, 7])
def test_a_polygon_that_touches_a_disc_leaves_it_whole(sides):
    """Whichever way the touching points are rounded; far from the polygon nothing is left."""
    for turn in np.linspace(0.0, 2.0, 40):
        disc, corners = ((0.3, -0.2), 2.0), polygon(sides, 2.0, turn, (0.3, -0.2))
        found = psf.Aperture.discs([disc], within=corners)
        assert found.area == approx(4 * math.pi, rel=1e-9)
        assert found.perimeter == approx(4 * math.pi, rel=1e-9)
        side = (corners[1] + corners[0]) / 2 - disc[0]
        with pytest.raises(SceneError, match="have no area in common"):
            psf.Aperture.discs([disc], within=corners - 2 * side)


@pytest.mark.parametrize("apart", [0.3, 1.1])
def test_lens_of_two_discs(apart):
    lens = psf.Aperture.discs([((0.1, 0.2), 1.0), ((0.1 + apart, 0.2), 1.0)])
    half = math.acos(apart / 2)
    assert lens.area == approx(2 * half - apart * math.sin(half), rel=1e-12)
    assert lens.perimeter == approx(4 * half, rel=1e-12)


@pytest.mark.parametrize(("half", "area"), [(0.5, 1.0), (0.9, None), (1.1, math.pi)])
def test_square_of_a_disc(half, area):
    """The square lies within the disc, crosses it, or holds it."""
    square = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    found = psf.Aperture.discs([((0.0, 0.0), 1.0)], within=square)
    cap = math.acos(half) - half * math.sqrt(1 - half**2) if half < 1 else 0.0
    assert found.area == approx(math.pi - 4 * cap if area is None else area, rel=1e-12)


def test_narrowest_vane_that_closes_a_pupil():
    """Vanes may leave a sector of any size, but none of no size."""
    with pytest.raises(SceneError, match=r"meet 0\.3 m from the axis, limit 0\.3 m"):
        psf.Aperture.round(1.0, 0.3, vanes=2, vane_width=0.6)
    narrow = psf.Aperture.round(1.0, 0.3, vanes=2, vane_width=0.5999)
    strip = 0.3 * math.sqrt(1 - 0.09) + math.asin(0.3)  # of the disc, 0.6 wide, on one side
    assert narrow.area == approx(math.pi - 2 * strip, rel=1e-3)
    single = psf.Aperture.round(1.0, 0.3, vanes=1, vane_width=0.5999)
    assert single.area - narrow.area == approx(strip - 0.045 * math.pi, rel=1e-3)


def test_cells_beside_a_map():
    """A cell outside the map has no share; the rest cover what they would alone."""
    pair = psf.Aperture.union(psf.Aperture.round(1.0), psf.Aperture.round(1.0).moved((9.0, 0.0)))
    total, most, owners = pair.grid_shares(9, 0.25)
    alone, *_ = psf.Aperture.round(1.0).grid_shares(9, 0.25)
    assert np.array_equal(total, alone)
    assert np.array_equal(most, alone)
    assert not owners.any()
    assert total.sum() * 0.25**2 == approx(math.pi, rel=1e-12)


def test_levels_of_a_point():
    """A point has no length, so that no line crosses it."""
    point = curves.Curve.point((1.0, 2.0))
    assert point.meets(2.0, 1).size == 0
    flat = curves.Curve.arc((0.0, 1.0), (2.0, 0.0), (0.0, 0.0), 0.0, 3.0)
    assert flat.meets(1.0, 1).size == 0


BOWL = CallableWall(
    lambda x, y: (x**2 + y**2) / 18,
    lambda x, y: (x / 9, y / 9),
    hessian=lambda x, y: (np.full_like(x, 1 / 9), 0 * x, np.full_like(x, 1 / 9)),
    size=2.0,
    max_height=0.12,
    max_curvature=0.12,
)


def test_mirror_points_of_a_wall_in_python():
    """Each start leads to the same point as the compiled search on the same bowl."""
    o, p = np.array([0.5, 0.1, 1.2]), np.array([-0.4, 0.2, 1.0])
    starts = np.array([[0.1, 0.1], [-0.2, 0.3], [0.0, 0.0]])
    found = np.array([*stationary_points(BOWL, o, p, starts, 1.0)])
    bowl = ConcaveWall(9.0, size=2.0)
    known = np.array([*stationary_points(bowl, o, p, starts, 1.0)])
    assert found[:, 2] == approx(known[:, 2])
    assert found[:, :2] == approx(np.repeat(found[:1, :2], 3, axis=0), abs=1e-9)
    hit = np.array([*found[0, :2], float(BOWL.height(*found[0, :2]))])
    near = [
        sum(np.linalg.norm(end - (h[0], h[1], float(BOWL.height(*h)))) for end in (o, p))
        for h in hit[:2] + 1e-4 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    ]
    assert np.all(np.abs(np.diff(near)) < 1e-8)  # the path is stationary there


def test_too_many_mirror_points():
    """A deep bowl whose rays cross within the pupil is refused."""
    near = ConcaveWall(0.9)
    nodes = 0.3 * np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(CausticError):
        psf.wall_aberration(near, (0.1, 0.0, 1.0), (-0.1, 0.0, 0.7), (0.0, 0.0, 0.0), nodes)


def test_planes_of_best_focus():
    """The least spot or the largest Strehl ratio."""
    given = {"shifts": np.array([-1.0, 0.0, 2.0]), "values": np.array([0.3, 0.1, 0.7])}
    given |= {"wavelength": 6e-7, "f_number": 8.0}
    best = {one: psf.ThroughFocus(criterion=one, **given).best for one in ("rms", "spot", "mtf")}
    assert best == {"rms": 1, "spot": 1, "mtf": 2}
    assert psf.ThroughFocus(criterion="of mine", **given).best == 2


def field_of(weights):
    modes = np.array([[[1.0, 2.0, 0.5]], [[0.01, -0.02, 0.03]]])
    given = {"across": np.array([-1.0, 1.0]), "up": np.array([0.0]), "pitch": 1e-5}
    given |= {"truncation_error": 1e-4, "error_estimate": 3e-4}
    return psf.PointSpreadField(modes=modes, weights=np.asarray(weights), **given)


def test_a_field_without_its_last_mode():
    """Its stated error grows by the largest omitted part, relative to that point's peak."""
    field = field_of([[[1.0, 0.8]], [[0.1, 0.5]]])
    short = field.compressed(0.1)
    assert short.modes.shape == (1, 1, 3)
    # at the second point: 0.5 * 0.03 of the peak 0.8 * 2 - 0.5 * 0.02
    assert short.truncation_error - 1e-4 == approx(0.015 / 1.59)
    assert short.error_estimate - 3e-4 == approx(0.015 / 1.59)
    assert field.compressed(0.0) is field


def test_contrast_of_a_pupil():
    values = np.exp(1j * np.arange(16.0)).reshape(4, 4) * np.linspace(0.5, 1.5, 16).reshape(4, 4)
    field = PupilField(values=values, pitch=2e-5)
    text = str(field._figures())
    size = np.abs(values) ** 2
    assert "4 x 4 of 20 µm" in text
    assert f"{np.std(size) / np.mean(size):.3g}" in text
    assert np.isnan(field.phase).sum() == 0


def test_relief_beyond_its_map():
    """A map must hold all wall points whose light reaches the pupil, in x and in y."""
    heights = 1e-8 * np.random.default_rng(2).random((40, 40))
    for pitch, inside in ((4e-4, True), (5e-5, False)):
        relief = HeightMapWall(heights, pitch)
        asked = SEEN | {"pitch": 2e-6, "shape": 24}
        if inside:
            assert psf.sample_point_spread(wave(), relief, **asked).error_estimate < 1
            continue
        with pytest.raises(SceneError, match=r"the height map of 0\.00195 x 0\.00195 m ends"):
            psf.sample_point_spread(wave(), relief, **asked)


def test_views_of_smooth_facets():
    """Without heights there is no halo; beyond every lag little is left of a small share."""
    view = rough_source(wave(), FacetWall(1e-3, 1e-3), 0.5, 1.8).view
    smooth = replace(view, rayleigh_parameter=0.0)
    assert smooth.halo(wave()) == 0
    assert view.halo(wave()) > 0
    lags = [view.last_lag(cut) for cut in (0.999999, 0.5, 1e-3)]
    assert 0 < lags[0] < lags[1] < lags[2]
    pattern = rough_source(wave(), FacetWall(1e-3, 1e-3), *SEEN.values(), pattern=True).view
    assert pattern.has_tails
    assert pattern.length == approx(math.sqrt(2) * FacetWall(1e-3, 1e-3).height_rms / 1e-3)


def test_a_function_as_autocorrelation_is_not_saved():
    with pytest.raises(NlosError, match=r"roughness\.autocorrelation"):
        pickle.dumps(psf.Roughness(3e-8, 1e-3, lambda r: np.exp(-r)))
    assert pickle.loads(pickle.dumps(ROUGH)).height_rms == ROUGH.height_rms


REFUSED = {
    "rays of several cells": (
        lambda: psf.point_spread(
            wave(nodes="grid", samples=64, aperture=psf.Aperture.hexagons(1, 2e-3, 1e-4)),
            method="geometric",
            pitch=2e-5,
            shape=30,
            pixel_integrated=True,
        ),
        "this grid's aperture has 7 separate cells; sample it with nodes='cells'",
    ),
    "pistons in words": (
        lambda: psf.Wavefront.from_function(
            aperture=psf.Aperture.hexagons(1, 2e-3, 1e-4),
            pistons=["a"] * 7,
            wavelength=6e-7,
            image_distance=0.06,
        ),
        "pistons are not numbers; give shape (7,), m",
    ),
    "error of a function": (
        lambda: psf.Wavefront.from_function(
            lambda u, v: psf.zernike(-1, u, v), **SYSTEM, samples=8
        ),
        "-1",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    call, words = REFUSED[name]
    with pytest.raises((SceneError, SamplingError, CausticError)) as caught:
        call()
    assert words in str(caught.value)


def test_a_figure_says_that_rays_fold():
    """A spot inside a caustic is named as such, one of few waves is not."""
    asked = {"pitch": 2e-5, "shape": 260, "pixel_integrated": True, "tol": 0.5}
    many = psf.point_spread(wave({4: 1e-6, 11: 6e-6}.items()), method="geometric", **asked)
    assert many.regime.folded
    assert "folded by a caustic" in str(many._figures())
    few = psf.point_spread(wave(), pitch=1e-6, shape=64)
    assert "folded" not in str(few._figures())
