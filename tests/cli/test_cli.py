"""The command line: exit codes, one-line errors, and folders written whole or not at all."""

from __future__ import annotations

import itertools
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

import nlosoptics
from nlosoptics import cli
from nlosoptics.cli import figures, forward, shell
from nlosoptics.runs import record, results
from nlosoptics.scene import Scene, WavyWall, material_library


class Answer(NamedTuple):
    """What a call of the program came to."""

    code: int
    out: str
    err: str


Run = Callable[..., Answer]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Call the command line in this process."""

    def call(*arguments: object) -> Answer:
        with pytest.raises(SystemExit) as ended:
            cli.main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return Answer(int(ended.value.code or 0), captured.out, captured.err)

    return call


@pytest.fixture
def scene_file(tmp_path: Path, flat_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene file of 64 x 64 pixels with its picture, in the working folder."""
    monkeypatch.chdir(tmp_path)
    picture = np.rint(255 * flat_scene.hidden.reflectance).astype(np.uint8)  # type: ignore[union-attr]
    Image.fromarray(picture).save(tmp_path / "letter.png")
    hidden = replace(flat_scene.hidden, image=tmp_path / "letter.png")
    replace(flat_scene, hidden=hidden).save(tmp_path / "letter.toml")
    return tmp_path / "letter.toml"


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# One edit of the scene file each, and what the message must name.
BAD_SCENES = {
    "missing key": ('power = "0.005 W"\n', "", ["laser.power", "missing"]),
    "unknown key": ("beam_diameter", "beam_diametre", ["beam_diametre", "beam_diameter"]),
    "wrong unit": ('"0.005 W"', '"0.005 m"', ["laser.power", "0.005 m", "W"]),
    "NaN": ('"0.025 m"', '"nan m"', ["camera.stop_diameter", "nan"]),
    "object behind the wall": (
        '"0.3798 m", "0.0 m", "1.0 m"',
        '"0.3798 m", "0.0 m", "-1.0 m"',
        ["hidden.position", "-1", "behind the wall"],
    ),
    "missing mesh": (
        'shape = "flat"',
        'shape = "mesh"\nmesh = "wall.stl"',
        ["wall.mesh", "wall.stl"],
    ),
    "beyond memory": (
        "pixels = [4096, 4096]\nbinning = 64",
        "pixels = [1048576, 1048576]\nbinning = 1",
        ["1048576", "GiB"],
    ),
    "not TOML": ("[wall]", "[wall", ["letter.toml", "TOML"]),
}


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scene_is_one_line_and_writes_nothing(case: str, scene_file: Path, run: Run) -> None:
    """Exit code 2, a line that names the place, and no file more than before."""
    old, new, named = BAD_SCENES[case]
    text = scene_file.read_text()
    assert text.count(old) >= 1
    scene_file.write_text(text.replace(old, new, 1))
    before = contents(scene_file.parent)
    for command in (["run", scene_file, "--out", "result"], ["plan", scene_file]):
        answer = run(*command)
        assert answer.code == 2
        assert answer.out == ""
        assert answer.err.count("\n") == 1
        for word in named:
            assert word in answer.err
    assert contents(scene_file.parent) == before


def test_version(run: Run) -> None:
    """The package's own."""
    assert run("--version") == (0, f"nlosoptics {nlosoptics.__version__}\n", "")


def test_help_of_every_command_has_an_example_that_can_be_typed() -> None:
    """Names of command, options and scene in the example are known, and its values are valid."""
    from typer.main import get_command

    from nlosoptics.cli.shell import app

    def each(command, words):
        if hasattr(command, "commands"):
            for name, part in command.commands.items():
                yield from each(part, [*words, name])
        else:
            yield command, words

    for command, words in each(get_command(app), ["nlosoptics"]):
        example = shlex.split(command.help.partition("Example: ")[2])
        # `run` may be left out after `study`
        assert example[: len(words)] == words or words[1:] == ["study", "run"]
        options = {name for parameter in command.params for name in parameter.opts}
        assert {word for word in example if word.startswith("--")} <= options
        typed = example[len(words) if example[: len(words)] == words else 2 :]
        typed = list(itertools.takewhile(lambda word: word != ">", typed))
        values = command.make_context("", typed).params  # parses all of them
        if "changes" in values and not values["scene_file"].suffix:
            shell.load(values["scene_file"], None, values["changes"])
        assert all(getattr(p, "help", None) for p in command.params if p.name != "help"), words


