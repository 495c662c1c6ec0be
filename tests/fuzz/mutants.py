"""Random small changes of the package, each tested by the tests that execute the changed line.

python -m tests.fuzz.mutants [--number 100] [--seed 0] [--rooms NAME ...] [--seconds 60]
                             [--results FILE] [--thorough]

The changes are drawn in turn from the rooms, each change of a room with equal probability. Test
files of a room are run once without any change, to record which lines each test executes and how
long it takes; a record holds until the file or a module that it calls is edited. A change is then
tested by the file's doctests and the tests that execute its statement, the quickest first, until
``--seconds`` of their time are reached. Compiled code, default values and values of modules and
classes leave no trace of their own: they are tested by all tests that execute a line of the file or
of a file that imports it. A run that takes over three times as long as expected has timed out, and
counts as killed.

The table counts killed and surviving changes, with the 95 % interval of their rate. Changes of
`equivalent_mutants.toml` alter no result, for the reason given there, and are not run.
``--results`` names a file of JSON lines that keeps the outcomes; changes in it are not run again.
Tests that are marked thorough take part with ``--thorough`` only.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from .readers import ROOT
from .source_changes import Change, changes

ROOMS = ("psf", "raytrace", "transient", "inverse", "imaging")
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
COPIED = ("nlosoptics", "tests", "examples", "pyproject.toml")
ALLOWANCE = 60.0  # s of a run to load libraries and compile
Row = dict[str, Any]


def sample(root: Path, rooms: list[str], seed: int, number: int) -> list[Change]:
    """Return random changes, drawn in turn from each room; more of them begin with the same."""
    drawn = []
    for turn, room in enumerate(rooms):
        found: dict[tuple[str, ...], Change] = {}
        for file in sorted((root / "nlosoptics" / room).rglob("*.py")):
            if file.name != "__init__.py":
                source = file.read_text()
                for one in changes(str(file.relative_to(root / "nlosoptics")), source):
                    found.setdefault(identity(described(one, source)), one)
        all_of_room = [*found.values()]
        order = np.random.default_rng([seed, *room.encode()]).permutation(len(all_of_room))
        drawn += [(place, turn, all_of_room[index]) for place, index in enumerate(order)]
    return [change for *_, change in sorted(drawn)][:number]


def described(change: Change, source: str) -> Row:
    """Return what names a change in results and in the list of equivalent ones."""
    before, after = change.lines(source)
    place = {"file": change.file, "line": change.line(source), "kind": change.kind}
    return place | {"before": before, "after": after}


def identity(row: Row) -> tuple[str, ...]:
    """Return what stays the same while other lines of the file change."""
    return tuple(row[key] for key in ("file", "before", "after"))


class Bench:
    """Copy of the checkout, in which changes are made and tested, and the records of its tests."""

    def __init__(self, root: Path, folder: Path, *options: str) -> None:
        self._options = options  # of pytest
        self.folder, self._file = folder / "copy", folder / "tests.json"
        self._known = json.loads(self._file.read_text()) if self._file.is_file() else {}
        self._update(root)
        self._users = importers(self.folder / "nlosoptics")

    def _update(self, root: Path) -> None:
        """Give the copy the files of a checkout, and forget what edits have made stale."""
        users, old = importers(root / "nlosoptics"), self.folder / "nlosoptics"
        new = [path for name in COPIED for path in [root / name, *(root / name).rglob("*")]]
        names = {str(path.relative_to(root)) for path in new if path.is_file()}
        names = {name for name in names if "__pycache__" not in name}
        for path in [*self.folder.rglob("*")]:
            if path.is_file() and "__pycache__" not in path.parts:
                names.add(str(path.relative_to(self.folder)))
        for name in names:
            if fingerprint(root / name) != fingerprint(self.folder / name):
                (self.folder / name).unlink(missing_ok=True)
                if name.startswith("nlosoptics/"):
                    forget_compiled(old, reach(name.removeprefix("nlosoptics/"), users))
                if (root / name).is_file():
                    (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(root / name, self.folder / name)

    def run(self, change: Change, most: float) -> Row:
        """Make a change, run the tests that reach it, undo it, and tell what happened."""
        package = self.folder / "nlosoptics"
        file = package / change.file
        source, times = file.read_text(), file.stat()
        stale, compiled = reach(change.file, self._users), is_kernel(change.file)
        lines = set() if compiled else statement(source, change.line(source))
        chosen, expected = [], 0.0
        for seconds, test in sorted(self._callers(change.file, lines, stale)):
            if chosen and expected + seconds > most:
                break
            chosen.append(test)
            expected += seconds
        if ">>> " in source:
            chosen.insert(0, f"nlosoptics/{change.file}")
        told: Row = {"outcome": "survived", "by": "", "tests": len(chosen)}
        if not chosen:
            return told
        forget_compiled(package, stale)
        try:
            file.write_text(change.applied(source))
            code, output = run_tests(
                self.folder, chosen, 3.0 * expected + ALLOWANCE, "-x", *self._options
            )
        finally:
            file.write_text(source)
            os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))  # by which numba's cache goes
            forget_compiled(package, stale)
        if code == 0:
            return told
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        by = failed[1] if failed else ""
        return told | {"outcome": "killed" if code in (1, 2, 3, 4) else "timed out", "by": by}

    def _callers(self, file: str, lines: set[int], users: set[str]) -> list[tuple[float, str]]:
        """Return the times and addresses of tests of the room that execute one of the lines.

        Without lines: one of the file's or of those that import it.
        """
        found = set()
        for path in sorted((self.folder / "tests" / file.split("/")[0]).rglob("test_*.py")):
            record = self._record(path)
            for test, told in record["tests"].items():
                if lines:
                    reached = lines & {*told["lines"].get(file, ())}
                else:
                    reached = users & {*told["lines"]} or Path(file).stem in path.read_text()
                if reached:
                    found.add((told["seconds"], test))
        return [*found]

    def _record(self, path: Path) -> Row:
        """Return seconds and lines of each passing test of a file, from a run or an earlier one."""
        name = str(path.relative_to(self.folder))
        record = self._known.get(name, {"prints": {name: ""}})
        if any(fingerprint(self.folder / one) != kept for one, kept in record["prints"].items()):
            written = self.folder.parent / "run.json"
            written.unlink(missing_ok=True)
            options = ("-p", "tests.fuzz.line_records", *self._options)
            run_tests(self.folder, [name], 1200.0, *options, record=written)
            tests = json.loads(written.read_text()) if written.is_file() else {}
            called = {f"nlosoptics/{file}" for told in tests.values() for file in told["lines"]}
            prints = {one: fingerprint(self.folder / one) for one in (name, *sorted(called))}
            self._known[name] = record = {"tests": tests, "prints": prints}
            self._file.write_text(json.dumps(self._known))
        return record


def run_tests(
    folder: Path, tests: list[str], seconds: float, *options: str, record: Path | None = None
) -> tuple[int, str]:
    """Run tests of a checkout in a process of its own; return its exit code and its output."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "LINE_RECORDS": str(record or "")}
    environment |= {"PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)  # compiled functions lie beside the copied sources
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "--tb=no"]
    command += ["--hypothesis-seed=0", "--assert=plain", *options, *tests]

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 10))
        resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))

    try:
        ended = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=5.0 * seconds,
            preexec_fn=limit,
        )
    except subprocess.TimeoutExpired:
        return -9, ""
    return ended.returncode, ended.stdout


