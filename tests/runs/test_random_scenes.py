"""Random scenes: what the plan accepts runs, within its memory, without warnings and NaN.

`benchmarks/random_scenes.py` does the same on thousands, each in a process of its own.
"""

from __future__ import annotations

import warnings
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import nlosoptics as nlos
from nlosoptics.errors import NlosError, SceneError, ValidityWarning

from .random_scenes import random_case

QUICK = 2.0  # s of the processor, predicted: tighter and larger scenes are the benchmark's
MEMORY = 2.0**31


def not_finite(value, name="result"):
    """Names of arrays and numbers within a noun that hold NaN or infinity."""
    if isinstance(value, (np.ndarray, float)):
        finite = np.asarray(value).dtype.kind not in "fc" or np.isfinite(value).all()
        return [] if finite else [name]
    if not is_dataclass(value):
        return []
    parts = (f for f in fields(value) if f.name not in ("scene", "plan", "regime", "aperture"))
    return [n for f in parts for n in not_finite(getattr(value, f.name), f"{name}.{f.name}")]


# of the last two rough scenes, one point spread suffices, and its halo reaches beyond the window
CASES = [(n, False) for n in range(20)] + [(n, True) for n in (0, 1, 10006, 10019)]
CASES = [*CASES[:2], *(pytest.param(*case, marks=pytest.mark.thorough) for case in CASES[2:])]


@pytest.mark.parametrize(("number", "rough"), CASES)
def test_what_is_planned_runs(number, rough):
    case = random_case(number, wild=number % 2 == 1, rough=rough)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ValidityWarning)
        try:
            plan = nlos.plan(case.scene, case.tol, memory=MEMORY)
        except NlosError as refusal:
            pytest.skip(f"refused: {refusal}")
        assert 0 < plan.seconds < np.inf
        assert 0 < plan.memory <= MEMORY
        if plan.seconds > QUICK or not plan.runs("wave aberration"):
            pytest.skip("not quick, or without a wave")
        result = nlos.simulate(case.scene, case.tol, seed=number, memory=MEMORY)
    assert not not_finite(result)
    assert result.plan == plan
    assert result.errors["point spread"] <= case.tol
    lowest = float(result.point_spread.intensity.min())
    assert lowest >= -1e-9 * result.point_spread.intensity.max()


def test_the_cone_of_light_is_free_at_every_node_that_the_field_will_have():
    """An occluder that cuts the light of one node, and none at the centre, corners and edges."""
    case = random_case(90101, wild=True)
    with pytest.raises(SceneError, match="cut .* of the cone of light"):
        nlos.plan(case.scene, case.tol)


def test_a_budget_holds_in_the_whole_run(flat_scene):
    """A run is refused before it starts, and as the plan would refuse it."""
    for limits in ({"memory": 1e6}, {"max_seconds": 1e-3}):
        with pytest.raises(NlosError) as planned:
            nlos.plan(flat_scene, **limits)
        with pytest.raises(NlosError) as refused:
            nlos.simulate(flat_scene, **limits)
        assert type(refused.value) is type(planned.value)
        assert str(refused.value) == str(planned.value)
