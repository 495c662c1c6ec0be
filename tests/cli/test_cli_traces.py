"""The command trace: from a scene file to a traced image in a folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nlosoptics import Scene, cli
from nlosoptics.raytrace import trace_image

SCENES = Path(__file__).parents[2] / "examples" / "scenes"
ROOM = SCENES / "corner_room.toml"
BINS = ("--t-start", 2, "--delta-t", 0.1, "--n-bins", 30)


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Call the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            cli.main([str(word) for word in words])
        told = capsys.readouterr()
        return int(ended.value.code or 0), told.out, told.err

    return call


def test_room_is_traced_into_a_folder(run):
    """The same bits as in Python, and a record that holds the power balance."""
    words = ("trace", ROOM, "--n-rays", 3000, "--seed", 3, "--size", 32, "--max-bounces", 4, *BINS)
    code, out, err = run(*words)
    assert (code, err) == (0, "")
    assert "32 x 32 pixels" in out
    scene = Scene.load(ROOM).resized(32)
    bins = {"t_start": 2.0, "delta_t": 0.1, "n_bins": 30}
    image = trace_image(scene, n_rays=3000, seed=3, max_bounces=4, **bins)
    with np.load("corner_room_trace/image.npz") as held:
        for name in ("expected", "expected_error", "by_bounce", "stray_error"):
            assert np.array_equal(held[name], getattr(image, name))
        assert np.array_equal(held["histogram_power"], image.histogram.power)
    record = json.loads(Path("corner_room_trace/result.json").read_text())
    assert record["figures"]["power"]["flux"]["watts"] == image.paths.flux
    assert sum(v["watts"] for v in record["figures"]["ledger"].values()) == pytest.approx(
        scene.laser.power, rel=0.1
    )
    assert {p.name for p in Path("corner_room_trace").iterdir()} == set(record["files"])
    assert record["scene_sha256"]
    assert record["seed"] == 3
    # an earlier result is replaced, and one ray has no standard error
    code, _, _ = run("trace", ROOM, "--n-rays", 1, "--size", 16)
    assert code == 0
    record = json.loads(Path("corner_room_trace/result.json").read_text())
    assert record["figures"]["power"]["flux"]["standard_error"] is None
    code, _, err = run("report", "corner_room_trace")
    assert code == 2
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--delta-t", 0.1), "t_start and n_bins missing for the histogram"),
        (("--n-rays", 0), "n_rays = 0"),
        (("--tol", 2), "tol = 2"),
        (("--max-bounces", 100), "max_bounces = 100"),
        (("--out", ROOM), "is a file; name a folder"),
        (("--set", "occluder[1].material.albedo=1.2"), "occluder[1].material.albedo"),
    ],
)
def test_bad_options_are_one_line(run, words, message):
    code, out, err = run("trace", ROOM, *words)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not list(Path().iterdir())


@pytest.mark.thorough
def test_light_left_to_chance_is_told(run):
    mirror = "occluder[1].material=polished aluminium"
    code, _, err = run("trace", ROOM, "--n-rays", 100, "--size", 16, "--set", mirror)
    assert code == 0
    assert "rays find by chance only light that mirror-like lobes of occluders" in err


@pytest.mark.thorough
def test_several_wavelengths_have_files_of_their_own(run, tmp_path):
    """The same bits as in Python, from a scene file whose albedo depends on the wavelength."""
    table = {"wavelengths": ["450 nm", "650 nm"], "values": [0.1, 0.6]}
    changes = {"hidden.material": {"lobe": "lambert", "albedo": table}}
    scene = Scene.load(SCENES / "letter_flat.toml", changes)
    scene.save("poster.toml")
    words = ("trace", "poster.toml", "--wavelengths-nm", "450, 650", "--size", 16)
    code, _, err = run(*words, "--n-rays", 2000, "--max-bounces", 3)
    assert (code, err) == (0, "")
    options = {"wavelengths": (450e-9, 650e-9), "n_rays": 2000, "max_bounces": 3}
    colours = trace_image(scene.resized(16), **options).colours
    for name, image in zip(("450nm", "650nm"), colours, strict=True):
        with np.load(f"poster_trace/{name}_image.npz") as held:
            assert np.array_equal(held["expected"], image.expected)
    record = json.loads(Path("poster_trace/result.json").read_text())
    figures = record["figures_by_wavelength"]["650nm"]
    assert figures["power"]["flux"]["watts"] == colours[1].paths.flux
    assert "450nm_image.npz" in record["files"]
    code, _, err = run(*words[:3], "450, 700")
    assert code == 2
    assert "700 nm is unknown" in " ".join(err.split())
