"""Changes of source are small, complete and repeatable, and compiled callees are not stale."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from . import mutants
from .source_changes import changes

ROOT = Path(__file__).parents[2]
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


@pytest.mark.thorough
def test_every_change_of_a_room_is_another_valid_source() -> None:
    """The tree differs from the first one, so that no change is void from the start."""
    few, many = (mutants.sample(ROOT, ["limits", "imaging"], 1, number) for number in (10, 40))
    assert many[:10] == few
    assert mutants.sample(ROOT, ["limits", "imaging"], 4, 10) != few
    for change in many:
        source = (ROOT / "nlosoptics" / change.file).read_text()
        assert ast.dump(ast.parse(change.applied(source))) != ast.dump(ast.parse(source))


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


@pytest.mark.thorough
def test_changes_are_killed_survive_or_time_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutants, "ALLOWANCE", 20.0)
    for name, text in KERNELS.items():
        (tmp_path / "root" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "root" / name).write_text(text)
    plugin = Path(mutants.__file__).with_name("line_records.py")
    for name, text in (("__init__.py", ""), ("line_records.py", plugin.read_text())):
        (tmp_path / "root/tests/fuzz").mkdir(exist_ok=True)
        (tmp_path / "root/tests/fuzz" / name).write_text(text)
    (tmp_path / "root/tests/__init__.py").write_text("")
    expected = {
        "_low_kernels: return x - 1.0": "killed",  # inlined in a kernel of another file
        "shell: if x <= 0.0:": "survived",
        "shell: return x - 1.0": "survived",  # no test calls it
        "shell: x -= 1.0": "timed out",
        "shell: x += 2.0": "killed",  # in a fixture that the first test uses as well
        "_low_kernels: return x + 1.0": "killed",  # by a test that calls only the kernel
    }
    bench, found = mutants.Bench(tmp_path / "root", tmp_path), {}
    for change in mutants.sample(tmp_path / "root", ["psf"], 0, 1000):
        after = change.lines((tmp_path / "root/nlosoptics" / change.file).read_text())[1]
        place = f"{Path(change.file).stem}: {after}"
        if place in expected:
            found[place] = bench.run(change, 60.0)
    assert {place: row["outcome"] for place, row in found.items()} == expected
    assert found["shell: x += 2.0"]["by"] == "tests/psf/test_shell.py::test_second"


def test_the_kill_rate_leaves_equivalent_changes_out() -> None:
    row = {"file": "psf/a.py", "line": 1, "kind": "constant", "before": "1", "after": "2"}
    kinds = ["killed"] * 7 + ["timed out"] * 2 + ["survived"] + ["equivalent"] * 10
    told = mutants.table([row | {"outcome": kind, "reason": "why"} for kind in kinds])
    assert told.splitlines()[2].split() == ["all", "7", "2", "1", "10", "90%", "55%-100%"]
