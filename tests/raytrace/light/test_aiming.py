"""Rays aimed at a mesh, the chart on which they are drawn, and shared eye paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics.raytrace import trace
from nlosoptics.raytrace.intersection.prepared_meshes import prepared_mesh
from nlosoptics.raytrace.light import _surround_kernels as kernels
from nlosoptics.raytrace.light import blocks, surroundings
from nlosoptics.raytrace.light.surroundings import Surroundings, lit_patches
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    Scene,
    SpecularMicrofacet,
)


def room(**changes):
    """A coarse ball and a slab of unequal triangles beside it, lit by way of a flat wall."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.15)
    slab = trimesh.creation.box((0.3, 0.4, 0.05)).apply_translation((-0.3, 0.1, 0.1))
    scene = Scene(
        Laser(
            wavelength=633e-9,
            power=1.0,
            beam_diameter=0.003,
            position=(0.8, 0.4, 1.2),
            aim=(0.5, 0.1, 0.0),
        ),
        FlatWall(size=2.0),
        MeshObject(mesh=trimesh.util.concatenate(ball, slab), position=(0.4, 0.0, 0.8)),
        Camera(
            position=(-0.4, 0.0, 0.8),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.02,
            focus_distance=0.9,
        ),
        wall_material=Lambert(0.7),
    )
    return replace(scene, **changes)


def drawn(world, splits, count):
    """Triangles (count^2,) that a grid of points in the unit square meets, and their points."""
    middles = (np.arange(count) + 0.5) / count
    found = [(u, v) for u in middles for v in middles]
    return (
        np.array([kernels._triangle(world, splits, u, v)[0] for u, v in found]),
        np.array([kernels.object_point(world, splits, u, v)[0] for u, v in found]),
    )


@pytest.mark.thorough
def test_chart_keeps_areas_and_neighbours():
    scene = room()
    chart, world = prepared_mesh(scene.hidden.surface).chart, Surroundings(scene).world
    areas = np.diff(chart.shares)
    triangles, points = drawn(world, world.splits, 256)
    found = np.bincount(triangles, minlength=len(areas)) / len(triangles)
    # a grid of 256 lines counts the area of a cell to a line along each of its sides
    assert np.abs(found - areas).max() < 2 * np.sqrt(areas.max()) / 256
    steps = np.linalg.norm(np.diff(points.reshape(256, 256, 3), axis=1), axis=-1)
    extent = np.ptp(points, axis=0).max()
    assert np.median(steps) < 0.02 * extent
    assert (steps > 0.25 * extent).mean() < 0.03  # seams


def test_lit_patches_are_a_density_and_prefer_what_the_spot_lights():
    scene = room()
    chart = prepared_mesh(scene.hidden.surface).chart
    lit = lit_patches(scene, chart)
    assert lit @ chart.areas == pytest.approx(1.0, rel=1e-12)
    assert lit.min() >= 0.125 / chart.area * (1 - 1e-12)
    behind = chart.normals[:, 2] > 0.9 * chart.areas
    before = chart.normals[:, 2] < -0.9 * chart.areas
    assert lit[before].min() > 5 * lit[behind].max()
    world = Surroundings(scene).world
    triangles, _ = drawn(world, world.lit_splits, 128)
    shares = np.bincount(
        np.searchsorted(chart.firsts, triangles, side="right") - 1, minlength=len(lit)
    )
    np.testing.assert_allclose(shares / len(triangles), lit * chart.areas, atol=0.01)


GLOSS = SpecularMicrofacet(0.6, 0.2, distribution="ggx")


@pytest.mark.parametrize(
    "changes",
    [{}, {"wall_material": GLOSS}, {"wall": ConcaveWall(3.0, size=2.0)}],
    ids=["matt", "glossy", "hollow"],
)
def test_flux_does_not_depend_on_where_rays_are_aimed(changes, monkeypatch):
    """Drawing and weighting use the same densities: quite other ones give the same flux."""
    scene = room(**changes)
    found = [trace(scene, n_rays=1 << 15, max_bounces=4, seed=1)]
    for power in (0.0, -1.0):

        def other(scene, chart, power=power):
            weights = chart.areas * (1.2 + np.sin(np.arange(len(chart.areas)))) ** power
            return weights / weights.sum() / chart.areas

        monkeypatch.setattr(surroundings, "lit_patches", other)
        found.append(trace(scene, n_rays=1 << 15, max_bounces=4, seed=2))
    for result in found[1:]:
        off = result.flux - found[0].flux
        assert abs(off) < 4 * np.hypot(result.standard_error, found[0].standard_error)
        assert result.standard_error > found[0].standard_error


@pytest.mark.parametrize("n", [1, 31, 33, 100, 1024, 4096, 3000])
def test_partners_share_group_and_unit_and_weigh_one(n):
    partners = blocks._partners(n, 4)
    rays = np.arange(n)
    np.testing.assert_allclose(sum(share for _, share in partners), 1.0, rtol=1e-15)
    np.testing.assert_array_equal(partners[0][0], rays)
    for rows, share in partners:
        used = rows[share > 0]
        assert len(set(used.tolist())) == len(used)
        np.testing.assert_array_equal(rows % blocks.GROUPS, rays % blocks.GROUPS)
        np.testing.assert_array_equal(rows // blocks.UNIT, rays // blocks.UNIT)


def test_shared_eye_paths_lower_the_error_and_keep_the_flux(monkeypatch):
    screen = trimesh.creation.box((0.2, 0.2, 0.01)).apply_translation((0.2, 0.0, 0.4))
    scene = room(occluders=(screen,))
    many = trace(scene, n_rays=8192, max_bounces=3, sampler="philox", seed=3)
    monkeypatch.setattr(blocks, "PARTNERS", 1)
    one = trace(scene, n_rays=8192, max_bounces=3, sampler="philox", seed=4)
    assert abs(many.flux - one.flux) < 4 * np.hypot(many.standard_error, one.standard_error)
    assert many.standard_error < 0.9 * one.standard_error
