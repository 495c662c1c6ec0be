"""Whether this machine can draw in three dimensions, tried where a crash does no harm."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import cache
from typing import Any

from ..errors import MissingExtraError

#: Renders one empty picture off the screen: VTK ends the process where it finds no OpenGL.
TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.Render()
"""
SECONDS = 60.0  # that a trial may take; half a second is usual
NEEDED = (
    "for pictures in 3-D install a software OpenGL, on Debian apt-get install libegl1 "
    "libgl1-mesa-dri (or libosmesa6); .html and .glb need none"
)


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
    if found := _fault():
        raise MissingExtraError(f"VTK cannot render here ({found}); {NEEDED}")


@cache
def _fault() -> str:
    """What is wrong with rendering on this machine; empty where nothing is."""
    try:
        ended = subprocess.run(
            [sys.executable, "-c", TRIAL], capture_output=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return f"a trial did not end within {SECONDS:g} s"
    if ended.returncode < 0:
        return f"a trial ended by {signal.Signals(-ended.returncode).name}"
    if ended.returncode > 0:
        said = ended.stderr.decode(errors="replace").strip().splitlines()
        return said[-1] if said else f"a trial ended with code {ended.returncode}"
    return ""
