"""Lines, arcs and outlines of no symmetry, against points counted one by one."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SceneError
from nlosoptics.psf.aperture import curves, polygons, quadrature_nodes, shapes
from nlosoptics.psf.aperture.curves import Curve

BASE, COSINE, SINE = np.array([0.3, -0.7]), np.array([1.1, 0.4]), np.array([-0.2, 0.6])
CURVES = {
    "line": Curve.line((0.3, -0.7), (1.9, 0.5)),
    "falling": Curve.line((0.3, 0.7), (-1.2, 0.4)),
    "level": Curve.line((0.3, 0.7), (-1.2, 0.7)),
    "arc": Curve.arc(BASE, COSINE, SINE, 0.4, 5.3),
    "back": Curve.arc(BASE, COSINE, SINE, 2.9, -2.1),
    "circle": Curve.circle((-0.4, 0.2), 0.9, -1.0, 1.3),
}
T = np.linspace(0.0, 1.0, 20001)


def points(curve, t):
    """Points of a curve by its definition."""
    t = np.asarray(t)[..., None]
    angle = curve.phase + curve.turn * t
    bent = curve.cosine * np.cos(angle) + curve.sine * np.sin(angle)
    return curve.base + curve.step * t + (bent if curve.turn else 0.0)


def outline():
    """A closed outline of two arcs and two lines."""
    first = Curve.arc((0.1, -0.2), (0.9, 0.3), (-0.2, 0.7), -0.5, 1.9)
    second = Curve.arc((-0.9, 0.1), (0.25, 0.0), (0.0, 0.45), 2.0, 4.6)
    ends = [c.at([0.0, 1.0]) for c in (first, second)]
    return [
        first,
        Curve.line(ends[0][1], ends[1][0]),
        second,
        Curve.line(ends[1][1], ends[0][0]),
    ]


def polyline(pieces, n=4000):
    return np.concatenate([points(c, np.linspace(0, 1, n, endpoint=False)) for c in pieces])


def shoelace(p):
    q = np.roll(p, -1, axis=0)
    swept = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return swept.sum() / 2, *(((p[:, k] + q[:, k]) * swept).sum() / 6 for k in (0, 1))


@pytest.mark.parametrize("name", CURVES)
def test_points_and_rates(name):
    curve = CURVES[name]
    t = np.array([0.0, 0.17, 0.5, 1.0])
    assert curve.at(t) == approx(points(curve, t), abs=1e-14)
    step = 1e-6
    slope = (points(curve, t + step) - points(curve, t - step)) / (2 * step)
    assert curve.rate(t) == approx(slope, abs=1e-8)
    assert curve.is_arc == (name in ("arc", "back", "circle"))
    for low, high in ((0.2, 0.9), (1.0, 0.0), (0.7, 0.1)):
        assert curve.part(low, high).at(t) == approx(
            points(curve, low + (high - low) * t), abs=1e-14
        )
    pieces = curve.parts()
    longest = max(abs(float(p.turn)) for p in pieces)
    assert longest <= curves.LONGEST * (1 + 1e-12)
    assert len(pieces) == max(1, math.ceil(abs(float(curve.turn)) / curves.LONGEST))
    for k, piece in enumerate(pieces):
        assert piece.at(t) == approx(points(curve, (k + t) / len(pieces)), abs=1e-14)
    scaled = curve.scaled(1.7, (0.2, -0.1)).at(t)
    assert scaled == approx((0.2, -0.1) + 1.7 * (points(curve, t) - (0.2, -0.1)), abs=1e-14)
    assert curve.moved((0.2, -0.1)).at(t) == approx(
        np.add(points(curve, t), (0.2, -0.1)), abs=1e-14
    )
    c, s = math.cos(0.6), math.sin(0.6)
    turned = points(curve, t) @ np.array([[c, -s], [s, c]])
    assert curve.turned(0.6).at(t) == approx(turned, abs=1e-14)
    stacked = Curve.stack([curve, CURVES["arc"], CURVES["line"]])
    assert stacked.at(t)[0] == approx(points(curve, t), abs=1e-14)
    assert stacked.at(t)[2] == approx(points(CURVES["line"], t), abs=1e-14)
    assert stacked.rate(t)[0] == approx(slope, abs=1e-8)
    assert Curve.stack([CURVES["line"], CURVES["falling"]]).rate(t)[1] == approx(
        np.broadcast_to(CURVES["falling"].step, (4, 2))
    )


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("axis", [0, 1])
def test_levels_that_a_curve_meets(name, axis):
    curve = CURVES[name]
    along = points(curve, T)[:, axis]
    low, high = curves.box([curve])
    assert (low[axis], high[axis]) == approx((along.min(), along.max()), abs=1e-7)
    levels = [-0.9313, -0.2071, 0.1117, 0.3371, 0.61337]
    found = np.sort(curve.meets(np.array(levels), axis))
    known = []
    for level in levels:
        change = np.flatnonzero(np.diff(np.sign(along - level)) != 0)
        known += [T[k] for k in change]
    assert found == approx(np.sort(known), abs=1e-4)
    assert np.sort(curve.meets(levels[3], axis)) == approx(
        [t for t in found if abs(points(curve, t)[axis] - levels[3]) < 1e-9], abs=1e-12
    )
    lengths = curves.lengths(Curve.stack([curve, CURVES["arc"]]))
    for length, one in zip(lengths, (curve, CURVES["arc"]), strict=True):
        exact = np.hypot(*np.diff(points(one, T), axis=0).T).sum()
        assert length == approx(exact, rel=1e-7)


def test_points_have_no_length_or_level():
    point = Curve.point((0.3, -0.7))
    assert point.meets(0.3, 0).size == point.meets(0.2, 1).size == 0
    assert point.at([0.0, 0.4, 1.0]) == approx(np.broadcast_to((0.3, -0.7), (3, 2)))
    across = Curve.arc((0.0, 0.0), (0.0, 0.0), (0.0, 1.0), 0.1, 2.0)
    assert across.meets(0.0, 0).size == 0


@pytest.mark.parametrize("name", [n for n in CURVES if n != "level"])
def test_monotone_parts_and_where_they_reach_a_level(name):
    pieces = curves.monotone_parts(CURVES[name])
    assert points(pieces[0], 0.0) == approx(points(CURVES[name], 0.0))
    assert points(pieces[-1], 1.0) == approx(points(CURVES[name], 1.0))
    for piece in pieces:
        at = points(piece, np.linspace(0, 1, 101))
        step = np.diff(at[:, 1])
        assert np.all(step > 0) or np.all(step < 0)
        inner = at[5:-5]
        assert curves.abscissa(piece, inner[:, 1]) == approx(inner[:, 0], abs=1e-9)


def test_moments_and_insides_of_an_outline():
    shape = outline()
    line = polyline(shape)
    assert curves.moments(shape) == approx(shoelace(line), rel=1e-6)
    far = [c.moved((70.0, -30.0)) for c in shape]
    area, x, y = curves.moments(far)
    own = shoelace(line)
    assert (area, x, y) == approx((own[0], own[1] + 70 * own[0], own[2] - 30 * own[0]), rel=1e-6)
    rng = np.random.default_rng(3)
    u, v = rng.uniform(-1.4, 1.4, (2, 300))
    q = np.roll(line, -1, axis=0)
    crosses = (line[:, 1] <= v[:, None]) != (q[:, 1] <= v[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = line[:, 0] + (v[:, None] - line[:, 1]) * (q - line)[:, 0] / (q - line)[:, 1]
    known = np.sum(crosses & (at > u[:, None]), axis=1) % 2 == 1
    assert 50 < known.sum() < 250
    assert np.array_equal(curves.within(shape, u, v), known)
    assert np.array_equal(
        curves.within(shape, u[:6, None], v[:5]),
        [
            [bool(curves.within(shape, u[i, None], v[j, None])[0]) for j in range(5)]
            for i in range(6)
        ],
    )


@pytest.mark.parametrize("corner", [(-1.3, -0.9), (-0.4, -0.1), (0.6, -1.2)])
def test_shares_of_squares(corner):
    """Squares that hold the outline, cut it on every side, or lie beside it."""
    pitch, fine = 0.31, 120
    x, y = corner[0] + pitch * np.arange(7), corner[1] + pitch * np.arange(5)
    found = curves.shares(outline(), x, y, pitch)
    at = (np.arange(fine) + 0.5) / fine - 0.5
    u, v = ((axis[:, None] + pitch * at).ravel() for axis in (x, y))
    inside = curves.within(outline(), u[None, :], v[:, None])
    known = inside.reshape(5, fine, 7, fine).mean(axis=(1, 3))
    assert found == approx(known, abs=1.2 / fine)
    assert abs(found.mean() - known.mean()) < 2e-4
    assert np.all(found[known == 0] < 1e-3)
    # the disc of another function, in rectangles too
    disc = [Curve.circle((0.0, 0.0), 0.8, 0.0, 2 * math.pi)]
    circle = quadrature_nodes.circle_shares(x, y, pitch, 0.8)
    assert circle == approx(curves.shares(disc, x, y, pitch), abs=1e-12)
    tall = quadrature_nodes.circle_shares(x, 2 * y, pitch, 0.8, 2 * pitch)
    v = (2 * y[:, None] + 2 * pitch * at).ravel()
    known = (u[None, :] ** 2 + v[:, None] ** 2 < 0.64).reshape(5, fine, 7, fine).mean(axis=(1, 3))
    assert tall == approx(known, abs=1.5 / fine)
    assert abs(tall.mean() - known.mean()) < 3e-4


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
    shared = quadrature_nodes.shared_polar_nodes(1.7, n_r, n_theta, obscuration)
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


def test_nodes_that_are_refused():
    for call, message in (
        (lambda: psf.grid_nodes(1.0, 1), "samples = 1"),
        (lambda: psf.grid_nodes(-1.0, 4), "radius = -1 m"),
        (lambda: psf.grid_nodes(1.0, 4, 0.991), "obscuration = 0.991"),
        (lambda: psf.grid_nodes(1.0, 4, -0.01), "obscuration = -0.01"),
        (lambda: psf.polar_nodes(0.0, 3, 4), "radius = 0 m"),
        (lambda: psf.polar_nodes(1.0, 0, 4), "n_r = 0"),
        (lambda: psf.polar_nodes(1.0, 3, 0), "n_theta = 0"),
        (lambda: psf.polar_nodes(1.0, 3, 4, 0.991), "obscuration = 0.991"),
    ):
        with pytest.raises(SceneError, match=re.escape(message)):
            call()
    assert psf.grid_nodes(1.0, 4, 0.99)[2].sum() == approx(math.pi * (1 - 0.99**2), rel=1e-9)
    pair = psf.Aperture.polygon([(0, 0), (1, 0), (0, 1)])
    for n_bytes, call, what in (
        (80 * 9 * 9, lambda: psf.grid_nodes(1.0, 9), "a pupil of 9 x 9 samples"),
        (80 * 5 * 7, lambda: psf.polar_nodes(1.0, 5, 7), "5 x 7 pupil nodes"),
        (200 * 5 * 7, lambda: pair.nodes(5, 7), "1 x 5 x 7 pupil nodes"),
        (120 * 9 * 9, lambda: pair.grid_nodes(9), "a pupil of 9 x 9 samples"),
    ):
        with within(Budget(memory=float(n_bytes), seconds=1.0)):
            call()
        refused = pytest.raises(MemoryLimitError, match=f"{what} needs")
        with within(Budget(memory=n_bytes - 1.0, seconds=1.0)), refused:
            call()


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


@pytest.mark.parametrize(
    ("discs", "within_", "message"),
    [
        ([((0.0, 0.0), 1.0), ((2.1, 0.0), 1.0)], None, "no area in common"),
        ([((0.0, 0.0), 1.0)], [(1.1, 0), (2, 0), (2, 1)], "no area in common"),
        ([], None, "discs = []"),
        ([3.0], None, "discs are not pairs"),
        ([((0.0,), 1.0)], None, "discs[0] centre = (0.0,) is not a point"),
        ([((0.0, 0.0), 1.0), ((0.0, math.inf), 1.0)], None, "discs[1] centre[1] = inf"),
        ([((0.0, 0.0), 1.0), ((0.0, 0.0), -1.0)], None, "discs[1] radius = -1 m"),
    ],
)
def test_discs_that_are_refused(discs, within_, message):
    with pytest.raises(SceneError, match=re.escape(message)):
        psf.Aperture.discs(discs, **({} if within_ is None else {"within": within_}))


def test_centres_of_hexagons():
    """Each ring has six times its number, all at whole steps of the lattice, each once."""
    centres = shapes.hexagon_centres(3, 0.7, 0.3)
    assert len(centres) == 37
    assert centres[1] == approx((0.7 * math.cos(0.3), 0.7 * math.sin(0.3)))
    apart = np.hypot(*(centres[:, None] - centres).transpose(2, 0, 1))
    assert apart[~np.eye(37, dtype=bool)].min() == approx(0.7)
    reach = np.hypot(*centres.T)
    for ring in range(4):
        first = 1 + 3 * ring * (ring - 1) if ring else 0
        last = 1 + 3 * ring * (ring + 1)
        assert reach[first:last].max() == approx(0.7 * ring)
        assert reach[first:last].min() >= 0.7 * ring * math.sqrt(3) / 2 - 1e-12


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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vanes": 1}, "vanes = 1 with obscuration = 0"),
        ({"vanes": 3, "vane_width": 0.0}, "vane_width"),
        (
            {"vanes": 3, "obscuration": 0.2, "vane_width": 0.36},
            "edges of 3 vanes meet 0.2078 m from",
        ),
        ({"vanes": 1, "obscuration": 0.2, "vane_width": 0.42}, "edges of 1 vane meet 0.21 m from"),
        (
            {"vanes": 2, "vane_width": 2.1},
            "meet 1.05 m from the axis, limit 1 m, the radius of the p",
        ),
    ],
)
def test_vanes_that_are_refused(options, message):
    with pytest.raises(SceneError, match=re.escape(message)):
        psf.Aperture.round(1.0, **({"vane_width": 0.1} | options))
    psf.Aperture.round(1.0, 0.2, vanes=3, vane_width=0.34)
    psf.Aperture.round(1.0, 0.2, vanes=1, vane_width=0.39)


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


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (
            [(0, 0), (1, 1), (1, 0), (0, 1)],
            "vertices: the sides that start at corners 0 and 2 meet",
        ),
        ([(0, 0), (2, 0), (2, 1), (1, 0), (0, 1)], "sides that start at corners 0 and 2 meet"),
        (
            [(0, 0), (2, 0), (1, 0), (1, 1)],
            "vertices: the sides that start at corners 0 and 1 meet",
        ),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "vertices[1] = [1.0, 0.0] m is repeated"),
        ([(0, 0), (1, 0), (0, 1), (0, 0)], "vertices[3] = [0.0, 0.0] m is repeated"),
        ([(0, 0), (1, 1), (3, 3)], "vertices lie on a line and enclose no area"),
        ([(0, 0), (1, 1)], "vertices have shape (2, 2); give 3 to 1000 corners"),
        ([(0, 0, 1), (1, 1, 1), (0, 1, 1)], "vertices have shape (3, 3)"),
        ([(0, 0), (1, math.nan), (0, 1)], "vertices[1] = [1.0, nan] m; give finite corners"),
        ("round", "vertices are not numbers"),
        (np.zeros((1001, 2)), "vertices have shape (1001, 2)"),
    ],
)
def test_polygons_that_are_refused(corners, message):
    with pytest.raises(SceneError, match=re.escape(message)):
        psf.Aperture.polygon(corners)


def test_polygons_that_nearly_are_refused():
    """Touching nowhere: collinear sides apart, a corner just off a side, a flat corner."""
    for corners in (
        [(0, 0), (1, 0), (1, 1), (2, 1), (2, 0), (3, 0), (3, 2), (0, 2)],
        [(0, 0), (2, 0), (2, 1), (1, 1e-6), (0, 1)],
        [(0, 0), (1, 0), (2, 0), (2, 1), (0, 1)],
    ):
        found = psf.Aperture.polygon(corners)
        assert found.area == approx(shoelace(np.array(corners, float))[0], rel=1e-9)
    circle = [(math.cos(t), math.sin(t)) for t in 2 * math.pi * np.arange(1000) / 1000]
    assert psf.Aperture.polygon(circle).area == approx(math.pi, rel=1e-4)


def test_parts_of_unions_and_their_squares():
    """Which cell covers most of a square, and how much of it; cells beyond the grid count 0."""
    first = psf.Aperture.polygon(POLYGONS["triangle"])
    second = psf.Aperture.ellipse(0.5, 0.3, 0.4, centre=(-0.7, -0.4))
    pair = psf.Aperture.union(first, second)
    total, most, owners = pair.grid_shares(9, 0.25)
    axis, fine = 0.25 * (np.arange(9) - 4), 100
    at = (np.arange(fine) + 0.5) / fine - 0.5
    line = (axis[:, None] + 0.25 * at).ravel()
    parts = np.stack(
        [
            one.contains(line[None, :], line[:, None]).reshape(9, fine, 9, fine).mean(axis=(1, 3))
            for one in (first, second)
        ]
    )
    assert total == approx(parts.sum(axis=0), abs=0.02)
    assert most == approx(parts.max(axis=0), abs=0.02)
    assert np.array_equal(owners, np.where(parts[1] > parts[0], 1, 0))
    assert len(np.unique(owners)) == 2
    small = pair.grid_shares(3, 0.25)
    assert small[0] == approx(total[3:6, 3:6], abs=1e-12)
    u, v, weights, owned = pair.grid_nodes(9, 0.9)
    assert np.array_equal(owned, pair.grid_shares(9, 0.2)[2])
    assert weights == approx(pair.grid_shares(9, 0.2)[0] * 0.04)
    assert u[0] == approx(0.2 * (np.arange(9) - 4))
    assert v[:, 0] == approx(0.2 * (np.arange(9) - 4))
    own = pair.grid_nodes(9)[0]
    assert own[0, 1] - own[0, 0] == approx(2 * pair.half_width / 9)
    a, b = pair.patches
    t = np.linspace(0, 1, 17)
    across = max(np.hypot(*(b.at(t) - a.at(t)).reshape(-1, 2).T))
    along = max(np.hypot(*np.concatenate([a.rate(t), b.rate(t)]).reshape(-1, 2).T))
    assert pair.patch_size == approx((across, along))
    moved = pair.moved((3.0, -2.0))
    assert moved.area == approx(pair.area)
    assert moved.cells[1].centroid == approx((2.3, -2.4))
    with pytest.raises(SceneError, match="cells 0 and 1 of the aperture overlap at u = "):
        psf.Aperture.union(first, second.moved((0.9, 0.6)))
    for shift in ((0.15, 0.05), (0.0, 1.4), (-3.0, 0.0), (0.0, -3.0), (5.0, 0.0)):
        assert len(psf.Aperture.union(first, second.moved(shift)).cells) == 2
    for one in (first, second):
        assert pair.perimeter > one.perimeter
    assert pair.perimeter == approx(first.perimeter + second.perimeter)
