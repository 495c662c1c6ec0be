"""Changes of source are small, complete and repeatable, and compiled callees are not stale."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from scipy import stats

from . import mutants
from .reaching_lines import of_default
from .source_changes import changes

ROOT = Path(__file__).parents[2]
DEFAULTS = """TOL = 1.0
class Size:
    tol: float = 1.0
    def grow(self, by: float = 2.0):
        self.tol = by + 3.0
def shrink(by=4.0):
    return by / 5.0"""
SOURCE = '''
"""A docstring with 1 < 2."""

LIMIT: float = 2.0


def mean(values: list[float] | None, *, power: int = 2) -> float:
    """Return a mean."""
    total = 0.0
    for value in values:
        if not value < LIMIT or "é" in (value):
            raise ValueError(f"{value + 1} is above {LIMIT - 1}")
        total += np.abs(-value) ** power
    values.clear()
    total = -(total + 4.0) if not (total) else total
    return (total) / (
        len(values)  # a comment with - in it
    )
'''
#: Each change of the source above: kind, and the line after it.
EXPECTED = {
    ("constant", "LIMIT: float = 4.0"),
    ("constant", "def mean(values: list[float] | None, *, power: int = 3) -> float:"),
    ("constant", "total = 1.0"),
    ("condition", 'if not (not value < LIMIT or "é" in (value)):'),
    ("boolean", 'if not value < LIMIT and "é" in (value):'),
    ("boolean", 'if value < LIMIT or "é" in (value):'),
    ("boundary", 'if not value <= LIMIT or "é" in (value):'),
    ("comparison", 'if not value >= LIMIT or "é" in (value):'),
    ("comparison", 'if not value < LIMIT or "é" not in (value):'),
    ("removed statement", "pass"),
    ("arithmetic", "total -= np.abs(-value) ** power"),
    ("arithmetic", "total += np.abs(-value) * power"),
    ("arithmetic", "total += np.abs(value) ** power"),
    ("removed call", "total += (-value) ** power"),
    ("arithmetic", "total = (total + 4.0) if not (total) else total"),
    ("arithmetic", "total = -(total - 4.0) if not (total) else total"),
    ("constant", "total = -(total + 8.0) if not (total) else total"),
    ("boolean", "total = -(total + 4.0) if (total) else total"),
    ("arithmetic", "return (total) * ("),
}


def test_every_change_of_a_source_is_found() -> None:
    found = changes("mean.py", SOURCE)
    assert {(one.kind, one.lines(SOURCE)[1]) for one in found} == EXPECTED
    # the raise, the sum and the call of `clear`
    assert [one.kind for one in found].count("removed statement") == 3


@pytest.mark.parametrize("room", mutants.ROOMS)
def test_every_change_of_a_room_is_another_valid_source(room: str) -> None:
    """The tree differs from the first one, so that no change is void from the start."""
    for change in mutants.sample(ROOT, [room], seed=1, number=40):
        source = (ROOT / "nlosoptics" / change.file).read_text()
        assert ast.dump(ast.parse(change.applied(source))) != ast.dump(ast.parse(source))


def test_a_longer_sample_continues_a_shorter_one() -> None:
    few, many = (mutants.sample(ROOT, ["limits", "imaging"], 3, n) for n in (10, 25))
    assert many[:10] == few
    assert len(set(many)) == 25
    assert mutants.sample(ROOT, ["limits", "imaging"], 4, 10) != few


def test_known_changes_are_drawn_first() -> None:
    """An edit of one line changes the order of all draws, but not what is known of other lines."""
    first = mutants.sample(ROOT, ["imaging"], 3, 8)
    known = {
        mutants.identity(mutants.described(one, (ROOT / "nlosoptics" / one.file).read_text()))
        for one in first
    }
    later = mutants.sample(ROOT, ["imaging"], 4, 40, known)
    assert {*first} <= {*later[: len(first) + 4]}  # the same change may exist twice in a file
    assert later[30:] != mutants.sample(ROOT, ["imaging"], 3, 40)[30:]


KERNELS = {
    "nlosoptics/__init__.py": "",
    "nlosoptics/psf/__init__.py": "",
    "nlosoptics/psf/_low_kernels.py": """
from numba import njit

@njit(cache=True)
def low(x):
    return x + 1.0

@njit(cache=True)
def lower(x):
    return x - 1.0
""",
    "nlosoptics/psf/_high_kernels.py": """
from numba import njit
from ._low_kernels import low

@njit(cache=True)
def high(x):
    return 2.0 * low(x)
""",
    "nlosoptics/psf/shell.py": """
from ._high_kernels import high

def shell(x):
    if x < 0.0:
        raise ValueError(x)
    return high(x)

def unused(x):
    return x + 1.0

def up(x):
    while x < 0.0:
        x += 1.0
    return x
""",
    "tests/psf/test_shell.py": """
import pytest
from nlosoptics.psf.shell import shell, up

@pytest.fixture(scope="module")
def raised():
    return up(-1.0)

def test_shell():
    assert shell(1.0) == 4.0

def test_first(raised):
    pass

def test_second(raised):
    assert raised == 0.0
""",
    "tests/psf/test_low.py": """
from nlosoptics.psf._low_kernels import lower

