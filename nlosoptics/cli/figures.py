"""Figures of a run as PNG files."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..runs.results import Result

OVERVIEW = "overview.png"


def write_overview(result: Result, folder: Path) -> None:
    """Write one figure of all results."""
    from .. import views

    views.save(views.overview(result), folder / OVERVIEW)


def write_figures(result: Result, folder: Path) -> list[Path]:
    """Write a figure for each part of a result; return their files."""
    from .. import views

    files = []
    for name, picture in _figures(result):
        files.append(folder / f"{name}.png")
        views.save(picture, files[-1])
    return files


def _figures(result: Result) -> Iterator[tuple[str, Any]]:
    """Yield the name and the drawing of each figure."""
    from .. import views
    from ..limits import object_scale
    from ..views.run_overview import shown_fit

    scale = object_scale(result.scene)
    yield "scene", views.scene_sketch(result.scene)
    if result.point_spread is not None and result.wavefront is not None:
        yield "point_spread", views.point_spread(result.point_spread)
        yield "wavefront", views.wavefront(result.wavefront)
    if result.pupil_field is not None:
        yield "pupil_phase", views.wavefront(result.pupil_field)
    yield "image", views.image(result.image, object_scale=scale)
    fit, truth, options = shown_fit(result)
    if fit is not None:
        yield "reconstruction", views.reconstruction(fit, truth, **options)


def write_photograph(image: Any, kernel: Any, answer: Any, gamma: str, folder: Path) -> None:
    """Write one figure of a photograph, its point spread and what a solver found in it."""
    from .. import views
    from ..views.canvas import new_axes

    status = answer.status.replace("_", " ")
    axes = new_axes(3, width=14.0, height=4.8)
    pictures = (image / image.max(), kernel / kernel.max(), answer.object)
    titles = ("photograph", "point spread", f"sharpened, {status}")
    for where, picture, title in zip(axes, pictures, titles, strict=True):
        shown = picture if where is axes[1] else _tones(picture, gamma)
        where.imshow(shown, cmap="gray", interpolation="nearest")
        where.set(title=title, xlabel="column (pixels)", ylabel="row (pixels)")
    views.save(axes, folder / OVERVIEW)


def displayed(picture: Any, gamma: str) -> bytes:
    """Return an 8-bit PNG of a picture, grey or in colour, as it is stored: linear or as sRGB."""
    import numpy as np
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.rint(255.0 * _tones(picture, gamma)).astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def _tones(picture: Any, gamma: str) -> Any:
    """Return a picture between 0 and 1; one pixel in a thousand may be brighter."""
    import numpy as np

    light = np.clip(picture / (np.quantile(picture, 0.999) or 1.0), 0.0, 1.0)
    if gamma == "linear":
        return light
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
