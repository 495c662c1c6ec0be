"""Light on rough walls: one surface for one seed, whose mean over seeds is the microfacet lobe."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlosoptics import raytrace
from nlosoptics.scene import (
    ConcaveWall,
    FacetWall,
    GaussianWall,
    Scene,
    SpecularMicrofacet,
    WallRoughness,
)

SLOPE = 4e-3


@pytest.fixture(scope="module")
def gloss():
    """The rough letter scene with a wall that only mirrors."""
    scene = Scene.load(Path(__file__).parents[3] / "examples" / "scenes" / "letter_rough.toml")
    return replace(
        scene,
        wall_material=SpecularMicrofacet(0.05, 0.0),
        wall_roughness=WallRoughness(FacetWall(1e-3, SLOPE)),
    )


def window(scene, count=5, pitch=288e-6):
    """Options of `trace_point` for pixels about the mirror image of the object point."""
    camera = scene.camera
    away = scene.mirrored_object_point - np.array(camera.position)
    centre = -scene.image_distance * (camera.frame[:2] @ away) / (camera.axis @ away)
    first = tuple(float(c) for c in centre - (count - 1) / 2 * pitch)
    return {"pitch": pitch, "shape": (count, count), "first": first}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["facets", "bumps"])
def test_the_mean_of_patterns_is_the_lobe(kind, gloss):
    # 2^14 rays: an error of 2 % a pattern and 1 % for the lobe
    seeds, n_rays = (24, 1 << 14) if kind == "facets" else (6, 1 << 12)
    options = window(gloss)

    def heights(seed):
        if kind == "facets":
            return FacetWall(1e-3, SLOPE, seed=seed)
        return GaussianWall(SLOPE * 1e-3 / math.sqrt(2), 1e-3, seed=seed)

    lobe = replace(gloss, wall_roughness=WallRoughness(heights(0), "mean"))
    mean = raytrace.trace_point(lobe, n_rays=1 << 17, **options)
    found = []
    for seed in range(seeds):
        one = replace(gloss, wall_roughness=WallRoughness(heights(seed)))
        found.append(raytrace.trace_point(one, n_rays=n_rays, **options).energy)
    found = np.array(found)
    # patterns differ by far more than their rays' noise; their own spread is the error
    error = found.std(axis=0, ddof=1) / math.sqrt(seeds) + mean.energy_error
    flux = found.sum(axis=(1, 2))
    spread = math.hypot(flux.std(ddof=1) / math.sqrt(seeds), mean.flux_error)
    assert abs(flux.mean() - mean.flux) < 4 * spread
    assert spread < 0.05 * mean.flux
    # of the mean the pixels' rays find nothing: its mirror image comes with the flux
    assert mean.energy.sum() == pytest.approx(mean.flux, rel=0.05)
    bright = mean.energy > 0.02 * mean.flux
    assert bright.sum() >= 9
    assert (np.abs(found.mean(axis=0) - mean.energy)[bright] < 4 * error[bright]).all()
    # and not the image of a smooth wall, which is a point
    assert mean.energy.max() < 0.5 * mean.flux


@pytest.mark.thorough
def test_each_seed_is_one_surface(gloss):
    options = {**window(gloss), "n_rays": 1 << 17}

    def energy(seed, tracing):
        scene = replace(gloss, wall_roughness=WallRoughness(FacetWall(1e-3, SLOPE, seed=seed)))
        return raytrace.trace_point(scene, seed=tracing, **options)

    one, again, other = energy(1, 0), energy(1, 9), energy(2, 0)
    assert (energy(1, 0).energy == one.energy).all()
    noise = math.sqrt((one.energy_error**2 + again.energy_error**2).sum())
    assert np.linalg.norm(one.energy - again.energy) < 2 * noise
    assert np.linalg.norm(one.energy - other.energy) > 3 * noise


@pytest.mark.thorough
def test_all_light_on_rough_walls(gloss):
    """Total flux and balance of a full trace, on a flat and a curved mean wall."""
    scene = Scene.load(Path(__file__).parents[3] / "examples" / "scenes" / "letter_rough.toml")
    for wall in (scene.wall, ConcaveWall(5.0, size=(1.4, 1.0))):
        pattern = replace(scene, wall=wall)
        mean = replace(pattern, wall_roughness=replace(scene.wall_roughness, realisation="mean"))
        one, other = (raytrace.trace(s, n_rays=1 << 14, seed=3) for s in (pattern, mean))
        # the diffuse lobe dominates: facets of 2 mrad change the flux by far less than the noise
        noise = math.hypot(one.standard_error, other.standard_error)
        assert abs(one.flux - other.flux) < 4 * noise
        assert noise < 0.2 * one.flux
        assert one.ledger["unresolved"] == 0.0

    def flux(scene):
        return raytrace.trace(scene, n_rays=1 << 10).flux

    assert flux(scene) == flux(scene.with_relief()) != flux(replace(scene, wall_roughness=None))
    assert raytrace.ray_plan(scene).wall_hits == "march"
    smooth = replace(scene, wall_roughness=replace(scene.wall_roughness, realisation="mean"))
    assert raytrace.ray_plan(smooth).wall_hits == "closed form"


def test_irradiance_is_per_area_of_the_mean_wall(gloss):
    scene = Scene.load(Path(__file__).parents[3] / "examples" / "scenes" / "letter_rough.toml")
    steep = replace(
        scene,
        wall_roughness=WallRoughness(FacetWall(1e-3, 0.3)),
        wall_material=scene.wall_material.parts[0],
    )
    flat = replace(steep, wall_roughness=None)
    options = {"shape": (2, 3), "source": "object", "max_bounces": 0, "n_rays": 1 << 15}
    one, other = (raytrace.wall_irradiance(s, **options) for s in (steep, flat))
    error = np.hypot(one.standard_error, other.standard_error)
    # the light that falls on the mean wall falls on the relief; its true area is 9 % larger
    assert (np.abs(one.irradiance - other.irradiance) < 4 * error + 0.01 * other.irradiance).all()
    assert (error < 0.02 * other.irradiance).all()
