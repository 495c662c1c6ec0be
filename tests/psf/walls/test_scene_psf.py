"""From a scene to its point spread: layout, refinement, vignetting, shared geometry."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import NlosError, SamplingError, SceneError
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Laser,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

WAVELENGTH = 632.8e-9
EXAMPLES = Path(__file__).parents[3] / "examples" / "scenes"
MIRROR = SumMaterial(SpecularMicrofacet(0.05, 0.0))


def small_wall(width, y, **changes):
    """A camera with a stop of 20 mm before a flat wall that holds a part of the cone of light."""
    return Scene(
        Laser(wavelength=WAVELENGTH, power=5e-3, beam_diameter=3e-3, position=(0.0, 0.3, 1.1)),
        FlatWall(size=width),
        PlanarObject(np.ones((16, 16)), 0.05, position=(-0.31, y, 0.83)),
        Camera(
            position=(0.31, 0.0, 0.83),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.02,
            pixels=(4096, 4096),
            binning=64,
        ),
        wall_material=MIRROR,
        **changes,
    )


#: The wall's edge takes a fifth of the light; the wall is the stop.
SCENES = {"vignetted": small_wall(0.06, 0.055), "stop": small_wall(0.008, 0.0)}


def window(scene, shape=48):
    """Pixels of a quarter of lambda N."""
    unit = scene.laser.wavelength * psf.exit_pupil(scene).f_number
    return {"pitch": unit / 4, "shape": shape}


def test_the_two_scenes_are_cut_as_they_say():
    pupils = {name: psf.exit_pupil(scene) for name, scene in SCENES.items()}
    assert {name: pupil.stop for name, pupil in pupils.items()} == {
        "vignetted": "lens",
        "stop": "wall",
    }
    assert pupils["vignetted"].vignetting == approx(0.2, abs=0.01)
    assert [pupil.layout for pupil in pupils.values()] == ["grid", "grid"]


@pytest.mark.parametrize("name", SCENES)
def test_a_cut_pupil_is_that_of_exact_edges(name):
    """The grid against cells that follow the wall's edge, summed exactly."""
    scene = SCENES[name]
    found = psf.scene_point_spread(scene, 1e-3, **window(scene))
    assert found.wavefront.layout == "grid"
    cells = psf.wavefront(scene, nodes="cells")
    exact = psf.point_spread(
        cells, method="quadrature", pixel_integrated=True, tol=1e-6, **window(scene)
    )
    peak = exact.intensity.max()
    off = np.abs(found.point_spread.intensity - exact.intensity).max() / peak
    # the default error of a scene's point spread; a wall's edge counts with shares of cells
    assert off < 1e-3
    # a clear lens would be off by far more
    clear = psf.scene_point_spread(replace(scene, wall=FlatWall()), 1e-3, **window(scene))
    assert np.abs(clear.point_spread.intensity - exact.intensity).max() > 0.05 * peak


def rough_images(scene, roughness, **options):
    """Images of a rough wall by the three functions that take a scene and its roughness."""
    mean = psf.mean_point_spread(scene, roughness, pixel_integrated=True, **options)
    one = psf.sample_point_spread(scene, roughness, seed=1, pixel_integrated=True, **options)
    both = psf.hybrid_point_spread(scene, roughness=roughness, check=False, **options)
    return {"mean": mean, "sample": one, "hybrid": both}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCENES)
