"""The command line: exit codes, one-line errors, and folders written whole or not at all."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

import nlosoptics
from nlosoptics import _random, _whole_files, cli
from nlosoptics._whole_files import whole_folder
from nlosoptics.cli import figures, forward, shell
from nlosoptics.runs import record, results
from nlosoptics.scene import Scene, material_library


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


def mesh_of(kind: str, path: Path) -> None:
    """Write a mesh file that no wall can be made of."""
    if kind == "empty":
        path.write_bytes(b"")
    else:
        path.write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")


# One edit of the scene file each, and what the message must name.
BAD_SCENES = {
    "missing key": ('power = "0.005 W"\n', "", ["laser.power", "missing"]),
    "unknown key": ("beam_diameter", "beam_diametre", ["beam_diametre", "beam_diameter"]),
    "wrong unit": ('"0.005 W"', '"0.005 m"', ["laser.power", "0.005 m", "W"]),
    "no unit": ('"6.328e-07 m"', "632.8", ["laser.wavelength", "632.8", "unit"]),
    "wavelength in m": ('"6.328e-07 m"', '"632.8 m"', ["laser.wavelength", "632.8", "nanometres"]),
    "negative size": ('size = ["0.3 m", "0.3 m"]', 'size = "-0.3 m"', ["hidden.size", "-0.3"]),
    "NaN": ('"0.025 m"', '"nan m"', ["camera.stop_diameter", "nan"]),
    "object behind the wall": (
        '"0.3798 m", "0.0 m", "1.0 m"',
        '"0.3798 m", "0.0 m", "-1.0 m"',
        ["hidden.position", "-1", "behind the wall"],
    ),
    "camera looks away": (
        'aim = ["-0.16453333333333325 m", "0.0 m", "0.0 m"]',
        'aim = ["-0.1 m", "0.0 m", "2.0 m"]',
        ["camera.aim", "away from the wall"],
    ),
    "missing picture": ("letter.png", "lettre.png", ["hidden.image", "lettre.png"]),
    "picture is no picture": ("letter.png", "letter.toml", ["hidden.image", "letter.toml"]),
    "missing mesh": (
        'shape = "flat"',
        'shape = "mesh"\nmesh = "wall.stl"',
        ["wall.mesh", "wall.stl"],
    ),
    "empty mesh": (
        'shape = "flat"',
        'shape = "mesh"\nmesh = "empty.stl"',
        ["wall.mesh", "empty.stl"],
    ),
    "mesh without surface": (
        'shape = "flat"',
        'shape = "mesh"\nmesh = "lines.obj"',
        ["wall.mesh", "lines.obj"],
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
    mesh_of("empty", scene_file.with_name("empty.stl"))
    mesh_of("lines", scene_file.with_name("lines.obj"))
    before = contents(scene_file.parent)
    for command in (["run", scene_file, "--out", "result"], ["plan", scene_file]):
        answer = run(*command)
        assert answer.code == 2
        assert answer.out == ""
        assert answer.err.count("\n") == 1
        for word in named:
            assert word in answer.err
    assert contents(scene_file.parent) == before


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], ["command"]),
        (["walk"], ["walk"]),
        (["run"], ["SCENE"]),
        (["run", "nowhere.toml"], ["nowhere.toml", "missing"]),
        (["run", "letter.toml", "--tol", "tight"], ["--tol"]),
        (["run", "letter.toml", "--tol", "nan"], ["tol = nan"]),
        (["run", "letter.toml", "--tol", "2"], ["tol = 2", "0.1"]),
        (["run", "letter.toml", "--seed", "-1"], ["--seed"]),
        (["run", "letter.toml", "--seed", "0.5"], ["--seed"]),
        (["run", "letter.toml", "--seed", str(2**64)], ["--seed", str(2**64 - 1)]),
        (["run", "letter.toml", "--size", "100"], ["size = 100", "nearest is 128"]),
        (["run", "letter.toml", "--size", "0"], ["size = 0"]),
        (["run", "letter.toml", "--sise", "64"], ["--sise"]),
        (["run", "letter.toml", "--out", "letter.png"], ["letter.png", "is a file"]),
        (["run", "letter.toml", "--out", "a/b"], ["a, which is no folder"]),
        (["run", "letter.toml", "--out", "."], ["letter.", "did not write"]),
        (["plan", "letter.toml", "--tol", "-1"], ["tol = -1"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_argument_is_one_line_and_writes_nothing(
    arguments: list[str], named: list[str], scene_file: Path, run: Run
) -> None:
    """Exit code 2 and a line that names the option and its value or limit."""
    before = contents(scene_file.parent)
    answer = run(*arguments)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    for word in named:
        assert word in answer.err
    assert contents(scene_file.parent) == before


def test_debug_shows_the_traceback(scene_file: Path, run: Run) -> None:
    """The code stays that of bad input."""
    answer = run("run", "nowhere.toml", "--debug")
    assert answer.code == 2
    assert "Traceback" in answer.err
    assert "SceneError" in answer.err


def test_version(run: Run) -> None:
    """The package's own."""
    assert run("--version") == (0, f"nlosoptics {nlosoptics.__version__}\n", "")


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["plan"],
        ["feasibility"],
        ["run"],
        ["reconstruct"],
        ["schema"],
        ["transient"],
        ["phasor"],
        ["trace"],
    ],
)
def test_help(command: list[str], run: Run) -> None:
    """Each command explains itself."""
    answer = run(*command, "--help")
    assert answer.code == 0
    assert "Usage: nlosoptics" in answer.out


