"""Folders that are written whole, whatever ends the process."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nlosoptics import _whole_files
from nlosoptics._whole_files import whole_folder

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no kill -9")

NAMES = ("a.txt", "b/c.txt", "z.txt")
WRITER = """
import sys
from pathlib import Path
from nlosoptics import _whole_files
if sys.argv[2] == "steps":
    _whole_files._exchanged = lambda *_: False
print("ready", flush=True)
for turn in range(1_000_000):
    with _whole_files.whole_folder(Path(sys.argv[1])) as new:
        (new / "b").mkdir()
        for name in ("a.txt", "b/c.txt", "z.txt"):
            (new / name).write_text(str(turn))
"""


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("way", ["exchange", "steps"])
def test_killed_writers_leave_a_whole_folder_and_the_next_one_nothing_else(way, tmp_path):
    target, chance, turns = tmp_path / "result", random.Random(5), []
    with whole_folder(target) as new:
        (new / "b").mkdir()
        for name in NAMES:
            (new / name).write_text("-1")
    for _ in range(12):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(target), way], stdout=subprocess.PIPE
        )
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.1))
        writer.kill()
        writer.wait()
        writer.stdout.close()
        if way == "exchange":
            assert target.is_dir()  # at every moment
        _whole_files._sweep(tmp_path, ".result-*")  # what the next writer does first
        found = {(target / name).read_text() for name in NAMES}
        assert len(found) == 1, "old and new files are mixed"
        turns.append(int(found.pop()))
        assert not [name for name in hidden(tmp_path) if (tmp_path / name / "lock").exists()]
    assert max(turns) >= 0  # the writers came to write


def test_a_folder_in_use_is_not_swept(tmp_path):
    target = tmp_path / "result"
    with whole_folder(target) as new:
        (new / "slow.txt").write_text("slow")
        other = [sys.executable, "-c", WRITER.replace("1_000_000", "1"), str(target), "exchange"]
        subprocess.run(other, check=True, stdout=subprocess.DEVNULL)
        assert (target / "a.txt").read_text() == "0"
        assert (new / "slow.txt").exists()
    assert [path.name for path in target.iterdir()] == ["slow.txt"]
    assert not hidden(tmp_path)


def test_a_link_is_followed(tmp_path):
    real, link = tmp_path / "disk" / "result", tmp_path / "result"
    real.mkdir(parents=True)
    link.symlink_to(real)
    with whole_folder(link) as new:
        (new / "a.txt").write_text("1")
    assert link.is_symlink()
    assert (real / "a.txt").read_text() == "1"


def test_a_failure_leaves_the_old_folder(tmp_path):
    target = tmp_path / "result"
    with whole_folder(target) as new:
        (new / "a.txt").write_text("1")
    with pytest.raises(OSError, match="No such file"), whole_folder(target) as new:
        (new / "missing" / "a.txt").write_text("2")  # no such folder
    assert (target / "a.txt").read_text() == "1"
    assert not hidden(tmp_path)
