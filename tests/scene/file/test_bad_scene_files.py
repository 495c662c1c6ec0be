"""A mistake in a scene file is one line that names file, key, value, limit and remedy."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

import pytest
import trimesh

from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.scene import Scene


@pytest.fixture
def folder(examples: Path, tmp_path: Path) -> Path:
    """A writable copy of the example scenes and what they name."""
    for part in ("scenes", "objects", "walls"):
        shutil.copytree(examples / part, tmp_path / part)
    return tmp_path / "scenes"


def refusal(path: Path, changes: dict[str, Any] | None = None) -> str:
    """What loading says, without the name of the file, in one line."""
    with pytest.raises(SceneError) as caught:
        Scene.load(path, changes)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{path}: ")
    return line.removeprefix(f"{path}: ")


FACETS = {"model": "facets", "cell": "1 mm"}
LOBE = {"lobe": "lambert", "albedo": 0.5}
#: Changes of the flat scene, and what the message must hold.
WRONG: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    # quantities
    ({"laser.wavelength": "40 ms"}, ('"40 ms" is a time, must be a length', '"1.2 m"')),
    ({"laser.beam_diameter": 0.003}, ("laser.beam_diameter = 0.003 has no unit", '"1.2 m"')),
    ({"laser.distance": "1.2 furlong"}, ("unknown unit 'furlong', must be a length",)),
    ({"laser.distance": "nan m"}, ("is not finite",)),
    ({"laser.aim": ["0.64 m", "0 m"]}, ("laser.aim", "has 2 components, must have 3")),
    ({"laser.aim": [0.64, 0, 0]}, ("laser.aim", "has no unit, must be a length")),
    # keys and tables
    ({"laser.wavelenght": "1 um"}, ("laser.wavelenght", "unknown key; did you mean wavelength?")),
    ({"wall.nothing": 1}, ("wall.nothing", "the keys here are shape, size, material, roughness")),
    ({"wall.material[0].albeto": 0.5}, ("wall.material[0].albeto", "did you mean albedo?")),
    ({"wall.shape": "flta"}, ('wall.shape = "flta" is unknown', 'did you mean "flat"?')),
    ({"wall.shape": "concave_sphere"}, ("wall.radius is missing; add it",)),
    ({"wall.material": {"albedo": 0.5}}, ("wall.material.lobe is missing; add one of lambert",)),
    ({"wall.material": {"lobe": "phong"}}, ('wall.material.lobe = "phong" is unknown',)),
    ({"hidden.mesh": "a.stl"}, ("hidden.mesh and hidden.image are both given", "remove the other")),
    ({"wall.roughness": "facets"}, ("is not a table; write [wall.roughness]",)),
    ({"camera.binning": "8"}, ("camera.binning", "it should be a valid integer")),
    # limits
    ({"laser.wavelength": "1 m"}, ("laser.wavelength = 1 m", "was it given in nanometres?")),
    ({"laser.incidence": "91 deg"}, ("laser.incidence", "from 0 deg to 89 deg")),
    ({"laser.azimuth": "0 deg", "wall.material[0].albedo": 1.2}, ("albedo = 1.2", "0 to 1")),
    ({"wall.material[0].albedo": 0.99}, ("albedos add up to", "limit 1")),
    ({"hidden.position": ["0 m", "0 m", "-1 m"]}, ("hidden.position has z = -1 m",)),
    ({"camera.field_of_view": "180 deg"}, ("camera.field_of_view",)),
    ({"camera.binning": 7}, ("camera.binning = 7 does not divide",)),
    ({"camera.file": "none.toml"}, ("there is no file", "with a [camera] table")),
    # roughness and summands
    (
        {"wall.roughness": FACETS | {"slope_rms": "1.1 rad"}},
        ("wall.roughness.slope_rms = 1.1 rad",),
    ),
    ({"wall.roughness": FACETS}, ("slope_rms is missing, and no mirror-like lobe",)),
    (
        {
            "wall.roughness": {"model": "gaussian", "correlation_length": "1 mm"}
            | {"height_rms": "1 um", "slope_rms": "1 mrad"}
        },
        ("height_rms and slope_rms are both given",),
    ),
    (
        {"wall.shape": "sum", "wall.terms": [{"shape": "flat", "material": LOBE}]},
        ("wall.terms[0].material belongs to a summand", "move it to wall.material"),
    ),
    (
        {
            "wall.shape": "sum",
            "wall.terms": [{"shape": "wavy", "amplitude": "1 mm", "period": "-1 m"}],
        },
        ("wall.terms[0].period = -1 m",),
    ),
    # occluders
    ({"occluder": {"mesh": "a.stl"}}, ("occluder = {...} is one table; write [[occluder]]",)),
]


@pytest.mark.parametrize(("changes", "parts"), WRONG, ids=lambda value: "-".join(value)[:40])
def test_wrong_values(
    changes: dict[str, Any], parts: tuple[str, ...], examples: Path, tmp_path: Path
) -> None:
    line = (examples / "scenes" / "letter_flat.toml").resolve()
    text = line.read_text()
    if "occluder" in changes:
        path = tmp_path / "scene.toml"
        path.write_text(f'{text}\n[occluder]\nmesh = "a.stl"\n')
        told = refusal(path)
    else:
        told = refusal(line, changes)
    for part in parts:
        assert part in told


def test_missing_table_and_file(folder: Path) -> None:
    path = folder / "bare.toml"
    path.write_text("")
    assert refusal(path) == "the table [wall] is missing; add it (and 2 more)"
    path.write_bytes(b"[laser]\npower = '\xff\xfe'\n")
    assert "byte 17 is not UTF-8 text; give a TOML" in refusal(path)
    assert "the scene file is missing; give the path" in refusal(folder / "none.toml")
    assert "the scene file is a folder; give the path" in refusal(folder)


def test_laser_and_camera_given_twice_or_not_at_all(folder: Path) -> None:
    path = folder / "letter_flat.toml"
    text = path.read_text()
    twice = '[laser]\nposition = ["1 m", "0 m", "1 m"]'
    path.write_text(text.replace("[laser]", twice))
    assert "laser.position are both given" in refusal(path)
    path.write_text(text.replace("[camera]", '[camera]\nf_number = 2\nstop_diameter = "5 mm"'))
    assert "camera.f_number and camera.stop_diameter are both given" in refusal(path)
    path.write_text(text.replace('incidence = "15 deg"', ""))
    assert "laser.position is missing; give position = " in refusal(path)


def test_camera_files(folder: Path) -> None:
    path, scene = folder / "camera_wu2024.toml", folder / "letter_flat.toml"
    text = path.read_text()
    path.write_text(text.replace("binning", "bining"))
    with pytest.raises(SceneError, match="camera.bining = 8 is an unknown key; did you mean"):
        Scene.load(scene)
    path.write_text('[camera]\nfile = "camera_wu2024.toml"\n')
    with pytest.raises(SceneError, match=r"camera\.file = 'camera_wu2024\.toml' leads back"):
        Scene.load(scene)


@pytest.mark.parametrize("cut", [0, 300])
def test_image_that_is_no_image(folder: Path, cut: int) -> None:
    picture = folder.parent / "objects" / "F.png"
    picture.write_bytes(picture.read_bytes()[:cut])
    line = refusal(folder / "letter_flat.toml")
    assert "hidden.image" in line
    assert "F.png is no readable image" in line


def test_object_mesh_behind_the_wall(folder: Path) -> None:
    trimesh.creation.box((1, 1, 4)).export(folder / "box.stl")
    path = folder / "letter_flat.toml"
    text = path.read_text().replace('image = "../objects/F.png"', 'mesh = "box.stl"')
    path.write_text(text.replace('size = "0.7 m"', ""))
    line = refusal(path)
    assert "hidden.mesh reaches z = -1 m, behind the wall" in line


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n"
)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.obj", None, "there is no file"),
        ("a.obj", b"\x00\x01 nothing", "holds no triangles"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has no area"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN or infinite"),
        ("a.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "vertices without three coordinates"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "is not a mesh"),
        ("a.obj", b"v 1 1 0\nv 2 1 0\nv 1 2 0\nf 1 2 3\n", "must surround the origin"),
        ("a.ply", f"{PLY}3 0 1 7\n".encode(), "between vertices 0 and 7, limit 0 to 2"),
    ],
)
def test_bad_wall_mesh(name, content, words: str, examples: Path, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    scene = examples / "scenes" / "letter_mesh.toml"
    line = refusal(scene, {"wall.mesh": str(tmp_path / name)})
    assert "wall.mesh" in line
    assert words in line


def test_random_wall_on_a_coarse_grid_names_the_file_too(examples: Path) -> None:
    path = examples / "scenes" / "letter_flat.toml"
    random = {"shape": "random", "height_rms": "1 mm", "correlation_length": "9 cm"}
    changes = {f"wall.{key}": value for key, value in random.items()}
    changes |= {"wall.size": "1.5 m", "wall.pitch": "50 mm"}
    with pytest.raises(SamplingError, match="wall.correlation_length = 0.09 m.*at most 0.045 m"):
        Scene.load(path, changes)


def test_saving_nowhere(examples: Path, tmp_path: Path) -> None:
    scene = Scene.load(examples / "scenes" / "letter_flat.toml")
    with pytest.raises(SceneError, match=r"there is no folder .*none; make it first"):
        scene.save(tmp_path / "none" / "scene.toml")
    with pytest.raises(SceneError, match=r"is a folder; name a file"):
        scene.save(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        (f"[{'.'.join('a' * 100_000)}]", "limit 4,000,000 and 20,000 in a line"),
    ],
)
def test_texts_that_exhaust_a_parser_are_refused_at_once(text, words, tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(text)
    began = time.process_time()
    assert words in refusal(file)
    assert time.process_time() - began < 2.0  # hours without the limits


@pytest.mark.parametrize("name", ["a\0b.png", "x" * 20_000])
@pytest.mark.parametrize("key", ["hidden.image", "camera.file"])
def test_texts_that_no_system_takes_as_a_path_are_told(name, key, examples):
    with pytest.raises(SceneError, match="cannot be the path of a file") as caught:
        Scene.load(examples / "scenes" / "letter_flat.toml", {key: name})
    assert len(str(caught.value)) < 400
