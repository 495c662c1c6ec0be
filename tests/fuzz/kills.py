"""Writing commands that are killed at random moments.

python -m tests.fuzz.kills [--moments 20] [--first 0] [--commands NAME ...] [--ends kill term]

After each end the destination must be the old or the new result as a whole, and the next run must
give what an undisturbed run gives and leave nothing else behind. The table counts what was found;
each fault is printed with the number that repeats it. Half of the moments are a random operation on
files, the other half a random time.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .commands import COMMANDS, ROOT, Contents, contents, lasting, of_target

ENDS = {"kill": signal.SIGKILL, "term": signal.SIGTERM}
#: Runs a command; sends itself a signal before the operation on files with a given number.
PROGRAM = """
import atexit, os, sys
wanted, kind, place = int(sys.argv[1]), int(sys.argv[2]), os.getcwd()
count = 0

def audit(event, given):
    global count
    path, writes = given[0] if given else "", event in ("os.rename", "os.remove", "os.mkdir")
    if event == "open":
        writes = isinstance(given[2], int) and bool(given[2] & (os.O_WRONLY | os.O_RDWR))
    if writes and isinstance(path, (str, os.PathLike)):
        if os.path.abspath(path).startswith(place):
            count += 1
            if count == wanted:
                os.kill(os.getpid(), kind)

sys.addaudithook(audit)
atexit.register(lambda: print(count))
sys.argv[1:] = sys.argv[3:]
exec(sys.argv.pop(1))
"""


class Outcome(NamedTuple):
    """What one moment led to: kind of the destination, and a fault if there is one."""

    number: int
    kind: str
    fault: str = ""


class Stage:
    """One command with its inputs, an old result and the new one, in a folder."""

    def __init__(self, name: str, folder: Path) -> None:
        self._name, self._command, self._folder = name, COMMANDS[name], folder
        self._work = folder / "work"
        self._work.mkdir(parents=True)
        self._command.make(self._work)
        self._before = {False: self._copied("inputs")}
        self._run(self._command.old)
        self._before[True] = self._copied("old")
        self._after, self._seconds, self._operations = {}, {}, {}
        for old in (False, True):
            self._start(old)
            start = time.monotonic()
            self._operations[old] = int(self._run(self._command.new).stdout.split()[-1])
            self._seconds[old] = time.monotonic() - start
            self._after[old] = self._copied(f"new_{old}")

    def moment(self, number: int, end: str) -> Outcome:
        """Disturb the command once, look at what it left, and run it again."""
        draw = np.random.default_rng([number, *f"{self._name} {end}".encode()])
        old, share = bool(draw.random() < 0.7), float(draw.random())
        self._start(old)
        if number % 2:
            operation = 1 + int(share * self._operations[old])
            told = self._run(self._command.new, operation, ENDS[end], check=False).stderr
        else:
            process = self._popen(self._command.new)
            time.sleep(share * self._seconds[old])
            process.send_signal(ENDS[end])
            told = process.communicate()[1]
        kind = self._kind(old)
        if kind.startswith("mixed") or "Traceback" in told:
            return Outcome(number, kind.split(":")[0], f"{kind}; {told}")
        again = self._run(self._command.new, check=False)
        if again.returncode:
            return Outcome(number, kind, f"next run: exit {again.returncode}: {again.stderr}")
        return Outcome(number, kind, self._difference(self._after[old]))

    def _copied(self, name: str) -> Path:
        return Path(shutil.copytree(self._work, self._folder / name))

    def _start(self, old: bool) -> None:
        """Put the inputs, and an old result if asked for, into the empty working folder."""
        shutil.rmtree(self._work)
        shutil.copytree(self._before[old], self._work)

    def _popen(self, words: tuple[str, ...], operation: int = 0, kind: int = 0) -> Any:
        code = ["-c", PROGRAM, str(operation), str(int(kind)), self._command.program]
        return subprocess.Popen(
            [sys.executable, *code, *words],
            cwd=self._work,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def _run(
        self, words: tuple[str, ...], operation: int = 0, kind: int = 0, *, check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        process = self._popen(words, operation, kind)
        out, told = process.communicate()
        if check and process.returncode:
            sys.exit(f"{self._name}: the undisturbed command failed: {told}")
        return subprocess.CompletedProcess(words, process.returncode, out, told)

    def _kind(self, old: bool) -> str:
        """Return the kind of the destination; "mixed: ..." is neither an old nor a new result.

        A folder may be away between two renames; the next run puts it back.
        """
        command = self._command
        if command.parts is not None:
            least = command.parts(self._before[old] / command.target) if old else {}
            most = command.parts(self._after[old] / command.target)
            try:
                here = command.parts(self._work / command.target)
            except Exception as error:
                return f"mixed: {error}" if old else "none"
            return "parts" if least.items() <= here.items() <= most.items() else "mixed: parts"
        here, before, new = (
            of_target(contents(folder), command.target)
            for folder in (self._work, self._before[old], self._after[old])
        )
        if here == before or not here:
            return "old" if old and here else "none"
        if lasting(here) == lasting(new):
            return "new"
        if old and self._without_state(here) == self._without_state(before):
            return "old, with a new state"
        record = lasting(here).get(f"{command.target}/result.json", {})
        status = record.get("status") if isinstance(record, dict) else None
        if status in ("running", "interrupted"):
            return status
        return f"mixed: {sorted(here)}"

    def _without_state(self, found: Contents) -> dict[str, Any]:
        """Return a result without the state of a fit and the list of its files."""
        told = {n: v for n, v in lasting(found).items() if Path(n).name not in self._command.state}
        record = told.get(f"{self._command.target}/result.json")
        if isinstance(record, dict):
            record.pop("files", None)
        return told

    def _difference(self, wanted: Path) -> str:
        """Return in what the working folder differs from that after an undisturbed run."""
        if self._command.parts is not None:
            here, there = (
                self._command.parts(folder / self._command.target)
                for folder in (self._work, wanted)
            )
            return "" if here == there else "the next run has other parts"
        here, there = lasting(contents(self._work)), lasting(contents(wanted))
        wrong = [name for name in {*here, *there} if here.get(name) != there.get(name)]
        return f"the next run differs: {sorted(wrong)}" if wrong else ""


def main() -> int:
    """Print a table of outcomes for each command and end; return 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=20, help="number for each command and end")
    parser.add_argument("--first", type=int, default=0, help="first number")
    parser.add_argument("--commands", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--ends", nargs="*", choices=ENDS, default=list(ENDS))
    options = parser.parse_args()
    faults = 0
    for name in options.commands:
        with tempfile.TemporaryDirectory() as folder:
            stage = Stage(name, Path(folder) / name)
            for end in options.ends:
                numbers = range(options.first, options.first + options.moments)
                found = [stage.moment(number, end) for number in numbers]
                bad = [one for one in found if one.fault]
                for one in bad:
                    print(f"  {name} {end} {one.number} ({one.kind}): {one.fault[:600]}")
                told = ", ".join(
                    f"{n} {kind}" for kind, n in Counter(o.kind for o in found).items()
                )
                print(f"{name}, {end}: {told}; {len(bad)} faults", flush=True)
                faults += len(bad)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
