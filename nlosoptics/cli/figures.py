"""Figures of a run, drawn by two processes where the system can fork."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ..runs.results import Result

Figures = Mapping[str, Callable[[], Any]]
#: Least time for which the child is waited for, s.
LEAST_WAIT: Final = 10.0


def write_figures(result: Result, folder: Path) -> None:
    """Write an overview picture and one PNG for each part of the result."""
    from .. import limits, views
    from ..views.run_overview import ground_truth

    scene, scale = result.scene, limits.object_scale(result.scene)
    here: dict[str, Callable[[], Any]] = {"overview": lambda: views.overview(result)}
    beside: dict[str, Callable[[], Any]] = {
        "scene": lambda: views.scene_sketch(scene),
        "scene_narrow": lambda: views.scene_sketch(scene, stacked=True),
        "wavefront": lambda: views.wavefront(result.wavefront),
        "point_spread": lambda: views.point_spread(result.point_spread),
        "image": lambda: views.image(result.image, object_scale=scale),
    }
    if (field := result.pupil_field) is not None:
        beside["pupil_phase"] = lambda: views.pupil_field(field)
    if (found := result.reconstruction) is not None:
        truth, pitch = ground_truth(result), scale * result.image.pitch
        here["reconstruction"] = lambda: views.reconstruction(found, truth, pitch=pitch)
    _draw_both(here, beside, folder)


def _draw_both(here: Figures, beside: Figures, folder: Path) -> None:
    """Draw some figures in this process, others beside it in a child that shares its memory.

    The child's figures are drawn here too if it cannot be started or fails.
    """
    from ..views.canvas import drawing_classes

    drawing_classes()  # loaded once, for both processes
    if not sys.platform.startswith("linux") or (os.cpu_count() or 1) < 2:
        _draw({**here, **beside}, folder)
        return
    child = multiprocessing.get_context("fork").Process(target=_child, args=(beside, folder))
    with warnings.catch_warnings():
        # The child only draws: it takes no lock that another thread of this process may hold.
        warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    try:
        start = time.perf_counter()
        _draw(here, folder)
        # it has as much to draw; one that hangs is ended below
        child.join(LEAST_WAIT + 10.0 * (time.perf_counter() - start))
    finally:
        if child.is_alive():
            child.kill()
            child.join()
    if child.exitcode != 0:
        _draw(beside, folder)


def _child(figures: Figures, folder: Path) -> None:
    """Draw in a child process, which its parent ends when it is interrupted itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        _draw(figures, folder)
    except Exception:
        os._exit(1)  # the parent tries again and tells what is wrong


def _draw(figures: Figures, folder: Path) -> None:
    from .. import views

    for name, draw in figures.items():
        views.save(draw(), folder / f"{name}.png")
