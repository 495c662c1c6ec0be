"""Light on the relay wall over time: streaks, frames and films."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, in_range, positive, whole
from ..errors import SamplingError, SceneError
from .canvas import new_axes
from .maps import colour_bar
from .palette import BLUE, SKY

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

    from ..transient import TransientCapture

Array = NDArray[np.floating]

#: Unit of each quantity that has one.
UNITS = {"irradiance": " (W/m$^2$)", "radiance": " (W/(m$^2$ sr))", "radiosity": " (W/m$^2$)"}
FRAMES = 3  # beside a streak, where times are not given
GAMMA = 0.5  # of the colours: echoes fall off with the fourth power of distance
MOST_MEGABYTES = 200.0  # of a film in a page
#: Of buttons, in characters that every font has.
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
    """Draw the light on the relay wall over time: a streak, and frames where points form a grid.

    Parameters
    ----------
    capture : TransientCapture
        What to draw.
    at : sequence of float, optional
        Optical paths of the frames, m; by default three, by which a sixth, half and five sixths of
        the light have come.
    laser : int
        Which of the laser points, counted along their rows, where each is seen at all sensors.
    axes : sequence of matplotlib Axes, optional
        Where to draw: one for the streak and one for each frame; a new figure by default.

    Returns
    -------
    tuple of Axes
        Of the streak: optical path in m upward, from the first to the last bin with light, against
        x in m along the middle row of sensors, or against their numbers where they form no grid; of
        one sensor, its light against the optical path. Then the frames, x and y in m as seen from
        the room: x grows to the right. All share one scale of colours, with the square root of the
        light; values below 0 are drawn as 0.

    Raises
    ------
    SceneError
        If ``at`` or ``laser`` is out of the capture's range, or frames are wanted of sensors that
        form no grid.
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
            f"{1 + len(others)} axes for a streak and {counted(len(frames), 'frame')}; give as many"
        )
    meaning = f"{capture.quantity} per bin{UNITS.get(capture.quantity, '')}"
    if light.ndim == 1:
        streak.plot(capture.times, light, color=BLUE, drawstyle="steps-mid")
        title = "light at the sensor point"
        streak.set(xlabel="optical path (m)", ylabel=meaning, xlim=ends, title=title)
        streak.grid(alpha=0.25)
        return (streak,)
    x, rows, title = _row(capture, light)
    norm = _norm(max([float(rows.max()), *(float(light[i].max()) for i in frames)]))
    drawn = streak.pcolormesh(
        x, capture.times, np.maximum(rows, 0.0), norm=norm, cmap="inferno", rasterized=True
    )
    across = "sensor point" if light.ndim == 2 else "x (m)"
    streak.set(xlabel=across, ylabel="optical path (m)", ylim=ends, title=title)
    streak.locator_params(axis="x", nbins=5)
    for axis, index in zip(others, frames, strict=True):
        streak.axhline(capture.times[index], color=SKY, linewidth=0.8, linestyle="--")
        drawn = _frame(axis, capture, light[index], norm, laser)
        axis.set_title(f"at {capture.times[index]:.4g} m")
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
    """Film of the light on the relay wall; `save` writes it as ``.gif`` or ``.html``.

    Parameters
    ----------
    capture : TransientCapture
        Of a grid of sensor points.
    between : (float, float), optional
        Optical paths that the film begins and ends with, m; by default those of the first and last
        bin with light.
    laser : int
        As of `transient`.
    most : int
        Frames; of more bins, each frame adds up as many neighbours as it takes.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib FuncAnimation
        Twenty frames a second, on axes as the frames of `transient`.

    Raises
    ------
    SceneError
        If an option is out of range, or the sensors form no grid.
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
        # a given height spares a search for free room over the axes in every frame
        return drawn, axes.set_title(f"optical path {middle:.3f} m", y=1.01)

    draw(0)
    from matplotlib.animation import FuncAnimation

    figure: Any = axes.get_figure(root=True)
    if made:
        # laid out once; every frame would do it again, ten times as long as drawing
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    return FuncAnimation(figure, draw, frames=len(frames), interval=50)


def film_file(film: Any, suffix: str) -> bytes:
    """Film as ``.gif``, or as ``.html``: a page with a slider that asks nothing of the net."""
    return _page(film).encode() if suffix == ".html" else _gif(film)


def _gif(film: FuncAnimation) -> bytes:
    from matplotlib.animation import PillowWriter

    with TemporaryDirectory() as folder:
        place = Path(folder, "film.gif")
        film.save(place, writer=PillowWriter(fps=20), dpi=90)
        return place.read_bytes()


def _page(film: FuncAnimation) -> str:
    """Page with matplotlib's slider, less its style sheet from the net, with a name and icons."""
    from matplotlib import rc_context

    with rc_context({"animation.embed_limit": MOST_MEGABYTES, "savefig.dpi": 90}):
        player = film.to_jshtml(default_mode="loop")
    player = re.sub(r"<link[^>]*>", "", player)
    player = player.replace("<img ", '<img alt="Light on the relay wall over time" ')
    player = player.replace('type="range"', 'type="range" aria-label="Frame"')
    icons = "".join(f'.fa-{name}::before{{content:"{icon}"}}' for name, icon in ICONS.items())
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        "<title>Light on the relay wall over time</title>\n"
        f"<style>.fa{{font-style:normal}}.fa-flip-horizontal{{display:inline-block;"
        f"transform:scaleX(-1)}}img{{max-width:100%}}{icons}</style>\n"
        f"</head>\n<body>\n{player}\n</body>\n</html>\n"
    )


