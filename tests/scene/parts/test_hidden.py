"""Hidden objects: pose, pictures and meshes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal
from PIL import Image
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.scene import MeshObject, PlanarObject
from nlosoptics.scene.parts._posed import rotation_matrix

PLACE = (0.5, 0.0, 1.0)
F = np.array([[1, 1, 1], [1, 0, 0], [1, 1, 0], [1, 0, 0]]) * 1.0  # row 0 on top


def planar(image=F, size=0.3, position=PLACE, **pose) -> PlanarObject:
    return PlanarObject(image, size, position=position, **pose)


# Pose


def test_unturned_object_faces_a_viewer_at_the_wall() -> None:
    """Who looks along +z with y up sees right as -x, and the picture's normal comes at them."""
    right, up, normal = planar().axes
    assert_array_equal(right, [-1, 0, 0])
    assert_array_equal(up, [0, 1, 0])
    assert_array_equal(normal, [0, 0, -1])
    assert_array_equal(np.cross(right, up), normal)


def test_roll_comes_first_yaw_last() -> None:
    turn = rotation_matrix(0.3, -0.4, 0.5)
    steps = rotation_matrix(0.3, 0, 0) @ rotation_matrix(0, -0.4, 0) @ rotation_matrix(0, 0, 0.5)
    assert turn == approx(steps, abs=1e-15)
    assert turn @ turn.T == approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(turn) == approx(1.0)


def test_mesh_is_scaled_turned_and_moved() -> None:
    tetrahedron = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    )
    hidden = MeshObject(
        tetrahedron, scale=0.1, position=(0.5, 0.2, 1.0), yaw=0.3, pitch=0.4, roll=0.5
    )
    turned = rotation_matrix(0.3, 0.4, 0.5)
    expected = 0.1 * tetrahedron.vertices @ turned.T + np.array([0.5, 0.2, 1.0])
    assert hidden.surface.vertices == approx(expected, abs=1e-15)
    assert tetrahedron.vertices.max() == 1.0  # the caller's mesh is left alone


def test_corners_are_half_a_size_from_the_centre() -> None:
    hidden = planar(size=(0.2, 0.4), roll=math.pi / 2)
    # cos(pi/2) is 6e-17
    expected = {(0.5 + dx, dy, 1.0) for dx in (-0.2, 0.2) for dy in (-0.1, 0.1)}
    assert {tuple(np.round(corner, 12)) for corner in hidden.corners} == expected


def test_one_size_is_the_width() -> None:
    assert planar(size=0.3).size == approx((0.3, 0.4), rel=1e-15)
    for kind in (np.float64, np.float32, np.array):
        assert planar(size=kind(0.5)).size == approx((0.5, 2 / 3), rel=1e-15)
    assert planar(size=np.int64(2), position=(0, 0, 3)).size == approx((2, 8 / 3), rel=1e-15)
    assert planar(size=(0.3, 0.5)).size == (0.3, 0.5)


