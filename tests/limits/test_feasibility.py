"""Feasibility: photons, modulation, noise, verdict, and comparison with fits."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

import nlosoptics
from nlosoptics import limits
from nlosoptics.errors import SceneError
from nlosoptics.imaging.images import light_levels
from nlosoptics.limits import modulation
from nlosoptics.limits.modulation import Noise, padded, spectra
from nlosoptics.limits.reports import first_crossing
from nlosoptics.scene import (
    FlatWall,
    Lambert,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)


@pytest.fixture
def scene(examples) -> Scene:
    """The letter of the first example, 64 x 64 pixels."""
    return Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)


def walled(scene: Scene, slope: float, **camera) -> Scene:
    """With a mirror-like lobe of a slope, and changes of the camera."""
    material = SumMaterial(Lambert(0.75), SpecularMicrofacet(0.05, slope))
    return replace(scene, wall_material=material, camera=replace(scene.camera, **camera))


def test_signal_to_noise_is_that_of_photons_alone(scene: Scene) -> None:
    """White plate, mirror, no readout noise: sqrt(N/2) for N electrons."""
    camera = replace(scene.camera, read_noise=0.0, dark_current=0.0, full_well=1e7, bit_depth=32)
    hidden = PlanarObject(np.ones((4, 4)), 0.3, position=scene.hidden.position)
    mirror = replace(
        scene,
        camera=camera,
        hidden=hidden,
        laser=replace(scene.laser, independent_patterns=None),
        wall_material=SpecularMicrofacet(0.3, 0.0),
    )
    found = limits.feasibility(mirror)
    # the plate's rim covers its pixels in part: 13 pixels across, half of a pixel at each side
    assert found.signal_to_noise[0] == approx(math.sqrt(found.electrons["signal"] / 2), rel=0.08)
    assert found.noise["readout"] == approx(1e7 / 2**32 / math.sqrt(12) * 64, rel=1e-9)
    assert found.veil == 0.0
    assert found.diffuse_modes == 0


@pytest.mark.parametrize("slope", [0.01, 0.02])
def test_lobe_modulation_is_the_closed_form(scene: Scene, slope: float) -> None:
    camera = replace(scene.camera, position=(-0.05, 0.0, 0.8), aim=(0.0, 0.0, 0.0), field_stop=None)
    hidden = replace(scene.hidden, position=(0.0625, 0.0, 1.0))
    near = replace(scene, camera=camera, hidden=hidden).resized(256)
    found = limits.feasibility(walled(near, slope))
    low = (found.frequency > 0) & (found.frequency < 0.2 / slope)
    expected = limits.lobe_relay_transfer(found.frequency[low], 1.0, slope)
    # 4 deg oblique and pixels of a quarter of the blur, 1 % each; the point spread is cut where it
    # falls below 1e-2 of its peak
    assert np.log(found.modulation[low]) == approx(np.log(expected), rel=0.04)


@pytest.mark.thorough
@pytest.mark.parametrize("slope", [0.0005, 0.002, 0.01, 0.05])
def test_resolution_is_the_closed_form_of_the_lobe(scene: Scene, slope: float) -> None:
    """At normal incidence, the frequency at which strength times exp(-8 (pi s d f)^2) is 1."""
    camera = replace(scene.camera, position=(-0.05, 0.0, 0.8), aim=(0.0, 0.0, 0.0), field_stop=None)
    hidden = replace(scene.hidden, position=(0.0625, 0.0, 1.0))
    near = replace(scene, camera=camera, hidden=hidden).resized(512)
    found = limits.feasibility(walled(near, slope))
    expected = math.sqrt(math.log(found.signal_to_noise[0]) / 8) / (math.pi * slope)
    # 4 deg oblique, and the blur is the rms of both axes
    assert found.limit == approx(min(expected, found.frequency[-1]), rel=0.05)


def test_resolution_is_the_first_crossing() -> None:
    frequency = np.geomspace(1.0, 16.0, 5)
    assert first_crossing(frequency, np.array([4.0, 2.0, 0.5, 3.0, 0.1])) == approx(2 * 2**0.5)
    assert first_crossing(frequency, np.full(5, 2.0)) == 16.0
    assert first_crossing(frequency, np.array([0.5, 2.0, 2.0, 2.0, 2.0])) == 0.0


def disc(radius: float, at: np.ndarray) -> trimesh.Trimesh:
    """Disc parallel to the wall."""
    angles = 2 * math.pi * np.arange(32) / 32
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles], axis=1)
    faces = [[32, i, (i + 1) % 32] for i in range(32)]
    return trimesh.Trimesh(np.vstack([rim, np.zeros(3)]) + at, faces, process=False)


def test_no_lobe_is_not_recoverable_and_says_which_would_do(scene: Scene) -> None:
    found = limits.feasibility(replace(scene, wall_material=Lambert(0.8)))
    assert not found.recoverable
    assert "no mirror-like lobe" in found.verdict
    needed = float(re.search(r"slope below ([\d.]+) rad", found.verdict)[1])  # type: ignore[index]
    # 2 sigma d1 below the stroke's width, d1 = 1.14 m along the oblique ray
    assert needed == approx(found.stroke / (2 * 1.14), rel=0.1)
    assert found.modes == found.diffuse_modes
    assert 2 <= found.diffuse_modes <= 10
    assert not found.modulation.any()
    assert found.score == 0.0
    assert found.wave_bounds == {}
    # one cycle/m: 0.6 %
    near = np.interp(1.0, found.frequency, np.log(found.relay_modulation))
    assert near == approx(math.log(0.0062), rel=0.1)


@pytest.mark.thorough
def test_occluder_raises_the_modes_and_is_not_advised_again(scene: Scene) -> None:
    """A disc of 12 cm near the object casts shadows that carry detail."""
    matt = replace(scene, wall_material=Lambert(0.8))
    shadowed = replace(matt, occluders=(disc(0.06, np.array([0.45, 0.0, 0.8])),))
    free, found = limits.feasibility(matt), limits.feasibility(shadowed)
    assert found.diffuse_modes > 3 * free.diffuse_modes
    assert found.relay_score > free.relay_score + 0.1
    assert "occluder near the object" in free.verdict
    assert "occluder near the object" not in found.verdict
    assert "past the occluders" in found.verdict


@pytest.mark.thorough
def test_diffuse_light_past_one_disc_is_limited_by_the_full_well(scene: Scene) -> None:
    """A well without limit ends the saturation; the forecast is then what the fit reaches."""
    matt = replace(scene, wall_material=Lambert(0.8))
    shadowed = replace(matt, occluders=(disc(0.06, np.array([0.45, 0.0, 0.8])),))
    found = limits.feasibility(shadowed, exposure=4e3)
    assert found.saturated > 0.01  # the same light by a stronger laser would fill the pixels
    assert not found.recoverable
    camera = replace(shadowed.camera, full_well=1e12, bit_depth=32, exposure=4e3)
    shadowed = replace(shadowed, camera=camera)
    found = limits.feasibility(shadowed)
    assert (found.saturated, found.score) == (0.0, 0.0)
    fit = nlosoptics.simulate(shadowed, reconstruct=True).reconstruction
    truth = shadowed.hidden.reflectance.reshape(32, 16, 32, 16).mean(axis=(1, 3))
    obtained = np.corrcoef(fit.object.ravel(), truth.ravel())[0, 1]
    assert found.relay_score == approx(obtained, abs=0.07)


@pytest.mark.thorough
def test_wide_lobe_is_told_with_the_slope_that_would_do(scene: Scene) -> None:
    found = limits.feasibility(walled(scene, 0.05))
    assert not found.recoverable
    needed = float(re.search(r"a lobe of ([\d.]+) rad", found.verdict)[1])  # type: ignore[index]
    # the lobe thought of is round, that of an oblique wall is longer in the plane of incidence
    assert limits.feasibility(walled(scene, 0.7 * needed)).recoverable
    assert not limits.feasibility(walled(scene, 1.2 * needed)).recoverable


@pytest.mark.thorough
def test_weak_light_is_told_with_the_exposure_that_would_do(scene: Scene) -> None:
    dark = walled(scene, 0.0, exposure=1e-4)
    found = limits.feasibility(dark)
    assert "noise is too strong" in found.verdict
    factor = float(re.search(r"([\d.e+]+) times the exposure", found.verdict)[1])  # type: ignore[index]
    # rounded up to two digits, so that the factor itself suffices
    assert limits.feasibility(dark, exposure=1e-4 * factor).recoverable
    assert not limits.feasibility(dark, exposure=0.9e-4 * factor).recoverable


def test_full_pixels_and_black_pictures_are_told(scene: Scene) -> None:
    found = limits.feasibility(walled(scene, 0.0, full_well=10.0))
    assert "pixels are full" in found.verdict
    assert found.saturated > 0.01
    black = replace(
        scene, hidden=PlanarObject(np.zeros((4, 4)), 0.3, position=scene.hidden.position)
    )
    found = limits.feasibility(black)
    assert "no light" in found.verdict
    pixel = limits.feasibility(scene.resized(1))
    assert pixel.electrons["signal"] > 1e6
    assert pixel.verdict.startswith("not recoverable: all pixels see the same light and show no")
    assert found.photons == 0.0
    json.dumps(found.figures(), allow_nan=False)


@pytest.mark.parametrize(
    "changes",
    [
        (0.0, 40e-3),
        pytest.param((0.02, 20e-3), marks=pytest.mark.thorough),
        pytest.param((0.06, 20e-3), marks=pytest.mark.thorough),
    ],
)
def test_score_is_what_a_fit_then_reaches(scene: Scene, changes: tuple[float, float]) -> None:
    from nlosoptics import inverse

    slope, exposure = changes
    case = walled(scene, slope, exposure=exposure)
    found = limits.feasibility(case)
    result = nlosoptics.simulate(case, 1e-2, seed=5, reconstruct=True)
    reached = inverse.registered_correlation(result.reconstruction, result.image.ideal)
    assert found.recoverable == (reached > 0.9)
    assert found.score == approx(reached, abs=2.5 * found.score_spread)


def test_figures_and_text_hold_everything(scene: Scene) -> None:
    found = limits.feasibility(scene)
    figures = json.loads(json.dumps(found.figures(), allow_nan=False))
    assert set(figures) == set(found.__dataclass_fields__)
    assert figures["wave_bounds"]["4"] is None  # the focus of a wave in focus
    text = str(found)
    assert text.startswith("recoverable\n")
    assert "modes above noise" in text
    assert not found.frequency.flags.writeable


def test_curved_wall_magnifies(examples) -> None:
    """Scale at the object's middle, against two points of the picture imaged by chief rays."""
    from nlosoptics.imaging.geometry import chief_rays, picture_coordinates, pixel_centres
    from nlosoptics.limits.modulation import object_scale

    scene = Scene.load(examples / "scenes" / "letter_concave.toml").resized(64)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    column, _ = picture_coordinates(scene.hidden, rays)
    columns = scene.hidden.reflectance.shape[1]
    middle = np.unravel_index(np.nanargmin(abs(column - columns / 2)), column.shape)
    step = abs(column[32, middle[1] + 1] - column[32, middle[1] - 1]) / 2
    across = step * scene.hidden.size[0] / columns / scene.camera.image_pitch
    flat = object_scale(replace(scene, wall=FlatWall()))
    # in plane and across differ by some percent: the wall is seen obliquely
    assert object_scale(scene) == approx(across, rel=0.05)
    assert abs(object_scale(scene) / flat - 1) > 0.05


