"""The plan says what runs, and the simulation runs exactly that."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

import nlosoptics as nlos
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError, ValidityWarning
from nlosoptics.runs.refusals import check_errors
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    MeshWall,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    WavyWall,
)

from .random_scenes import random_case

CURVED = [
    ConcaveWall(5.0),
    ConvexWall(2.0),
    WavyWall(2e-5, 0.3, 0.4),
    SumWall(WavyWall(1e-5, 0.3), WavyWall(1e-5, 0.3, direction=np.pi / 2)),
]


@pytest.mark.thorough
def test_the_plan_says_where_the_scalar_model_errs_by_more_than_tol(flat_scene):
    """F/2: the axial field moves 1 % of the peak of a spot that fills several pixels."""
    mirror = SumMaterial(SpecularMicrofacet(0.05, 0.0))
    scene = replace(flat_scene, wall=ConcaveWall(5.0), wall_material=mirror)
    for tol in (1e-3, 0.1):
        stage = next(one for one in nlos.plan(scene, tol).stages if one.name == "point spread")
        found = nlos.psf.scene_point_spread(scene, tol).point_spread
        said = "scalar model" in stage.error
        assert said == (found.model_error > tol) == ("model='auto'" in stage.reason)


@pytest.mark.parametrize("wall", [FlatWall(), CURVED[0]], ids=lambda w: type(w).__name__)
def test_simulation_runs_exactly_the_plan(flat_scene, wall):
    result = nlos.simulate(replace(flat_scene, wall=wall))
    assert tuple(result.timings) == tuple(stage.name for stage in result.plan.stages)
    assert result.reconstruction is None


@pytest.mark.thorough
@pytest.mark.parametrize("wall", CURVED[:3], ids=lambda w: type(w).__name__)
def test_estimated_waves_are_of_the_right_size(flat_scene, wall):
    scene = replace(flat_scene, wall=wall)
    wave = nlos.psf.wavefront(scene)
    true = float(np.ptp(wave.aberration)) / scene.laser.wavelength
    # second order at normal incidence: 28 degrees cost a quarter; a wave has its steepest crest's
    limits = (0.6, 1.4) if wall.finest_period == np.inf else (0.2, 8)
    assert limits[0] * true < nlos.plan(scene).waves < limits[1] * true


def test_a_diffuse_wall_is_not_reconstructed(flat_scene):
    scene = replace(flat_scene, wall_material=Lambert(0.8))
    result = nlos.simulate(scene, reconstruct=True)
    assert result.reconstruction is None
    assert not result.image.signal.any()
    (stage,) = (s for s in result.plan.skipped if s.name == "reconstruction")
    assert "mirror-like lobe" in stage.reason


def test_progress_counts_up_to_done(flat_scene):
    heard = []
    nlos.simulate(flat_scene, progress=lambda text, fraction: heard.append((text, fraction)))
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions)
    assert heard[-1] == ("done", 1.0)


def test_same_seed_same_bits(flat_scene):
    one, two = (nlos.simulate(flat_scene, seed=5).image.electrons for _ in range(2))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, nlos.simulate(flat_scene, seed=6).image.electrons)


BITS = """
import hashlib, sys
import numpy as np
import nlosoptics as nlos
from nlosoptics.scene import *
x = 0.3798
picture = np.zeros((32, 32)); picture[6:26, 8:24] = 1.0
scene = Scene(
    Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.6, 0.3, 1.1)),
    ConcaveWall(4.0),
    PlanarObject(picture, 0.3, position=(x, 0.0, 1.0)),
    Camera(position=(-0.6, 0.0, 0.8), aim=(-0.6 + (x + 0.6) * 0.8 / 1.8, 0.0, 0.0),
           focal_length=0.0506415, stop_diameter=0.01, binning=32),
)
r = nlos.simulate(scene, seed=1)
for a in (r.wavefront.aberration, r.point_spread.intensity, r.image.electrons, r.image.expected):
    print(hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest())
"""


PLAN = """
import sys
from nlosoptics.cli import main

try:
    main(["plan", sys.argv[1]])
finally:
    print(sorted({"numba", "torch"} & set(sys.modules)))
