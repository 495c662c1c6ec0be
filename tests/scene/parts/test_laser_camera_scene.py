"""Laser, camera and scene: derived quantities and what they refuse."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    FlatWall,
    Laser,
    MeshObject,
    PlanarObject,
    Scene,
)
from nlosoptics.scene.parts.camera import pupil_frame

LASER = Laser(
    wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(1.0, 0.0, 1.2), aim=(0.6, 0, 0)
)
CAMERA = Camera(
    position=(-0.6, 0.0, 0.8), aim=(-0.1645, 0.0, 0.0), focal_length=0.0506, stop_diameter=0.025
)
HIDDEN = PlanarObject(np.eye(8), 0.3, position=(0.3798, 0.0, 1.0))
SCENE = Scene(LASER, FlatWall(), HIDDEN, CAMERA)


@pytest.mark.parametrize("axis", [(0, 0, -1), (0.5, 0, -0.8), (0.3, -0.6, -0.2), (0, 1, 0)])
def test_pupil_frame(axis) -> None:
    """Rows e1 = unit(Y x n), e2 = n x e1, n: right-handed, e1 level unless the axis is vertical."""
    n = np.array(axis) / np.linalg.norm(axis)
    e1, e2, last = pupil_frame(n)
    frame = np.stack([e1, e2, last])
    assert frame @ frame.T == approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(frame) == approx(1.0)
    assert_array_equal(last, n)
    assert e1[1] == approx(0.0, abs=1e-15)
    if abs(n[1]) < 1:
        assert e2[1] > 0


def test_camera_pixels() -> None:
    assert CAMERA.shape == (512, 512)
    assert CAMERA.image_pitch == 72e-6
    wide = replace(CAMERA, pixels=(640, 480), binning=4)
    assert wide.shape == (120, 160)
    assert wide.resized(80).shape == (60, 80)
    assert wide.resized(80).image_pitch * 80 == approx(wide.image_pitch * 160)  # the same field


def test_thin_lens() -> None:
    """1/f = 1/s + 1/d, s along the axis to the mirrored object."""
    s = SCENE.focus_distance
    mirrored = np.array([0.3798, 0.0, -1.0])
    assert_array_equal(SCENE.mirrored_object_point, mirrored)
    assert s == approx((mirrored - CAMERA.position) @ CAMERA.axis, rel=1e-15)
    assert 1 / s + 1 / SCENE.image_distance == approx(1 / 0.0506, rel=1e-14)
    assert replace(SCENE, camera=replace(CAMERA, focus_distance=1.5)).focus_distance == 1.5


def test_object_point_of_a_mesh_is_its_centroid() -> None:
    hidden = MeshObject(trimesh.creation.box((0.2, 0.2, 0.2)), position=(0.3, 0.1, 1.0))
    assert replace(SCENE, hidden=hidden).object_point == approx([0.3, 0.1, 1.0], abs=1e-15)


BAD = [
    (LASER, "wavelength", 632.8, r"laser.wavelength = 632.8 m .* 1e-08 to 0.0001 m; .*nanometres"),
    (LASER, "power", 1.1e18, r"laser.power = 1.1e\+18 W .* from 0 to 1e\+18 W"),
    (LASER, "power", 10**400, "laser.power is beyond the range of a float"),
    (LASER, "aim", (0, 0), "laser.aim has 2 components; give three"),
    (
        CAMERA,
        "position",
        (0, 0, -1),
        "camera.position has z = -1 m, behind the wall; must be above",
    ),
    (CAMERA, "aim", (-0.6, 1.0, 0.8), "camera.aim = .* looks away from the wall"),
    (CAMERA, "pixel_pitch", math.inf, "camera.pixel_pitch = inf is not finite"),
    (CAMERA, "binning", 3, r"camera.binning = 3 does not divide .*\(4096, 4096\); use a common"),
    (CAMERA, "exposure", 1.1e18, r"camera.exposure = 1.1e\+18 s .* above 0 to 1e\+18 s"),
    (CAMERA, "full_well", 0, "camera.full_well = 0 electrons .* above 0"),
    (CAMERA, "bit_depth", 33, "camera.bit_depth = 33 is out of range, must be from 1 to 32"),
    (CAMERA, "field_stop", 0, "camera.field_stop = 0 .* must be above 0"),
    (SCENE, "wall_material", 0.7, "scene.wall_material is a float; give a Material"),
    (SCENE, "occluders", 1, "scene.occluders is a int; give a tuple of meshes"),
]


@pytest.mark.parametrize(
    ("noun", "name", "value", "message"), BAD, ids=[f"{name}={value}" for _, name, value, _ in BAD]
)
def test_bad_values(noun, name: str, value, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        replace(noun, **{name: value})
    assert "\n" not in str(caught.value)


def test_object_within_the_focal_length() -> None:
    scene = replace(SCENE, camera=replace(CAMERA, focal_length=5.0))
    with pytest.raises(SceneError, match=r"within its focal length 5 m; turn the camera"):
        _ = scene.image_distance


# In front of a curved wall: all of them at z > 0, so behind only what the wall raises


def behind(wall, name: str, **changes) -> str:
    """What a scene with that wall says; the same scene with the wall's plane is accepted."""
    replace(SCENE, **changes)
    with pytest.raises(SceneError, match=f"^{name}.*; move it further into the room$") as caught:
        replace(SCENE, wall=wall, **changes)
    return str(caught.value)


def test_object_behind_a_hollow_wall() -> None:
    """Sag of a sphere: 1 - sqrt(1 - 0.6^2) = 0.2 m."""
    hidden = replace(HIDDEN, position=(0.6, 0, 0.05))
    said = behind(ConcaveWall(1.0), "hidden.position", hidden=hidden)
    assert "at x = 0.6 m, y = 0 m, z = 0.05 m, behind" in said
    assert "whose height there is 0.2 m" in said


def test_corner_of_the_picture_behind_a_hollow_wall() -> None:
    """The centre at 0.2 m + 1 mm is in front, and the corner at x = 0.75 m is not."""
    hidden = replace(HIDDEN, position=(0.6, 0, 0.201))
    said = behind(ConcaveWall(1.0), "hidden.size", hidden=hidden)
    assert "puts a corner at x = 0.45 m, y = 0.15 m" not in said  # 0.12 m high there
    assert "puts a corner at x = 0.75 m, y = " in said
    height = 1 - math.sqrt(1 - 0.75**2 - 0.15**2)
    assert f"whose height there is {height:g} m" in said


def test_no_height_beyond_the_walls_edge_and_rim() -> None:
    """Nothing is behind a wall that is not there: past its size, or past the sphere's equator."""
    replace(SCENE, wall=ConcaveWall(1.0, size=0.8), hidden=replace(HIDDEN, position=(0.6, 0, 0.05)))
    replace(SCENE, wall=ConcaveWall(0.4), hidden=replace(HIDDEN, position=(0.6, 0, 0.05)))
