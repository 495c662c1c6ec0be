"""Transient signal on the relay wall: streak images, frames and films."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import in_range, positive, whole
from ..errors import SamplingError, SceneError
from .canvas import BLUE, SKY, new_axes, space_ticks
from .maps import colour_bar

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

    from ..transient import TransientCapture

Array = NDArray[np.floating]

#: Unit of each quantity of a capture, for labels; counts have none.
UNITS = {"irradiance": " (W/m$^2$)", "radiance": " (W/(m$^2$ sr))", "radiosity": " (W/m$^2$)"}
FRAMES = 3  # number of frames next to the streak image by default
GAMMA = 0.5  # exponent of the colour scale; the signal falls with the fourth power of distance
MOST_MEGABYTES = 200.0  # largest film in an HTML page
#: Symbols of the player's buttons, in characters that every font has.
ICONS = {
    "minus": "\u2212",
    "plus": "+",
    "fast-backward": "|\u25c0",
    "step-backward": "\u2039",
    "pause": "||",
    "play": "\u25b6",
    "step-forward": "\u203a",
    "fast-forward": "\u25b6|",
}


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
    transient_film : Film of the signal over time.

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
    light = _light(capture, laser)
    frames = _frames(capture, light, at)
    first, last = _span(capture, light, None)
    ends = (float(capture.edges[first]), float(capture.edges[last + 1]))
    if axes is None:
        axes = new_axes(1 + len(frames), width=1.4 + 4.0 * (1 + len(frames)), height=4.0)
    streak, *others = axes
    if len(others) != len(frames):
        raise SceneError(
            f"{1 + len(others)} axes were given, must be {1 + len(frames)}: one for the streak "
            f"image and {len(frames)} for the frames; change axes or at"
        )
    meaning = f"{capture.quantity} per bin{UNITS.get(capture.quantity, '')}"
    if light.ndim == 1:
        streak.plot(capture.times, light, color=BLUE, drawstyle="steps-mid")
        title = "signal at the sensor point"
        streak.set(xlabel="optical path (m)", ylabel=meaning, xlim=ends, title=title)
        space_ticks(streak)
        streak.grid(alpha=0.25)
        return (streak,)
    x, rows, title = _row(capture, light)
    norm = _norm(max([float(rows.max()), *(float(light[i].max()) for i in frames)]))
    drawn = streak.pcolormesh(
        x, capture.times, np.maximum(rows, 0.0), norm=norm, cmap="inferno", rasterized=True
    )
    across = "index of the sensor point" if light.ndim == 2 else "x (m)"
    streak.set(xlabel=across, ylabel="optical path (m)", ylim=ends, title=title)
    space_ticks(streak)
    for axis, index in zip(others, frames, strict=True):
        streak.axhline(capture.times[index], color=SKY, linewidth=0.8, linestyle="--")
        drawn = _frame(axis, capture, light[index], norm, laser)
        axis.set_title(f"optical path {capture.times[index]:.4g} m")
    colour_bar(others[-1] if others else streak, drawn, meaning)
    return tuple(axes)


def transient_film(
    capture: TransientCapture,
    *,
    between: tuple[float, float] | None = None,
    laser: int = 0,
    most: int = 100,
    axes: Axes | None = None,
) -> FuncAnimation:
    """Make a film of the signal on the relay wall over time; `save` writes it to a file.

    Parameters
    ----------
    capture : TransientCapture
        Capture at a grid of sensor points.
    between : (float, float), optional
        Times of the first and last frame, m of optical path (the length that the light has
        travelled). None: the first and last bin with signal.
    laser : int
        Index of the laser point whose signal is drawn, in the flattened (C order) grid of laser
        points; only for captures with ``pairing="all"`` (every laser point with every sensor
        point).
    most : int
        Largest number of frames. If there are more bins, each frame is the sum of several bins.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    matplotlib FuncAnimation
        Film of 20 frames per second. Its axes show x and y, m, as seen from the room: x points
        right and y up.

    Raises
    ------
    SceneError
        If an argument is out of range, or the sensor points do not form a grid.

    See Also
    --------
    transient : Streak image of a capture.
    save : Write a figure, film or 3-D view.
    """
    light = _light(capture, laser)
    _check_grid(light)
    first, last = _span(capture, light, between)
    step = -(-(last + 1 - first) // whole("most", most))
    starts = np.arange(first, last + 1, step)
    frames = np.add.reduceat(light[: last + 1], starts, axis=0)
    made = axes is None
    (axes,) = (axes,) if axes is not None else new_axes(1, width=5.4, height=4.4)
    drawn = _frame(axes, capture, frames[0], _norm(float(frames.max())), laser)
    added = f"{step} bins" if step > 1 else "bin"
    colour_bar(axes, drawn, f"{capture.quantity} per {added}{UNITS.get(capture.quantity, '')}")
    edges = capture.edges

    def draw(number: int) -> tuple[Any, ...]:
        drawn.set_array(np.maximum(frames[number], 0.0))
        middle = 0.5 * (edges[starts[number]] + edges[min(starts[number] + step, last + 1)])
        # with a given height, matplotlib need not search for free space above the axes each time
        return drawn, axes.set_title(f"optical path {middle:.3f} m", y=1.01)

    draw(0)
    from matplotlib.animation import FuncAnimation

    figure: Any = axes.get_figure(root=True)
    if made:
        # a layout for every frame would take ten times as long as drawing it
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    return FuncAnimation(figure, draw, frames=len(frames), interval=50)


def film_file(film: Any, suffix: str) -> bytes:
    """Return a film as the bytes of a ``.gif`` or of a self-contained ``.html`` page."""
    return _page(film).encode() if suffix == ".html" else _gif(film)


def _gif(film: FuncAnimation) -> bytes:
    """Return a film as a GIF of 20 frames per second."""
    from matplotlib.animation import PillowWriter

    with TemporaryDirectory() as folder:
        place = Path(folder, "film.gif")
        film.save(place, writer=PillowWriter(fps=20), dpi=90)
        return place.read_bytes()


def _page(film: FuncAnimation) -> str:
    """Return a film as a page: matplotlib's player, without its links to style sheet and icons."""
    from matplotlib import rc_context

    with rc_context({"animation.embed_limit": MOST_MEGABYTES, "savefig.dpi": 90}):
        player = film.to_jshtml(default_mode="loop")
    player = re.sub(r"<link[^>]*>", "", player)
    player = player.replace("<img ", '<img alt="Transient signal on the relay wall" ')
    player = player.replace('type="range"', 'type="range" aria-label="Frame"')
    icons = "".join(f'.fa-{name}::before{{content:"{icon}"}}' for name, icon in ICONS.items())
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        "<title>Transient signal on the relay wall</title>\n"
        f"<style>.fa{{font-style:normal}}.fa-flip-horizontal{{display:inline-block;"
        f"transform:scaleX(-1)}}img{{max-width:100%}}{icons}</style>\n"
        f"</head>\n<body>\n{player}\n</body>\n</html>\n"
    )


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


