"""The wave of traced rays against the wave by aiming, and the areas of scattered points."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf, raytrace
from nlosoptics.errors import CausticError, SamplingError, SceneError
from nlosoptics.raytrace.fans.paths import DETECTED
from nlosoptics.scene import ConcaveWall, ConvexWall, FlatWall, HeightMapWall, SumWall, WavyWall

WALLS = [
    FlatWall(),
    ConcaveWall(5.0),
    ConvexWall(0.5),
    ConcaveWall(4.0, shape="cylinder", axis="x"),
    WavyWall(2e-5, 0.3, 0.4, direction=0.7),
    SumWall(WavyWall(1e-5, 0.25), WavyWall(1e-5, 0.35, direction=math.pi / 2)),
]


def name(value):
    return type(value).__name__


def wave_of(scene, n_rays, **options):
    rays = raytrace.pupil_rays(scene, n_rays=n_rays, **options)
    return psf.wavefront_from_rays(rays, psf.exit_pupil(scene), scene.laser.wavelength)


def aimed(scene, wave, object_point=None):
    return psf.wavefront(scene, object_point, nodes=np.stack([wave.u, wave.v], axis=1))


# ---------------------------------------------------------------- areas


# ---------------------------------------------------------------- waves


@pytest.mark.parametrize("wall", WALLS, ids=name)
def test_rays_carry_the_aimed_wave(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    wave = wave_of(scene, 3000, seed=3)
    expected = aimed(scene, wave)
    # lengths of 2 m carry 2e-16 m each; the tilt errs by some 1e-13 over 12 mm
    assert np.abs(wave.aberration - expected.aberration).max() < 2e-14
    assert wave.removed.piston == approx(expected.removed.piston, abs=2e-15)
    assert wave.removed.tilt == approx(expected.removed.tilt, abs=1e-12)
    # a smoothly bent lattice has the cells of its Jacobian but for fourth order in its step
    assert np.abs(wave.amplitude - expected.amplitude).max() < 1e-7
    assert wave.layout == "scattered"
    assert wave.image_distance == expected.image_distance
    assert wave.weights.sum() == approx(math.pi * wave.pupil_radius**2, rel=1e-12)


@pytest.mark.thorough
def test_height_maps_converge_to_the_aimed_wave(flat_scene):
    """A rough wall of 100 nm, whose W has no closed form."""
    wall = HeightMapWall.random(
        height_rms=1e-7, correlation_length=5e-3, size=0.6, pitch=1.5e-3, seed=1
    )
    scene = replace(flat_scene, wall=SumWall(ConcaveWall(5.0), wall, size=0.6))
    amplitude = []
    for n_rays in (1000, 4000, 16000):
        wave = wave_of(scene, n_rays)
        expected = aimed(scene, wave)
        amplitude.append(np.sqrt(np.mean((wave.amplitude - expected.amplitude) ** 2)))
    # W itself is exact ray by ray; its zero and tilt come from a fit near the centre
    assert np.abs(wave.aberration - expected.aberration).max() < 1e-10
    assert np.abs(wave.amplitude - expected.amplitude).max() < 1e-2
    # first order in the step or better: the bends of a bicubic surface have kinks
    assert amplitude[1] < 0.6 * amplitude[0]
    assert amplitude[2] < 0.6 * amplitude[1]


def test_amplitude_error_falls_with_the_rays(flat_scene):
    scene = replace(flat_scene, wall=WALLS[-1])
    errors = []
    for n_rays in (500, 2000, 8000):
        wave = wave_of(scene, n_rays)
        errors.append(np.abs(wave.amplitude - aimed(scene, wave).amplitude).max())
    # second order in the step, so first in the number
    assert errors[1] < errors[0] / 2.5
    assert errors[2] < errors[1] / 2.5


@pytest.mark.parametrize("wall", [FlatWall(), ConcaveWall(5.0), WALLS[4]], ids=name)
def test_energy_and_the_weight_of_a_ray(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    rays = raytrace.pupil_rays(scene, n_rays=4000)
    wave = psf.wavefront_from_rays(rays, psf.exit_pupil(scene), scene.laser.wavelength)
    # amplitude^2 times area is each ray's power, the same for all within the rim
    power = wave.amplitude**2 * wave.weights
    within = np.hypot(wave.u, wave.v) < 0.9 * wave.pupil_radius
    assert power[within] == approx(power[within].mean(), rel=1e-10)
    # amplitude times area is then the root of the area that a ray stands for
    product = wave.amplitude * wave.weights / np.sqrt(wave.weights)
    assert product[within] == approx(product[within].mean(), rel=1e-10)
    # the rim's cells are clipped: their sum is the disc's and not the rays' number
    expected = psf.wavefront(scene)
    assert wave.flux == approx(expected.flux, rel=2e-5)
    assert power.sum() == approx(power[within].mean() * len(power), rel=1e-2)


# ---------------------------------------------------------------- what is refused


@pytest.mark.thorough
def test_crossed_rays_are_refused(flat_scene):
    for wall in (WavyWall(1e-3, 0.1), WavyWall(1e-4, 0.01)):
        with pytest.raises(CausticError, match="rays cross, or are too few"):
            wave_of(replace(flat_scene, wall=wall), 20_000)


def test_light_cut_by_the_walls_edge_is_refused(flat_scene):
    # the lens sees this point by x = -0.17 m, next to the edge, and the axis by -0.165 m
    scene = replace(flat_scene, wall=FlatWall(size=0.345))
    assert psf.exit_pupil(scene).stop == "lens"
    with pytest.raises(SamplingError, match="the wall's edge cuts the light"):
        wave_of(scene, 2000, object_point=(0.366, 0.0, 1.0))


def rays_of(scene, **changes):
    return replace(raytrace.pupil_rays(scene, n_rays=1000), **changes)


@pytest.mark.parametrize("wall", [FlatWall(), ConvexWall(1.5), WALLS[4]], ids=name)
def test_rays_of_a_scene_without_symmetry(flat_scene, wall):
    """Piston, tilt, aberration and amplitude are those of the aimed wave."""
    o, place = np.array([0.41, -0.17, 0.9]), np.array([-0.55, 0.36, 0.75])
    hit = place + 0.75 / 1.65 * (o * (1, 1, -1) - place)
    camera = replace(flat_scene.camera, position=tuple(place), aim=(*hit[:2], 0.0))
    hidden = replace(flat_scene.hidden, position=tuple(o))
    scene = replace(flat_scene, wall=wall, camera=camera, hidden=hidden)
    wave = wave_of(scene, 1500)
    expected = aimed(scene, wave)
    # the centre's value and slopes come from a fit of the fifth degree
    assert np.abs(wave.aberration - expected.aberration).max() < 1e-12
    assert np.abs(wave.amplitude - expected.amplitude).max() < 1e-4
    assert wave.removed.piston == approx(expected.removed.piston, abs=1e-12)
    assert wave.removed.tilt == approx(expected.removed.tilt, abs=1e-9)
    assert wave.removed.defocus == 0
    for attribute in ("wavelength", "image_distance", "pupil_radius", "layout"):
        assert getattr(wave, attribute) == getattr(expected, attribute)


def test_paths_of_another_kind_are_refused(flat_scene):
    rays = rays_of(flat_scene)
    pupil, wavelength = psf.exit_pupil(flat_scene), flat_scene.laser.wavelength

    def refused(message, *, kind=SceneError, pupil=pupil, wavelength=wavelength, **changes):
        with pytest.raises(kind, match=message):
            psf.wavefront_from_rays(replace(rays, **changes), pupil, wavelength)

    bounces = rays.n_bounces.copy()
    first = int(np.flatnonzero(rays.status == DETECTED)[0])
    bounces[first] = 2
    refused(f"path {first} has 2 bounces", n_bounces=bounces)
    points = rays.points.copy()
    points[first, 0, 0] += 1e-6
    refused("paths start up to 1e-06 m apart", points=points)
    points = rays.points.copy()
    points[first, 2, 2] += 1e-6
    refused("off a plane through exit_pupil.centre", points=points)
    points = rays.points.copy()
    points[first] = points[int(np.flatnonzero(rays.status == DETECTED)[1])]
    refused("ends where another does", points=points)
    refused("keep paths of three vertices", points=rays.points[:0, :0])
    refused("keep paths of three vertices", points=rays.points[:, :2])
    refused("exit_pupil.stop is the wall", pupil=replace(pupil, stop="wall"))
    refused("limit 0.01 m, its radius", pupil=replace(pupil, radius=0.01))
    moved = replace(pupil, centre=pupil.centre + 1e-3)
    refused("off a plane through exit_pupil.centre", pupil=moved)
    refused("wavelength = 0 m is out of range", wavelength=0.0)
    dark = np.ones_like(rays.status)
    refused("paths holds 0 detected rays, limit 64", kind=SamplingError, status=dark)
    longer = rays.path_length.copy()
    longer[first] += 1e-6
    refused("differ by 1.58 waves", kind=CausticError, path_length=longer)
