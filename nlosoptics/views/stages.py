"""Plotters for 3-D views: creation, legend, colour bars and viewpoint."""

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
from .canvas import INK

if TYPE_CHECKING:
    from pyvista import Plotter

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
SECONDS = 60.0  # time limit of this program, which usually takes half a second
NEEDED = (
    "for images of 3-D views install a software OpenGL, on Debian apt-get install libegl1 "
    "libgl1-mesa-dri (or libosmesa6); .html and .glb need none"
)
#: VTK's classes of windows that need no display.
HIDDEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkOSMesaRenderWindow")


def pyvista() -> Any:
    """Import and return pyvista.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    """
    try:
        import pyvista
    except ModuleNotFoundError:
        raise MissingExtraError(
            "pyvista is not installed; run pip install 'nlosoptics[views]' for 3-D views"
        ) from None
    return pyvista


def rendering_works() -> None:
    """Check that this machine can render 3-D views as images; raise an error if it cannot.

    Web pages (``.html``) and ``.glb`` files need no rendering. The check runs only once, in a
    separate process, because a missing OpenGL would crash the process.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or if VTK, which draws its views, finds neither a display nor
        an off-screen OpenGL (EGL or OSMesa). The message says what to install.

    See Also
    --------
    save : Write a figure, film or 3-D view.
    window : Plotter with a window.
    """
    pyvista()
    _, fault = _trial()
    if fault:
        raise MissingExtraError(f"VTK cannot render here ({fault}); {NEEDED}")


def window() -> Plotter:
    """Return an empty plotter for 3-D views in an interactive window.

    Returns
    -------
    pyvista Plotter
        Plotter to pass to `scene_3d`, `ray_paths` or `phasor_volume`. Its method ``show()`` then
        opens the window.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or there is no display.

    See Also
    --------
    scene_3d : 3-D view of a scene.
    rendering_works : Whether this machine can render.
    """
    pyvista()
    kind, fault = _trial()
    if fault or kind in HIDDEN:
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
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"a test image took more than {SECONDS:g} s"
    if ended.returncode < 0:
        return "", f"a test image ended with {signal.Signals(-ended.returncode).name}"
    if ended.returncode > 0:
        said = ended.stderr.strip().splitlines()
        return "", said[-1] if said else f"a test image ended with code {ended.returncode}"
    return ended.stdout.strip(), ""


Array = NDArray[np.float64]

SIZE = (1280, 860)  # pixels
BACKGROUND = "white"
VIEW_ANGLE = 30.0  # deg, vertical
# parts of the half width and half height that the scene may fill; legend and bars are at the foot
SIDE, TOP, FOOT = 0.94, 0.94, 0.68
ELEVATIONS = (20.0, 30.0)  # possible viewpoints, deg above the floor
AZIMUTHS = (-40.0, -65.0, 40.0, 65.0)  # and deg about y from the wall normal


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress VTK's messages on the terminal, for example that there is no display."""
    with pyvista().vtk_verbosity("off"):
        yield


def new_plotter(title: str, *, window: bool = False) -> Plotter:
    """Return an empty plotter that renders off screen, or in a window if ``window``."""
    with quiet():
        plotter: Plotter = pyvista().Plotter(off_screen=not window, window_size=SIZE, title=title)
    plotter.set_background(BACKGROUND)
    plotter.enable_anti_aliasing("msaa", multi_samples=4)
    return plotter


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


def look_at(plotter: Plotter, corners: Array, balls: Sequence[tuple[Any, float]]) -> Array:
    """Place the viewpoint so that the given balls are as far apart as possible in the view.

    Parameters
    ----------
    plotter : Plotter
        Plotter whose camera is set.
    corners : ndarray, (n, 3)
        Points that must be within the view, world frame, m.
    balls : sequence of (point, radius)
        Centres, world, and radii, m, of the parts that should be visible separately.

    Returns
    -------
    ndarray, (3, 3)
        Unit vectors right, up and toward the viewer, as rows, world frame.
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
    """Return the focal point m and the viewing distance d at which points just fill the view.

    Parameters
    ----------
    places : ndarray, (n,)
        Coordinates p of the points along one axis of the view, m.
    near : ndarray, (n,)
        Distances q of the points from the focal plane toward the viewer, m.
    half : float
        Tangent of half the view angle along this axis.
    free : (float, float)
        Parts a and b of the half view below and above its middle that may be filled.

    Notes
    -----
    A point is within the view if m - p <= a half (d - q) and p - m <= b half (d - q).
    """
    below = float((free[0] * half * near - places).max())
    above = float((free[1] * half * near + places).max())
    away = (below + above) / ((free[0] + free[1]) * half)
    return above - free[1] * half * away, away
