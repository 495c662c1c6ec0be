"""Figures of a run as PNG files."""

from __future__ import annotations

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
    fit, truth, pitch = shown_fit(result)
    if fit is not None:
        yield "reconstruction", views.reconstruction(fit, truth, pitch=pitch)
