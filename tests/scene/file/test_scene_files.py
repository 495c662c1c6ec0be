"""Scene files: what they mean, that they round-trip exactly, and the examples."""

from __future__ import annotations

import json
import math
import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics import limits, plan, raytrace
from nlosoptics.errors import SceneError
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FacetWall,
    FlatWall,
    GaussianWall,
    HeightMapWall,
    Lambert,
    MeshObject,
    Occluder,
    OrenNayar,
    PlanarObject,
    Scene,
    Spectrum,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    TransientScan,
    WallRoughness,
    Ward,
    WavyWall,
)
from nlosoptics.scene.file.scene_file import scene_files, scene_schema

FOLDER = Path(__file__).parents[3] / "examples" / "scenes"
SCENES = sorted(path for path in FOLDER.glob("*.toml") if not path.name.startswith("camera"))
NAMES = [path.stem for path in SCENES]


@pytest.fixture
def flat(examples: Path) -> Scene:
    return Scene.load(examples / "scenes" / "letter_flat.toml")


def saved(scene: Scene, folder: Path) -> Scene:
    """What a scene is after saving and loading, twice to catch any drift."""
    for name in ("first.toml", "second.toml"):
        scene.save(folder / name)
        scene = Scene.load(folder / name)
    assert (folder / "first.toml").read_text() == (folder / "second.toml").read_text()
    return scene


LEVELS = np.random.default_rng(1).permutation(65536).reshape(256, 256)


@pytest.mark.parametrize(
    ("picture", "suffix"),
    [
        (LEVELS[:5, :7].astype(np.uint8), ".png"),
        (LEVELS[:40].astype(np.uint16), ".png"),
        (np.eye(6, dtype=bool), ".png"),
        (LEVELS / 65537, ".npy"),
        (np.array([[0.0, -0.0], [1.0, 0.5]]), ".npy"),
    ],
)
def test_a_picture_in_memory_is_written_beside_the_scene(
    flat: Scene, tmp_path: Path, picture: np.ndarray, suffix: str
) -> None:
    """Every bit of it, in the smallest file that holds them."""
    scene = replace(flat, hidden=replace(flat.hidden, image=picture))
    again = saved(scene, tmp_path)
    assert again == scene
    assert again.hidden.reflectance.tobytes() == scene.hidden.reflectance.tobytes()
    assert again.hidden.image == tmp_path / f"first_hidden_image{suffix}"
    assert {p.name for p in tmp_path.iterdir()} == {
        "first.toml",
        "second.toml",
        f"first_hidden_image{suffix}",
    }
    assert replace(again, hidden=replace(again.hidden, image=1 - scene.hidden.image)) != scene


def test_meshes_in_memory_are_written_beside_the_scene(flat: Scene, tmp_path: Path) -> None:
    """Coordinates of every size, vertices in their order, and one that no triangle has."""
    rng = np.random.default_rng(2)
    corners = rng.random((60, 3)) * 10.0 ** rng.integers(-12, 2, (60, 3)) + (0, 0, 1)
    mesh = trimesh.Trimesh(corners, rng.integers(0, 59, (90, 3)), process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    hidden = MeshObject(mesh, position=(0.3, 0.0, 1.0))
    scene = replace(flat, hidden=hidden, occluders=(Occluder(mesh), mesh))
    again = saved(scene, tmp_path)
    for one, other in (
        (again.hidden.surface, hidden.surface),
        (again.occluding_mesh, scene.occluding_mesh),
    ):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)
    names = {"first_hidden_mesh.ply", "first_occluder_0_mesh.ply", "first_occluder_1_mesh.ply"}
    assert {p.name for p in tmp_path.iterdir()} - {"first.toml", "second.toml"} == names


@pytest.mark.parametrize("path", SCENES, ids=NAMES)
def test_examples_round_trip_exactly(path: Path, tmp_path: Path) -> None:
    scene = Scene.load(path)
    assert saved(scene, tmp_path) == scene


