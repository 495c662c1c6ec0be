"""Sample points of waves: how many are taken, moved segments, and refused functions and arrays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.wave.cell_series import CellSpectrum
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.polar_series import PolarSpectrum
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.wave.sampling import Sampling, owned

WAVELENGTH, RADIUS, DISTANCE = 5.3e-7, 4e-3, 0.07
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
SEGMENTS = psf.Aperture.union(
    psf.Aperture.regular(4, 1.2e-3, 0.1).moved((-1.6e-3, 0.7e-3)),
    psf.Aperture.regular(5, 1.3e-3, 0.3).moved((1.7e-3, -0.4e-3)),
)
ROUND = psf.Aperture.round(RADIUS, 1e-3)
K = 2 * math.pi / WAVELENGTH


@pytest.mark.parametrize("nodes", ["cells", "grid"])
def test_moved_segments(nodes):
    """Each cell is lifted, and turned about its centroid."""
    pistons, tilts = np.array([2e-8, -5e-8]), np.array([[1e-5, -3e-5], [4e-5, 2e-5]])
    options = {"nodes": nodes, "samples": 6 if nodes == "cells" else 40, "aperture": SEGMENTS}
    both = {"pistons": pistons, "tilts": tilts}
    found = {
        name: psf.Wavefront.from_function(lambda u, v: 0.1 * u * v, **SYSTEM, **options, **given)
        for name, given in {
            "none": {},
            "pistons": {"pistons": pistons},
            "tilts": {"tilts": tilts},
            "both": both,
        }.items()
    }
    wave = found["none"]
    right = (wave.u > 0.1e-3).astype(int)
    centres = np.array([cell.centroid for cell in SEGMENTS.cells])[right]
    lift, lit = pistons[right], wave.weights > 0
    turn = tilts[right, 0] * (wave.u - centres[..., 0]) + tilts[right, 1] * (
        wave.v - centres[..., 1]
    )
    assert_allclose(wave.aberration[lit], 0.1 * (wave.u * wave.v)[lit], atol=1e-20)
    for name, expected in (("pistons", lift), ("tilts", turn), ("both", lift + turn)):
        moved = (found[name].aberration - wave.aberration)[lit]
        assert_allclose(moved, expected[lit], atol=1e-20)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pistons": [1e-8]}, r"pistons have shape \(1,\); give \(2,\), m of every cell"),
        (
            {"tilts": [1e-8, 0]},
            r"tilts have shape \(2,\); give \(2, 2\), slopes dW/du and dW/dv of",
        ),
        ({"pistons": ["a", "b"]}, r"pistons = .* is no array of numbers; give floats"),
        ({"pistons": [0, math.inf]}, r"pistons\[1\] = inf; give finite numbers, m"),
        ({"tilts": [[0, math.nan], [0, 0]]}, r"tilts\[0\] = .*nan.*; give finite numbers, slopes"),
        (
            {"pistons": [0.0], "aperture": None},
            "pistons or tilts need an aperture, whose cells they",
        ),
        ({"tilts": [[0.0, 0]], "aperture": None}, "pistons or tilts need an aperture"),
    ],
)
def test_refused_segments(given, message):
    with pytest.raises(SceneError, match=message):
        psf.Wavefront.from_function(**SYSTEM, **{"aperture": SEGMENTS} | given)


def test_refused_functions():
    def make(aberration=None, **given):
        return psf.Wavefront.from_function(aberration, **SYSTEM, samples=(4, 12), **given)

    told = r"aberration\(u, v\) must return one real number for each of 48 nodes: "
    for wrong in (lambda u, v: u[1:], lambda u, v: 1j * u, lambda u, v: "flat"):
        with pytest.raises(SceneError, match=told):
            make(wrong)
    with pytest.raises(SceneError, match="the values are complex; put a phase into the aberration"):
        make(lambda u, v: 1j * u)

    def refusing(u, v):
        raise SceneError("own words")

    with pytest.raises(SceneError, match="own words"):
        make(refusing)
    with pytest.raises(
        SceneError, match=r"amplitude\(u, v\) = nan at u = .* m, v = .* m; give fini"
    ):
        make(amplitude=lambda u, v: np.where(u > 1e-3, np.nan, 1.0))
    assert (make(lambda u, v: 3e-8).aberration == 3e-8).all()
    corners = psf.Wavefront.from_function(
        lambda u, v: np.sqrt(RADIUS**2 * 1.4 - u**2 - v**2), **SYSTEM, nodes="grid", samples=9
    )
    # beyond the rim nothing is asked for
    assert corners.aberration[0, 0] == 0
    assert corners.aberration[4, 4] == approx(RADIUS * math.sqrt(1.4))


@pytest.mark.parametrize("size", [None, lambda u, v: 1 + 0.3 * np.cos(900 * v)])
@pytest.mark.parametrize("turns", [0.0, 900.0, 3e3, 9e3, 4e4])
@pytest.mark.parametrize("height", [1e-12, 1e-6, 3e-4])
def test_polar_nodes_are_doubled_until_they_suffice(height, turns, size):
    """Up to 192 radii; rounding of many waves does not count as lacking nodes."""
    ring = {"obscuration": 0.2}

    def path(u, v):
        return height * np.cos(turns * u)

    wave = psf.Wavefront.from_function(path, amplitude=size, **SYSTEM, **ring)
    for n in (24, 48, 96, 192):
        u, v, _ = psf.polar_nodes(RADIUS, n, 4 * n, 0.2)
        lack = 0.0
        for values, scale in ((path(u, v), K), (size(u, v) if size else 0 * u, 1.0)):
            if np.ptp(values) > 0:
                least = max(1e-11, 1e-13 * scale * np.abs(values).max())
                lack = max(lack, scale * PolarSpectrum(values, RADIUS, 0.2).truncation() / least)
        if lack <= 1:
            break
    assert wave.u.shape == (n, 4 * n)
    if size is not None:
        assert_allclose(wave.amplitude, size(wave.u, wave.v), rtol=1e-12)


@pytest.mark.parametrize("turns", [0.0, 700.0, 3e3])
@pytest.mark.parametrize("aperture", [SEGMENTS, ROUND], ids=["straight", "curved"])
def test_cells_are_divided_until_they_suffice(aperture, turns):
    """Outlines with arcs begin with more nodes."""

    def path(u, v):
        return 2e-7 * np.cos(turns * u + 0.3) * (turns > 0)

    wave = psf.Wavefront.from_function(path, aperture=aperture, **SYSTEM)
    for n in (8, 12, 16, 24, 32, 48, 64)[aperture is ROUND :]:
        u, v, _ = aperture.nodes(n, n)
        lack = K * CellSpectrum(path(u, v), aperture).truncation() if turns else 0.0
        if lack <= max(1e-11, 1e-13 * K * np.abs(path(u, v)).max()):
            break
    assert wave.u.shape[1:] == (n, n)
    assert (wave.amplitude == 1).all()


def test_trials():
    assert Sampling("polar", None, RADIUS, 0.0, None).trials == [24, 48, 96, 192]
    assert Sampling("polar", (3, 5), RADIUS, 0.0, None).trials == [(3, 5)]
    assert Sampling("grid", None, RADIUS, 0.0, None).trials == [512]
    assert Sampling("grid", 17, RADIUS, 0.0, SEGMENTS).trials == [17]
    assert Sampling("cells", None, RADIUS, 0.0, SEGMENTS).trials == [8, 12, 16, 24, 32, 48, 64]
    assert Sampling("cells", None, RADIUS, 0.0, ROUND).trials == [12, 16, 24, 32, 48, 64]
    # at most a million nodes after the first trial
    row = psf.Aperture.union(
        *(psf.Aperture.regular(6, 2e-4).moved((5e-4 * i, 0.0)) for i in range(-49, 50))
    )
    n = len(row.owners)
    sides = [8, *(side for side in (12, 16, 24, 32, 48, 64) if n * side**2 <= 1_000_000)]
    assert Sampling("cells", None, RADIUS, 0.0, row).trials == sides
    assert len(sides) < 7


def test_nodes_by_layout():
    polar = Sampling("polar", None, 2.0, 0.3, None).nodes((3, 10))
    assert_allclose(polar.u, psf.polar_nodes(2.0, 3, 10, 0.3)[0])
    assert Sampling("polar", None, 2.0, 0.3, None).nodes(3).u.shape == (3, 12)
    grid = Sampling("grid", None, 2.0, 0.3, None).nodes(7)
    assert_allclose(grid.weights, psf.grid_nodes(2.0, 7, 0.3)[2])
    cells = Sampling("cells", None, RADIUS, 0.0, SEGMENTS).nodes((4, 6))
    assert cells.u.shape[1:] == (4, 6)
    assert Sampling("cells", None, RADIUS, 0.0, SEGMENTS).nodes(5).u.shape[1:] == (5, 5)
    assert_allclose(cells.owners[:, 0, 0], SEGMENTS.owners)
    lit = Sampling("grid", None, RADIUS, 0.0, SEGMENTS).nodes(30)
    assert lit.weights.sum() == approx(SEGMENTS.area, rel=1e-12)
    with pytest.raises(SceneError, match="samples = 1 is out of range"):
        Sampling("grid", None, 2.0, 0.0, None).nodes(1)


@pytest.mark.parametrize(
    ("values", "layout", "message"),
    [
        (np.zeros(4), "polar", r"has shape \(4,\); layout 'polar' needs 2 dimensions"),
        (
            np.zeros((4, 4)),
            "scattered",
            r"has shape \(4, 4\); layout 'scattered' needs 1 dimension$",
        ),
        (np.zeros((4, 4)), "cells", r"has shape \(4, 4\); layout 'cells' needs 3 dimensions"),
        (np.zeros((0, 4)), "polar", r"has shape \(0, 4\); layout 'polar' needs 2 dimensions"),
        (
            [[0, 1], [math.nan, 0]],
            "grid",
            r"aberration = nan at \(1, 0\); give finite numbers, and",
        ),
        ([[0, 1j]], "polar", "aberration is not an array of real numbers; give real values, and a"),
        ([["a"]], "polar", "aberration is not an array of real numbers"),
    ],
)
def test_refused_arrays(values, layout, message):
    with pytest.raises(SceneError, match=message):
        owned("aberration", values, layout)


def test_owned_arrays():
    given = np.ones((3, 4), dtype=np.float32)
    found = owned("amplitude", given, "grid")
    assert (found.dtype, found.shape, found.flags.writeable) == (np.float64, (3, 4), False)
    assert owned("aberration", np.ones((3, 4)), "polar").shape == (3, 4)


def test_polynomials_of_an_aperture():
    """On cells, on a grid, and on more nodes than are kept; a disc's polynomials at all of them."""
    for nodes, samples in (("cells", 6), ("cells", 60), ("grid", 31)):
        wave = psf.Wavefront.from_zernike(
            {3: 2e-8, 6: -4e-8}, aperture=SEGMENTS, nodes=nodes, samples=samples, **SYSTEM
        )
        lit = wave.weights > 0
        rho, theta = np.hypot(wave.u, wave.v) / RADIUS, np.arctan2(wave.v, wave.u)
        expected = 4e-8 * rho * np.sin(theta) - 4e-8 * math.sqrt(6) * rho**2 * np.cos(2 * theta)
        assert_allclose(wave.aberration[lit], expected[lit], atol=1e-21)
        assert not wave.aberration[~lit].any()
        assert (wave.amplitude == 1).all()
    with pytest.raises(SceneError, match=r"coefficients\[3\] = nan is not finite"):
        psf.Wavefront.from_zernike({3: math.nan}, aperture=SEGMENTS, **SYSTEM)
    with pytest.raises(SceneError, match="ordering = 'born' is unknown"):
        psf.Wavefront.from_zernike({}, ordering="born", **SYSTEM)