def _check_grid(light: Array) -> None:
    """Raise SceneError if the sensor points form no grid."""
    if light.ndim != 3:
        raise SceneError(
            f"sensor points of shape {light.shape[1:]} are no grid, which frames need; draw the "
            "streak image alone by views.transient(capture, at=())"
        )


def _frames(capture: TransientCapture, light: Array, at: Sequence[float] | None) -> list[int]:
    """Return the bins of the frames."""
    if at is None:
        if light.ndim != 3:
            return []
        come = np.cumsum(np.maximum(light, 0.0).sum(axis=(1, 2)))
        shares = (np.arange(FRAMES) + 0.5) / FRAMES
        return [int(i) for i in np.searchsorted(come, shares * come[-1])]
    if len(at):
        _check_grid(light)
    return [_bin(capture, "at", time) for time in at]


def _bin(capture: TransientCapture, name: str, time: float) -> int:
    """Return the bin that contains an optical path, m."""
    low, high = float(capture.edges[0]), float(capture.edges[-1])
    time = in_range(
        name, time, low, high, unit="m", remedy="choose an optical path within the capture"
    )
    return min(int((time - low) / capture.delta_t), capture.n_bins - 1)


def _span(
    capture: TransientCapture, light: Array, between: tuple[float, float] | None
) -> tuple[int, int]:
    """Return the first and last bin of a film."""
    if between is None:
        lit = np.flatnonzero((light > 0.0).reshape(len(light), -1).any(axis=1))
        return (int(lit[0]), int(lit[-1])) if len(lit) else (0, capture.n_bins - 1)
    low, high = (_bin(capture, "between", time) for time in between)
    if low > high:
        raise SceneError(f"between = {tuple(between)} m decreases; give the shorter path first")
    return low, high


def _row(capture: TransientCapture, light: Array) -> tuple[Array, Array, str]:
    """Return positions (n,), signal (n_bins, n) and title of the streak image."""
    if light.ndim == 2:
        return np.arange(float(light.shape[1])), light, "streak image over the sensor points"
    points = capture.sensor_points
    middle = light.shape[1] // 2
    return points[middle, :, 0], light[:, middle], f"streak image, y = {points[middle, 0, 1]:.3g} m"


def _frame(axes: Axes, capture: TransientCapture, frame: Array, norm: Normalize, laser: int) -> Any:
    """Draw the signal (ny, nx) at the sensor points as seen from the room, and the laser point."""
    points = capture.sensor_points
    drawn = axes.pcolormesh(
        points[..., 0],
        points[..., 1],
        np.maximum(frame, 0.0),
        norm=norm,
        cmap="inferno",
        shading="nearest",
        rasterized=True,
    )
    if capture.pairing == "all":
        x, y, _ = capture.laser_points.reshape(-1, 3)[laser]
        axes.plot([x], [y], color=SKY, marker="+", markersize=9, linestyle="", label="laser point")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.locator_params(axis="y", nbins=5)
    space_ticks(axes)
    return drawn


def _norm(most: float) -> Normalize:
    """Return the colour scale from 0 to the largest signal; up to 1 for a dark capture."""
    from matplotlib.colors import PowerNorm

    return PowerNorm(GAMMA, 0.0, positive("signal", most) if most > 0.0 else 1.0)
