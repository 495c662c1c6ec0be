"""The commands `reconstruct` and `feasibility`: files, interruption, resumption, errors."""

from __future__ import annotations

import json
import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nlosoptics
from nlosoptics import cli, inverse, limits, reconstructing
from nlosoptics.imaging import CameraImage, ForwardModel, camera_image
from nlosoptics.imaging.detector import full_reading
from nlosoptics.scene import Lambert, Scene


@pytest.fixture(scope="module")
def result(examples: Path) -> nlosoptics.Result:
    """A simulated exposure."""
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    return nlosoptics.simulate(scene, 1e-2, seed=2)


@pytest.fixture
def taken(result: nlosoptics.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """The truth; beside it letter.png (16 bits), dark.npy, flat.tif and letter.toml."""
    monkeypatch.chdir(tmp_path)
    result.scene.save(tmp_path / "letter.toml")
    rng = np.random.default_rng(0)
    response, dark = rng.uniform(0.8, 1.2, (64, 64)), rng.uniform(100, 130, (64, 64))
    electrons = result.image.electrons
    counts = electrons / electrons.max() * 5e4 * response + dark
    counts[3, 60] = 65535
    Image.fromarray(np.rint(counts).clip(0, 65535).astype(np.uint16)).save("letter.png")
    np.save("dark.npy", dark)
    Image.fromarray((1e4 * response + dark).astype(np.float32)).save("flat.tif")
    return result.image.ideal


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the program."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(a) for a in arguments])
    told = capsys.readouterr()
    return int(ended.value.code or 0), told.out, told.err


USUAL = ("reconstruct", "letter.png", "--scene", "letter.toml", "--tol", 1e-2)
FRAMES = ("--dark", "dark.npy", "--flat", "flat.tif")


@pytest.mark.parametrize("method", ["tv", pytest.param("wiener", marks=pytest.mark.thorough)])
def test_object_and_report_are_written(method: str, taken: np.ndarray, capsys) -> None:
    code, out, err = call(capsys, *USUAL, *FRAMES, "--method", method, "--json", "--seed", 7)
    assert (code, err) == (0, "")
    report = json.loads(out)
    assert report == json.loads(Path("letter/result.json").read_text())
    assert set(report["files"]) == {p.name for p in Path("letter").iterdir()}
    assert (report["status"], report["seed"]) == ("done", 7)
    assert report["figures"]["masked_fraction"] == 1 / 64**2
    assert report["figures"]["reconstruction_status"] == "converged"
    assert len(report["scene_sha256"]) == 64
    assert report["versions"]["nlosoptics"] == nlosoptics.__version__
    found = np.load("letter/object.npy")
    # the data's correlation is 0.99 already: the wall is smooth
    assert inverse.registered_correlation(found, taken) > 0.98
    with Image.open("letter/object.png") as picture:
        drawn = np.asarray(picture)[:, ::-1] / 255.0  # the mirror is undone
    # a picture of 8 bits holds what is not negative, rounded
    assert abs(drawn - np.clip(found / found.max(), 0, 1)).max() <= 0.5 / 255 + 1e-12
    assert call(capsys, *USUAL, *FRAMES, "--method", method)[0] == 0  # over its own files


@pytest.mark.thorough
def test_hot_pixels_are_found_and_told(taken: np.ndarray, capsys, monkeypatch) -> None:
    axis = np.arange(13.0) - 6.0
    kernel = np.exp(-(axis**2 + axis[:, None] ** 2) / (2 * 1.5**2))
    model = ForwardModel(kernel / kernel.sum(), shape=taken.shape)
    monkeypatch.setattr(reconstructing, "known_model", lambda *_, **__: model)
    counts = 4e4 * model.forward(taken / taken.max()) + 1e3
    counts += np.random.default_rng(0).normal(0.0, 200.0, counts.shape)
    hot = [(10, 12), (30, 31), (30, 32), (50, 7)]
    counts[tuple(zip(*hot, strict=True))] = 6e4
    Image.fromarray(np.rint(counts).astype(np.uint16)).save("letter.png")
    code, out, _ = call(capsys, *USUAL)
    assert code == 0
    assert re.search(r"dead, hot or saturated pixels found +4", out)
    report = json.loads(Path("letter/result.json").read_text())
    assert report["figures"]["physical_parameters"]["bad_pixels"] == 4
    with np.load("letter/reconstruction.npz") as arrays:
        bad = arrays["physical_parameters_bad_pixel_map"]
    assert sorted(zip(*np.nonzero(bad), strict=True)) == hot
    assert inverse.registered_correlation(np.load("letter/object.npy"), taken) > 0.95


def test_ctrl_c_keeps_the_best_and_resume_ends_at_the_same_object(
    taken: np.ndarray, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert call(capsys, *USUAL, *FRAMES, "--out", "whole")[0] == 0
    told = reconstructing.Keeper.__call__
    calls = []

    def interrupts(self, fraction: float, text: str) -> None:
        calls.append(text)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGINT)
        told(self, fraction, text)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(reconstructing.Keeper, "__call__", interrupts)
    code, _, err = call(capsys, *USUAL, *FRAMES, "--out", "part")
    assert code == 130
    assert err.count("\n") == 1
    assert "--resume" in err
    assert signal.getsignal(signal.SIGINT) is before
    report = json.loads(Path("part/result.json").read_text())
    assert report["status"] == "interrupted"
    assert report["figures"]["iterations"] == 20
    assert np.isfinite(np.load("part/object.npy")).all()
    monkeypatch.setattr(reconstructing.Keeper, "__call__", told)
    assert call(capsys, *USUAL, *FRAMES, "--out", "part", "--resume")[0] == 0
    # the fit begins again from the kept object and ends within its tolerance
    part, whole = np.load("part/object.npy"), np.load("whole/object.npy")
    assert part == pytest.approx(whole, abs=0.02 * whole.max())
    again = json.loads(Path("part/result.json").read_text())
    assert (again["status"], again["resumed"]) == ("done", True)
    for options, named in (
        (("--method", "wiener"), "another scene, image, method"),
        (("--out", "never"), "no never/checkpoint.npz"),
    ):
        code, _, err = call(capsys, *USUAL, *FRAMES, "--out", "part", "--resume", *options)
        assert code == 2
        assert named in err


@pytest.mark.thorough
def test_a_fit_that_ends_early_leaves_the_old_object_and_its_state(
    taken: np.ndarray, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The old result stays whole until the new one is; the state allows to resume."""
    assert call(capsys, *USUAL, *FRAMES, "--iterations", 20)[0] == 0
    assert call(capsys, "report", "letter", "--no-3d")[0] == 0
    kept = ("object.npy", "object.png", "reconstruction.npz", "report.html")
    before = {name: Path("letter", name).read_bytes() for name in kept}
    monkeypatch.setattr(reconstructing, "KEPT_EVERY", 0.0)
    with monkeypatch.context() as broken:
        broken.setattr(reconstructing, "_figures", lambda *_: 1 / 0)
        code, _, err = call(capsys, *USUAL, *FRAMES)
    assert (code, err.count("\n")) == (1, 1)
    assert {name: Path("letter", name).read_bytes() for name in kept} == before
    record = json.loads(Path("letter/result.json").read_text())
    assert record["figures"]["iterations"] == 20
    assert set(record["files"]) == {p.name for p in Path("letter").iterdir()}
    assert call(capsys, *USUAL, *FRAMES, "--resume")[0] == 0
    assert call(capsys, *USUAL, *FRAMES, "--out", "whole")[0] == 0
    part, whole = np.load("letter/object.npy"), np.load("whole/object.npy")
    assert part == pytest.approx(whole, abs=0.02 * whole.max())
    assert not [p for p in Path().rglob(".*")]


def bad_files() -> None:
    """Pictures that cannot be used."""
    good = np.load("dark.npy")
    np.save("nan.npy", np.where(good > 129, np.nan, good))
    np.save("small.npy", good[:60])
    Image.fromarray(np.full((64, 64), 255, np.uint8)).save("full.png")
    scene = Scene.load("letter.toml")
    replace(scene, wall_material=Lambert(0.8)).save("matt.toml")
    near = replace(scene.camera, focus_distance=0.06, stop_diameter=0.025)
    replace(scene, camera=near).save("blurred.toml")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nan.npy"], ["nan.npy", "not finite"]),
        (["small.npy"], ["64 x 60", "64 x 64"]),
        (["full.png"], ["reads 255 in every pixel"]),
        (["nowhere.png"], ["no file nowhere.png"]),
        (["letter.png", "--scene", "matt.toml"], ["no mirror-like lobe", "feasibility"]),
        (["letter.png", "--scene", "blurred.toml"], ["point spread", "pixels"]),
        (["letter.png", "--method", "magic"], ["method = 'magic'", "tv, wiener"]),
        (["letter.png", "--defocus", "a"], ["--defocus", "'a'"]),
        (["letter.png", "--defocus", "0.5"], ["defocus is given"]),
        (["letter.png", "--resume"], ["no letter/checkpoint.npz"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_and_writes_nothing(
    arguments: list[str], named: list[str], taken: np.ndarray, capsys
) -> None:
    bad_files()
    before = sorted(Path().rglob("*"))
    scene = [] if "--scene" in arguments else ["--scene", "letter.toml"]
    code, out, err = call(capsys, "reconstruct", *arguments, *scene, "--tol", 1e-2)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for word in named:
        assert word in err
    assert sorted(Path().rglob("*")) == before


def test_feasibility_command(taken: np.ndarray, capsys) -> None:
    found = limits.feasibility(Scene.load("letter.toml"))
    assert call(capsys, "feasibility", "letter.toml") == (0, f"{found}\n", "")
    code, out, _ = call(capsys, "feasibility", "letter.toml", "--json", "--out", "f.png")
    assert code == 0
    assert json.loads(out) == json.loads(json.dumps(found.figures()))
    assert Path("f.png").stat().st_size > 5_000
    code, _, err = call(capsys, "feasibility", "nowhere.toml")
    assert (code, err.count("\n")) == (2, 1)


@pytest.mark.parametrize("gain", [0.05, 40.0])
def test_noise_of_a_file_follows_the_light_in_any_unit(gain, result: nlosoptics.Result) -> None:
    """Counts per electron are not known; the mean noise and the light give them."""
    electrons = result.image.electrons
    masked = np.zeros(electrons.shape, dtype=bool)
    masked[3, 60] = masked[30:33, 30] = True
    image = CameraImage(
        values=np.where(masked, gain * electrons.mean(), gain * electrons),
        masked=masked,
        saturated=np.zeros_like(masked),
        saturated_fraction=0.0,
    )
    model = reconstructing.known_model(result.scene, tol=1e-2)
    noise = reconstructing.camera_noise(result.scene, image, model)
    assert np.array_equal(np.isinf(noise), masked)
    ratio = (noise / (gain * result.image.noise_sigma))[~masked]
    # the mean is estimated from second differences, which the edges of a sharp letter raise by a
    # quarter; the light is averaged over 1.5 pixels, which moves it at the letter's edges
    assert 0.9 < np.median(ratio) < 1.3
    assert np.quantile(ratio, 0.95) / np.quantile(ratio, 0.05) < 1.3
    # bright pixels have 1.67 times the noise of dark ones, before the average
    assert noise[~masked].max() > 1.3 * noise[~masked].min()


def test_even_noise_where_the_camera_explains_none(result: nlosoptics.Result) -> None:
    """Noise below that of speckle, which no number of electrons per count lowers."""
    speckled = replace(result.scene, laser=replace(result.scene.laser, independent_patterns=1))
    smooth = np.full((64, 64), 1000.0) + np.random.default_rng(0).normal(0.0, 1e-3, (64, 64))
    none = np.zeros((64, 64), bool)
    image = CameraImage(values=smooth, masked=none, saturated=none, saturated_fraction=0.0)
    model = reconstructing.known_model(result.scene, tol=1e-2)
    noise = reconstructing.camera_noise(speckled, image, model)
    assert np.ptp(noise) == 0.0
    # relative spread 2/sqrt(pixels), three errors
    assert noise[0, 0] == pytest.approx(1e-3, rel=0.12)


@pytest.mark.thorough
def test_simulated_full_pixels_are_lower_limits(result: nlosoptics.Result) -> None:
    camera, image = result.scene.camera, result.image
    level = 0.5 * image.expected.max() / camera.binning**2
    camera = replace(camera, full_well=level, bit_depth=12, read_noise=0.03 * level)
    scene = replace(result.scene, camera=camera)
    run = nlosoptics.simulate(scene, 1e-2, seed=3, reconstruct=True)
    found, electrons = run.reconstruction, run.image.electrons
    n_full = round(run.image.saturated_fraction * electrons.size)
    stated = found.physical_parameters["saturated_pixels"]
    # no full pixel is lost; some others within the readout's noise count too
    assert 0 < n_full <= stated <= np.count_nonzero(image.expected > 0.4 * image.expected.max())
    assert stated == np.count_nonzero(electrons >= full_reading(camera))
    assert inverse.registered_correlation(found, image.ideal) > 0.93


@pytest.mark.thorough
@pytest.mark.parametrize("over", [2.5, 30.0])
def test_an_overexposed_simulation_is_told_to_expose_shorter(over, result) -> None:
    """A little light beyond the full well hides little; thirty times leaves no pixel of it."""
    power = result.scene.laser.power * over * full_reading(result.scene.camera)
    laser = replace(result.scene.laser, power=power / result.image.expected.max())
    scene = replace(result.scene, laser=laser)
    if over == 2.5:
        found = nlosoptics.simulate(scene, 1e-2, reconstruct=True)
        assert found.reconstruction.status == "converged"
        assert inverse.registered_correlation(found.reconstruction, found.image.ideal) > 0.97
    else:
        found = nlosoptics.simulate(scene, 1e-2, reconstruct=True)
        assert found.reconstruction is None
        assert any("saturated, the fullest" in stage.reason for stage in found.plan.skipped)


@pytest.mark.thorough
def test_full_pixels_of_a_file_are_lower_limits(result: nlosoptics.Result, tmp_path: Path) -> None:
    electrons, camera = result.image.electrons, result.scene.camera
    file = tmp_path / "short.png"
    counts = np.clip(electrons / (0.4 * electrons.max()) * 255.0, 0.0, 255.0)
    Image.fromarray(counts.astype(np.uint8)).save(file)
    taken = camera_image(file, shape=camera.shape)
    full = counts == 255.0
    assert np.array_equal(taken.saturated, full)
    assert np.array_equal(taken.masked, full)
    assert (taken.values[full] == 255.0).all()
    task = reconstructing.prepared(result.scene, [file], tol=1e-2)
    found = reconstructing.reconstructed(task)
    assert found.physical_parameters["saturated_pixels"] == full.sum()
    model = reconstructing.known_model(result.scene, tol=1e-2)
    ignored = inverse.tv_deconvolve(inverse.Measurement(taken.values, masked=full), model)
    score = inverse.registered_correlation(found, result.image.ideal)
    assert score > inverse.registered_correlation(ignored, result.image.ideal) + 0.01
