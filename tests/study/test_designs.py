"""Points of a design: their values, their names, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.scene import material_library, named_material
from nlosoptics.study import Study

HERE = Path(__file__).parent
SCENE = str(HERE.parents[1] / "examples" / "scenes" / "letter_concave.toml")


def made(**tables) -> Study:
    return Study.from_tables({"scene": SCENE, "figures": ["strehl"], **tables}, HERE)


def drawn(given, method="sobol", count=64, **more) -> np.ndarray:
    """Radii of the wall that a distribution gives, m."""
    draws = {"count": count, "method": method, "of": {"wall.radius": given}}
    study = made(draws=draws, **more)
    return np.array([float(study.delta(i)["wall.radius"][:-2]) for i in range(len(study))])


def test_points_are_the_product_of_all_dimensions() -> None:
    study = made(
        axes={"camera.f_number": [2, 4], "laser.power": {"from": "1 mW", "to": "3 mW", "count": 3}},
        zip={"hidden.yaw": ["0 deg", "10 deg"], "hidden.pitch": ["1 deg", "2 deg"]},
    )
    assert study.shape == (2, 3, 2)
    assert study.delta(11) == {
        "camera.f_number": 4,
        "laser.power": "0.003 W",
        "hidden.yaw": "0.17453292519943295 rad",
        "hidden.pitch": "0.03490658503988659 rad",
    }
    scene = study.scene(11)
    assert scene.laser.power == 3e-3
    assert scene.camera.focal_length / scene.camera.stop_diameter == approx(4, rel=1e-15)


def test_a_name_depends_on_values_alone() -> None:
    """Not on units, order, or on what else the design has."""
    one = made(axes={"laser.power": ["5 mW", "7 mW"], "camera.f_number": [2, 4]})
    other = made(axes={"camera.f_number": [8, 4], "laser.power": ["0.007 W"]})
    assert one.ids[3] == other.ids[1]
    assert len({*one.ids, *other.ids}) == 5
    assert set(one.ids).isdisjoint(made(**one.definition | {"seed": 1}).ids)


def test_one_at_a_time_begins_with_the_nominal_scene() -> None:
    study = made(one_at_a_time={"wall.radius": ["4 m", "6 m"], "laser.power": ["1 mW"]})
    assert study.dimensions[0].labels() == (
        "nominal",
        "wall.radius = 4 m",
        "wall.radius = 6 m",
        "laser.power = 1 mW",
    )


@pytest.mark.parametrize("method", ["random", "sobol", "saltelli"])
def test_more_draws_keep_those_before(method: str) -> None:
    few, many = (drawn({"from": "4 m", "to": "6 m"}, method, n) for n in (16, 64))
    assert np.array_equal(many[: len(few)], few)
    assert len(many) == 64 * (3 if method == "saltelli" else 1)


def test_draws_follow_their_distribution() -> None:
    """A Sobol sample's distribution function is off by a few over its number of points."""
    for given, law in (
        ({"from": "4 m", "to": "6 m"}, scipy.stats.uniform(4, 2)),
        ({"from": "1 m", "to": "8 m", "spacing": "log"}, scipy.stats.loguniform(1, 8)),
        ({"mean": "5 m", "sigma": "10 cm"}, scipy.stats.norm(5, 0.1)),
        # the mean is that of the scene, 5 m
        ({"sigma": "0.1 m", "to": "5 m"}, scipy.stats.truncnorm(-np.inf, 0, 5, 0.1)),
    ):
        values = drawn(given, count=256)
        assert scipy.stats.kstest(values, law.cdf).statistic < 4 / 256
    assert sorted(drawn(["4 m", "6 m"])) == [4.0] * 32 + [6.0] * 32
    latin = np.sort(drawn({"from": "0 m", "to": "64 m"}, "latin"))
    assert np.array_equal(np.floor(latin), np.arange(64))


