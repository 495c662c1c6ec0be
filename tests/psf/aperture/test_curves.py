"""Lines, arcs and outlines of no symmetry, against points counted one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.aperture import cell_nodes, polygons, quadrature_nodes

T = np.linspace(0.0, 1.0, 20001)


def points(curve, t):
    """Points of a curve by its definition."""
    t = np.asarray(t)[..., None]
    angle = curve.phase + curve.turn * t
    bent = curve.cosine * np.cos(angle) + curve.sine * np.sin(angle)
    return curve.base + curve.step * t + (bent if curve.turn else 0.0)


def shoelace(p):
    q = np.roll(p, -1, axis=0)
    swept = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return swept.sum() / 2, *(((p[:, k] + q[:, k]) * swept).sum() / 6 for k in (0, 1))


@pytest.mark.parametrize("n", [1, 2, 7])
def test_rules_of_gauss(n):
    fraction, weight = quadrature_nodes.gauss_legendre(n)
    for power in range(2 * n):
        assert weight @ fraction**power == approx(1 / (power + 1), rel=1e-13)
    assert np.all(np.diff(fraction) > 0)
    assert not fraction.flags.writeable
    assert not weight.flags.writeable


@pytest.mark.parametrize("obscuration", [0.0, 0.35])
@pytest.mark.parametrize(("n_r", "n_theta"), [(2, 7), (3, 11), (1, 3)])
def test_polar_nodes_integrate_polynomials(n_r, n_theta, obscuration):
    """u^i v^j over a ring: R^(n+2) (1 - e^(n+2))/(n + 2) times the mean over the angles."""
    u, v, weights = psf.polar_nodes(1.7, n_r, n_theta, obscuration)
    assert u.shape == v.shape == weights.shape == (n_r, n_theta)
    assert v[:, 0] == approx(0.0, abs=1e-15)
    for i in range(6):
        for j in range(6):
            degree = i + j
            if degree >= min(4 * n_r, n_theta):
                continue
            exact = 0.0
            if i % 2 == j % 2 == 0:
                angle = 2 * math.gamma((i + 1) / 2) * math.gamma((j + 1) / 2)
                angle /= math.gamma((degree + 2) / 2)
                exact = (
                    1.7 ** (degree + 2) * (1 - obscuration ** (degree + 2)) / (degree + 2) * angle
                )
            assert np.sum(weights * u**i * v**j) == approx(exact, rel=1e-12, abs=1e-12)
    shared = cell_nodes.pupil_points(1.7, obscuration, None, (n_r, n_theta))
    for one, own in zip(shared, (u, v, weights), strict=True):
        assert np.array_equal(one, own)
        assert not one.flags.writeable
        assert own.flags.writeable
    many = int(quadrature_nodes.KEPT**0.5) + 1
    assert psf.polar_nodes(1.0, many, many)[0].flags.writeable


@pytest.mark.parametrize("samples", [2, 5, 8])
@pytest.mark.parametrize("obscuration", [0.0, 0.35])
def test_grid_nodes_hold_the_ring(samples, obscuration):
    u, v, weights = psf.grid_nodes(1.7, samples, obscuration)
    pitch = 3.4 / (samples if samples % 2 else samples - 1)
    axis = pitch * (np.arange(samples) - samples // 2)
    assert u == approx(np.broadcast_to(axis, u.shape))
    assert v == approx(np.broadcast_to(axis[:, None], u.shape))
    # even grids have a row and a column more at the lower end
    assert weights.sum() == approx(math.pi * 1.7**2 * (1 - obscuration**2), rel=1e-12)
    fine = 200
    at = (np.arange(fine) + 0.5) / fine - 0.5
    line = (axis[:, None] + pitch * at).ravel()
    r = np.hypot(line[None, :], line[:, None])
    inside = ((r < 1.7) & (r > obscuration * 1.7)).reshape(samples, fine, samples, fine)
    assert weights == approx(inside.mean(axis=(1, 3)) * pitch**2, abs=0.02 * pitch**2)


DISCS = {
    "two": [((0.3, 0.1), 1.0), ((-0.5, -0.2), 1.2)],
    "three": [((0.3, 0.1), 1.0), ((-0.5, -0.2), 1.2), ((0.1, 0.9), 1.1)],
    "inside": [((0.3, 0.1), 0.5), ((0.2, 0.0), 1.4)],
    "repeated": [((0.3, 0.1), 1.0), ((0.3, 0.1), 1.0), ((-0.5, -0.2), 1.2)],
    "touching": [((0.0, 0.0), 1.3), ((0.3, 0.0), 1.0)],
    "touching back": [((0.36, 0.48), 0.7), ((0.0, 0.0), 1.3)],
}
WITHINS = {
    "none": None,
    "box": [(-0.9, -0.6), (0.8, -0.6), (0.8, 0.7), (-0.9, 0.7)],
    "clockwise": [(0.1, 1.2), (1.5, -0.5), (-1.2, -0.7)],
    "around": [(-4.0, -3.0), (5.0, -3.0), (0.0, 6.0)],
}


@pytest.mark.parametrize("discs", DISCS)
@pytest.mark.parametrize("within_", WITHINS)
def test_common_parts_of_discs_and_polygons(discs, within_):
    """Membership of random points, area and first moments by them."""
    options = {} if WITHINS[within_] is None else {"within": WITHINS[within_]}
    found = psf.Aperture.discs(DISCS[discs], **options)
    rng = np.random.default_rng(8)
    u, v = rng.uniform(-1.6, 1.6, (2, 20000))
    known = np.ones(u.shape, dtype=bool)
    for (x, y), r in DISCS[discs]:
        known &= np.hypot(u - x, v - y) < r
    corners = np.array(WITHINS[within_] or np.zeros((0, 2)))
    if len(corners):
        after = np.roll(corners, -1, axis=0)
        area = np.sum(corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0])
        for a, b in zip(corners, after, strict=True):
            turn = (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])
            known &= turn * np.sign(area) > 0
    assert np.array_equal(found.contains(u, v), known)
    share = known.mean()
    error = 4 * math.sqrt(share * (1 - share) / 20000) * 3.2**2
    assert found.area == approx(share * 3.2**2, abs=error)
    nodes_u, nodes_v, weights = found.nodes(10, 12)
    assert weights.min() > 0
    assert weights.sum() == approx(found.area, rel=1e-9)
    assert found.contains(nodes_u, nodes_v).all()
    assert np.sum(weights * nodes_u) == approx(found.cells[0].centroid[0] * found.area, abs=1e-9)
    assert np.sum(weights * nodes_v) == approx(found.cells[0].centroid[1] * found.area, abs=1e-9)
    edge = found.rims.at(np.linspace(0, 1, 400)).reshape(-1, 2)
    assert found.bounding_radius == approx(np.hypot(*edge.T).max(), rel=1e-5)
    assert found.half_width == approx(np.abs(edge).max(), rel=1e-5)


@pytest.mark.parametrize(("vanes", "hole"), [(2, 0.0), (3, 0.0), (1, 0.3), (4, 0.3), (5, 0.25)])
def test_sectors_between_vanes(vanes, hole):
    """A point is dark if it is within half a width of a vane's half line."""
    width, turn = 0.21, 0.37
    found = psf.Aperture.round(1.6, hole, vanes=vanes, vane_width=width, angle=turn)
    rng = np.random.default_rng(vanes)
    u, v = rng.uniform(-1.7, 1.7, (2, 20000))
    r = np.hypot(u, v)
    known = (r < 1.6) & (r > hole * 1.6)
    for k in range(vanes):
        c, s = math.cos(turn + 2 * math.pi * k / vanes), math.sin(turn + 2 * math.pi * k / vanes)
        known &= ~((c * u + s * v > 0) & (abs(c * v - s * u) < width / 2))
    assert np.array_equal(found.contains(u, v), known)
    share = known.mean()
    assert found.area == approx(share * 3.4**2, abs=4 * math.sqrt(share / 20000) * 3.4**2 / 2)
    assert len(found.cells) == vanes
    nodes_u, nodes_v, weights = found.nodes(6, 8)
    assert found.contains(nodes_u, nodes_v).all()
    assert weights.sum() == approx(found.area, rel=1e-6)


