"""Fans of rays to the lens, and the part of the wall that they meet."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf, raytrace
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil import aiming
from nlosoptics.raytrace.fans import pupil_fans
from nlosoptics.raytrace.fans.footprints import lens_footprint
from nlosoptics.raytrace.fans.material_slopes import material_slope
from nlosoptics.raytrace.fans.paths import DETECTED, ESCAPED, LEFT
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    OrenNayar,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    Ward,
    WavyWall,
)

WALLS = [
    FlatWall(),
    FlatWall(size=0.8),
    ConcaveWall(5.0),
    ConvexWall(0.3),  # its light comes from far off the plane mirror's place
    ConcaveWall(4.0, shape="cylinder", axis="x"),
    WavyWall(2e-5, 0.3, 0.4, direction=0.7),
    SumWall(WavyWall(1e-5, 0.25), WavyWall(1e-5, 0.35, direction=math.pi / 2)),
    CallableWall(
        lambda x, y: 1e-3 * np.sin(x),
        lambda x, y: (1e-3 * np.cos(x), 0 * y),
        max_height=1e-3,
        max_curvature=1e-3,
        finest_period=2 * math.pi,
    ),
]


def name(value):
    return type(value).__name__


# ---------------------------------------------------------------- footprints and slopes


@pytest.mark.parametrize("wall", WALLS, ids=name)
def test_footprint_holds_what_the_pupil_sees(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    found = lens_footprint(wall, scene.object_point, scene.camera)
    angle = np.linspace(0, 2 * math.pi, 64)
    rim = scene.camera.stop_diameter / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    axes = scene.camera.frame
    ends = aiming.pupil_points(scene.camera.position, axes[2], rim)
    seen = aiming.aim(wall, scene.object_point, ends, axes[2]).points[:, :2]
    assert (found.low < seen).all()
    assert (found.high > seen).all()
    # and little more: a third as wide again, with the margin for bend
    size = seen.max(axis=0) - seen.min(axis=0)
    assert ((found.high - found.low) < 4 / 3 * size).all()


def test_slope_is_that_of_the_strongest_rough_lobe(flat_scene):
    def slope(material):
        return material_slope(replace(flat_scene, wall_material=material))

    gloss = SpecularMicrofacet(0.1, 0.05)
    assert slope(gloss) == 0.05
    # Ward's alpha is sqrt(2) slopes
    assert slope(SumMaterial(gloss, Ward(0.3, 0.2))) == approx(0.2 / math.sqrt(2))
    assert slope(SumMaterial(Lambert(0.8), gloss)) == 0.05
    assert slope(SumMaterial(gloss, OrenNayar(0.5, 0.3))) == 0.3
    for smooth in (Lambert(0.8), SpecularMicrofacet(0.5, 0.0), OrenNayar(0.5, 0.0)):
        with pytest.raises(SceneError, match="no lobe with a slope; use a material"):
            slope(smooth)


# ---------------------------------------------------------------- fans of rays


@pytest.mark.parametrize("wall", WALLS, ids=name)
def test_rays_obey_the_law_of_reflection_and_their_status(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    rays = raytrace.pupil_rays(scene, n_rays=700, seed=2)
    assert rays.points.shape == (700, 3, 3)
    assert np.array_equal(rays.points[:, 0], np.tile(scene.object_point, (700, 1)))
    arrived = rays.status == DETECTED
    assert arrived.mean() > 0.3
    o, h, p = np.moveaxis(rays.points[arrived], 1, 0)
    first, second = np.linalg.norm(h - o, axis=1), np.linalg.norm(p - h, axis=1)
    assert rays.path_length[arrived] == approx(first + second, rel=1e-15)
    assert h[:, 2] == approx(wall.height(h[:, 0], h[:, 1]), abs=1e-12)
    # the change of direction is along the normal
    kink = (p - h) / second[:, None] - (h - o) / first[:, None]
    across = np.cross(kink, wall.normal(h[:, 0], h[:, 1]))
    assert abs(across).max() < 1e-12
    u, v, n = ((p - np.array(scene.camera.position)) @ scene.camera.frame.T).T
    assert abs(n).max() < 1e-14
    radius = scene.camera.stop_diameter / 2
    assert np.hypot(u, v).max() <= radius
    beside = (rays.status == ESCAPED) & (rays.n_bounces == 1)
    beside &= (rays.points[:, 1] != rays.points[:, 2]).any(axis=1)
    offset = rays.points[beside, 2] - np.array(scene.camera.position)
    assert np.linalg.norm(offset, axis=1).min() > radius
    assert sum(rays.ledger.values()) == approx(rays.weight.sum(), rel=1e-12)
    assert rays.flux == approx(rays.weight[arrived].sum(), rel=1e-12)


@pytest.mark.parametrize("wall", [FlatWall(), ConcaveWall(5.0), WavyWall(2e-5, 0.3)], ids=name)
def test_flux_is_the_pupils(flat_scene, wall):
    """Power of 1 W/sr through the lens, against quadrature of the ray tubes' spreading."""
    scene = replace(flat_scene, wall=wall)
    wave = psf.wavefront(scene)
    axes = scene.camera.frame
    nodes = np.zeros((1, 2))
    ends = aiming.pupil_points(scene.camera.position, axes[2], nodes)
    centre = aiming.aim(wall, scene.object_point, ends, axes[2]).spreading[0]
    expected = centre * np.sum(wave.amplitude**2 * wave.weights)
    for n_rays, limit in ((1_000, 2e-2), (100_000, 6e-4)):
        rays = raytrace.pupil_rays(scene, n_rays=n_rays)
        # points of a lattice in a disc: n^(-2/3) of it, some 1 and 0.05 %
        assert rays.flux == approx(expected, rel=limit)
        assert abs(rays.flux - expected) < 4 * rays.standard_error


