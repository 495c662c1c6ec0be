"""Rough walls in two scales: closed forms at both ends, sums over pairs, and any split's mean."""

import math

import numpy as np
import pytest
from pytest import approx
from scipy import stats

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.rough.phase_screens import screens
from nlosoptics.psf.rough.sample import seen_through, speckle_pupil, wall_fields
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.window import Window
from nlosoptics.scene import FacetWall, GaussianWall

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
UNIT = 2 * WAVELENGTH
NORMAL = {"footprint": 0.55, "cos_sum": 2.0}
SKEW = {"footprint": [[0.7, 0.1], [-0.05, 0.5]], "cos_sum": 1.5}
#: Short enough that geometry holds for all walls here.
NEAR = 1e-4
D_EFF = 0.44


def wave_of(nodes="grid", samples=96, waves=None):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    if nodes == "polar":
        samples = None
    return psf.Wavefront.from_zernike(coefficients, nodes=nodes, samples=samples, **SYSTEM)


def wall(s, length, cos_sum=2.0, autocorrelation="gaussian"):
    """Roughness of Rayleigh parameter s."""
    return psf.Roughness(s * WAVELENGTH / (2 * np.pi * cos_sum), length, autocorrelation)


def test_scale_of_geometry():
    # d1 = d2 = 1 m: 3.2 mm, and the published turn at sqrt(lambda d_eff)
    assert psf.split_scale(WAVELENGTH, 0.5) == approx(3.153e-3, rel=1e-3)
    assert psf.split_scale(WAVELENGTH, 0.5, math.pi) == approx(math.sqrt(WAVELENGTH * 0.5))
    assert psf.split_scale(WAVELENGTH, np.diag([0.2, 0.5])) == psf.split_scale(WAVELENGTH, 0.5)
    for distance, turn in ((0.0, 0.1), ([1.0, 2.0], 0.1), (0.5, 0.0)):
        with pytest.raises(SceneError):
            psf.split_scale(WAVELENGTH, distance, turn)


@pytest.mark.parametrize("propagation", ["geometric", "fresnel"])
@pytest.mark.parametrize("nodes", ["grid", "polar"])
def test_ends_are_the_drawn_wall_and_the_mean(nodes, propagation):
    wave, roughness = wave_of(nodes, waves={8: 0.2, 2: 0.3}), wall(1.5, 4e-3)
    distance = NEAR if propagation == "geometric" else D_EFF
    view = {**NORMAL, "pitch": UNIT / 2, "shape": 40}
    drawn = {"effective_distance": distance, "propagation": propagation, "seed": 3}
    sample = psf.sample_point_spread(wave, roughness, **drawn, **view)
    mean = psf.mean_point_spread(wave, roughness, tol=0.02, **view)

    def at(cutoff):
        return psf.two_scale_point_spread(wave, roughness, cutoff=cutoff, tol=0.02, **drawn, **view)

    assert np.array_equal(at(0.0).intensity, sample.intensity)
    assert at(0.0).rayleigh_parameter == 0
    assert np.array_equal(at(math.inf).intensity, mean.intensity)
    # s^2 (cutoff/l)^2 of the light goes elsewhere
    near = at(1e-5 * 4e-3)
    assert near.intensity == approx(sample.intensity, abs=1e-8 * sample.intensity.max(), rel=0)
    # the long waves' phases are s l/cutoff = 1e-3; their tilt over the pupil some 1e-3 of that
    far = at(1.5e3 * 4e-3)
    limit = (far.error_estimate + mean.error_estimate + 2e-5) * mean.intensity.max()
    assert far.intensity == approx(mean.intensity, abs=limit, rel=0)
    assert far.coherent == approx(mean.coherent, abs=limit, rel=0)


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize("view", [NORMAL, SKEW], ids=["normal", "askew"])
@pytest.mark.parametrize("s", [0.8, 3.0])
def test_one_wall_is_the_sum_over_pairs_of_its_pupil_points(s, view, pixels):
    wave = wave_of(samples=40, waves={8: 0.1})
    roughness, cutoff, pitch = wall(s, 9e-3, view["cos_sum"]), 9e-3, UNIT / 2
    kwargs = {"pitch": pitch, "shape": 21, "pixel_integrated": pixels, **view}
    found = psf.two_scale_point_spread(
        wave,
        roughness,
        cutoff=cutoff,
        seed=5,
        effective_distance=D_EFF,
        propagation="fresnel",
        tol=0.07,
        **kwargs,
    )
    long, short = roughness.split(cutoff)
    seen = rough_source(wave, roughness, view["footprint"], view["cos_sum"], D_EFF).view
    residual = split(wave)
    samples = Window.centred(pitch, (21, 21))
    grid = speckle_pupil(residual, seen.of(long), samples)
    fields, between = wall_fields(residual, seen.of(long), grid, 5, "fresnel")
    pupil = seen_through(grid, next(fields), between).values
    lit = np.abs(pupil) > 0
    tilt = 2 * np.pi / WAVELENGTH * (residual.tilt[0] * wave.u + residual.tilt[1] * wave.v)
    values = (pupil * np.exp(1j * tilt))[lit]
    nodes = np.stack([wave.u[lit], wave.v[lit]])
    apart = nodes[:, :, None] - nodes[:, None, :]
    lag = np.hypot(*np.einsum("ab,bij->aij", seen.footprint, apart))
    factor = np.exp(-(seen.of(short).rayleigh_parameter ** 2) * short.structure(lag))
    scale = WAVELENGTH * DISTANCE
    if pixels:
        factor *= np.sinc(apart[0] * pitch / scale) * np.sinc(apart[1] * pitch / scale)
    level = residual.pixel_share(pitch)
    worst = 0.0
    for row, column in ((10, 10), (8, 13), (14, 9), (3, 11)):
        turns = (found.x[column] * nodes[0] + found.y[row] * nodes[1]) / scale
        light = values * np.exp(-2j * np.pi * turns)
        expected = float((light @ factor @ light.conj()).real) * level
        worst = max(worst, abs(found.intensity[row, column] - expected))
    # the estimate tells of the rim's cells, which both have in a different form
    assert worst < found.error_estimate * found.intensity.max()
    assert found.error_estimate < 0.07


