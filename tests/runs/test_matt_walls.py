"""Matt walls with shadows through all doors: simulate, plan, run, reconstruct, feasibility."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from pytest import approx
from scipy import constants

import nlosoptics as nlos
from nlosoptics import cli, imaging, inverse, limits, reconstructing
from nlosoptics.errors import ValidityWarning
from nlosoptics.imaging import WallTransport
from nlosoptics.runs.noise import electron_noise
from nlosoptics.scene import FlatWall, Lambert, Scene

SCENES = Path(__file__).parents[2] / "examples" / "scenes"


def call(capsys, *arguments: object) -> dict:
    """Run the program and return the JSON that it prints, if any."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert (ended.value.code or 0) == 0, err
    return json.loads(out) if out.startswith("{") else {}


def test_a_letter_is_read_off_the_shadows_of_a_disc(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = SCENES / "letter_disc.toml"
    exposure = ("--set", "camera.exposure=100 ms")
    call(capsys, "run", scene, "--size", 32, *exposure, "--out", "letter")
    result = nlos.load_result("letter")
    assert (result.exit_pupil, result.wavefront, result.point_spread) == (None, None, None)
    assert (tmp_path / "letter" / "overview.png").is_file()
    truth = result.scene.hidden.reflectance.reshape(32, 16, 32, 16).mean(axis=(1, 3))
    fit = result.reconstruction
    assert fit.status == "converged"
    assert np.corrcoef(fit.object.ravel(), truth.ravel())[0, 1] > 0.85
    figures = json.loads(Path("letter/result.json").read_text())["figures"]
    assert figures["correlation_with_truth"] == approx(inverse.registered_correlation(fit, truth))
    # the same image as a file, whose noise is estimated
    np.save("photo.npy", result.image.electrons)
    usual = ("reconstruct", "photo.npy", "--scene", "letter/scene.toml", "--json")
    report = call(capsys, *usual)
    assert report["figures"]["method"] == "shadows"
    again = np.load("photo/object.npy")
    assert np.corrcoef(again.ravel(), truth.ravel())[0, 1] > 0.8
    forecast = limits.feasibility(result.scene)
    assert forecast.diffuse_modes > 20
    assert forecast.score == 0.0 < forecast.relay_score


def test_an_occluder_in_view_is_left_out(tmp_path) -> None:
    """A board between camera and wall is bright in the room's light; the model knows it as dark."""
    scene = Scene.load(SCENES / "letter_disc.toml").resized(64)
    board = trimesh.creation.box((0.06, 0.06, 1e-3)).apply_translation((-0.45, 0.0, 0.5))
    scene = replace(scene, occluders=(*scene.occluders, board))
    light = imaging.form_image(scene, None, seed=0).electrons
    covered = 1.0 - imaging.cast_shadows(scene).view
    assert 0.05 < covered.mean() < 0.15
    np.save(tmp_path / "photo.npy", light + 3.0 * light.max() * covered)
    fit = reconstructing.reconstructed(reconstructing.prepared(scene, [tmp_path / "photo.npy"]))
    assert fit.status == "converged", fit.reasons
    side = len(fit.object)
    truth = scene.hidden.reflectance.reshape(side, 512 // side, side, -1).mean(axis=(1, 3))
    assert np.corrcoef(fit.object.ravel(), truth.ravel())[0, 1] > 0.95


def screen(**parts) -> Scene:
    """A luminous screen past a chair, 16 x 16 pixels."""
    scene = Scene.load(SCENES / "screen_chair.toml")
    return replace(scene, **({"camera": replace(scene.camera, binning=256)} | parts))


@pytest.mark.thorough
def test_light_of_screen_and_room_is_that_of_the_operator() -> None:
    disc = Scene.load(SCENES / "letter_disc.toml").occluders
    scene = screen(ambient_irradiance=1e-3, occluders=disc)
    camera = replace(scene.camera, field_stop=None)
    scene = replace(scene, camera=camera, wall=FlatWall(size=4.0))
    hidden = scene.hidden
    options = {"cells": (32, 32), "samples": 8}
    picture = hidden.reflectance.reshape(32, 16, 32, 16).mean(axis=(1, 3))
    lobe = hidden.luminous_lobe
    emitted = WallTransport(scene, source="luminous", lobe=lobe, **options).forward(picture)
    lit = WallTransport(scene, source="ambient", **options).forward(picture)
    expected = hidden.luminous * emitted + 1e-3 * lit
    image = imaging.form_image(scene, None)
    ambient = image.ledger["ambient"] / 256
    diffuse = image.background - image.ledger["dark"] / 256
    assert image.ledger["diffuse"] == approx(expected.sum(), rel=1.5e-3)
    # a matt wall in uniform light has the radiance albedo E / pi; the image falls as cos^4
    lens = camera.stop_diameter / (2 * scene.image_distance)
    rate = camera.quantum_efficiency * scene.laser.wavelength / (constants.h * constants.c)
    gain = math.pi * camera.transmission * lens**2
    gain *= (256 * camera.pixel_pitch) ** 2 * camera.exposure * rate
    side = (np.arange(16) - 7.5) * 256 * camera.pixel_pitch / scene.image_distance
    cos4 = (1 + side**2 + side[:, None] ** 2) ** -2.0
    assert ambient == approx(0.6 * 1e-3 / math.pi * gain * cos4.mean(), rel=1e-3)
    rest = diffuse - 0.6 * 1e-3 / math.pi * gain * cos4
    assert rest == approx(expected, abs=0.01 * expected.mean())


def test_light_that_is_not_described_is_refused() -> None:
    dark = screen(ambient_irradiance=0.0)
    dark = replace(dark, hidden=replace(dark.hidden, luminous=None))
    with pytest.warns(ValidityWarning, match=r"no object .* the scene has no light: .*; add one"):
        assert nlos.simulate(dark, reconstruct=True).reconstruction is None


def test_light_of_the_room_has_no_speckle() -> None:
    """It adds shot noise alone, to simulated images and to the noise of a reading."""
    flat = Scene.load(SCENES / "letter_flat.toml").resized(8)
    laser = replace(flat.laser, independent_patterns=1)
    camera = replace(flat.camera, exposure=1e4, field_stop=None)  # more speckle than shot noise
    speckled = replace(flat, wall_material=Lambert(0.7), laser=laser, camera=camera)
    lit = replace(speckled, ambient_irradiance=1e-5)
    with_room, without = imaging.form_image(lit, None), imaging.form_image(speckled, None)
    more = with_room.expected - without.expected
    assert more.max() > without.expected.max()
    assert with_room.noise_sigma**2 - without.noise_sigma**2 == approx(more)
    reading = with_room.expected - with_room.ledger["dark"] / more.size
    inside = np.s_[2:-2, 2:-2]
    noise = electron_noise(lit, reading)[inside]
    assert noise == approx(with_room.noise_sigma[inside], rel=0.2)


@pytest.mark.thorough
def test_a_photograph_of_a_wall_becomes_a_picture_by_one_command(tmp_path, capsys) -> None:
    """An 8-bit JPEG of sRGB values, turned, in perspective, with a margin around the wall."""
    discs = Scene.load(SCENES / "letter_discs.toml").occluders
    scene = screen(occluders=discs).resized(64)
    scene = replace(scene, camera=replace(scene.camera, field_stop=None))
    scene.save(tmp_path / "scene.toml")
    lobe, truth = scene.hidden.luminous_lobe, scene.hidden.reflectance
    fine = WallTransport(scene.resized(128), cells=(64, 64), source="luminous", lobe=lobe)
    light = fine.forward(truth.reshape(64, 8, 64, 8).mean(axis=(1, 3)))
    light = np.pad(0.1 + 0.7 * light / light.max(), 16, mode="edge")
    # from the photograph's positions to those in the wall's image
    mapping = np.array([[0.24, 0.015, -40.0], [-0.01, 0.25, -30.0], [1e-4, -5e-5, 1.0]])
    photo = Image.fromarray(light.astype(np.float32)).transform(
        (800, 800), Image.Transform.PERSPECTIVE, list(mapping.ravel()[:8]), Image.Resampling.BICUBIC
    )
    photo = np.maximum(photo.rotate(-6.0, Image.Resampling.BICUBIC), 0.0)
    seen = np.random.default_rng(0).poisson(5e3 * photo[..., None].repeat(3, axis=-1)) / 5e3
    stored = np.where(seen < 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    jpeg = tmp_path / "photo.jpg"
    Image.fromarray(np.uint8(255.5 * stored.clip(0.0, 1.0))).save(jpeg, quality=92)
    ends = np.array([(16, 16, 1), (144, 16, 1), (144, 144, 1), (16, 144, 1)])
    corners = np.linalg.solve(mapping, ends.T)
    corners = (corners[:2] / corners[2]).T - (20.0, 10.0)
    options = ("--method", "shadows", "--gamma", "srgb", "--channel", "grey", "--rotate", 6)
    options += ("--crop", "20,10,760,770", "--out", tmp_path / "out", "--json")
    marked = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    command = ("reconstruct", jpeg, "--scene", tmp_path / "scene.toml", "--corners", marked)
    with pytest.raises(SystemExit) as ended:
        cli.main([str(part) for part in command + options])
    out, err = capsys.readouterr()
    assert not ended.value.code, err
    assert "JPEG artefacts and 8 bits" in err
    assert json.loads(out)["figures"]["reconstruction_status"] == "converged"
    picture, cells = np.load(tmp_path / "out" / "object.npy"), truth.reshape(32, 16, 32, 16)
    assert np.corrcoef(picture.ravel(), cells.mean(axis=(1, 3)).ravel())[0, 1] > 0.9


def test_no_wave_is_planned_and_no_laser_drawn() -> None:
    plan = nlos.plan(screen(), reconstruct=True)
    assert [stage.name for stage in plan.stages] == ["shadow rays", "image", "reconstruction"]
    assert {s.reason for s in plan.skipped} == {
        "the wall has no mirror-like lobe and forms no image"
    }
    assert math.isnan(plan.waves)
    (axes, *_) = nlos.views.scene_sketch(screen())
    assert "laser beam" not in [line.get_label() for line in axes.get_lines()]
