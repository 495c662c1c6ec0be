"""Mean point spreads of rough walls, against sums over pupil points and drawn walls."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy import signal

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.rough import otf
from nlosoptics.psf.wave.detilted import split
from nlosoptics.scene import ConcaveWall

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
UNIT = 2 * WAVELENGTH
NORMAL = {"footprint": 0.55, "cos_sum": 2.0}
SKEW = {"footprint": [[0.7, 0.1], [-0.05, 0.5]], "cos_sum": 1.5}


def wave_of(waves=None, **changes):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, **{**SYSTEM, **changes})


def wall(s, length, cos_sum=2.0, autocorrelation="gaussian"):
    """Roughness of Rayleigh parameter s."""
    return psf.Roughness(s * WAVELENGTH / (2 * np.pi * cos_sum), length, autocorrelation)


def by_pairs(wave, roughness, footprint, cos_sum, points, pixel=0.0):
    """Mean intensity per area at image points: the sum over pairs of the wave's own nodes."""
    k = 2 * np.pi / wave.wavelength
    pupil = (wave.amplitude * wave.weights * np.exp(1j * k * wave.aberration)).ravel()
    nodes = np.stack([wave.u.ravel(), wave.v.ravel()])
    separation = nodes[:, :, None] - nodes[:, None, :]
    lag = np.einsum("ab,bij->aij", footprint, separation)
    s = k * cos_sum * roughness.height_rms
    factor = np.exp(-(s**2) * (1 - roughness.correlation(np.hypot(*lag))))
    scale = wave.wavelength * wave.image_distance
    if pixel:
        factor = factor * np.sinc(separation[0] * pixel / scale)
        factor *= np.sinc(separation[1] * pixel / scale)
    energy = float(np.sum(wave.amplitude**2 * wave.weights))
    found = []
    for x, y in points:
        lit = pupil * np.exp(-2j * np.pi * (x * nodes[0] + y * nodes[1]) / scale)
        found.append((lit @ factor @ lit.conj()).real / (energy * scale**2))
    return np.array(found)


def matrix(footprint):
    m = np.array(footprint, dtype=float)
    return m if m.ndim == 2 else m * np.eye(2)


