"""Pictures of a camera: files, dark frame, flat field, and what is refused in one line."""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pytest import approx
from scipy import ndimage

from nlosoptics.errors import (
    MissingExtraError,
    NlosError,
    SamplingError,
    SceneError,
    ValidityWarning,
)
from nlosoptics.imaging import camera_image
from nlosoptics.imaging.camera_files import read_camera_file

RNG = np.random.default_rng(4)
COUNTS = RNG.integers(20, 200, (12, 16))
COLOURS = RNG.integers(20, 200, (12, 16, 3))


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
    counts, stored, largest = read_camera_file(path)
    assert np.array_equal(counts, COUNTS * scale)
    assert np.array_equal(stored, counts)
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
    "stack": (np.zeros((2, 12, 16)), {}, ["(2, 12, 16)", "one (ny, nx) image", "in colour"]),
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
    "crop outside": (COUNTS * 1.0, {"crop": (4, 0, 13, 3)}, ["column 17", "16 x 12 pixels"]),
    "crop of three": (COUNTS * 1.0, {"crop": (4, 0, 13)}, ["give x, y, width, height"]),
    "crossed corners": (
        COUNTS * 1.0,
        {"shape": (4, 4), "corners": [(0, 0), (9, 9), (9, 0), (0, 9)]},
        ["do not go around", "top left"],
    ),
    "corners alone": (COUNTS * 1.0, {"corners": [(0, 0)] * 4}, ["without shape"]),
    "curve of floats": (COUNTS * 1.0, {"gamma": "srgb"}, ["float64", "use linear"]),
    "no such channel": (COUNTS * 1.0, {"channel": "infrared"}, ["infrared", "grey"]),
    "no angle": (COUNTS * 1.0, {"rotate": np.nan}, ["rotate = nan"]),
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


def test_files_that_are_no_grey_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match="no file"):
        camera_image(tmp_path / "nowhere.png")
    (tmp_path / "t.png").write_text("no picture")
    with pytest.raises(SceneError, match="cannot identify image file"):
        camera_image(tmp_path / "t.png")
    Image.fromarray(np.eye(64, dtype=np.uint8)).save(tmp_path / "whole.png")
    (tmp_path / "half.png").write_bytes((tmp_path / "whole.png").read_bytes()[:70])
    with pytest.raises(SceneError, match=r"half.png is no readable image \(.*trunc.*\); give PNG"):
        camera_image(tmp_path / "half.png")
    Image.fromarray(COLOURS.astype(np.uint8)).save(tmp_path / "c.png")
    with pytest.raises(SceneError, match="in colour; give channel = 'red'"):
        camera_image(tmp_path / "c.png")
    holes = np.dstack([COLOURS, np.full((12, 16), 255)]).astype(np.uint8)
    holes[0, 0, 3] = 9
    Image.fromarray(holes).save(tmp_path / "h.png")
    with pytest.raises(SceneError, match="transparent in places"):
        camera_image(tmp_path / "h.png", channel="red")
    (tmp_path / "r.nef").write_bytes(b"raw")
    monkeypatch.setitem(sys.modules, "rawpy", None)  # as if it was not installed
    with pytest.raises(MissingExtraError, match=r"r.nef is a raw file.*nlosoptics\[photo\]"):
        camera_image(tmp_path / "r.nef")
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


def png16(values: np.ndarray) -> bytes:
    """PNG of 16-bit colours; Pillow writes none. Each row has the next of three filters."""
    rows = values.astype(">u2").view(np.uint8).reshape(len(values), -1)
    left = np.pad(rows, ((0, 0), (6, 0)))[:, :-6]
    above = np.pad(rows, ((1, 0), (0, 0)))[:-1]
    filtered = [[rows, rows - left, rows - above][i % 3][i] for i in range(len(rows))]
    data = b"".join(bytes([i % 3]) + row.tobytes() for i, row in enumerate(filtered))
    head = struct.pack(">IIBBBBB", values.shape[1], len(values), 16, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in chunks
    )


