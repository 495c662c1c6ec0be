"""Kernels compiled by a second process while a first run works."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nlosoptics import _cost_model
from nlosoptics.cli import first_run

forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
MODULE = """
from nlosoptics.kernels.compiling import njit

@njit(cache=True)
def total(x, twice):
    return 2 * x.sum() if twice else x.sum()
"""
TYPES = ["Array(float64, 1, 'C', True, aligned=True)", "bool"]


@pytest.fixture
def mark(tmp_path, monkeypatch):
    """Place of the mark that all kernels are compiled, on a machine with two cores."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    return _cost_model.kept_at().with_suffix(".compiled")


def compiled(tmp_path, monkeypatch, *kernels):
    """Run the process for some kernels until it has ended by itself."""
    monkeypatch.setattr(first_run, "KERNELS", tmp_path / "kernels.json")
    first_run.KERNELS.write_text(json.dumps(kernels))
    started = []
    forked = first_run.forked
    monkeypatch.setattr(
        first_run, "forked", lambda *call: started.append(forked(*call)) or started[0]
    )
    with first_run.compiled_ahead():
        started[0].join(60.0)
    return started[0].exitcode


def test_the_list_names_the_kernels_of_a_run():
    """If it does not: python tests/cli/first_run.py > nlosoptics/cli/first_run.json."""
    found = subprocess.run(
        [sys.executable, Path(__file__).with_name("first_run.py")],
        capture_output=True,
        text=True,
        check=True,
    )
    named = json.loads(first_run.KERNELS.read_text())
    assert sorted(named) == sorted(json.loads(found.stdout))


WARM = """
import sys
from nlosoptics import Scene, simulate

scene = Scene.load("examples/scenes/letter_flat.toml")
simulate(scene.resized(128), reconstruct=True)
from numba.core import entrypoints

print("numba.np.arrayobj" in sys.modules, entrypoints._already_initialized)
"""


def test_a_warm_run_loads_no_compiler_for_arrays_and_no_extension():
    """Importing numba's arrays, or searching all installed packages, takes time for nothing."""
    for _ in range(2):  # the first one may compile
        found = subprocess.run(
            [sys.executable, "-c", WARM], capture_output=True, text=True, check=True
        )
    assert found.stdout == "False False\n"


@forks
def test_another_process_compiles_once(tmp_path, monkeypatch, mark, capfd):
    (tmp_path / "kernel_of_a_run.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    import kernel_of_a_run

    assert compiled(tmp_path, monkeypatch, ["kernel_of_a_run:total", TYPES]) == 0
    assert mark.exists()
    (index,) = Path(kernel_of_a_run.total._cache.cache_path).glob("kernel_of_a_run.total-*.nbi")
    assert index.stat().st_size > 0
    monkeypatch.setattr(first_run, "forked", None)  # is not called again
    with first_run.compiled_ahead():
        pass
    assert capfd.readouterr() == ("", "")


@forks
def test_a_process_that_fails_is_silent(tmp_path, monkeypatch, mark, capfd):
    assert compiled(tmp_path, monkeypatch, ["nlosoptics.kernels.brdf:nothing", TYPES]) == 1
    assert capfd.readouterr() == ("", "")


@forks
def test_the_process_ends_with_a_run_that_fails(monkeypatch, mark):
    monkeypatch.setattr(first_run, "_compile", lambda: time.sleep(60.0))
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), first_run.compiled_ahead():
        raise KeyboardInterrupt
    assert time.perf_counter() - start < 30.0
    assert not mark.exists()  # the next run compiles what this one did not


def test_one_core_starts_no_process(monkeypatch, mark):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    monkeypatch.setattr(first_run, "forked", None)
    with first_run.compiled_ahead():
        pass
