"""Arrays of results are read-only, since results are kept and shared."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics.scene import FlatWall, Lambert

from .light.draws import scene

SCENE = replace(scene(paint=Lambert(0.5), material=Lambert(0.5)), occluders=())
BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
RAYS = np.array([[0.0, 0.1, 1.0], [0.1, 0.0, 2.0]]), np.array([[0.0, 0.0, -1.0], [0.1, 0.0, -1.0]])
FEW = {"n_rays": 32, "max_bounces": 2}
BINS = {"delta_t": 0.5, "n_bins": 9, "t_start": 0.0}
RESULTS = {
    "wall": lambda: raytrace.intersect(FlatWall(), *RAYS),
    "mesh": lambda: raytrace.intersect_mesh(BALL, *RAYS),
    "all hits": lambda: raytrace.all_hits(BALL, *RAYS),
    "paths": lambda: raytrace.trace(SCENE, keep_paths=True, **FEW),
    "image": lambda: raytrace.trace_image(SCENE, **FEW, **BINS),
    "histogram": lambda: raytrace.trace_image(SCENE, **FEW, **BINS).histogram,
    "point": lambda: raytrace.trace_point(SCENE, n_rays=256),
    "irradiance": lambda: raytrace.wall_irradiance(SCENE, shape=(3, 4), n_rays=64),
}


@pytest.mark.parametrize("name", RESULTS)
def test_arrays_of_results_are_read_only(name):
    found = RESULTS[name]()
    values = {field.name: getattr(found, field.name) for field in fields(found)}
    arrays = {key: value for key, value in values.items() if isinstance(value, np.ndarray)}
    assert len(arrays) >= 4
    assert not [key for key, value in arrays.items() if value.flags.writeable]
