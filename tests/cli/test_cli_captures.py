"""The commands transient and image: from a scene file to a picture, by files."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlosoptics import cli
from nlosoptics.transient import TransientCapture, wall_grid

SCENE = """
[laser]
wavelength = "532 nm"
power = "100 mW"
beam_diameter = "3 mm"
position = ["-0.5 m", "0 m", "0.25 m"]

[wall]
shape = "flat"
material = { lobe = "lambert", albedo = 0.8 }

[hidden]
image = "dot.npy"
size = "0.2 m"
position = ["0.25 m", "-0.25 m", "0.8 m"]

[camera]
position = ["-0.5 m", "0 m", "0.25 m"]
aim = ["0 m", "0 m", "0 m"]
focal_length = "50 mm"
stop_diameter = "25 mm"

[transient]
side = "2 m"
count = 8
t_start = "1 m"
delta_t = "2 cm"
n_bins = 150
wl_mean = "0.5 m"
near = "0.6 m"
far = "1 m"
step = "10 cm"
"""


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Call the command line in a folder that has a scene of a small white square."""
    monkeypatch.chdir(tmp_path)
    np.save("dot.npy", np.ones((2, 2)))
    Path("dot.toml").write_text(SCENE)

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            cli.main([str(word) for word in words])
        told = capsys.readouterr()
        return int(ended.value.code or 0), told.out, told.err

    return call


def test_from_a_scene_to_its_picture(run):
    code, out, err = run("transient", "dot.toml")
    assert (code, err) == (0, "")
    assert "150 of 20 mm" in out
    capture = TransientCapture.load("dot.hdf5")
    assert capture.H.shape == (150, 8, 8)
    assert capture.details["run"]["seed"] == 0
    assert len(capture.details["run"]["scene_sha256"]) == 64

    code, out, err = run("image", "dot.hdf5", "--out", "seen")
    assert code == 0
    assert sorted(p.name for p in Path("seen").iterdir()) == [
        "depth.png",
        "front.png",
        "result.json",
        "side.png",
        "top.png",
        "volume.npz",
    ]
    report = json.loads(Path("seen/result.json").read_text())
    # the voxel's half sides off
    assert report["figures"]["brightest_voxel"] == pytest.approx([0.25, -0.25, 0.8], abs=0.126)
    assert report["capture_run"] == capture.details["run"]
    assert report["wl_mean"] == 0.5
    assert err.count("nlosoptics: ") == len(report["notes"])
    with np.load("seen/volume.npz") as kept:
        assert kept["intensity"].shape == (5, 8, 8)
        assert kept["z"] == pytest.approx([0.6, 0.7, 0.8, 0.9, 1.0])
        assert np.abs(kept["field"]) ** 2 == pytest.approx(kept["intensity"], rel=1e-6)


@pytest.mark.thorough
def test_counts_of_a_detector(run):
    given = ("--photons", 5000, "--jitter-ps", 50, "--dark-counts", 0.1, "--seed", 7)
    assert run("transient", "dot.toml", "--out", "a.hdf5", *given)[0] == 0
    assert run("transient", "dot.toml", "--out", "b.hdf5", *given)[0] == 0
    first, second = (TransientCapture.load(f"{name}.hdf5") for name in "ab")
    assert np.array_equal(first.H, second.H)
    assert first.quantity == "counts"
    expected = 5000 + 0.1 * first.H.size
    assert first.H.sum() == pytest.approx(expected, abs=5 * expected**0.5)
    assert first.details["detector"]["jitter"] == pytest.approx(50e-12 * 299792458)


def test_options_stand_for_what_a_capture_lacks(run):
    run("transient", "dot.toml", "--out", "x.hdf5")
    with h5py.File("x.hdf5", "a") as file:
        del file["scene_info"], file["delta_t"]
        file["delta_t"] = 0.02 / 299792458
    for command in (("image",), ("capture", "check")):
        code, out, err = run(*command, "x.hdf5")
        assert (code, out) == (2, "")
        assert "if it is in seconds, give --bin = 0.02" in err
    planes = ("--near", 0.6, "--far", "1 m", "--step", "10cm")
    code, _, _ = run("image", "x.hdf5", "--bin", "2cm", "--wl-mean", 0.5, *planes)
    assert code == 0
    assert Path("x/front.png").is_file()


