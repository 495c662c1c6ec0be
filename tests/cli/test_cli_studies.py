"""Command study: run, resume, plan, status, pictures and tables, with one-line errors."""

from __future__ import annotations

import csv
import os
import re
import signal
import threading
import time
from pathlib import Path

import pytest

from nlosoptics import cli
from nlosoptics.cli import shell

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "examples" / "scenes" / "letter_concave.toml"


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study file of light points in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "powers.py").write_text(
        "def power(point):\n    return point.scene.laser.power\n"
        "def fails(point):\n    raise ValueError('never')\n"
    )
    path = tmp_path / "powers.toml"
    path.write_text(
        f'scene = "{SCENE}"\nfigures = ["powers:power"]\n'
        '[axes]\n"laser.power" = ["1 mW", "2 mW", "5 mW"]\n"camera.f_number" = [2, 4]\n'
    )
    return path


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(a) for a in arguments])
    told = capsys.readouterr()
    return int(ended.value.code or 0), told.out, told.err


def test_study_runs_resumes_and_answers(study: Path, capsys) -> None:
    code, out, err = call(capsys, "study", study, "--plan")
    assert (code, err) == (0, "")
    assert "points         6, 1 figure each" in out
    assert not Path("powers.zarr").exists()
    code, out, err = call(capsys, "study", study, "--workers", 0)
    assert (code, err) == (0, "")
    assert "powers.zarr: 6 points: 6 done\npower" in out
    chunk = next(Path("powers.zarr/status/c").rglob("0/0"))
    written = chunk.stat().st_mtime_ns
    assert call(capsys, "study", "run", study, "--workers", 0) == (0, out, "")
    assert chunk.stat().st_mtime_ns == written
    assert call(capsys, "study", "status", "powers.zarr") == (0, out, "")
    assert call(capsys, "study", "export", "powers.zarr", "table.csv")[0] == 0
    with Path("table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["power"]) for row in rows] == [1e-3, 1e-3, 2e-3, 2e-3, 5e-3, 5e-3]
    assert {row["status"] for row in rows} == {"done"}
    code, out, err = call(capsys, "study", "plot", "powers.zarr", "power", "--boundary", 3e-3)
    assert (code, err) == (0, "")
    assert Path("study.png").read_bytes()[1:4] == b"PNG"
    code, out, err = call(capsys, "study", study, "--workers", 0, "--picture", "power")
    assert (code, out.splitlines()[-1], err) == (0, "powers.png: power", "")
    assert Path("powers.png").read_bytes()[1:4] == b"PNG"


@pytest.mark.parametrize(
    ("edit", "arguments", "told"),
    [
        (("powers:power", "powers:none"), (), "'powers:none' cannot be imported"),
        (('"laser.power"', '"laser.tower"'), (), "laser.tower .* did you mean power"),
        (("[axes]", "[lines]"), (), "lines = .* is an unknown key"),
        (
            ("powers:power", "powers:power"),
            ("--out", "powers.py"),
            "powers.py: .* cannot be written",
        ),
    ],
)
def test_bad_study_is_one_line(edit, arguments, told: str, study: Path, capsys) -> None:
    study.write_text(study.read_text().replace(*edit))
    code, out, err = call(capsys, "study", study, "--workers", 0, *arguments)
    assert (code, out) == (shell.BAD_INPUT, "")
    assert err.startswith("nlosoptics: ")
    assert err.count("\n") == 1
    assert re.search(told, err)


def test_failed_points_are_counted(study: Path, capsys) -> None:
    study.write_text(study.read_text().replace('"powers:power"', '"powers:power", "powers:fails"'))
    code, out, _ = call(capsys, "study", study, "--workers", 0)
    assert code == 0
    assert "6 points: 6 done" in out
    assert "6 x fails: ValueError: never" in out


def test_a_study_without_any_value_is_a_failure(study: Path, capsys) -> None:
    study.write_text(study.read_text().replace("powers:power", "powers:fails"))
    code, _, err = call(capsys, "study", study, "--workers", 0)
    assert code == 1
    assert "every figure of every point failed" in err


def test_interrupt_keeps_what_is_done(study: Path, capsys) -> None:
    (study.parent / "powers.py").write_text(
        "import time\ndef power(point):\n    time.sleep(0.2)\n    return point.scene.laser.power\n"
    )
    study.write_text(study.read_text().replace("[2, 4]", "[2, 4, 8, 16]"))

    def first_chunk() -> None:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not list(Path("powers.zarr/status/c").rglob("0/0")):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=first_chunk)
    thread.start()
    code, out, err = call(capsys, "study", study, "--workers", 0)
    thread.join()
    assert code == shell.INTERRUPTED
    assert "pending" in out
    assert err == "nlosoptics: interrupted; the same command continues\n"
    code, out, _ = call(capsys, "study", study, "--workers", 0)
    assert code == 0
    assert "12 points: 12 done" in out


