"""Runs of chosen tests in forked processes, in a copy of the checkout.

A process that has loaded the large libraries forks for each run. A changed file's compiled
functions, and those of all files that import it, are compiled again: numba looks only at the time
of the file in which a function is written, although callees of other files are inlined.
"""

from __future__ import annotations

import ast
import gc
import hashlib
import importlib
import inspect
import json
import os
import resource
import shutil
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

#: Libraries that take long to load. The package itself is loaded by each run from its copy.
LIBRARIES = ("numba", "scipy.optimize", "scipy.signal", "h5py", "trimesh", "pydantic", "pint")
LIBRARIES += ("torch", "matplotlib.pyplot", "mpmath", "zarr", "pytest", "hypothesis.stateful")
#: Before numba is loaded, as in `tests/conftest.py`.
SETTINGS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
SETTINGS |= {"NUMBA_NUM_THREADS": "2", "PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}
MEMORY = 12 << 30  # bytes of address space of a run
PATIENCE = 4.0  # longest time of a run per second of processor time
FAILED = (1, 2, 3, 4)  # exit codes of pytest: a test, an import, or a plugin failed
NONE_FOUND = 5  # a folder without tests


class Run(NamedTuple):
    """End of a run: "passed", "failed" or "timed out", the first failure, processor time, s.

    ``tests`` holds the processor time of each test that passed, s. If the lines were recorded,
    ``lines`` holds file and number of each line of the package with the numbers of the tests that
    execute it.
    """

    kind: str
    failure: str
    seconds: float
    tests: Mapping[str, float] = MappingProxyType({})
    lines: Sequence[tuple[str, int, list[int]]] = ()


def load_libraries() -> None:
    """Load what all runs need into this process, once."""
    os.environ |= SETTINGS
    os.environ.pop("NUMBA_CACHE_DIR", None)  # compiled functions lie beside the copied sources
    for name in LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(name)
    import numba

    numba.njit(lambda x: x + 1)(1.0)  # the first compilation of a process loads much more
    gc.freeze()  # collections of a run pass over what is loaded here


def copied(root: Path, folder: Path) -> None:
    """Copy a checkout without results and hidden files.

    A package that is there keeps what was compiled of files that no edit reaches.
    """
    ignored, package = shutil.ignore_patterns("out", ".*"), folder / "nlosoptics"
    if package.is_dir():
        _update(package, root / "nlosoptics")
    for path in folder.iterdir() if folder.is_dir() else ():
        if path != package:
            (shutil.rmtree if path.is_dir() else Path.unlink)(path)
    folder.mkdir(parents=True, exist_ok=True)
    for path in root.iterdir():
        there = folder / path.name
        if there.exists() or ignored("", [path.name]):
            continue
        if path.is_dir():
            shutil.copytree(path, there, ignore=ignored)
        else:
            shutil.copy2(path, there)


def _update(package: Path, new: Path) -> None:
    """Give a copy of the package the files of another, and forget what edits have made stale."""
    users = importers(new)
    names = {
        str(file.relative_to(folder))
        for folder in (package, new)
        for file in folder.rglob("*.*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    for name in names:
        if fingerprint(package / name) != fingerprint(new / name):
            (package / name).unlink(missing_ok=True)
            forget_compiled(package, reach(name, users))
            if (new / name).is_file():
                (package / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(new / name, package / name)


def importers(package: Path) -> dict[str, set[str]]:
    """Return for each file of the package the files that import from it, relative paths."""
    found: dict[str, set[str]] = {}
    for file in package.rglob("*.py"):
        here = file.relative_to(package)
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                folder = (package / here).parents[node.level - 1]
                base = folder / (node.module or "").replace(".", "/")
                names = [base.with_suffix(".py"), *(base / f"{one.name}.py" for one in node.names)]
                for name in names:
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


def forget_compiled(package: Path, files: set[str]) -> int:
    """Remove the compiled functions of files, and return how many there were."""
    paths = [package / file for file in files]
    kept = [k for p in paths for k in p.parent.glob(f"__pycache__/{p.stem}.*.nb[ic]")]
    for file in kept:
        file.unlink()
    return len(kept)


def run_tests(folder: Path, tests: Sequence[str], *, seconds: float, longest: float = 0.0) -> Run:
    """Run tests of a checkout until the first failure, or record which lines all of them execute.

    Parameters
    ----------
    folder : Path
        Copy of the checkout; its package is the one that is imported.
    tests : sequence of str
        Files, folders and single tests, relative to the copy. Of a file with single tests in this
        list, only these are run.
    seconds : float
        Limit of processor time, s.
    longest : float
        If above 0, the lines of the package that each test executes are recorded, failures do not
        end the run, and a test that takes more processor time than this, s, is stopped and fails.

    Returns
    -------
    Run
        What happened; "timed out" covers a process that waits for something.
    """
    told, log = folder.parent / "run.json", folder.parent / "run.log"
    told.unlink(missing_ok=True)
    start = time.monotonic()
    process = os.fork()
    if not process:
        code = 70
        try:
            os.setsid()
            with log.open("w") as file:
                os.dup2(file.fileno(), 1)
                os.dup2(file.fileno(), 2)
            code = _tested(folder, tests, seconds, told, longest)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    ended, usage = 0, None
    while not ended:
        ended, status, usage = os.wait4(process, os.WNOHANG)
        if not ended and time.monotonic() - start > PATIENCE * seconds:
            os.killpg(process, signal.SIGKILL)
        time.sleep(0.0 if ended else 0.02)
    assert usage is not None
    with suppress(ProcessLookupError):  # what a killed run has started
        os.killpg(process, signal.SIGKILL)
    used, code = usage.ru_utime + usage.ru_stime, os.waitstatus_to_exitcode(status)
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return Run("timed out", "", used)
    if code < 0:
        return Run("failed", signal.Signals(-code).name, used)
    if code not in (0, NONE_FOUND, *FAILED) or not told.is_file():
        sys.exit(f"pytest ended with {code}; see {log}")
    found = json.loads(told.read_text())
    kind = "failed" if code in FAILED else "passed"
    return Run(kind, found["failure"], used, found["tests"], found["lines"])


def _tested(folder: Path, tests: Sequence[str], seconds: float, told: Path, longest: float) -> int:
    """Run pytest in this process, which ends with it."""
    import pytest

    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 60))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.chdir(folder)
    os.environ["PYTHONPATH"] = str(folder)
    here = Path(__file__).parents[2]
    sys.path[:] = [str(folder), *(name for name in sys.path if Path(name).resolve() != here)]
    for name in [*sys.modules]:  # of this program, which is not the copy's
        if name.split(".")[0] in ("tests", "nlosoptics"):
            del sys.modules[name]
    watch = _Watch(folder / "nlosoptics", {test for test in tests if "::" in test}, longest)
    files = [*dict.fromkeys(test.split("::")[0] for test in tests)]
    options = ["-q", "-n0", "-p", "no:cacheprovider", "--tb=line", "--hypothesis-seed=0"]
    options.append("--assert=plain")  # rewriting takes longer than most tests
    if longest:
        signal.signal(signal.SIGVTALRM, _stop)
        threading.settrace(watch.called)
    else:
        options.append("-x")
    code = int(pytest.main([*options, *files], plugins=[watch]))
    sys.settrace(None)
    package = sys.modules.get("nlosoptics")
    if package is not None and not str(package.__file__).startswith(str(folder)):
        return 71
    found = {"failure": watch.failure, "tests": watch.passed, "lines": watch.lines}
    told.write_text(json.dumps(found))
    return code


def _stop(*_: Any) -> None:
    raise TimeoutError("a test took longer than a record allows")


class _Watch:
    """A plugin of pytest that selects tests, and keeps the first failure, times and lines.

    A line that runs while a shared fixture is set up counts for all tests that use the fixture.
    Caches are cleared before each test, so that no test relies on the calls of an earlier one.
    """

    def __init__(self, package: Path, wanted: set[str], longest: float) -> None:
        self.failure = ""
        self._tests: dict[str, float] = {}
        self._failed: set[str] = set()
        self._lines: dict[str, dict[str, set[int]]] = {}
        self._uses: dict[str, list[str]] = {}
        self._now = ""  # test or fixture
        self._start, self._longest = f"{package}/", longest
        self._wanted, self._files = wanted, {test.split("::")[0] for test in wanted}
        self._begun = 0.0

    @property
    def passed(self) -> dict[str, float]:
        """Processor time of each test that passed."""
        return {test: used for test, used in self._tests.items() if test not in self._failed}

    @property
    def lines(self) -> list[tuple[str, int, list[int]]]:
        """File and number of each line, with the numbers of the passed tests that execute it."""
        found: dict[tuple[str, int], list[int]] = {}
        for number, test in enumerate(self.passed):
            held = [self._lines.get(name, {}) for name in (test, *self._uses[test])]
            for place in {(file, line) for one in held for file in one for line in one[file]}:
                found.setdefault(place, []).append(number)
        return [(*place, numbers) for place, numbers in sorted(found.items())]

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Keep only the wanted tests of files of which single tests are wanted."""
        items[:] = [
            one
            for one in items
            if one.nodeid in self._wanted or one.nodeid.split("::")[0] not in self._files
        ]

    def pytest_runtest_protocol(self, item: Any) -> None:
        """Start the clock of a test."""
        self._now = item.nodeid
        self._uses[self._now] = getattr(item, "fixturenames", [])
        if self._longest:
            _clear_caches(self._start)
            signal.setitimer(signal.ITIMER_VIRTUAL, self._longest)
            sys.settrace(self.called)  # ended by an exception in it, as when a test was stopped
        self._tests[self._now], self._begun = 0.0, time.process_time()

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Keep the processor time of a test."""
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        self._tests[nodeid] = round(time.process_time() - self._begun, 3)

    def pytest_fixture_setup(self, fixturedef: Any) -> None:
        """Keep the lines of a shared fixture apart from those of its first test."""
        if fixturedef.scope != "function":
            self._now = fixturedef.argname

    def pytest_runtest_call(self, item: Any) -> None:
        """Go on with the lines of a test after its fixtures."""
        self._now = item.nodeid

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep the addresses of the tests that failed."""
        if report.failed:
            self.failure = self.failure or report.nodeid
        if not report.passed:
            self._failed.add(report.nodeid)

    def pytest_collectreport(self, report: Any) -> None:
        """Keep the address of a module that could not be imported."""
        if report.failed and not self.failure:
            self.failure = report.nodeid

    def called(self, frame: Any, *_: Any) -> Any:
        """Record the lines of a function of the package that is called."""
        code = frame.f_code
        inside = code.co_filename.startswith(self._start)
        if not inside or not code.co_flags & inspect.CO_OPTIMIZED:  # no import, no class
            return None
        file = code.co_filename[len(self._start) :]
        lines = self._lines.setdefault(self._now, {}).setdefault(file, set())

        def executed(frame: Any, *_: Any) -> Any:
            lines.add(frame.f_lineno)
            return executed

        return executed(frame)


def _clear_caches(start: str) -> None:
    """Clear the caches of all functions and methods of the package and its tests."""
    folder = str(Path(start).parent)
    for module in [*sys.modules.values()]:
        if str(getattr(module, "__file__", None)).startswith(folder):
            for value in [*vars(module).values()]:
                for one in [value, *(vars(value).values() if isinstance(value, type) else ())]:
                    if callable(getattr(one, "cache_clear", None)):
                        one.cache_clear()


def fingerprint(file: Path) -> str:
    """Return a hash of a file, or nothing if there is none."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""