def test_rough_walls_agree_in_the_smooth_limit(name):
    scene, height = SCENES[name], 1e-12
    smooth = psf.scene_point_spread(scene, 1e-3, **window(scene)).point_spread
    peak = smooth.intensity.max()
    s = 2 * math.pi / WAVELENGTH * psf.wall_view(scene).cos_sum * height
    assert s < 3e-5
    for found in rough_images(scene, psf.Roughness(height, 1e-3), **window(scene)).values():
        off = np.abs(found.intensity - smooth.intensity).max() / peak
        # one wall's field is off by s, its intensity by twice that; some pixels by a few of them
        assert off < smooth.error_estimate + found.error_estimate + 8 * s


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCENES)
def test_rough_walls_agree_on_a_cut_pupil(name):
    """Half of the light scattered: the mean of drawn walls, and the halo of the hybrid."""
    scene = SCENES[name]
    height = math.sqrt(math.log(2)) * WAVELENGTH / (2 * math.pi * psf.wall_view(scene).cos_sum)
    roughness = psf.Roughness(height, 2e-3)
    found = rough_images(scene, roughness, **window(scene))
    mean, both = found["mean"], found["hybrid"]
    assert mean.coherent_fraction == approx(0.5, rel=1e-12)
    peak = mean.intensity.max()
    off = np.abs(both.intensity - mean.intensity).max() / peak
    assert off < mean.error_estimate + both.error_estimate + 1e-12
    count = 64
    drawn = psf.sample_point_spread(
        scene,
        roughness,
        seed=3,
        independent_patterns=count,
        pixel_integrated=True,
        **window(scene),
    )
    # speckle of contrast 1 at most, over 64 walls, and the largest of some hundred of them
    assert np.abs(drawn.intensity - mean.intensity).max() < 4 * peak / math.sqrt(count)
    # their sum over the window varies less; without the cut it would be off by its share
    assert drawn.intensity.sum() == approx(mean.intensity.sum(), rel=0.1)


@pytest.mark.parametrize("name", SCENES)
def test_light_through_a_cut_pupil_is_what_rays_bring(name):
    """The flux of the mirror image against a trace of the whole wall."""
    scene = SCENES[name]
    found = psf.hybrid_point_spread(scene, n_rays=1 << 16, seed=2, **window(scene))
    assert 0.0 < found.traced_flux_error < 0.02
    assert found.traced_flux == approx(1.0, abs=4 * found.traced_flux_error)


def test_auto_takes_a_grid_where_an_edge_cuts_this_point_alone(flat_scene):
    """The wall holds the light of the reference point, and not all of that of one beside it."""
    scene = replace(flat_scene, wall=FlatWall(size=(0.36, 1.0)))
    assert psf.wavefront(scene).layout == "polar"
    x, y, z = scene.hidden.position
    aside = (x - 0.035, y, z)
    with pytest.raises(SamplingError, match=r"the wall's edge cuts .* of the pupil"):
        psf.wavefront(scene, aside, nodes="polar")
    wave = psf.wavefront(scene, aside)
    assert wave.layout == "grid"
    assert 0.0 < 1 - wave.weights.sum() / (math.pi * wave.pupil_radius**2) < 0.9
    # a field has both kinds, each to the wanted error
    small = replace(scene, hidden=replace(scene.hidden, size=0.07))
    field = psf.point_spread_field(small, (1, 2), tol=1e-2, pitch=4e-6, checks=0)
    assert field.modes.shape[0] == 2
    right = small.hidden.axes[0]
    layouts = []
    for across in field.across:
        point = small.object_point + 0.035 * across * right
        side = field.modes.shape[1]
        exact = psf.scene_point_spread(small, 1e-2, object_point=point, pitch=4e-6, shape=side)
        layouts.append(exact.wavefront.layout)
        intensity = exact.point_spread.intensity
        off = np.abs(field.point_spread(across, 0.0) - intensity).max()
        assert off < 1e-2 * intensity.max()
    assert sorted(layouts) == ["grid", "polar"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scene", "layout", "steps"),
    [("vignetted", "grid", (512, 1024, 2048)), (None, "polar", (24, 48, 96))],
)
def test_nodes_are_refined_until_they_are_enough(flat_scene, scene, layout, steps):
    seen = psf.SceneOptics(SCENES.get(scene, flat_scene)).reference
    tried = []

    def fussy(aimed):
        tried.append(aimed.wave.u.shape[0])
        assert aimed.wave.layout == layout
        if len(tried) < enough:
            raise SamplingError("too few")
        return len(tried)

    for enough in (1, 2):
        tried.clear()
        aimed, found = seen.refined(fussy)
        assert tuple(tried) == steps[:enough]
        assert aimed.wave.u.shape[0] == steps[enough - 1]
        assert found == enough
    enough = 4
    tried.clear()
    with pytest.raises(SamplingError, match="^too few$"):
        seen.refined(fussy)
    assert tuple(tried) == steps


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tol": 0.0}, "tol = 0"),
        ({"tol": float("nan")}, "tol = nan"),
        ({"pitch": -1e-6}, "pitch = -1e-06"),
        ({"shape": 0}, "shape"),
        ({"object_point": (0.0, float("nan"), 1.0)}, "object_point"),
        ({"object_point": (0.0, 0.0, -1.0)}, "object_point has z = -1"),
        ({"scene": "letter_flat.toml"}, "scene is a str; give a Scene"),
    ],
)
def test_bad_input_is_refused(flat_scene, changes, message):
    with pytest.raises(SceneError, match=message):
        psf.scene_point_spread(**({"scene": flat_scene} | changes))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tol": 1e-320}, "tol = .* must be from 1e-12 to 1"),
        ({"tol": True}, "tol = True is not a number"),
        ({"model": "vector"}, "model = 'vector'"),
        ({"pitch": 1e300}, "pitch = 1e.300 m is out of range, must be from 1e-15 to 1000 m"),
        ({"pitch": 1e-320}, "pitch = .* must be from 1e-15 to 1000 m"),
        ({"shape": 10**400}, "shape = an int of 1329 bits is out of range"),
        ({"shape": (10**9, 10**9)}, r"1e.09 x 1e.09 pixels needs .* GiB; use a smaller shape"),
        ({"pitch": 1e-12}, "GiB; use a larger tol, a wider pitch or a shape"),
        ({"object_point": (5.0, 0.0, 1.0)}, "by no part of the wall, wall.size = .*; enlarge"),
    ],
)
def test_a_wrong_option_ends_in_one_line_before_any_work(options, message):
    with pytest.raises(NlosError, match=message) as raised:
        psf.scene_point_spread(SCENES["vignetted"], **options)
    assert "\n" not in str(raised.value)