CASES = {
    "clear": ({}, {}, NORMAL),
    "annulus": ({}, {"obscuration": 0.4}, NORMAL),
    "tilted coma, seen askew": ({2: 0.5, 3: -0.2, 8: 0.2}, {}, SKEW),
    "negative distance": ({7: 0.2, 4: 0.1}, {"image_distance": -DISTANCE}, SKEW),
}


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize("s", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_mean_is_the_sum_over_pairs_of_pupil_points(case, s, pixels):
    waves, changes, view = CASES[case]
    wave = wave_of(waves, samples=(14, 48), **changes)
    # wide enough a C that the 14 x 48 nodes hold it; the rule converges exponentially
    roughness = wall(s, 12e-3, view["cos_sum"])
    pitch = UNIT / 4
    mean = psf.mean_point_spread(
        wave, roughness, pitch=pitch, shape=81, tol=3e-4, pixel_integrated=pixels, **view
    )
    rows, columns = np.array([40, 40, 33, 49, 24]), np.array([40, 45, 38, 34, 55])
    points = np.stack([mean.x[columns], mean.y[rows]], axis=1)
    expected = by_pairs(
        wave,
        roughness,
        matrix(view["footprint"]),
        view["cos_sum"],
        points,
        pixel=pitch if pixels else 0.0,
    )
    peak = mean.intensity.max()
    error = np.abs(mean.intensity[rows, columns] - expected * pitch**2).max() / peak
    # the sum over pairs itself: 1e-9
    assert error < mean.error_estimate + 1e-9


@pytest.mark.parametrize("waves", [{}, {4: 0.3, 8: 0.1}])
@pytest.mark.parametrize("s", [0.0, 1e-7])
def test_smooth_limit_is_the_smooth_point_spread(waves, s):
    wave = wave_of(waves)
    smooth = psf.point_spread(wave, pitch=UNIT / 4, shape=128, model="scalar")
    mean = psf.mean_point_spread(wave, wall(s, 1e-3), pitch=UNIT / 4, shape=128, **NORMAL)
    # 1 - exp(-s^2) = 1e-14, and rounding
    assert mean.intensity == approx(smooth.intensity, abs=1e-12 * smooth.intensity.max(), rel=0)
    assert mean.coherent_fraction == approx(1, abs=1e-13)


@pytest.mark.thorough
def test_wall_longer_than_the_pupil_only_moves_the_phase():
    """With C = 1 over the pupil all light stays in the smooth shape."""
    wave = wave_of({8: 0.2})
    smooth = psf.point_spread(wave, pitch=UNIT / 4, shape=128, model="scalar")
    mean = psf.mean_point_spread(wave, wall(1.0, 1e3), pitch=UNIT / 4, shape=128, **NORMAL)
    # s^2 (2 RADIUS m/l)^2 = 2e-10, and what the estimate says
    assert mean.error_estimate < 1e-3
    limit = (mean.error_estimate + 1e-9) * smooth.intensity.max()
    assert mean.intensity == approx(smooth.intensity, abs=limit, rel=0)
    assert mean.coherent == approx(math.exp(-1) * smooth.intensity, rel=1e-12)


@pytest.mark.parametrize("view", [NORMAL, SKEW], ids=["normal", "askew"])
def test_rough_limit_is_the_distribution_of_slopes(view):
    roughness = wall(20.0, 1e-3, view["cos_sum"])
    m = matrix(view["footprint"])
    # slopes of sigma per axis are pupil slopes -(cos_i + cos_o) M^T grad h, thrown by d_i
    covariance = (view["cos_sum"] * roughness.slope_rms * DISTANCE) ** 2 * m.T @ m
    wide = math.sqrt(np.linalg.eigvalsh(covariance).max())
    mean = psf.mean_point_spread(wave_of(), roughness, pitch=wide / 10, shape=81, **view)
    x, y = np.meshgrid(mean.x, mean.y)
    at = np.stack([x, y], axis=-1)
    form = np.einsum("yxa,ab,yxb->yx", at, np.linalg.inv(covariance), at)
    slopes = np.exp(-form / 2) / (2 * np.pi * math.sqrt(np.linalg.det(covariance)))
    peak = slopes.max() * mean.pitch**2
    # C beyond its parabola, 1/s^2, and the blur by the Airy disc
    assert mean.intensity == approx(slopes * mean.pitch**2, abs=0.01 * peak, rel=0)
    assert mean.diffuse == approx(mean.intensity, abs=0)


@pytest.mark.thorough
def test_light_adds_up_and_its_shares_are_told():
    wave = wave_of(obscuration=0.3)
    mean = psf.mean_point_spread(wave, wall(0.8, 4e-3), shape=1024, pitch=UNIT / 2.2, **NORMAL)
    smooth = psf.point_spread(wave, shape=1024, pitch=UNIT / 2.2, model="scalar")
    # the halo ends well inside; what lacks is the rim's tail
    assert mean.enclosed_energy == approx(smooth.enclosed_energy, abs=2e-4)
    assert mean.intensity.sum() == approx(mean.enclosed_energy, rel=1e-12)
    share = mean.coherent.sum() / smooth.enclosed_energy
    assert share == approx(math.exp(-0.64), rel=1e-9)
    assert mean.rayleigh_parameter == approx(0.8, rel=1e-12)


@pytest.mark.parametrize("normalisation", ["ideal-peak", "flux"])
def test_normalisations_scale_as_those_of_the_smooth_wall(normalisation):
    wave = wave_of({6: 0.1}, obscuration=0.3)
    kwargs = {"pitch": UNIT / 4, "shape": 64}
    factor = (
        psf.point_spread(wave, normalisation=normalisation, **kwargs, model="scalar").intensity
        / psf.point_spread(wave, **kwargs, model="scalar").intensity
    ).max()
    plain = psf.mean_point_spread(wave, wall(1.0, 2e-3), **kwargs, **NORMAL)
    scaled = psf.mean_point_spread(
        wave, wall(1.0, 2e-3), normalisation=normalisation, **kwargs, **NORMAL
    )
    assert scaled.intensity == approx(factor * plain.intensity, rel=1e-9)


@pytest.mark.parametrize("s", [1.0, 10.0])
@pytest.mark.parametrize("length", [2e-3, 5e-5])
def test_grid_agrees_with_polar_nodes_within_its_estimate(s, length):
    """Down to a C far below the grid's pitch on the wall, 0.1 mm for 128 samples."""
    kwargs = {"pitch": UNIT / 4, "shape": 64, "tol": 1e-2, **NORMAL}
    waves = {8: 0.15, 4: 0.1}
    polar = psf.mean_point_spread(wave_of(waves), wall(s, length), **kwargs)
    grid = psf.mean_point_spread(
        wave_of(waves, nodes="grid", samples=128), wall(s, length), **kwargs
    )
    peak = polar.intensity.max()
    error = np.abs(grid.intensity - polar.intensity).max() / peak
    assert error < grid.error_estimate + polar.error_estimate
    assert grid.error_estimate < 8e-3


@pytest.mark.thorough
def test_exponential_and_given_correlations():
    """A function of the Gaussian C give its mean; the exponential has wider tails."""
    wave, kwargs = wave_of(), {"pitch": UNIT / 2, "shape": 201, **NORMAL}
    length = 2e-3
    named = psf.mean_point_spread(wave, wall(2.0, length), **kwargs)
    function = wall(2.0, length, autocorrelation=lambda r: np.exp(-((r / length) ** 2)))
    peak = named.intensity.max()
    from_function = psf.mean_point_spread(wave, function, **kwargs)
    assert from_function.intensity == approx(named.intensity, abs=1e-9 * peak, rel=0)
    sharp = psf.mean_point_spread(wave, wall(2.0, length, autocorrelation="exponential"), **kwargs)
    assert sharp.coherent == approx(named.coherent, rel=1e-9)
    # 2-D transform of s^2 exp(-r/l)'s leading cusp: a tail of r^-3, far below it for the Gaussian
    row = sharp.diffuse[100, 100:]
    assert row[100] / row[50] == approx(1 / 8, rel=0.15)
    # what is left there is the smooth rim's tail, which all light shares
    assert named.diffuse[100, 200] < 0.1 * sharp.diffuse[100, 200]


def drawn_coherence(source, centre, e1, curvature, roughness, seed):
    """Coherence of light at pupil points along e1, by brute force in the plane of incidence.

    Every wall is a sum of cosines on a line in that plane; every path is its true length.
    """
    k = 2 * np.pi / WAVELENGTH
    steps = np.linspace(-1, 1, 9) * RADIUS
    pupil = centre + steps[:, None] * e1
    x = np.linspace(-20e-3, 20e-3, 4001)
    points = np.stack([x, np.zeros_like(x), curvature * x**2 / 2], axis=1)
    path = np.linalg.norm(points - source, axis=1) - np.linalg.norm(source)
    way = np.linalg.norm(points - pupil[:, None], axis=2) - np.linalg.norm(pupil, axis=1)[:, None]
    # a soft edge, far from the 11 mm that the pupil sees; beyond 26 mm 10 um would alias
    taper = 0.5 * (np.tanh((x + 17e-3) / 1e-3) - np.tanh((x - 17e-3) / 1e-3))
    carry = taper * np.exp(1j * k * (path + way))
    cosines = source[2] / np.linalg.norm(source) + centre[2] / np.linalg.norm(centre)
    rng = np.random.default_rng(seed)
    total = np.zeros((9, 9), dtype=complex)
    for _ in range(60):
        # spectrum of C: normal frequencies of deviation sqrt(2)/l
        waves = rng.normal(size=(20, 80, 1)) * math.sqrt(2) / roughness.correlation_length
        phases = rng.uniform(0, 2 * np.pi, (20, 80, 1))
        coarse = x[::10]
        heights = np.cos(waves * coarse + phases).sum(axis=1) * math.sqrt(2 / 80)
        heights = np.stack([np.interp(x, coarse, row) for row in heights])
        light = np.exp(-1j * k * cosines * roughness.height_rms * heights) @ carry.T
        total += light.T @ light.conj()
    smooth = carry.sum(axis=1)
    smooth /= np.abs(smooth)
    power = np.sqrt(np.diag(total).real) * smooth
    return steps, total / power[:, None] / power.conj(), cosines


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("angle", "curvature"), [(0.0, 0.0), (45.0, 0.0), (45.0, 1 / 3.0)], ids=["0", "45", "hollow"]
)
def test_coherence_of_drawn_walls_is_that_of_the_footprint(flat_scene, angle, curvature):
    tilt = math.radians(angle)
    source = 1.0 * np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    camera = 0.7 * np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
    mean_wall = flat_scene.wall if curvature == 0 else ConcaveWall(1 / curvature, size=1.0)
    # a picture held at right angles to nothing: its reference point alone matters
    scene = replace(
        flat_scene,
        wall=mean_wall,
        hidden=replace(flat_scene.hidden, position=tuple(source)),
        camera=replace(flat_scene.camera, position=tuple(camera), aim=(0.0, 0.0, 0.0)),
    )
    view = psf.wall_view(scene)
    roughness = psf.Roughness(1.0 * WAVELENGTH / (2 * np.pi * view.cos_sum), 4e-3)
    e1 = scene.camera.frame[0]
    steps, found, cosines = drawn_coherence(source, camera, e1, curvature, roughness, 3)
    assert view.cos_sum == approx(cosines, rel=1e-9)
    lag = np.linalg.norm(view.footprint[:, :1], axis=0) * np.abs(steps[:, None] - steps)
    expected = np.exp(-roughness.structure(lag))
    # 1200 walls: 1/sqrt(1200) = 0.029 for one pair, the 17 lags' means less
    for i in range(1, 9):
        pairs = np.array([found[j, j + i] for j in range(9 - i)])
        assert pairs.mean().real == approx(np.diag(expected, i)[0], abs=0.04)