# Pictures


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, bool])
def test_pictures_scale_to_one(suffix: str, kind: type, tmp_path: Path) -> None:
    """Black is 0, white is 1, and grey the share of the type's largest."""
    largest = 1 if kind is bool else np.iinfo(kind).max
    raw = np.array([[0, largest, largest // 3], [1, 0, largest]]).astype(kind)
    Image.fromarray(raw).save(tmp_path / f"p{suffix}")
    expected = raw.astype(float) / largest
    assert_array_equal(planar(tmp_path / f"p{suffix}").reflectance, expected)
    assert_array_equal(planar(raw).reflectance, expected)


def test_first_row_is_the_top(examples: Path) -> None:
    """The F of the examples: its long bar is above the short one, and on the left is the stem."""
    letter = planar(examples / "objects" / "F.png").reflectance
    rows, columns = np.nonzero(letter > 0.5)
    widths = [(letter[row] > 0.5).sum() for row in (rows.min() + 5, rows.max() - 5)]
    assert widths[0] > 2 * widths[1]
    assert columns[rows == rows.max() - 5].max() < columns.max()


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (np.zeros((2, 2, 3)), r"hidden.image has shape \(2, 2, 3\); give a greyscale image"),
        (np.array([[0.0, np.nan]]), "hidden.image holds NaN or infinity; give finite"),
        (np.array([[0, 255]]), "hidden.image spans 0 to 255, must be within 0 to 1; rescale"),
        (np.array([["a", "b"]]), "hidden.image holds .* values; give real brightness"),
    ],
)
def test_bad_arrays(raw, message: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=message):
        planar(raw)
    np.save(tmp_path / "p.npy", raw)
    pattern = message.replace("hidden.image ", r"hidden.image \(.*p.npy\) ")
    with pytest.raises(SceneError, match=pattern):
        _ = planar(tmp_path / "p.npy").reflectance


@pytest.mark.parametrize("name", ["p.png", "p.npy", "p.txt"])
@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n", b"\x93NUMPY\x01"])
def test_bad_picture_files(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        SceneError, match=rf"hidden.image: .*{name} is no readable image .*; give PNG"
    ):
        _ = planar(tmp_path / name).reflectance


# Bad input


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: planar(size=-0.3), r"hidden.size\[x\] = -0.3 m .* must be above 0 m"),
        (lambda: planar(size="1"), r"hidden.size has 1 component; give one number"),
        (lambda: planar(material="foam"), "hidden.material = 'foam' is a str; give a Material"),
        (lambda: planar(size=math.nan), r"hidden.size\[x\] = nan is not finite"),
        (lambda: planar(position=(0, math.inf, 1)), r"hidden.position\[y\] = inf is not finite"),
        (
            lambda: planar(position=(0, 0, 0.1), pitch=1.5),
            "z = 0.1 m, which puts a corner .* at z = -0.099499 m, behind the wall; move it",
        ),
        (
            lambda: MeshObject(trimesh.creation.box((1, 1, 3)), position=PLACE).surface,
            "hidden.mesh reaches z = -0.5 m, behind the wall, must be above 0; move hidden",
        ),
    ],
)
def test_bad_objects(make, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()


def test_a_picture_close_to_the_wall_but_in_front() -> None:
    """The limit is the corner: 0.2 m high, leaning by 30 degrees, it reaches 0.05 m down."""
    ok = planar(size=(0.2, 0.2), position=(0, 0, 0.0501), pitch=math.pi / 6)
    with pytest.raises(SceneError, match="behind the wall"):
        replace(ok, position=(0, 0, 0.0499))


# Picture files


def test_a_phones_rotation_is_applied(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x112] = 6  # the camera was turned: show it 90 degrees clockwise
    picture = Image.fromarray(np.uint8(255 * F))
    picture.save(tmp_path / "turned.png", exif=exif)
    assert_array_equal(planar(tmp_path / "turned.png").reflectance, np.rot90(F, -1))


def test_what_a_picture_would_lose_is_named(tmp_path: Path) -> None:
    grey = np.uint8(255 * F)
    picture = Image.fromarray(grey)
    picture.save(tmp_path / "two.tif", save_all=True, append_images=[picture])
    Image.fromarray(np.dstack([grey] * 4)).save(tmp_path / "clear.png")
    opaque = np.dstack([grey] * 3 + [np.full_like(grey, 255)])
    Image.fromarray(opaque).save(tmp_path / "opaque.png")
    noise = np.random.default_rng(1).integers(0, 255, (99, 99)).astype(np.uint8)
    Image.fromarray(noise).save(tmp_path / "half.png")
    (tmp_path / "half.png").write_bytes((tmp_path / "half.png").read_bytes()[:3000])
    assert_array_equal(planar(tmp_path / "opaque.png").reflectance, F)
    for name, text in (("two.tif", "2 images"), ("clear.png", "transp"), ("half.png", "truncat")):
        with pytest.raises(SceneError, match=text):
            planar(tmp_path / name)


def test_vertices_whose_squares_overflow_are_refused() -> None:
    mesh = trimesh.creation.box()
    mesh.vertices *= 1e200
    with pytest.raises(SceneError, match=r"vertex at .*e\+19.* m, limit 1e\+150"):
        _ = MeshObject(mesh, position=PLACE).surface
