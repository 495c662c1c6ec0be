"""Each way to make an aperture, with all its arguments, against its definition point by point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError

RNG = np.random.default_rng(12)
U, V = RNG.uniform(-2.0, 2.0, (2, 6000))


def in_polygon(corners, u, v):
    """Whether points lie inside a convex counterclockwise polygon."""
    corners = np.asarray(corners)
    after = np.roll(corners, -1, axis=0)
    inside = np.ones(u.shape, dtype=bool)
    for (x, y), (p, q) in zip(corners.tolist(), after.tolist(), strict=True):
        inside &= (p - x) * (v - y) - (q - y) * (u - x) > 0
    return inside


@pytest.mark.parametrize("hole", [0.0, 0.45])
def test_ellipse(hole):
    found = psf.Aperture.ellipse(1.3, 0.6, 0.5, obscuration=hole, centre=(0.3, -0.2))
    x, y = U - 0.3, V + 0.2
    c, s = math.cos(0.5), math.sin(0.5)
    r = np.hypot((c * x + s * y) / 1.3, (c * y - s * x) / 0.6)
    assert np.array_equal(found.contains(U, V), (r < 1) & (r > hole))
    assert found.area == approx(math.pi * 1.3 * 0.6 * (1 - hole**2), rel=1e-12)
    plain = psf.Aperture.ellipse(1.3, 0.6)
    assert np.array_equal(plain.contains(U, V), np.hypot(U / 1.3, V / 0.6) < 1)
    near = psf.Aperture.ellipse(1.3, 0.6, obscuration=0.99)
    assert near.area == approx(math.pi * 1.3 * 0.6 * (1 - 0.99**2), rel=1e-9)


def test_round():
    found = psf.Aperture.round(1.3, 0.4)
    r = np.hypot(U, V)
    assert np.array_equal(found.contains(U, V), (r < 1.3) & (r > 0.52))
    assert np.array_equal(psf.Aperture.round(1.3).contains(U, V), r < 1.3)
    assert len(psf.Aperture.round(1.3).cells) == 1
    assert psf.Aperture.round(1.3).bounding_radius == approx(1.3, rel=1e-9)
    ellipse = psf.Aperture.ellipse(1.3, 0.6, 0.51)
    assert ellipse.bounding_radius == approx(1.3, rel=1e-7)
    width = math.hypot(1.3 * math.cos(0.51), 0.6 * math.sin(0.51))
    assert ellipse.half_width == approx(width, rel=1e-12)


@pytest.mark.parametrize(("sides", "angle"), [(3, 0.3), (5, -0.4), (6, 0.1)])
@pytest.mark.parametrize("hole", [0.0, 0.5])
def test_regular(sides, angle, hole):
    found = psf.Aperture.regular(sides, 1.4, angle, obscuration=hole)
    turn = angle + 2 * math.pi * np.arange(sides) / sides
    corners = 1.4 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    inside = in_polygon(corners, U, V)
    if hole:
        inside &= ~in_polygon(hole * corners, U, V)
    assert np.array_equal(found.contains(U, V), inside)
    assert found.area == approx(
        sides / 2 * 1.4**2 * math.sin(2 * math.pi / sides) * (1 - hole**2), rel=1e-12
    )


def test_polygon_with_a_hole():
    """The hole is similar, about the centroid."""
    corners = np.array([(-0.8, -0.7), (1.1, -0.4), (0.6, 0.9), (-0.5, 0.5)])
    found = psf.Aperture.polygon(corners, obscuration=0.3)
    whole = psf.Aperture.polygon(corners)
    x, y = whole.cells[0].centroid
    hole = (x, y) + 0.3 * (corners - (x, y))
    known = in_polygon(corners, U, V) & ~in_polygon(hole, U, V)
    assert np.array_equal(found.contains(U, V), known)
    assert found.area == approx(whole.area * (1 - 0.09), rel=1e-12)
    assert found.cells[0].centroid == approx((x, y))
    bent = [(0, 0), (1, 0), (1, 1), (0.9, 0.1), (0, 0.1)]
    with pytest.raises(SceneError, match="obscuration = 0.2 needs a polygon with every side"):
        psf.Aperture.polygon(bent, obscuration=0.2)


@pytest.mark.parametrize("central", [True, False])
@pytest.mark.parametrize("rings", [1, 2])
def test_hexagons(rings, central):
    """Segments 0.5 m wide, 0.04 m apart, in rings that start at angle + pi/6."""
    found = psf.Aperture.hexagons(rings, 0.5, 0.04, angle=0.2, central=central)
    turn = 0.2 + math.pi / 3 * np.arange(6)
    shape = 0.5 / math.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    steps = 0.54 * np.stack([np.cos(turn + math.pi / 6), np.sin(turn + math.pi / 6)], axis=1)
    places = {(0, 0)}  # in steps of two neighbouring directions
    for _ in range(rings):
        ways = [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)]
        places |= {(i + a, j + b) for i, j in places for a, b in ways}
    if not central:
        places.remove((0, 0))
    known = np.zeros(U.shape, dtype=bool)
    for i, j in places:
        known |= in_polygon(shape + i * steps[0] + j * steps[1], U, V)
    assert np.array_equal(found.contains(U, V), known)
    assert len(found.cells) == len(places)
    first = found.cells[1 if central else 0].centroid
    assert first == approx(tuple(steps[0]), abs=1e-12)
    second = found.cells[2 if central else 1].centroid  # counterclockwise
    assert second == approx(tuple(steps[1]), abs=1e-12)
    one = psf.Aperture.hexagons(0, 0.5)
    assert len(one.cells) == 1
    assert one.area == approx(math.sqrt(3) / 2 * 0.25, rel=1e-12)
    touching = psf.Aperture.hexagons(1, 0.5)
    assert touching.area == approx(7 * one.area, rel=1e-12)
