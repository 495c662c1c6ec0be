"""Fixtures of the tests of point spreads."""

from __future__ import annotations

import importlib.util
import sys
import types
import warnings
from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], types.ModuleType]:
    """Import a package of the test extra, or skip; its warnings on import are not ours."""

    def load(name: str) -> types.ModuleType:
        # prysm 0.21 asks for its own version by a module that setuptools 82 no longer has
        lacking = "pkg_resources" not in sys.modules
        if lacking and importlib.util.find_spec("pkg_resources") is None:
            stand_in = types.ModuleType("pkg_resources")
            monkeypatch.setattr(stand_in, "get_distribution", distribution, raising=False)
            monkeypatch.setitem(sys.modules, "pkg_resources", stand_in)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pytest.importorskip(name)

    return load


@pytest.fixture
def draw(root: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """``draw(seed, index, max_seconds, kind)``: a wave of the benchmark and what is asked of it."""
    monkeypatch.syspath_prepend(root / "benchmarks")
    import psf_study

    return psf_study.draw
