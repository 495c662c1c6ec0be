"""Random small changes of the package, each tested by the tests that call the changed code.

python -m tests.fuzz.mutants [--number 100] [--seed 0] [--rooms NAME ...] [--by-lines]
                             [--seconds 60] [--record] [--results FILE] [--again] [--fresh FILE ...]

The changes are drawn in turn from the rooms, or with `--by-lines` as often as a room has lines,
each change of a room with equal probability. Test files are run once without any change, to record
which lines their tests execute and how long they take; a record holds until the test file or a file
that it calls is edited. `--record` puts all files of the rooms on record before the first change.

A change is tested first by tests on record that execute its line. If they pass, it is tested by the
files of its folder that have no record and name the changed module's functions most. If these pass
too, the other files are recorded, and the change is tested by its file's doctests and by the tests
of its room that execute its line, those of its folder first and of these the quickest ones, until
`--seconds` of their processor time are reached. A change of a kernel is tested by those that
execute a call of its function, but first by those that call kernels alone, in files that name its
module: they compile least; then also by the other tests of these files, since direct calls leave
no trace. A default value is also tested by the file that has these on record. A test that fails
without a change counts for nothing. A run that takes over three times as long as undisturbed tests
has timed out, and counts as killed.

The table counts killed and surviving changes, with the 95 % interval of their rate. Changes of
`equivalent_mutants.toml` alter no result, for the reason given there, and are not run. `--results`
names a file that keeps the outcomes: its changes are drawn first, as far as their lines still
exist, and are not run again, except for the survivors if `--again` is given. Changes in the files
that `--fresh` names are not drawn.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import shutil
import sys
import tomllib
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from .mutant_runs import (
    copied,
    fingerprint,
    forget_compiled,
    importers,
    is_kernel,
    load_libraries,
    reach,
    run_tests,
)
from .reaching_lines import of_default, reaching_lines
from .readers import ROOT
from .source_changes import Change, changes

ROOMS = ("psf", "raytrace", "transient", "inverse", "imaging")
DEFAULTS = "tests/test_defaults.py"  # reads them, and executes no line
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
OUTCOMES = {"passed": "survived", "failed": "killed", "timed out": "timed out"}
LONGEST = 1200.0  # limit of a test file that is undisturbed, s
FIRST = 3  # test files that are run without a record
SLOWER = 3.0  # longest time of a run, times that of the undisturbed tests
ALLOWANCE, COMPILING = 30.0, 180.0  # added to that, and again if kernels are compiled, s
Row = dict[str, Any]


def sample(
    root: Path,
    rooms: list[str],
    seed: int,
    number: int,
    known: Container[tuple[str, ...]] = (),
    *,
    without: Container[tuple[str, ...]] = (),
    by_lines: bool = False,
) -> list[Change]:
    """Return random changes, drawn in turn from each room; more of them begin with the same.

    If ``by_lines``, rooms have their turns as often as they have lines.

    Changes whose identity is in ``known`` come before the others of their room. An edit of a source
    draws others, so without this the outcomes of earlier draws would be lost. Of changes with the
    same identity, the first in the source is drawn. Those in ``without`` are not drawn.
    """
    drawn = []
    for turn, room in enumerate(rooms):
        size = 0
        found: dict[tuple[str, ...], Change] = {}
        for file in sorted((root / "nlosoptics" / room).rglob("*.py")):
            if file.name != "__init__.py":
                source = file.read_text()
                size += source.count("\n") if by_lines else 0
                for one in changes(str(file.relative_to(root / "nlosoptics")), source):
                    found.setdefault(identity(described(one, source)), one)
        names = [name for name in found if name not in without]
        order = np.random.default_rng([seed, *room.encode()]).permutation(len(names))
        shuffled = [names[i] for i in order]
        for i, name in enumerate(sorted(shuffled, key=lambda one: one not in known)):
            drawn.append(((i + 0.5) / max(size, 1), turn, found[name]))
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
    """Copies of the checkout: one with the undisturbed tests' records, one for the changes."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._base, self._changed = folder / "base", folder / "changed"
        self._record = folder / "tests.json"
        copied(root, self._base)
        self._users = importers(self._base / "nlosoptics")
        self._prints: dict[str, str] = {}
        known = json.loads(self._record.read_text()) if self._record.is_file() else {}
        self._known: dict[str, Row] = {key: told | {"new": 0.0} for key, told in known.items()}
        copied(self._base, self._changed)

    def record(self, rooms: list[str], most: float) -> None:
        """Put all test files of rooms on record, without tests of over ``most`` seconds."""
        for room in rooms:
            for file in sorted((self._base / "tests" / room).rglob("test_*.py")):
                if self._kept(file) is None:
                    self._recorded(file, most)

    def run(self, change: Change, most: float) -> Row:
        """Run the tests that reach a changed piece of code, and tell what happened."""
        source = (self._base / "nlosoptics" / change.file).read_text()
        stale, compiled, spent = reach(change.file, self._users), -1, 0.0
        told: Row = {"outcome": "survived", "by": "", "seconds": 0.0, "tests": 0}
        ran: set[str] = set()
        for where in ("known", "likeliest", "alone", "near", "far"):
            planned = spent if where in ("near", "far") else 0.0
            if where == "likeliest":
                chosen = self._likeliest(change, stale)
                planned = len(chosen) * (most + ALLOWANCE / SLOWER)
            else:
                doctests = where == "near" and ">>> " in source
                chosen = [f"nlosoptics/{change.file}"] if doctests else []
                if where == "known" and of_default(
                    self._base / "nlosoptics", change.file, change.line(source)
                ):
                    chosen = [name for name in (DEFAULTS,) if (self._base / name).is_file()]
                callers = {*self._callers(change, stale, most, where)}
                for name, seconds in sorted(callers, key=lambda one: one[::-1]):
                    if name in ran:
                        continue
                    if chosen and planned + seconds > most:
                        break
                    chosen.append(name)
                    planned += seconds
            if not chosen:
                continue
            if compiled < 0:  # after the records, by which kernels were compiled
                compiled = self._apply(change, stale)
            limit = SLOWER * planned + ALLOWANCE + COMPILING * bool(compiled)
            run = run_tests(self._changed, chosen, seconds=limit)
            self._keep_compiled(stale)
            spent += run.seconds * (where in ("near", "far"))
            ran |= {*chosen}
            told["seconds"] = round(told["seconds"] + run.seconds, 1)
            told["tests"] += len(chosen)
            if run.kind != "passed" and self._passes(run.failure):
                return told | {"outcome": OUTCOMES[run.kind], "by": run.failure}
        return told

    def _passes(self, test: str) -> bool:
        """Whether a test, if there is one, passes without any change."""
        return ".py" not in test or run_tests(self._base, [test], seconds=LONGEST).kind == "passed"

    def _apply(self, change: Change, stale: set[str]) -> int:
        """Apply a change to a fresh copy, and return how many compiled functions it makes stale.

        Its other files are links to those of the undisturbed copy. No run writes into a file that
        is there: numba replaces it.
        """
        package = self._changed / "nlosoptics"
        shutil.rmtree(package)
        shutil.copytree(self._base / "nlosoptics", package, copy_function=os.link)
        source = (package / change.file).read_text()
        (package / change.file).unlink()
        (package / change.file).write_text(change.applied(source))
        return forget_compiled(package, stale)

    def _keep_compiled(self, stale: set[str]) -> None:
        """Keep what a run compiled of files that the change does not reach."""
        changed = {Path(file).with_suffix("") for file in stale}
        for file in (self._changed / "nlosoptics").rglob("*.nb[ic]"):
            there = file.relative_to(self._changed / "nlosoptics")
            new = file.stat().st_nlink == 1
            if new and there.parents[1] / there.name.split(".")[0] not in changed:
                (self._base / "nlosoptics" / there.parent).mkdir(exist_ok=True)
                (self._base / "nlosoptics" / there).unlink(missing_ok=True)
                shutil.copy2(file, self._base / "nlosoptics" / there)

    def _likeliest(self, change: Change, users: set[str]) -> list[str]:
        """Return test files of a folder without a record: those that name the module most.

        For a kernel, those that name the modules of its users count as well.
        """
        folder = Path(change.file).parent
        files = users if is_kernel(change.file) else {change.file}
        stems = {Path(file).stem for file in files if Path(file).parent == folder}
        imports = re.compile(rf"^(?:from|import) .*\b(?:{'|'.join(stems)})\b", re.MULTILINE)
        names = re.compile(r"\b(" + "|".join(self._names(files)) + r")\b")
        counts = {}
        for file in sorted((self._base / "tests" / folder).rglob("test_*.py")):
            text, named = file.read_text(), any(stem.strip("_") in file.stem for stem in stems)
            counts[file] = (named, len(imports.findall(text)), len({*names.findall(text)}))
        best = sorted(counts, key=lambda one: counts[one], reverse=True)[:FIRST]
        return [
            str(file.relative_to(self._base))
            for file in best
            if any(counts[file]) and not self._kept(file)
        ]

    def _callers(
        self, change: Change, users: set[str], most: float, where: str
    ) -> Iterator[tuple[str, float]]:
        """Yield tests that reach the changed code and their time.

        ``where`` is "known" for tests on record, also of other rooms, "alone" for tests that call
        no users but name the module of a kernel, "near" for others of the folder, and "far" for
        those of other folders. Records of the last are made until they have taken ``most`` seconds,
        the likeliest files first.
        """
        alone, stem = where == "alone", Path(change.file).stem
        if alone and not is_kernel(change.file):
            return
        room, *_ = folder = change.file.split("/")[:-1]
        source = (self._base / "nlosoptics" / change.file).read_text()
        package = self._base / "nlosoptics"
        lines = reaching_lines(package, change.file, change.line(source), users)
        here = self._base / "tests" / "/".join(folder)
        words = re.compile(r"\b(" + "|".join(self._names(users)) + r")\b")

        def mentions(file: Path) -> int:
            return -len({*words.findall(file.read_text())})

        searched = self._base / "tests" / ("" if where == "known" else room)
        files = sorted(searched.rglob("test_*.py"))
        spent = 0.0
        for file in sorted(files, key=mentions):
            held = file.is_relative_to(here) == (where == "near")
            if where == "known":
                held = self._kept(file) is not None
            elif alone:
                held = stem in file.read_text()
            if not held or (spent > most and where == "far"):
                continue
            told = self._kept(file) or self._recorded(file, most)
            spent += told["new"]
            told["new"] = 0.0
            names, found = [*told["tests"]], set()
            for executed, line, tests in told["lines"]:
                if executed in users if alone else line in lines.get(executed, ()):
                    found |= {*tests}
            if alone:
                found = {*range(len(names))} - found
            elif is_kernel(change.file) and stem in file.read_text():
                found = {*range(len(names))}  # it may call the kernels, which leaves no trace
            yield from ((names[i], told["tests"][names[i]]) for i in sorted(found))

    def _names(self, files: set[str]) -> set[str]:
        """Return the names of public functions and classes of files."""
        trees = [ast.parse((self._base / "nlosoptics" / file).read_text()) for file in files]
        named = (ast.FunctionDef, ast.ClassDef)
        found = {node.name for tree in trees for node in tree.body if isinstance(node, named)}
        return {name for name in found if not name.startswith("_")} or {"nothing"}

    def _kept(self, file: Path) -> Row | None:
        """Return the record of a test file, if neither it nor a file that it calls was edited."""
        told = self._known.get(str(file.relative_to(self._base)))
        same = told and all(self._print(one) == kept for one, kept in told["prints"].items())
        return told if same else None

    def _print(self, name: str) -> str:
        """Return the fingerprint of a file of the checkout, or nothing if there is no such file."""
        if name not in self._prints:
            self._prints[name] = fingerprint(self._base / name)
        return self._prints[name]

    def _recorded(self, file: Path, most: float) -> Row:
        """Run a test file, and return the times and lines of its tests.

        Tests that fail or take longer than ``most`` seconds without any change are left out.
        """
        name, compiled = str(file.relative_to(self._base)), -1
        while compiled != len(found := [*self._base.rglob("*.nbc")]):  # not to time compilation
            compiled = len(found)
            run = run_tests(self._base, [name], seconds=LONGEST, longest=most)
        if run.failure:
            print(f"fails without any change, or takes over {most:.0f} s: {run.failure}")
        called = {f"nlosoptics/{file}" for file, *_ in run.lines}
        results = str(Path(name).with_suffix(".json"))  # with which its tests may compare
        prints = {one: self._print(one) for one in (name, results, *called)}
        told = {"tests": run.tests, "lines": run.lines, "new": run.seconds, "prints": prints}
        self._known[name] = told
        self._record.write_text(json.dumps(self._known))
        return told