def test_schema_is_json(run: Run) -> None:
    """A JSON schema that knows the tables."""
    schema = json.loads(run("schema").out)
    assert set(schema["properties"]) == {
        "laser",
        "wall",
        "hidden",
        "camera",
        "occluder",
        "transient",
        "ambient",
        "burst",
    }


def test_plan_prints_what_the_library_plans(scene_file: Path, run: Run) -> None:
    """The table is `str(plan)`; nothing is computed or written."""
    before = contents(scene_file.parent)
    plan = nlosoptics.plan(nlosoptics.Scene.load(scene_file).resized(32), 1e-2, reconstruct=True)
    answer = run("plan", scene_file, "--size", 32, "--tol", 1e-2)
    assert answer == (0, f"{plan}\n", "")
    assert contents(scene_file.parent) == before


def test_run_writes_the_whole_result(examples: Path, scene_file: Path, run: Run) -> None:
    """Figures, arrays and pictures, and result.json describes them; the scene can be run again."""
    # the laser spot of the fixture's scene outshines its letter
    nlosoptics.Scene.load(examples / "scenes" / "letter_flat.toml").resized(64).save(scene_file)
    answer = run("run", scene_file, "--seed", 3)
    assert answer.code == 0, answer.err
    assert answer.err == ""
    folder = scene_file.parent / "letter"
    report = json.loads((folder / "result.json").read_text())
    assert report["status"] == "done"
    assert (report["seed"], report["tol"]) == (3, 1e-3)
    assert sorted(p.name for p in folder.iterdir()) == report["files"]
    assert {"image.npz", "reconstruction.npz", "overview.png"} <= set(report["files"])
    assert "scene.png" not in report["files"]
    stages = [stage["name"] for stage in report["plan"]["stages"]]
    seconds = report["seconds"]
    ends = ["writing", "figures", "other", "total"]
    assert list(seconds) == ["loading", "planning", *stages, *ends]
    *parts, whole = seconds.values()
    assert sum(parts) == pytest.approx(whole, rel=1e-9)  # rounding of a sum
    assert min(parts) >= 0.0
    assert report["figures"]["correlation_with_truth"] > 0.9
    for stage in stages:
        assert stage in answer.out

    again = nlosoptics.simulate(nlosoptics.Scene.load(scene_file), seed=3)
    with np.load(folder / "image.npz") as arrays:
        np.testing.assert_array_equal(arrays["electrons"], again.image.electrons)
    with np.load(folder / "wavefront.npz") as arrays:
        np.testing.assert_array_equal(arrays["aberration"], again.wavefront.aberration)
        assert arrays["layout"] == again.wavefront.layout

    # the folder's own scene file gives the same scene, so the same hash
    more = ("--no-reconstruct", "--figures", "--out", "again")
    assert run("run", folder / "scene.toml", *more).code == 0
    second = json.loads((scene_file.parent / "again" / "result.json").read_text())
    assert second["scene_sha256"] == report["scene_sha256"]
    assert "reconstruction.npz" not in second["files"]
    figures = {"scene.png", "wavefront.png", "point_spread.png", "image.png"}
    assert figures <= set(second["files"])
    # a report is listed as a part of the folder
    assert run("report", folder, "--no-3d").code == 0
    third = json.loads((folder / "result.json").read_text())
    assert "report.html" in third["files"]
    assert sorted(p.name for p in folder.iterdir()) == third["files"]


@pytest.mark.thorough
@pytest.mark.parametrize("dark", ["black picture", "turned away"])
def test_object_that_sends_no_light(dark: str, examples: Path, scene_file: Path, run: Run) -> None:
    """No truth to compare with or to draw, and no NaN; warnings are errors here."""
    scene = nlosoptics.Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    if dark == "black picture":
        Image.fromarray(np.zeros((8, 8), np.uint8)).save(scene_file.with_name("black.png"))
        hidden = replace(scene.hidden, image=scene_file.with_name("black.png"))
    else:
        hidden = replace(scene.hidden, yaw=np.pi)
    replace(scene, hidden=hidden).save(scene_file)
    answer = run("run", scene_file)
    assert answer.code == 0, answer.err
    assert "no light from the object reaches the camera" in " ".join(answer.out.split())
    assert "correlation" not in answer.out
    report = json.loads((scene_file.parent / "letter" / "result.json").read_text())
    assert "correlation_with_truth" not in report["figures"]
    assert report["figures"]["reconstruction_status"] == "too_few_photons"


