"""From an empty folder to a first result: `new`, examples by name, help, and the wheel's files."""

from __future__ import annotations

import itertools
import re
import shlex
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics.cli import main
from nlosoptics.errors import SceneError

pytest.importorskip("matplotlib")

ROOT = Path(__file__).parents[2]
KINDS = ("corner", "design", "photo", "shadows", "transient")
Call = Callable[[str], tuple[int, str, str]]


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> Call:
    """Run a command line in an empty folder; return its exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def run(words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(shlex.split(words)[1:])
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return run


@pytest.mark.parametrize("kind", KINDS)
def test_new_scenes_load_and_plan(call: Call, kind: str) -> None:
    code, out, _ = call(f"nlosoptics new room.toml --kind {kind}")
    assert code == 0
    written, *steps = out.splitlines()
    files = written.removeprefix("written: ").removesuffix("; next:").split(", ")
    assert set(files) == {path.name for path in Path().iterdir()}
    assert steps
    assert all(re.match(r"  nlosoptics \w+ .*(room\.toml|capture\.hdf5)", step) for step in steps)
    assert str(nlos.plan(nlos.Scene.load("room.toml").resized(64)))


@pytest.mark.parametrize("kind", KINDS)
def test_each_value_of_a_new_scene_has_a_comment(kind: str) -> None:
    """On its own line, or in the line above."""
    lines = (ROOT / "examples" / "scenes" / f"{kind}.toml").read_text().splitlines()
    bare = [
        line
        for above, line in itertools.pairwise(lines)
        if " = " in line and "#" not in line and not above.startswith("#")
    ]
    assert bare == []


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.thorough) for kind in KINDS if kind != "design"]
)
def test_the_next_steps_of_a_new_scene_run(call: Call, kind: str) -> None:
    """The commands that `new` prints, as they are; the files written beside it suffice."""
    _, out, _ = call(f"nlosoptics new room.toml --kind {kind}")
    for step in out.splitlines()[1:]:
        code, _, err = call(step.strip())
        assert code == 0, err
    if kind == "photo":
        truth = nlos.Scene.load("room.toml", {"hidden.image": str(ROOT / "examples/objects/R.png")})
        ideal = nlos.simulate(truth, seed=0).image.ideal
        assert np.corrcoef(np.load("photo/object.npy").ravel(), ideal.ravel())[0, 1] > 0.97


def test_a_new_scene_gives_a_picture(call: Call) -> None:
    call("nlosoptics new room.toml --kind design")
    code, out, _ = call("nlosoptics run room.toml --size 32")
    assert code == 0
    assert "converged" in out
    assert (Path("room") / "overview.png").stat().st_size > 50_000


def test_new_keeps_what_exists(call: Call) -> None:
    Path("eye_chart.png").write_bytes(b"mine")
    code, _, err = call("nlosoptics new room.toml")
    assert (code, err) == (
        2,
        "nlosoptics: eye_chart.png exists and is kept; name a file in another folder\n",
    )
    assert [path.name for path in Path().iterdir()] == ["eye_chart.png"]
    assert call("nlosoptics new room.toml --kind design")[0] == 0
    assert call("nlosoptics new other.toml --kind shadows")[0] == 0  # the same picture F.png
    assert "room.toml exists" in call("nlosoptics new room.toml --kind photo")[2]


def test_examples_have_names(call: Call) -> None:
    """In Python and on the command line, also beside a folder of results of this name."""
    path = ROOT / "examples" / "scenes" / "letter_flat.toml"
    nlos.example("letter_flat").save("named.toml")
    nlos.Scene.load(path).save("path.toml")
    assert Path("named.toml").read_bytes() == Path("path.toml").read_bytes()
    Path("letter_flat").mkdir()
    assert call("nlosoptics plan letter_flat --size 64")[0] == 0
    with pytest.raises(SceneError, match=r"did you mean corner\? The examples are .*letter_wavy"):
        nlos.example("cornr")
    with pytest.raises(SceneError, match="camera_wu2024.*use one of the examples"):
        nlos.example("camera_wu2024")


def test_the_wheel_holds_what_examples_name() -> None:
    """Each file that a scene or study refers to is in a folder that the wheel includes."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    included = settings["targets"]["wheel"]["force-include"]
    assert all(there == f"nlosoptics/{here}" for here, there in included.items())
    for folder in ("scenes", "studies"):
        for path in (ROOT / "examples" / folder).glob("*.toml"):
            for name in re.findall(r'"([\w./]+\.(?:png|obj|toml))"', path.read_text()):
                part = (path.parent / name).resolve()
                assert part.is_file()
                assert str(part.parent.relative_to(ROOT)) in included


def test_help_lists_every_command_in_the_order_of_work(call: Call) -> None:
    code, out, _ = call("nlosoptics")
    assert code == 0
    from nlosoptics.cli.shell import app

    headings = re.findall(r"^([A-Z][\w-]+):$", out, re.MULTILINE)
    assert headings == [
        "Options", "Simulate", "Design", "Reconstruct", "Time-resolved", "Tools",
    ]  # fmt: skip
    names = {command.name for command in app.registered_commands} | {"study", "capture"}
    listed = re.findall(r"^  ([a-z]+) +[A-Z]", out, re.MULTILINE)
    assert sorted(listed) == sorted(names)
    assert "--install-completion" in out
    assert call("nlosoptics study")[:2] == call("nlosoptics study --help")[:2]
    assert "lambert (albedo 0.76) + ward (albedo 0.04" in call("nlosoptics materials")[1]
