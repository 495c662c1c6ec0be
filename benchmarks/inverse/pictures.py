"""Random pictures of 64 x 64 pixels for training: glyphs, pairs, strokes, shapes, dots, clouds.

    from pictures import pictures
    stack = pictures(200, seed=0)

The glyphs are those of the fonts that matplotlib ships, without the capital F and without arrows,
which tests use. Nothing is drawn from examples/objects.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy import ndimage

SIDE = 64
_FINE = 4  # samples per pixel
_SYMBOLS = "0123456789&?!@#%+=*$"
_FONTS = (
    "DejaVuSans.ttf",
    "DejaVuSans-Bold.ttf",
    "DejaVuSans-BoldOblique.ttf",
    "DejaVuSerif.ttf",
    "DejaVuSerif-Bold.ttf",
    "DejaVuSansMono-Bold.ttf",
    "STIXGeneralBol.ttf",
    "STIXGeneral.ttf",
)


def pictures(count: int, seed: int) -> np.ndarray:
    """Pictures (count, SIDE, SIDE), 0 to 1; a larger count extends those of a smaller one."""
    found = np.empty((count, SIDE, SIDE), dtype=np.float32)
    for number in range(count):
        _kind, fine = fine_picture(seed, number)
        cells = fine.reshape(SIDE, _FINE, SIDE, _FINE).mean(axis=(1, 3))
        found[number] = cells / max(float(cells.max()), 1e-6)
    return found


def fine_picture(seed: int, number: int) -> tuple[str, np.ndarray]:
    """Kind of one of the pictures, and the picture at _FINE samples per pixel."""
    kinds = (_glyph, _glyph, _glyph, _pair, _strokes, _strokes, _shapes, _dots, _cloud)
    draw = np.random.default_rng([seed, number])
    kind = kinds[draw.integers(len(kinds))]
    return kind.__name__[1:], kind(draw)


@cache
def _letters() -> str:
    """Letters of three alphabets, digits and symbols."""
    ranges = ((0x41, 0x5B), (0x61, 0x7B), (0x391, 0x3AA), (0x3B1, 0x3CA), (0x410, 0x450))
    letters = "".join(chr(code) for first, end in ranges for code in range(first, end))
    return letters.replace("F", "").replace("\u03a2", "") + _SYMBOLS


@cache
def _font(name: str, size: int):
    import matplotlib
    from PIL import ImageFont

    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / name), size)


def _written(text: str, height: float, draw: np.random.Generator) -> np.ndarray:
    """A text of given height relative to the frame, turned a little."""
    from PIL import Image, ImageDraw

    wide = SIDE * _FINE
    image = Image.new("L", (wide, wide))
    font = _font(str(draw.choice(_FONTS)), max(8, int(round(height * wide / 4.0) * 4)))
    ImageDraw.Draw(image).text((wide / 2, wide / 2), text, 255, font, anchor="mm")
    turned = image.rotate(float(draw.normal(0.0, 12.0)), Image.Resampling.BILINEAR)
    return np.asarray(turned, dtype=float) / 255.0


def _glyph(draw: np.random.Generator) -> np.ndarray:
    letters = _letters()
    return _written(letters[draw.integers(len(letters))], draw.uniform(0.35, 0.85), draw)


def _pair(draw: np.random.Generator) -> np.ndarray:
    letters = _letters()
    text = "".join(letters[draw.integers(len(letters))] for _ in range(draw.integers(2, 5)))
    if len(text) > 2 and draw.random() < 0.6:
        text = f"{text[:2]}\n{text[2:]}"
    return _written(text, draw.uniform(0.2, 0.4), draw)


def _axes(draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    axis = (np.arange(SIDE * _FINE) + 0.5) / (SIDE * _FINE) * 2.0 - 1.0
    return np.meshgrid(axis, axis)


def _segment(x, y, start, end, width):
    """One within a distance of a line between two points."""
    along = np.subtract(end, start)
    share = ((x - start[0]) * along[0] + (y - start[1]) * along[1]) / max(along @ along, 1e-9)
    share = share.clip(0.0, 1.0)
    return np.hypot(x - start[0] - share * along[0], y - start[1] - share * along[1]) < width


def _strokes(draw: np.random.Generator) -> np.ndarray:
    """Lines, upright ones more often than others, and arcs, of one width."""
    x, y = _axes(draw)
    picture = np.zeros_like(x)
    reach, width = draw.uniform(0.3, 0.65), draw.uniform(0.025, 0.09)
    upright = draw.random() < 0.5
    place = draw.uniform(-reach, reach, size=2)
    for _ in range(draw.integers(2, 9)):
        kind = draw.random()
        joined = draw.random() < 0.4
        start = place if joined else draw.uniform(-reach, reach, size=2)
        place = draw.uniform(-reach, reach, size=2)
        if kind < 0.2:
            radius = draw.uniform(0.15, 0.8) * reach
            angle = np.arctan2(y - start[1], x - start[0])
            first, extent = draw.uniform(-np.pi, np.pi), draw.uniform(1.0, 2.0 * np.pi)
            turned = np.mod(angle - first, 2.0 * np.pi) < extent
            ring = np.abs(np.hypot(x - start[0], y - start[1]) - radius) < width
            inside = ring & turned
        else:
            if upright:
                side = draw.integers(2)
                place[side] = start[side]
            inside = _segment(x, y, start, place, width)
        picture[inside] = 1.0
    return picture


def _shapes(draw: np.random.Generator) -> np.ndarray:
    """Bars, discs and rings, many of them grey."""
    x, y = _axes(draw)
    picture = np.zeros_like(x)
    for _ in range(draw.integers(1, 7)):
        centre, angle = draw.uniform(-0.45, 0.45, size=2), draw.uniform(0.0, np.pi)
        along = (x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)
        across = (y - centre[1]) * np.cos(angle) - (x - centre[0]) * np.sin(angle)
        half, width = draw.uniform(0.1, 0.4), draw.uniform(0.04, 0.25)
        kind = draw.integers(3)
        if kind == 0:
            inside = (np.abs(along) < half) & (np.abs(across) < width)
        elif kind == 1:
            inside = np.hypot(along / half, across / width) < 1.0
        else:
            inside = np.abs(np.hypot(along, across) - 0.7 * half) < 0.4 * width
        picture[inside] = draw.uniform(0.0, 1.0) if draw.random() < 0.5 else 1.0
    return picture


def _dots(draw: np.random.Generator) -> np.ndarray:
    """Discs of several sizes."""
    x, y = _axes(draw)
    picture = np.zeros_like(x)
    largest, reach = draw.uniform(0.04, 0.15), draw.uniform(0.3, 0.7)
    for _ in range(draw.integers(3, 25)):
        centre = draw.uniform(-reach, reach, size=2)
        inside = np.hypot(x - centre[0], y - centre[1]) < draw.uniform(0.03, largest)
        picture[inside] = draw.uniform(0.3, 1.0)
    return picture


def _cloud(draw: np.random.Generator) -> np.ndarray:
    """A patch of filtered noise, grey or black and white."""
    x, y = _axes(draw)
    across = np.fft.fftfreq(len(x))
    frequency = np.hypot(*np.meshgrid(across, across)) + 1.0 / len(x)
    noise = np.fft.fft2(draw.normal(size=x.shape)) * frequency ** -draw.uniform(1.2, 2.0)
    texture = np.fft.ifft2(noise).real
    texture = (texture - texture.min()) / np.ptp(texture)
    if draw.random() < 0.4:
        texture = (texture > np.quantile(texture, draw.uniform(0.4, 0.8))).astype(float)
    sides = draw.uniform(0.25, 0.75, size=2)
    if draw.random() < 0.5:
        inside = np.hypot(x / sides[0], y / sides[1]) < 1.0
    else:
        inside = (np.abs(x) < sides[0]) & (np.abs(y) < sides[1])
    return texture * ndimage.gaussian_filter(inside.astype(float), draw.uniform(0.0, 8.0))