WALLS = [
    FlatWall(),
    FlatWall(size=(1.1, 0.7)),
    ConcaveWall(4.9999999999999991, size=1.0),
    ConcaveWall(3.0, shape="cylinder", axis="x"),
    ConvexWall(1 / 3, size=(0.1, 0.2)),
    ConvexWall(7.0, shape="cylinder", axis="y"),
    WavyWall(-1e-5 / 3, 0.1, 1e-17, size=0.5, direction=-0.1),
    SumWall(WavyWall(1e-4, 0.3), SumWall(FlatWall(size=1.0), ConcaveWall(5.0)), size=(1.0, 2.0)),
]


@pytest.mark.parametrize("wall", WALLS, ids=lambda wall: type(wall).__name__)
def test_every_wall_round_trips_exactly(wall, flat: Scene, tmp_path: Path) -> None:
    scene = replace(flat, wall=wall)
    assert saved(scene, tmp_path) == scene


MATERIALS = [
    Lambert(0.1 + 0.2),
    OrenNayar(0.8, 0.3, model="full", normalised=True),
    SpecularMicrofacet(0.05, 1e-3, distribution="ggx", index=1.5 + 0.1j),
    Ward(0.3, 0.4, variant="bounded"),
    Lambert(Spectrum((450e-9, 650e-9), (0.1, 0.4))),
    SumMaterial(Lambert(0.7)),
    SumMaterial(Lambert(0.5), SumMaterial(OrenNayar(0.1, 0.2), SpecularMicrofacet(0.05, 0.0))),
]


@pytest.mark.parametrize("material", MATERIALS, ids=range(len(MATERIALS)))
def test_every_material_round_trips_exactly(material, flat: Scene, tmp_path: Path) -> None:
    hidden = replace(flat.hidden, material=material)
    scene = replace(flat, wall_material=material, hidden=hidden)
    assert saved(scene, tmp_path) == scene


ROUGHNESSES = [
    WallRoughness(FacetWall(1e-3 / 3, 2e-3 / 7, seed=2**64 - 1)),
    WallRoughness(GaussianWall(1e-6 / 3, 1e-3 / 7, seed=2**33 + 1), "mean"),
    WallRoughness(HeightMapWall(1e-6 * np.random.default_rng(0).random((90, 120)), 1 / 60)),
    WallRoughness(
        HeightMapWall.random(height_rms=1e-6, correlation_length=0.1, size=(1.4, 1.0), pitch=0.02),
        "mean",
    ),
]


@pytest.mark.parametrize("roughness", ROUGHNESSES, ids=range(len(ROUGHNESSES)))
def test_every_roughness_round_trips_exactly(roughness, flat: Scene, tmp_path: Path) -> None:
    scene = replace(flat, wall_roughness=roughness)
    assert saved(scene, tmp_path) == scene
    (tmp_path / "carried").mkdir()
    for name, content in scene_files(scene).items():
        (tmp_path / "carried" / name).write_bytes(content)
    assert Scene.load(tmp_path / "carried" / "scene.toml").wall_roughness == roughness
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert replace(scene, wall_roughness=None) == flat


def test_roughness_takes_the_slope_of_the_lobe(tmp_path: Path) -> None:
    path = FOLDER / "letter_rough.toml"
    scene = Scene.load(path)
    assert scene.wall_roughness == WallRoughness(FacetWall(1e-3, 2e-3, seed=1))
    text = path.read_text().replace("../", f"{FOLDER.parent}/")
    text = text.replace('file = "', f'file = "{FOLDER}/')
    keys = 'model = "gaussian"\ncorrelation_length = "0.5 mm"\nrealisation = "mean"'
    old = text[text.index('model = "facets"') : text.index("seed = 1")]
    for more, slope in (("", 2e-3), ('\nslope_rms = "2 mrad"', 2e-3), ('\nheight_rms = "0 m"', 0)):
        changed = text.replace(old, keys + more + "\n")
        if not slope:
            changed = changed.replace('slope_rms = "2 mrad" ', 'slope_rms = "0 rad" ')
        (tmp_path / "gaussian.toml").write_text(changed)
        roughness = Scene.load(tmp_path / "gaussian.toml").wall_roughness
        assert roughness.slope_rms == approx(slope, rel=1e-15)
        assert roughness.realisation == "mean"
        assert (roughness.heights.correlation_length, roughness.heights.seed) == (5e-4, 1)