def test_lower():
    assert lower(1.0) == 0.0
""",
    "pyproject.toml": "[tool.pytest.ini_options]\naddopts = ['--import-mode=importlib']\n",
}


#: Runs changes of the package above, named by the line that they give, and prints the outcomes.
PROGRAM = """
import json, sys
from pathlib import Path
from tests.fuzz import mutant_runs, mutants

mutant_runs.LIBRARIES = ("numba", "pytest")
mutant_runs.load_libraries()
root, wanted = Path(sys.argv[1]), sys.argv[2:]
mutants.SLOWER, mutants.ALLOWANCE = 1.0, 5.0
if "stale" in wanted:
    mutants.forget_compiled = lambda package, files: 1
bench = mutants.Bench(root, root.parent / "work")
tests = root.parent / "work/base/tests/psf/test_shell.py"
bench._recorded(tests, 60.0)  # compiles the kernels without any change
for change in mutants.sample(root, ["psf"], 0, 1000):
    after = change.lines((root / "nlosoptics" / change.file).read_text())[1]
    place = f"{Path(change.file).stem}: {after}"
    if place in wanted:
        print(json.dumps([place, bench.run(change, 60.0)]))
"""


def outcomes(folder: Path, *wanted: str) -> dict[str, Any]:
    """Outcomes of changes of the small package, run as the program does."""
    for name, text in KERNELS.items():
        (folder / "root" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "root" / name).write_text(text)
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder / "root"), *wanted],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    return dict(json.loads(line) for line in told.stdout.splitlines())


def test_changes_are_killed_survive_or_time_out(tmp_path: Path) -> None:
    inlined, guard = "_low_kernels: return x - 1.0", "shell: if x <= 0.0:"
    unused, endless, wrong = "shell: return x - 1.0", "shell: x -= 1.0", "shell: x += 2.0"
    alone = "_low_kernels: return x + 1.0"
    found = outcomes(tmp_path, inlined, guard, unused, endless, wrong, alone)
    assert {name: one["outcome"] for name, one in found.items()} == {
        inlined: "killed",  # by a kernel of another file, which was compiled again
        guard: "survived",
        unused: "survived",
        endless: "timed out",
        wrong: "killed",  # in a fixture that the first test uses as well
        alone: "killed",  # by a test that calls only the kernel
    }
    by = [
        f"tests/psf/{name}" for name in ("test_shell.py::test_shell", "test_shell.py::test_second")
    ]
    assert [found[name]["by"] for name in (inlined, wrong)] == by
    assert found[alone]["by"] == "tests/psf/test_low.py::test_lower"
    assert [found[name]["tests"] for name in (guard, unused, wrong)] == [1, 0, 2]


def test_a_stale_kernel_would_hide_a_change(tmp_path: Path) -> None:
    """What numba does by itself, and why compiled functions are removed."""
    inlined = "_low_kernels: return x - 1.0"
    assert outcomes(tmp_path, inlined, "stale")[inlined]["outcome"] == "survived"


def test_the_kill_rate_leaves_equivalent_changes_out() -> None:
    row = {"file": "psf/a.py", "line": 1, "kind": "constant", "before": "1", "after": "2"}
    kinds = ["killed"] * 7 + ["timed out"] * 2 + ["survived"] + ["equivalent"] * 10
    told = mutants.table([row | {"outcome": kind, "reason": "why"} for kind in kinds])
    assert told.splitlines()[2].split() == ["all", "7", "2", "1", "10", "90%", "55%-100%"]


def test_intervals_of_shares() -> None:
    """Both bounds are where the tails of the binomial law hold 2.5 %."""
    low, high = mutants.interval(44, 56)
    assert stats.binom.sf(43, 56, low) == pytest.approx(0.025)
    assert stats.binom.cdf(44, 56, high) == pytest.approx(0.025)
    assert mutants.interval(0, 9)[0] == 0.0
    assert mutants.interval(9, 9)[1] == 1.0


def test_rooms_by_lines_and_without_known_changes() -> None:
    rooms = ["limits", "imaging"]
    sizes = [
        sum(
            file.read_text().count("\n")
            for file in (ROOT / "nlosoptics" / room).rglob("*.py")
            if file.name != "__init__.py"
        )
        for room in rooms
    ]
    drawn = mutants.sample(ROOT, rooms, 3, 40, by_lines=True)
    few = sum(one.file.startswith("imaging/") for one in drawn)
    assert few == pytest.approx(40 * sizes[1] / sum(sizes), abs=1)
    names = {
        mutants.identity(mutants.described(one, (ROOT / "nlosoptics" / one.file).read_text()))
        for one in drawn
    }
    assert not {*drawn} & {*mutants.sample(ROOT, rooms, 3, 40, without=names)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("TOL = 1.0", False),
        ("    tol: float = 1.0", True),
        ("    def grow(self, by: float = 2.0):", True),
        ("        self.tol = by + 3.0", False),
        ("def shrink(by=4.0):", True),
        ("    return by / 5.0", False),
    ],
)
def test_default_values_are_recognised(text: str, expected: bool, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(f"{DEFAULTS}\n")
    line = DEFAULTS.splitlines().index(text) + 1
    assert of_default(tmp_path, "a.py", line) == expected
