"""Tables of methods and jackknife errors, from patterns made by hand."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.metrics import comparisons
from nlosoptics.psf.transform import huygens
from nlosoptics.psf.transform.point_spread import METHODS
from nlosoptics.psf.wave.detilted import split

WAVELENGTH, RADIUS, DISTANCE = 600e-9, 3e-3, 0.05
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}


@pytest.fixture(scope="module")
def wave():
    return psf.Wavefront.from_zernike({4: 4e-8, 7: 3e-8}, **SYSTEM)


def pattern(intensity, error):
    real = psf.point_spread(psf.Wavefront.from_zernike({}, **SYSTEM), shape=3, pitch=1e-6)
    return replace(real, intensity=np.asarray(intensity, float), error_estimate=error)


@pytest.mark.parametrize("huygens_error", [1e-9, None])
def test_rows_against_the_best_method(huygens_error):
    """The best is that of the least error but for huygens, unless that alone ran."""
    image = np.array([[1.0, 4.0], [2.0, 3.0]])
    done = {
        "fft": (0.3, pattern(image + 0.5, 1e-3)),
        "mdft": (0.2, pattern(image, 1e-5)),
        "nufft": (0.1, pattern(image - [[0.0, 1.0], [0.2, 0.0]], 1e-4)),
    }
    if huygens_error:
        done["huygens"] = (0.7, pattern(2 * image, huygens_error))
    reasons = {m: f"not {m}" for m in METHODS[1:] if m not in done}
    found = comparisons._table(done, reasons, 1e-6, (2, 3))
    assert [row.method for row in found.rows] == list(METHODS[1:])
    assert (found.best, found.pitch, found.shape) == ("mdft", 1e-6, (2, 3))
    rows = {row.method: row for row in found.rows}
    assert rows["fft"].difference == approx(0.5 / 4)
    assert rows["mdft"].difference == 0
    assert rows["nufft"].difference == approx(1.0 / 4)
    assert (rows["fft"].seconds, rows["fft"].error_estimate, rows["fft"].reason) == (0.3, 1e-3, "")
    assert rows["airy"] == psf.ComparisonRow(method="airy", reason="not airy")
    if huygens_error:
        assert rows["huygens"].difference == approx(4.0 / 4)
    lines = str(found).splitlines()
    assert lines[0] == "2 x 3 samples of 1e-06 m, against mdft"
    assert lines[1].split() == ["method", "seconds", "estimate", "max", "dI"]
    assert len(lines) == 1 + len(METHODS)
    by_name = {line.split()[0]: line for line in lines[2:]}
    assert by_name["airy"].split(maxsplit=1)[1] == "not airy"
    assert by_name["nufft"].split()[1:] == ["0.1", "1.0e-04", "2.5e-01"]


def test_tables_of_huygens_alone_or_of_nothing():
    image = np.array([[1.0, 4.0], [2.0, 3.0]])
    others = {m: "no" for m in METHODS[1:] if m != "huygens"}
    alone = comparisons._table({"huygens": (0.7, pattern(image, 0.1))}, others, 1e-6, (2, 2))
    assert alone.best == "huygens"
    none = comparisons._table({}, others | {"huygens": "no"}, 1e-6, (2, 2))
    assert none.best == ""
    assert str(none).splitlines()[0].endswith("against none")
    assert all(row.seconds is None for row in none.rows)


def test_methods_of_a_wave_are_run(wave, monkeypatch):
    """As often as asked for, the shortest time counts; what is refused says why."""
    calls, clock = [], iter(np.cumsum(np.tile([0.0, 5.0, 0.0, 2.0, 0.0, 3.0], 20)).tolist())

    def counted(front, **options):
        calls.append(options)
        if options["method"] == "nufft":
            raise SamplingError("too few nodes")
        return pattern(np.full((5, 6), 1.0), 1e-4)

    monkeypatch.setattr(comparisons, "point_spread", counted)
    monkeypatch.setattr(comparisons.time, "perf_counter", lambda: next(clock))
    asked = {"tol": 0.02, "pitch": 1e-6, "shape": (5, 6), "pixel_integrated": True, "repeats": 3}
    found = psf.compare(wave, **asked)
    rows = {row.method: row for row in found.rows}
    assert rows["nufft"].reason == "too few nodes"
    assert rows["fft"].seconds == 2.0
    assert sum(call["method"] == "fft" for call in calls) == 3
    for call in calls:
        assert (call["tol"], call["pitch"], call["shape"]) == (0.02, 1e-6, (5, 6))
        assert call["pixel_integrated"]
    assert (found.pitch, found.shape) == (1e-6, (5, 6))


@pytest.mark.parametrize("longest", [0.5, 2.0])
def test_slow_sums_are_skipped(wave, monkeypatch, longest):
    """Four corners of the window say how long its samples take, 12 of them here."""
    seen = []

    def seconds(residual, corners):
        seen.append(np.array(corners))
        return 4 * 1.0 / 12

    monkeypatch.setattr(huygens, "seconds", seconds)
    monkeypatch.setattr(
        comparisons, "point_spread", lambda *_, **__: pattern(np.ones((3, 4)), 1e-4)
    )
    found = psf.compare(wave, pitch=2e-6, shape=(3, 4), longest=longest)
    row = next(row for row in found.rows if row.method == "huygens")
    assert row.reason == ("would take about 1 s, limit 0.5 s" if longest < 1 else "")
    corners = {tuple(corner) for corner in seen[0].round(9).tolist()}
    assert corners == {(x, y, DISTANCE) for x in (-4e-6, 2e-6) for y in (-2e-6, 2e-6)}
    assert comparisons._huygens_seconds(split(wave), 2e-6, (3, 4)) == approx(1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tol": 0.0}, "tol = 0"),
        ({"tol": 1.01}, "tol = 1.01"),
        ({"repeats": 0}, "repeats = 0"),
        ({"longest": 0.0}, "longest = 0 s"),
    ],
)
def test_comparisons_that_are_refused(wave, options, message):
    with pytest.raises(SceneError, match=re.escape(message)):
        psf.compare(wave, **options)


@pytest.mark.parametrize("n", [2, 5])
def test_jackknife(n):
    """Of a metric that is not linear: values without each pattern in turn."""
    rng = np.random.default_rng(n)
    images, energies = rng.random((n, 3, 4)), rng.random(n)
    patterns = [
        replace(pattern(image, 0.1), enclosed_energy=energy)
        for image, energy in zip(images, energies.tolist(), strict=True)
    ]

    def metric(spread):
        return [spread.intensity[1, 2] ** 2, spread.enclosed_energy * spread.intensity[0, 0]]

    def value(kept):
        mean, energy = images[kept].mean(axis=0), energies[kept].mean()
        return np.array([mean[1, 2] ** 2, energy * mean[0, 0]])

    found = psf.metric_estimate(metric, iter(patterns))
    every = np.arange(n)
    assert found.value == approx(value(every), rel=1e-12)
    others = np.array([value(np.delete(every, i)) for i in every])
    square = (n - 1) / n * np.sum((others - others.mean(axis=0)) ** 2, axis=0)
    assert found.standard_error == approx(np.sqrt(square), rel=1e-9)
    assert found.n_patterns == n


def test_patterns_that_differ():
    one = pattern(np.ones((3, 4)), 0.1)
    for name, value in (
        ("pitch", 2e-6),
        ("wavelength", 5e-7),
        ("normalisation", "flux"),
        ("pixel_integrated", True),
        ("intensity", np.ones((4, 4))),
    ):
        word = "shape" if name == "intensity" else name
        with pytest.raises(SceneError, match=f"patterns differ in {word}"):
            psf.metric_estimate(psf.centroid, [one, one, replace(one, **{name: value})])
    with pytest.raises(SceneError, match="needs at least 2 patterns, got 0"):
        psf.metric_estimate(psf.centroid, [])
    for bad in (math.nan, [1.0, math.inf]):
        with pytest.raises(SamplingError, match="the metric is"):
            psf.metric_estimate(lambda _, bad=bad: bad, [one, one])
