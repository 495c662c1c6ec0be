"""A writing command that is disturbed in forked processes, and what it leaves."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import sys
import tempfile
import time
import weakref
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .commands import COMMANDS, contents, lasting, of_target

SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM}
ENDS = (*SIGNALS, "full", "locked")
WAYS = ("time", "operation", "change")
GLANCE = 5e-4  # time between two looks at the folder, s; the command may need the same core
SOON = 0.05  # longest time between the first change of the folder and the signal, s
LONGEST = 120.0  # time after which a command hangs, s
#: Audited operations that change files. Python announces each before it happens.
CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate")
PAGE = 4096  # bytes that a tmpfs allocates at once
NEW_NAMESPACE, PRIVATE = 0x20000, 0x44000  # CLONE_NEWNS; MS_PRIVATE and MS_REC
READ_ONLY, REMOUNT = 1, 32  # MS_RDONLY, MS_REMOUNT


class Outcome(NamedTuple):
    """What one moment led to: kind of the destination, and a fault if there is one."""

    number: int
    kind: str
    fault: str = ""


class Ended(NamedTuple):
    """End of a command: exit code, or minus a signal, and what it printed on stderr."""

    code: int
    told: str
    seconds: float


def _nothing(*_: Any) -> None:
    pass


class Stage:
    """One command in a process that has loaded all modules and kernels, and forks for each run.

    Parameters
    ----------
    name : str
        Name in `COMMANDS`.
    folder : Path
        Folder for all files; it must not exist.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self._name, self._command, self._folder = name, COMMANDS[name], folder
        self._work, self._scratch = folder / "work", folder / "scratch"
        self._work.mkdir(parents=True)
        self._command.make(self._work)
        self._before = {False: self._copied("inputs")}
        # in this process, so that forked ones find everything loaded
        here = Path.cwd()
        os.chdir(self._work)
        with Path(os.devnull).open("w") as quiet, redirect_stdout(quiet), redirect_stderr(quiet):
            if self._command.run(*self._command.old) or self._command.run(*self._command.new):
                sys.exit(f"{name}: the undisturbed command failed")
        os.chdir(here)
        self._start(old=False)
        self._undisturbed(self._command.old)
        self._before[True] = self._copied("old")
        self._after, self._seconds, self._operations = {}, {}, {}
        for old in (False, True):
            self._start(old)
            self._seconds[old] = self._undisturbed(self._command.new)
            self._operations[old] = int((self._folder / "count").read_text())
            self._after[old] = self._copied(f"new_{old}")

    def moment(self, number: int, end: str) -> Outcome:
        """Disturb the command once, look at what it left, and run it again."""
        draw = np.random.default_rng([number, *f"{self._name} {end}".encode()])
        old = bool(draw.random() < 0.7)
        self._start(old)
        if end in SIGNALS:
            ended = self._signalled(SIGNALS[end], WAYS[number % len(WAYS)], old, draw)
        else:
            ended = self._mounted(end, draw.uniform(0.0, 1.1), old)
        kind, fault = self._kind(old, end, ended), self._rudeness(end, ended)
        if kind.startswith("mixed"):
            fault = f"exit {ended.code} leaves {kind}; {ended.told}"
        if not fault:
            again = self._run(self._command.new)
            fault = f"next run: exit {again.code}: {again.told}" if again.code else self._rest(old)
        return Outcome(number, kind.split(":")[0], fault)

    def _copied(self, name: str) -> Path:
        return Path(shutil.copytree(self._work, self._folder / name))

    def _start(self, old: bool) -> None:
        """Put the inputs, and an old result if asked for, into the empty working folder."""
        for path in (self._work, self._scratch):
            shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(self._before[old], self._work)
        self._scratch.mkdir()

    def _undisturbed(self, words: tuple[str, ...]) -> float:
        """Run a command that must not fail and return its time, s."""
        ended = self._run(words)
        if ended.code:
            sys.exit(f"{self._name}: the undisturbed command failed: {ended.told}")
        return ended.seconds

    def _run(
        self,
        words: tuple[str, ...],
        *,
        disturb: Callable[[int], None] = _nothing,
        operation: int = -1,
        kind: int = 0,
        first: Callable[[], None] = _nothing,
        last: Callable[[], None] = _nothing,
    ) -> Ended:
        """Fork, run a command, and wait for its end.

        ``disturb`` is called with the process. The process sends itself the signal ``kind`` before
        the operation of this number; it calls ``first`` and ``last`` before and after the command.
        """
        told, start = self._folder / "stderr", time.monotonic()
        process = os.fork()
        if not process:
            code = 70
            try:
                with told.open("w") as err:
                    os.dup2(err.fileno(), 2)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                first()
                os.chdir(self._work)
                tempfile.tempdir = os.environ["TMPDIR"] = str(self._scratch)
                count = _counted(self._folder, operation, kind)
                code = self._command.run(*words)
                (self._folder / "count").write_text(str(count[0]))
                sys.stderr.flush()
                weakref.finalize._exitfunc()  # type: ignore[attr-defined]  # what `os._exit` skips
                last()
            except BaseException as error:
                os.write(2, f"Traceback: {error!r}".encode())
            finally:
                os._exit(code)
        disturb(process)
        while not os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            if time.monotonic() - start > LONGEST:
                os.kill(process, signal.SIGKILL)
            time.sleep(0.001)
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        seconds = time.monotonic() - start
        hung = f"it hung for {LONGEST:g} s" if seconds > LONGEST else ""
        return Ended(99 if hung else code, hung or told.read_text(), seconds)

    def _signalled(self, kind: int, way: str, old: bool, draw: np.random.Generator) -> Ended:
        share = float(draw.random())
        if way == "operation":
            number = int(share * self._operations[old])
            return self._run(self._command.new, operation=number, kind=kind)

        def disturb(process: int) -> None:
            if way == "time":
                time.sleep(share * self._seconds[old])
            else:
                before = _looked(self._work)
                while _looked(self._work) == before and not os.waitid(
                    os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT
                ):
                    time.sleep(GLANCE)
                time.sleep(share * SOON)
            os.kill(process, kind)

        return self._run(self._command.new, disturb=disturb)

    def _mounted(self, end: str, share: float, old: bool) -> Ended:
        """Run in a tmpfs that has room for a share of the new result, or is read-only."""
        new = of_target(contents(self._after[old]), self._command.target)
        size = _room(contents(self._before[old]).values()) + int(share * _room(new.values()))
        mirror = self._folder / "mirror"
        shutil.rmtree(mirror, ignore_errors=True)

        def first() -> None:
            _mount(self._work, size if end == "full" else 1 << 30)
            shutil.copytree(self._before[old], self._work, dirs_exist_ok=True)
            if end == "locked":
                _mount(self._work, 1 << 30, READ_ONLY | REMOUNT)

        ended = self._run(
            self._command.new, first=first, last=lambda: shutil.copytree(self._work, mirror)
        )
        shutil.rmtree(self._work)
        mirror.rename(self._work)
        return ended

    def _kind(self, old: bool, end: str, ended: Ended) -> str:
        """Return the kind of the destination; "mixed: ..." is neither an old nor a new result."""
        command = self._command
        if command.parts is not None:
            least = command.parts(self._before[old] / command.target) if old else {}
            try:
                here = command.parts(self._work / command.target)
            except Exception as error:
                return f"mixed: {error}" if old else "none"
            if least.items() <= here.items() <= self._parts(old).items():
                return f"{'all' if here == self._parts(old) else 'some'} parts"
            return "mixed: other parts"
        here, before, new = (
            of_target(contents(folder), command.target)
            for folder in (self._work, self._before[old], self._after[old])
        )
        if here == before:
            return "old" if old else "none"
        if lasting(here) == lasting(new):
            return "new"
        if old and self._without_state(here) == self._without_state(before):
            return "old, with a new state"
        record = lasting(here).get(f"{command.target}/result.json", {})
        status = record.get("status") if isinstance(record, dict) else None
        if status == "running" and not old:
            return "marked as running"
        if end == "term" and (status == "interrupted" or "best network so far" in ended.told):
            return "marked as interrupted"
        return f"mixed: {_difference(here, before)}"

    def _without_state(self, found: dict[str, bytes]) -> dict[str, Any]:
        """Return a result without the state of a fit and the list of its files."""
        told = {n: v for n, v in lasting(found).items() if Path(n).name not in self._command.state}
        record = told.get(f"{self._command.target}/result.json")
        if isinstance(record, dict):
            record.pop("files", None)
        return told

    def _parts(self, old: bool) -> Any:
        assert self._command.parts is not None
        return self._command.parts(self._after[old] / self._command.target)

    def _rudeness(self, end: str, ended: Ended) -> str:
        """Return what is wrong with the end of a command that could tell and clean up."""
        if end == "kill" or ended.code == -signal.SIGTERM:  # before the program could handle it
            return "" if ended.code <= 0 else f"exit {ended.code}: {ended.told}"
        if ended.code not in (0, 1, 2) or "Traceback" in ended.told:
            return f"exit {ended.code}: {ended.told}"
        if ended.code and ended.told.count("\n") != 1:
            return f"not one line: {ended.told}"
        left = self._left(self._before[True], self._after[True], self._after[False])
        return f"exit {ended.code} leaves {left}" if left else ""

    def _left(self, *known: Path) -> str:
        """Return a file or an empty folder that is in none of the known folders, or ""."""
        names = {name for folder in known for name in contents(folder)}
        found = contents(self._work).keys() - names
        if self._command.parts is not None:  # parts are files; only a temporary name is wrong
            found = {name for name in found if "partial" in name or "/" not in name}
        return min([*found, *(f"temporary {name}" for name in contents(self._scratch))], default="")

    def _rest(self, old: bool) -> str:
        """Return in what the working folder differs from that after an undisturbed run."""
        if left := self._left(self._after[old]):
            return f"the next run leaves {left}"
        if self._command.parts is not None:
            here = self._command.parts(self._work / self._command.target)
            return "" if here == self._parts(old) else "the next run has other parts"
        found = _difference(contents(self._work), contents(self._after[old]))
        return f"the next run differs: {found}" if found else ""


