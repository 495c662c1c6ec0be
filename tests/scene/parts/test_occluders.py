"""Occluders: their position, and the mesh that they form together."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics.errors import SceneError
from nlosoptics.scene import MeshObject, Occluder


def test_an_occluder_is_placed_as_a_hidden_mesh_is() -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    place = {"scale": 0.5, "position": (0.4, -0.1, 0.9), "yaw": 0.3, "pitch": -0.2, "roll": 1.0}
    occluder, hidden = Occluder(box, **place), MeshObject(box, **place)
    np.testing.assert_array_equal(occluder.surface.vertices, hidden.surface.vertices)
    assert occluder.surface is occluder.surface
    assert box.bounds[1, 2] == 0.15  # the caller's mesh is left alone


def test_an_occluder_may_stand_on_the_wall_and_not_reach_behind_it() -> None:
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    # the corner of a box turned by 45 degrees about y touches z = 0 to rounding
    standing = Occluder(box, position=(0.3, 0, 0.1 * math.sqrt(2)), yaw=math.pi / 4)
    assert abs(standing.surface.vertices[:, 2].min()) < 1e-15
    behind = replace(standing, position=(0.3, 0, 0.14))
    with pytest.raises(SceneError, match=r"occluder.mesh reaches z = -0.0014.* at least 0; move"):
        _ = behind.surface


def test_all_occluders_are_one_mesh(flat_scene) -> None:
    assert flat_scene.occluding_mesh is None
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    high = box.copy()
    high.apply_translation((0, 0, 1))
    scene = replace(flat_scene, occluders=[high, Occluder(box, position=(1, 0, 2))])
    assert isinstance(scene.occluders, tuple)
    mesh = scene.occluding_mesh
    assert mesh is scene.occluding_mesh
    assert len(mesh.faces) == 24
    assert mesh.volume == pytest.approx(2 * 0.008, rel=1e-12)
    np.testing.assert_allclose(mesh.bounds, [(-0.1, -0.1, 0.9), (1.1, 0.1, 2.1)], rtol=1e-14)
    # what is cached is no part of a scene
    assert scene == replace(scene)
    again = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(again.occluding_mesh.vertices, mesh.vertices)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": -1}, "occluder.scale = -1 is out of range, must be above 0"),
        ({"position": (0, 0)}, "occluder.position has 2 components; give three"),
        ({"roll": math.nan}, "occluder.roll = nan is not finite"),
    ],
)
def test_bad_occluders(change, message) -> None:
    with pytest.raises(SceneError, match=message):
        Occluder("x.stl", **change)
    with pytest.raises(SceneError, match=r"occluder.mesh: there is no file .*x.stl; give"):
        _ = Occluder("x.stl").surface