def test_range_of_the_hole():
    wave = psf.Wavefront.from_zernike({}, samples=(4, 12), **SYSTEM)
    for wrong in (0.995, -0.01):
        with pytest.raises(SceneError, match=f"wavefront.obscuration = {wrong} is out of range"):
            replace(wave, obscuration=wrong)


@pytest.mark.parametrize("counts", [(24, 96), (25, 97), (9, 41), (8, 40)])
@pytest.mark.parametrize("obscuration", [0.0, 0.3])
def test_extremes_at_the_rims(counts, obscuration):
    """No node is at the rims or the centre, where the series has its extremes too."""
    wave = psf.Wavefront.from_function(
        lambda u, v: 1e-7 * np.exp(400 * u - 300 * v),
        **SYSTEM,
        samples=counts,
        obscuration=obscuration,
    )
    residual = split(wave)
    u, v, _ = psf.polar_nodes(RADIUS, 4, counts[1], obscuration)
    angle = np.arctan2(v[0], u[0])
    plane = (wave.aberration - residual.aberration).ravel()
    corner = np.stack([np.ones(wave.u.size), wave.u.ravel(), wave.v.ravel()], axis=1)
    fit = np.linalg.lstsq(corner, plane, rcond=None)[0]
    ends = []
    for r in (RADIUS, obscuration * RADIUS):
        u, v = r * np.cos(angle), r * np.sin(angle)
        ends.append(1e-7 * np.exp(400 * u - 300 * v) - fit[0] - fit[1] * u - fit[2] * v)
    low = min(residual.heights.low, *map(np.min, ends))
    high = max(residual.heights.high, *map(np.max, ends))
    # the series through so few nodes
    found = regime(residual, 1e-6).peak_to_valley
    assert found == approx((high - low) / WAVELENGTH, rel=1e-4)