@pytest.mark.parametrize("falls", [0.0, modulation.TV_FIT.prior_power])
def test_score_is_that_of_a_filter_for_its_own_prior(
    monkeypatch: pytest.MonkeyPatch, falls: float
) -> None:
    """With one noise it is the Wiener filter's for the expected spectrum, and lower for others."""
    fit = replace(modulation.TV_FIT, left=modulation.TV_FIT.smoothed)
    monkeypatch.setattr(modulation, "TV_FIT", fit)
    noise = Noise(photons=3.0, readout=1.0, speckle=0.0)
    image = np.random.default_rng(5).random((32, 32))
    picture = spectra(image, np.ones((64, 33)), 1.0, noise)
    lowest = 2.0 * picture.frequency[0, 1]
    power = 1e4 * (picture.frequency**2 + lowest**2) ** (-falls / 2)
    transfer = np.exp(-((picture.frequency / 0.2) ** 2))
    picture = replace(picture, power=power, transfer=transfer)
    share = picture.grain**fit.grain_power / math.sqrt(picture.fill)
    weak = 1.0 + fit.weak_light / picture.excess
    white = fit.smoothed * share * weak * noise.variance * image.size
    passed = power * transfer**2 / (power * transfer**2 + white)
    wiener = math.sqrt((picture.twice * power * passed).sum() / (picture.twice * power).sum())
    if falls:
        assert picture.score() == approx(wiener, rel=1e-12)
    else:
        assert 0.5 * wiener < picture.score() < 0.99 * wiener


