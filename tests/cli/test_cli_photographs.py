"""Photographs on the command line: `deblur`, and the reading options of `reconstruct`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import signal

from nlosoptics.cli import main


@pytest.fixture
def photo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Light of a sharp view, whose blurred photograph lies on its side in photo.jpg."""
    monkeypatch.chdir(tmp_path)
    rng, picture = np.random.default_rng(3), np.full((80, 96, 3), 0.3)
    for _ in range(25):
        row, column, height, width = rng.integers(0, (80, 96, 30, 30))
        picture[row : row + height + 4, column : column + width + 4] = rng.uniform(0.05, 0.9, 3)
    y, x = np.indices((7, 7)) - 3
    disc = (np.hypot(y, x) <= 3.0).astype(float)
    disc /= disc.sum()
    np.save("disc.npy", disc)
    light = np.stack([signal.fftconvolve(picture[..., k], disc, "same") for k in range(3)], -1)
    light = np.clip(light + rng.normal(0.0, 0.005, light.shape), 0.0, 1.0)
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    entry = Image.Exif()
    entry[0x112] = 6
    stored = np.rot90(np.rint(255 * code).astype(np.uint8))
    Image.fromarray(stored).save("photo.jpg", exif=entry, quality=98, subsampling=0)
    return picture


def run(capsys, *words: object) -> tuple[int, str, str]:
    """Exit code, and the text on stdout and stderr."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


def test_a_photograph_of_a_phone_is_sharpened_by_one_command(photo, capsys) -> None:
    words = ("deblur", "photo.jpg", "--psf", "disc.npy", "--gamma", "srgb", "--crop", "8,8,80,64")
    code, out, err = run(capsys, *words, "--json", "--out", "sharp")
    assert code == 0
    assert err.count("\n") == 1
    assert "JPEG artefacts and 8 bits" in err
    report = json.loads(out)
    assert set(report["files"]) == {path.name for path in Path("sharp").iterdir()}
    assert {"object.png", "object.npz", "overview.png"} <= set(report["files"])
    assert report["figures"]["image_shape"] == [64, 80, 3]
    truth = photo[8:72, 8:88]
    with np.load("sharp/object.npz") as saved:
        before, after = (
            np.corrcoef(saved[name].ravel(), truth.ravel())[0, 1] for name in ("image", "object")
        )
    assert after > 0.96 > before
    with Image.open("sharp/object.png") as picture:
        assert (picture.size, picture.mode) == ((80, 64), "RGB")
    Path("photo").mkdir()  # of a reconstruction of the same photograph
    strict = run(capsys, *words, "--strict", "--channel", "green")
    assert not [*Path("photo").iterdir()]
    status = json.loads(Path("photo_deblurred/result.json").read_text())["figures"][
        "reconstruction_status"
    ]
    assert strict[0] == (3 if status == "does_not_fit" else 0)
    assert ["sharpened", "photograph", status] in [line.split() for line in strict[1].splitlines()]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("photo.jpg",), "one of --psf, --disc and --gaussian"),
        (("photo.jpg", "--disc", "2", "--gaussian", "1"), "one of --psf"),
        (("photo.jpg", "--disc", "0"), "--disc = 0 pixels is out of range"),
        (("photo.jpg", "--disc", "60"), "crop the point spread"),
        (("photo.jpg", "--disc", "2", "--crop", "1,2,3"), "give x, y, width, height"),
        (("photo.jpg", "--disc", "2", "--crop", "a"), "--crop"),
        (("photo.jpg", "--disc", "2", "--gamma", "2.2"), "must be one of linear, srgb"),
        (("photo.jpg", "--psf", "nowhere.png"), "no file nowhere.png"),
    ],
)
def test_bad_words_are_refused_in_one_line(photo, words, named, capsys) -> None:
    before = sorted(Path().iterdir())
    code, out, err = run(capsys, "deblur", *words, "--gamma", "srgb", *words[1:], "--out", "sharp")
    assert (code, out) == (2, "")
    assert named in err.splitlines()[-1]
    assert sorted(Path().iterdir()) == before


def test_a_marked_area_becomes_the_scenes_image(photo, examples, capsys) -> None:
    """An image that was photographed from a screen at an angle gives the same object again."""
    scene = ("--scene", examples / "scenes" / "letter_flat.toml", "--size", 32, "--tol", 1e-2)
    y, x = np.indices((32, 32))
    straight = 50.0 + 9.0 * (np.hypot(y - 12, x - 18) < 6)
    straight += np.random.default_rng(1).normal(0.0, 0.2, straight.shape)
    np.save("straight.npy", straight)
    np.save("turned.npy", np.pad(np.rot90(np.kron(straight, np.ones((4, 4)))), ((3, 0), (5, 0))))
    assert run(capsys, "reconstruct", "straight.npy", *scene)[0] == 0
    more = ("--rotate", -90, "--corners", "0,5 128,5 128,133 0,133")
    code, _, err = run(capsys, "reconstruct", "turned.npy", *scene, *more)
    assert (code, err) == (0, "")
    straight, turned = (np.load(f"{name}/object.npy") for name in ("straight", "turned"))
    assert np.corrcoef(straight.ravel(), turned.ravel())[0, 1] > 0.99
    code, _, err = run(capsys, "reconstruct", "turned.npy", *scene, "--corners", "0,5 128,5")
    assert (code, "give four positions" in err) == (2, True)
