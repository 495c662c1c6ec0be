"""Tracing: closed forms, brute force, power balance, statistics and skipped tests."""

from __future__ import annotations

import functools
import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx
from scipy.integrate import dblquad

import nlosoptics as nlos
from nlosoptics import imaging
from nlosoptics.errors import SceneError
from nlosoptics.imaging.radiometry import electrons_per_joule
from nlosoptics.raytrace import ray_plan, trace
from nlosoptics.raytrace.fans.paths import ABSORBED, BLOCKED, DETECTED, ESCAPED, LEFT
from nlosoptics.raytrace.light._surround_kernels import LOST
from nlosoptics.raytrace.light.surroundings import Surroundings
from nlosoptics.scene import (
    CallableWall,
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    Ward,
    WavyWall,
)

PAINT, CARD = Lambert(0.7), Lambert(0.8)


def wide_scene(wall=None, wall_material=PAINT, material=CARD):
    """A room in which the lens is large, so that a plain random walk finds it."""
    sensor = {"pixel_pitch": 1e-3, "pixels": (120, 120), "binning": 1}
    return Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.02, position=(-0.1, 0.8, 0.9)),
        FlatWall(size=(2.0, 2.0)) if wall is None else wall,
        PlanarObject(
            np.array([[1.0, 0.3], [0.6, 1.0]]),
            0.6,
            position=(0.35, -0.05, 0.5),
            yaw=0.3,
            material=material,
        ),
        Camera(
            position=(-0.45, 0.0, 0.6),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=0.3,
            focus_distance=0.9,
            transmission=0.9,
            **sensor,
        ),
        wall_material=wall_material,
    )


def beside_a_hollow_wall(what):
    """Camera or object outside a hollow wall, whose rim hides parts of the wall from it."""
    scene = wide_scene(ConcaveWall(0.8, size=(1.0, 1.0)))
    if what == "object":
        hidden = replace(scene.hidden, position=(0.8, 0.0, 0.25), yaw=1.3, size=0.25)
        return replace(scene, hidden=hidden)
    camera = replace(scene.camera, position=(-0.8, 0.0, 0.15), stop_diameter=0.25)
    return replace(scene, camera=replace(camera, focus_distance=0.8))


def inward_cap(albedo, *, radius=1.0, size=1.2):
    """A hollow sphere's part that lights itself, with a black speck as the object."""
    scene = wide_scene(ConcaveWall(radius, size=(size, size)), Lambert(albedo))
    return replace(
        scene,
        hidden=PlanarObject(np.zeros((2, 2)), 1e-6, position=(0.0, 0.3, 0.8)),
        camera=replace(scene.camera, stop_diameter=1e-5),
    )


def cap_area(radius, size):
    half = size / 2
    area, _ = dblquad(
        lambda y, x: 1 / math.sqrt(1 - (x * x + y * y) / radius**2), -half, half, -half, half
    )
    return area


# light that a hollow wall keeps


@pytest.mark.parametrize("analog", [False, True])
def test_hollow_sphere_lights_itself_evenly(analog):
    """Any point of a sphere sends area/(4 pi R^2) of its Lambertian light to any part of it."""
    albedo, bounces = 0.8, 4
    again = albedo * cap_area(1.0, 1.2) / (4 * math.pi)
    found = trace(inward_cap(albedo), n_rays=1 << 17, max_bounces=bounces, analog=analog, seed=3)
    between = 2.0 * sum(again**m for m in range(1, bounces + 1))
    trapped = 2.0 * (1 - albedo) * sum(again**m for m in range(1, bounces))
    # five standard errors, of which the first is some 2e-3 of the value
    assert found.trapped_error < 5e-3 * trapped
    assert found.trapped == approx(trapped, abs=5 * found.trapped_error)
    assert found.wall_to_wall == approx(between, abs=5 * found.trapped_error / (1 - albedo))


def test_flat_and_convex_walls_trap_nothing():
    for wall in (FlatWall(size=(2.0, 2.0)), ConvexWall(3.0, size=(2.0, 2.0))):
        found = trace(wide_scene(wall), n_rays=1 << 12)
        assert found.trapped == found.wall_to_wall == 0.0


