"""Kept paths: mirrors among them, their surfaces and lobes, and which of them are drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import raytrace
from nlosoptics.raytrace.fans.paths import DETECTED, NO_SURFACE, ON_OBJECT, ON_WALL
from nlosoptics.scene import (
    Camera,
    FlatWall,
    Lambert,
    Laser,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

MIRROR = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.0))


def room(wall=MIRROR, thing=MIRROR):
    """A small room with a lens of 0.3 m."""
    return Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.02, position=(-0.1, 0.8, 0.9)),
        FlatWall(size=2.0),
        PlanarObject(np.ones((2, 2)), 0.6, position=(0.35, -0.05, 0.5), yaw=0.3, material=thing),
        Camera(
            position=(-0.45, 0.0, 0.6),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.3,
            focus_distance=0.9,
            pixel_pitch=1e-3,
            pixels=(120, 120),
            binning=1,
        ),
        wall_material=wall,
    )


def normals_of(paths, scene):
    """The surface normal at each point, (n, k, 3): both surfaces are planes."""
    on_wall = (paths.surface == ON_WALL)[..., None]
    return np.where(on_wall, (0.0, 0.0, 1.0), scene.hidden.axes[2])


def mirror_error(paths, scene):
    """Angles, rad, (n, k), by which the light leaves the direction of a mirror; NaN elsewhere."""
    steps = np.diff(paths.points, axis=1)
    length = np.linalg.norm(steps, axis=2, keepdims=True)
    steps = np.divide(steps, length, out=np.zeros_like(steps), where=length > 0.0)
    come, go = steps[:, :-1], steps[:, 1:]
    n = normals_of(paths, scene)[:, 1:-1]
    reflected = come - 2.0 * (come * n).sum(axis=2, keepdims=True) * n
    off = np.full(paths.surface.shape, np.nan)
    off[:, 1:-1] = np.linalg.norm(go - reflected, axis=2)
    off[paths.surface == NO_SURFACE] = np.nan
    return off


@pytest.mark.thorough
@pytest.mark.parametrize("analog", [False, True])
def test_paths_over_mirrors_are_kept_with_their_lobes(analog):
    scene = room()
    count = 200_000 if analog else 8000
    found = raytrace.trace(scene, n_rays=count, keep_paths=True, analog=analog, seed=1)
    light = found.status == DETECTED
    # all detected power is there, that of mirrors included: to the rounding of the sums
    assert math.fsum(found.weight[light]) == approx(found.flux + found.stray, rel=1e-12)
    met = light & found.met_object
    assert math.fsum(found.weight[met]) == approx(found.flux, rel=1e-12)
    by_bounce = np.bincount(found.n_bounces[met], found.weight[met], minlength=6)
    assert by_bounce == approx(found.by_bounce, rel=1e-12, abs=1e-30)
    # each reflection has a surface and a lobe, and nothing else has
    reflections = found.surface != NO_SURFACE
    assert (reflections.sum(axis=1) == found.n_bounces).all()
    assert ((found.lobe >= 0) == reflections).all()
    assert not reflections[:, 0].any()
    # the points lie on their surfaces
    plate = (found.points - scene.hidden.position) @ scene.hidden.axes[2]
    assert np.abs(found.points[found.surface == ON_WALL][:, 2]).max() < 1e-12
    assert np.abs(plate[found.surface == ON_OBJECT]).max() < 1e-12
    # lobe 1 is the smooth mirror: its reflections obey the law of mirrors, and no others do
    off = mirror_error(found, scene)
    mirrored = found.lobe == 1
    assert off[mirrored].max() < 1e-9
    assert off[found.lobe == 0].min() > 1e-6
    last = found.n_bounces
    at_end = mirrored[np.arange(len(last)), last] & light & (last > 0)
    # mirrors also send light to the lens that no connection finds
    assert at_end.sum() > 10
    assert (mirrored.sum(axis=1) >= 2).any()


def test_lobe_is_the_strongest_of_the_wall():
    """A glossy lobe near its mirror direction, the matt one far from it."""
    scene = room(wall=SumMaterial(Lambert(0.5), SpecularMicrofacet(0.4, 0.05)), thing=Lambert(0.8))
    found = raytrace.trace(scene, n_rays=4000, keep_paths=True, seed=2)
    off = mirror_error(found, scene)
    wall = found.surface == ON_WALL
    assert (found.lobe[found.surface == ON_OBJECT] == 0).all()
    # the reflected light spreads by twice the slope: inside 0.1 rad the lobe is far above the paint
    assert (found.lobe[wall & (off < 0.1)] == 1).all()
    assert (found.lobe[wall & (off > 0.7)] == 0).all()
    assert (found.lobe[wall] == 1).any()
