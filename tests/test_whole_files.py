"""Folders that are written whole, whatever ends the process."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import itertools
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nlosoptics import _whole_files
from nlosoptics._whole_files import whole_folder
from nlosoptics.errors import SceneError
from nlosoptics.scene import Scene

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no kill -9")

NAMES = ("a.txt", "b/c.txt", "z.txt")
WRITER = """
import sys
from pathlib import Path
from nlosoptics import _whole_files
if sys.argv[2] == "steps":
    _whole_files._exchanged = lambda *_: False
for turn in range(1_000_000):
    if turn == 1:
        print("wrote", flush=True)  # on a busy machine no earlier time is long enough
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


FILES_WRITER = """
import sys
from pathlib import Path
from nlosoptics._whole_files import write_whole
print("ready", flush=True)
for turn in range(1_000_000):
    write_whole({Path(sys.argv[1], name): (f"{turn} " * 20_000).encode() for name in "ab"})
"""


def test_killed_writers_leave_whole_files_and_the_next_one_nothing_else(tmp_path):
    chance = random.Random(7)
    for _ in range(6):
        writer = subprocess.Popen(
            [sys.executable, "-c", FILES_WRITER, str(tmp_path)], stdout=subprocess.PIPE
        )
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.05))
        writer.kill()
        writer.wait()
        writer.stdout.close()
        _whole_files.sweep(tmp_path / "a")  # finishes what was begun
        assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]
        if (tmp_path / "a").exists():
            one, other = ((tmp_path / name).read_text().split() for name in "ab")
            assert len(one) == 20_000
            assert len({*one, *other}) == 1, "old and new files are mixed"
    _whole_files.write_whole({tmp_path / name: b"last" for name in "ab"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_ctrl_c_between_two_files_does_not_part_them(tmp_path, monkeypatch):
    _whole_files.write_whole({tmp_path / name: b"old" for name in "ab"})
    replace = Path.replace

    def interrupted(self, to):
        if to.name == "b":
            monkeypatch.undo()
            raise KeyboardInterrupt
        return replace(self, to)

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _whole_files.write_whole({tmp_path / name: b"new" for name in "ab"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "a": b"new",
        "b": b"new",
    }


def test_a_scene_whose_saving_was_killed_has_its_own_picture(flat_scene, tmp_path, monkeypatch):
    path, replace = tmp_path / "room.toml", Path.replace
    flat_scene.save(path)
    other = dataclasses.replace(
        flat_scene.hidden, image=1.0 - flat_scene.hidden.reflectance, size=(0.2, 0.2)
    )

    class Killed(BaseException):
        pass

    def killed(self, to):
        if to.suffix == ".png":
            raise Killed
        return replace(self, to)

    with monkeypatch.context() as broken:
        broken.setattr(Path, "replace", killed)
        broken.setattr(_whole_files, "_remove", lambda folder: None)
        with pytest.raises(Killed):
            dataclasses.replace(flat_scene, hidden=other).save(path)
    assert hidden(tmp_path)
    loaded = Scene.load(path).hidden
    assert loaded.size == (0.2, 0.2)
    assert (loaded.reflectance == other.reflectance).all()
    assert not hidden(tmp_path)


def test_files_are_put_in_place_in_the_given_order(tmp_path, monkeypatch):
    """A list of files may go before what it lists."""
    placed, replace = [], Path.replace
    monkeypatch.setattr(
        Path, "replace", lambda self, to: placed.append(Path(to).name) or replace(self, to)
    )
    _whole_files.write_whole({tmp_path / name: b"" for name in ("z", "a", "m")})
    assert [name for name in placed if len(name) == 1] == ["z", "a", "m"]


def test_folders_of_dead_processes_inside_an_output_folder_are_no_foreign_files(tmp_path):
    """A killed `report` leaves its temporary folder in the folder of the result."""
    with whole_folder(tmp_path / "result") as new:
        (new / "result.json").write_text('{"files": ["result.json"]}')
    left = tmp_path / "result" / ".report.html-0123456789abcdef"
    left.mkdir()
    (left / "lock").write_text("")
    (left / "0.new").write_text("half a page")
    _whole_files.check_folder(tmp_path / "result")
    assert not left.exists()
    (tmp_path / "result" / ".report.html-mine").mkdir()
    with pytest.raises(SceneError, match="which nlosoptics did not write"):
        _whole_files.check_folder(tmp_path / "result")


def test_a_full_disk_is_one_line(tmp_path):
    told = r"result: cannot be written .No space left on device.; make room"
    with pytest.raises(SceneError, match=told), whole_folder(tmp_path / "result"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


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


STEPPED = """
import os, signal, sys
from pathlib import Path
from nlosoptics import _whole_files

what, wanted, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
if what == "steps":
    _whole_files._exchanged = lambda *_: False
step = [0]

def write(value):
    if what == "files":
        _whole_files.write_whole({folder / name: value for name in "ab"})
    else:
        with _whole_files.whole_folder(folder / "result") as new:
            for name in "ab":
                (new / name).write_bytes(value)

def audit(event, given):
    if event == "os.rename":
        step[0] += 1
        if step[0] == wanted:
            os.kill(os.getpid(), signal.SIGKILL)

write(b"old")
sys.addaudithook(audit)
write(b"new")
"""


@pytest.mark.parametrize(("what", "renames"), [("files", 3), ("steps", 2)])
def test_a_kill_before_each_rename_leaves_the_old_or_the_new_result(what, renames, tmp_path):
    """Files: first the list of their places is renamed. Folders: the old one, then the new one."""
    found = []
    for number in range(1, renames + 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        code = subprocess.run(
            [sys.executable, "-c", STEPPED, what, str(number), str(folder)], check=False
        ).returncode
        assert code == (-9 if number <= renames else 0)
        target = folder / ("a" if what == "files" else "result")
        _whole_files.sweep(target)
        parent = folder if what == "files" else target
        found.append({path.name: path.read_bytes() for path in parent.iterdir()})
        assert not hidden(folder)
    old, new = ({name: value for name in "ab"} for value in (b"old", b"new"))
    assert found == {"files": [old, new, new, new], "steps": [old, old, new]}[what]


class Interrupting:
    """A trace function that raises `KeyboardInterrupt` at the line with a given number."""

    FILES = tuple(map(str, (_whole_files.__file__, contextlib.__file__, shutil.__file__)))

    def __init__(self, number: int) -> None:
        self.number, self.line = number, 0

    def __call__(self, frame, event, _):
        if frame.f_code.co_name == "_finish_own":  # what it is for has happened
            sys.settrace(None)
        if not frame.f_code.co_filename.startswith(self.FILES):
            return None
        if event == "line":
            self.line += 1
            if self.line == self.number:
                raise KeyboardInterrupt
        return self


@pytest.fixture
def quick_collections():
    """Leave all that exists out of collections, which would take 0.3 s each after other tests."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("quick_collections")
@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")  # of interrupted closings
@pytest.mark.parametrize("what", ["files", "exchange", "steps"])
def test_an_interrupt_at_any_line_leaves_the_old_or_the_new_result(what, tmp_path, monkeypatch):
    """SIGTERM acts alike; one that comes while a folder is removed once left it there."""
    monkeypatch.setattr(_whole_files, "_written_through", lambda _: None)  # slow
    if what == "steps":
        monkeypatch.setattr(_whole_files, "_exchanged", lambda *_: False)
    target = tmp_path / ("a" if what == "files" else "result")

    def write(value: bytes) -> None:
        if what == "files":
            _whole_files.write_whole({tmp_path / name: value for name in "ab"})
        else:
            with whole_folder(target) as new:
                for name in "ab":
                    (new / name).write_bytes(value)

    write(b"old")
    kinds, before = [], sys.gettrace()
    for number in itertools.count(1):
        value = str(number).encode()
        tracer = Interrupting(number)
        sys.settrace(tracer)
        try:
            write(value)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(before)
        if hidden(tmp_path):
            gc.collect()  # the exception's frames
        place = tmp_path if what == "files" else target
        found = {path.name: path.read_bytes() for path in place.iterdir()}
        assert sorted(found) == ["a", "b"], f"line {number}"
        assert len({*found.values()}) == 1, f"line {number}: old and new files are mixed"
        assert not hidden(tmp_path), f"line {number}"
        kinds.append(found["a"] == value)
        if tracer.line < number:
            break
    assert kinds == sorted(kinds)  # old results, then new ones
    assert 30 < sum(kinds) < len(kinds) - 30


def test_an_undisturbed_end_needs_no_finalizer(tmp_path, monkeypatch):
    """Python prints an interrupt that comes while a finalizer runs, and goes on."""
    calls = []
    monkeypatch.setattr(_whole_files, "_finish_own", lambda *given: calls.append(given))
    with whole_folder(tmp_path / "result") as new:
        (new / "a").write_text("1")
    gc.collect()
    assert calls == []
