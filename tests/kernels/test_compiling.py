"""Kernels from numba's cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from numba.core import types

from nlosoptics.kernels.compiling import njit

MODULE = """
import json, sys
import numpy as np
from nlosoptics.kernels.compiling import njit

@njit(cache=True)
def doubled(x):
    y = np.empty(x.size)
    for i in range(x.size):
        y[i] = 2.0 * x[i]
    return y

@njit(cache=True)
def total(x):
    found = 0.0
    for value in doubled(x):
        found += value
    return found

@njit
def uncached(x):
    return total(x) + 1.0

def told(kernel):
    value = float(np.sum(kernel(np.arange(4.0))))
    stats = getattr(kernel, "stats", None)
    hits, misses = (sum(getattr(stats, name).values()) for name in ("cache_hits", "cache_misses"))
    return value, hits, misses, "scipy.linalg" in sys.modules
"""
CALLS = "from module import *; print(json.dumps([told(k) for k in ({})]))"


def _run(folder, kernels, **environment):
    found = subprocess.run(
        [sys.executable, "-c", CALLS.format(kernels)],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(found.stdout)


def test_cached_kernels_load_without_what_a_compilation_needs(tmp_path) -> None:
    """The second process compiles nothing and does not import numba's implementations of numpy."""
    (tmp_path / "module.py").write_text(MODULE)
    # for Python, and not only as a part of the other, each kernel is compiled
    assert _run(tmp_path, "total, doubled") == [[12.0, 0, 1, True], [12.0, 0, 1, True]]
    assert _run(tmp_path, "total, doubled") == [[12.0, 1, 0, False], [12.0, 1, 0, False]]
    # a kernel without a cache is compiled after one that was loaded, and calls it
    assert _run(tmp_path, "total, uncached") == [[12.0, 1, 0, False], [13.0, 0, 1, True]]


def test_python_functions_stay_as_they_are_without_compilation(tmp_path) -> None:
    (tmp_path / "module.py").write_text(MODULE)
    call = "from module import *; print(json.dumps([type(total).__name__, total(np.arange(4.0))]))"
    found = subprocess.run(
        [sys.executable, "-c", call],
        cwd=tmp_path,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(found.stdout) == ["function", 12.0]


def test_a_kernel_is_compiled_once_for_all_constants() -> None:
    """numba alone would compile it for each of two whole numbers, and for the variable."""

    @njit(cache=True)
    def shifted(x, by):
        return x + by

    @njit(cache=True)
    def sums(x, by):
        return shifted(x, 1) + shifted(x, 2) + shifted(x, by)

    assert sums(1, 3) == 9
    called = shifted.get_call_template((types.int64, types.literal(1)), {})[0]
    assert [case.args for case in called.cases] == [(types.int64, types.int64)]
    assert shifted(1, 1) == 2  # Python calls a version of its own


def test_a_shared_kernel_is_compiled_once_for_python_and_kernels() -> None:
    @njit(cache=True, shared=True)
    def doubled(x):
        return 2 * x

    @njit(cache=True)
    def quadrupled(x):
        return doubled(doubled(x))

    assert quadrupled(3) == 12
    (only,) = doubled.overloads.values()
    assert doubled(3) == 6
    assert list(doubled.overloads.values()) == [only]
