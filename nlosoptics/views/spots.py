"""Spot diagrams."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import whole
from .canvas import new_axes
from .palette import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..psf import SpotDiagram


def spot_diagram(spots: SpotDiagram, *, most: int = 20_000, axes: Axes | None = None) -> Axes:
    """Draw where rays land, beside the disc that diffraction makes of a perfect wave.

    Parameters
    ----------
    spots : SpotDiagram
        As of `psf.spot_diagram`.
    most : int
        Of more rays, every so-manieth is drawn.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Image coordinates in um, turned as the camera shows them: y grows downward. A dot's area is
        its share of the light; the circle about the centroid is the first dark ring of Airy's
        pattern.
    """
    whole("most", most)
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.4, height=5.4)
    from matplotlib.patches import Circle

    drawn = slice(None, None, max(1, -(-len(spots.x) // most)))
    x, y, energy = (1e6 * spots.x[drawn], 1e6 * spots.y[drawn], spots.energy[drawn])
    rms, airy = 1e6 * spots.radius, 1e6 * spots.airy_radius
    centre = (1e6 * spots.centroid[0], 1e6 * spots.centroid[1])
    axes.scatter(
        x,
        y,
        s=np.clip(8.0 * energy / energy.mean(), 0.5, 40.0),
        color=BLUE,
        linewidths=0,
        alpha=0.7,
        rasterized=True,
        label=f"rays, {rms:.3g} µm rms",
    )
    style: dict[str, Any] = {"fill": False, "color": VERMILION, "linewidth": 1.5}
    axes.add_patch(Circle(centre, airy, label=f"first dark ring, {airy:.3g} µm", **style))
    half = 1.3 * max(airy, float(np.abs(x - centre[0]).max()), float(np.abs(y - centre[1]).max()))
    axes.set(
        xlim=(centre[0] - half, centre[0] + half),
        ylim=(centre[1] + half, centre[1] - half),
        aspect="equal",
        xlabel="x (µm)",
        ylabel="y (µm)",
        title="spot diagram",
    )
    axes.grid(alpha=0.25)
    axes.legend(loc="upper right")
    return axes