@pytest.mark.parametrize("analog", [False, True])
def test_wavy_wall_is_the_same_a_period_further(analog):
    """Also at the origin, where rounding of a point is not small against its coordinates."""
    scene = wide_scene(WavyWall(0.08, 0.4, phase=math.pi / 2, size=(20.0, 2.0)))
    found = []
    for shift in (0.0, 0.4):
        laser = replace(
            scene.laser, position=(shift - 0.3, 0.6, 1.0), aim=(shift, 0, 0), beam_diameter=1e-3
        )
        hidden = replace(scene.hidden, position=(shift + 0.35, -0.05, 0.5))
        moved = replace(scene, laser=laser, hidden=hidden)
        found.append(trace(moved, n_rays=1 << 14, max_bounces=3, analog=analog))
    # rounding moves some rays across an edge: a few of 16384
    assert found[0].wall_to_wall > 0.4
    assert found[0].wall_to_wall == approx(found[1].wall_to_wall, rel=1e-3)
    assert found[0].trapped == approx(found[1].trapped, rel=1e-3)


# brute force: the same light by a plain random walk

MIRROR = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.0))
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.08))
MESH = MeshObject(
    mesh=trimesh.creation.icosphere(subdivisions=2, radius=0.22),
    position=(0.3, 0.0, 0.5),
    material=Lambert(0.9),
)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "scene",
    [
        wide_scene(),
        wide_scene(wall_material=OrenNayar(0.8, 0.4)),
        wide_scene(wall_material=MIRROR),
        wide_scene(wall_material=GLOSS),
        wide_scene(wall_material=Ward(0.8, 0.3)),
        wide_scene(material=MIRROR),
        wide_scene(wall_material=MIRROR, material=GLOSS),
        wide_scene(ConcaveWall(1.5, size=(2.0, 2.0)), MIRROR),
        wide_scene(ConvexWall(2.0, size=(2.0, 2.0)), GLOSS),
        wide_scene(WavyWall(0.05, 0.4, size=(2.0, 2.0)), SumMaterial(Lambert(0.6), GLOSS.parts[1])),
        wide_scene(SumWall(ConcaveWall(3.0), WavyWall(0.03, 0.5), size=(1.6, 1.6))),
        replace(wide_scene(wall_material=GLOSS), hidden=MESH),
        replace(wide_scene(), hidden=MESH),
        beside_a_hollow_wall("camera"),
        beside_a_hollow_wall("object"),
    ],
    ids=[
        "lambert",
        "oren-nayar",
        "mirror",
        "gloss",
        "ward",
        "mirror object",
        "all glossy",
        "hollow mirror",
        "convex gloss",
        "wavy gloss",
        "sum",
        "mesh and gloss",
        "mesh",
        "camera beside a hollow",
        "object beside a hollow",
    ],
)
def test_connections_agree_with_a_plain_walk(scene):
    """Next events, multiple importance and roulette change the noise, not the light."""
    plain = trace(scene, n_rays=1 << 19, max_bounces=6, analog=True, sampler="philox", seed=11)
    found = trace(scene, n_rays=1 << 16, max_bounces=6, seed=12)
    # ray for ray the connections are the quieter: 8 times fewer rays
    assert found.standard_error < math.sqrt(8) * plain.standard_error
    for key in ("flux", "stray"):
        a, b = getattr(plain, key), getattr(found, key)
        errors = [
            getattr(p, "standard_error" if key == "flux" else "stray_error") for p in (plain, found)
        ]
        # four standard errors of the difference: 30 such comparisons pass with p = 0.998
        assert b == approx(a, abs=4 * math.hypot(*errors) + 1e-15)
    for k in range(7):
        error = math.hypot(plain.by_bounce_error[k], found.by_bounce_error[k])
        # where a plain walk found nothing it may have missed a few rays
        few = 3 * 2.0 / plain.n_rays
        assert found.by_bounce[k] == approx(plain.by_bounce[k], abs=5 * error + few)
    for name, power in plain.ledger.items():
        error = math.hypot(plain.ledger_error[name], found.ledger_error[name])
        assert found.ledger[name] == approx(power, abs=5 * error + 1e-12)


