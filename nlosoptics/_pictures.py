"""Opening picture files, with a limit on their number of pixels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

from .errors import SceneError

if TYPE_CHECKING:
    from PIL.Image import Image

#: Largest number of pixels of a compressed picture. A file of less than a megabyte can hold a
#: hundred times as many, which would fill the memory when they are decoded.
MOST_PIXELS = 8192 * 8192


@contextmanager
def opened_picture(file: Path | IO[bytes], name: str) -> Iterator[Image]:
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
