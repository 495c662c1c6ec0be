"""Killed commands leave the old or the new result; `kills` tests any number of moments."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from .commands import COMMANDS, Command
from .kills import Outcome, Stage

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Windows has no kill -9"),
]
CARELESS = """
import os, sys
from pathlib import Path
folder = Path("result")
folder.mkdir(exist_ok=True)
for name in "ab":
    draft = folder / f".{name}.{os.getpid()}"
    draft.write_text(sys.argv[1])
    draft.replace(folder / name)
"""
CAREFUL = """
import sys
from pathlib import Path
from nlosoptics._whole_files import whole_folder
with whole_folder(Path("result")) as new:
    for name in "ab":
        (new / name).write_text(sys.argv[1])
"""


def outcomes(
    program: str, moments: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> list[Outcome]:
    """Outcomes of SIGKILL at random operations."""
    command = Command("result", ("1",), ("2",), lambda folder: None, program=program)
    monkeypatch.setitem(COMMANDS, "trap", command)
    stage = Stage("trap", folder / "trap")
    return [stage.moment(2 * number + 1, "kill") for number in range(moments)]


def test_faults_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = outcomes(CARELESS, 12, tmp_path, monkeypatch)
    assert {one.kind for one in found if one.fault} >= {"mixed"}


def test_a_whole_folder_has_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = outcomes(CAREFUL, 16, tmp_path, monkeypatch)
    assert [one for one in found if one.fault] == []
    assert {one.kind for one in found} >= {"none", "old"}


def test_a_killed_report_leaves_the_old_or_the_new_page(tmp_path: Path) -> None:
    stage = Stage("report", tmp_path / "report")
    assert [one for one in map(stage.moment, (1, 3, 5), 3 * ["kill"]) if one.fault] == []
