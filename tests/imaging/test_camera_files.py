"""Pictures of a camera: files, dark frame, flat field, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pytest import approx

from nlosoptics.errors import NlosError, SamplingError, SceneError
from nlosoptics.imaging import camera_image
from nlosoptics.imaging.camera_files import read_camera_file

RNG = np.random.default_rng(4)
COUNTS = RNG.integers(20, 200, (12, 16))


def saved(path: Path, values: np.ndarray) -> Path:
    """A picture file of that type."""
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        Image.fromarray(values).save(path)
    return path


@pytest.mark.parametrize(
    ("name", "dtype", "scale", "full"),
    [
        ("a.png", np.uint8, 1, 255.0),
        ("a.png", np.uint16, 300, 65535.0),
        ("a.tif", np.uint8, 1, 255.0),
        ("a.tif", np.uint16, 300, 65535.0),
        ("a.tif", np.float32, 1, None),
        ("a.npy", np.uint16, 300, 65535.0),
        ("a.npy", np.float64, 1, None),
    ],
)
def test_counts_are_those_of_the_file(
    tmp_path: Path, name: str, dtype: type, scale: int, full: float | None
) -> None:
    path = saved(tmp_path / name, (COUNTS * scale).astype(dtype))
    counts, largest = read_camera_file(path)
    assert np.array_equal(counts, COUNTS * scale)
    assert counts.dtype == np.float64
    assert largest == full


def test_dark_and_flat_are_undone(tmp_path: Path) -> None:
    """(scene * response + dark) comes back as the scene times the mean response."""
    scene = RNG.uniform(1e3, 1e4, (12, 16))
    response = RNG.uniform(0.5, 1.5, (12, 16))
    dark = RNG.uniform(50, 60, (12, 16))
    image = saved(tmp_path / "i.npy", scene * response + dark)
    found = camera_image(
        image,
        dark=saved(tmp_path / "d.npy", dark),
        flat=saved(tmp_path / "f.npy", 7.0 * response + dark),
    )
    # rounding of some differences and quotients
    assert found.values == approx(scene * response.mean(), rel=1e-12)
    assert not found.masked.any()
    assert not found.values.flags.writeable
    assert not found.masked.flags.writeable


def test_full_and_dead_pixels_do_not_count(tmp_path: Path) -> None:
    values = COUNTS.astype(np.uint8)
    values[2, 3], values[5, 5] = 255, 250
    flat = np.full(values.shape, 100.0)
    flat[7, 8] = 1.0
    image = saved(tmp_path / "i.png", values)
    found = camera_image(image, flat=saved(tmp_path / "f.npy", flat))
    assert set(zip(*np.nonzero(found.masked), strict=True)) == {(2, 3), (7, 8)}
    assert found.saturated_fraction == 1 / values.size
    # a converter of fewer bits than its file
    assert camera_image(image, full=250).masked.sum() == 2


def test_whole_frames_are_summed_to_image_pixels(tmp_path: Path) -> None:
    """Sums over square groups; a full pixel spoils its group."""
    values = COUNTS.astype(np.uint8)
    values[0, 15] = 255
    found = camera_image(saved(tmp_path / "i.png", values), shape=(3, 4))
    sums = values.astype(float).reshape(3, 4, 4, 4).sum(axis=(1, 3))
    assert np.array_equal(found.masked, [[False] * 3 + [True], [False] * 4, [False] * 4])
    assert np.array_equal(found.values[~found.masked], sums[~found.masked])
    assert np.array_equal(found.values, sums)  # also of saturated pixels, as lower limits


FULL = np.full((12, 16), 65535, np.uint16)
FULL[:5] = 9
HALF = np.where(np.arange(16) < 8, 1.0, 100.0) * np.ones((12, 1))
SPOILT = np.where(np.arange(192).reshape(12, 16) % 16 == 8, 65535, COUNTS).astype(np.uint16)
BAD = {
    "dead and full": (
        SPOILT,
        {"flat": HALF},
        ["56.2 % of the pixels are saturated, or dead", "limit 50 %", "another flat field"],
    ),
    "even": (HALF * 3.0, {"flat": HALF}, ["reads 151.5 in every good pixel", "check the file"]),
    "constant": (np.full((12, 16), 7.0), {}, ["reads 7 in every pixel"]),
    "black": (np.zeros((12, 16)), {}, ["reads 0 in every pixel"]),
    "NaN": (np.where(COUNTS > 190, np.nan, COUNTS), {}, ["not finite"]),
    "full": (FULL, {}, ["58.3 % of the pixels are saturated", "limit 50 %"]),
    "stack": (np.zeros((2, 12, 16)), {}, ["(2, 12, 16)", "one (ny, nx) image"]),
    "complex": (COUNTS * 1j, {}, ["complex128"]),
    "no photons": (
        COUNTS * 1.0,
        {"dark": COUNTS + 5.0},
        ["not brighter than the dark", "expose longer"],
    ),
    "below zero": (COUNTS - 500.0, {}, ["no pixel above 0", "expose longer"]),
    "dark of another size": (COUNTS * 1.0, {"dark": COUNTS[:6] * 1.0}, ["16 x 6", "16 x 12"]),
    "flat without light": (COUNTS * 1.0, {"flat": COUNTS * 0.0}, ["flat field has no light"]),
    "another size": (COUNTS * 1.0, {"shape": (64, 64)}, ["16 x 12 pixels", "64 x 64"]),
    "another aspect": (COUNTS * 1.0, {"shape": (6, 4)}, ["16 x 12 pixels", "4 x 6"]),
    "bad limit": (COUNTS * 1.0, {"full": 0.0}, ["full = 0"]),
    "limit beyond the type": (
        COUNTS.astype(np.uint8),
        {"full": 4095.0},
        ["full = 4095 counts", "up to 255", "give the count"],
    ),
    "no rows": (COUNTS * 1.0, {"shape": (0, 4)}, ["shape[0] = 0"]),
    "three sides": (COUNTS * 1.0, {"shape": (6, 8, 1)}, ["3 counts", "(rows, columns)"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_pictures_are_refused_in_one_line(case: str, tmp_path: Path) -> None:
    values, options, named = BAD[case]
    options = {
        key: saved(tmp_path / f"{key}.npy", value) if isinstance(value, np.ndarray) else value
        for key, value in options.items()
    }
    with pytest.raises(NlosError) as refused:
        camera_image(saved(tmp_path / "i.npy", values), **options)
    text = str(refused.value)
    assert "\n" not in text
    for word in named:
        assert word in text


def test_files_that_are_no_grey_picture(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no file"):
        camera_image(tmp_path / "nowhere.png")
    (tmp_path / "t.png").write_text("no picture")
    with pytest.raises(SceneError, match="not an image"):
        camera_image(tmp_path / "t.png")
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "c.png")
    with pytest.raises(SceneError, match="in colour"):
        camera_image(tmp_path / "c.png")
    pages = [Image.fromarray(COUNTS.astype(np.uint8)) for _ in range(2)]
    pages[0].save(tmp_path / "p.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(SceneError, match="2 images"):
        camera_image(tmp_path / "p.tif")
    with pytest.raises(SceneError, match="no image is given"):
        camera_image([])
    saved(tmp_path / "a.npy", COUNTS)
    saved(tmp_path / "b.npy", COUNTS[:, :8])
    with pytest.raises(SamplingError, match="8 x 12"):
        camera_image([tmp_path / "a.npy", tmp_path / "b.npy"])
