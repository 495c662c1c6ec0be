"""Scenes with a rough wall: regimes, their agreement, plan and run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlosoptics import Scene, errors, plan, psf, simulate
from nlosoptics.psf.walls import rough_wall
from nlosoptics.runs.patterns import mean_optics
from nlosoptics.scene import (
    FacetWall,
    GaussianWall,
    SpecularMicrofacet,
    WallRoughness,
)

EXAMPLES = Path(__file__).parents[3] / "examples" / "scenes"


@pytest.fixture(scope="module")
def letter():
    scene = Scene.load(EXAMPLES / "letter_flat.toml").resized(64)
    return replace(scene, wall_material=SpecularMicrofacet(0.05, 0.0))


def rough(scene, heights, realisation="pattern"):
    return replace(scene, wall_roughness=WallRoughness(heights, realisation))


FACETS = FacetWall(1e-3, 5e-4, seed=1)


@pytest.mark.parametrize(
    ("heights", "realisation", "way"),
    [
        (GaussianWall(2e-7, 8e-3, seed=2), "pattern", "wave aberration of this wall by rays"),
        (FacetWall(5e-3, 1e-7, seed=2), "pattern", "wave aberration of this wall by rays"),
        (FACETS, "pattern", "this wall's field, propagated from wall to pupil"),
        (FACETS, "mean", "mean over all walls in closed form"),
    ],
)
def test_plan_names_the_way(letter, heights, realisation, way):
    stages = plan(rough(letter, heights, realisation), tol=1e-2).stages
    assert way in next(s for s in stages if s.name == "point spread").reason


def test_the_shipped_rough_wall_is_propagated_for_an_image():
    """Only its plan is made here, since the run takes minutes."""
    scene = Scene.load(EXAMPLES / "letter_rough.toml")
    stages = {stage.name: stage for stage in plan(scene).stages}
    assert "this wall's field, propagated from wall to pupil" in stages["point spread"].reason
    assert {"wave aberration", "point spread", "image"} <= set(stages)


@pytest.mark.thorough
def test_one_call_gives_the_pattern_of_this_wall(letter):
    scene = rough(letter, FACETS)
    pitch, shape = scene.camera.image_pitch / 16, (25, 25)
    found = psf.scene_point_spread(scene, tol=1e-2, pitch=pitch, shape=shape)
    direct = psf.sample_point_spread(scene, FACETS, pitch=pitch, shape=shape, pixel_integrated=True)
    # the door cuts off the faint tail of wide pixels, and then needs a coarser pupil
    off = np.abs(found.point_spread.intensity - direct.intensity).max()
    assert off < 5e-3 * direct.intensity.max()
    assert "propagated from wall to pupil" in found.point_spread.reason
    field = found.pupil_field
    # energy through the pupil; the mean over walls is 1, a single wall speckles
    inside = np.isfinite(field.phase)
    assert np.mean(field.amplitude[inside] ** 2) == pytest.approx(1.0, abs=0.1)
    other = rough(letter, replace(FACETS, seed=2))
    changed = psf.scene_point_spread(other, tol=1e-2, pitch=pitch, shape=shape)
    peak = found.point_spread.intensity.max()
    assert np.abs(changed.point_spread.intensity - found.point_spread.intensity).max() > 0.1 * peak


def test_walls_too_steep_for_a_screen_are_refused(letter):
    scene = rough(letter, FacetWall(1e-3, 3e-2, seed=1))
    with pytest.raises(
        errors.SamplingError, match="phase screen of .* limits 60 s .*; use realisation"
    ):
        psf.scene_point_spread(scene, tol=1e-2)


@pytest.mark.thorough
def test_wide_pixels_hold_the_energy_of_narrow_ones(letter):
    scene = rough(letter, FacetWall(4e-3, 1e-3, seed=3))
    optics, pitch = psf.SceneOptics(scene), scene.camera.image_pitch / 8
    waves = psf.scene_point_spread(optics, 1e-2, pitch=pitch).point_spread.intensity
    side = len(waves)
    # the light fills a small part of them
    wide = psf.scene_point_spread(optics, 1e-2, pitch=9 * pitch, shape=9).point_spread
    middle = slice(side // 2 - 13, side // 2 + 14) if side >= 27 else slice(0, side)
    inner = waves[middle, middle] if side >= 27 else np.pad(waves, (27 - side) // 2)
    expected = inner.reshape(3, 9, 3, 9).sum(axis=(1, 3))
    assert np.abs(wide.intensity[3:6, 3:6] - expected).max() < 5e-3


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("heights", "tol", "least"),
    [(GaussianWall(2e-7, 8e-3, seed=2), 1e-3, 5e-7), (FacetWall(8e-3, 3e-6, seed=2), 1e-2, 2e-8)],
    ids=["bumps", "facets"],
)
def test_aberration_and_propagation_agree(letter, heights, tol, least, monkeypatch):
    """Facets are sampled on a grid, here of few nodes, and diffract more at their edges."""
    monkeypatch.setitem(rough_wall.RELIEF_NODES, "grid", (400, 1))
    scene = rough(letter, heights)
    pitch, shape = scene.camera.image_pitch / 64, (65, 65)
    rays = psf.scene_point_spread(scene, tol=tol, pitch=pitch, shape=shape)
    assert rays.pupil_field is None
    # this wall's aberration, peak to valley
    assert np.ptp(rays.wavefront.aberration) > least
    waves = psf.sample_point_spread(
        scene, scene.wall_roughness.heights, pitch=pitch, shape=shape, pixel_integrated=True
    )
    off = np.abs(rays.point_spread.intensity - waves.intensity).max() / waves.intensity.max()
    assert off < tol


@pytest.mark.thorough
def test_mean_of_a_scene_is_that_of_its_statistics(letter):
    scene = rough(letter, FACETS, "mean")
    pitch, shape = scene.camera.image_pitch / 32, (33, 33)
    found = psf.scene_point_spread(scene, tol=1e-2, pitch=pitch, shape=shape).point_spread
    direct = psf.mean_point_spread(
        scene, FACETS, tol=1e-2, pitch=pitch, shape=shape, pixel_integrated=True
    )
    np.testing.assert_allclose(found.intensity, direct.intensity, atol=1e-2 * found.intensity.max())


def test_slope_of_the_lobe_is_not_counted_twice(letter):
    """A lobe with the slope of the roughness gives the same image as a smooth one."""
    lobe = SpecularMicrofacet(0.05, FACETS.slope_rms)
    scene = rough(letter, FACETS)
    twice = replace(scene, wall_material=lobe)
    pitch, shape = scene.camera.image_pitch / 8, (9, 9)
    one, other = (
        psf.scene_point_spread(s, tol=1e-2, pitch=pitch, shape=shape).point_spread.intensity
        for s in (scene, twice)
    )
    np.testing.assert_array_equal(one, other)


@pytest.mark.thorough
def test_run_of_a_large_picture_uses_the_mean(letter, tmp_path):
    scene = rough(letter, GaussianWall(1e-6, 2e-3, seed=1))
    planned = plan(scene, tol=1e-2)
    mean = next(s for s in planned.stages if s.name == "mean point spread")
    assert "patterns would be needed" in mean.reason
    assert "differs by about" in mean.error
    result = simulate(scene, tol=1e-2)
    same = simulate(mean_optics(psf.SceneOptics(scene)).scene, tol=1e-2)
    np.testing.assert_array_equal(result.image.electrons, same.image.electrons)
    assert result.pupil_field is not None
    result.save(tmp_path / "out")
    from nlosoptics import load_result

    loaded = load_result(tmp_path / "out")
    np.testing.assert_array_equal(loaded.pupil_field.values, result.pupil_field.values)


@pytest.mark.thorough
def test_run_of_a_small_picture_uses_patterns(letter):
    camera = replace(letter.camera, focal_length=0.1)
    hidden = replace(letter.hidden, size=(4e-3, 4e-3))
    scene = rough(replace(letter, camera=camera, hidden=hidden), FacetWall(2e-3, 2e-4, seed=1))
    planned = plan(scene, tol=1e-2)
    assert planned.pattern_nodes > 1
    result = simulate(scene, tol=1e-2)
    assert result.field.weights.shape[1:] == (planned.pattern_nodes,) * 2
    # patterns computed at other points, relative to their peak
    assert result.errors["field of point spreads"] < 0.1


def test_a_cut_cone_cannot_be_traced_on_steep_facets(letter):
    wall = replace(letter.wall, size=(0.011, 0.011))
    scene = rough(replace(letter, wall=wall, laser=letter.laser), FacetWall(1e-3, 3e-2))
    with pytest.raises(errors.NlosError, match="realisation = 'mean'|off the wall"):
        psf.scene_point_spread(scene, tol=1e-2, shape=65)


def test_statistical_paths_take_the_mean_of_the_roughness(letter):
    """Lobes of the slope of the roughness, where no single wall is computed."""
    scene = rough(letter, FACETS)
    lobe = replace(letter, wall_material=SpecularMicrofacet(0.05, FACETS.slope_rms))
    assert scene.mirror_lobes == lobe.wall_material.mirror_lobes


def test_facets_too_fine_for_any_window_are_refused(letter):
    with pytest.raises(errors.SamplingError, match="use a larger cell or correlation_length"):
        plan(rough(letter, FacetWall(1e-6, 2e-3)), tol=1e-3)
