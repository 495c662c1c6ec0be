"""Plugin of pytest that records the lines of the package that each test executes, for `mutants`.

A line that runs while a shared fixture is set up counts for all tests that use the fixture. Caches
are cleared before each test, so that no test relies on the calls of an earlier one.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

START = str(Path.cwd() / "nlosoptics") + "/"
_lines: dict[str, dict[str, set[int]]] = {}  # of each test or fixture, by file
_seconds: dict[str, float] = {}
_uses: dict[str, list[str]] = {}
_failed: set[str] = set()
_now = ""


def _called(frame: Any, *_: Any) -> Any:
    """Record the lines of a function of the package that is called."""
    code = frame.f_code
    inside = code.co_filename.startswith(START)
    if not inside or not code.co_flags & inspect.CO_OPTIMIZED:  # no import, no class
        return None
    lines = _lines.setdefault(_now, {}).setdefault(code.co_filename[len(START) :], set())

    def executed(frame: Any, *_: Any) -> Any:
        lines.add(frame.f_lineno)
        return executed

    return executed(frame)


def pytest_runtest_protocol(item: Any) -> None:
    """Start the clock of a test."""
    global _now
    for name, module in [*sys.modules.items()]:
        if name.split(".")[0] == "nlosoptics":
            for value in [*vars(module).values()]:
                for one in [value, *(vars(value).values() if isinstance(value, type) else ())]:
                    if callable(getattr(one, "cache_clear", None)):
                        one.cache_clear()
    _now, _uses[item.nodeid] = item.nodeid, getattr(item, "fixturenames", [])
    _seconds[_now] = -time.process_time()
    threading.settrace(_called)
    sys.settrace(_called)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Stop it."""
    _seconds[nodeid] = round(_seconds[nodeid] + time.process_time(), 3)


def pytest_fixture_setup(fixturedef: Any) -> None:
    """Keep the lines of a shared fixture apart from those of its first test."""
    global _now
    if fixturedef.scope != "function":
        _now = fixturedef.argname


def pytest_runtest_call(item: Any) -> None:
    """Go on with the lines of a test after its fixtures."""
    global _now
    _now = item.nodeid


def pytest_runtest_logreport(report: Any) -> None:
    """Note the tests that do not pass."""
    if not report.passed:
        _failed.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the record of all tests that pass."""
    sys.settrace(None)
    record: dict[str, Any] = {}
    for test in _seconds.keys() - _failed:
        files: dict[str, set[int]] = {}
        for name in (test, *_uses[test]):
            for file, lines in _lines.get(name, {}).items():
                files.setdefault(file, set()).update(lines)
        told = {file: sorted(lines) for file, lines in sorted(files.items())}
        record[test] = {"seconds": _seconds[test], "lines": told}
    Path(os.environ["LINE_RECORDS"]).write_text(json.dumps(record))
