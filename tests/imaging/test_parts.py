"""Functions of the image model with random arguments, on record.

Coarse arguments are multiples of 1/4: footprints then meet texels at their borders exactly.
"""

from dataclasses import replace

import numpy as np
import pytest

from nlosoptics.imaging import (
    geometry,
)
from nlosoptics.raytrace import intersect
from nlosoptics.scene import (
    ConcaveWall,
    FlatWall,
    HeightMapWall,
    MeshWall,
    PlanarObject,
    SumWall,
    WavyWall,
)

WALLS = {
    "endless": FlatWall(),
    "flat": FlatWall(size=(0.11, 0.07)),
    "hemisphere": ConcaveWall(0.09, size=(0.11, 0.13)),
    "wavy": WavyWall(1e-3, 0.2, 0.3, direction=0.4, size=(0.12, 0.08)),
    "sum": SumWall(WavyWall(1e-3, 0.2, direction=0.4), ConcaveWall(1.0), size=(0.1, 0.09)),
    "map": HeightMapWall(1e-4 * np.random.default_rng(2).normal(size=(30, 41)), 3e-3),
    "mesh": MeshWall(ConcaveWall(1.0, size=(0.1, 0.08)).to_mesh(max_sag_error=1e-5)),
}


@pytest.fixture
def scene(flat_scene):
    """Few pixels, none of whose numbers are equal, a tilted picture and a weak field stop."""
    picture = np.random.default_rng(4).uniform(0.1, 1.0, (5, 7))
    picture[0] = 0.0
    hidden = PlanarObject(picture, (0.3, 0.2), position=(0.35, 0.03, 0.9), yaw=0.3, pitch=0.1)
    camera = replace(
        flat_scene.camera, pixels=(26, 20), binning=2, pixel_pitch=1e-4, focus_distance=1.7
    )
    return replace(flat_scene, hidden=hidden, camera=camera)


def test_hits_that_a_wall_continues(scene):
    """Rays just beyond an edge meet the wall's continuation, unless it cannot be extended."""
    x, y = geometry.pixel_centres(scene.camera)
    rays = geometry.chief_rays(replace(scene, wall=WALLS["flat"]), x, y)
    alone = intersect(FlatWall(), np.array(scene.camera.position), rays.directions)
    near = np.abs(alone.points[..., :2]) < np.array([0.055, 0.035]) + scene.camera.stop_diameter
    assert (np.isfinite(rays.distance) == near.all(axis=-1)).all()