"""


def test_a_plan_of_a_flat_wall_in_focus_loads_no_compiler():
    """Importing numba takes longer than all that such a plan computes."""
    run = subprocess.run(
        [sys.executable, "-c", PLAN, "examples/scenes/letter_posed.toml"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.splitlines()[-1] == "[]"


@pytest.mark.thorough
def test_same_bits_for_any_number_of_threads():
    def digests(threads):
        names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        env = os.environ | dict.fromkeys(names, str(threads))
        run = subprocess.run(
            [sys.executable, "-c", BITS], env=env, capture_output=True, text=True, check=True
        )
        return run.stdout.split()

    one, two = digests(1), digests(2)
    assert len(one) == 4
    assert one == two


@pytest.mark.parametrize("wall", [FlatWall(), ConcaveWall(5.0), ConvexWall(3.0)])
def test_wave_and_rays_put_the_image_in_the_same_place(flat_scene, wall):
    """The tilt taken out of W shifts the spot to where the reversed chief ray says it is."""
    from nlosoptics.imaging.geometry import chief_rays

    scene = replace(flat_scene, wall=wall)
    e1, e2, _ = scene.camera.frame
    hidden = scene.hidden
    target = scene.object_point + 0.05 * hidden.axes[0] - 0.03 * hidden.axes[1]
    line = target * (1, 1, -1) - np.array(scene.camera.position)
    wave = nlos.psf.wavefront(scene, target)
    # W's slopes add to direction cosines, and the lens images tangents
    sines = -np.array([line @ e1, line @ e2]) / np.linalg.norm(line) + wave.removed.tilt
    landing = scene.image_distance * sines / np.sqrt(1 - sines @ sines)
    rays = chief_rays(scene, landing[:1], landing[1:])
    start, along = rays.points[0, 0], rays.reflected[0, 0]
    normal = hidden.axes[2]
    found = start + along * ((target - start) @ normal) / (along @ normal)
    # both are exact; 1e-16 rad of rounding over 2 m, magnified by a curved wall
    assert found == approx(target, abs=1e-13)


@pytest.mark.parametrize("tol", [1.0, float("nan")])
def test_tolerance_out_of_range(flat_scene, tol):
    with pytest.raises(SceneError, match="tol = "):
        nlos.plan(flat_scene, tol)


@pytest.mark.thorough
def test_near_the_caustic_the_remedy_is_named(flat_scene):
    """R = 2 d_eff is the focus of the wall; short of it the spot outgrows what can be sampled."""
    from nlosoptics.errors import CausticError, SamplingError

    wide = replace(flat_scene.camera, stop_diameter=0.05)
    # so small that one point spread stands for it
    hidden = replace(flat_scene.hidden, size=1e-6)
    scene = replace(flat_scene, wall=ConcaveWall(1.3), camera=wide, hidden=hidden)
    # a plan refuses what the run would, and its remedies are in the caller's hands
    with pytest.raises(MemoryLimitError, match=r"limit 0.5 GiB; .* smaller stop.*more memory"):
        nlos.plan(scene, memory=2**29)
    with pytest.raises(SamplingError, match=r"limit max_seconds = 0.01; .*or max_seconds = ") as no:
        nlos.plan(scene, max_seconds=0.01, memory=2**40)
    enough = float(str(no.value).rsplit("max_seconds = ", 1)[1])
    assert nlos.plan(scene, max_seconds=enough, memory=2**40).seconds <= enough
    with pytest.raises(CausticError, match="flatter wall"):
        nlos.simulate(replace(flat_scene, wall=ConcaveWall(1.05)))


def test_a_laser_off_the_wall_is_found_before_anything_is_computed(flat_scene):
    laser = replace(flat_scene.laser, aim=(0.7, 0.0, 0.0))
    with pytest.raises(SceneError, match=r"laser\.aim = .*off the wall"):
        nlos.plan(replace(flat_scene, wall=FlatWall(size=1.2), laser=laser))


@pytest.mark.thorough
def test_a_wall_whose_edge_cuts_the_pupil_is_put_on_a_grid(flat_scene):
    beside = replace(flat_scene.camera, aim=(-0.1, 0.0, 0.0))
    narrow = replace(flat_scene, wall=FlatWall(size=(0.34, 1.0)), camera=beside)
    plan = nlos.plan(narrow)
    assert plan.layout == "grid"
    assert "edge cuts" in str(plan)
    result = nlos.simulate(narrow)
    assert result.wavefront.layout == "grid"
    assert result.point_spread.error_estimate <= 1e-3


@pytest.mark.thorough
def test_a_wall_that_is_the_stop_is_put_on_a_grid(flat_scene):
    slit = replace(flat_scene, wall=FlatWall(size=(0.34, 0.01)))
    assert "outline is the stop" in str(nlos.plan(slit))
    result = nlos.simulate(slit)
    # the slit is 10 mm high and the lens 25 mm wide: the spot is longer along y
    inner = result.point_spread.intensity
    middle = inner.shape[0] // 2
    assert inner[middle + 1, middle] > inner[middle, middle + 1]


def test_an_object_that_cannot_be_seen_is_found_by_the_plan(flat_scene):
    aside = replace(flat_scene.hidden, position=(1.4, 0.0, 1.0))
    with pytest.raises(SceneError, match="not mirrored to the camera"):
        nlos.plan(replace(flat_scene, wall=FlatWall(size=0.5), hidden=aside))
    with pytest.raises(SceneError, match="off the detector"):
        nlos.plan(replace(flat_scene, hidden=replace(aside, position=(2.5, 0.0, 1.0))))


@pytest.mark.thorough
def test_a_mesh_too_coarse_for_waves_is_refused_by_the_plan(flat_scene):
    from nlosoptics.errors import NotWaveGradeError

    wall = MeshWall(WavyWall(2e-3, 0.2, size=2.0).to_mesh(max_sag_error=1e-4))
    scene = replace(flat_scene, wall=wall)
    for refusing in (nlos.plan, nlos.simulate):
        with pytest.raises(NotWaveGradeError, match="lambda/20.*no geometric method"):
            refusing(scene)


@pytest.mark.thorough
def test_a_picture_seen_by_too_many_periods_of_the_wall_is_refused_by_the_plan():
    """The run would find it only after 27 x 27 point spreads."""
    case = random_case(301393, wild=True)
    with pytest.raises(SamplingError, match="27 x 27 point spreads .* use tol = 4"):
        nlos.plan(case.scene, tol=2e-5)


def test_an_overexposed_run_keeps_its_image_and_names_the_exposure():
    scene = nlos.Scene.load("examples/scenes/letter_flat.toml").resized(16)
    bright = replace(
        scene,
        camera=replace(scene.camera, exposure=1e4),
        wall=FlatWall(),
        laser=replace(scene.laser, power=1e3),
    )
    planned = nlos.plan(bright, 1e-2, reconstruct=True)
    (stage,) = (s for s in planned.skipped if s.name == "reconstruction")
    result = nlos.simulate(bright, 1e-2, reconstruct=True)
    assert "camera.exposure = " in stage.reason
    assert result.reconstruction is None
    assert result.image.saturated_fraction > 0.8  # the rest sees no lit wall
    # the remedy that is named is one
    right = float(stage.reason.rsplit("=", 1)[1].removesuffix("s"))
    again = replace(bright, camera=replace(bright.camera, exposure=right))
    assert nlos.simulate(again, 1e-2, reconstruct=True).image.saturated_fraction < 0.2


def test_an_error_above_the_planned_one_is_told():
    with pytest.warns(ValidityWarning, match="error of the image is 0.01, planned was tol = 0.001"):
        check_errors({"image": 0.01, "point spread": 1e-4}, 1e-3)


def test_a_fit_that_refuses_leaves_the_run_its_image(flat_scene, monkeypatch):
    def refuses(*_, **__):
        raise SceneError("no light; expose longer")

    monkeypatch.setattr(nlos.inverse, "tv_deconvolve", refuses)
    with pytest.warns(ValidityWarning, match="no object is reconstructed: no light"):
        result = nlos.simulate(flat_scene, 1e-2, reconstruct=True)
    assert result.reconstruction is None
    assert result.image.electrons.max() > 0


def test_shadows_on_too_small_a_part_of_the_wall_are_left_out_by_the_plan():
    scene = nlos.Scene.load("examples/scenes/letter_disc.toml").resized(16)
    assert nlos.plan(scene, reconstruct=True).runs("reconstruction")
    small = replace(scene.resized(8), wall=FlatWall(size=(1.6, 0.25)))
    (stage,) = (s for s in nlos.plan(small, reconstruct=True).skipped if "squares" in s.reason)
    assert "limit 64" in stage.reason