def test_random_walls_keep_their_parameters(flat: Scene, tmp_path: Path) -> None:
    third = 1e-3 / 3
    for wall in (
        HeightMapWall.random(height_rms=third, correlation_length=0.1, size=1.5, pitch=0.04),
        HeightMapWall.random(
            height_rms=1e-6,
            correlation_length=0.2 / 3,
            size=(1.1, 1.3),
            pitch=0.03,
            autocorrelation="exponential",
            seed=2**64 - 1,
        ),
    ):
        scene = replace(flat, wall=wall)
        again = saved(scene, tmp_path)
        assert again == scene
        assert again.wall.drawn == wall.drawn
        summed = replace(flat, wall=SumWall(wall, ConcaveWall(5.0)))
        assert saved(summed, tmp_path) == summed


def test_a_cut_random_wall_is_no_longer_the_one_drawn(flat: Scene, tmp_path: Path) -> None:
    drawn = HeightMapWall.random(height_rms=1e-6, correlation_length=0.1, size=1.5, pitch=0.04)
    cut = replace(flat, wall=replace(drawn, size=1.4))
    assert saved(cut, tmp_path) == cut
    assert (tmp_path / "first_wall_heights.npy").is_file()


def test_occluders_round_trip_exactly(flat: Scene, examples: Path, tmp_path: Path) -> None:
    mesh = (examples / "walls" / "concave_5m.obj").resolve()
    posed = Occluder(mesh, scale=0.1, position=(1 / 3, -0.2, 0.7), yaw=0.1, pitch=-1 / 3, roll=3.0)
    scene = replace(flat, occluders=[posed, Occluder(mesh)])
    assert saved(scene, tmp_path) == scene
    assert scene != flat
    text = (tmp_path / "first.toml").read_text()
    assert text.count("[[occluder]]") == 2
    again = Scene.load(tmp_path / "first.toml")
    np.testing.assert_array_equal(again.occluding_mesh.vertices, scene.occluding_mesh.vertices)
    assert "[occluder" not in text.replace("[[occluder]]", "")  # black, as by default


def test_materials_of_occluders_round_trip(flat: Scene, tmp_path: Path) -> None:
    mesh = trimesh.creation.box((0.1, 0.2, 0.3))
    lobes = SumMaterial(Lambert(1 / 3), SpecularMicrofacet(0.1, 0.2))
    occluders = [
        Occluder(mesh, position=(0, 0, z), material=material)
        for z, material in ((0.5, Lambert(0.3)), (1.0, lobes), (1.5, Lambert(0.0)))
    ]
    scene = replace(flat, occluders=tuple(occluders))
    again = saved(scene, tmp_path)
    assert [o.material for o in again.occluders] == [o.material for o in occluders]
    assert again.room_materials == (Lambert(0.3), lobes)
    other = replace(occluders[0], material=Lambert(0.4))
    assert replace(scene, occluders=(other, *occluders[1:])) != scene


def test_every_float_of_laser_and_camera_round_trips(flat: Scene, tmp_path: Path) -> None:
    third = 1 / 3  # needs all its 17 digits
    laser = replace(
        flat.laser,
        wavelength=632.8e-9 * third,
        power=third,
        beam_diameter=third,
        position=(third, -third, 2 * third),
        aim=(-third, third, 0.0),
        independent_patterns=3,
    )
    camera = replace(
        flat.camera,
        position=(third, third, third),
        aim=(-third, third, 0.0),
        focal_length=third / 10,
        stop_diameter=third / 100,
        pixel_pitch=third * 1e-5,
        pixels=(640, 480),
        binning=2,
        exposure=third,
        quantum_efficiency=third,
        transmission=third,
        full_well=1e5 * third,
        read_noise=third,
        dark_current=third,
        bit_depth=12,
        focus_distance=third,
        glare_fraction=third,
        field_stop=None,
    )
    scene = replace(flat, laser=laser, camera=camera)
    assert saved(scene, tmp_path) == scene


def test_paths_are_relative_to_the_file(flat: Scene, tmp_path: Path) -> None:
    """A scene and its picture may move together."""
    (tmp_path / "here").mkdir()
    np.save(tmp_path / "here" / "letter.npy", np.eye(8))
    hidden = PlanarObject(tmp_path / "here" / "letter.npy", 0.3, position=(0.5, 0.0, 1.0))
    replace(flat, hidden=hidden).save(tmp_path / "here" / "scene.toml")
    (tmp_path / "here").rename(tmp_path / "there")
    moved = Scene.load(tmp_path / "there" / "scene.toml")
    assert np.array_equal(moved.hidden.reflectance, np.eye(8))