def test_regime_of_scattered_waves():
    rng = np.random.default_rng(6)
    u, v = rng.uniform(-2.5e-3, 2.5e-3, (2, 900))
    wave = psf.Wavefront(
        u=u,
        v=v,
        aberration=1e-2 * u**2 + 2e-2 * v**2 + 8e-3 * u * v + v**3,
        amplitude=np.ones(900),
        weights=np.full(900, 2.7e-8),
        layout="scattered",
        **SYSTEM,
    )
    residual = split(wave)
    assert residual.spacing == approx(math.sqrt(2.7e-8), rel=1e-12)
    step = residual.rays.slope * residual.spacing / WAVELENGTH
    assert regime(residual, 1e-6).slope_per_sample == approx(step, rel=1e-12)


def test_squares_of_two_segments():
    """Squares that touching segments share, by the largest step of the pupil function across."""
    pair = psf.Aperture.union(
        psf.Aperture.regular(4, 1e-3, math.pi / 4).moved((-1.01e-3, 0.0)),
        psf.Aperture.regular(4, 1e-3, math.pi / 4).moved((1.01e-3, 0.1e-3)),
    )
    wave = psf.Wavefront.from_function(
        aperture=pair, pistons=[0.0, 1.3e-7], nodes="grid", samples=33, **SYSTEM
    )
    residual = split(wave)
    total, most, owners = pair.grid_shares(33, wave.pupil_pitch)
    phase = np.exp(1j * K * residual.aberration)
    wide = 0.0
    for i in range(33):
        for j in range(33):
            for a, b in ((i + 1, j), (i, j + 1)):
                inside = a < 33 and b < 33 and total[i, j] > 0 and total[a, b] > 0
                if inside and owners[i, j] != owners[a, b]:
                    wide = max(wide, abs(phase[a, b] - phase[i, j]))
    assert residual.mixed_area == approx(wide * (total - most).sum() / total.sum(), rel=1e-12)
    # the step between the segments is no slope
    assert residual.jump()[0] * WAVELENGTH < 0.5e-7


def test_faint_scattered_nodes_are_dark():
    """Below 1e-12 of the strongest amplitude times area."""
    u, v = np.random.default_rng(6).uniform(-2.5e-3, 2.5e-3, (2, 80))
    amplitude = np.ones(80)
    amplitude[[7, 30, 51, 64]] = 0.8e-12, 1.2e-12, 1.8e-12, 0.0
    wave = psf.Wavefront(
        u=u,
        v=v,
        aberration=1e-3 * u * v,
        amplitude=amplitude,
        weights=np.full(80, 3e-7),
        layout="scattered",
        **SYSTEM,
    )
    lit = [i for i in range(80) if i not in (7, 64)]
    assert split(wave).local.indices.tolist() == lit