@pytest.mark.thorough
def test_flux_is_what_the_radiance_chain_says(examples):
    """Three reflections by quadrature and chief rays, as `form_image` does; flat wall, a mirror."""
    scene = nlos.Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    result = nlos.simulate(scene)
    electrons = result.image.ledger["ideal"] + result.image.ledger["diffuse"]
    per_watt = electrons_per_joule(scene) * scene.camera.exposure
    found = trace(scene, n_rays=1 << 19, max_bounces=3, seed=5)
    # the image takes the lens as small and its background to 1e-3
    assert found.standard_error < 0.01 * found.flux
    assert found.flux * per_watt == approx(
        electrons, abs=4 * found.standard_error * per_watt + 2e-3 * electrons
    )


@pytest.mark.thorough
def test_background_is_what_the_radiance_chain_says(examples):
    scene = nlos.Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    scene = replace(scene, wall_material=scene.wall_material.diffuse)
    electrons = imaging.diffuse_background(scene, np.array(scene.hidden.reflectance)).sum()
    per_watt = electrons_per_joule(scene) * scene.camera.exposure
    found = trace(scene, n_rays=1 << 18, max_bounces=3, seed=5)
    # the image takes the lens as a point and its background to 1e-3; the trace's error is 2e-4
    assert found.flux * per_watt == approx(electrons, rel=2e-3)


# the budget of the light


@pytest.mark.parametrize(
    "scene",
    [
        wide_scene(),
        wide_scene(ConcaveWall(1.5, size=(2.0, 2.0)), MIRROR),
        wide_scene(wall_material=OrenNayar(1.0, 0.35)),
        replace(wide_scene(wall_material=GLOSS), hidden=MESH),
    ],
)
def test_analog_ledger_closes(scene):
    """To rounding of the sum; an Oren-Nayar fit that gains energy has a negative loss in it."""
    found = trace(scene, n_rays=20_000, max_bounces=5, analog=True)
    assert math.fsum(found.ledger.values()) == approx(2.0, rel=1e-12)
    assert found.ledger["unresolved"] == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize("wall_material", [Lambert(0.7), GLOSS])
def test_ledger_closes_within_its_error(wall_material):
    found = trace(wide_scene(wall_material=wall_material), n_rays=1 << 16, max_bounces=5)
    error = math.sqrt(sum(e * e for e in found.ledger_error.values()))
    assert 0.0 < error < 4e-3
    assert math.fsum(found.ledger.values()) == approx(2.0, abs=4 * error)


def test_ray_that_cannot_be_resolved_is_booked(monkeypatch):
    """Rays that leave a wall and are lost, as at a touch, end there and stop nothing."""
    honest = Surroundings.first_hits

    def losing(self, origins, directions, live, on_wall, counts):
        distance, kind, *rest = honest(self, origins, directions, live, on_wall, counts)
        lost = on_wall & (np.arange(len(live)) % 8 == 0)
        distance[lost], kind[lost] = 0.0, LOST
        return distance, kind, *rest

    monkeypatch.setattr(Surroundings, "first_hits", losing)
    for analog in (True, False):
        found = trace(wide_scene(), n_rays=1 << 12, analog=analog)
        # an eighth of 0.7 of 2 W at the first reflection alone
        assert 0.175 * (1 - 1e-12) < found.ledger["unresolved"] < 0.2
        assert np.isfinite(list(found.ledger_error.values())).all()
    assert found.flux > 0.0


def test_black_wall_absorbs_all():
    found = trace(wide_scene(wall_material=Lambert(0.0)), n_rays=100)
    assert found.ledger["absorbed by wall"] == approx(2.0, rel=1e-14)
    assert found.flux == found.stray == 0.0


# statistics


@functools.cache
def true_flux(size=0.6):
    """Flux by a million Sobol points, some thirty times nearer than what it is held against."""
    scene = with_plate(size)
    return trace(scene, n_rays=1 << 20, max_bounces=3, seed=10_000, sampler="sobol").flux


def with_plate(size):
    """A small plate and nothing but wall in sight is a smooth function of the numbers."""
    scene = wide_scene()
    if size == scene.hidden.size[0]:
        return scene
    camera = replace(scene.camera, pixels=(60, 60))
    return replace(scene, hidden=replace(scene.hidden, size=size), camera=camera)


