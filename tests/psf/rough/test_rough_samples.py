"""Speckle patterns of drawn rough walls: against the mean, laws of speckle, and closed forms."""

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from pytest import approx
from scipy import fft, stats

from nlosoptics import psf
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.rough.phase_screens import Between, propagated, screens, throw
from nlosoptics.psf.rough.source import rough_source

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
UNIT = 2 * WAVELENGTH
NORMAL = {"footprint": 0.55, "cos_sum": 2.0}
D_EFF = 0.44
#: d1 = 1 m, d2 = 0.8 m, 45 deg: in plane 1/(cos^2/d1 + cos^2/d2) and d1 cos/(d1 cos^2 + d2 cos^2).
C45 = math.cos(math.pi / 4)
ASKEW = {"footprint": np.diag([1 / (1.8 * C45), 1 / 1.8]), "cos_sum": 2 * C45}
ASKEW_D_EFF = np.diag([0.8 / (1.8 * C45**2), 0.8 / 1.8])


def grid_wave(samples=96, waves=None):
    coefficients = {j: w * WAVELENGTH for j, w in (waves or {}).items()}
    return psf.Wavefront.from_zernike(coefficients, nodes="grid", samples=samples, **SYSTEM)


def wall(s, length, cos_sum=2.0, autocorrelation="gaussian"):
    """Roughness of Rayleigh parameter s."""
    return psf.Roughness(s * WAVELENGTH / (2 * np.pi * cos_sum), length, autocorrelation)


def patterns(wave, roughness, count, *, view=NORMAL, distance=D_EFF, **kwargs):
    """Patterns of seeds 0 to count - 1, (count, ny, nx)."""
    kwargs = {"pitch": UNIT / 2, "shape": 48, "effective_distance": distance, **view, **kwargs}
    return np.stack(
        [psf.sample_point_spread(wave, roughness, seed=i, **kwargs).intensity for i in range(count)]
    )


def rings(spread, width):
    """Index of each pixel's ring about the axis."""
    return (np.hypot(spread.y[:, None], spread.x) / width).astype(int)


#: Rayleigh parameter, correlation length, m, samples a side of the window, and geometry.
CASES = {
    "s = 0.3": (0.3, 2e-3, 48, NORMAL, D_EFF),
    "s = 1": (1.0, 2e-3, 48, NORMAL, D_EFF),
    "s = 3": (3.0, 4e-3, 48, NORMAL, D_EFF),
    "s = 10": (10.0, 5e-3, 80, NORMAL, D_EFF),
    "s = 0.3, 45 deg": (0.3, 3e-3, 48, ASKEW, ASKEW_D_EFF),
    "s = 1.5, 45 deg": (1.5, 3e-3, 48, ASKEW, ASKEW_D_EFF),
    "s = 3, 45 deg": (3.0, 6e-3, 48, ASKEW, ASKEW_D_EFF),
    "s = 10, 45 deg": (10.0, 7e-3, 80, ASKEW, ASKEW_D_EFF),
}


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
def test_patterns_tend_to_the_mean_in_every_ring(case):
    s, length, shape, view, distance = CASES[case]
    wave, roughness, count = grid_wave(), wall(s, length, view["cos_sum"]), 160
    drawn = patterns(wave, roughness, count, view=view, distance=distance, shape=shape)
    spread = psf.mean_point_spread(wave, roughness, pitch=UNIT / 2, shape=shape, tol=0.02, **view)
    mean, ring = spread.intensity, rings(spread, 2 * UNIT)
    labels = np.arange(10)
    sums = np.stack([np.bincount(ring.ravel(), p.ravel())[:10] for p in drawn])
    expected = np.bincount(ring.ravel(), mean.ravel())[:10]
    scatter = sums.std(axis=0, ddof=1) / math.sqrt(count)
    # ten rings, wrong in one run of a thousand; the grid's 96 samples know the rim to 0.5 %
    family = stats.norm.isf(1e-3 / 2 / len(labels))
    limit = np.maximum(0.02 * expected, family * scatter)
    assert (np.abs(sums.mean(axis=0) - expected) < limit).all()
    # and that is no empty promise: rings are known to some percent
    assert np.median(scatter / expected) < 0.07


