"""What the solvers' parts refuse, in one line that names value, limit and remedy."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from nlosoptics import Scene, inverse
from nlosoptics.errors import MissingExtraError, NlosError
from nlosoptics.imaging import ForwardModel
from nlosoptics.inverse.data.adam import take_up_adam
from nlosoptics.inverse.wave.frames import known_defoci
from nlosoptics.inverse.wave.pupil_psf import MOST_DEFOCUS
from nlosoptics.inverse.wave.pupil_waves import checked_slopes, checked_tangents
from nlosoptics.scene import (
    GaussianWall,
    MeshObject,
    SpecularMicrofacet,
    SumMaterial,
    WallRoughness,
)

OPTICS = {"pupil_radius": 1e-3, "image_distance": 0.05, "wavelength": 6e-7}
OPTICS |= {"pitch": 7e-6, "shape": 16}
TENT = np.minimum.outer(*[7.0 - np.abs(np.arange(-6.0, 7.0))] * 2)
EDGE = np.pad(np.zeros((5, 5)), 4, constant_values=1.0)
MESH = MeshObject(trimesh.creation.icosphere(1, 0.1), position=(0.3, 0.0, 0.6))
ROUGH = WallRoughness(GaussianWall(1e-7, 1e-3, seed=1))


@pytest.fixture(scope="module")
def scene(examples):
    return Scene.load(examples / "scenes" / "letter_speckle.toml")


def adam():
    return torch.optim.Adam([torch.zeros(3, requires_grad=True)])


def zernike():
    return inverse.PupilPSF.from_zernike([4, 5], **OPTICS)


def slopes():
    return inverse.PupilPSF.from_slopes(np.zeros((3, 3, 2)), slope_pitch=1e-3, **OPTICS)


def unknown(scene, leaves="object_position", **changes):
    return inverse.SceneLeaves(replace(scene, **changes), leaves, pitch=4.5e-6, shape=32)


def glossy(*slopes):
    return SumMaterial(*(SpecularMicrofacet(0.2, slope) for slope in slopes))


TABLE = {
    "state of another solver": (
        lambda _: take_up_adam("angles", adam(), {"network": 1.0}),
        "start holds no angles; give a state of the same solver, or leave it out",
    ),
    "one image": (
        lambda _: inverse.CnnBaseline(base=8, depth=2)(torch.zeros(8, 8)),
        "images has shape (8, 8), must be (B, H, W)",
    ),
    "modes twice": (
        lambda _: inverse.PupilPSF.from_zernike([4, 6, 5, 6], **OPTICS),
        "modes holds 6 more than once; give each index once",
    ),
    "wavelength in mm": (
        lambda _: inverse.PupilPSF.from_zernike([4], **OPTICS | {"wavelength": 1.01e-3}),
        "wavelength = 0.00101 m is out of range, must be from 1e-08 to 0.001 m; give metres",
    ),
    "pixels of a coarse pupil": (
        lambda _: inverse.PupilPSF.from_zernike([4], **OPTICS | {"pitch": 1e-6}),
        "samples the pupil every 0.00187 m, limit its radius, 0.001 m; use 30 pixels or more",
    ),
    "tolerance of nothing": (
        lambda _: inverse.CnnBaseline(base=8, depth=2).reconstruct(
            np.ones((8, 8)), ForwardModel(np.ones((1, 1)), shape=(8, 8)), tolerance=0.0
        ),
        "tolerance = 0 is out of range, must be above 0 to 0.5",
    ),
    "lags without power": (
        lambda _: inverse.object_from_autocorrelation(EDGE, object_size=(3, 3)),
        "the lags hold no positive power within the object's extent; give object_size",
    ),
    "object as wide as the lags": (
        lambda _: inverse.object_from_autocorrelation(TENT, object_size=(8, 3)),
        "an object of 8 x 3 pixels has lags up to 7 x 2, beyond the 6 x 6 that there are",
    ),
    "slopes for modes": (
        lambda _: inverse.evidence_fit(np.ones((16, 16)), slopes()),
        "pupil_psf has slopes instead of Zernike coefficients; build it by",
    ),
    "coefficients without a number": (
        lambda _: inverse.PupilPSF(zernike().optics, zernike().waves, [0.0, np.nan]),
        "coefficients contain NaN or infinity; give finite start values",
    ),
    "defocus in waves": (
        lambda _: known_defoci([0.0, 1.001 * MOST_DEFOCUS], 2),
        f"m rms, limit {MOST_DEFOCUS:g}; give metres, not waves",
    ),
    "one node": (
        lambda _: checked_slopes("slopes", np.zeros((1, 1, 2)), 3e-3, 1e-3),
        "1 x 1 slopes 0.003 m apart reach 0.0015 m from the axis, the pupil 0.001 m; give 2 or",
    ),
    "nodes inside the pupil": (
        lambda _: checked_slopes("slopes", np.zeros((3, 3, 2)), 0.6e-3, 1e-3),
        "3 x 3 slopes 0.0006 m apart reach 0.0009 m from the axis, the pupil 0.001 m; give 5 or",
    ),
    "upright angles": (
        lambda _: checked_tangents(np.full((3, 3, 2), np.pi / 2), 1e-3, 1e-3),
        "angles reach 1.57 rad, must stay below pi/2; give finite angles",
    ),
    "field of a mesh": (
        lambda scene: unknown(scene, hidden=MESH)([[0.0, 0.0]]),
        "field is given, but the hidden object is a mesh; leave it out",
    ),
    "tilt of a mesh": (
        lambda scene: unknown(scene, "object_tilt", hidden=MESH),
        "object_tilt is given, but the hidden object is a mesh; use a planar object",
    ),
    "rough wall of a fit": (
        lambda scene: unknown(scene, wall_roughness=ROUGH),
        "scene.wall_roughness is not among the parameters of a fit; leave it out",
    ),
    "two lobes": (
        lambda scene: unknown(scene, wall_material=glossy(0.0, 1e-4)),
        "the wall has 2 mirror-like lobes, must be 1 for a lobe with a slope; use one lobe",
    ),
    "rough wall of training": (
        lambda scene: inverse.training_pairs(replace(scene, wall_roughness=ROUGH), 1),
        "scene.wall_roughness is given, but training draws the wall's wave at random",
    ),
    "mesh of training": (
        lambda scene: inverse.training_pairs(replace(scene, hidden=MESH), 1),
        "hidden of type MeshObject has no picture; give a planar object",
    ),
    "object out of view": (
        lambda scene: inverse.training_pairs(aside(scene, 4.0), 1, size=16),
        "the camera sees nothing of the object; move hidden.position into its view",
    ),
}


def aside(scene, share):
    """The scene with the object moved by a share of its width in an image of 16 pixels."""
    x, y, z = scene.hidden.position
    step = share * scene.hidden.size[0] * 16 / max(scene.camera.shape)
    moved = replace(scene.hidden, position=(x + step, y, z))
    return replace(scene, hidden=moved)


@pytest.mark.parametrize("name", TABLE)
def test_refused_in_one_line(name, scene):
    call, words = TABLE[name]
    with pytest.raises(NlosError) as caught:
        call(scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


SMALL = ForwardModel(np.ones((1, 1)), shape=(16, 16))
SEEDED = {
    "deep_image_prior": lambda seed: inverse.deep_image_prior(np.eye(16), SMALL, seed=seed),
    "wu2024_fit": lambda seed: inverse.wu2024_fit(np.eye(16), zernike(), seed=seed),
    "phase_retrieval": lambda seed: inverse.phase_retrieval(np.eye(16), seed=seed),
    "lags": lambda seed: inverse.object_from_autocorrelation(TENT, seed=seed),
    "evidence_fit": lambda seed: inverse.evidence_fit(np.eye(16), zernike(), seed=seed),
    "pcin": lambda seed: inverse.pcin(np.eye(16), zernike(), seed=seed),
    "train_cnn": lambda seed: inverse.train_cnn(
        inverse.TrainingPairs(images=np.ones((2, 8, 8)), objects=np.ones((2, 8, 8))), seed=seed
    ),
}


@pytest.mark.parametrize("name", SEEDED)
def test_seeds_are_whole_numbers_of_64_bits(name):
    for seed in (-1, 2**64, 0.5):
        with pytest.raises(NlosError, match="seed = "):
            SEEDED[name](seed)


def test_a_network_does_not_start_from_an_object():
    bright = np.kron(np.eye(4), np.ones((4, 4)))
    with pytest.raises(NlosError, match="start holds no "):
        inverse.deep_image_prior(inverse.Measurement(bright, noise_sigma=0.01), SMALL, start=bright)


LAST = {
    "object of half the lags": lambda _: inverse.object_from_autocorrelation(
        TENT, object_size=(7, 3), restarts=2, max_iterations=2
    ),
    "largest defocus": lambda _: known_defoci([0.0, -MOST_DEFOCUS], 2),
    "two nodes": lambda _: checked_slopes("slopes", np.zeros((2, 2, 2)), 2e-3, 1e-3),
    "nodes at the rim": lambda _: checked_slopes("slopes", np.zeros((3, 3, 2)), 2e-3 / 3, 1e-3),
    "steep angles": lambda _: checked_tangents(np.full((3, 3, 2), 1.5707), 1e-3, 1e-3),
    "two smooth lobes": lambda scene: unknown(scene, wall_material=glossy(0.0, 0.0)),
    "a mesh": lambda scene: unknown(scene, hidden=MESH)(),
}


@pytest.mark.parametrize("name", LAST)
def test_the_last_value_is_accepted(name, scene):
    assert LAST[name](scene) is not None


def test_a_network_with_weights_that_are_no_numbers_is_refused(tmp_path):
    network = inverse.CnnBaseline(base=8, depth=2)
    next(network.parameters()).data.view(-1)[3] = torch.inf
    network.save(tmp_path / "n.safetensors")
    with pytest.raises(NlosError, match="has weights that are not finite; train it again"):
        inverse.CnnBaseline.load(tmp_path / "n.safetensors")


def test_files_of_networks_need_safetensors(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    with pytest.raises(MissingExtraError, match="safetensors, which is not installed"):
        inverse.CnnBaseline(base=8, depth=2).save(tmp_path / "n.safetensors")


def test_pictures_out_of_view_are_drawn_again(scene):
    """Of an object at the edge of the image one of the first four pictures shows nothing."""
    found = inverse.training_pairs(aside(scene, 0.9), 3, size=16, seed=1)
    assert found.objects.max(axis=(1, 2)).tolist() == [1.0] * 3