def _light(capture: TransientCapture, laser: int) -> Array:
    """Light (n_bins, *sensor_shape) of one laser point."""
    sensors = capture.sensor_shape
    shape = capture.H.shape[1:]
    if capture.pairing == "confocal":
        sensors = shape  # each laser point has the one sensor
    count = int(np.prod(shape)) // int(np.prod(sensors))
    laser = whole("laser", laser, 0, count - 1)
    light = capture.H.reshape(capture.n_bins, count, *sensors)[:, laser]
    if light.ndim > 3:
        raise SamplingError(
            f"sensor points of shape {sensors} are no grid and no list; give (ny, nx, 3) or (n, 3)"
        )
    return light


def _check_grid(light: Array) -> None:
    if light.ndim != 3:
        raise SceneError(
            f"sensor points of shape {light.shape[1:]} are no grid, so there are no frames of them"
        )


def _frames(capture: TransientCapture, light: Array, at: Sequence[float] | None) -> list[int]:
    """Bins of the frames."""
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
    """Bin that holds an optical path, m."""
    low, high = float(capture.edges[0]), float(capture.edges[-1])
    time = in_range(name, time, low, high, unit="m", remedy="name a path that the capture holds")
    return min(int((time - low) / capture.delta_t), capture.n_bins - 1)


def _span(
    capture: TransientCapture, light: Array, between: tuple[float, float] | None
) -> tuple[int, int]:
    """First and last bin of a film."""
    if between is None:
        lit = np.flatnonzero((light > 0.0).reshape(len(light), -1).any(axis=1))
        return (int(lit[0]), int(lit[-1])) if len(lit) else (0, capture.n_bins - 1)
    low, high = (_bin(capture, "between", time) for time in between)
    if low > high:
        raise SceneError(f"between = {tuple(between)} m falls; give the earlier path first")
    return low, high


def _row(capture: TransientCapture, light: Array) -> tuple[Array, Array, str]:
    """Places (n,), light (n_bins, n) and title of the streak."""
    if light.ndim == 2:
        return np.arange(float(light.shape[1])), light, "streak over the sensor points"
    points = capture.sensor_points
    middle = light.shape[1] // 2
    return points[middle, :, 0], light[:, middle], f"streak, y = {points[middle, 0, 1]:.3g} m"


def _frame(axes: Axes, capture: TransientCapture, frame: Array, norm: Normalize, laser: int) -> Any:
    """Draw light (ny, nx) at the sensor points, as seen from the room, and the laser's point."""
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
    axes.locator_params(nbins=5)
    return drawn


def _norm(most: float) -> Normalize:
    from matplotlib.colors import PowerNorm

    return PowerNorm(GAMMA, 0.0, positive("light", most) if most > 0.0 else 1.0)
