"""Attempts of transforms in their order, each counted, and what is said if none succeeds."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.transform import geometric, selection
from nlosoptics.psf.transform.runners import Result, Task
from nlosoptics.psf.transform.selection import Candidate
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window.error_bounds import rounded_up
from nlosoptics.psf.window.pixels import pixel_rule

SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
UNIT = 6e-7 * 7.5  # lambda N, m


def task_of(pixels=False, shape=(9, 14), pitch=0.3 * UNIT, tol=1e-3, **options):
    wave = psf.Wavefront.from_zernike({4: 9e-7, 7: 3e-7}, **SYSTEM, **options)
    residual = split(wave)
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape)) if pixels else None
    return Task(residual, tol, pitch, shape, rule)


FEW = SimpleNamespace(peak_to_valley=3.75, pixel=0.3)
MANY = SimpleNamespace(peak_to_valley=37.5, pixel=0.3)


@pytest.fixture
def attempts(monkeypatch):
    """Run `automatic` on candidates whose outcomes (error or refusal) are given; note the runs."""

    def run(outcomes, max_seconds, ruled_out=()):
        ran, offered = [], [Candidate(seconds, name) for name, (seconds, _) in outcomes.items()]

        def transform(task, method):
            ran.append(method)
            outcome = outcomes[method][1]
            if isinstance(outcome, Exception):
                raise outcome
            return Result(method, None, outcome, 1.0)

        monkeypatch.setattr(selection, "candidates", lambda *_: [*offered, *ruled_out])
        monkeypatch.setattr(selection, "transform", transform)
        try:
            result, said = selection.automatic(task_of(), FEW, max_seconds)
            return ran, result.method, said
        except (SamplingError, MemoryLimitError) as refusal:
            return ran, type(refusal), str(refusal)

    return run


BAD = Candidate(0.5, "geometric", "rays have no intensity at points")


def test_the_quickest_that_reaches_tol_is_taken(attempts):
    outcomes = {"mdft": (3.0, 1e-4), "fft": (2.0, 1e-3), "nufft": (1.0, 1.01e-3)}
    assert attempts(outcomes, 3.0, [BAD]) == (
        ["nufft", "fft"],
        "fft",
        "fft is the cheapest within tol = 0.001, about 2 s; geometric ruled out: rays have no "
        "intensity at points; nufft ran first, with an error of 0.001; mdft would take about 3 s",
    )
    late = Candidate(7.0, "airy", "the wave is not flat")
    assert attempts(outcomes, 3.0, [late])[2].endswith("; airy ruled out: the wave is not flat")


def test_time_of_what_fell_short_counts(attempts):
    """Time that is used up exactly suffices; what was refused at its start has used none."""
    outcomes = {"nufft": (1.0, 0.5), "fft": (2.0, 1e-4)}
    assert attempts(outcomes, 3.0)[:2] == (["nufft", "fft"], "fft")
    ran, error, said = attempts(outcomes, 2.99)
    assert (ran, error) == (["nufft"], SamplingError)
    assert said == (
        "fft of 3.75 waves to 9 x 14 samples would take about 2 s, limit max_seconds = 2.99; use "
        "max_seconds = 2, or a wider pitch with pixel_integrated=True, or tol = 0.5"
    )
    outcomes["nufft"] = (1.0, SamplingError("too few samples; use more"))
    ran, method, said = attempts(outcomes, 2.0)
    assert (ran, method) == (["nufft", "fft"], "fft")
    assert said.endswith("about 2 s; nufft failed: too few samples")
    outcomes["fft"] = (2.0, MemoryLimitError("too large; use fewer"))
    assert attempts(outcomes, 9.0) == (
        ["nufft", "fft"],
        MemoryLimitError,
        "too large; use fewer",
    )
    outcomes["fft"] = (2.0, SceneError("no refusal of a transform"))
    with pytest.raises(SceneError, match="no refusal of a transform"):
        attempts(outcomes, 9.0)


def test_the_best_that_fell_short_is_named(attempts):
    outcomes = {"nufft": (1.0, 0.5), "fft": (2.0, 0.02), "mdft": (3.0, 0.07)}
    assert attempts(outcomes, 9.0) == (
        ["nufft", "fft", "mdft"],
        SamplingError,
        "no transform reaches tol = 0.001, the best estimate is 0.02; use tol = 0.02, or more "
        "pupil nodes (now 24 x 96)",
    )
    assert attempts({}, 9.0, [BAD, Candidate(1.0, "airy", "the wave is not flat")]) == (
        [],
        SamplingError,
        "no transform reaches tol = 0.001 (geometric: rays have no intensity at points; airy: the "
        "wave is not flat); use a larger tol, or more pupil nodes (now 24 x 96)",
    )


def test_what_can_be_tried(attempts, monkeypatch):
    one, two = Candidate(1.0, "nufft"), Candidate(2.0, "fft")
    monkeypatch.setattr(selection, "candidates", lambda *_: [two, BAD, one])
    assert selection.able(task_of(), FEW) == [one, two]
    monkeypatch.setattr(selection, "candidates", lambda *_: [BAD])
    message = r"tol = 0\.001 \(geometric: rays have no intensity at points\)"
    with pytest.raises(SamplingError, match=message):
        selection.able(task_of(), FEW)


def too_long(task, regime, reached=float("inf"), method="quadrature"):
    with pytest.raises((SamplingError, MemoryLimitError)) as refusal:
        raise selection._too_long(task, regime, Candidate(123.4, method), reached, 7.5)
    return str(refusal.value)


def test_remedies_of_what_takes_too_long():
    task = task_of()
    reach = task.residual.rays.reach
    head = (
        "quadrature of {} waves to {} samples would take about 1.2e+02 s, limit max_seconds = 7.5; "
        "use max_seconds = 1.3e+02"
    )
    points = ", or a wider pitch with pixel_integrated=True"
    assert too_long(task, FEW) == head.format("3.75", "9 x 14") + points
    assert too_long(task, MANY) == head.format("37.5", "9 x 14") + points
    assert too_long(task, FEW, 0.0123) == head.format("3.75", "9 x 14") + points + (
        ", or tol = 0.013"
    )
    pixels = task_of(pixels=True)
    shape = "{} x {}".format(*pixels.samples.shape)
    assert too_long(pixels, FEW) == head.format("3.75", shape)
    least = geometric.least_error(pixels.residual, pixels.pitch)
    assert too_long(pixels, MANY) == head.format("37.5", shape) + (
        f", or a tol well above {least:.2g}, so that geometric rays suffice"
    )
    assert too_long(pixels, MANY, 0.2).endswith(f"use max_seconds = 1.3e+02, or tol = {0.2}")
    for share, wide in ((0.99, False), (1.01, True)):
        for shape in ((40, 5), (5, 40)):
            far = task_of(shape=shape, pitch=share * 3 * reach / 40)
            assert too_long(far, FEW).endswith(", or a smaller shape") == wide
    assert rounded_up(123.4) == "1.3e+02"


@pytest.mark.parametrize(
    ("options", "regime", "remedy"),
    [
        ({}, MANY, "use a smaller shape"),
        ({"pixels": True}, FEW, "use a smaller shape, or psf.wide_point_spread"),
        (
            {"pixels": True},
            MANY,
            "use a smaller shape, or on wide pixels a larger tol, so that geometric rays suffice",
        ),
        ({"pixels": True, "nodes": "grid", "samples": 64}, FEW, "use a smaller shape"),
    ],
)
def test_memory_comes_before_time(options, regime, remedy):
    """32 bytes a sample, where the grid of a soft rim does not tell its own need."""
    task = task_of(**options)
    ny, nx = task.samples.shape
    with within(Budget(memory=32.0 * ny * nx * (1 - 1e-6), seconds=9.0)):
        told = too_long(task, regime)
    assert told.startswith(f"a point spread that needs {ny} x {nx} samples needs")
    assert told.endswith(remedy)
    with within(Budget(memory=32.0 * ny * nx * (1 + 1e-6), seconds=9.0)):
        assert "would take about" in too_long(task, regime)
