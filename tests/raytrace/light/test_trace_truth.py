"""The benchmark's scene: traced light against plain quadrature over letter and wall."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from pytest import approx

from nlosoptics.raytrace import ray_plan, trace


@pytest.fixture(scope="module")
def wu_scene(root: Path):
    """The module that builds the scene and integrates its light without rays."""
    spec = importlib.util.spec_from_file_location("wu_scene", root / "benchmarks" / "wu_scene.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["wu_scene"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["wu_scene"]


@pytest.mark.thorough
def test_letter_of_triangles_is_traced_to_the_quadrature(wu_scene):
    """Three reflections, and five, in which light returns from the wall to the letter once more."""
    three, five = wu_scene.flux()[3], wu_scene.flux()[5]
    found = trace(wu_scene.scene(), n_rays=1 << 17, max_bounces=5, seed=3)
    # the quadrature is good to 1e-9
    assert found.by_bounce_error[3] < 1e-4 * three
    assert found.by_bounce[3] == approx(three, abs=4 * found.by_bounce_error[3])
    assert found.by_bounce_error[5] < 1e-2 * five
    assert found.by_bounce[5] == approx(five, abs=4 * found.by_bounce_error[5])
    assert found.by_bounce[4] == found.stray == 0.0


def test_plan_says_what_the_letter_takes(wu_scene):
    table = str(ray_plan(wu_scene.scene())).splitlines()
    runs = {line.split("  ")[0]: " runs " in line for line in table}
    assert runs == {
        "wall hits": True,
        "triangles": True,
        "wall to wall": False,
        "wall shadows": False,
        "three strategies": False,
        "mirror chains": False,
    }