def table(rows: list[Row]) -> str:
    """Return the counts of each room and of all, then survivors and equivalent changes."""
    rooms = [*dict.fromkeys(row["file"].split("/")[0] for row in rows), ""]
    kinds = ("killed", "timed out", "survived", "equivalent")
    heads = (*kinds, "kill rate", "95 %")
    told = [f"{'room':10}" + "".join(f"{head:>12}" for head in heads)]
    for room in rooms:
        found = [row for row in rows if not room or row["file"].startswith(f"{room}/")]
        count = Counter(row["outcome"] for row in found)
        counted = len(found) - count["equivalent"]
        seen = counted - count["survived"]
        rate = f"{seen / counted:.0%}" if counted else "-"
        low, high = interval(seen, counted)
        numbers = "".join(f"{count[kind]:12d}" for kind in kinds)
        told.append(f"{room or 'all':10}{numbers}{rate:>12}{f'{low:.0%}-{high:.0%}':>12}")
    for row in rows:
        if row["outcome"] in ("survived", "equivalent"):
            place = f"{row['outcome']}: {row['file']}:{row['line']} ({row['kind']})"
            told += [place, f"  - {row['before']}", f"  + {row['after']}"]
            told += [f"  {row['reason']}"] if "reason" in row else []
    return "\n".join(told)


