"""Patterns of single rough walls against direct sums over the pupil, and the limits of sampling."""

import math
from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.rough import phase_screens, sample
from nlosoptics.psf.rough.relief import ReliefView, relief_screen
from nlosoptics.psf.rough.view import RoughView
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.window import Window
from nlosoptics.scene import FacetWall, GaussianWall

WAVELENGTH, DISTANCE, RADIUS = 5.3e-7, 0.06, 4e-3
FOOTPRINT = np.array([[0.7, 0.2], [-0.15, 0.45]])
SPREAD = np.array([[0.6, 0.13], [0.13, 0.35]])
GEOMETRY = {"footprint": FOOTPRINT, "cos_sum": 1.6, "effective_distance": SPREAD}
PITCH = 1.9e-6
K = 2 * math.pi / WAVELENGTH
ACROSS = np.linalg.svd(FOOTPRINT)[1][0]


def path(u, v):
    return 4e-5 * u - 3e-5 * v + 3e-3 * u * v - 2e-3 * u * u


def wave(samples=31, distance=DISTANCE):
    return psf.Wavefront.from_function(
        path,
        amplitude=lambda u, v: 1.0 - 2e4 * (u**2 + 0.5 * v**2) + 30 * u,
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=distance,
        nodes="grid",
        samples=samples,
    )


def rough(s, length, autocorrelation="gaussian"):
    return psf.Roughness(s / (1.6 * K), length, autocorrelation)


