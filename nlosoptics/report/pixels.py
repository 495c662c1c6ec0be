"""Greyscale pictures of arrays, pixel by pixel, with a scale in text."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._html import Html, png, tag
from .elements import figure, number

MOST = 1024  # largest side of a drawn picture, pixels
COARSE = 256  # largest side of an array whose single pixels remain visible on the page


def pixels(
    values: NDArray[Any],
    title: str,
    *,
    unit: str,
    low: float,
    high: float,
    alt: str,
    told: str = "",
) -> Html:
    """Draw an array as a greyscale picture with its scale.

    Parameters
    ----------
    values : ndarray, (ny, nx)
        Values; row 0 is drawn on top.
    title : str
        Title, the first words of the caption.
    unit : str
        Unit of the values.
    low, high : float
        Values drawn black and white.
    alt : str
        Description of the picture for readers who cannot see it.
    told : str
        Further text of the caption.

    Returns
    -------
    Html
        Figure with caption.
    """
    from PIL import Image

    span = high - low if high > low else 1.0
    grey = np.rint(255.0 * np.clip((values - low) / span, 0.0, 1.0)).astype(np.uint8)
    drawn = Image.fromarray(grey)
    ny, nx = values.shape
    step = math.ceil(max(nx, ny) / MOST)
    size = f"{nx} × {ny} pixels"
    if step > 1:
        drawn = drawn.reduce(step)
        size += f", drawn as means of {step} × {step}"
    held = io.BytesIO()
    drawn.save(held, format="PNG", optimize=True)
    picture = tag(
        "img",
        src=png(held.getvalue()),
        alt=alt,
        width=drawn.width,
        height=drawn.height,
        class_="coarse" if max(nx, ny) <= COARSE else None,
    )
    scale = tag(
        "span",
        tag("span", number(low)),
        tag("span", class_="ramp"),
        tag("span", f"{number(high)} {unit}".rstrip()),
        class_="scale",
    )
    return figure(picture, scale, tag("b", title), f", {size}. {told}".rstrip(), class_="pixels")