def test_colours_of_16_bits_are_whole(tmp_path: Path) -> None:
    """Pillow alone would give their upper bytes."""
    values = RNG.integers(0, 65535, (12, 16, 3)).astype(np.uint16)
    (tmp_path / "a.png").write_bytes(png16(values))
    tifffile = pytest.importorskip("tifffile")
    for name, options in (
        ("l.tif", {}),
        ("b.tif", {"byteorder": ">"}),
        ("z.tif", {"compression": "zlib"}),
    ):
        tifffile.imwrite(tmp_path / name, values, photometric="rgb", **options)
    for name in ("a.png", "l.tif", "b.tif", "z.tif"):
        assert np.array_equal(camera_image(tmp_path / name, channel="rgb").values, values)
    found = camera_image(tmp_path / "a.png", channel="green", dark=values[..., 1] // 2)
    assert np.array_equal(found.values, values[..., 1] - values[..., 1] // 2)
    mean = camera_image(values, channel="grey").values
    assert mean == approx(values.mean(axis=2), rel=1e-12)


def test_a_jpeg_is_turned_made_linear_and_warned_of(tmp_path: Path) -> None:
    light = np.linspace(0.05, 0.9, 64)[:, None] * np.linspace(0.5, 1.0, 48)
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    entry = Image.Exif()
    entry[0x112] = 6  # to be turned clockwise
    stored = Image.fromarray(np.rint(255 * code).astype(np.uint8))
    stored.save(tmp_path / "a.jpg", exif=entry, quality=95)
    with pytest.warns(ValidityWarning, match="JPEG artefacts and 8 bits"):
        found = camera_image(tmp_path / "a.jpg", gamma="srgb")
    assert found.values / 255 == approx(np.rot90(light, -1), abs=0.01)
    with pytest.warns(ValidityWarning, match="give gamma = 'srgb'"):
        camera_image(tmp_path / "a.jpg")


def test_turning_and_cutting_out() -> None:
    found = camera_image(COUNTS, rotate=90, crop=(2, 3, 5, 4))
    assert np.array_equal(found.values, np.rot90(COUNTS)[3:7, 2:7])
    y, x = np.indices((40, 50)) - np.array([19.5, 24.5])[:, None, None]
    slope = 100.0 + 0.3 * x + y  # linear, so that interpolation is exact
    cos, sin = np.cos(np.radians(10)), np.sin(np.radians(10))
    found = camera_image(slope, rotate=10.0)
    turned = 100.0 + 0.3 * (cos * x - sin * y) + sin * x + cos * y
    inside = ndimage.binary_erosion(~found.masked)  # half a pixel at the edge is continued
    assert 0.7 < inside.mean() < 1.0
    assert found.values[inside] == approx(turned[inside], rel=1e-12)


def test_an_area_in_perspective_becomes_the_image() -> None:
    """Cells of a board come back from a photograph at an angle, each by its mean."""
    board = np.random.default_rng(1).uniform(20, 200, (4, 6))
    corners = np.array([(20.0, 15.0), (220.0, 40.0), (200.0, 190.0), (35.0, 150.0)])
    # the homography of those corners, by an independent solver
    ends = np.array([(0, 0), (6, 0), (6, 4), (0, 4)])
    rows = []
    for (u, v), (a, b) in zip(corners, ends, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -a * u, -a * v, -a], [0, 0, 0, u, v, 1, -b * u, -b * v, -b]]
    back = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    v, u = np.indices((210, 240)) + 0.5
    a, b, w = np.einsum("ij,jyx->iyx", back, np.stack([u, v, np.ones_like(u)]))
    at = np.clip(np.stack([b / w, a / w]), 0.0, np.array([3.99, 5.99])[:, None, None]).astype(int)
    photograph = board[at[0], at[1]]
    found = camera_image(photograph, shape=(4, 6), corners=corners)
    assert not found.masked.any()
    # the pixels at the cells' edges are shared
    assert found.values == approx(board, abs=0.04 * np.ptp(board))
    one = camera_image(COUNTS * 1.0, shape=(12, 16), corners=[(0, 0), (16, 0), (16, 12), (0, 12)])
    assert one.values == approx(COUNTS, rel=1e-9)
