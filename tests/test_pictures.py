"""Picture files: a few bytes may claim very many pixels."""

import struct
import zlib
from pathlib import Path

import pytest

from nlosoptics import imaging
from nlosoptics.errors import SceneError
from nlosoptics.scene import PlanarObject


def png_of(width: int, height: int) -> bytes:
    """Black PNG of one bit a pixel, whose size grows by a byte per 8000 pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    rows = zlib.compress(bytes((1 + (width + 7) // 8) * height), 9)
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", rows), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


#: Above this package's limit, that of Pillow's warning (89 Mpx) and that of its error (179 Mpx).
SIZES = {(8193, 8192): "8193 x 8192", (12_000, 12_000): "12000 x 12000", (16_000, 16_000): "too"}


@pytest.mark.parametrize("size", SIZES)
def test_pictures_of_too_many_pixels_are_not_decoded(size: tuple[int, int], tmp_path: Path) -> None:
    file = tmp_path / "large.png"
    file.write_bytes(png_of(*size))
    assert file.stat().st_size < 100_000
    line = rf"large.png has {SIZES[size]}.* pixels, limit 67108864 in all; scale it down, or"
    with pytest.raises(SceneError, match=f"hidden.image: .*{line}"):
        _ = PlanarObject(file, size=0.1, position=(0.0, 0.0, 1.0)).reflectance
    with pytest.raises(SceneError, match=line):
        imaging.camera_image(file)


def test_the_largest_picture_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nlosoptics._pictures.MOST_PIXELS", 40 * 32)
    file = tmp_path / "p.png"
    file.write_bytes(png_of(40, 32))
    picture = PlanarObject(file, size=0.1, position=(0.0, 0.0, 1.0))
    assert picture.reflectance.shape == (32, 40)