@pytest.mark.thorough
@pytest.mark.parametrize("sampler", ["philox", "sobol"])
def test_standard_error_covers_the_truth(sampler):
    scene, truth = with_plate(0.6), true_flux()
    runs = [trace(scene, n_rays=512, max_bounces=3, seed=k, sampler=sampler) for k in range(1000)]
    off = np.array([abs(r.flux - truth) / r.standard_error for r in runs])
    # 1,000 runs tell these shares to 1.5 % and 0.7 %; 32 groups make tails a little heavier
    assert np.mean(off < 1.0) == approx(0.683, abs=0.04)
    assert np.mean(off < 1.96) == approx(0.95, abs=0.02)


def error_slope(size, sampler, counts, repeats):
    """Exponent of the true error's fall with the number of rays."""
    scene, truth, errors = with_plate(size), true_flux(size), []
    for n in counts:
        # another seed each, so that no two are related
        seeds = range(1000 * n, 1000 * n + repeats)
        found = [
            trace(scene, n_rays=n, max_bounces=3, seed=seed, sampler=sampler).flux for seed in seeds
        ]
        errors.append(math.sqrt(np.mean((np.array(found) / truth - 1) ** 2)))
    return np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.mark.thorough
def test_sobol_points_err_less():
    # 16 repeats at 6 counts tell the slope to 0.05
    assert error_slope(0.25, "sobol", [2**k for k in range(10, 16)], 16) < -0.7 - 0.1


@pytest.mark.thorough
def test_tolerance_ends_the_tracing():
    coarse, fine = (trace(wide_scene(), tol=tol, max_bounces=3) for tol in (0.02, 1e-3))
    assert coarse.stopped == fine.stopped == "tol"
    assert coarse.standard_error <= 0.02 * coarse.flux
    assert fine.standard_error <= 1e-3 * fine.flux
    assert coarse.n_rays < fine.n_rays


def test_limits_end_the_tracing_early():
    rays = trace(wide_scene(), tol=1e-6, n_rays=20_000)
    assert (rays.stopped, rays.n_rays) == ("rays", 20_000)
    hurried = trace(wide_scene(), max_seconds=0.05)
    assert hurried.stopped == "time"
    assert hurried.n_rays >= 1024
    assert 0.0 < hurried.standard_error < math.inf


# the same bits


def summary(found):
    """All numbers of a trace but its seconds."""
    return (
        found.flux,
        found.standard_error,
        found.stray,
        found.stray_error,
        found.mean_path_length,
        found.trapped,
        *found.by_bounce,
        *found.ledger.values(),
        *found.ledger_error.values(),
    )


PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from test_trace import GLOSS, MESH, MIRROR, replace, summary, trace, wide_scene
scene = wide_scene(wall_material=GLOSS)
mirrors = wide_scene(wall_material=GLOSS, material=MIRROR)
for scene in (scene, replace(scene, hidden=MESH), mirrors):
    print([float(v).hex() for v in summary(trace(scene, n_rays=20_000, seed=2**63 + 5))])
