"""Plotters for rooms: made quietly, given a legend, colour bars and a place to look from."""

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

from ..errors import MissingExtraError

if TYPE_CHECKING:
    from pyvista import Plotter

#: Renders one empty picture off the screen: VTK ends the process where it finds no OpenGL.
TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.Render()
print(window.GetClassName())
"""
SECONDS = 60.0  # that a trial may take; half a second is usual
NEEDED = (
    "for pictures in 3-D install a software OpenGL, on Debian apt-get install libegl1 "
    "libgl1-mesa-dri (or libosmesa6); .html and .glb need none"
)
#: VTK's windows without a screen.
HIDDEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkOSMesaRenderWindow")


def pyvista() -> Any:
    """The package of that name.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import pyvista
    except ModuleNotFoundError:
        raise MissingExtraError(
            "pyvista is not installed; run pip install 'nlosoptics[views]' for pictures in 3-D"
        ) from None
    return pyvista


def rendering_works() -> None:
    """Try once per process whether this machine can render, in a process of its own.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or VTK crashes because the machine has neither a display nor
        EGL nor OSMesa; what to install is said.
    """
    pyvista()
    _, fault = _trial()
    if fault:
        raise MissingExtraError(f"VTK cannot render here ({fault}); {NEEDED}")


def window() -> Plotter:
    """An empty window to draw on; its ``show()`` opens it.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or there is no display.
    """
    pass

    pyvista()
    kind, fault = _trial()
    if fault or kind in HIDDEN:
        raise MissingExtraError(
            "there is no display to open a window on; write a file instead, such as room.html"
        )
    return new_plotter("nlosoptics", window=True)


@cache
def _trial() -> tuple[str, str]:
    """VTK's kind of window on this machine, and what is wrong with rendering; empty if nothing."""
    try:
        ended = subprocess.run(
            [sys.executable, "-c", TRIAL],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"a trial did not end within {SECONDS:g} s"
    if ended.returncode < 0:
        return "", f"a trial ended by {signal.Signals(-ended.returncode).name}"
    if ended.returncode > 0:
        said = ended.stderr.strip().splitlines()
        return "", said[-1] if said else f"a trial ended with code {ended.returncode}"
    return ended.stdout.strip(), ""


Array = NDArray[np.float64]

SIZE = (1280, 860)  # pixels
BACKGROUND, INK = "white", "#222222"
VIEW_ANGLE = 30.0  # deg, vertical
SIDE, TOP, FOOT = 0.94, 0.94, 0.68  # of half the picture: filled to there, legend and bar below
ELEVATIONS = (20.0, 30.0)  # deg above the floor
AZIMUTHS = (-40.0, -65.0, 40.0, 65.0)  # deg from the wall's normal about y


@contextmanager
def quiet() -> Iterator[None]:
    """Keep VTK's notes off the terminal, such as that there is no display to draw on."""
    with pyvista().vtk_verbosity("off"):
        yield


def new_plotter(title: str, *, window: bool = False) -> Plotter:
    """An empty stage, off the screen unless a ``window`` is wanted."""
    with quiet():
        plotter: Plotter = pyvista().Plotter(off_screen=not window, window_size=SIZE, title=title)
    plotter.set_background(BACKGROUND)
    plotter.enable_anti_aliasing("msaa", multi_samples=4)
    return plotter


def add_legend(plotter: Plotter, entries: Mapping[str, str]) -> None:
    """Name what is what by colour, beside what the legend already names."""
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
    """Names of a plotter's legend with their colours as ``#rrggbb``."""
    box = plotter.legend
    if box is None:
        return {}
    colour = pyvista().Color
    return {
        box.GetEntryString(row): colour(box.GetEntryColor(row)).hex_rgb
        for row in range(box.GetNumberOfEntries())
    }


def bar_style(title: str, **more: Any) -> dict[str, Any]:
    """Arguments of pyvista for a colour bar at the foot of the picture."""
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
    """Part a colour bar's title from its labels; label ``steps`` alone where there are any."""
    bar = plotter.scalar_bars[title]
    bar.GetTitleTextProperty().SetLineOffset(-12)
    if steps:
        bar.SetCustomLabels(pyvista().convert_array(np.array(steps, dtype=np.float64)))
        bar.SetUseCustomLabels(True)


def look_at(plotter: Plotter, corners: Array, balls: Sequence[tuple[Any, float]]) -> Array:
    """Place the camera where what matters lies apart in the picture.

    Parameters
    ----------
    plotter : Plotter
    corners : ndarray, (n, 3)
        What is to fit into the picture, world, m.
    balls : sequence of (point, radius)
        What is not to hide each other, world, m.

    Returns
    -------
    ndarray, (3, 3)
        Rows right, up and toward the viewer, world frame.
    """
    centres = np.array([centre for centre, _ in balls], dtype=np.float64).reshape(-1, 3)
    radii = [radius for _, radius in balls]
    best, frame = -np.inf, np.eye(3)
    for elevation, azimuth in itertools.product(np.radians(ELEVATIONS), np.radians(AZIMUTHS)):
        rise, fall = np.sin(elevation), np.cos(elevation)
        toward = np.array([np.sin(azimuth) * fall, rise, np.cos(azimuth) * fall])
        right = np.cross((0.0, 1.0, 0.0), toward)
        right /= np.linalg.norm(right)
        tried = np.stack([right, np.cross(toward, right), toward])
        flat = centres @ tried[:2].T
        gaps = [
            float(np.linalg.norm(flat[a] - flat[b])) - radii[a] - radii[b]
            for a, b in itertools.combinations(range(len(balls)), 2)
        ]
        gap = min(gaps, default=0.0)
        if gap > best:
            best, frame = gap, tried
    across, up, near = (corners @ frame.T).T
    half = np.tan(np.radians(VIEW_ANGLE / 2))
    x, away_x = _fitted(across, near, half * SIZE[0] / SIZE[1], (SIDE, SIDE))
    y, away_y = _fitted(up, near, half, (FOOT, TOP))
    away = max(away_x, away_y)
    focus = np.array([x, y, 0.0]) @ frame
    plotter.camera.view_angle = VIEW_ANGLE
    plotter.camera_position = [focus + away * frame[2], focus, (0.0, 1.0, 0.0)]
    plotter.renderer.reset_camera_clipping_range()
    return frame


def _fitted(
    places: Array, near: Array, half: float, free: tuple[float, float]
) -> tuple[float, float]:
    """Where to look, and from how far, so that places just fill the free part of the picture.

    A place p, ``near`` nearer than the point m that is looked at, is seen within the free parts a
    below and b above the middle where m - p <= a half (away - near) and p - m <= b half (away -
    near).
    """
    below = float((free[0] * half * near - places).max())
    above = float((free[1] * half * near + places).max())
    away = (below + above) / ((free[0] + free[1]) * half)
    return above - free[1] * half * away, away
