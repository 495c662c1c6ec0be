"""Point spreads over a picture: modes against point spreads computed anew."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import imaging, psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.imaging import ForwardModel
from nlosoptics.psf.walls.field import AVERAGED, BLOCK, picture_nodes
from nlosoptics.scene import ConcaveWall, MeshObject, PlanarObject

PITCH = 4e-6


@pytest.fixture(scope="module")
def scene():
    """A hollow wall, whose point spread changes over a picture of 0.3 m."""
    from nlosoptics.scene import Camera, Laser, Scene

    return Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.6, 0.3, 1.1)),
        ConcaveWall(8.0, size=(2.0, 2.0)),
        PlanarObject(np.ones((8, 8)), 0.3, position=(0.38, 0.0, 1.0)),
        Camera(
            position=(-0.38, 0.0, 0.8),
            aim=(0.0, 0.0, 0.0),
            focal_length=50e-3,
            stop_diameter=5e-3,
            pixels=(256, 256),
            pixel_pitch=36e-6,
            binning=4,
        ),
    )


@pytest.fixture(scope="module")
def field(scene):
    return psf.point_spread_field(scene, 5, tol=2e-3, pitch=PITCH, checks=3)


def place(scene, across, up):
    corners = scene.hidden.corners  # right top, right bottom, left bottom, left top
    right, upward = corners[0] - corners[3], corners[0] - corners[1]
    return np.array(scene.hidden.position) + across / 2 * right + up / 2 * upward


def test_field_gives_the_point_spreads_between_its_nodes(scene, field):
    """Held-out points, each computed as a wave of its own, within the stated error."""
    side = field.modes.shape[1]
    changed = 0.0
    centre = field.point_spread(0.0, 0.0)
    for across, up in ((0.9, -0.8), (-0.55, 0.31), (0.1, 0.97)):
        wave = psf.wavefront(scene, place(scene, across, up))
        exact = psf.point_spread(
            wave, pitch=PITCH, shape=side, pixel_integrated=True, tol=1e-4, model="scalar"
        ).intensity
        error = np.abs(field.point_spread(across, up) - exact).max() / exact.max()
        assert error <= field.error_estimate
        changed = max(changed, np.abs(centre - exact).max() / exact.max())
    # a field worth the name, and known far better than it varies
    assert changed > 0.1
    assert field.error_estimate < 0.1 * changed
    assert field.truncation_error <= 1e-3
    assert 1 < len(field.modes) < 25


def test_a_field_weighs_points_one_by_one_in_blocks_and_on_grids_alike():
    """To the last bit, since the same products are added in the same order."""
    draws = np.random.default_rng(0)
    field = psf.PointSpreadField(
        modes=draws.random((3, 2, 2)),
        weights=draws.normal(size=(3, 4, 5)),
        across=picture_nodes(5),
        up=picture_nodes(4),
        pitch=1e-5,
        truncation_error=0.0,
        error_estimate=0.0,
    )
    x, y = draws.uniform(-1.1, 1.1, (1, 300)), draws.uniform(-1.1, 1.1, (200, 1))
    grid, points = field.at(x, y), field.at(*np.broadcast_arrays(x, y))
    assert points.shape == (3, 200, 300)
    assert x.size * y.size > 3 * BLOCK
    assert np.array_equal(grid, points)
    for i, j in ((0, 0), (130, 7), (199, 299)):
        assert np.array_equal(field.at(x[0, j], y[i, 0]), points[:, i, j])


def test_model_of_a_field_is_a_sum_over_object_points(field):
    """Each object pixel spreads as the field says there; and the adjoint is the transpose."""
    draw = np.random.default_rng(3)
    shape = (24, 31)
    model = ForwardModel(field, shape=shape)
    picture = np.zeros(shape)
    spots = {(3, 4): 1.0, (20, 27): 2.0, (11, 15): 0.5}
    for spot, light in spots.items():
        picture[spot] = light
    side = field.modes.shape[1]
    expected = np.zeros((shape[0] + 2 * side, shape[1] + 2 * side))
    for (row, column), light in spots.items():
        kernel = field.point_spread((2 * column + 1) / shape[1] - 1, (2 * row + 1) / shape[0] - 1)
        top, left = side + row - side // 2, side + column - side // 2
        expected[top : top + side, left : left + side] += light * kernel
    expected = expected[side:-side, side:-side]
    # rounding of the transforms
    assert model.forward(picture) == approx(expected, abs=1e-14)
    x, y = draw.normal(size=(2, *shape))
    assert (model.forward(x) * y).sum() == approx((x * model.adjoint(y)).sum(), rel=1e-12)
    stack = draw.normal(size=(2, *shape))
    assert model.forward(stack)[1] == approx(model.forward(stack[1]), abs=1e-14)


def test_image_by_a_field(scene):
    """A field of one point spread blurs as that one does; a varying one as its points say."""
    coarse = psf.point_spread_field(scene, 3, tol=2e-3, checks=0)
    alone = psf.point_spread_field(scene, 1, tol=2e-3, checks=0)
    one = psf.scene_point_spread(scene, shape=alone.modes.shape[1], tol=1e-3).point_spread
    images = [imaging.form_image(scene, p) for p in (coarse, alone, one)]
    peak = images[2].signal.max()
    assert images[1].signal == approx(images[2].signal, abs=1e-9 * peak)
    # pixels far wider than the spot hide most of the change
    assert 0.0 < np.abs(images[0].signal - images[2].signal).max() < 0.05 * peak
    for image in images:
        ledger = image.ledger
        parts = ledger["signal"] + ledger["beyond_window"] + ledger["beyond_detector"]
        assert parts == approx(ledger["ideal"], rel=1e-9)
    dark = replace(scene, hidden=replace(scene.hidden, image=np.zeros((8, 8))))
    assert not imaging.form_image(dark, coarse).signal.any()


def test_bad_input_is_refused(scene, field):
    import trimesh

    mesh = replace(
        scene, hidden=MeshObject(mesh=trimesh.creation.box((0.1, 0.1, 0.1)), position=(0.3, 0, 1))
    )
    with pytest.raises(SceneError, match="PlanarObject"):
        psf.point_spread_field(mesh)
    with pytest.raises(SceneError, match="grid = 0"):
        psf.point_spread_field(scene, 0)
    with pytest.raises(SceneError, match="grid"):
        psf.point_spread_field(scene, (3, 3, 3))
    with pytest.raises(SceneError, match="pitch = 0 m"):
        psf.point_spread_field(scene, pitch=0.0)
    with pytest.raises(SamplingError, match="at has shapes"):
        ForwardModel(field, shape=(8, 8), at=(np.zeros((8, 7)), np.zeros((8, 8))))
    with pytest.raises(SamplingError, match="is not a field"):
        ForwardModel(np.ones((3, 3)), shape=(8, 8), at=(np.zeros((8, 8)), np.zeros((8, 8))))


def made_field(modes=4, counts=(3, 5), shape=(6, 7), seed=3):
    """Field of random positive modes and weights, whose modes overlap."""
    rng = np.random.default_rng(seed)
    ny, nx = counts
    return psf.PointSpreadField(
        modes=rng.uniform(0.2, 1.0, (modes, *shape)) / 5.0 ** np.arange(modes)[:, None, None],
        weights=rng.uniform(0.1, 1.0, (modes, ny, nx)),
        across=picture_nodes(nx),
        up=picture_nodes(ny),
        pitch=2e-6,
        truncation_error=1e-3,
        error_estimate=3e-3,
    )


def test_statistics_of_a_field():
    """Mean, deviation, and what is lost without the last modes, over evenly spread points."""
    field = made_field()
    steps = (np.arange(AVERAGED) + 0.5) / AVERAGED * 2 - 1
    spreads = np.array([[field.point_spread(a, b) for a in steps] for b in steps])
    mean = spreads.mean(axis=(0, 1))
    assert field.mean() == approx(mean, rel=1e-12)
    apart = math.sqrt(np.mean(np.sum((spreads - mean) ** 2, axis=(2, 3))) / np.sum(mean**2))
    assert field.deviation() == approx(apart, rel=1e-9)
    weights = field.at(steps[None, :], steps[:, None])
    rest = []  # rms of the modes from each on
    for k in range(4):
        left = np.tensordot(weights[k:].reshape(4 - k, -1).T, field.modes[k:], 1)
        rest.append(math.sqrt(np.sum(left**2)))
    nodes = np.tensordot(np.moveaxis(field.weights, 0, -1), field.modes, 1)
    for kept in (1, 2, 3):
        short = field.compressed(rest[kept] / rest[0] * (1 + 1e-9))
        assert len(short.modes) == kept
        assert len(field.compressed(rest[kept] / rest[0] * (1 - 1e-9)).modes) == kept + 1
        assert np.array_equal(short.modes, field.modes[:kept])
        assert np.array_equal(short.weights, field.weights[:kept])
        missing = np.tensordot(np.moveaxis(field.weights[kept:], 0, -1), field.modes[kept:], 1)
        lost = np.max(np.abs(missing).max(axis=(2, 3)) / nodes.max(axis=(2, 3)))
        assert short.truncation_error == approx(1e-3 + lost, rel=1e-9)
        assert short.error_estimate == approx(3e-3 + lost, rel=1e-9)
    assert field.compressed(0.0) is field
    assert len(field.compressed(1.0).modes) == 1
    with pytest.raises(SceneError, match=r"tol = 1\.01 is out of range"):
        field.compressed(1.01)
    for array in (field.modes, field.weights, field.across, field.up):
        assert not array.flags.writeable
