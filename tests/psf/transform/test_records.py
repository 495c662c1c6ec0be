"""Point spreads of random waves by every transform, and what is predicted of them, on record."""

import pytest

from nlosoptics import psf
from nlosoptics.psf.transform import selection
from nlosoptics.psf.transform.point_spread import METHODS
from nlosoptics.psf.transform.runners import Task
from nlosoptics.psf.walls.scene_costs import smooth_cost
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.window.pixels import pixel_rule

from ...records import attempt

KINDS = ("polar", "cells", "grid", "scattered", "map")
SEED = 23


def task_of(wave, options):
    residual = split(wave)
    shape, pitch = (options["shape"], options["shape"]), options["pitch"]
    whole = options["pixel_integrated"]
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape)) if whole else None
    return Task(residual, options["tol"], pitch, shape, rule)


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("kind", KINDS)
def test_a_random_wave(kind, index, draw, on_record):
    case = draw(SEED, index, 0.4, kind)
    task = task_of(case.front, case.options)
    where = case.options["pitch"], task.shape, case.options["tol"]
    on_record(
        {
            "spread": attempt(psf.point_spread, case.front, **case.options, model="scalar"),
            "ways": attempt(selection.candidates, task, regime(task.residual, task.pitch)),
            "cost": attempt(smooth_cost, task.residual, *where),
        }
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("model", ["scalar", "high-aperture"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_named_method(kind, model, method, draw, on_record):
    case = draw(SEED, 1, 0.4, kind)
    asked = {"tol": 3e-2, "pitch": case.options["pitch"], "shape": (11, 16), "model": model}
    asked |= {"method": method, "max_seconds": 1.0, "polarisation": 0.3}
    if model == "scalar":
        del asked["polarisation"]
    on_record([attempt(psf.point_spread, case.front, **asked, pixel_integrated=b) for b in (0, 1)])