def by_sums(front, field, shape, pitch=PITCH):
    """Energy per pixel of a wave times a wall's field: a sum of plane waves, of energy 1."""
    ny, nx = shape
    x, y = (np.arange(nx) - nx // 2) * pitch, (np.arange(ny) - ny // 2) * pitch
    values = front.amplitude * front.weights * np.exp(1j * K * front.aberration) * field
    turn = -1j * K / front.image_distance
    image = (
        np.exp(turn * np.outer(y, front.v[:, 0])) @ values @ np.exp(turn * np.outer(front.u[0], x))
    )
    area = np.sum(front.amplitude**2 * front.weights)
    return np.abs(image) ** 2 * (pitch / (WAVELENGTH * front.image_distance)) ** 2 / area


def fields(front, wall, seed):
    """Fields at the pupil points of a lattice as fine as the pupil's."""
    view = RoughView(wall, FOOTPRINT, 1.6 * K * wall.height_rms, SPREAD)
    angle = view.halo(front) / abs(front.image_distance)
    reach = phase_screens.throw(view, angle)
    n, pitch = len(front.u), front.pupil_pitch
    step = phase_screens.stride(view, pitch)
    cells = n if step == 1 else math.ceil(n / step) + 1
    walls = phase_screens.screens(view, cells, step * pitch, WAVELENGTH, reach)
    between = (
        phase_screens.Between(walls.size, step, n) if step > 1 else lambda field: field[:n, :n]
    )
    return step, (between(field) for field in walls.draw(seed))


@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
@pytest.mark.parametrize(
    ("samples", "wall", "step"),
    [
        (31, rough(1.3, 2.1e-3), 1),
        (91, rough(0.05, 4e-3), 14),
        (31, rough(0.4, 2.5e-3, "exponential"), 1),
    ],
)
def test_pattern_is_a_sum_over_the_pupil(samples, wall, step, distance):
    front, shape = wave(samples, distance), (12, 15)
    found = psf.sample_point_spread(
        front,
        wall,
        seed=5,
        independent_patterns=3,
        pitch=PITCH,
        shape=shape,
        **GEOMETRY,
    )
    taken, drawn = fields(front, wall, 5)
    assert taken == step
    expected = np.mean([by_sums(front, one, shape) for one in islice(drawn, 3)], axis=0)
    assert_allclose(found.intensity, expected, atol=1e-9 * expected.max())
    assert found.enclosed_energy == approx(expected.sum(), rel=1e-9)
    assert (found.pitch, found.wavelength, found.pixel_integrated) == (PITCH, WAVELENGTH, False)
    assert found.method == "fresnel screen + mdft"
    assert found.reason.startswith("a phase screen")
    assert found.f_number == front.f_number
    assert found.normalisation == "unit-sum"
    s = 1.6 * K * wall.height_rms
    assert found.regime.coherent_fraction == approx(math.exp(-(s**2)), rel=1e-9)


@pytest.mark.parametrize(
    "relief", [FacetWall(1.5e-2, 2e-6, seed=3), GaussianWall(2e-8, 6e-3, seed=2)]
)
def test_pattern_of_given_heights(relief):
    front, shape = wave(), (9, 14)
    asked = GEOMETRY | {"pitch": PITCH, "shape": shape}
    found = psf.sample_point_spread(front, relief, **asked)
    s, n = 1.6 * K * relief.height_rms, len(front.u)
    view = ReliefView(relief, FOOTPRINT, s, SPREAD, np.zeros(2), np.eye(2))
    screen = relief_screen(view, n, front.pupil_pitch, WAVELENGTH, n // 2)
    expected = by_sums(front, screen.field()[:n, :n], shape)
    # interpolated between wider points of the lattice
    assert_allclose(found.intensity, expected, atol=2e-3 * expected.max())
    assert np.abs(found.intensity - by_sums(front, 1.0, shape)).max() > 0.02 * expected.max()


def test_normalisations_and_pixels():
    front, wall = wave(), rough(1.3, 2.1e-3)
    asked = GEOMETRY | {"pitch": PITCH, "shape": (8, 9), "seed": 1}
    plain = psf.sample_point_spread(front, wall, **asked)
    clear = np.sum(front.amplitude**2 * front.weights) / (math.pi * RADIUS**2)
    ideal = np.sum(front.amplitude * front.weights) ** 2 / np.sum(
        front.amplitude**2 * front.weights
    )
    factors = {"flux": clear, "ideal-peak": (WAVELENGTH * DISTANCE / PITCH) ** 2 / ideal}
    for name, factor in factors.items():
        other = psf.sample_point_spread(front, wall, **asked, normalisation=name)
        assert_allclose(other.intensity, factor * plain.intensity, rtol=1e-9)
        assert other.enclosed_energy == approx(plain.enclosed_energy, rel=1e-12)
        assert other.normalisation == name
    wide = asked | {"pitch": 3 * PITCH, "pixel_integrated": True}
    pixels = psf.sample_point_spread(front, wall, **wide)
    _, drawn = fields(front, wall, 1)
    parts = 15  # samples of a pixel side, whose mean is that of the pixel to 1e-3
    fine = by_sums(front, next(drawn), (8 * parts, 9 * parts), 3 * PITCH / parts)
    # the middle sample of pixel [4, 4] is on the axis, as sample [60, 67] is
    rows = np.roll(fine, 7, axis=0)[:, :].reshape(8, parts, 9, parts)
    expected = rows.sum(axis=(1, 3))
    assert_allclose(pixels.intensity, expected, atol=1e-3 * expected.max())
    assert pixels.pixel_integrated


NARROW = rough(0.4, 3e-3)


@pytest.mark.parametrize(
    ("wall", "changes", "message"),
    [
        (NARROW, {"seed": None}, "seed is missing, which selects the random wall; give seed = 0"),
        (NARROW, {"seed": 2**64}, "seed = .* out of range"),
        (FacetWall(8e-3, 1e-6), {}, "seed = 0 is given with the heights of one wall; leave it out"),
        (
            FacetWall(8e-3, 1e-6),
            {"seed": None, "independent_patterns": 2},
            "independent_patterns = 2 with the heights of one wall, limit 1; give a Roughness",
        ),
        (NARROW, {"independent_patterns": 0}, "independent_patterns = 0 is out of range"),
        (NARROW, {"normalisation": "sum"}, "normalisation = 'sum' is unknown"),
    ],
)
def test_refuses(wall, changes, message):
    asked = GEOMETRY | {"pitch": PITCH, "shape": 8, "seed": 0} | changes
    with pytest.raises(SceneError, match=message):
        psf.sample_point_spread(wave(), wall, **asked)


def view_of(wall, s=0.4):
    return RoughView(wall, FOOTPRINT, s, SPREAD)


@pytest.mark.parametrize("factor", [1 - 1e-6, 1 + 2e-9])
def test_pitch_of_a_grid_wave(factor):
    """The pupil's pitch is the widest one of the wall, for the lags at which C falls by 1/9."""
    residual = split(wave())
    length = residual.wavefront.pupil_pitch * ACROSS / math.sqrt(-math.log1p(-1 / 9)) * factor
    view, window = view_of(rough(0.4, length)), Window.centred(1e-7, (5, 8))
    finest = phase_screens.widest_pitch(view)
    if factor > 1:
        assert sample.speckle_pupil(residual, view, window).pitch == residual.wavefront.pupil_pitch
        return
    message = (
        f"the pupil's pitch is {residual.wavefront.pupil_pitch:.3g} m, limit {finest:.3g} m for"
    )
    with pytest.raises(
        SamplingError, match=f"{message} a wall of Rayleigh parameter 0.4 whose image reaches"
    ) as refusal:
        sample.speckle_pupil(residual, view, window)
    assert "wavefront of 33 or more pupil samples (now 31), or of polar nodes" in str(refusal.value)