def test_scene_gives_wave_and_view(flat_scene):
    roughness = psf.Roughness(50e-9, 1e-3)
    view = psf.wall_view(flat_scene)
    assert np.linalg.inv(view.effective_distance) @ view.effective_distance == approx(np.eye(2))
    kwargs = {"shape": 64, "pitch": UNIT / 4}
    direct = psf.mean_point_spread(flat_scene, roughness, **kwargs)
    steps = psf.mean_point_spread(
        psf.wavefront(flat_scene),
        roughness,
        footprint=view.footprint,
        cos_sum=view.cos_sum,
        **kwargs,
    )
    assert np.array_equal(direct.intensity, steps.intensity)
    expected = 2 * np.pi / WAVELENGTH * view.cos_sum * 50e-9
    assert direct.rayleigh_parameter == approx(expected, rel=1e-12)


def test_window_by_default_holds_the_halo():
    mean = psf.mean_point_spread(wave_of(), wall(3.0, 2e-3), **NORMAL)
    assert mean.enclosed_energy > 0.97  # 3 standard deviations, and the rim's tail
    with pytest.raises(SamplingError, match="the halo reaches"):
        psf.mean_point_spread(wave_of(), wall(3.0, 2e-5), **NORMAL)


def test_lattice_is_the_closed_form():
    """Transfer functions from a lattice against exact overlaps, the ratio's error included."""
    clear = otf.transfer(split(wave_of(obscuration=0.3)))
    lattice = otf.transfer(split(wave_of(obscuration=0.3, nodes="grid", samples=256)))
    d = np.linspace(0, 2.2, 4000) * RADIUS
    difference = np.abs(clear.at(0.6 * d, 0.8 * d) - lattice.at(0.6 * d, 0.8 * d)).max()
    assert difference < lattice.error
    assert lattice.error < 3e-3