def test_hash_follows_scene_and_picture(scene_file: Path) -> None:
    """Any change of the scene's numbers or of the picture's bytes changes it."""

    def digest() -> str:
        return record.scene_hash(nlosoptics.Scene.load(scene_file))

    first = digest()
    scene_file.write_text(scene_file.read_text().replace('"0.04 s"', '"0.02 s"'))
    second = digest()
    Image.fromarray(np.full((32, 32), 255, np.uint8)).save(scene_file.with_name("letter.png"))
    assert len({first, second, digest()}) == 3


@pytest.mark.thorough
def test_only_our_folder_is_replaced(scene_file: Path, run: Run) -> None:
    """A second run replaces the first one's folder, but not one that holds somebody's notes."""
    command = ("run", scene_file, "--no-reconstruct", "--out", "result")
    assert run(*command, "--seed", 1).code == 0
    assert run(*command, "--seed", 2).code == 0
    folder = scene_file.parent / "result"
    assert json.loads((folder / "result.json").read_text())["seed"] == 2
    (folder / "notes.txt").write_text("mine")
    before = contents(folder)
    answer = run(*command, "--seed", 3)
    assert answer.code == 2
    assert "notes.txt" in answer.err
    assert contents(folder) == before


def disk_full(*_: object, **__: object) -> None:
    """Fail as a full disk does."""
    raise OSError("disk full")


