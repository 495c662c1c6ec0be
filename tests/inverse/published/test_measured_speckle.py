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


@pytest.mark.parametrize("name", ["letter_E", "letter_S", "number_8", "number_9"])
def test_real_speckle_is_fully_developed(data, script, name):
    path = data / "bu_deep_speckle" / f"{name}.npy"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    found = script.speckle_statistics(np.load(path)[..., 0])
    # 5 x 65536 samples, grains of 10 pixels, a profile across the frame: a tenth of the contrast
    np.testing.assert_allclose(found["contrast"], 1.0, atol=0.12)
    assert found["second_moment"] == pytest.approx(2.0, rel=0.1)
    assert found["above_mean"] == pytest.approx(np.exp(-1.0), abs=0.02)
    # diffusers scramble the frame and leave its autocorrelation
    assert found["frames_alike"] < 0.4 < 0.9 < found["autocorrelations_alike"]


def test_statistics_of_drawn_speckle(script):
    """Exponential intensity with grains of known width: the script's own check."""
    rng = np.random.default_rng(0)
    frequency = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256))
    field = rng.normal(size=(4, 256, 256)) + 1j * rng.normal(size=(4, 256, 256))
    frames = np.abs(np.fft.ifft2(np.fft.fft2(field) * (frequency < 0.125))) ** 2
    found = script.speckle_statistics(frames)
    # 4 x 3200 independent grains: 1 % of the contrast, k sqrt(k)-fold for the k-th moment
    np.testing.assert_allclose(found["contrast"], 1.0, atol=0.08)
    assert found["second_moment"] == pytest.approx(2.0, rel=0.06)
    assert found["third_moment"] == pytest.approx(6.0, rel=0.2)
    assert found["above_mean"] == pytest.approx(np.exp(-1.0), abs=0.01)
    # the squared jinc's half width, 0.514 over the disc's diameter of 1/4 per pixel, both sides
    assert found["grain_pixels"] == pytest.approx(2 * 0.514 / 0.25, rel=0.05)
    assert abs(found["frames_alike"]) < 0.02
