"""The benchmark of scaling: its simulated workers take the place of real ones."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from pytest import approx


@pytest.fixture
def benchmark() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "studies.py"
    spec = importlib.util.spec_from_file_location("studies_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_waiting_workers_fill_a_store(benchmark: ModuleType, tmp_path: Path) -> None:
    row = benchmark.simulated(2, "here", tmp_path)
    # the benchmark itself refuses points that are not done
    planned = benchmark.plan_study(benchmark.made(1000)).block
    assert row["points"] == benchmark.ROUNDS * 2 * planned
    assert row["throughput"] == approx(row["share"] * 2 / row["point"])
    # workers cannot be faster than they are; the first block is on its way when the clock starts
    assert 0.0 < row["share"] < 1.1
    assert row["blocks"] * row["block"] == approx(row["throughput"])
