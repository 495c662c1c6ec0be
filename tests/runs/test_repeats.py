"""Memory of a process over repeated calls; `benchmarks/repeats.py` makes 500 of each."""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

#: Python specialises code in the first calls; what is kept for each input has more objects.
SPECIALISED = 10.0


@pytest.fixture(scope="module")
def repeats(root: Path) -> ModuleType:
    """The benchmark as a module."""
    path = root / "benchmarks" / "repeats.py"
    spec = importlib.util.spec_from_file_location("repeats", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["repeats"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
@pytest.mark.parametrize("name", ["simulate", "point_spread", "trace", "render"])
def test_memory_does_not_grow(name: str, repeats: ModuleType) -> None:
    found = repeats.repeated(repeats.stages()[name], 80)
    assert not found["bytes"].grows, found
    assert found["objects"].slope - 3.0 * found["objects"].error < SPECIALISED, found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
def test_what_is_kept_for_each_call_is_seen(repeats: ModuleType) -> None:
    kept = []
    with suppress(AttributeError):  # of glibc alone: memory that earlier tests freed is not used
        ctypes.CDLL(None).malloc_trim(0)
    found = repeats.repeated(lambda number: kept.append(np.full(500_000, number)), 50)
    assert found["bytes"].grows
    assert found["bytes"].slope == pytest.approx(4_000_000, rel=0.5)  # 8 B each
    lists = []
    found = repeats.repeated(lambda number: lists.append([[] for _ in range(20)]), 50)
    assert found["objects"].grows
    assert found["objects"].slope > 20.0


def test_noise_and_one_step_are_no_growth(repeats: ModuleType) -> None:
    draw = np.random.default_rng(1)
    noise = 1e8 + 1e5 * draw.standard_normal(500)
    assert not repeats.fitted(noise, repeats.ALLOWED["bytes"]).grows
    first = np.where(np.arange(500) < 150, 0.0, 1e7)  # a cache that is filled once
    assert not repeats.fitted(first, repeats.ALLOWED["bytes"]).grows
    ramp = noise + 1e4 * np.arange(500)
    assert repeats.fitted(ramp, repeats.ALLOWED["bytes"]).slope == pytest.approx(1e4, rel=0.05)
