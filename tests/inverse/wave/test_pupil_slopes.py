"""Differentiable point spreads of slopes, of exit angles and of scenes."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from nlosoptics import Scene, psf
from nlosoptics.errors import CausticError, MemoryLimitError, SamplingError, SceneError
from nlosoptics.inverse import PupilPSF
from nlosoptics.scene import ConcaveWall

WAVELENGTH = 632.8e-9
DISTANCE = 0.06
PITCH = 5e-6
SIDE = 48
CELL = WAVELENGTH * DISTANCE / (SIDE * PITCH)
OPTICS = {
    "wavelength": WAVELENGTH,
    "pupil_radius": 9.0 * CELL,
    "image_distance": DISTANCE,
    "pitch": PITCH,
    "shape": SIDE,
    "dtype": torch.float64,
}


def drawn(count, waves=0.2, seed=0):
    """Slopes drawn node by node, which no wave has, rad."""
    table = np.random.default_rng(seed).normal(size=(count, count, 2))
    return table * waves * WAVELENGTH / OPTICS["pupil_radius"]


def test_slopes_on_the_pupil_cells_are_psf_wavefront_from_slopes():
    slopes = drawn(19)
    module = PupilPSF.from_angles(np.arctan(slopes), angle_pitch=CELL, **OPTICS)
    wave, _ = psf.wavefront_from_slopes(
        slopes, CELL, np.ones((19, 19), dtype=bool), wavelength=WAVELENGTH, image_distance=DISTANCE
    )
    lit = module.optics.share > 0
    found = module.aberration().detach().numpy()
    # conjugate gradients to 1e-15 there, matrices here
    np.testing.assert_allclose(
        found[lit], wave.aberration[lit], rtol=0, atol=1e-12 * np.abs(wave.aberration).max()
    )
    assert not found[~lit].any()


def test_coarse_slopes_of_a_quadratic_give_it():
    pitch = 4.0 * CELL
    axis = (np.arange(7) - 3) * pitch
    v, u = np.meshgrid(axis, axis, indexing="ij")
    bend, twist = 0.2, -0.1  # 1/m
    slopes = np.stack([bend * u + twist * v, twist * u - bend * v], axis=-1)
    module = PupilPSF.from_angles(np.arctan(slopes), angle_pitch=pitch, **OPTICS)
    v, u = np.meshgrid(module.optics.v, module.optics.u, indexing="ij")
    expected = bend / 2 * (u * u - v * v) + twist * u * v
    lit = module.optics.share > 0
    # mean slopes of neighbours and cubic splines are exact for quadratics; roundings are left
    np.testing.assert_allclose(
        module.aberration().detach().numpy()[lit],
        expected[lit],
        rtol=0,
        atol=1e-12 * np.abs(expected).max(),
    )


def test_a_tilt_moves_the_spot_to_where_its_ray_lands():
    pixels = 4.0
    angles = np.zeros((5, 5, 2))
    angles[..., 0] = np.arctan(pixels * PITCH / DISTANCE)
    module = PupilPSF.from_angles(angles, angle_pitch=6 * CELL, **OPTICS)
    centred = PupilPSF.from_angles(0 * angles, angle_pitch=6 * CELL, **OPTICS)
    # a whole number of pixels: the same samples elsewhere, up to roundings
    torch.testing.assert_close(module(), centred().roll(4, -1), rtol=0, atol=1e-14)


def test_leaves_are_waves_per_pupil_radius():
    slopes = drawn(7)
    module = PupilPSF.from_angles(np.arctan(slopes), angle_pitch=4 * CELL, **OPTICS)
    expected = slopes * OPTICS["pupil_radius"] / WAVELENGTH
    np.testing.assert_allclose(module.coefficients.detach().numpy(), expected, rtol=1e-12)
    assert module.modes == ()


@pytest.mark.thorough
def test_gradients_of_batches_of_slopes():
    options = OPTICS | {"shape": 12, "pupil_radius": 2.4 * WAVELENGTH * DISTANCE / (12 * PITCH)}
    module = PupilPSF.from_angles(
        np.zeros((4, 4, 2)), angle_pitch=options["pupil_radius"] * 0.8, **options
    )
    generator = torch.Generator().manual_seed(0)
    leaves = 0.2 * torch.randn(2, 4, 4, 2, dtype=torch.float64, generator=generator)
    assert tuple(module(leaves, defocus=[0.0, 1e-7]).shape) == (2, 2, 12, 12)
    assert torch.autograd.gradcheck(module, leaves.requires_grad_())
    assert torch.autograd.gradcheck(module, torch.zeros_like(leaves, requires_grad=True))


def test_single_precision_slopes():
    slopes = drawn(7, waves=1.0)
    single = PupilPSF.from_angles(
        np.arctan(slopes), angle_pitch=4 * CELL, **OPTICS | {"dtype": torch.float32}
    )
    double = PupilPSF.from_angles(np.arctan(slopes), angle_pitch=4 * CELL, **OPTICS)
    found, expected = single().detach(), double().detach()
    assert found.dtype == torch.float32
    # some ten roundings of 6e-8 in phases of some rad
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-5 * float(expected.max()))


def test_a_slope_beyond_half_a_wave_a_cell_draws_a_warning():
    limit = WAVELENGTH / (2 * CELL)
    slopes = np.zeros((5, 5, 2))
    slopes[..., 1] = 0.99 * limit
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PupilPSF.from_angles(np.arctan(slopes), angle_pitch=6 * CELL, **OPTICS)
    with pytest.warns(UserWarning, match=r"rises 0\.505 waves from one pupil cell"):
        PupilPSF.from_angles(np.arctan(slopes * (1.01 / 0.99)), angle_pitch=6 * CELL, **OPTICS)
    with pytest.warns(UserWarning, match="limit 0.5"):
        PupilPSF.from_zernike({4: 5 * WAVELENGTH}, **OPTICS)


@pytest.mark.parametrize(
    ("angles", "kind", "text"),
    [
        (np.zeros((5, 4, 2)), SceneError, r"angles have shape \(5, 4, 2\)"),
        (np.full((5, 5, 2), np.nan), SceneError, "must be finite and below pi/2"),
        (np.full((5, 5, 2), 1.6), SceneError, "angles reach 1.6 rad"),
        ("steep", SceneError, "not an array of real numbers"),
        (np.zeros((3, 3, 2)), SamplingError, "give 7 or more a side"),
    ],
)
def test_bad_angles_are_refused_in_one_line(angles, kind, text):
    with pytest.raises(kind, match=text) as caught:
        PupilPSF.from_angles(angles, angle_pitch=3 * CELL, **OPTICS)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def concave(examples):
    """Half a wave rms of astigmatism and defocus."""
    scene = Scene.load(examples / "scenes" / "letter_speckle.toml")
    return replace(scene, wall=ConcaveWall(1.5, size=(1.4, 1.0)))


def scene_pupil(scene, modes=range(2, 12), dtype=torch.float64, **options):
    return PupilPSF.from_scene(scene, modes, pitch=4.5e-6, shape=96, dtype=dtype, **options)


def test_a_scene_starts_at_the_wave_of_its_wall(concave):
    module = scene_pupil(concave, [4, 5, 6])
    optics = module.optics
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    lit = optics.share > 0
    inside = lit & (np.hypot(u, v) <= optics.pupil_radius)
    aimed = psf.wavefront(concave, nodes=np.stack([u[inside], v[inside]], axis=-1))
    # rays aimed at the cells themselves; the series of 24 x 96 nodes holds W to 1e-9 waves
    np.testing.assert_allclose(
        module.aberration().detach().numpy()[inside],
        aimed.aberration,
        rtol=0,
        atol=1e-8 * WAVELENGTH,
    )
    np.testing.assert_allclose(
        optics.amplitude[inside] / optics.share[inside], aimed.amplitude, rtol=1e-8
    )
    fit = psf.fit_zernike(psf.wavefront(concave), 6)
    found = module.coefficients.detach().numpy()
    np.testing.assert_allclose(found, [fit[m] / WAVELENGTH for m in (4, 5, 6)], rtol=1e-12)
    assert np.abs(found).max() > 0.1  # waves: there is something to fit


@pytest.mark.thorough
def test_a_scene_has_its_point_spread(concave):
    expected = psf.point_spread(psf.wavefront(concave), pitch=4.5e-6, shape=96, tol=1e-4).intensity
    found = scene_pupil(concave)().detach().numpy()
    found *= expected.sum() / found.sum()
    # cells at the rim count with their area: 24 of them to the radius
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02 * expected.max())


def test_single_precision_keeps_the_fraction_of_a_steep_wave(concave):
    steep = replace(concave, wall=ConcaveWall(1.35, size=(1.4, 1.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        double, single = (scene_pupil(steep, [11], dtype=d) for d in (torch.float64, torch.float32))
        found, expected = single().detach(), double().detach()
    # some ten roundings of 6e-8, whatever the number of waves
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-5 * float(expected.max()))


def test_scenes_without_a_wave_are_refused(concave):
    with pytest.raises(SceneError, match="piston"):
        scene_pupil(concave, [1, 4])
    with pytest.raises(CausticError):
        scene_pupil(replace(concave, wall=ConcaveWall(1.1, size=(1.4, 1.0))))


def test_a_scene_beyond_the_memory_is_refused_before_any_work(examples):
    """Pixels of 0.6 mm, of which the lens' wave needs 900 samples a side each."""
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    with pytest.raises(MemoryLimitError, match=r"pupil cells.*fewer pixels, a finer pitch"):
        PupilPSF.from_scene(
            scene, [4, 5], pitch=scene.camera.image_pitch, shape=2048, pixel_integrated=True
        )
