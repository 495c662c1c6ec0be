"""Point spreads of independent facets: closed forms, and the wave where rays give it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.inverse import FacetPSF, PupilPSF

PUPIL = {"pupil_radius": 5e-3, "image_distance": 0.05, "pitch": 8e-6, "shape": 64}
COUNT = 65
FACETS = {"angle_pitch": 1e-2 / (COUNT - 1), **PUPIL, "dtype": torch.float64}
FLAT = np.zeros((COUNT, COUNT, 2))
WAVELENGTH = 632.8e-9


def drawn(seed=0, slope=1e-3, count=COUNT):
    return np.random.default_rng(seed).normal(0.0, slope, size=(count, count, 2))


def moments(spread):
    """Centroid and mean squared distance from the centre, pixels."""
    y, x = np.mgrid[:64, :64] - 32.0
    values = spread.detach().numpy()
    square = (values * (x**2 + y**2)).sum()
    return (values * x).sum(), (values * y).sum(), square


def test_facets_land_where_their_angles_point():
    # displacements of whole pixels fall into one pixel each
    steps = np.random.default_rng(3).integers(-20, 20, size=(COUNT, COUNT, 2))
    angles = np.arctan(steps * PUPIL["pitch"] / PUPIL["image_distance"])
    module = FacetPSF(angles, **FACETS)
    expected = np.zeros((64, 64))
    share = module._share.numpy()
    np.add.at(expected, (32 + steps[..., 1], 32 + steps[..., 0]), share)
    np.testing.assert_allclose(module().detach(), expected, atol=1e-13)  # rounding of tan(arctan)
    assert float(share[COUNT // 2, 0]) == pytest.approx(float(share[0, COUNT // 2]), rel=1e-12)
    assert share[0, 0] == 0.0


def test_defocus_is_a_disc_of_the_closed_form_radius():
    waves = 5.0
    spread = FacetPSF(FLAT, **FACETS)(defocus=[waves * WAVELENGTH])[0]
    edge = 4.0 * math.sqrt(3.0) * waves * WAVELENGTH / 5e-3 * (0.05 / 8e-6)
    x, y, square = moments(spread)
    # a disc of radius a has a**2/2; bilinear weights of a uniform fraction add 2 * 1/6
    assert square == pytest.approx(edge**2 / 2 + 1 / 3, rel=2e-3)  # 65 facets across
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
    beyond = np.hypot(*np.mgrid[-32:32, -32:32]) > edge + 1.5
    assert spread.detach().numpy()[beyond].sum() == 0.0


def test_directions_and_defocus_are_those_of_the_wave():
    tilt = np.broadcast_to([0.6e-3, -0.3e-3], (COUNT, COUNT, 2)).copy()
    facets = FacetPSF(tilt, **FACETS)
    wave = PupilPSF.from_angles(tilt, **FACETS, wavelength=WAVELENGTH, pixel_integrated=True)
    kept = facets.transfer(defocus=[3e-6]).detach()[0]
    other = wave.transfer(defocus=[3e-6]).detach()[0]
    # one cycle over the frame: phases by the same shift, moduli by the same defocus
    for place in ((0, 1), (1, 0), (1, 1)):
        angle = float(torch.angle(kept[place] / other[place]))
        assert abs(angle) < 1e-3
        assert abs(kept[place]) == pytest.approx(float(abs(other[place])), abs=0.02)  # diffraction
    flipped = FacetPSF(-tilt, **FACETS).transfer().detach()
    assert abs(float(torch.angle(flipped[0, 1] / other[0, 1]))) > 0.5


def test_many_waves_of_aberration_give_the_spot_of_the_rays():
    # astigmatism and coma: 2 waves rms, a spot of 40 pixels
    def slopes(u, v):
        x, y, r = u / 5e-3, v / 5e-3, 2.0 * WAVELENGTH / 5e-3
        six, eight = math.sqrt(6.0), math.sqrt(8.0)
        du = six * 2 * x + eight * (9 * x * x + 3 * y * y - 2)
        dv = six * -2 * y + eight * 6 * x * y
        return r * np.stack([du, dv], axis=-1) / math.sqrt(2.0)

    axis = (np.arange(401) - 200) * 2.5e-5
    u, v = np.meshgrid(axis, axis)
    fine = {**FACETS, "angle_pitch": 2.5e-5}
    rays = FacetPSF(np.arctan(slopes(u, v)), **fine)
    wave = PupilPSF.from_zernike(
        {6: math.sqrt(2.0) * WAVELENGTH, 8: math.sqrt(2.0) * WAVELENGTH},
        **{**PUPIL, "dtype": torch.float64},
        wavelength=WAVELENGTH,
        pixel_integrated=True,
    )
    box = torch.sinc(torch.fft.rfftfreq(64, dtype=torch.float64))
    box = torch.sinc(torch.fft.fftfreq(64, dtype=torch.float64))[:, None] * box
    seen, expected = rays.transfer().detach(), wave.transfer().detach() * box
    assert float(abs(expected[0, 3])) < 0.5  # the spot is resolved
    # diffraction at the rim and at caustics: wavelength times F-number is 0.4 pixels
    assert float((seen - expected).abs().max()) < 0.06


def test_diffraction_of_a_facet_is_that_of_a_square_aperture():
    module = FacetPSF(FLAT, **FACETS, wavelength=WAVELENGTH)
    # autocorrelation of the facet, sampled: 64 x 64 points at shifts lambda d f
    side = FACETS["angle_pitch"]
    cycles = np.fft.rfftfreq(64) / PUPIL["pitch"]
    x = (np.arange(20001) + 0.5) / 20001
    overlap = [np.mean(x + WAVELENGTH * 0.05 * f / side < 1.0) for f in cycles]
    np.testing.assert_allclose(module.transfer().detach().abs()[0], overlap, atol=1e-4)
    assert float(module().detach().sum()) == pytest.approx(1.0, abs=1e-12)
    assert module().detach().max() < 0.9 < FacetPSF(FLAT, **FACETS)().detach().max()


def test_gradients_are_those_of_finite_differences():
    module = FacetPSF(
        drawn(5, count=5), **{**FACETS, "angle_pitch": 2.5e-3, "shape": 12}, wavelength=WAVELENGTH
    )
    weights = torch.randn(12, 12, dtype=torch.float64, generator=torch.manual_seed(1))
    start = module.coefficients.detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda c: (module(c) * weights).sum(), (start,), eps=1e-7)


def test_batches_and_transfer_agree_with_single_point_spreads():
    module = FacetPSF(drawn(), **FACETS, wavelength=WAVELENGTH)
    pair = torch.stack([module.coefficients.detach(), -module.coefficients.detach()])
    spreads = module(pair, defocus=[0.0, 1e-6])
    assert spreads.shape == (2, 2, 64, 64)
    torch.testing.assert_close(spreads[1, 0], module(pair[1]), rtol=0, atol=1e-15)
    rolled = spreads[0, 1].roll((-32, -32), (-2, -1))
    seen = module.transfer(pair, defocus=[0.0, 1e-6])[0, 1]
    torch.testing.assert_close(torch.fft.rfft2(rolled), seen, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"angles": np.zeros((9, 9))}, SceneError, "shape"),
        ({"angles": np.full((COUNT, COUNT, 2), 1.6)}, SceneError, "pi/2"),
        ({"angles": np.full((COUNT, COUNT, 2), np.nan)}, SceneError, "finite"),
        ({"angle_pitch": 1e-5}, SamplingError, "or more a side"),
        ({"image_distance": 0.0}, SceneError, "must not be 0"),
        ({"wavelength": 633.0}, SceneError, "metres"),
        ({"dtype": torch.float16}, SamplingError, "float32"),
    ],
)
def test_bad_input_says_what_to_change(change, error, words):
    with pytest.raises(error, match=words):
        FacetPSF(**{"angles": FLAT, **FACETS, **change})


def test_coefficients_of_another_grid_are_refused():
    with pytest.raises(SamplingError, match="one displacement per facet"):
        FacetPSF(FLAT, **FACETS)(torch.zeros(5, 5, 2))