def test_a_fast_lens_gets_the_vector_model_where_tol_needs_it(flat_scene):
    """At F/2 the scalar model errs by 1 %; only a smooth wall has the other one."""
    fine = {"pitch": 0.5e-6, "shape": 33}
    scalar, found = (
        psf.scene_point_spread(flat_scene, 1e-4, model=model, **fine).point_spread
        for model in ("scalar", "auto")
    )
    assert (scalar.model, found.model, found.model_error) == ("scalar", "high-aperture", 0.0)
    difference = np.abs(found.intensity - scalar.intensity).max() / found.intensity.max()
    # the difference is the whole of the model's error, up to the errors of both
    assert 0.1 * scalar.model_error < difference < scalar.model_error + 2e-4
    wave = psf.scene_point_spread(flat_scene, 1e-4, **fine).wavefront
    options = {"pixel_integrated": True, "tol": 1e-4, "model": "high-aperture", **fine}
    alone = psf.point_spread(wave, **options)
    assert np.array_equal(found.intensity, alone.intensity)
    # a pixel that holds nearly all of the light hides the difference
    wide = psf.scene_point_spread(flat_scene, 1e-3, model="auto").point_spread
    assert wide.model == "scalar"
    assert wide.model_error < 1e-3
    blurred = replace(flat_scene, wall_material=SumMaterial(SpecularMicrofacet(0.05, 1e-3)))
    with pytest.raises(SceneError, match="model = 'high-aperture' for a wall with a lobe with"):
        psf.scene_point_spread(blurred, model="high-aperture", **fine)
    assert (
        psf.scene_point_spread(blurred, 1e-2, model="auto", **fine).point_spread.model == "scalar"
    )


def test_roughness_has_no_vector_model():
    scene = Scene.load(EXAMPLES / "letter_rough.toml")
    with pytest.raises(SceneError, match="model = 'high-aperture' for a wall with roughness"):
        psf.scene_point_spread(scene, model="high-aperture", shape=5)