def test_a_named_material_is_drawn_from_its_spread() -> None:
    """Every value of it, the logarithm of those whose ends are far apart."""
    entry = material_library()["whiteboard"]
    of = {"wall.material": {"spread_of": "whiteboard"}, "laser.power": ["1 mW", "2 mW"]}
    study = made(draws={"count": 256, "of": of}, set={"wall.material": "whiteboard"})
    rows = [study.delta(i) for i in range(len(study))]
    assert list(rows[0]) == [f"wall.material{v.address}" for v in entry.values] + ["laser.power"]
    for value in entry.values:
        column = [str(row[f"wall.material{value.address}"]) for row in rows]
        wide = value.high > 4 * value.low
        law = scipy.stats.loguniform(value.low, value.high)
        if not wide:
            law = scipy.stats.uniform(value.low, value.high - value.low)
        numbers = [float(text.removesuffix(" rad")) for text in column]
        # a Sobol sample's distribution function is off by a few over its number of points
        assert scipy.stats.kstest(numbers, law.cdf).statistic < 4 / 256
        assert wide == (value.key == "slope_rms")
    scene = study.scene(3)
    assert scene.wall_material.parts[0].rho == rows[3]["wall.material[0].albedo"]
    assert study.base.scene({}).wall_material == entry.material


def test_materials_are_an_axis() -> None:
    names = ["whiteboard", "painted wall"]
    study = made(axes={"wall.material": names, "laser.power": ["1 mW", "2 mW"]})
    assert [study.scene(i).wall_material for i in (0, 2)] == [named_material(n) for n in names]


def test_another_seed_draws_others() -> None:
    one, other = (drawn({"from": "4 m", "to": "6 m"}, "random", seed=seed) for seed in (0, 1))
    assert not np.intersect1d(one, other).size


def test_columns_of_a_saltelli_design_are_exchanged_one_by_one() -> None:
    of = {"wall.radius": {"sigma": "0.1 m"}, "laser.power": {"from": "1 mW", "to": "2 mW"}}
    study = made(draws={"count": 8, "method": "saltelli", "of": of})
    rows = [tuple(study.delta(i).values()) for i in range(len(study))]
    for a, b, first, second in zip(*[iter(rows)] * 4, strict=True):
        assert first == (b[0], a[1])
        assert second == (a[0], b[1])
        assert a[0] != b[0]
        assert a[1] != b[1]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tables", "told"),
    [
        ({}, "design is empty"),
        ({"axes": {"wall.radius": []}}, r"axes.wall.radius = \[\] has no values"),
        ({"axes": {"wall.radius": ["2 m", "3 s"]}}, "mixes units"),
        ({"axes": {"wall.radius": ["2 m", "200 cm"]}}, "lists 2 m twice"),
        ({"axes": {"wall.radius": ["3 s"]}}, "is a time, must be a length"),
        ({"axes": {"wall.radios": ["3 m"]}}, "wall.radios .* did you mean radius"),
        ({"axes": {"wall": ["3 m"]}}, "not the address of a value"),
        ({"axes": {"wall.radius": {"from": "2 m", "to": "4 rad", "count": 3}}}, "different units"),
        ({"axes": {"wall.radius": {"from": "2 m", "to": "4 m", "count": 1}}}, "count = 1"),
        ({"axes": {"wall.material": ["whitebord"]}}, 'whitebord.* did you mean "whiteboard"'),
        (
            {"draws": {"count": 2, "of": {"wall.material": {"spread_of": "tile"}}}},
            "draws.of.wall.material.spread_of = 'tile' is not .*\"white ceramic tile\"",
        ),
        (
            {"draws": {"count": 2, "of": {"wall": {"spread_of": "paper"}}}},
            "draws.of.wall: spread_of belongs to wall.material",
        ),
        (
            {"draws": {"count": 2, "of": {"wall.material": {"spread_of": "paper", "sigma": 1}}}},
            "spread_of goes with no other key",
        ),
        (
            {
                "set": {"wall.material": "plaster"},
                "draws": {"count": 2, "of": {"wall.material": {"spread_of": "paper"}}},
            },
            "set.wall.material is not paper",
        ),
        (
            {
                "draws": {
                    "count": 2,
                    "of": {
                        "wall.material[0].albedo": {"from": 0.1, "to": 0.2},
                        "wall.material": {"spread_of": "paper"},
                    },
                }
            },
            r"wall.material\[0\].albedo is drawn twice",
        ),
        ({"axes": {"hidden.image": ["none.png"]}}, "none.png: the file cannot be read"),
        ({"zip": {"wall.radius": ["2 m"], "laser.power": ["1 W", "2 W"]}}, "different lengths"),
        (
            {"axes": {"wall.radius": ["2 m"]}, "one_at_a_time": {"wall.radius": ["3 m"]}},
            "wall.radius is varied twice",
        ),
        ({"axes": {"wall.radius": ["2 m"]}, "colour": 1}, "colour = 1 is an unknown key"),
        (
            {"axes": {"camera.exposure": {"from": "1 s", "to": "2 s", "count": 999_999}}}
            | {"one_at_a_time": {"wall.radius": ["3 m"]}},
            r"2e\+06 points, limit 1,000,000",
        ),
        ({"axes": {"laser.power": ["1 W"]}, "figures": ["sharpness"]}, "'sharpness' is unknown"),
        ({"axes": {"laser.power": ["1 W"]}, "figures": ["a:b"]}, "'a:b' cannot be imported"),
        ({"axes": {"laser.power": ["1 W"]}, "figures": ["strehl", "strehl"]}, "strehl twice"),
        ({"axes": {"laser.power": ["1 W"]}, "figures": ["mtf"]}, "mtf: missing .*'frequency'"),
    ],
)
def test_bad_design_is_refused_in_one_line(tables: dict, told: str) -> None:
    with pytest.raises(SceneError, match=told) as refused:
        made(**tables)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"from": "4 m"}, "needs sigma, or from and to"),
        ({"from": "4 m", "to": "3 m"}, "from = 4 is not below to = 3"),
        ({"sigma": "0 m"}, "sigma = 0 is not above 0"),
        ({"sigma": "1 s"}, "different units"),
        ({"from": "0 m", "to": "3 m", "spacing": "log"}, "needs values above 0"),
    ],
)
def test_bad_distribution_is_refused(given: dict, told: str) -> None:
    with pytest.raises(SceneError, match=told):
        drawn(given)


