"""The command `reconstruct` with each of its methods, from picture files to result.json."""

from __future__ import annotations

import json
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import nlosoptics
from nlosoptics import cli, inverse, reconstructing
from nlosoptics.imaging import ForwardModel
from nlosoptics.scene import Scene

SIDE = 32
#: Noll 4 to 8 of the wall that the scene file does not know, waves rms.
WALL = {4: 0.1, 5: -0.12, 6: 0.1, 7: 0.15, 8: -0.1}


@pytest.fixture(scope="module")
def exposed(examples: Path) -> nlosoptics.Result:
    """A simulated exposure of a letter."""
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(64)
    return nlosoptics.simulate(scene, 1e-2, seed=2)


@pytest.fixture
def letter(
    exposed: nlosoptics.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> np.ndarray:
    """The truth; beside it letter.npy and letter.toml."""
    monkeypatch.chdir(tmp_path)
    exposed.scene.save("letter.toml")
    np.save("letter.npy", exposed.image.electrons)
    return exposed.image.ideal


@pytest.fixture
def frames(examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """The truth; beside it fine.toml, whose pixels resolve diffraction, and a.npy, b.npy.

    The second is half a wave further out of focus, both are by a wall that is not the scene's.
    """
    monkeypatch.chdir(tmp_path)
    scene = Scene.load(examples / "scenes" / "letter_flat.toml").resized(SIDE)
    fine = replace(scene.camera, stop_diameter=0.22e-3, pixel_pitch=72e-6 / scene.camera.binning)
    scene = replace(scene, camera=fine)
    scene.save("fine.toml")
    pupil = inverse.PupilPSF.from_scene(
        scene,
        tuple(WALL),
        pitch=scene.camera.image_pitch,
        shape=2 * SIDE,
        pixel_integrated=True,
    )
    half = 0.5 * scene.laser.wavelength
    with torch.no_grad():
        kernels = pupil(torch.tensor(list(WALL.values())), defocus=[0.0, half]).double().numpy()
    truth = np.zeros((SIDE, SIDE))
    truth[8:24, 10:14] = 1.0
    truth[20:24, 10:22] = 1.0
    truth[14:17, 10:19] = 0.8
    random = np.random.default_rng(0)
    for name, kernel in zip("ab", kernels, strict=True):
        seen = 3e4 * ForwardModel(kernel, shape=truth.shape).forward(truth) + 500.0
        np.save(f"{name}.npy", seen + 0.01 * seen.max() * random.normal(size=seen.shape))
    Image.fromarray(np.zeros((SIDE, SIDE, 3), dtype=np.uint8)).save("colour.png")
    return truth


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the program."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(a) for a in arguments])
    told = capsys.readouterr()
    return int(ended.value.code or 0), told.out, told.err


def report_of(folder: str) -> dict:
    """What result.json says, its files checked."""
    report = json.loads(Path(folder, "result.json").read_text())
    assert set(report["files"]) == {p.name for p in Path(folder).iterdir()}
    assert report["status"] == "done"
    return report


@pytest.mark.parametrize(
    ("method", "options", "status", "least"),
    [
        # least correlations: the data's own is 0.99, the wall being smooth
        ("inverse_filter", (), "converged", 0.9),
        pytest.param("richardson_lucy", (), "converged", 0.9, marks=pytest.mark.thorough),
        ("richardson_lucy", ("--iterations", 2), "unconverged", 0.8),
        # of a frame whose object fills half of it, phases are not told from one picture
        ("phase_retrieval", ("--iterations", 20), None, -1.0),
    ],
)
def test_methods_that_know_the_point_spread(
    method, options, status, least, letter: np.ndarray, capsys
) -> None:
    usual = ("reconstruct", "letter.npy", "--scene", "letter.toml", "--tol", 1e-2)
    code, out, err = call(capsys, *usual, "--method", method, *options)
    assert (code, err) == (0, "")
    figures = report_of("letter")["figures"]
    assert figures["method"] == method
    assert method in out
    assert figures["reconstruction_status"] in (
        (status,) if status else ("converged", "unconverged")
    )
    found = np.load("letter/object.npy")
    assert found.shape == (64, 64)
    assert np.isfinite(found).all()
    assert inverse.registered_correlation(found, letter) > least


@pytest.mark.thorough
def test_frames_of_known_defocus(frames: np.ndarray, capsys) -> None:
    """A saturated pixel has no say."""
    hot = np.load("a.npy")
    hot[4, 7] = 10.0 * hot.max()
    np.save("a.npy", hot)
    usual = ("reconstruct", "a.npy", "b.npy", "--scene", "fine.toml", "--seed", 1)
    usual = (*usual, "--full", hot.max())
    options = ("--method", "evidence", "--defocus", "0, 0.5", "--iterations", 1)
    code, _, err = call(capsys, *usual, *options, "--out", "found")
    assert (code, err) == (0, "")
    figures = report_of("found")["figures"]
    assert figures["reconstruction_status"] in ("converged", "unconverged")
    assert len(figures["physical_parameters"]["coefficients"]) == len(reconstructing.MODES)
    # of one wall and two defoci there is no fit from no blur to compare with
    assert figures["physical_parameters"]["margin"] is None
    assert inverse.registered_correlation(np.load("found/object.npy"), frames) > 0.9


@pytest.mark.thorough
def test_one_frame_by_the_published_method_goes_on(frames: np.ndarray, capsys) -> None:
    usual = ("reconstruct", "a.npy", "--scene", "fine.toml", "--method", "wu2024")
    code, _, err = call(capsys, *usual, "--iterations", 40)
    assert (code, err) == (0, "")
    figures = report_of("a")["figures"]
    assert figures["reconstruction_status"] in ("unconverged", "ambiguous")
    assert figures["iterations"] == 40
    # half a million weights are in the arrays, not among the figures
    assert "network_weights" not in figures["physical_parameters"]
    with np.load("a/reconstruction.npz") as found:
        assert found["physical_parameters_network_weights"].size > 4e5


@pytest.mark.thorough
def test_ended_and_gone_on(frames: np.ndarray, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C at the second report of a fit of wall and object; --resume comes to the same end."""
    usual = ("reconstruct", "a.npy", "b.npy", "--scene", "fine.toml", "--iterations", 1)
    usual = (*usual, "--method", "evidence", "--defocus", "0, 0.5")
    assert call(capsys, *usual, "--out", "whole")[0] == 0
    told = reconstructing.Keeper.__call__
    calls = []

    def interrupts(self, fraction: float, text: str) -> None:
        calls.append(text)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        told(self, fraction, text)

    monkeypatch.setattr(reconstructing.Keeper, "__call__", interrupts)
    code, _, err = call(capsys, *usual, "--out", "part")
    assert (code, err.count("\n")) == (130, 1)
    report = json.loads(Path("part/result.json").read_text())
    assert report["status"] == "interrupted"
    assert report["figures"]["reconstruction_status"] == "unconverged"
    monkeypatch.setattr(reconstructing.Keeper, "__call__", told)
    assert call(capsys, *usual, "--out", "part", "--resume")[0] == 0
    assert report_of("part")["resumed"]
    assert np.array_equal(np.load("part/object.npy"), np.load("whole/object.npy"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (
            ["a.npy", "b.npy", "--method", "evidence", "--defocus", "0"],
            ["defocus has 1 value for 2 images"],
        ),
        (["a.npy", "b.npy", "--method", "wu2024"], ["2 images without defocus"]),
        (["colour.png", "--method", "evidence"], ["colour.png", "colour"]),
        (["fine.toml"], ["fine.toml"]),
        (["a.npy", "--method", "inverse_filter", "--iterations", "3"], ["does not iterate"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_line(arguments, named, frames: np.ndarray, capsys) -> None:
    code, out, err = call(capsys, "reconstruct", *arguments, "--scene", "fine.toml")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for word in named:
        assert word in err


def test_a_blur_wider_than_the_picture_is_refused(frames: np.ndarray, capsys) -> None:
    scene = Scene.load("fine.toml")
    # focused on 6 cm, the light of 1.8 m away fills a disc of 5 mm on a detector of 2.3 mm
    near = replace(scene.camera, focus_distance=0.06, stop_diameter=1.1e-3)
    replace(scene, camera=near).save("blurred.toml")
    code, _, err = call(capsys, "reconstruct", "a.npy", "--scene", "blurred.toml", "--tol", 0.1)
    assert (code, err.count("\n")) == (2, 1)
    assert "the blur is larger than the image" in err


def test_every_method_is_tried_here() -> None:
    tried = {"evidence", "wu2024", "burst", "shadows", *reconstructing.KNOWN}
    assert set(reconstructing.METHODS) == tried