#: Rayleigh parameter, correlation length, m, and pupil samples that hold the drawn wall.
WALLS = {1: (1.0, 4e-3, 48), 3: (3.0, 6e-3, 48), 10: (10.0, 10e-3, 64)}


@pytest.mark.parametrize("s", WALLS)
def test_mean_over_walls_does_not_depend_on_the_split(s):
    rayleigh, length, samples = WALLS[s]
    wave, roughness = wave_of(samples=samples), wall(rayleigh, length)
    kwargs = {"pitch": UNIT / 2, "shape": 24, **NORMAL}
    mean = psf.mean_point_spread(wave, roughness, tol=0.05, **kwargs)
    ring = (np.hypot(mean.y[:, None], mean.x) / (1.5 * UNIT)).astype(int).ravel()
    pixels = np.bincount(ring)[:4]
    expected = np.bincount(ring, mean.intensity.ravel())[:4] / pixels
    known = 0
    for cutoff, batches, each in ((0.3, 16, 8), (1.0, 12, 6), (3.0, 8, 4), (10.0, 8, 2)):
        drawn = [
            psf.two_scale_point_spread(
                wave,
                roughness,
                cutoff=cutoff * length,
                seed=i,
                independent_patterns=each,
                effective_distance=NEAR,
                tol=0.05,
                **kwargs,
            ).intensity.ravel()
            for i in range(batches)
        ]
        sums = np.stack([np.bincount(ring, p)[:4] / pixels for p in drawn])
        scatter = sums.std(axis=0, ddof=1) / math.sqrt(batches)
        # twelve comparisons of four rings, wrong in one run of a thousand
        chance = stats.t.isf(0.5e-3 / 48, batches - 1) * scatter
        limit = np.maximum(0.01 * expected.max(), chance)
        assert (np.abs(sums.mean(axis=0) - expected) < limit).all()
        known += int(chance.max() < 0.01 * expected.max())
    # and chance leaves some of them to the 1 % alone
    assert known >= 1


