"""Whether this machine can draw in three dimensions, tried where a crash does no harm."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import cache
from typing import TYPE_CHECKING, Any

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
    from .stages import new_plotter

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