def interval(seen: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, by Clopper and Pearson."""
    low = scipy.stats.beta.ppf(0.025, seen, of - seen + 1) if seen else 0.0
    high = scipy.stats.beta.ppf(0.975, seen + 1, of - seen) if seen < of else 1.0
    return float(low), float(high)


def main() -> int:
    """Test random changes and print what happened; return 1 if one survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--number", type=int, default=100, help="number of changes")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw")
    parser.add_argument("--rooms", nargs="*", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--by-lines", action="store_true", help="rooms by their numbers of lines")
    parser.add_argument("--seconds", type=float, default=60.0, help="time of a change's tests, s")
    parser.add_argument("--record", action="store_true", help="record all test files before")
    parser.add_argument("--results", type=Path, help="JSON lines that keep the outcomes")
    parser.add_argument("--again", action="store_true", help="test survivors of the file again")
    parser.add_argument("--fresh", type=Path, nargs="*", default=[], help="outcomes to leave out")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "mutants")
    options = parser.parse_args()
    known = _outcomes(options.results) if options.results else {}
    old = {name for file in options.fresh for name in _outcomes(file)}
    entries = tomllib.loads(EQUIVALENT.read_text()).get("mutant", [])
    reasons = {identity(entry): entry["reason"] for entry in entries}
    load_libraries()
    options.folder.mkdir(parents=True, exist_ok=True)
    done = {"killed", "timed out"} if options.again else {"killed", "timed out", "survived"}
    bench, rows = None, []
    if options.record:
        bench = Bench(ROOT, options.folder.resolve())
        bench.record(options.rooms, options.seconds)
    drawn = sample(
        *(ROOT, options.rooms, options.seed, options.number, {*known}),
        without=old,
        by_lines=options.by_lines,
    )
    for change in drawn:
        row = described(change, (ROOT / "nlosoptics" / change.file).read_text())
        kept = known.get(identity(row), {"outcome": ""})
        if identity(row) in reasons:
            row |= {"outcome": "equivalent", "reason": reasons[identity(row)]}
        elif kept["outcome"] in done:
            row = kept | row
        else:
            bench = bench or Bench(ROOT, options.folder.resolve())
            row |= bench.run(change, options.seconds) | {"seed": options.seed}
            print(f"{row['outcome']}: {row['file']}:{row['line']} {row['after']}", flush=True)
        rows.append(row)
        if options.results:
            known[identity(row)] = row
            options.results.write_text("".join(json.dumps(one) + "\n" for one in known.values()))
    print(table(rows))
    return 1 if any(row["outcome"] == "survived" for row in rows) else 0


def _outcomes(file: Path) -> dict[tuple[str, ...], Row]:
    lines = file.read_text().splitlines() if file.is_file() else []
    return {identity(row): row for row in map(json.loads, lines)}


if __name__ == "__main__":
    sys.exit(main())