@pytest.mark.parametrize(
    ("method", "laser"),
    [
        ("phasor", None),
        ("lct", None),
        ("lct", (0.1, 0.1, 0.0)),
        ("inverse", None),
        *(pytest.param(m, None, marks=pytest.mark.thorough) for m in ("fk", "backprojection")),
    ],
)
def test_any_array_is_read_and_shown_without_hints(run, method, laser):
    """Rows run downward in it, time comes last; the object is where it was put."""
    wall = wall_grid(1.0, 16)
    path = 2.0 * np.linalg.norm(wall - (0.2, -0.1, 0.6), axis=-1)
    if laser is not None:
        path = 0.5 * path + np.linalg.norm(np.subtract(laser, (0.2, -0.1, 0.6)))
    counts = 60.0 * (np.arange(40)[:, None, None] == (path - 0.8) // 0.06)
    counts += np.random.default_rng(1).poisson(0.5, counts.shape)
    np.save("scan.npy", counts[:, ::-1].transpose(1, 2, 0))
    layout = ["--array", "array", "--axes=-y,x,t", "--side", "1 m", "--t-start", "80 cm"]
    if laser is not None:
        layout += ["--pairing", "all", "--laser-points", ", ".join(map(str, laser))]
    code, _, err = run("image", "scan.npy", *layout, "--bin", "200.1 ps", "--method", method)
    assert code == 0, err
    report = json.loads(Path("scan/result.json").read_text())
    place = report["figures"]["brightest_voxel"]
    assert place == pytest.approx([0.2, -0.1, 0.6], abs=0.07)  # one pitch


def test_an_inverse_takes_its_planes_from_the_photons(run):
    run("transient", "dot.toml", "--out", "x.hdf5")
    code, _, err = run("image", "x.hdf5", "--method", "inverse", "--near", "0.6")
    assert (code, "is not for --method inverse; leave it out" in err) == (2, True)


def test_a_check_says_what_a_file_holds(run):
    wall = wall_grid(1.0, 16)
    path = np.linalg.norm(wall - (0.2, -0.1, 0.6), axis=-1) + 0.65
    counts = 60.0 * (np.arange(40)[:, None, None] == (path - 0.8) // 0.06) + 1.0
    np.savez("scan.npz", counts=counts)
    given = ["--array", "counts", "--side", 1, "--bin", "6cm", "--t-start", "80 cm"]
    code, out, _ = run("capture", "check", "scan.npz", *given)
    assert code == 0
    assert "16 x 16 laser, 16 x 16 sensor, confocal" in out
    assert "40 of 60 mm, 0.8 to 3.2 m" in out
    assert "1 in each bin and pair" in out
    assert "phasor, backprojection, fk, lct, inverse\n" in out
    given += ["--laser-points", "0, 0, 0"]
    code, out, _ = run("capture", "check", "scan.npz", *given)
    assert (code, "fk, lct (after normal moveout)" in out) == (0, True)
    code, out, _ = run("capture", "check", "scan.npz", *given, "--outer-legs")
    assert (code, "--laser-origin and --sensor-origin not given" in out) == (0, True)
    code, _, err = run("image", "scan.npz", *given, "--outer-legs", "--sensor-origin", "0, 1, 1")
    assert (code, "give --laser-origin and --sensor-origin, or" in err) == (2, True)
    # of 1001 m, whatever the point on the wall
    given += ["--laser-origin", "0, 0, 1", "--sensor-origin", "0, 0, 1000", "--t-start", 1001.8]
    code, out, _ = run("capture", "check", "scan.npz", *given, "--outer-legs")
    assert (code, "fk, lct (after normal moveout)" in out) == (0, True)
    np.savez("scan.npz", counts=np.ones((40, 8, 8)))
    code, out, _ = run("capture", "check", "scan.npz", *given)
    assert (code, "has no light of 5 standard deviations" in out) == (0, True)


def test_an_empty_room_is_told(run):
    counts = np.random.default_rng(2).poisson(2.0, (40, 8, 8))
    np.savez("dark.npz", counts=counts)
    code, out, _ = run("image", "dark.npz", "--array", "counts", "--side", 1, "--bin", "0.06m")
    assert code == 0
    assert "no object above the noise" in out
    assert not Path("dark/volume.npz").exists()
    for words, named in (
        (("--array", "Q"), "holds no Q; give one of counts"),
        (("--array", "counts", "--axes", "x,y"), "must name t, y and x once each"),
        (("--array", "counts"), "m, or side"),
    ):
        code, _, err = run("image", "dark.npz", *words)
        assert (code, err.count("\n")) == (2, 1)
        assert named in err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("transient", "none.toml"), "none.toml"),
        (("transient", "dot.toml", "--out", "no/x.hdf5"), "no folder"),
        (("transient", "dot.toml", "--jitter-ps", 50), "--photons"),
        (("transient", "dot.toml", "--quantity", "lumen"), "lumen"),
        (("image", "none.hdf5"), "none.hdf5: the capture file is missing"),
        (("image", "dot.toml"), "neither HDF5 nor a MATLAB or numpy file"),
        (("image", "dot.hdf5", "--out", "dot.toml"), "is a file"),
        (("image", "dot.hdf5", "--laser-points", "a, b"), "--laser-points"),
        (("image", "dot.hdf5", "--bin", "3 kg"), "neither a length nor a time"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run, words, named):
    before = sorted(Path().iterdir())
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert named in err
    assert err.count("\n") == 1
    assert sorted(Path().iterdir()) == before