@pytest.mark.thorough
def test_error_falls_as_the_root_of_the_count():
    wave, roughness = grid_wave(), wall(2.0, 2e-3)
    drawn = patterns(wave, roughness, 512, shape=32)
    mean = psf.mean_point_spread(wave, roughness, pitch=UNIT / 2, shape=32, tol=0.02, **NORMAL)
    counts = np.array([1, 4, 16, 64])
    errors = []
    for n in counts:
        groups = drawn.reshape(512 // n, n, 32, 32).mean(axis=1)
        errors.append(math.sqrt(np.mean((groups - mean.intensity) ** 2)))
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == approx(-0.5, abs=0.1)


#: Some 150 bumps in the pupil, and a core of exp(-s^2) = 1e-7: the middle of the halo is developed.
DEVELOPED = wall(4.0, 1e-3)


def developed(count=120):
    """Patterns over their mean, 40 x 40 points of half a lambda N."""
    wave = grid_wave(192)
    drawn = patterns(wave, DEVELOPED, count, shape=40)
    mean = psf.mean_point_spread(wave, DEVELOPED, pitch=UNIT / 2, shape=40, tol=0.02, **NORMAL)
    return drawn / mean.intensity


@pytest.mark.thorough
def test_developed_speckle():
    """Contrast 1, an exponential law, and grains of the pupil's autocorrelation."""
    drawn = developed()
    # 20 x 20 grains a pattern: 1/sqrt(5e4) from chance; the bumps' finite number adds 1 %
    contrast = drawn.std() / drawn.mean()
    assert contrast == approx(1, abs=0.03)
    # points eight lambda N apart
    apart = drawn[::2, 4::16, 4::16].ravel()
    assert stats.kstest(apart, "expon").pvalue > 1e-3
    # covariance of the normalised pattern over displacements, by its spectrum without wrap-round
    excess = drawn - 1
    spectrum = np.abs(fft.fft2(excess, s=(80, 80))) ** 2
    overlap = fft.ifft2(np.abs(fft.fft2(np.ones((40, 40)), s=(80, 80))) ** 2).real
    covariance = (fft.ifft2(spectrum.mean(axis=0)).real / np.maximum(overlap, 1e-9))[0, :16]
    covariance /= covariance[0]
    # |mu|^2 is the Airy disc of the whole pupil: half at 0.5145 lambda N
    lag = np.arange(16) / 2
    half = np.interp(-0.5, -covariance[:4], lag[:4])
    fine = np.linspace(0, 1.5, 301)
    from_airy = np.interp(lag, fine, airy(fine))
    half_of_airy = np.interp(-0.5, -from_airy[:4], lag[:4])
    assert half == approx(half_of_airy, rel=0.05)
    assert covariance[:4] == approx(airy(lag[:4]), abs=0.03)


def airy(r):
    """Intensity at r Airy units."""
    from scipy.special import j1

    v = np.maximum(np.pi * r, 1e-9)
    return (2 * j1(v) / v) ** 2


@pytest.mark.thorough
def test_patterns_are_averaged():
    wave, roughness = grid_wave(192), DEVELOPED
    kwargs = {"pitch": UNIT / 2, "shape": 30, "effective_distance": D_EFF, **NORMAL}

    def drawn(seed, k=1):
        return psf.sample_point_spread(
            wave, roughness, seed=seed, independent_patterns=k, **kwargs
        ).intensity

    one, again, other, two = drawn(5), drawn(5), drawn(6), drawn(5, 2)
    assert np.array_equal(one, again)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] < 0.3
    second = 2 * two - one
    assert second.min() > -1e-15
    assert np.corrcoef(one.ravel(), second.ravel())[0, 1] < 0.3
    mean = psf.mean_point_spread(
        wave, roughness, pitch=UNIT / 2, shape=30, tol=0.02, **NORMAL
    ).intensity
    averaged = np.stack([drawn(seed, 16) for seed in range(12)]) / mean
    # 12 patterns of 15 x 15 grains: 2 %; and as much for the mean itself
    assert averaged.std() == approx(0.25, rel=0.06)


@pytest.mark.parametrize("distance", [0.1, 0.44, 2.0])
def test_light_scintillates_on_its_way(distance):
    """Weak screens: variance 2 s^2 x^2/(1 + x^2) of the pupil's intensity, x = 2 lambda d/(pi l^2).

    Each wave of the height comes as amplitude by sin(q); averaged over the Gaussian spectrum in
    two dimensions, 2 sin^2(q) = 1 - cos(2 q) has the mean x^2/(1 + x^2).
    """
    length, s = 0.5e-3, 0.05
    view = rough_source(grid_wave(), wall(s, length), 0.55, 2.0, distance).view
    walls = screens(view, 200, 2e-4, WAVELENGTH, throw(view, view.halo(grid_wave()) / DISTANCE))
    light = np.stack([np.abs(f[:200, :200]) ** 2 for f in islice(walls.draw(1), 8)])
    x = 2 * WAVELENGTH * distance / (math.pi * length**2)
    # 8 screens of some (40 mm 0.55/0.5 mm)^2/3 grains: 1 %; the next order s^2
    assert light.var() == approx(2 * s**2 * x**2 / (1 + x**2), rel=0.04)
    assert light.mean() == approx(1, abs=1e-3)