@pytest.mark.parametrize("n", [5, 8])
def test_autocorrelation_is_the_sum_over_pairs(n):
    rng = np.random.default_rng(n)
    values = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    found = otf._correlation(values)
    expected = np.zeros_like(found)
    expected[1:, 1:] = signal.correlate2d(values, values)
    assert np.abs(found - expected).max() < 1e-12


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"footprint": None}, "footprint is missing"),
        ({"cos_sum": None}, "cos_sum is missing"),
        ({"cos_sum": 2.1}, "cos_sum = 2.1"),
        ({"footprint": [[1, 1], [1, 1]]}, "singular"),
        ({"footprint": [1, 1]}, "shape"),
        ({"tol": 0.0}, "tol = 0"),
    ],
)
def test_refuses(changes, message):
    kwargs = {"shape": 32, "pitch": UNIT / 4, **NORMAL, **changes}
    with pytest.raises(SceneError, match=message):
        psf.mean_point_spread(wave_of(), wall(1.0, 1e-3), **kwargs)


def test_refuses_geometry_beside_a_scene(flat_scene):
    with pytest.raises(SceneError, match="given with a scene"):
        psf.mean_point_spread(flat_scene, wall(1.0, 1e-3), cos_sum=2.0)


def test_refuses_what_the_nodes_cannot_reach():
    with pytest.raises(SamplingError, match="limit tol"):
        psf.mean_point_spread(
            wave_of({4: 0.2}, nodes="grid", samples=32),
            wall(10.0, 1e-2),
            shape=32,
            pitch=UNIT / 4,
            tol=1e-6,
            **NORMAL,
        )