@pytest.mark.thorough
def test_plot_has_a_picture_for_each_kind(study: Path, capsys) -> None:
    assert call(capsys, "study", study, "--workers", 0)[0] == 0
    for more in (("--kind", "slices"), ("--contours", "0.002,0.004"), ("--kind", "gallery")):
        code, out, err = call(
            capsys, "study", "plot", "powers.zarr", "power", *more, "--out", f"{more[1]}.png"
        )
        assert (code, err) == (0, "")
        assert Path(f"{more[1]}.png").read_bytes()[1:4] == b"PNG"
    for more, told in (
        (("--kind", "slices", "--contours", "1"), "contours belong to a map"),
        (("--kind", "slices", "--x", "a"), "--x and --y belong to a map"),
        (("--at", "laser.power=9 W"), "laser.power has no step '9 W'; give one of"),
        (("--contours", "a,b"), "'a,b' is not a list of numbers; give for example"),
        (("--kind", "sobol"), "Sobol indices needs a study with .draws. alone"),
        (("--kind", "tornado"), "sensitivities need a study with one_at_a_time alone"),
    ):
        code, out, err = call(capsys, "study", "plot", "powers.zarr", "power", *more)
        assert (code, out) == (2, "")
        assert re.search(told, err)
        assert err.count("\n") == 1


@pytest.mark.thorough
def test_saltelli_draws_are_plotted_as_sobol_indices(study: Path, capsys, monkeypatch) -> None:
    drawn = [f'"{a}" = {{ from = {v}, to = {w} }}' for a, v, w in (
        ("laser.power", '"1 mW"', '"2 mW"'), ("camera.f_number", 2, 4))]  # fmt: skip
    text = study.read_text().partition("[axes]")[0]
    text += '[draws]\ncount = 8\nmethod = "saltelli"\n[draws.of]\n' + "\n".join(drawn)
    study.write_text(text)
    assert call(capsys, "study", study, "--workers", 0)[0] == 0
    seen = []
    monkeypatch.setattr(
        "nlosoptics.views.studies.tornado", lambda found, label: seen.append((found, label)) or 1
    )
    monkeypatch.setattr("nlosoptics.views.save", lambda axes, out: None)
    assert call(capsys, "study", "plot", "powers.zarr", "power")[0] == 0
    ((found, label),) = seen
    assert label == "power"
    # the figure is the power itself; 8 draws leave an error of the order of 1/8
    assert found["total"].values == pytest.approx([1.0, 0.0], abs=0.3)


@pytest.mark.thorough
def test_report_is_written_next_to_the_caller(study: Path, capsys) -> None:
    assert call(capsys, "study", study, "--workers", 0)[0] == 0
    code, out, err = call(capsys, "study", "report", "powers.zarr", "--no-gallery")
    assert (code, err) == (0, "")
    assert out.startswith("powers.html: ")
    assert Path("powers.html").read_text().startswith("<!DOCTYPE html>")
    code, out, err = call(capsys, "study", "report", "powers.zarr", "--out", "page.txt")
    assert (code, out) == (2, "")
    assert "page.txt does not end in .html" in err
    code, out, err = call(capsys, "study", "report", "nothing.zarr")
    assert (code, out) == (2, "")
    assert "nothing.zarr has no results of a study" in err


SEARCH = """[optimise]
method = "nsga-ii"
evaluations = 12
population = 4
objectives = [{ figure = "power", goal = "minimise" }, { figure = "gap", goal = "minimise" }]
[optimise.variables]
"laser.power" = { from = "1 mW", to = "9 mW" }
"""


@pytest.fixture
def search(study: Path) -> Path:
    """A search of the least power and the least distance from 9 mW."""
    (study.parent / "gaps.py").write_text(  # Python keeps a module of a name that it has read
        "import time\n"
        "def power(point):\n    time.sleep(0.05)\n    return point.scene.laser.power\n"
        "def gap(point):\n    return 9e-3 - point.scene.laser.power\n"
    )
    text = study.read_text().replace('"powers:power"', '"gaps:power", "gaps:gap"')
    study.write_text(text.partition("[axes]")[0] + SEARCH)
    return study


@pytest.mark.thorough
def test_search_is_stopped_resumed_and_drawn(search: Path, capsys) -> None:
    code, out, err = call(capsys, "study", search, "--plan")
    assert (code, err) == (0, "")
    assert "points         12, 2 figures each" in out
    assert not Path("powers.zarr").exists()

    def few_trials() -> None:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not list(Path("powers.zarr/status/c").rglob("0/0")):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=few_trials)
    thread.start()
    code, out, err = call(capsys, "study", search, "--workers", 0)
    thread.join()
    assert code == shell.INTERRUPTED
    assert "search: running; " in out
    assert err == "nlosoptics: interrupted; the same command continues\n"
    code, _, err = call(capsys, "study", "optimum", "powers.zarr")
    assert (code, err.count("\n")) == (shell.BAD_INPUT, 1)
    code, out, err = call(capsys, "study", search, "--workers", 0)
    assert (code, err) == (0, "")
    # both objectives fall and rise with the power, so that every trial is on the front
    assert "search: 12 evaluations; 12 trials, 12 feasible, 0 failed" in out
    assert len(re.findall(r"^trial \d+: power [\d.e-]+, gap", out, re.MULTILINE)) == 12
    assert call(capsys, "study", "status", "powers.zarr") == (0, out, "")
    code, out, err = call(capsys, "study", "optimum", "powers.zarr", "--out", "front.svg")
    assert (code, err) == (0, "")
    assert "<svg" in Path("front.svg").read_text()
    assert call(capsys, "study", "export", "powers.zarr", "table.csv")[0] == 0
    with Path("table.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 12
    code, _, err = call(capsys, "study", "plot", "powers.zarr", "power")
    assert (code, err.count("\n")) == (shell.BAD_INPUT, 1)
    assert "use nlosoptics study optimum" in err