def test_halo_far_wider_than_the_window_keeps_its_energy():
    roughness, cutoff = wall(1.2, 0.3e-3), 4e-3
    kwargs = {"effective_distance": NEAR, "cutoff": cutoff, "seed": 2, "tol": 0.02, **NORMAL}
    wave = wave_of("polar")
    wide = psf.two_scale_point_spread(
        wave, roughness, pitch=4 * UNIT, shape=64, pixel_integrated=True, **kwargs
    )
    # the rim's tail beyond 128 lambda N, 2/(pi^2 128), and the rim of the drawn grid
    assert wide.enclosed_energy == approx(1.0, abs=3e-3)
    s = wide.rayleigh_parameter
    assert s == approx(1.2 * cutoff / math.hypot(cutoff, 0.3e-3), rel=1e-12)
    assert wide.coherent.sum() == approx(math.exp(-(s**2)), abs=3e-3)
    narrow = psf.two_scale_point_spread(
        wave, roughness, pitch=4 * UNIT, shape=8, pixel_integrated=True, **kwargs
    )
    assert narrow.enclosed_energy < 0.7
    inner = wide.intensity[28:36, 28:36]
    assert narrow.intensity == approx(inner, abs=2e-3 * inner.max(), rel=0)


def test_walls_are_averaged():
    wave, roughness = wave_of(), wall(3.0, 3e-3)
    kwargs = {"pitch": UNIT / 2, "shape": 32, "effective_distance": NEAR, "tol": 0.02, **NORMAL}

    def drawn(k):
        return psf.two_scale_point_spread(
            wave, roughness, cutoff=1e-3, seed=4, independent_patterns=k, **kwargs
        )

    one, two = drawn(1), drawn(2)
    second = 2 * two.intensity - one.intensity
    assert second.min() > -1e-12
    # another wall: speckles elsewhere in a like halo
    assert np.abs(second - one.intensity).max() > 0.3 * one.intensity.max()
    # each part is averaged
    assert (2 * two.coherent - one.coherent).min() > -1e-12


def test_a_cutoff_of_zero_leaves_one_wall():
    """Without fine structure nothing is scattered besides, and no error of it is added."""
    wave, roughness = wave_of(), wall(1.3, 3e-3)
    kwargs = {"pitch": UNIT / 2, "shape": (16, 19), "effective_distance": NEAR, "seed": 4, **NORMAL}
    found = psf.two_scale_point_spread(wave, roughness, cutoff=0.0, tol=0.02, **kwargs)
    one = psf.sample_point_spread(wave, roughness, **kwargs)
    assert found.intensity == approx(one.intensity, abs=1e-5 * one.intensity.max())
    assert np.array_equal(found.coherent, found.intensity)
    assert found.error_estimate == approx(one.error_estimate, rel=1e-6)
    assert found.rayleigh_parameter == 0.0


@pytest.mark.parametrize("normalisation", ["ideal-peak", "flux"])
def test_normalisations(normalisation):
    wave, roughness = wave_of(), wall(1.0, 4e-3)
    kwargs = {"pitch": UNIT / 2, "shape": 24, "effective_distance": NEAR, "tol": 0.02, **NORMAL}
    plain, scaled = (
        psf.two_scale_point_spread(
            wave, roughness, cutoff=4e-3, seed=1, normalisation=name, **kwargs
        )
        for name in ("unit-sum", normalisation)
    )
    smooth = [
        psf.point_spread(
            wave, pitch=UNIT / 2, shape=24, normalisation=name, model="scalar"
        ).intensity.max()
        for name in ("unit-sum", normalisation)
    ]
    factor = smooth[1] / smooth[0]
    assert scaled.intensity == approx(factor * plain.intensity, rel=1e-9)
    assert scaled.coherent == approx(factor * plain.coherent, rel=1e-9)


