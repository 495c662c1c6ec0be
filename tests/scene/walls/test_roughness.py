"""Roughness of a scene: its effect on wall and lobes, and contradictory input."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlosoptics.errors import SceneError
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    FacetWall,
    FlatWall,
    GaussianWall,
    HeightMapWall,
    Lambert,
    OrenNayar,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    WallRoughness,
    Ward,
)

FACETS = FacetWall(1e-3, 2e-3, seed=1)
MAP = HeightMapWall(1e-6 * np.random.default_rng(0).normal(size=(101, 141)), 1e-2)


@pytest.fixture(scope="module")
def flat():
    return Scene.load(Path(__file__).parents[3] / "examples" / "scenes" / "letter_flat.toml")


def rough(scene, roughness=None, *lobes, **changes):
    """The scene with roughness, and with a material of these lobes if any are given."""
    if lobes:
        changes["wall_material"] = SumMaterial(*lobes)
    return replace(scene, wall_roughness=roughness or WallRoughness(FACETS), **changes)


def test_a_pattern_is_added_to_the_wall(flat):
    x, y = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 500))
    for heights in (FACETS, GaussianWall(1e-6, 1e-3, seed=1), MAP):
        for wall in (FlatWall(size=(1.4, 1.0)), ConcaveWall(5.0, size=1.0)):
            scene = rough(flat, WallRoughness(heights), wall=wall)
            relief = scene.with_relief()
            assert relief.wall_roughness is None
            assert relief.wall.size == wall.size
            expected = wall.height(x, y) + heights.height(x, y)
            assert (relief.wall.height(x, y) == expected).all()
            assert scene.wall is wall
    assert flat.with_relief() is flat
    assert relief.with_relief() is relief


def test_each_lobe_has_its_slope_once(flat):
    s = FACETS.slope_rms
    body, wide = OrenNayar(0.4, 0.3), SpecularMicrofacet(0.1, 0.3)
    ward = Ward(0.1, math.sqrt(2) * s)
    lobes = (body, wide, SpecularMicrofacet(0.05, s * (1 + 1e-10)), SpecularMicrofacet(0.03, 0.0))
    pattern = rough(flat, None, *lobes, ward).with_relief().wall_material
    assert pattern.parts == (
        body,
        wide,
        SpecularMicrofacet(0.05, 0.0),
        SpecularMicrofacet(0.03, 0.0),
        SpecularMicrofacet(0.1, 0.0),
    )
    scene = rough(flat, WallRoughness(FACETS, "mean"), *lobes, ward)
    mean = scene.with_relief()
    assert mean.wall is scene.wall
    assert mean.wall_material.parts == (*lobes[:3], SpecularMicrofacet(0.03, s), ward)
    ggx = SpecularMicrofacet(0.03, 0.0, distribution="ggx")
    # a smooth GGX lobe is a mirror; the facets that scatter it are Gaussian
    one = replace(rough(flat, WallRoughness(FACETS, "mean")), wall_material=ggx).with_relief()
    assert one.wall_material == SpecularMicrofacet(0.03, s)
    matt = replace(rough(flat), wall_material=Lambert(0.5))
    assert matt.with_relief().wall_material == Lambert(0.5)


def test_a_rough_lobe_of_the_same_slope_is_the_reliefs_too(flat):
    heights = FacetWall(1e-3, 0.3)
    scene = rough(flat, WallRoughness(heights), Lambert(0.5), SpecularMicrofacet(0.1, 0.3))
    assert scene.with_relief().wall_material.parts[1] == SpecularMicrofacet(0.1, 0.0)


def test_slopes_of_the_three_kinds():
    assert WallRoughness(FACETS).slope_rms == 2e-3
    assert WallRoughness(GaussianWall(1e-6, 1e-3)).slope_rms == pytest.approx(math.sqrt(2) * 1e-3)
    slopes = MAP.derivatives(*np.meshgrid(1e-2 * np.arange(-70, 71), 1e-2 * np.arange(-50, 51)))
    rms = math.sqrt((slopes[..., 1:3] ** 2).mean())
    assert WallRoughness(MAP).slope_rms == pytest.approx(rms, rel=1e-9)
    steepest = np.hypot(slopes[..., 1], slopes[..., 2]).max()
    assert WallRoughness(MAP).steepest == pytest.approx(steepest, rel=1e-9)


def mound(x, y):
    return 0.0 * x


def slopes_of_mound(x, y):
    return 0.0 * x, 0.0 * y


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: WallRoughness(FlatWall()), "heights is a FlatWall; give a FacetWall"),
        (lambda s: WallRoughness(FacetWall(1e-3, 2e-3, size=1.0)), "leave out its size"),
        (lambda s: WallRoughness(FacetWall(1.0, 0.8), "mean"), "from 0 to 0.7 rad"),
        (
            lambda s: rough(s, None, Lambert(0.5), SpecularMicrofacet(0.1, 2.001e-3)),
            "mirror-like lobe of slope_rms = 0.002001 rad, .* has 0.002 rad",
        ),
        (
            lambda s: rough(s, None, SpecularMicrofacet(0.1, 2e-3, distribution="ggx")),
            "GGX lobe of slope_rms = 0.002 rad",
        ),
        (
            lambda s: rough(
                s, wall=CallableWall(mound, slopes_of_mound, max_height=0.0, max_curvature=0.0)
            ),
            "cannot be added to a CallableWall; sample its heights",
        ),
        (lambda s: rough(s, WallRoughness(MAP), wall=FlatWall()), "the wall has no size"),
    ],
)
def test_what_does_not_fit_is_refused(make, message, flat):
    with pytest.raises(SceneError, match=message):
        make(flat)
