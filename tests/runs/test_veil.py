"""Diffuse light of the hidden object in the image, and its shape from the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nlosoptics
from nlosoptics import inverse
from nlosoptics.imaging import diffuse_background
from nlosoptics.runs import simulate
from nlosoptics.runs.noise import electron_noise
from nlosoptics.runs.veil import fitted_veil, veil_shape
from nlosoptics.scene import Lambert, Scene, SpecularMicrofacet, SumMaterial


@pytest.fixture(scope="module", params=[64, pytest.param(128, marks=pytest.mark.thorough)])
def bright(request, examples) -> nlosoptics.Result:
    """A long exposure of a picture whose light comes from one side; also in binned pixels."""
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(request.param)
    picture = np.zeros((40, 40))
    picture[5:35, 3:9] = 1.0
    picture[5:11, 9:25] = 0.7
    scene = replace(
        scene,
        hidden=replace(scene.hidden, image=picture, size=0.6, position=(0.33, 0.0, 0.6)),
        camera=replace(scene.camera, exposure=0.07, stop_diameter=0.012),
        laser=replace(scene.laser, independent_patterns=1000),
    )
    return nlosoptics.simulate(scene, 1e-2, seed=1)


def test_veil_of_a_bright_object_is_found(bright):
    """Its error falls from many standard errors of the noise to few, and the fit succeeds."""
    scene, image = bright.scene, bright.image
    dark = image.ledger["dark"] / image.electrons.size
    noise = electron_noise(scene, image.electrons - dark)
    model = simulate.image_model(scene, bright.point_spread)
    known = {"noise_sigma": noise, "background": dark}
    found = fitted_veil(scene, image.electrons, model, **known)
    true, white = diffuse_background(scene), veil_shape(scene)

    def error(shape):
        """Standard errors, with the best strength."""
        weighted = shape / noise
        rest = true / noise - weighted * (weighted * true / noise).sum() / (weighted**2).sum()
        return np.linalg.norm(rest)

    # measured 511, and 9.9 with the found shape
    assert error(white) > 100.0
    assert error(found) < 0.05 * error(white)
    assert found.mean() == pytest.approx(1.0)
    fits = [
        inverse.tv_deconvolve(
            inverse.Measurement(image.electrons, background_shape=shape, **known), model
        )
        for shape in (found, white)
    ]
    # measured 0.99995 and 0.9625
    near, far = (inverse.registered_correlation(fit, image.ideal) for fit in fits)
    assert near > 0.999
    assert far < 0.98


def test_veil_contains_the_highlight_of_a_glossy_lobe(examples):
    """A narrow lobe throws part of the laser's light onto one place of the object."""
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(32)
    # the lobe's axis meets the object 5 cm from its middle, off the four points of a white object
    hidden = replace(scene.hidden, image=np.ones((8, 8)), size=0.6, position=(0.43, 0.03, 0.6))
    lobe = SpecularMicrofacet(0.05, 0.01)
    scene = replace(scene, hidden=hidden, wall_material=SumMaterial(Lambert(0.75), lobe))
    matt = replace(scene, wall_material=Lambert(0.75))
    true, found, without = (
        veil / veil.mean()
        for veil in (diffuse_background(scene), veil_shape(scene), veil_shape(matt))
    )
    # measured 0.0034 and 0.16
    assert np.abs(found - true).max() < 0.01 < 0.03 < np.abs(without - true).max()