def test_a_folder_holds_all_of_a_scene(flat: Scene, tmp_path: Path) -> None:
    """Whatever its files were called: two of one name, and one with the name of a run's own."""
    (tmp_path / "other").mkdir()
    for height, folder in ((0.1, tmp_path), (0.2, tmp_path / "other")):
        trimesh.creation.box((0.1, 0.1, height)).export(folder / "image.ply")
    rng = np.random.default_rng(0)
    np.save(tmp_path / "scene.npy", rng.random((8, 8)))
    np.save(tmp_path / "heights.npy", 1e-6 * rng.random((16, 16)))
    scene = replace(
        flat,
        wall=SumWall(FlatWall(), HeightMapWall(tmp_path / "heights.npy", pitch=0.1)),
        hidden=PlanarObject(tmp_path / "scene.npy", 0.3, position=(0.5, 0.0, 1.0)),
        occluders=tuple(
            Occluder(folder / "image.ply", position=(0.0, 0.0, 1.0))
            for folder in (tmp_path, tmp_path / "other")
        ),
    )
    (tmp_path / "carried").mkdir()
    for name, content in scene_files(scene).items():
        (tmp_path / "carried" / name).write_bytes(content)
    moved = Scene.load(tmp_path / "carried" / "scene.toml")
    assert scene_files(moved) == scene_files(scene)
    assert np.array_equal(moved.hidden.reflectance, scene.hidden.reflectance)
    x, y = np.array([0.01, 0.2]), np.array([0.0, -0.3])
    assert np.array_equal(moved.wall.height(x, y), scene.wall.height(x, y))
    assert [np.ptp(o.surface.bounds[:, 2]) for o in moved.occluders] == pytest.approx([0.1, 0.2])
    (tmp_path / "other" / "image.ply").unlink()
    assert scene_files(moved) == scene_files(scene)
    gone = Occluder(tmp_path / "other" / "image.ply", position=(0.0, 0.0, 1.0))
    with pytest.raises(SceneError, match=r"occluder\[0\].mesh: .* cannot be read .*put it back"):
        scene_files(replace(scene, occluders=(gone,)))


def test_laser_by_distance_and_incidence(flat: Scene) -> None:
    start = np.subtract(flat.laser.position, flat.laser.aim)
    # 1e-15: rounding of sine and cosine
    assert np.linalg.norm(start) == approx(1.2, rel=1e-15)
    assert math.acos(start[2] / 1.2) == approx(math.radians(15), rel=1e-14)


def test_field_of_view_gives_the_focal_length(flat: Scene) -> None:
    """Across the side: f = (36.864 mm / 2) / tan 20 deg."""
    expected = 18.432e-3 / math.tan(math.radians(20))
    assert flat.camera.focal_length == approx(expected, rel=1e-15)
    assert flat.camera.focal_length == approx(50.6e-3, abs=0.05e-3)  # as printed, three digits


def camera_of(tmp_path: Path, *lines: str):
    """Camera of a scene whose table is the given lines."""
    text = (FOLDER / "letter_flat.toml").read_text()
    text = text.replace('file = "camera_wu2024.toml"', "\n".join(lines))
    text = text.replace("../objects", str(FOLDER.parent / "objects"))
    (tmp_path / "scene.toml").write_text(text)
    return Scene.load(tmp_path / "scene.toml").camera


PLACE = ('position = ["0 m", "0 m", "1 m"]', 'aim = ["0.1 m", "0 m", "0 m"]')


def test_f_number_gives_the_stop(tmp_path: Path) -> None:
    camera = camera_of(tmp_path, *PLACE, 'focal_length = "50 mm"', "f_number = 2")
    assert camera.stop_diameter == 25e-3