"""


@pytest.mark.thorough
def test_threads_change_no_bit():
    folder = os.path.dirname(__file__)  # noqa: PTH120  (handed to another process)
    texts = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM.format(folder=folder)],
            env={**os.environ, "NUMBA_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    ]
    assert texts[0] == texts[1]
    assert texts[0].count("0x") > 75


# what a scene does not need


def test_plan_of_rays():
    mesh = replace(wide_scene(), hidden=MESH)
    assert ray_plan(wide_scene()).wall_hits == "closed form"
    assert not ray_plan(wide_scene()).embree
    assert not ray_plan(wide_scene()).glossy
    assert ray_plan(mesh).embree
    hollow = ray_plan(wide_scene(ConcaveWall(2.0, size=(1.0, 1.0))))
    assert hollow.wall_to_wall
    assert not hollow.wall_shadows
    wavy = ray_plan(wide_scene(WavyWall(0.01, 0.3)))
    assert wavy.wall_hits == "march"
    assert wavy.wall_to_wall
    assert wavy.wall_shadows
    assert ray_plan(wide_scene(material=MIRROR)).glossy
    for what in ("camera", "object"):
        assert ray_plan(beside_a_hollow_wall(what)).wall_shadows


def test_wall_of_python_functions_is_traced():
    """A flat wall by another way."""
    zero = CallableWall(
        lambda x, y: 0.0 * x,
        lambda x, y: (0.0 * x, 0.0 * y),
        size=(2.0, 2.0),
        max_height=0.0,
        max_curvature=0.0,
    )
    flat, called = (trace(wide_scene(w), n_rays=5000) for w in (FlatWall(size=(2.0, 2.0)), zero))
    # it might see itself for all the tracer knows, which draws other numbers
    error = math.hypot(called.standard_error, flat.standard_error)
    assert called.flux == approx(flat.flux, abs=4 * error)


# paths


def test_detected_paths_carry_the_flux():
    found = trace(wide_scene(wall_material=GLOSS), n_rays=3000, keep_paths=True)
    steps = np.sqrt((np.diff(found.points, axis=1) ** 2).sum(axis=2))
    assert math.fsum(found.weight) == approx(found.flux + found.stray, rel=1e-12)
    assert found.path_length == approx(steps.sum(axis=1), rel=1e-12)
    assert (found.status == DETECTED).all()
    camera = wide_scene().camera
    ends = found.points[:, -1] - camera.position
    assert np.abs(ends @ camera.axis).max() < 1e-12
    assert np.linalg.norm(ends, axis=1).max() <= 0.15 * (1 + 1e-12)
    for k in range(1, 6):
        some = found.n_bounces == k
        assert (steps[some, k + 1 :] == 0.0).all()
        assert (steps[some, : k + 1] > 0.0).all()
    length = found.weight @ found.path_length
    assert found.mean_path_length * found.flux <= length * (1 + 1e-12)


def test_analog_paths_end_by_every_fate():
    found = trace(wide_scene(), n_rays=20_000, max_bounces=2, keep_paths=True, analog=True, seed=1)
    assert len(found.weight) == 20_000
    ended = {k: found.weight[found.status == k].sum() for k in range(5)}
    assert min(ended[ESCAPED], ended[LEFT], ended[BLOCKED], ended[DETECTED]) > 0.0
    assert ended[ESCAPED] == approx(found.ledger["escaped"], rel=1e-12)
    assert ended[LEFT] == approx(found.ledger["left"], rel=1e-12)
    assert ended[DETECTED] == approx(found.ledger["detected"], rel=1e-12)
    # the glass takes a tenth of what is detected
    lost = ended[BLOCKED] + ended[DETECTED] / 9
    assert lost == approx(found.ledger["blocked"], rel=1e-12)
    assert found.weight[found.status == ABSORBED].sum() == 0.0


# bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_rays": 0}, "n_rays = 0"),
        ({"n_rays": 1.5}, "n_rays = 1.5"),
        ({"tol": 0.0}, "tol = 0"),
        ({"tol": math.nan}, "tol"),
        ({"max_seconds": -1.0}, "max_seconds = -1"),
        ({"max_bounces": 0}, "max_bounces = 0"),
        ({"max_bounces": 1000}, "max_bounces = 1000"),
        ({"sampler": "halton"}, "halton"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_bad_option_is_refused(options, message):
    with pytest.raises(SceneError, match=message):
        trace(wide_scene(), **options)


def test_darkness_is_said_and_not_waited_for():
    with pytest.raises(SceneError, match="wall_material reflects nothing"):
        trace(wide_scene(wall_material=Lambert(0.0)), tol=0.1)
    with pytest.raises(SceneError, match="hidden.material reflects nothing"):
        trace(wide_scene(material=Lambert(0.0)), tol=0.1)
    dark = replace(wide_scene(), hidden=PlanarObject(np.zeros((2, 2)), 0.3, position=(0, 0, 1)))
    with pytest.raises(SceneError, match="hidden.image is black"):
        trace(dark, tol=0.1)
    turned = replace(wide_scene(), hidden=replace(wide_scene().hidden, yaw=math.pi))
    with pytest.raises(SceneError, match="no light of"):
        trace(turned, tol=0.1)
