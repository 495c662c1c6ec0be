"""Plotters for 3-D views: creation, legend, colour bars, floor and viewpoint."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import expect
from ..errors import MissingExtraError
from . import room_parts
from .canvas import GREY, INK, PALE_GREY, pyvista, round_step

if TYPE_CHECKING:
    from pyvista import Plotter

Array = NDArray[np.float64]

#: Program that renders an empty image off screen. VTK ends the process if it finds no OpenGL.
TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.Render()
print(window.GetClassName())
"""
FLAT: dict[str, Any] = {"lighting": False}


def rendering_works() -> None:
    """Check that this machine can render 3-D views as images; raise an error if it cannot.

    Web pages (``.html``) and ``.glb`` files need no rendering. The check runs only once, in a
    separate process, because a missing OpenGL would crash the process.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or if VTK, which draws its views, finds neither a display nor
        an off-screen OpenGL (EGL or OSMesa). The message says what to install.
    """
    pyvista()
    _, fault = _trial()
    if fault:
        raise MissingExtraError(
            f"VTK cannot render here ({fault}); for images of 3-D views install a software OpenGL, "
            "on Debian apt-get install libegl1 libgl1-mesa-dri (or libosmesa6); .html and .glb "
            "need none"
        )


def window() -> Plotter:
    """Return an empty plotter whose method ``show()`` opens an interactive window.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or there is no display.
    """
    pyvista()
    kind, fault = _trial()
    # windows of these classes need no display
    hidden = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkOSMesaRenderWindow")
    if fault or kind in hidden:
        raise MissingExtraError(
            "there is no display to open a window on; write a file instead, such as room.html"
        )
    return new_plotter("nlosoptics", window=True)