def test_scene_has_its_own_scale(flat_scene):
    view = psf.wall_view(flat_scene)
    cutoff = psf.split_scale(WAVELENGTH, view.effective_distance)
    roughness, kwargs = psf.Roughness(100e-9, 2e-3), {"pitch": UNIT / 2, "shape": 24, "seed": 1}
    direct = psf.two_scale_point_spread(flat_scene, roughness, **kwargs)
    steps = psf.two_scale_point_spread(
        psf.wavefront(flat_scene),
        roughness,
        cutoff=cutoff,
        footprint=view.footprint,
        cos_sum=view.cos_sum,
        effective_distance=view.effective_distance,
        **kwargs,
    )
    assert np.array_equal(direct.intensity, steps.intensity)
    _, short = roughness.split(cutoff)
    expected = 2 * np.pi / WAVELENGTH * view.cos_sum * short.height_rms
    assert direct.rayleigh_parameter == approx(expected, rel=1e-12)


@pytest.mark.parametrize("autocorrelation", ["gaussian", "exponential"])
def test_both_parts_can_be_drawn(autocorrelation):
    """Their spectra on a torus: what the filter passes of the whole's, and none below 0."""
    roughness = wall(1.0, 2e-3, autocorrelation=autocorrelation)
    view = rough_source(wave_of(), roughness, 0.5, 2.0, D_EFF).view
    parts = [view.of(part) for part in roughness.split(2e-3)]
    n, pitch = 240, 4e-4
    steps = (np.arange(n) + n // 2) % n - n // 2
    lags = view.lags(steps * pitch, (steps * pitch)[:, None])
    power = [
        np.fft.fft2(p.roughness.height_rms**2 * p.roughness.correlation(lags)).real
        for p in (view, *parts)
    ]
    # periods on the wall
    f = np.fft.fftfreq(n, pitch * 0.5)
    passed = np.exp(-((np.pi * 2e-3 * np.hypot(f, f[:, None])) ** 2))
    # the torus ends where C is 1e-10; an exponential's waves are folded, 1e-3 of the strongest
    folded = 1e-8 if autocorrelation == "gaussian" else 2e-3
    limit = folded * power[0].max()
    assert power[1] == approx(passed * power[0], abs=limit, rel=0)
    assert power[2] == approx((1 - passed) * power[0], abs=limit, rel=0)
    for part in parts:
        fields = screens(part, 48, 3e-4, WAVELENGTH, 0.0).draw(1)
        assert np.abs(next(fields)) == approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"effective_distance": None, "cutoff": None}, SceneError, "effective_distance is missing"),
        ({"cutoff": -1.0}, SceneError, "cutoff = -1"),
        ({"propagation": "rays"}, SceneError, "propagation"),
        ({"independent_patterns": 0}, SceneError, "independent_patterns"),
        ({"tol": 0.0}, SceneError, "tol = 0"),
        ({"tol": 1e-6}, SamplingError, "limit tol = 1e-06"),
        ({"pitch": UNIT}, SamplingError, "Nyquist"),
        ({"effective_distance": 40.0}, SamplingError, "for propagation='geometric'"),
    ],
)
def test_refuses(changes, kind, message):
    given = {"seed": 0, "pitch": UNIT / 2, "shape": 24, "effective_distance": NEAR, "tol": 0.02}
    given = {**given, "cutoff": 2e-3, **NORMAL, **changes}
    with pytest.raises(kind, match=message):
        psf.two_scale_point_spread(wave_of(), wall(1.0, 4e-3), **given)


@pytest.mark.parametrize("nodes", ["grid", "polar"])
def test_tol_that_a_refusal_names_is_enough(nodes):
    given = {"seed": 1, "cutoff": 4e-3, "effective_distance": NEAR, "pitch": UNIT / 2, "shape": 32}

    def spread(tol):
        wave = wave_of(nodes, waves={4: 0.2})
        return psf.two_scale_point_spread(wave, wall(1.0, 4e-3), tol=tol, **given, **NORMAL)

    with pytest.raises(SamplingError, match="the mean over the short waves") as refusal:
        spread(1e-9)
    spread(float(str(refusal.value).split("use tol = ")[1].split(",")[0]))


@pytest.mark.parametrize("given", [FacetWall(1e-3, 1e-3), GaussianWall(1e-6, 1e-3), 1e-6])
def test_only_statistics_of_heights_are_split(given):
    with pytest.raises(SceneError, match=f"is a {type(given).__name__}, but only the statistics"):
        psf.two_scale_point_spread(wave_of(), given, seed=0, effective_distance=NEAR, **NORMAL)