SCAN = {"side": 2.0, "count": 8, "delta_t": 0.01, "n_bins": 20}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"side": -1.0}, "transient.side = -1 m is out of range"),
        ({"n_bins": 1.5}, "transient.n_bins = 1.5 is not a whole number"),
        ({"max_bounces": 2}, "transient.max_bounces = 2"),
        ({"near": 1.0, "far": 0.5, "step": 0.1}, "transient.far = 0.5 m is out of range"),
    ],
)
def test_bad_transient_scans(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        TransientScan(**{**SCAN, **changes})


def test_a_matt_wall_photographed_without_laser_round_trips(tmp_path: Path) -> None:
    """A screen of unknown picture in a lit room; what computes laser light says that it cannot."""
    text = (FOLDER / "letter_flat.toml").read_text()
    text = text[: text.index("[laser]")] + text[text.index("[wall]") :]
    text = text.replace('"camera_wu2024.toml"', f'"{(FOLDER / "camera_wu2024.toml").as_posix()}"')
    screen = 'luminous = "2 mW/(cm^2 sr)"\nluminous_lobe = [1.0, 2.0]'
    text = text.replace('image = "../objects/F.png"', screen)
    (tmp_path / "room.toml").write_text(text + '\n[ambient]\nirradiance = "0.5 W/m^2"\n')
    room = Scene.load(tmp_path / "room.toml")
    assert saved(room, tmp_path) == room
    assert (room.hidden.luminous, room.hidden.luminous_lobe) == (approx(20.0), (1.0, 2.0))
    assert (room.laser.power, room.ambient_irradiance) == (0.0, 0.5)
    assert room.hidden.size == (0.7, 0.7)
    assert room.hidden.reflectance.min() == 1.0
    assert "[laser]" not in (tmp_path / "first.toml").read_text()
    dark = replace(room, hidden=replace(room.hidden, luminous=None))
    for scene, words in (
        (room, r"hidden.luminous = 20 W/\(m\^2 sr\)"),
        (dark, "ambient.irradiance = 0.5 W/m"),
        (replace(dark, ambient_irradiance=0.0), "laser.power = 0 W"),
    ):
        for computed in (plan, limits.feasibility, raytrace.trace):
            with pytest.raises(SceneError, match=f"{words}.*WallTransport"):
                computed(scene)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("hidden.luminous", "2 W/m^2", "is an irradiance, must be a radiance"),
        ("hidden.luminous", "-1 W/(m^2 sr)", "hidden.luminous = -1 W/.m.2 sr. is out of range"),
        ("hidden.luminous_lobe", [1.0, -2.0], r"hidden.luminous_lobe\[1\] = -2 is out of range"),
        ("ambient.irradiance", "-1 W/m^2", "ambient.irradiance = -1 W/m.2 is out of range"),
    ],
)
def test_bad_light(key: str, value: Any, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Scene.load(FOLDER / "letter_flat.toml", {key: value})


def test_schema_is_current() -> None:
    """The shipped schema is the models'; else write scene_schema() over it."""
    shipped = json.loads((FOLDER / "scene.schema.json").read_text())
    assert shipped == scene_schema()


def test_schema_knows_every_key_that_is_written(flat: Scene) -> None:
    """Keys of a saved scene are in the schema, with a note for whoever edits."""
    tables = scene_schema()["$defs"]
    for section, table in (("laser", "Laser"), ("camera", "Camera")):
        text = scene_files(flat)["scene.toml"].decode().split(f"[{section}]\n")[1].split("\n\n")[0]
        for key in re.findall(r"^(\w+) =", text, re.MULTILINE):
            assert tables[table]["properties"][key]["description"]


def test_a_scene_whose_picture_file_is_gone_or_changed_saves_its_picture(tmp_path) -> None:
    """A pickled scene carries the bytes of its picture; a saved one loads to its numbers."""
    picture = tmp_path / "picture.png"
    original = (FOLDER.parent / "objects" / "F.png").read_bytes()
    picture.write_bytes(original)
    scene = Scene.load(FOLDER / "letter_flat.toml")
    scene = replace(scene, hidden=replace(scene.hidden, image=picture))
    travelled = pickle.loads(pickle.dumps(scene))
    for name, spoil in (("gone", picture.unlink), ("changed", lambda: picture.write_bytes(b"x"))):
        spoil()
        travelled.save(tmp_path / f"{name}.toml")
        assert (tmp_path / f"{name}_hidden_image.png").read_bytes() == original
        found = Scene.load(tmp_path / f"{name}.toml").hidden
        assert np.array_equal(found.reflectance, scene.hidden.reflectance)