POLYGONS = {
    "triangle": [(0.1, 0.0), (1.3, 0.2), (0.4, 1.1)],
    "quadrangle": [(0.0, 0.0), (1.2, 0.1), (1.0, 0.9), (-0.2, 0.7)],
    "arrow": [(0.0, 0.0), (1.0, 0.0), (0.4, 0.3), (0.3, 1.0)],
    "hexagon": [(1.0, 0.1), (0.6, 0.8), (-0.3, 0.9), (-1.0, 0.0), (-0.5, -0.8), (0.5, -0.7)],
    "pentagon": [(1.0, 0.1), (0.3, 0.8), (-0.9, 0.4), (-0.7, -0.6), (0.5, -0.7)],
    "star": [(1.0, 0.0), (0.3, 0.2), (0.2, 1.0), (-0.2, 0.3), (-1.0, 0.1), (-0.1, -0.6)],
    "comb": [
        (0, 0),
        (4, 0),
        (4, 2),
        (3, 2),
        (3, 0.5),
        (2.4, 0.6),
        (2, 2),
        (1, 2.2),
        (1, 0.7),
        (0, 1),
    ],
}


@pytest.mark.parametrize("name", POLYGONS)
@pytest.mark.parametrize("order", [1, -1])
def test_patches_of_polygons(name, order):
    """Patches that fill the polygon once: areas, and one patch for each of random points."""
    corners = np.array(POLYGONS[name], dtype=float)[::order]
    found = psf.Aperture.polygon(corners)
    assert found.area == approx(abs(shoelace(corners)[0]), rel=1e-12)
    u, v, weights = found.nodes(5, 6)
    assert weights.min() > 0
    assert weights.sum() == approx(found.area, rel=1e-12)
    assert found.contains(u, v).all()
    assert found.patch_areas.sum() == approx(found.area, rel=1e-12)
    area, x, y = shoelace(corners)
    assert np.sum(weights * u) == approx(x * np.sign(area), abs=1e-12)
    assert np.sum(weights * v) == approx(y * np.sign(area), abs=1e-12)
    expected = {"triangle": 1, "quadrangle": 1, "hexagon": 3, "pentagon": 5, "arrow": 4, "comb": 8}
    if name in expected:
        assert len(found.owners) == expected[name]
    if name in ("triangle", "quadrangle", "hexagon", "pentagon"):
        assert polygons.convex_polygon(corners).shape == corners.shape
    else:
        with pytest.raises(SceneError, match="is turned inward; give a convex polygon"):
            polygons.convex_polygon(corners)