def statement(source: str, line: int) -> set[int]:
    """Return the lines of the innermost statement of a function that holds a line.

    They are none for a line outside a function's body, such as a default value.
    """
    inner = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0)
    ]
    functions = [node for node in inner if isinstance(node, ast.FunctionDef)]
    if not functions or line < functions[-1].body[0].lineno:
        return set()
    body = getattr(inner[-1], "body", None)  # a condition, not what depends on it
    last = max(inner[-1].lineno, body[0].lineno - 1) if body else inner[-1].end_lineno
    return {*range(inner[-1].lineno, (last or 0) + 1)}


def importers(package: Path) -> dict[str, set[str]]:
    """Return for each file of the package the files that import from it, relative paths."""
    found: dict[str, set[str]] = {}
    for file in package.rglob("*.py"):
        here = file.relative_to(package)
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = file.parents[node.level - 1] / (node.module or "").replace(".", "/")
                for name in (base.with_suffix(".py"), *(base / f"{n.name}.py" for n in node.names)):
                    if name.is_file():
                        found.setdefault(str(name.relative_to(package)), set()).add(str(here))
    return found


def is_kernel(file: str) -> bool:
    """Whether a file of the package may hold compiled functions."""
    return file.startswith("kernels/") or file.endswith("_kernels.py")


