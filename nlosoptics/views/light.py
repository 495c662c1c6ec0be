"""Traced light on the wall: its irradiance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .canvas import new_axes
from .maps import colour_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..raytrace import WallIrradiance


def irradiance(irradiance: WallIrradiance, *, axes: Axes | None = None) -> Axes:
    """Draw the irradiance of the relay wall.

    Parameters
    ----------
    irradiance : WallIrradiance
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        World x and y in m, as seen from the room: x grows to the right, y up.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.6)
    drawn = axes.pcolormesh(
        irradiance.x, irradiance.y, irradiance.irradiance, shading="nearest", rasterized=True
    )
    colour_bar(axes, drawn, "irradiance (W/m$^2$)")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="light on the relay wall")
    return axes