def test_score_grows_steadily_with_light(scene: Scene) -> None:
    """From 0 to nearly 1 as the light grows, without a step."""
    ideal = light_levels(scene).ideal
    rows, columns = padded(ideal.shape)
    flat = np.ones((rows, columns // 2 + 1))
    picture = spectra(ideal, flat, 1.0, Noise(photons=1e14, readout=0.0, speckle=0.0))
    light = np.geomspace(1, 1e14, 141)
    scores = np.array([picture.with_noise(picture.noise.exposed(k)).score() for k in light])
    rise = np.diff(scores)
    assert np.all(rise >= 0.0)
    # a tenth of a decade of light; a gate would make a step of 0.5 or more
    assert rise.max() < 0.07
    assert scores[0] < 0.01
    assert scores[-1] > 0.99


@pytest.mark.thorough
def test_needs_no_torch(examples) -> None:
    code = (
        "import sys; import nlosoptics as n; "
        f"s = n.Scene.load({str(examples / 'scenes' / 'letter_flat.toml')!r}).resized(64); "
        "print(n.limits.feasibility(s).recoverable, 'torch' in sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.stdout == "True False\n", answer.stderr


def test_bad_input_is_named(scene: Scene) -> None:
    with pytest.raises(SceneError, match="scene is a str"):
        limits.feasibility("letter")  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="exposure"):
        limits.feasibility(scene, exposure=0.0)


def test_walls_narrower_than_the_bins_of_the_prediction(scene: Scene) -> None:
    """Bins that the wall fills in part say nothing about it, so that modes are counted instead."""
    strips = [
        replace(scene, wall=FlatWall(size=(width, 1.0)), laser=replace(scene.laser, aim=(0, 0, 0)))
        for width in (0.02, 0.05)
    ]
    narrow, wide = (limits.feasibility(strip).diffuse_modes for strip in strips)
    assert 1 <= narrow <= wide
