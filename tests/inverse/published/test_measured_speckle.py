"""Measured speckle: objects from real autocorrelations, and how real intensities are spread."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from nlosoptics import inverse


@pytest.fixture(scope="module")
def script(root):
    path = root / "benchmarks/inverse/real_speckle.py"
    spec = importlib.util.spec_from_file_location("real_speckle", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["real_speckle"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def seven(data, script):
    name, file, size = script.OBJECTS[1]
    path = data / script.CORRELOGRAPHY / file
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    assert name.startswith("7")
    lags = script.measured_lags(path)
    return inverse.object_from_autocorrelation(lags, object_size=size, restarts=8)


def test_two_halves_of_the_restarts_find_the_same_seven(seven):
    # measured 0.97
    assert seven.score > 0.9
    assert seven.status == "converged"


def test_the_seven_is_a_bar_and_a_slanted_stroke(seven):
    """A level bar at one end of the box, and from it one stroke that moves on row by row."""
    rows, columns = seven.physical_parameters["object_size"]
    top, left = (length - n for length, n in zip(seven.object.shape, (rows, columns), strict=True))
    box = seven.object[top // 2 : top // 2 + rows, left // 2 : left // 2 + columns]
    # the bar is the only row lit over most of its columns
    lit = (box > 0.25 * box.max()).mean(axis=1)
    bar = int(np.argmax(lit))
    assert lit[bar] > 0.5
    away = np.abs(np.arange(rows) - bar) > 3
    assert lit[away].max() < lit[bar] / 2
    # the stroke's brightest column goes with the row
    kept = away & (box.max(axis=1) > 0.3 * box.max())
    place = box.argmax(axis=1)[kept]
    assert abs(np.corrcoef(np.flatnonzero(kept), place)[0, 1]) > 0.9
