"""Images of random scenes, their light, noise, shadows and the visible object, on record."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from nlosoptics import imaging
from nlosoptics.imaging import geometry, images, objects, radiometry, stray
from nlosoptics.scene import Occluder, PlanarObject

from ..records import attempt
from ..runs.random_scenes import random_case


def few_pixels(number, **changes):
    scene = random_case(number, **changes).scene
    return replace(scene, camera=replace(scene.camera, pixels=(14, 11)))


def blur(scene):
    kernel = np.array([[0.0, 0.1, 0.0], [0.1, 0.5, 0.2], [0.0, 0.0, 0.1]])
    pitch = scene.camera.image_pitch
    return SimpleNamespace(intensity=kernel, pitch=pitch, normalisation="unit-sum")


@pytest.mark.parametrize("number", range(24))
def test_an_image(number, on_record):
    scene = few_pixels(number, wild=number % 4 == 3)
    rng = np.random.default_rng(1)
    on_record(
        {
            "light": attempt(images.light_levels, scene, exposure=0.3),
            "image": attempt(imaging.form_image, scene, blur(scene), seed=3),
            "other": attempt(
                imaging.form_image, scene, blur(scene), rng.random((5, 7)), exposure=0.02
            ),
            "noise": images.reading_noise(scene, rng.random((11, 14)) * 1e3),
            "mirror": attempt(images.mirror_image, scene),
        }
    )


@pytest.mark.parametrize("number", range(6))
def test_the_objects_samples_and_the_spot(number, on_record):
    scene = few_pixels(number)
    spot = attempt(radiometry.laser_spot, scene)
    patches = objects.object_patches(scene.hidden)
    on_record(
        {
            "patches": patches,
            "samples": [objects.object_samples(scene.hidden, n) for n in (1, 37)],
            "work": attempt(radiometry.background_work, scene, patches),
            "stray": attempt(stray.spot_image, scene, spot),
            "places": isinstance(scene.hidden, PlanarObject)
            and attempt(
                lambda: geometry.picture_positions(
                    scene.hidden, geometry.chief_rays(scene, *geometry.pixel_edges(scene.camera))
                )
            ),
        }
    )


@pytest.mark.parametrize("wall", [2, 6, 14])
def test_shadows(wall, flat_scene, on_record):
    box = trimesh.creation.box((0.12, 0.1, 0.02))
    box.apply_translation((0.09, 0.01, 0.2))
    camera = replace(flat_scene.camera, binning=256)
    scene = replace(
        flat_scene, camera=camera, occluders=(Occluder(box),), wall=random_case(wall).scene.wall
    )
    shadows = attempt(imaging.cast_shadows, scene)
    on_record([shadows, attempt(imaging.form_image, scene, blur(scene))])


@pytest.mark.parametrize("beam", [1e-3, 2e-2])
@pytest.mark.parametrize("focus", [None, 3.0])
def test_the_image_of_the_spot(beam, focus, flat_scene, on_record):
    laser = replace(flat_scene.laser, beam_diameter=beam)
    camera = replace(flat_scene.camera, binning=128, aim=(0.05, 0.02, 0.0), focus_distance=focus)
    scene = replace(flat_scene, laser=laser, camera=camera)
    distances = np.linspace(0.0, 3.2, 30)
    areas = [stray.common_area(distances, *radii) for radii in ((1.0, 2.0), (0.0, 1.5), (1.0, 1.0))]
    on_record([stray.spot_image(scene, radiometry.laser_spot(scene)), areas])


@pytest.mark.parametrize("wall", [None, 2])
def test_the_image_of_the_object(wall, flat_scene, on_record):
    camera = replace(flat_scene.camera, binning=256)
    own = flat_scene.wall if wall is None else random_case(wall).scene.wall
    scene = replace(flat_scene, camera=camera, wall=own)
    on_record(attempt(imaging.image_field, scene, tol=0.1, most_nodes=4))


def test_coherence(flat_scene, on_record):
    points = np.array([[0.38, 0.01, 1.0], [0.3801, 0.0, 1.0]])
    on_record(attempt(imaging.spot_coherence, flat_scene, points))
