"""Fields of point spreads as coarse as an image allows, against much finer ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel, image_field
from nlosoptics.imaging.image_fields import (
    COUNTS,
    autocorrelation,
    blurred_power,
    expected_counts,
    interpolation_errors,
    picture_frame,
)
from nlosoptics.psf import point_spread_field
from nlosoptics.scene import ConcaveWall, WavyWall


@pytest.fixture(scope="module")
def scene(examples):
    return nlos.Scene.load(examples / "scenes" / "letter_speckle.toml").resized(128)


def rms_difference(found, exact):
    return float(np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)))


@pytest.mark.thorough
def test_error_bounds_that_of_the_image(examples):
    """A hollow wall that turns one pixel into twenty, in other ways over the picture."""
    flat = nlos.Scene.load(examples / "scenes" / "letter_flat.toml")
    camera = replace(flat.camera, stop_diameter=8e-3)
    scene = replace(flat, wall=ConcaveWall(2.2), camera=camera)
    picture = picture_frame(scene)

    def image(field):
        wide = psf.widened(field, tol=1e-5, shape=picture.shape)
        return ForwardModel(wide, shape=picture.shape).forward(picture)

    exact = image(point_spread_field(scene, 6, tol=1e-3, checks=0))
    field, error = image_field(scene, tol=3e-3)
    assert field.weights[0].size < 36
    true = rms_difference(image(field), exact)
    assert 0.2 * error <= true <= error <= 3e-3
    # one point spread is worse, and so are these without what lies beyond their windows
    assert rms_difference(image(point_spread_field(scene, 1, checks=0)), exact) > 3 * true
    narrow = ForwardModel(field, shape=picture.shape).forward(picture)
    assert rms_difference(narrow, exact) > 2 * true


@pytest.mark.thorough
def test_an_unknown_object_may_be_bright_anywhere(examples):
    """A spot in the middle needs one point spread, an object in its place needs more."""
    flat = nlos.Scene.load(examples / "scenes" / "letter_flat.toml")
    picture = np.zeros((41, 41))
    picture[20, 19:22] = 1.0
    spot = replace(flat, wall=ConcaveWall(6.0), hidden=replace(flat.hidden, image=picture))
    one, many = (image_field(spot, tol=1e-2, anywhere=where)[0] for where in (False, True))
    assert one.weights[0].size < many.weights[0].size


def test_frame_is_the_picture_upright_on_the_wall(scene):
    frame = picture_frame(scene)
    picture = scene.hidden.reflectance
    assert frame.shape[0] / frame.shape[1] == pytest.approx(
        scene.hidden.size[1] / scene.hidden.size[0], rel=0.05
    )
    assert frame.mean() == pytest.approx(picture.mean(), rel=0.05)
    upper = picture[: len(picture) // 2].mean() / picture.mean()
    assert frame[len(frame) // 2 :].mean() / frame.mean() == pytest.approx(upper, rel=0.05)
    black = replace(scene, hidden=replace(scene.hidden, image=np.zeros((4, 4))))
    assert np.all(picture_frame(black) == 1.0)


@pytest.mark.thorough
def test_too_few_nodes_are_refused(scene):
    told = []
    asked = {"tol": 1e-7, "most_nodes": 4, "progress": lambda *step: told.append(step)}
    with pytest.raises(SamplingError, match=r"still has an error of .* 3 x 3 point spreads"):
        image_field(replace(scene, wall=ConcaveWall(6.0)), **asked)
    names, shares = zip(*told, strict=True)
    assert {*names} == {"field"}
    # both grids, of 1 and 3 nodes along each side, count alike
    assert shares == tuple(sorted(shares))
    assert {0.5, 1.0} <= {*shares}
    assert 0.0 < shares[0] <= 0.5
    with pytest.raises(SceneError, match="most_nodes = 0 .* at least 1"):
        image_field(scene, most_nodes=0)


def test_power_is_that_of_the_blurred_picture():
    rng = np.random.default_rng(4)
    picture, kernels = rng.uniform(size=(9, 13)), rng.normal(size=(3, 5, 5))
    # a frame that holds all the light: then nothing is lost beyond its edges
    framed = np.pad(picture, 4)
    exact = [(ForwardModel(k, shape=framed.shape).forward(framed) ** 2).sum() for k in kernels]
    assert blurred_power(kernels, autocorrelation(picture, 5)) == pytest.approx(exact, rel=1e-12)


def test_a_field_beyond_the_seconds_of_a_run_is_refused(scene):
    """The time that one grid took says what the next would take.

    10 ms hold one point spread, predicted at 1.5 ms, and not all grids that ``tol`` needs.
    """
    with (
        within(Budget(memory=4e9, seconds=1e-2)),
        pytest.raises(SamplingError, match="point spreads over the object .* max_seconds = 0.01"),
    ):
        image_field(scene, tol=1e-6)


@pytest.mark.parametrize("periods", [1.0, 2.5, 5.0])
def test_interpolation_needs_pi_nodes_per_period(scene, periods):
    """Chebyshev nodes resolve a sinusoid from pi per period on, and converge fast beyond."""
    crossed = 0.5 * scene.hidden.size[0]  # m on the wall, about, at half the object's distance
    wall = WavyWall(1e-7, crossed / periods)
    small = replace(scene, wall=wall, camera=replace(scene.camera, stop_diameter=1e-3))
    errors = interpolation_errors(small)
    counts = np.array(COUNTS)
    assert (errors[counts < 0.6 * np.pi * periods] > 0.05).all()
    assert (errors[counts > 2.0 * np.pi * periods + 6] < 1e-2).all()


def test_a_grid_that_cannot_resolve_the_wall_is_foreseen(scene):
    """With 0.1 of error from one point spread and 40 periods, no grid reaches 1 %."""
    period = 0.5 * scene.hidden.size[0] / 40
    camera = replace(scene.camera, stop_diameter=1e-3)
    errors = interpolation_errors(replace(scene, wall=WavyWall(1e-7, period), camera=camera))
    counts, change = expected_counts(0.1, 0.1, 0.01, errors)
    assert counts == list(COUNTS)
    assert change > 0.01
    assert expected_counts(0.1, 0.1, 0.01)[1] <= 0.01


@pytest.mark.thorough
def test_beyond_the_planned_nodes_a_field_is_refined_only_while_it_converges(scene):
    """A ripple of 2 mm has far more periods over the object than there are nodes."""
    rippled = replace(scene, wall=WavyWall(3e-9, 2e-3))
    field, error = image_field(rippled, tol=1e-7, planned_nodes=1)
    assert len(field.across) <= 3
    assert error > 1e-7
    field, error = image_field(replace(scene, wall=ConcaveWall(6.0)), tol=1e-4, planned_nodes=1)
    assert len(field.across) >= 3
    assert error <= 1e-4