def test_schema_is_json(run: Run) -> None:
    """A JSON schema that knows the four tables."""
    schema = json.loads(run("schema").out)
    assert set(schema["properties"]) == {
        "laser",
        "wall",
        "hidden",
        "camera",
        "occluder",
        "transient",
    }


def test_plan_prints_what_the_library_plans(scene_file: Path, run: Run) -> None:
    """The table is `str(plan)`; nothing is computed or written."""
    before = contents(scene_file.parent)
    plan = nlosoptics.plan(nlosoptics.Scene.load(scene_file).resized(32), 1e-2, reconstruct=True)
    answer = run("plan", scene_file, "--size", 32, "--tol", 1e-2)
    assert answer == (0, f"{plan}\n", "")
    assert contents(scene_file.parent) == before


@pytest.mark.parametrize("command", ["plan", "run"])
def test_a_budget_is_kept_before_anything_is_written(scene_file: Path, run: Run, command) -> None:
    before = contents(scene_file.parent)
    for option, value, limit in (
        ("--memory", 0.001, "limit 0.001 GiB"),
        ("--max-seconds", 0.001, "limit max_seconds = 0.001"),
    ):
        code, out, told = run(command, scene_file, "--size", 32, option, value)
        assert code != 0
        assert not out
        assert limit in told
        assert told.count("\n") == 1
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
    assert {"image.npz", "reconstruction.npz", "scene.png", "reconstruction.png"} <= set(
        report["files"]
    )
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
    assert run("run", folder / "scene.toml", "--no-reconstruct", "--out", "again").code == 0
    second = json.loads((scene_file.parent / "again" / "result.json").read_text())
    assert second["scene_sha256"] == report["scene_sha256"]
    assert "reconstruction.npz" not in second["files"]


def test_seed_limit_is_the_generators() -> None:
    """Written twice, because the command line's help loads no numpy."""
    assert shell.MOST_SEED == _random.MOST_SEED


def test_help_of_tol_claims_no_more_than_it_does(run: Run) -> None:
    """It bounds the point spread; the image's own error is fixed."""
    text = " ".join(run("run", "--help").out.replace("\u2502", " ").split())
    assert "Largest error of the point spread" in text
    assert "point spread and image" not in text


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


def terminate(*_: object, **__: object) -> None:
    """End the process like a batch system or the system's shutdown."""
    signal.raise_signal(signal.SIGTERM)