def test_ripple_comes_as_talbot_has_it():
    """One wave of the screen along an oblique direction, by its Bessel series on the wall."""
    from scipy.special import jv

    view = rough_source(
        grid_wave(), wall(1.2, 2e-3), [[0.7, 0.2], [-0.1, 0.5]], 2.0, ASKEW_D_EFF
    ).view
    walls = screens(view, 100, 2e-4, WAVELENGTH, 5e-3)
    n = walls.size
    j = np.arange(n)
    ku, kv = 4, -7
    phase = 2 * np.pi * (ku * j + kv * j[:, None]) / n
    screen = np.exp(-1.2j * np.cos(phase))
    assert walls.distance is not None
    found = propagated(screen.copy(), walls.distance, walls.pitch, walls.wavelength)
    # wave vector on the wall: q . M p = k . p
    q = np.linalg.solve(view.footprint.T, np.array([ku, kv]) / (n * 2e-4))
    turn = math.pi * WAVELENGTH * q @ view.effective_distance @ q
    series = [(-1j) ** m * jv(m, 1.2) * np.exp(1j * m * (phase - m * turn)) for m in range(-20, 21)]
    assert turn > 0.1
    assert np.abs(found - sum(series)).max() < 1e-12


@pytest.mark.parametrize(("size", "cells", "count"), [(12, 3, 20), (15, 4, 31), (20, 1, 20)])
def test_interpolated_lattices_are_sums_of_their_waves(size, cells, count):
    """Against the direct sum of the plane waves of a random field below the highest frequency."""
    draw = np.random.default_rng(3)
    k = np.fft.fftfreq(size) * size
    waves = draw.normal(size=(size, size)) + 1j * draw.normal(size=(size, size))
    lit = np.abs(k) < size / 2
    waves = waves * lit * lit[:, None]
    turns = np.exp(2j * np.pi * np.outer(np.arange(count), k) / (size * cells))
    expected = turns @ waves @ turns.T
    found = Between(size, cells, count)(np.fft.ifft2(waves, norm="forward"))
    # rounding of sums of 400 terms of order 1
    assert np.abs(found - expected).max() < 1e-11


@pytest.mark.thorough
def test_drawn_heights_have_their_correlation():
    roughness = wall(1.0, 2e-3, autocorrelation="exponential")
    footprint = np.array([[0.6, 0.5], [-0.1, 0.4]])
    view = rough_source(grid_wave(), roughness, footprint, 2.0, D_EFF).view
    walls = screens(view, 64, 2e-4, WAVELENGTH, 0.0)
    walls = replace(walls, phase_rms=1e-6, distance=np.zeros((2, 2)))
    size = walls.heights.shape[0]
    heights = np.stack([-f.imag * 1e6 for f in islice(walls.draw(2), 40)])
    power = np.mean(np.abs(fft.fft2(heights)) ** 2, axis=0)
    found = fft.ifft2(power).real / size**2
    steps = np.arange(64) * 2e-4
    # the torus ends at C = 1e-6; 40 surfaces of some (14 l/l)^2 pi/6 grains: 1.5 % of the variance
    for along, row in enumerate((found[0, :64], found[:64, 0])):
        lags = steps * np.linalg.norm(footprint[:, along])
        assert row == approx(np.exp(-lags / 2e-3), abs=0.06)


@pytest.mark.parametrize("samples", [64, 128])
def test_error_estimate_bounds_that_of_the_grid(samples):
    """The same wall on a pupil four times finer, its field continued by its own waves."""
    coarse, fine = grid_wave(samples + 1), grid_wave(4 * samples + 1)
    kwargs = {"pitch": UNIT / 2, "shape": 32, "effective_distance": D_EFF, "seed": 4, **NORMAL}
    # short enough that every pupil point is one of the screen's lattice
    roughness = wall(1.0, 1.8e-3)
    spread = psf.sample_point_spread(coarse, roughness, **kwargs)
    view = rough_source(coarse, roughness, 0.55, 2.0, D_EFF).view
    reach = throw(view, view.halo(coarse) / DISTANCE)
    walls = screens(view, samples + 1, coarse.pupil_pitch, WAVELENGTH, reach)
    field = next(walls.draw(4))
    n = field.shape[0]
    # both grids have their middle sample on the axis
    scale = coarse.pupil_pitch / fine.pupil_pitch
    place = (np.arange(4 * samples + 1) - 2 * samples) / scale + samples // 2
    row = np.exp(2j * np.pi * np.outer(place, np.fft.fftfreq(n)))
    continued = row @ (fft.fft2(field) / n**2) @ row.T
    total = fine.amplitude * fine.weights
    k = -2j * np.pi / (WAVELENGTH * DISTANCE)
    x = np.exp(k * np.outer(spread.x, fine.u[0]))
    image = np.abs(x @ (total * continued) @ x.T) ** 2
    image *= spread.pitch**2 / (np.sum(total) * (WAVELENGTH * DISTANCE) ** 2)
    error = np.abs(spread.intensity - image).max() / image.max()
    assert error < spread.error_estimate
    assert spread.error_estimate < 0.1


