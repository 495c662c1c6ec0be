"""The library of wall materials: derived values follow from their sources, names are read."""

from __future__ import annotations

import math
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.scene import Scene, material_library, named_material
from nlosoptics.scene.file.addresses import value_at
from nlosoptics.scene.file.scene_file import save_scene

FILE = tomllib.loads(files("nlosoptics.scene.parts").joinpath("library.toml").read_text())
VALUES = [
    pytest.param(lobe, key, given, id=f"{entry['name']}-{key}")
    for entry in FILE["material"]
    for lobe in entry["lobe"]
    for key, given in lobe.items()
    if isinstance(given, dict)
]
#: Digits of the library's values.
ROUNDED = 2e-3


def half_width(lobe: dict) -> float:
    """Tilt at which the density of GGX facet normals falls to half, found by bisection."""
    alpha = math.sqrt(2.0) * lobe["slope_rms"]["value"]

    def density(t: float) -> float:
        return (alpha / math.cos(t) ** 2 / (alpha**2 + math.tan(t) ** 2)) ** 2

    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if density(middle) > density(0.0) / 2 else (low, middle)
    return low


@pytest.mark.parametrize(("lobe", "key", "given"), VALUES)
def test_value_follows_from_its_source(lobe: dict, key: str, given: dict) -> None:
    """The value lies in its spread, and is what its constants give."""
    assert 0.0 < given["from"] <= given["value"] <= given["to"] <= 1.0
    assert given["source"] in FILE["source"]
    assert given["basis"] in ("published", "fitted", "computed", "estimate")
    assert (given["basis"] == "fitted") == ("abc" in given)
    assert (given["basis"] == "computed") == ("index" in given)
    if "axes" in given:
        assert given["value"] == approx(math.sqrt(math.prod(given["axes"])), rel=ROUNDED)
        assert given["from"] <= min(given["axes"]) < max(given["axes"]) <= given["to"]
    if "index" in given:
        n, k = given["index"]
        one = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
        # light between the two faces of a pane is reflected again and again
        every = sum(one * (1 - one) ** 2 * one ** (2 * i) for i in range(50)) + one
        wanted = every if given.get("faces") == 2 else one
        assert given["value"] == approx(wanted, rel=ROUNDED)
    if "abc" in given:
        b, c = given["abc"]
        width = half_width(lobe)
        assert (1 + b * (1 - math.cos(width))) ** -c == approx(0.5, rel=2 * ROUNDED)


@pytest.mark.parametrize("name", material_library())
def test_material_reflects_what_its_values_say(name: str) -> None:
    entry = material_library()[name]
    powers = [v for v in entry.values if v.key in ("albedo", "reflectance")]
    # every draw from the spread is a material
    assert sum(v.high for v in powers) <= 1.0
    table = entry.material.lobe_table()
    assert table[:, 1].tolist() == [v.value for v in powers]
    assert entry.name in str(entry)
    assert all(v.source in str(entry) for v in entry.values)
    # the unbounded variants of Ward grow without limit only near grazing incidence
    assert np.all(entry.material.albedo(np.radians([0.0, 45.0, 75.0])) <= 1.0)


def test_name_and_single_values_go_together(examples, tmp_path) -> None:
    """A value below a name replaces the library's, and a saved scene holds the lobes."""
    path = examples / "scenes" / "letter_flat.toml"
    changes = {"wall.material": "Whiteboard", "wall.material[1].slope_rms": "1 mrad"}
    scene = Scene.load(path, changes)
    assert scene.wall_material.mirror_lobes[0].slope_rms == 1e-3
    assert scene.wall_material.diffuse == named_material("whiteboard").diffuse
    save_scene(scene, tmp_path / "again.toml")
    assert Scene.load(tmp_path / "again.toml") == scene
    tables = {"wall": {"material": "painted wall"}}
    assert value_at(tables, "wall.material[1].alpha") == 0.0998
    assert value_at(tables, "wall.material") == "painted wall"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"wall.material": "whitebord"}, 'wall.material = "whitebord" is not in .*"whiteboard"'),
        (
            {"wall.material": "whitebord", "wall.material[0].albedo": 0.5},
            "wall.material = 'whitebord' is not in .*\"whiteboard\"",
        ),
    ],
)
def test_unknown_name_is_one_line_with_near_names(changes: dict, told: str, examples) -> None:
    with pytest.raises(SceneError, match=told) as error:
        Scene.load(examples / "scenes" / "letter_flat.toml", changes)
    assert "\n" not in str(error.value)