def _counted(inside: Path, operation: int, kind: int) -> list[int]:
    """Count operations on files in this process; send it a signal before one of them."""
    count, process, place = [0], os.getpid(), str(inside)

    def audit(event: str, given: tuple[Any, ...]) -> None:
        if event in CHANGES or (event == "open" and _writes(given, place)):
            if os.getpid() == process and count[0] == operation:
                count[0] += 1
                os.kill(process, kind)
            else:
                count[0] += 1

    sys.addaudithook(audit)
    return count


def _writes(given: tuple[Any, ...], place: str) -> bool:
    """Whether an audited opening of a file writes in a folder."""
    path, _, flags = given
    if not isinstance(path, str) or not (flags or 0) & (os.O_WRONLY | os.O_RDWR):
        return False
    return path.startswith(place) or not path.startswith("/")


def _looked(folder: Path) -> list[Any]:
    """Return names and times of a folder's entries, and of theirs."""
    found: list[Any] = []
    for place in (folder, *(path for path in folder.iterdir() if path.is_dir())):
        try:
            found += sorted((e.path, e.stat().st_mtime_ns) for e in os.scandir(place))
        except FileNotFoundError:
            found.append(place)
    return found


def _room(files: Iterable[bytes]) -> int:
    """Return the room that files take in a tmpfs, bytes."""
    return PAGE * sum(-(-len(held) // PAGE) for held in files)


def can_mount() -> bool:
    """Whether a process may mount a tmpfs for itself alone: Linux, as root."""
    if not sys.platform.startswith("linux") or os.geteuid():
        return False
    process = os.fork()
    if not process:
        try:
            _mount(Path(tempfile.gettempdir()), 1 << 20)
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(process, 0)[1] == 0


def _mount(folder: Path, size: int, flags: int = 0) -> None:
    """Mount a tmpfs that only this process and its children see."""
    system = ctypes.CDLL(None, use_errno=True)
    if not flags and (system.unshare(NEW_NAMESPACE) or system.mount(b"", b"/", b"", PRIVATE, b"")):
        raise OSError(ctypes.get_errno(), "no namespace for a tmpfs")
    told = f"size={size}".encode()
    if system.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", flags, told):
        raise OSError(ctypes.get_errno(), "no tmpfs")


def _difference(found: dict[str, bytes], wanted: dict[str, bytes]) -> str:
    """Return the first name with different content, and how it differs."""
    here, there = lasting(found), lasting(wanted)
    for name in sorted({*here, *there}):
        if name not in here or name not in there:
            return f"{name} is {'missing' if name in there else 'new'}"
        if here[name] != there[name]:
            return f"{name} has other content"
    return ""
