"""Transient signal on the relay wall: streak images and frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import expect, in_range, whole
from ..errors import SamplingError, SceneError
from .canvas import BLUE, SKY, few_ticks, new_axes
from .maps import colour_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..transient import TransientCapture

Array = NDArray[np.floating]


def transient(
    capture: TransientCapture,
    *,
    at: Sequence[float] | None = None,
    laser: int = 0,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a transient capture: the signal on the relay wall over time.

    A streak image shows the signal over time along one row of the wall. Frames show the signal on
    the whole wall at single times, if the sensor points form a grid. Times are given as optical
    path, the length that the light has travelled.

    Parameters
    ----------
    capture : TransientCapture
        Capture to draw.
    at : sequence of float, optional
        Times of the frames, m of optical path. A frame shows the bin that contains its time, and
        its title gives the centre of this bin. None: three times, by which 1/6, 3/6 and 5/6 of the
        total signal have arrived; no frames if the sensor points form no grid. An empty sequence
        also draws no frames.
    laser : int
        Index of the laser point whose signal is drawn, in the flattened (C order) grid of laser
        points; only for captures with ``pairing="all"`` (every laser point with every sensor
        point).
    axes : sequence of matplotlib Axes, optional
        Axes to draw on, one for the streak image and one for each frame. A new figure by default.

    Returns
    -------
    tuple of Axes
        Axes of the streak image, then of the frames. The streak image shows the optical path, m,
        from the first to the last bin with signal, against x, m, along the middle row of sensor
        points. If the sensor points do not form a grid, their index replaces x. For a single sensor
        point a curve is drawn instead. Frames show x and y, m, as seen from the room: x points
        right and y up. Streak image and frames have the same colour scale, proportional to the
        square root of the signal. Negative values are drawn as 0.

    Raises
    ------
    SceneError
        If ``at`` or ``laser`` is out of the range of the capture, if frames are requested and the
        sensor points do not form a grid, or if the number of axes is wrong.
    SamplingError
        If the shape of ``sensor_points`` is neither that of a list, (n, 3), nor that of a grid,
        (ny, nx, 3).

    See Also
    --------
    volume : Picture of an image that was reconstructed from a capture.

    Examples
    --------
    The frame at 2 m shows the bin from 2.00 to 2.02 m:

    >>> import numpy as np
    >>> from nlosoptics import transient, views
    >>> capture = transient.TransientCapture(
    ...     H=np.ones((50, 8, 8)),
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=transient.wall_grid(1.0, 8),
    ...     delta_t=0.02,
    ...     t_start=1.5,
    ... )
    >>> streak, frame = views.transient(capture, at=[2.0])
    >>> frame.get_title()
    'optical path 2.01 m'
    """
    capture = expect("capture", capture, "TransientCapture")
    light = _light(capture, laser)
    frames = _frames(capture, light, at)
    lit = np.flatnonzero((light > 0.0).reshape(len(light), -1).any(axis=1))
    first, last = (int(lit[0]), int(lit[-1])) if len(lit) else (0, capture.n_bins - 1)
    ends = (float(capture.edges[first]), float(capture.edges[last + 1]))
    if axes is None:
        axes = new_axes(1 + len(frames), width=1.4 + 4.0 * (1 + len(frames)), height=4.0)
    streak, *others = axes
    if len(others) != len(frames):
        raise SceneError(
            f"{1 + len(others)} axes were given, must be {1 + len(frames)}: one for the streak "
            f"image and {len(frames)} for the frames; change axes or at"
        )
    # counts have no unit
    units = {"irradiance": "(W/m$^2$)", "radiance": "(W/(m$^2$ sr))", "radiosity": "(W/m$^2$)"}
    meaning = f"{capture.quantity} per bin {units.get(capture.quantity, '')}".rstrip()
    if light.ndim == 1:
        streak.plot(capture.times, light, color=BLUE, drawstyle="steps-mid")
        title = "signal at the sensor point"
        streak.set(xlabel="optical path (m)", ylabel=meaning, xlim=ends, title=title)
        streak.grid(alpha=0.25)
        return (streak,)
    from matplotlib.colors import PowerNorm

    x, rows, title = _row(capture, light)
    most = max([float(rows.max()), *(float(light[i].max()) for i in frames)])
    # the square root, because the signal falls with the fourth power of distance
    style: dict[str, Any] = {"norm": PowerNorm(0.5, 0.0, most if most > 0.0 else 1.0)}
    style |= {"cmap": "inferno", "rasterized": True}
    drawn = streak.pcolormesh(x, capture.times, np.maximum(rows, 0.0), **style)
    across = "index of the sensor point" if light.ndim == 2 else "x (m)"
    streak.set(xlabel=across, ylabel="optical path (m)", ylim=ends, title=title)
    points = capture.sensor_points
    for axis, index in zip(others, frames, strict=True):
        streak.axhline(capture.times[index], color=SKY, linewidth=0.8, linestyle="--")
        frame = np.maximum(light[index], 0.0)
        drawn = axis.pcolormesh(points[..., 0], points[..., 1], frame, shading="nearest", **style)
        if capture.pairing == "all":
            place = capture.laser_points.reshape(-1, 3)[laser, :2]
            axis.plot(*place, color=SKY, marker="+", markersize=9, label="laser point")
        title = f"optical path {capture.times[index]:.4g} m"
        axis.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=title)
        few_ticks(axis)
    colour_bar(others[-1] if others else streak, drawn, meaning)
    return tuple(axes)


def _light(capture: TransientCapture, laser: int) -> Array:
    """Return the signal (n_bins, *sensor_shape) of one laser point."""
    sensors = capture.sensor_shape
    shape = capture.H.shape[1:]
    if capture.pairing == "confocal":
        sensors = shape  # each laser point has its own sensor point
    count = int(np.prod(shape)) // int(np.prod(sensors))
    laser = whole("laser", laser, 0, count - 1)
    light = capture.H.reshape(capture.n_bins, count, *sensors)[:, laser]
    if light.ndim > 3:
        raise SamplingError(
            f"sensor points of shape {sensors} are neither a grid nor a list; give (ny, nx, 3) or "
            "(n, 3)"
        )
    return light


def _frames(capture: TransientCapture, light: Array, at: Sequence[float] | None) -> list[int]:
    """Return the bins of the frames."""
    if at is None:
        if light.ndim != 3:
            return []
        come = np.cumsum(np.maximum(light, 0.0).sum(axis=(1, 2)))
        return [int(i) for i in np.searchsorted(come, np.array([1, 3, 5]) / 6 * come[-1])]
    if len(at) and light.ndim != 3:
        raise SceneError(
            f"sensor points of shape {light.shape[1:]} are no grid, which frames need; draw the "
            "streak image alone by views.transient(capture, at=())"
        )
    low, high = float(capture.edges[0]), float(capture.edges[-1])
    advice = "choose an optical path within the capture"
    times = [in_range("at", time, low, high, unit="m", remedy=advice) for time in at]
    return [min(int((time - low) / capture.delta_t), capture.n_bins - 1) for time in times]


def _row(capture: TransientCapture, light: Array) -> tuple[Array, Array, str]:
    """Return positions (n,), signal (n_bins, n) and title of the streak image."""
    if light.ndim == 2:
        return np.arange(float(light.shape[1])), light, "streak image over the sensor points"
    points = capture.sensor_points
    middle = light.shape[1] // 2
    return points[middle, :, 0], light[:, middle], f"streak image, y = {points[middle, 0, 1]:.3g} m"
