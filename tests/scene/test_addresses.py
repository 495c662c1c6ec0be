"""Scenes with changed values: addresses, values as in files, and messages."""

from __future__ import annotations

import pytest

from nlosoptics import Scene
from nlosoptics.errors import SceneError
from nlosoptics.scene import ConcaveWall, SumMaterial
from nlosoptics.scene.file.addresses import changed, parsed

FLAT = "examples/scenes/letter_flat.toml"


def test_values_are_read_like_those_of_a_file(monkeypatch, request):
    monkeypatch.chdir(request.config.rootpath)
    texts = ["wall.shape=concave_sphere", "wall.radius = 2.5m", "camera.aim[1] = 3 cm"]
    texts += ["camera.binning=4", 'laser.power="20 mW"', "hidden.roll=-5deg"]
    before, scene = Scene.load(FLAT), Scene.load(FLAT, parsed(texts))
    assert isinstance(scene.wall, ConcaveWall)
    assert scene.wall.radius == 2.5
    assert scene.laser.power == 0.02
    assert scene.camera.binning == 4
    assert scene.camera.aim[1] == 0.03
    assert scene.camera.aim[0] == before.camera.aim[0]
    assert scene.hidden.roll == pytest.approx(-0.0872664625997, rel=1e-12)
    assert scene.hidden.size == before.hidden.size


def test_tables_and_lobes_are_added_and_counted(monkeypatch, request):
    monkeypatch.chdir(request.config.rootpath)
    gloss = {"lobe": "specular", "reflectance": 0.1, "slope_rms": "0 rad"}
    lobes = [{"lobe": "lambert", "albedo": 0.5}, gloss]
    rough = {"wall.roughness.model": "facets", "wall.roughness.cell": "20 um"}
    rough |= {"wall.roughness.slope_rms": "1 mrad", "wall.roughness.seed": 3}
    scene = Scene.load(FLAT, {"wall.material": lobes, "wall.material[1].reflectance": 0.2, **rough})
    assert isinstance(scene.wall_material, SumMaterial)
    assert scene.wall_material.parts[1].reflectance == 0.2
    assert scene.wall_roughness.heights.seed == 3
    assert gloss["reflectance"] == 0.1


def test_the_file_and_the_given_tables_stay_as_they_are():
    raw = {"camera": {"position": ["1 m", "0 m", "2 m"], "f_number": 4.0}}
    found = changed(raw, {"camera.position[2]": "3 m", "camera.stop_diameter": "5 mm"})
    assert raw == {"camera": {"position": ["1 m", "0 m", "2 m"], "f_number": 4.0}}
    assert found == {"camera": {"position": ["1 m", "0 m", "3 m"], "stop_diameter": "5 mm"}}


def test_one_way_to_say_a_thing_replaces_the_other(monkeypatch, request):
    monkeypatch.chdir(request.config.rootpath)
    polar = Scene.load(FLAT, {"laser.distance": "2 m", "laser.incidence": "0 deg"})
    assert polar.laser.position == (0.64, 0.0, 2.0)  # above the aim of the file
    placed = Scene.load(FLAT, {"laser.position": ["0 m", "1 m", "2 m"]})
    assert placed.laser.position == (0.0, 1.0, 2.0)
    fast = Scene.load(FLAT, {"camera.f_number": 2.0, "camera.focal_length": "50 mm"})
    assert fast.camera.stop_diameter == 0.025


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wall.radus": "2 m"}, r"letter_flat.toml: wall.radus = \"2 m\" is an unknown key"),
        ({"radius": "2 m"}, "'radius' is not the address of a value"),
        ({"camera.position[3]": "2 m"}, r"camera.position\[3\]: camera.position has 3 elements"),
        ({"laser.power.x": "2 m"}, "laser.power.x: laser.power is one value"),
        ({"occluder[0].scale": 2.0}, r"occluder is not a list"),
    ],
)
def test_wrong_changes_name_address_and_remedy(changes, words, monkeypatch, request):
    monkeypatch.chdir(request.config.rootpath)
    with pytest.raises(SceneError, match=words):
        Scene.load(FLAT, changes)


@pytest.mark.parametrize(
    ("texts", "words"),
    [(["wall.radius"], "has no value"), (["a.b=1", "a.b=2"], "a.b is given twice")],
)
def test_texts_need_one_value_each(texts, words):
    with pytest.raises(SceneError, match=words):
        parsed(texts)