@cache
def _trial() -> tuple[str, str]:
    """Return VTK's window class on this machine, and the fault that prevents rendering or ''."""
    try:
        ended = subprocess.run(
            [sys.executable, "-c", TRIAL],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=60.0,  # it usually takes half a second
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", "a test image took more than 60 s"
    if ended.returncode < 0:
        return "", f"a test image ended with {signal.Signals(-ended.returncode).name}"
    if ended.returncode > 0:
        lines = ended.stderr.strip().splitlines()
        return "", lines[-1] if lines else f"a test image ended with code {ended.returncode}"
    return ended.stdout.strip(), ""


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress VTK's messages on the terminal, for example that there is no display."""
    with pyvista().vtk_verbosity("off"):
        yield


def new_plotter(title: str, *, window: bool = False) -> Plotter:
    """Return an empty plotter that renders off screen, or in a window if ``window``."""
    with quiet():
        plotter: Plotter = pyvista().Plotter(
            off_screen=not window, window_size=(1280, 860), title=title
        )
    plotter.set_background("white")
    plotter.enable_anti_aliasing("msaa", multi_samples=4)
    return plotter


def drawn_on(plotter: Plotter | None, title: str) -> Plotter:
    """Return the given plotter, checked, or a new one."""
    checked: Plotter = (
        new_plotter(title) if plotter is None else expect("plotter", plotter, "Plotter")
    )
    return checked


def add_legend(plotter: Plotter, entries: Mapping[str, str]) -> None:
    """Add entries, colours by name, to the legend of a plotter."""
    known = legend_entries(plotter) | dict(entries)
    renderer: Any = plotter.renderer
    if renderer.legend is not None:
        renderer.remove_legend()
    renderer.add_legend(
        labels=[[name, colour] for name, colour in known.items()],
        face="rectangle",
        bcolor=None,
        border=False,
        size=(0.24, 0.034 * len(known)),
        loc="lower left",
    )


def legend_entries(plotter: Plotter) -> dict[str, Any]:
    """Return the legend entries of a plotter: colours ``#rrggbb`` by name."""
    box = plotter.legend
    if box is None:
        return {}
    colour = pyvista().Color
    return {
        box.GetEntryString(row): colour(box.GetEntryColor(row)).hex_rgb
        for row in range(box.GetNumberOfEntries())
    }


def bar_style(title: str, **more: Any) -> dict[str, Any]:
    """Return pyvista's arguments for a colour bar at the foot of the view."""
    return {
        "title": title,
        "color": INK,
        "width": 0.44,
        "height": 0.07,
        "position_x": 0.52,
        "position_y": 0.03,
        "title_font_size": 18,
        "label_font_size": 16,
        "n_labels": 4,
        **more,
    }


def finish_bar(plotter: Plotter, title: str, steps: Sequence[float] = ()) -> None:
    """Move the title of a colour bar off its labels; label only ``steps`` if there are any."""
    bar = plotter.scalar_bars[title]
    bar.GetTitleTextProperty().SetLineOffset(-12)
    if steps:
        bar.SetCustomLabels(pyvista().convert_array(np.array(steps, dtype=np.float64)))
        bar.SetUseCustomLabels(True)


def add_floor(
    plotter: Plotter, around: Array, low: Array, high: Array, balls: Sequence[tuple[Any, float]]
) -> dict[str, str]:
    """Draw a floor grid and the axes x, y and z, and set the viewpoint; return the legend entry.

    Parameters
    ----------
    plotter : Plotter
        Plotter to draw on.
    around : ndarray, (n, 3)
        Points that must be within the view, world frame, m.
    low, high : ndarray, (3,)
        Corners of the box around what is drawn, world frame, m.
    balls : sequence of (point, radius)
        Centres, world, and radii, m, of the parts that should be visible separately.
    """
    step = round_step(float((high - low).max()) / 6)
    floor = room_parts.floor_grid(low, high, step)
    plotter.add_mesh(floor, color=PALE_GREY, line_width=1, name="floor grid", **FLAT)
    frame = _look_at(plotter, np.concatenate([around, floor.points]), balls)
    origin = np.array(floor.points[np.argmin(floor.points @ frame[0])])
    if balls:  # moved into the room, because the wall would hide letters in the floor's corner
        origin[2] += np.copysign(1.2 * step, floor.center[2] - origin[2])
    axes = room_parts.triad(origin, 0.6 * step, frame)
    plotter.add_mesh(axes, color=INK, name="axes", **FLAT)
    return {f"floor grid, {step:g} m": GREY}  # the lines are too pale for text


def _look_at(plotter: Plotter, corners: Array, balls: Sequence[tuple[Any, float]]) -> Array:
    """Place the viewpoint so that the given balls are as far apart as possible in the view.

    Returns
    -------
    ndarray, (3, 3)
        Unit vectors right, up and toward the viewer, as rows, world frame.
    """
    centres = np.array([centre for centre, _ in balls], dtype=np.float64).reshape(-1, 3)
    pairs = list(itertools.combinations(range(len(balls)), 2))
    best, frame = -np.inf, np.eye(3)
    # degrees above the floor, and about y from the wall normal
    for elevation, azimuth in itertools.product((20.0, 30.0), (-40.0, -65.0, 40.0, 65.0)):
        rise, turn = np.radians([elevation, azimuth])
        toward = np.array([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)])
        right = np.array([np.cos(turn), 0.0, -np.sin(turn)])
        tried = np.stack([right, np.cross(toward, right), toward])
        flat = centres @ tried[:2].T
        gaps = [
            float(np.linalg.norm(flat[a] - flat[b])) - balls[a][1] - balls[b][1] for a, b in pairs
        ]
        if min(gaps, default=0.0) > best:
            best, frame = min(gaps, default=0.0), tried
    plotter.camera.view_angle = 30.0
    places = corners @ frame.T
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    across, up, near = (places - middle).T
    # legend and colour bars are at the foot, so that the view's upper 80 % are left
    slope = np.tan(np.radians(15.0))
    wide, high = abs(across) * 860 / 1280 / 0.94, abs(up) / 0.8
    away = float((near + np.maximum(wide, high) / slope).max())
    middle[1] -= 0.16 * slope * away
    focus = middle @ frame
    plotter.camera_position = [focus + away * frame[2], focus, (0.0, 1.0, 0.0)]
    plotter.renderer.reset_camera_clipping_range()
    return frame