def interrupt(*_: object, **__: object) -> None:
    """Press Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


@pytest.mark.thorough
@pytest.mark.usefixtures("interruptible")
def test_broken_run_leaves_the_old_folder(
    scene_file: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither half a folder nor a lost one, whatever breaks in the middle."""
    command = ("run", scene_file, "--no-reconstruct")
    assert run(*command).code == 0
    before = contents(scene_file.parent)
    for where, step in (
        (forward, "load"),
        (results, "write_result"),
        (figures, "write_overview"),
    ):
        for break_it, code, said in (
            (disk_full, 1, "disk full"),
            (interrupt, 130, "interrupted; no partial result was written"),
        ):
            with monkeypatch.context() as broken:
                broken.setattr(where, step, break_it)
                answer = run(*command, "--seed", 1)
            assert answer.code == code, step
            assert said in answer.err
            assert answer.err.count("\n") == 1
            assert contents(scene_file.parent) == before, step


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_is_interrupted_says_so_in_one_line(number: int, scene_file: Path) -> None:
    """The signal comes when the run begins to compute."""
    code = (
        "import os, signal, sys\n"
        "from nlosoptics.runs import simulate\n"
        f"simulate.carried_out = lambda *_: os.kill(os.getpid(), {int(number)})\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from nlosoptics.cli import main\nmain()"
    )
    before = contents(scene_file.parent)
    command = [sys.executable, "-c", code, "run", str(scene_file), "--size", "32"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 130
    assert answer.stderr == "nlosoptics: interrupted; no partial result was written\n"
    assert contents(scene_file.parent) == before


def test_missing_extra_is_told_before_any_work(
    scene_file: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 1: the input is good, the installation is not."""
    before = contents(scene_file.parent)
    monkeypatch.setattr(shell.importlib.util, "find_spec", lambda name: name != "torch" or None)
    answer = run("reconstruct", scene_file, "--scene", scene_file, "--method", "wiener")
    assert answer.code == 1
    assert "pip install 'nlosoptics[inverse]'" in answer.err
    assert answer.err.count("\n") == 1
    assert contents(scene_file.parent) == before


@pytest.mark.thorough
def test_without_matplotlib_a_run_writes_all_but_pictures(
    scene_file: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a process of its own, in which nothing can load matplotlib."""
    code = (
        "import sys\nsys.modules['matplotlib'] = None\n"
        "import importlib.util as u\nfind = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'matplotlib' else find(name, *a)\n"
        "from nlosoptics.cli import main\nmain()"
    )
    command = [sys.executable, "-c", code, "run", str(scene_file), "--no-reconstruct"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert "no pictures are written" in answer.stderr
    assert answer.stderr.count("\n") == 1
    folder = scene_file.parent / "letter"
    held = json.loads((folder / "result.json").read_text())["files"]
    assert set(held) == {path.name for path in folder.iterdir()}
    assert not [name for name in held if name.endswith(".png") and "hidden" not in name]
    assert run("report", folder).code == 0


@pytest.mark.thorough
@pytest.mark.parametrize("command", ["plan", "run"])
def test_plan_and_run_load_nothing_heavy(command: str, scene_file: Path) -> None:
    """A plan takes as long as its imports."""
    code = (
        "import atexit, sys\nfrom nlosoptics.cli import main\n"
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr))\nmain()"
    )
    environment = {k: v for k, v in os.environ.items() if k != "EAGER_IMPORT"}
    answer = subprocess.run(
        [sys.executable, "-c", code, command, scene_file],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=scene_file.parent,
    )
    heavy = {"torch", "pyvista", "trimesh", "rich.console"}
    if command == "plan":
        heavy.add("matplotlib")
    loaded = set(answer.stderr.split())
    assert "nlosoptics.runs.plan" in loaded
    assert heavy & loaded == set()


@pytest.mark.parametrize(("word", "code"), [("--version", 0), ("--nonsense", 2)])
def test_a_process_ends_with_its_code_and_all_that_it_registered(word: str, code: int) -> None:
    """Also into a pipe, whose text is written only when it is flushed."""
    program = (
        "import atexit, sys; atexit.register(print, 'registered'); sys.argv[1:] = [{!r}]\n"
        "from nlosoptics.cli import main; main(); print('goes on')"
    )
    answer = subprocess.run(
        [sys.executable, "-c", program.format(word)], capture_output=True, text=True, check=False
    )
    assert answer.returncode == code
    assert answer.stdout.splitlines()[-1] == "registered"
    assert answer.stderr.startswith("nlosoptics: No such option") == (code == 2)


@pytest.mark.thorough
def test_set_changes_values_of_the_scene(run, scene_file):
    plain = run("feasibility", scene_file, "--json")
    stronger = run("feasibility", scene_file, "--json", "--set", "laser.power=10mW")
    assert plain.code == stronger.code == 0
    factor = json.loads(stronger.out)["photons"] / json.loads(plain.out)["photons"]
    assert factor == pytest.approx(10e-3 / Scene.load(scene_file).laser.power, rel=1e-9)
    wrong = run("plan", scene_file, "--set", "laser.power=5")
    assert wrong.code == shell.BAD_INPUT
    assert "laser.power = 5 has no unit" in wrong.err
    assert wrong.err.count("\n") == 1


def test_materials_are_listed_with_their_sources(run: Run) -> None:
    code, out, err = run("materials")
    assert (code, err) == (0, "")
    assert [line.split("  ")[0] for line in out.splitlines()] == list(material_library())
    code, out, err = run("materials", "Painted-Wall")
    assert (code, err) == (0, "")
    assert out == f"{material_library()['painted wall']}\n"
    code, out, err = run("materials", "tile")
    assert (code, out) == (2, "")
    assert 'did you mean "white ceramic tile"?' in err
    assert err.count("\n") == 1


def test_a_plan_that_no_run_can_follow_is_refused(run: Run, scene_file: Path) -> None:
    """A mesh too coarse for waves, whose stages the plan lists as skipped."""
    WavyWall(2e-3, 0.2, size=2.0).to_mesh(max_sag_error=1e-4).export("wall.stl")
    text = scene_file.read_text()
    scene_file.write_text(text.replace('shape = "flat"', 'shape = "mesh"\nmesh = "wall.stl"'))
    answer = run("plan", scene_file)
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "no geometric method" in answer.err


def test_what_no_system_can_do_is_refused_in_one_line(run: Run, scene_file: Path) -> None:
    """A folder in /proc, whose permissions say yes, and an integer that Python does not read."""
    answer = run("run", scene_file, "--out", "/proc/x")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "/proc/x is in /proc, which takes no folder" in answer.err
    scene_file.write_text(scene_file.read_text().replace("[laser]", "[laser]\nx = " + 5000 * "9"))
    answer = run("plan", scene_file)
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "thousands of digits; give fewer" in answer.err
