"""Images of random scenes, their light, noise, shadows and the visible object, on record."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from nlosoptics import imaging
from nlosoptics.imaging import detector, geometry, images, objects, radiometry, shadows, stray
from nlosoptics.scene import FlatWall, Lambert, Occluder, PlanarObject

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


def test_the_detector(flat_scene, on_record):
    light = np.outer([0.0, 3.0, 900.0], [1.0, 0.4, 12.0])
    cameras = [
        replace(flat_scene.camera, binning=binning, bit_depth=depth, read_noise=noise)
        for binning, depth, noise in ((1, 8, 0.0), (4, 12, 2.5), (64, 16, 1.0))
    ]
    ratios = (0.03, 0.7, 1.0, 4.0, 70.0, 5000.0)
    on_record(
        {
            "speckles": [detector.speckles_per_pixel(r * 2e-6, 5e-7, 4.0) for r in ratios],
            "variances": [detector.noise_variance(cameras[1], light, 7.0, m) for m in (None, 2.0)],
            "readings": [
                detector.read_out(camera, light, 7.0, freedom=freedom, seed=seed)
                for camera in cameras
                for freedom, seed in ((None, 0), (1.5, 4))
            ],
            "default": detector.read_out(cameras[1], light, 0.0),
            "bright": detector._counts(np.array([2e15, 0.9e15, 3e16]), 5),
        }
    )


def test_coherence_of_many_points(flat_scene, on_record):
    """Oblique, near, far and more points than are computed at a time."""
    rng = np.random.default_rng(3)
    centre = np.array(flat_scene.object_point)
    near = centre + rng.normal(0.0, 4e-4, (70, 3))
    laser = replace(flat_scene.laser, position=(2.0, 0.3, 0.4), beam_diameter=2e-3)
    oblique = replace(flat_scene, laser=laser)
    edge = replace(flat_scene, wall=FlatWall(size=(1.2, 0.0012)))
    on_record(
        {
            "near": attempt(imaging.spot_coherence, flat_scene, near),
            "oblique": attempt(imaging.spot_coherence, oblique, near[:4].reshape(2, 2, 3)),
            "one": attempt(imaging.spot_coherence, oblique, near[0], reference=near[1]),
            "none": attempt(imaging.spot_coherence, oblique, near[:0]),
            "edge": attempt(imaging.spot_coherence, edge, near[:2]),
        }
    )


def test_a_scene_without_light_or_shadow(flat_scene, on_record):
    """A black picture, a mirror wall, a camera that looks away, and no occluder."""
    scene = few_pixels(2)
    black = replace(flat_scene, hidden=replace(flat_scene.hidden, image=np.zeros((3, 4))))
    away = replace(flat_scene.camera, aim=(-2.0, 0.0, 0.0), field_stop=None)
    matt = replace(flat_scene, wall_material=Lambert(0.4))
    spot = radiometry.laser_spot(flat_scene)
    patches = [objects.object_patches(one.hidden) for one in (black, flat_scene)]
    none = imaging.cast_shadows(scene)
    on_record(
        {
            "shadows": none,
            "repainted": shadows.repainted(none, scene) is none,
            "black": [patches[0], objects.object_samples(black.hidden, 50)],
            "work": [
                radiometry.background_work(one, part)
                for one in (flat_scene, matt)
                for part in patches
            ],
            "away": [
                radiometry.spot_power_through_lens(replace(flat_scene, camera=away), spot),
                stray.spot_image(replace(flat_scene, camera=away), spot),
            ],
            "images": [attempt(imaging.form_image, one, blur(one)) for one in (black, matt)],
        }
    )


def test_fine_shadows(flat_scene, on_record):
    """More pixels than the veil has nodes, so that it is interpolated, and paths to the wall."""
    box = trimesh.creation.box((0.4, 0.3, 0.02))
    box.apply_translation((0.2, 0.15, 0.4))
    camera = replace(flat_scene.camera, binning=1, pixels=(70, 3), pixel_pitch=1.5e-3)
    laser = replace(flat_scene.laser, position=(-0.6, 0.3, 1.1))
    other = {"occluders": (Occluder(box),), "wall_material": Lambert(0.4)}
    scene = replace(flat_scene, camera=camera, laser=laser, **other)
    centres, pitch = geometry.pixel_centres(camera), camera.image_pitch
    known = attempt(imaging.cast_shadows, scene)
    use = np.zeros((3, 70), dtype=bool)
    use[1, 30:40] = True
    on_record(
        {
            "shadows": known,
            "samples": [*shadows.wall_samples(scene, centres, pitch, use)],
            "nodes": [shadows._nodes(count) for count in (1, 2, 65, 66, 200)],
        }
    )