def test_smooth_wall_has_the_smooth_point_spread():
    wave = grid_wave(waves={8: 0.1})
    kwargs = {"pitch": UNIT / 4, "shape": 64}
    smooth = psf.point_spread(wave, method="mdft", **kwargs)
    drawn = psf.sample_point_spread(
        wave, wall(0.0, 1e-3), seed=0, effective_distance=D_EFF, **NORMAL, **kwargs
    )
    assert drawn.intensity == approx(smooth.intensity, abs=1e-13 * smooth.intensity.max(), rel=0)
    assert drawn.enclosed_energy == approx(smooth.enclosed_energy, rel=1e-12)


def test_polar_nodes_and_pixels():
    """A polar wave is put on a grid of its own; pixels hold the light of the samples in them."""
    polar = psf.Wavefront.from_zernike({8: 0.1 * WAVELENGTH}, **SYSTEM)
    kwargs = {"effective_distance": D_EFF, "seed": 3, **NORMAL}
    roughness = wall(1.0, 4e-3)
    pixels = psf.sample_point_spread(
        polar, roughness, pitch=UNIT, shape=24, pixel_integrated=True, **kwargs
    )
    total = psf.mean_point_spread(
        polar, roughness, pitch=UNIT, shape=24, pixel_integrated=True, **NORMAL
    )
    assert pixels.error_estimate < 1e-3
    # one wall's core scatters
    assert pixels.enclosed_energy == approx(total.enclosed_energy, abs=0.1)
    many = psf.sample_point_spread(
        polar,
        roughness,
        pitch=UNIT,
        shape=24,
        pixel_integrated=True,
        independent_patterns=60,
        **kwargs,
    )
    assert many.intensity.sum() == approx(total.intensity.sum(), rel=0.03)


def test_scene_is_sampled(flat_scene):
    roughness = psf.Roughness(60e-9, 3e-3)
    view = psf.wall_view(flat_scene)
    kwargs = {"pitch": UNIT / 4, "shape": 48, "seed": 2}
    direct = psf.sample_point_spread(flat_scene, roughness, **kwargs)
    steps = psf.sample_point_spread(
        psf.wavefront(flat_scene),
        roughness,
        footprint=view.footprint,
        cos_sum=view.cos_sum,
        effective_distance=view.effective_distance,
        **kwargs,
    )
    assert np.array_equal(direct.intensity, steps.intensity)


@pytest.mark.parametrize(
    ("changes", "roughness", "kind", "message"),
    [
        ({"effective_distance": None}, wall(1, 2e-3), SceneError, "effective_distance is missing"),
        ({"effective_distance": [[1, 0.2], [0, 1]]}, wall(1, 2e-3), SceneError, "symmetric"),
        ({"seed": -1}, wall(1, 2e-3), SceneError, "seed"),
        ({"independent_patterns": 0}, wall(1, 2e-3), SceneError, "independent_patterns"),
        ({"pitch": UNIT}, wall(1, 2e-3), SamplingError, "Nyquist"),
        ({}, wall(3, 1e-3), SamplingError, "pupil's pitch"),
        (
            {"shape": 400},
            wall(3, 3e-3),
            SamplingError,
            "whose image reaches",
        ),
        ({"effective_distance": 1e6}, wall(1, 2e-3), MemoryLimitError, "screen of"),
        (
            {},
            wall(1, 2e-3, autocorrelation=lambda r: np.where(r < 4e-3, 1 - (r / 4e-3) ** 2, 0)),
            SceneError,
            "negative power",
        ),
        ({}, wall(1, 2e-3, autocorrelation=lambda r: np.exp(-0 * r)), SceneError, "stays above"),
    ],
)
def test_refuses(changes, roughness, kind, message):
    given = {"seed": 0, "pitch": UNIT / 2, "shape": 32, "effective_distance": D_EFF, **NORMAL}
    with pytest.raises(kind, match=message):
        psf.sample_point_spread(grid_wave(), roughness, **{**given, **changes})
