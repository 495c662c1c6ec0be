"""Killed commands leave the old or the new result; `kills` tests any number of moments."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from .commands import COMMANDS, Command
from .stage import Outcome, Stage

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="processes are forked after numba was loaded"
)


def _inputs(folder: Path) -> None:
    (folder / "scene.toml").write_text("")


def _careless(value: str) -> int:
    """Write two files in place, by way of a hidden one that the next run does not know."""
    folder = Path("result")
    folder.mkdir(exist_ok=True)
    for name in ("a", "b"):
        draft = folder / f".{name}.{os.getpid()}"
        draft.write_text(value)
        draft.replace(folder / name)
    return 0


def _careful(value: str) -> int:
    """Write two files as a whole."""
    from nlosoptics._whole_files import whole_folder

    with whole_folder(Path("result")) as new:
        for name in ("a", "b"):
            (new / name).write_text(value)
    return 0


def outcomes(run, moments: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Outcome]:
    """Outcomes of SIGKILL at random operations."""
    command = Command("result", ("1",), ("2",), _inputs, run=run)
    monkeypatch.setitem(COMMANDS, "trap", command)
    with warnings.catch_warnings():
        # The forked process takes no lock that another thread may hold.
        warnings.simplefilter("ignore", DeprecationWarning)
        stage = Stage("trap", folder / "trap")
        return [stage.moment(3 * number + 1, "kill") for number in range(moments)]


def test_faults_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = outcomes(_careless, 20, tmp_path, monkeypatch)
    told = " ".join(one.fault for one in found)
    assert "leaves mixed: result/" in told
    assert {one.kind for one in found} >= {"mixed", "none"}


def test_a_whole_folder_has_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = outcomes(_careful, 20, tmp_path, monkeypatch)
    assert [one for one in found if one.fault] == []
    assert {one.kind for one in found} == {"none", "old", "new"}


def test_moments_repeat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, again = (outcomes(_careless, 5, tmp_path / name, monkeypatch) for name in "ab")
    assert [o.kind for o in one] == [o.kind for o in again]


@pytest.mark.thorough
def test_killed_commands_leave_an_old_or_a_new_result() -> None:
    """A few moments of the two quickest commands, one of which keeps a state to go on from."""
    words = ["--moments", "3", "--commands", "report", "reconstruct"]
    told = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.kills", *words],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    assert told.stdout.count("; 0 faults") >= 4  # kill and term; full and locked need a tmpfs