def test_a_count_that_sobol_cannot_balance_is_refused() -> None:
    with pytest.raises(SceneError, match="count = 100 is not a power of 2.* use 64 or 128"):
        drawn({"from": "4 m", "to": "6 m"}, count=100)


def test_a_study_file_names_itself_in_errors(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'scene = "{SCENE}"\nfigures = ["strehl"]\n[axes]\n"wall.radius" = ["1 kg"]\n')
    with pytest.raises(SceneError, match=r"study.toml: .*wall.radius = .*1 kg"):
        Study.load(path)
    with pytest.raises(SceneError, match="cannot be read .No such file"):
        Study.load(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("name", "page"),
    [
        ("read_a_letter", "design_study.md"),
        ("tolerances", "tolerance_study.md"),
    ],
)
def test_the_examples_are_short_and_on_their_pages(name: str, page: str) -> None:
    """At most 12 lines of TOML, the same in the file and in the how-to."""
    root = HERE.parents[1]
    path = root / "examples" / "studies" / f"{name}.toml"
    lines = path.read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#"))
    assert len(text.splitlines()) <= 12
    assert text in (root / "docs" / "howto" / page).read_text()
    study = Study.load(path)
    assert sum(len(dimension.addresses) for dimension in study.dimensions) == 3
    assert min(study.shape) >= 3


def test_the_letter_of_the_example_is_what_its_question_says() -> None:
    study = Study.load(HERE.parents[1] / "examples" / "studies" / "read_a_letter.toml")
    assert study.shape == (3, 6, 6)
    scene = study.scene(0)
    # the letter is 0.31 m high in a picture of 0.7 m
    assert 0.31 / 0.7 * scene.hidden.size[0] == approx(0.1, abs=1e-3)
    assert (scene.laser.power, scene.camera.exposure) == (0.02, 0.02)
    assert scene.hidden.position[2] == 1.0
