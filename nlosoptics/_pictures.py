"""Opening picture files: a limit on their number of pixels, one upright frame without holes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import SceneError

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFile import ImageFile

#: Largest number of pixels of a compressed picture. A file of less than a megabyte can hold a
#: hundred times as many, which would fill the memory when they are decoded.
MOST_PIXELS = 8192 * 8192


@contextmanager
def opened_picture(file: Path | IO[bytes], name: str) -> Iterator[ImageFile]:
    """Yield Pillow's picture of a file, whose pixels are decoded at the first access.

    ``name`` stands for the picture in the `SceneError` that refuses more than `MOST_PIXELS` pixels.
    """
    from PIL import Image

    size = "too many"
    with warnings.catch_warnings():
        # Pillow's own limits are larger, and the lower one only warns
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            picture = Image.open(file)
        except Image.DecompressionBombError:
            picture = None
    if picture is not None:
        with picture:
            if picture.width * picture.height <= MOST_PIXELS:
                yield picture
                return
            size = f"{picture.width} x {picture.height}"
    raise SceneError(
        f"{name} has {size} pixels, limit {MOST_PIXELS} in all; scale it down, or save it as .npy"
    )


def upright_picture(picture: Image, name: str) -> Image:
    """Return Pillow's picture turned as its EXIF entry says.

    Several frames and transparent pixels are refused by a `SceneError`.
    """
    from PIL import ImageOps

    frames = getattr(picture, "n_frames", 1)
    if frames > 1 and picture.format != "MPO":  # a phone's photograph and its preview
        raise SceneError(f"{name} holds {frames} images, must be one; save one per file")
    if picture.has_transparency_data:
        least = picture.convert("RGBA").getchannel("A").getextrema()[0]
        if least != 255:
            raise SceneError(
                f"{name} is transparent in places (opacity from {least} of 255); "
                "save it on an opaque background"
            )
    return ImageOps.exif_transpose(picture)


def picture_values(file: Path, name: str) -> tuple[NDArray[Any], bool]:
    """Return the values of a picture file, (ny, nx) or (ny, nx, 3), and whether it is a JPEG."""
    from PIL.TiffImagePlugin import TiffImageFile

    with opened_picture(file, name) as picture:
        args: list[Any] = [tile.args for tile in picture.tile]
        raw = [mode if isinstance(mode, str) else mode[0] for mode in args]
        kind, _, depth = raw[0].partition(";") if raw else ("", "", "")
        jpeg = picture.format in ("JPEG", "MPO")
        bits = max(picture.tag_v2.get(258, (8,))) if isinstance(picture, TiffImageFile) else 8
        upright = upright_picture(picture, name)
        if picture.mode in ("1", "L", "I", "F") or picture.mode.startswith("I;16"):
            # 16-bit PNGs open as 32-bit integers in some versions of Pillow
            png = picture.mode == "I" and picture.format == "PNG"
            return np.asarray(upright, dtype=np.uint16 if png else None), jpeg
        if bits <= 8 and not depth.startswith("16"):
            return np.asarray(upright.convert("RGB")), jpeg
    if kind not in ("RGB", "RGBA") or depth not in ("16B", "16L", "16N"):
        raise SceneError(
            f"{name} has 16-bit values of type {';'.join(raw[:1])}; save it as grey or RGB"
        )
    # Pillow keeps one byte of each 16-bit value in colour: read once each, and put them together
    halves: list[NDArray[np.uint16]] = []
    for order in "BL" if depth == "16B" else "LB":
        with opened_picture(file, name) as picture:
            mode = f"{kind};16{order}"
            args = [tile.args for tile in picture.tile]
            args = [mode if isinstance(old, str) else (mode, *old[1:]) for old in args]
            picture.tile = [
                tile._replace(args=new) for tile, new in zip(picture.tile, args, strict=True)
            ]
            halves.append(np.asarray(upright_picture(picture, name))[..., :3].astype(np.uint16))
    high, low = halves
    return high << 8 | low, jpeg
