"""Hidden scenes found in a volume, as seen from the wall, from above and from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import one_of
from .canvas import new_axes
from .maps import colour_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..transient import VolumeImage

#: Across and up of each view, with the side that it is seen from.
VIEWS = {
    "z": ("x", "y", "from the wall"),
    "y": ("x", "z", "from above"),
    "x": ("z", "y", "from the side"),
}


def volume(image: VolumeImage, *, axis: str = "z", axes: Axes | None = None) -> Axes:
    """Draw the brightest voxels along an axis.

    Parameters
    ----------
    image : VolumeImage
        What to draw.
    axis : {"z", "y", "x"}
        Along which: from the wall into the room, from above, or from the side.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        World coordinates in m. Seen from the wall and from above, x grows to the left, so that
        letters read; colours are relative to the brightest voxel.
    """
    one_of("axis", axis, VIEWS)
    across, up, title = VIEWS[axis]
    ends = [_ends(getattr(image.volume, name)) for name in (across, up)]
    if axes is None:
        shape = (ends[0][1] - ends[0][0]) / (ends[1][1] - ends[1][0])
        (axes,) = new_axes(1, width=min(2.0 + 3.8 * max(shape, 0.25), 8.0), height=4.6)
    seen = image.projection(axis)
    if axis == "x":
        seen = seen.T  # (nz, ny) with z across
    brightest = float(seen.max())
    drawn = axes.imshow(
        seen / brightest if brightest > 0.0 else seen,
        cmap="inferno",
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=(*ends[0], *ends[1]),
        interpolation="nearest",
    )
    if across == "x":
        axes.invert_xaxis()
    colour_bar(axes, drawn, "relative brightness")
    axes.set(xlabel=f"{across} (m)", ylabel=f"{up} (m)", title=title)
    return axes


def _ends(values: Any) -> tuple[float, float]:
    """Where the cells of an axis begin and end, m; 1 cm for a single one."""
    half = 0.5 * float(np.diff(values[:2])[0]) if len(values) > 1 else 0.005
    return float(values[0]) - half, float(values[-1]) + half
