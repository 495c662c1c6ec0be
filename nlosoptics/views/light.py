"""Traced light: the wall's irradiance, and single paths seen from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._checks import whole
from ..errors import SceneError
from .canvas import new_axes
from .maps import colour_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..raytrace import RayPaths, WallIrradiance


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
        World x and y in m, y up, as seen from the room: x grows to the left.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.6)
    drawn = axes.pcolormesh(
        irradiance.x, irradiance.y, irradiance.irradiance, shading="nearest", rasterized=True
    )
    colour_bar(axes, drawn, "irradiance (W/m$^2$)")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="light on the relay wall")
    axes.invert_xaxis()
    return axes


def ray_paths(
    paths: RayPaths, *, most: int = 100, axes: Sequence[Axes] | None = None
) -> tuple[Axes, Axes]:
    """Draw light paths from above (x, z) and from the side (z, y).

    Parameters
    ----------
    paths : RayPaths
        Traced with ``keep_paths=True``.
    most : int
        How many to draw: the strongest. Weaker ones are fainter.
    axes : sequence of two matplotlib Axes, optional
        Where to draw, such as those of `scene_sketch`; a new figure by default.

    Returns
    -------
    (Axes, Axes)
        Top view and side view, m.

    Raises
    ------
    SceneError
        If no paths were kept.
    """
    whole("most", most)
    if not len(paths.weight):
        raise SceneError("the trace kept no paths; trace with keep_paths=True")
    top, side = axes if axes is not None else new_axes(2, width=10.5, height=5.4)
    strongest = np.argsort(-paths.weight, kind="stable")[:most]
    shares = paths.weight[strongest] / max(float(paths.weight[strongest[0]]), 1e-300)
    for view, (across, up) in ((top, (0, 2)), (side, (2, 1))):
        for path, share in zip(paths.points[strongest], shares.tolist(), strict=True):
            view.plot(
                path[:, across],
                path[:, up],
                color="#D55E00",
                linewidth=0.6,
                alpha=0.1 + 0.6 * max(share, 0.0) ** 0.5,
            )
        view.set_aspect("equal", adjustable="datalim")
    top.set(xlabel="x (m)", ylabel="z, into the room (m)", title="from above")
    side.set(xlabel="z, into the room (m)", ylabel="y, up (m)", title="from the side")
    return top, side
