"""Point spread functions as 3-D surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .canvas import new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

    from ..psf import PointSpread

Array = NDArray[np.float64]

MOST = 160  # patches along a side; more look no finer and take seconds to draw


def relief(
    point_spread: PointSpread,
    decades: float,
    half_width: float | None,
    *,
    meaning: str,
    title: str,
    axes: Axes | None,
) -> Axes:
    """Draw a point spread function as a surface, with the parameters of `views.point_spread`."""
    on: Any = axes
    if on is None:
        on = _new_axes_3d()
    elif getattr(on, "name", "") != "3d":
        raise SceneError(
            "axes are 2-D axes, which scale = 'surface' cannot use; pass axes made with "
            "projection='3d', or none"
        )
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LightSource

    norm = spread_norm(point_spread, decades)
    x, y, heights = _shown(point_spread, half_width)
    colours = colormaps["viridis"](norm(np.maximum(heights, norm.vmin or 0.0)))
    # heights in units of the sample pitch, as drawn: the sides of the box are about equal
    slopes = heights * (max(heights.shape) / (norm.vmax or 1.0))
    colours[..., :3] = LightSource(azdeg=250, altdeg=40).shade_rgb(
        colours[..., :3], slopes, blend_mode="soft"
    )
    on.plot_surface(
        *np.meshgrid(x * 1e6, y * 1e6),
        heights,
        facecolors=colours,
        rstride=1,
        cstride=1,
        linewidth=0,
        antialiased=False,
        shade=False,
    )
    figure: Any = on.get_figure(root=True)
    bar = ScalarMappable(norm, "viridis")
    figure.colorbar(bar, ax=on, label="logarithmic colour scale", shrink=0.7, pad=0.2, aspect=25)
    on.set(xlabel="x (µm)", ylabel="y (µm)", zlabel=meaning, title=title)
    # full numbers, because matplotlib would write a common factor across the axis label
    on.zaxis.set_major_formatter("{x:.2g}")
    on.tick_params(axis="z", pad=9)
    on.zaxis.labelpad = 22
    on.locator_params(nbins=5)
    on.invert_yaxis()
    on.view_init(elev=32, azim=-58)
    return on  # type: ignore[no-any-return]


def spread_norm(spread: PointSpread, decades: float | None) -> Normalize:
    """Return the colour scale up to the peak: linear from 0, or logarithmic over ``decades``."""
    from matplotlib.colors import LogNorm, Normalize

    peak = float(spread.intensity.max()) or 1.0
    return Normalize(0.0, peak) if decades is None else LogNorm(peak * 10.0**-decades, peak)


def _new_axes_3d() -> Any:
    """Return 3-D axes on a new figure."""
    (flat,) = new_axes(1, width=7.2, height=4.8)
    figure: Any = flat.get_figure()
    flat.remove()
    figure.set_layout_engine("constrained")  # labels of 3-D axes lie inside and outside of them
    return figure.add_subplot(projection="3d")


def _shown(spread: PointSpread, half_width: float | None) -> tuple[Array, Array, Array]:
    """Return x (nx,), y (ny,), m, and intensities (ny, nx) of the surface.

    Where there are too many samples, each value is the maximum of a block.
    """
    reach = np.inf if half_width is None else half_width
    rows, columns = np.abs(spread.y) <= reach, np.abs(spread.x) <= reach
    x, y, light = spread.x[columns], spread.y[rows], spread.intensity[rows][:, columns]
    step = -(-max(light.shape) // MOST)
    if step == 1:
        return x, y, light
    starts = [np.arange(0, n, step) for n in light.shape]
    light = np.maximum.reduceat(np.maximum.reduceat(light, starts[0], axis=0), starts[1], axis=1)
    x, y = (
        np.add.reduceat(places, start) / np.diff(start, append=len(places))
        for places, start in ((x, starts[1]), (y, starts[0]))
    )
    return x, y, light