def reach(file: str, users: dict[str, set[str]]) -> set[str]:
    """Return a file, and all that import it directly or through files of kernels."""
    found, todo = {file}, [file]
    while todo:
        for user in users.get(todo.pop(), set()) - found:
            found.add(user)
            if is_kernel(user):
                todo.append(user)
    return found


def forget_compiled(package: Path, files: set[str]) -> None:
    """Remove the compiled functions of files.

    numba looks only at the time of the file in which a function is written, although callees of
    other files are inlined.
    """
    for path in (package / file for file in files):
        for kept in path.parent.glob(f"__pycache__/{path.stem}.*.nb[ic]"):
            kept.unlink()


def fingerprint(file: Path) -> str:
    """Return a hash of a file, or nothing if there is none."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""


def table(rows: list[Row]) -> str:
    """Return the counts of each room and of all, then survivors and equivalent changes."""
    kinds = ("killed", "timed out", "survived", "equivalent")
    told = [f"{'room':10}" + "".join(f"{head:>12}" for head in (*kinds, "kill rate", "95 %"))]
    for room in [*dict.fromkeys(row["file"].split("/")[0] for row in rows), ""]:
        count = Counter(r["outcome"] for r in rows if not room or r["file"].startswith(f"{room}/"))
        counted = count.total() - count["equivalent"]
        seen = counted - count["survived"]
        rate = f"{seen / counted:.0%}" if counted else "-"
        low, high = interval(seen, counted)
        numbers = "".join(f"{count[kind]:12d}" for kind in kinds)
        told.append(f"{room or 'all':10}{numbers}{rate:>12}{f'{low:.0%}-{high:.0%}':>12}")
    for row in rows:
        if row["outcome"] in ("survived", "equivalent"):
            told.append(f"{row['outcome']}: {row['file']}:{row['line']} ({row['kind']})")
            told += [
                f"  - {row['before']}",
                f"  + {row['after']}",
                *row.get("reason", "").split("\n"),
            ]
    return "\n".join(filter(None, told))


def interval(seen: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, by Clopper and Pearson."""
    found = scipy.stats.binomtest(seen, of).proportion_ci() if of else (0.0, 1.0)
    return float(found[0]), float(found[1])


def main() -> int:
    """Test random changes and print what happened; return 1 if one survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--number", type=int, default=100, help="number of changes")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw")
    parser.add_argument("--rooms", nargs="*", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--seconds", type=float, default=60.0, help="time of a change's tests, s")
    parser.add_argument("--results", type=Path, help="JSON lines that keep the outcomes")
    parser.add_argument("--thorough", action="store_true", help="run thorough tests too")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "mutants")
    options = parser.parse_args()
    results = options.results
    lines = results.read_text().splitlines() if results and results.is_file() else []
    known = {identity(row): row for row in map(json.loads, lines)}
    entries = tomllib.loads(EQUIVALENT.read_text()).get("mutant", [])
    reasons = {identity(entry): entry["reason"] for entry in entries}
    bench, rows, more = None, [], ("-m", "") if options.thorough else ()
    for change in sample(ROOT, options.rooms, options.seed, options.number):
        row = described(change, (ROOT / "nlosoptics" / change.file).read_text())
        if identity(row) in reasons:
            row |= {"outcome": "equivalent", "reason": reasons[identity(row)]}
        elif identity(row) in known:
            row = known[identity(row)] | row
        else:
            options.folder.mkdir(parents=True, exist_ok=True)
            bench = bench or Bench(ROOT, options.folder.resolve(), *more)
            row |= bench.run(change, options.seconds)
            print(f"{row['outcome']}: {row['file']}:{row['line']} {row['after']}", flush=True)
            if results:
                with results.open("a") as file:
                    file.write(json.dumps(row) + "\n")
        rows.append(row)
    print(table(rows))
    return 1 if any(row["outcome"] == "survived" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
