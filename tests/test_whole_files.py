"""Files and folders that are written whole, whatever ends the process."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time

import pytest

from nlosoptics import _whole_files
from nlosoptics._whole_files import SUFFIX, whole_folder
from nlosoptics.errors import SceneError

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no kill -9")

WRITER = """
import sys
from pathlib import Path
from nlosoptics._whole_files import whole_folder
for turn in range(int(sys.argv[2])):
    if turn == 1:
        print("wrote", flush=True)  # on a busy machine no earlier time is long enough
    with whole_folder(Path(sys.argv[1])) as new:
        (new / "b").mkdir()
        for name in ("a.txt", "b/c.txt", "z.txt"):
            (new / name).write_text(str(turn))
"""


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_killed_writers_leave_a_whole_folder_and_the_next_one_nothing_else(tmp_path):
    target, chance = tmp_path / "result", random.Random(5)
    for _ in range(6):
        command = [sys.executable, "-c", WRITER, str(target), "1000000"]
        writer = subprocess.Popen(command, stdout=subprocess.PIPE)
        writer.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.1))
        writer.kill()
        writer.wait()
        writer.stdout.close()
        _whole_files.sweep(target)  # what the next writer or reader does first
        found = {(target / name).read_text() for name in ("a.txt", "b/c.txt", "z.txt")}
        assert len(found) == 1, "old and new files are mixed"
        assert not hidden(tmp_path)


STEPPED = """
import os, signal, sys
from pathlib import Path
from nlosoptics._whole_files import whole_folder

ending, wanted, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
step = 0

def write(value):
    with whole_folder(folder / "result") as new:
        for name in "ab":
            (new / name).write_bytes(value)

def audit(event, given):
    global step
    if event == "os.rename":
        step += 1
        if step == wanted:
            if ending == "interrupt":
                raise KeyboardInterrupt
            os.kill(os.getpid(), signal.SIGKILL)

write(b"old")
sys.addaudithook(audit)
try:
    write(b"new")
except KeyboardInterrupt:
    pass
"""


@pytest.mark.parametrize("ending", ["kill", "interrupt"])
def test_an_end_before_each_rename_leaves_the_old_or_the_new_folder(ending, tmp_path):
    """The old folder is moved aside, then the new one comes in its place."""
    for number, expected in enumerate((b"old", b"old", b"new"), start=1):
        folder = tmp_path / str(number)
        folder.mkdir()
        command = [sys.executable, "-c", STEPPED, ending, str(number), str(folder)]
        code = subprocess.run(command, check=False).returncode
        assert code == (-9 if ending == "kill" and number < 3 else 0)
        if ending == "kill":
            _whole_files.sweep(folder / "result")
        assert not hidden(folder)
        found = {path.name: path.read_bytes() for path in (folder / "result").iterdir()}
        assert found == {"a": expected, "b": expected}


def test_a_failure_changes_nothing(tmp_path):
    target = tmp_path / "result"
    with whole_folder(target) as new:
        (new / "a.txt").write_text("1")
    with pytest.raises(OSError, match="No such file"), whole_folder(target) as new:
        (new / "missing" / "a.txt").write_text("2")  # no such folder
    told = r"result: cannot be written .No space left on device.; make room"
    with pytest.raises(SceneError, match=told), whole_folder(target):
        raise OSError(28, "No space left on device")
    assert (target / "a.txt").read_text() == "1"
    assert not hidden(tmp_path)


def test_files_are_put_in_place_once_all_are_complete(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    _whole_files.write_whole({first: b"old", second: b"old"})
    with pytest.raises(SceneError, match=r"there is no folder .*; make it first"):
        _whole_files.write_whole({first: b"new", tmp_path / "missing" / "c": b"new"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "a": b"old",
        "b": b"old",
    }
    _whole_files.write_whole({first: b"new", second: b"new"})
    assert sorted(path.read_bytes() for path in tmp_path.iterdir()) == [b"new", b"new"]


def test_folders_of_dead_processes_inside_an_output_folder_are_no_foreign_files(tmp_path):
    """A killed `report` leaves its temporary folder in the folder of the result."""
    with whole_folder(tmp_path / "result") as new:
        (new / "result.json").write_text('{"files": ["result.json"]}')
    left = tmp_path / "result" / f".report.html-0123abcd{SUFFIX}"
    left.mkdir()
    (left / "new").write_text("half a page")
    _whole_files.check_folder(tmp_path / "result")
    assert not left.exists()
    (tmp_path / "result" / ".report.html-mine").mkdir()
    with pytest.raises(SceneError, match="which nlosoptics did not write"):
        _whole_files.check_folder(tmp_path / "result")


def test_a_folder_in_use_is_not_swept(tmp_path):
    target = tmp_path / "result"
    with whole_folder(target) as new:
        (new / "slow.txt").write_text("slow")
        subprocess.run([sys.executable, "-c", WRITER, str(target), "1"], check=True)
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
