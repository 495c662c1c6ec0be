"""Reconstructions of scenes whose point spread varies over the object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlosoptics import Scene, imaging, inverse
from nlosoptics.psf import PointSpreadField
from nlosoptics.runs.simulate import MOST_DEVIATION, image_model

SIDE = 64


def field(scene: Scene, change: float) -> PointSpreadField:
    """Return a spot to the left of the middle that moves to its right across the object."""

    def spot(place: float) -> np.ndarray:
        axis = np.arange(31.0) - 15.0
        values = np.exp(-((axis - place) ** 2 + axis[:, None] ** 2) / 4.0)
        return values / values.sum()

    nodes = np.array([-np.sqrt(0.5), np.sqrt(0.5)])
    across = np.broadcast_to(nodes, (2, 2))
    return PointSpreadField(
        modes=np.stack([spot(-4.0), spot(4.0)]),
        weights=np.stack([0.5 - 0.5 * change * across, 0.5 + 0.5 * change * across]),
        across=nodes,
        up=nodes.copy(),
        pitch=scene.camera.image_pitch,
        truncation_error=0.0,
        error_estimate=0.0,
    )


@pytest.fixture(scope="module")
def scene(examples: Path) -> Scene:
    """Return a bright letter without speckle."""
    given = Scene.load(examples / "scenes" / "letter_flat.toml").resized(SIDE)
    return replace(given, laser=replace(given.laser, independent_patterns=None))


def test_deviation_of_two_spots(scene: Scene) -> None:
    """The spots hardly overlap, so the mean has half the power of one."""
    first, second = field(scene, 1.0).modes
    overlap = (first * second).sum() / (first**2).sum()
    # mean of x^2 over 32 cells between -1 and 1
    square = (1.0 - 1.0 / 32**2) / 3.0
    expected = np.sqrt(square * (1.0 - overlap) / (1.0 + overlap))
    assert field(scene, 1.0).deviation() == pytest.approx(expected, rel=1e-12)
    assert field(scene, 0.0).deviation() < 1e-12  # rounding


def test_the_model_forms_the_image_of_the_scene(scene: Scene) -> None:
    """Every pixel has the point spread that the simulated image has there."""
    spreads = field(scene, 1.0)
    image = imaging.form_image(scene, spreads, seed=0)
    same = image_model(scene, spreads).forward(image.ideal)
    assert np.abs(same - image.signal).max() <= 1e-12 * image.signal.max()
    other = image_model(scene, spreads, mean=True).forward(image.ideal)
    assert np.abs(other - image.signal).max() > 0.1 * image.signal.max()


def test_little_variation_uses_the_mean(scene: Scene) -> None:
    little, much = (field(scene, change) for change in (0.05, 1.0))
    assert little.deviation() <= MOST_DEVIATION < much.deviation()
    model = image_model(scene, little)
    assert model.weights is None
    assert np.array_equal(model.kernel, little.mean())
    varied = image_model(scene, much)
    assert varied.weights is not None
    assert varied.weights.shape == (2, SIDE, SIDE)


@pytest.mark.thorough
def test_the_object_behind_varying_spots_is_found(scene: Scene) -> None:
    spreads = field(scene, 1.0)
    image = imaging.form_image(scene, spreads, seed=0)
    found, wrong = (
        inverse.tv_deconvolve(
            inverse.Measurement(image.electrons - image.background, noise_sigma=image.noise_sigma),
            image_model(scene, spreads, mean=mean),
        )
        for mean in (False, True)
    )
    assert (found.status, found.reasons) == ("converged", ())
    assert inverse.registered_correlation(found, image.ideal) > 0.95
    assert wrong.status != "converged"
    assert inverse.registered_correlation(wrong, image.ideal) < 0.95


@pytest.mark.thorough
def test_modes_below_the_noise_of_a_fit_are_left_out(scene: Scene) -> None:
    """A third mode, weaker by a known factor: it is kept, or omitted with its error stated."""
    spreads = field(scene, 1.0)
    bump = np.roll(spreads.modes[0], 9, axis=0)
    places = (2 * np.arange(32) + 1) / 32 - 1
    power = np.mean([np.mean(spreads.point_spread(x, 0.0) ** 2) for x in places])
    for size, count in ((0.0045, 2), (0.0055, 3)):
        scale = size * np.sqrt(power / np.mean(bump**2))
        three = replace(
            spreads,
            modes=np.concatenate([spreads.modes, scale * bump[None]]),
            weights=np.concatenate([spreads.weights, np.ones((1, 2, 2))]),
        )
        fewer = three.compressed(0.005)
        assert len(fewer.modes) == len(fewer.weights) == count
        model = image_model(scene, three)
        assert model.weights is not None
        assert len(model.weights) == count
        lost = [
            np.abs(fewer.point_spread(x, y) - three.point_spread(x, y)).max()
            / three.point_spread(x, y).max()
            for x in three.across
            for y in three.up
        ]
        assert fewer.truncation_error == pytest.approx(max(lost), rel=1e-9, abs=1e-15)
