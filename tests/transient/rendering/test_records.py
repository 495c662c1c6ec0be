"""Rendered captures of small meshes, with shadows, lobes and several bounces, on record."""

import numpy as np
import pytest
import trimesh

from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial
from nlosoptics.transient import render, render_scene

from ...records import attempt
from ...runs.random_scenes import random_case

POINTS = np.array([[-0.5, 0.4, 0.0], [0.3, -0.2, 0.0], [0.0, 0.1, 0.0]])
BINS = {"t_start": 1.0, "delta_t": 0.05, "n_bins": 60}
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.2, 0.15))


def thing(kind, material=None):
    if kind == "box":
        mesh = trimesh.creation.box((0.4, 0.3, 0.2))
        mesh.apply_transform(trimesh.transformations.rotation_matrix(0.5, (1, 2, 0.5)))
    else:
        mesh = trimesh.creation.icosphere(1, 0.2)
    mesh.apply_translation((0.1, 0.0, 0.9 if kind == "box" else 0.6))
    return mesh, material or Lambert(0.8)


@pytest.mark.parametrize("material", ["matt", "rough", "gloss"])
@pytest.mark.parametrize("kinds", [("box",), ("ball",), ("box", "ball")], ids="-".join)
def test_three_bounces(kinds, material, on_record):
    paint = {"matt": Lambert(0.8), "rough": OrenNayar(0.7, 0.3), "gloss": GLOSS}[material]
    surfaces = [thing(kind, paint) for kind in kinds]
    told = []
    asked = {"sensor_points": POINTS, "max_bounces": 3, **BINS, "tol": 1e-2}
    asked["progress"] = lambda *step: told.append(step)
    lamps = {"laser_origin": (0.5, 0.2, 1.0), "sensor_origin": (-0.4, 0.1, 1.2)}
    on_record(
        [
            attempt(render, surfaces, laser_points=POINTS[2], **asked),
            attempt(
                render,
                surfaces,
                laser_points=POINTS,
                pairing="confocal",
                **asked,
                **lamps,
                outer_legs=True,
                quantity="radiance",
                keep_laser_cosine=True,
                wall_albedo=0.5,
            ),
            told,
        ]
    )


@pytest.mark.parametrize("kinds", [("box",), ("box", "ball")], ids="-".join)
def test_more_bounces(kinds, on_record):
    surfaces = [thing(kind) for kind in kinds]
    asked = {"laser_points": POINTS[2], "sensor_points": POINTS, **BINS, "tol": 0.3, "seed": 2}
    told = []
    asked["progress"] = lambda *step: told.append(step)
    on_record([attempt(render, surfaces, min_bounces=1, max_bounces=4, **asked), told])


@pytest.mark.parametrize("number", range(5))
def test_a_scene(number, on_record):
    scene = random_case(number).scene
    asked = {"sensor_points": POINTS, "laser_points": POINTS[2], "max_bounces": 3, **BINS}
    on_record(attempt(render_scene, scene, tol=0.05, **asked))