def terminate_in_a_callback(*_: object, seconds: float = 5.0, **__: object) -> None:
    """End the process while Python cannot raise the exception."""

    class Thing:
        pass

    thing = Thing()
    watched = weakref.ref(thing, terminate)
    del thing
    assert watched() is None
    time.sleep(seconds)


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
        (figures, "write_figures"),
    ):
        for break_it, said in (
            (disk_full, "disk full"),
            (interrupt, "interrupted; no partial result was written"),
            (terminate, "interrupted; no partial result was written"),
            (terminate_in_a_callback, "interrupted; no partial result was written"),
        ):
            with monkeypatch.context() as broken:
                broken.setattr(where, step, break_it)
                answer = run(*command, "--seed", 1)
            assert answer.code == 1, step
            assert said in answer.err
            assert answer.err.count("\n") == 1
            assert contents(scene_file.parent) == before, step


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("then", ["it waits", "it fails"])
def test_an_interrupt_that_python_forgets_is_told(
    run: Run, monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    """On a busy machine, a thread that repeats it is quicker than the one that starts it."""
    start, slow = threading.Timer.start, [0.5, 0.0]

    def started(timer: threading.Timer) -> None:
        start(timer)
        time.sleep(slow.pop(0) if slow else 0.0)

    def made(**_: object) -> int:
        terminate_in_a_callback(seconds=5.0 * (then == "it waits"))
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr(threading.Timer, "start", started)
    monkeypatch.setattr(cli, "_program", lambda _: made)
    answer = run("schema")
    assert (answer.code, answer.err) == (
        1,
        "nlosoptics: interrupted; no partial result was written\n",
    )


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_in_an_import_waits_for_its_end(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Libraries go on without what they could not import, whatever the reason."""
    words = ["import signal", "try:", "    signal.raise_signal(signal.SIGTERM)"]
    words += ["except BaseException:", "    pass", "done = True"]
    (tmp_path / "goes_on.py").write_text("\n".join(words))
    monkeypatch.syspath_prepend(tmp_path)

    def made(**_: object) -> int:
        importlib.import_module("goes_on")
        time.sleep(5.0)
        return 0

    monkeypatch.setattr(cli, "_program", lambda _: made)
    answer = run("schema")
    assert sys.modules.pop("goes_on").done
    assert (answer.code, answer.err) == (
        1,
        "nlosoptics: interrupted; no partial result was written\n",
    )


def test_ctrl_c_while_words_are_read_is_told(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Typer ends with 130 and no word where the command has not begun."""
    monkeypatch.setattr(cli, "_program", lambda _: lambda **_: 130)
    answer = run("schema")
    assert (answer.code, answer.err) == (
        1,
        "nlosoptics: interrupted; no partial result was written\n",
    )


def test_renaming_that_fails_puts_the_old_folder_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one moment when the old folder is away and the new one not yet there."""
    target = tmp_path / "result"
    target.mkdir()
    (target / "old.txt").write_text("old")
    rename = Path.rename

    def break_second(self: Path, to: Path) -> Path:
        if self.name == "new":
            raise OSError("no")
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", break_second)
    monkeypatch.setattr(_whole_files, "_exchanged", lambda *_: False)
    with pytest.raises(OSError, match="no"), whole_folder(target) as new:
        (new / "new.txt").write_text("new")
    assert contents(tmp_path) == {"result/old.txt": b"old"}


def test_missing_extra_is_told_before_any_work(
    scene_file: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 1: the input is good, the installation is not."""
    before = contents(scene_file.parent)
    monkeypatch.setattr(shell.importlib.util, "find_spec", lambda name: name != "torch" or None)
    answer = run("train", scene_file)
    assert answer.code == 1
    assert "pip install 'nlosoptics[inverse]'" in answer.err
    assert answer.err.count("\n") == 1
    assert contents(scene_file.parent) == before


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


@pytest.mark.parametrize("command", ["plan", "run"])
def test_plan_and_run_load_nothing_heavy(command: str, scene_file: Path) -> None:
    """A plan takes as long as its imports; numba aims the waves that its windows follow from.

    Other processes load matplotlib for a run.
    """
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
    heavy = {"torch", "pyvista", "trimesh", "rich.console", "scipy.fft", "scipy.special"}
    if command == "plan":  # on one core, a run draws by itself
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


def test_figures_fit_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Long values go on below the first line; a path stays whole."""
    monkeypatch.setenv("COLUMNS", "40")
    table = shell.Figures()
    table.add("light", "one two three four five six seven eight")
    table.add("  stage", "")
    table.add("written to", "/a-folder/" + 40 * "x")
    table.print()
    assert capsys.readouterr().out.splitlines() == [
        "",
        "  quantity     value",
        40 * "-",
        "  light        one two three four five",
        "               six seven eight",
        "    stage",
        "  written to   /a-folder/" + 40 * "x",
        "",
    ]