def test_launch_is_uniform_in_solid_angle(flat_scene):
    """Half the fan's rays on either side of any plane through its axis, a lattice's discrepancy."""
    rays = raytrace.pupil_rays(flat_scene, n_rays=4096)
    d = rays.points[:, 1] - rays.points[:, 0]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    axis = d.mean(axis=0) / np.linalg.norm(d.mean(axis=0))
    # the solid angle of the narrow fan: area of the launch lattice's cell is the weight
    distance = np.sort(np.linalg.norm(d[:, None] - d[None, :400], axis=-1), axis=0)[1]
    assert distance.min() > 0.6 * math.sqrt(rays.weight[0])
    assert distance.max() < 1.1 * math.sqrt(rays.weight[0])
    cone = np.arccos(np.clip(d @ axis, -1, 1)) < 4e-3
    assert rays.weight[cone].sum() == approx(2 * math.pi * (1 - math.cos(4e-3)), rel=2e-2)


@pytest.mark.parametrize("n", [1000, 1009, 1024])
def test_launch_points_are_evenly_spread(n):
    """Each coordinate has n equal steps, and neighbours are nearly as far apart as can be."""
    places = pupil_fans._lattice(n, 0)
    for axis in np.sort(places, axis=0).T:
        np.testing.assert_allclose(np.diff(axis), 1 / n, rtol=0, atol=1e-12)
    apart = np.abs(places[1:] - places[0])
    shortest = np.hypot(*np.minimum(apart, 1 - apart).T).min()
    # the hexagonal lattice is the best of all; one of integers may be a fifth worse
    assert shortest > 0.8 * math.sqrt(2 / math.sqrt(3) / n)


def test_fan_is_wider_than_the_lens_by_its_margin(flat_scene):
    """1.5 ray spacings on each side of a fan of few rays, a fixed margin for many."""
    few, many = (pupil_fans._fan(flat_scene, flat_scene.object_point, n, 0)[1] for n in (64, 4096))
    expected = ((1 + 2 * 1.5 / (8 - 3)) / (1 + 2 * 0.05)) ** 2
    # one product of two widths divided by the other: rounding
    assert few / many == approx(expected, rel=1e-13)


@pytest.mark.thorough
def test_light_that_meets_the_wall_again_does_not_arrive(flat_scene):
    """Deep grooves, against small steps along every reflected ray."""
    wall = WavyWall(0.02, 0.08, size=2.0)
    scene = replace(flat_scene, wall=wall)
    rays = raytrace.pupil_rays(scene, n_rays=2000, seed=1)
    counts = np.bincount(rays.status, minlength=5)
    assert counts[LEFT] > 100
    h, p = rays.points[:, 1], rays.points[:, 2]
    passed = (rays.points[:, 1] != rays.points[:, 2]).any(axis=1)
    assert passed.sum() > 100
    steps = np.linspace(1e-3, 1, 4000)[:, None]
    for i in np.flatnonzero(passed)[:200]:
        along = h[i] + steps * (p[i] - h[i])
        inside = wall.contains(along[:, 0], along[:, 1])
        clear = along[inside, 2] - wall.height(along[inside, 0], along[inside, 1])
        assert clear.min() > -1e-6  # the first step leaves the curved wall at a slant
    for i in np.flatnonzero(rays.status == LEFT)[:100]:
        normal = wall.normal(h[i, 0], h[i, 1])
        d = (h[i] - rays.points[i, 0]) / np.linalg.norm(h[i] - rays.points[i, 0])
        along = h[i] + np.linspace(1e-4, 1, 8000)[:, None] * (d - 2 * (d @ normal) * normal)
        inside = wall.contains(along[:, 0], along[:, 1])
        clear = along[inside, 2] - wall.height(along[inside, 0], along[inside, 1])
        assert clear.min() < 0


def test_every_image_in_a_wavy_wall_is_found(flat_scene):
    """One-dimensional: the wall points of the plane of incidence, by sampling their slope."""
    wall = WavyWall(1e-3, 0.1)
    scene = replace(flat_scene, wall=wall)
    found = lens_footprint(wall, scene.object_point, scene.camera)
    x = np.linspace(-1, 1, 2_000_001)
    d = wall.derivatives(x, 0 * x)
    h = np.stack([x, 0 * x, d[:, 0]], axis=1)
    kink = scene.object_point - h
    kink /= np.linalg.norm(kink, axis=1, keepdims=True)
    onward = np.array(scene.camera.position) - h
    kink += onward / np.linalg.norm(onward, axis=1, keepdims=True)
    slope = kink[:, 0] + kink[:, 2] * d[:, 1]
    images = x[:-1][np.diff(np.sign(slope)) != 0]
    assert len(images) > 1
    assert found.low[0] < images.min()
    assert found.high[0] > images.max()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_rays": 15}, "n_rays = 15 is out of range, must be at least 16"),
        ({"object_point": (0.1, 0.0, -1.0)}, "object_point has z = -1 m, behind the wall"),
        ({"object_point": (math.nan, 0, 1)}, r"object_point\[x\] = nan is not finite"),
        ({"seed": 2**64}, "seed = .* is out of range"),
        ({"object_point": (9.0, 9.0, 0.5)}, "no light from .* is reflected by the wall"),
    ],
)
def test_bad_fans_are_refused(flat_scene, change, message):
    scene = replace(flat_scene, wall=FlatWall(size=1.0))
    with pytest.raises(SceneError, match=message):
        raytrace.pupil_rays(scene, **({"n_rays": 64} | change))
