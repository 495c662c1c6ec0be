"""One drawn figure for each central notion: mirror image, pupil, wave, facets, shadow, phasors."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tables import COLOURS, figure

from nlosoptics import views

BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK = COLOURS
GREY = "#666666"


def pages(target: Path) -> None:
    """Write ``notion_*.svg`` into a folder."""
    for draw in (mirror_image, exit_pupil, wave_aberration, facets, shadow, phasors):
        views.save(draw(), target / f"notion_{draw.__name__}.svg")


def line(axes: Axes, *points: tuple[float, float], **style: Any) -> None:
    """Draw straight pieces through points, with an arrow at the middle of each solid piece."""
    x, y = np.array(points).T
    axes.plot(x, y, **{"linewidth": 1.4} | style)
    if style.get("linestyle") is None:
        for k in range(len(x) - 1):
            middle, end = (
                (1 - t) * np.array(points[k]) + t * np.array(points[k + 1]) for t in (0.45, 0.6)
            )
            arrow = {"arrowstyle": "-|>", "color": style.get("color", BLACK), "lw": 0}
            axes.annotate("", end, middle, arrowprops=arrow)


def plain(axes: Axes, **limits: Any) -> Axes:
    """Hide the frame: a sketch has no scale."""
    axes.set(aspect="equal", **limits)
    axes.axis("off")
    return axes


def mirror_image() -> Figure:
    """Object, its image behind the wall, and the camera, from above."""
    drawn = figure(7.5, 4.4)
    axes = plain(drawn.subplots())
    axes.plot([-1, 1], [0, 0], color=BLACK, linewidth=4)
    camera = (0.75, 1.05)
    for x, colour in ((-0.75, GREEN), (-0.35, BLUE)):
        hit = (x + (camera[0] - x) * 0.8 / (0.8 + 1.05), 0.0)
        line(axes, (x, 0.8), hit, camera, color=colour)
        axes.plot([x, hit[0]], [-0.8, 0], color=colour, linestyle="--", linewidth=1.2)
    for side, name, place in ((1, "hidden object", 0.9), (-1, "its mirror image", -0.97)):
        axes.annotate(
            "",
            (-0.35, 0.8 * side),
            (-0.75, 0.8 * side),
            arrowprops={"arrowstyle": "-|>", "color": GREY, "lw": 3 if side > 0 else 1.5},
        )
        axes.text(-0.55, place, name, ha="center", color=GREY)
    axes.plot(*camera, "s", color=RED, markersize=12)
    axes.text(camera[0] + 0.08, camera[1], "camera", color=RED, va="center")
    axes.plot([0.0, 0.0], [0.35, 1.2], color=ORANGE, linewidth=5, solid_capstyle="butt")
    axes.text(0.04, 1.12, "partition", color=ORANGE)
    axes.text(0.98, -0.1, "relay wall", ha="right")
    return drawn


def exit_pupil() -> Figure:
    """The stop, and the cone of light from the pupil to one point of the sensor."""
    drawn = figure(8.0, 3.0)
    axes = plain(drawn.subplots(), xlim=(-2.2, 2.25), ylim=(-0.95, 0.9))
    y = np.linspace(-0.6, 0.6, 101)
    axes.fill_betweenx(y, 0.1 * (y**2 / 0.36 - 1), -0.1 * (y**2 / 0.36 - 1), color=SKY, alpha=0.5)
    for sign in (-1, 1):
        axes.plot(
            [0, 0], [0.4 * sign, 0.72 * sign], color=BLACK, linewidth=5, solid_capstyle="butt"
        )
        line(axes, (-2.1, 0.0), (0, 0.4 * sign), (1.6, 0), color=ORANGE)
    line(axes, (-2.1, 0), (0, 0), (1.6, 0), color=RED)
    axes.plot([1.6, 1.6], [-0.55, 0.55], color=BLUE, linewidth=4)
    axes.annotate(
        "",
        (1.6, -0.7),
        (0, -0.7),
        arrowprops={"arrowstyle": "<->", "color": GREY, "shrinkA": 0, "shrinkB": 0},
    )
    axes.text(0.8, -0.66, "$d_i$", color=GREY, ha="center", va="bottom")
    axes.annotate(
        "",
        (0.17, 0.4),
        (0.17, 0),
        arrowprops={"arrowstyle": "<->", "color": GREY, "shrinkA": 0, "shrinkB": 0},
    )
    axes.text(0.2, 0.1, "$a'$", color=GREY)
    axes.text(0, 0.76, "stop = exit pupil", ha="center")
    axes.text(1.66, 0.4, "sensor", color=BLUE)
    axes.text(-2.1, 0.12, "from the wall", color=GREY)
    axes.text(-1.1, 0.03, "chief ray", color=RED, va="bottom", ha="center")
    return drawn


def wave_aberration() -> Figure:
    """Reference sphere and wavefront; the phase between them; the spot that it makes."""
    drawn = figure(8.0, 3.2)
    axes = plain(drawn.subplots(), xlim=(-0.35, 3.0), ylim=(-1.15, 1.1))
    u = np.linspace(-0.95, 0.95, 401)
    radius = 2.6
    sphere = radius - np.sqrt(radius**2 - u**2)
    W = 0.55 * (u**4 - 0.9 * u**2)
    axes.plot(sphere, u, color=BLACK, linestyle="--")
    axes.plot(sphere + W, u, color=BLUE, linewidth=2)
    axes.fill_betweenx(u, sphere, sphere + W, color=BLUE, alpha=0.2)
    for at in (-0.85, -0.55, 0.0, 0.55, 0.85):
        k = int(np.argmin(abs(u - at)))
        slope = np.gradient(sphere + W / 6, u)[k]  # the wave is drawn larger than it acts
        start = (sphere[k] + W[k], u[k])
        line(axes, start, (radius, u[k] - slope * (radius - start[0])), color=ORANGE, linewidth=1.0)
    axes.plot([radius, radius], [-0.75, 0.75], color=GREY, linewidth=3)
    axes.plot(radius, 0, "o", color=BLACK, markersize=5)
    axes.text(radius + 0.06, 0, "ideal\nimage\npoint", va="center")
    axes.text(-0.02, 1.0, "reference sphere", ha="left")
    axes.text(-0.1, -0.45, "W", color=BLUE, fontsize=13, ha="right", va="center")
    axes.text(-0.34, -1.1, "wave in the exit pupil", color=BLUE, va="bottom")
    axes.text(1.35, 0.62, "rays, normal to the wave", color=ORANGE, ha="center")
    return drawn


def facets() -> Figure:
    """A rough mirror, and how its slopes spread the light: the lobe is twice as wide as they."""
    drawn = figure(9.0, 3.4)
    left, right = drawn.subplots(1, 2, width_ratios=(1.25, 1))
    plain(left, xlim=(-1.1, 1.1), ylim=(-0.2, 1.0))
    draws = np.random.default_rng(4).normal(size=22) * 0.18
    x = np.linspace(-1.1, 1.1, 23)
    h = np.concatenate([[0], np.cumsum(draws * np.diff(x))])
    h -= np.polyval(np.polyfit(x, h, 1), x)
    left.fill_between(x, -0.2, h, color=GREY, alpha=0.3)
    left.plot(x, h, color=BLACK, linewidth=2)
    for k in (5, 9, 13, 17):
        middle = np.array([(x[k] + x[k + 1]) / 2, (h[k] + h[k + 1]) / 2])
        tangent = np.array([x[k + 1] - x[k], h[k + 1] - h[k]])
        normal = np.array([-tangent[1], tangent[0]]) / np.hypot(*tangent)
        come = np.array([0.5, -1.0]) / np.hypot(0.5, 1.0)
        go = come - 2 * (come @ normal) * normal
        line(left, tuple(middle - 0.75 * come), tuple(middle), color=RED, linewidth=1.0)
        line(left, tuple(middle), tuple(middle + 0.75 * go), color=ORANGE, linewidth=1.0)
    left.set_title("facets with random slopes")
    angle = np.linspace(-25, 25, 501)
    for slope, colour in ((0.02, BLUE), (0.05, GREEN), (0.1, PINK)):
        width = np.degrees(2 * slope)
        right.plot(
            angle, np.exp(-0.5 * (angle / width) ** 2), color=colour, label=f"{slope} rad rms"
        )
    right.set(xlabel="angle from the mirror direction, °", ylabel="light, relative to its peak")
    right.legend(frameon=False)
    right.set_title("pattern of the reflected light")
    return drawn


def shadow() -> Figure:
    """Two bright cells past a disc: each leaves its own shadow on the matt wall."""
    drawn = figure(8.0, 4.6)
    sketch, light = drawn.subplots(2, 1, height_ratios=(2.2, 1), sharex=True)
    height, disc = 1.0, (0.5, 0.13)  # of the object, and height and radius of the disc, m
    wall = np.linspace(-0.9, 0.9, 1801)
    total = np.zeros_like(wall)
    sketch.plot([-0.9, 0.9], [0, 0], color=BLACK, linewidth=4)
    sketch.plot(
        [-disc[1], disc[1]], [disc[0]] * 2, color=ORANGE, linewidth=6, solid_capstyle="butt"
    )
    for cell, colour in ((-0.35, BLUE), (0.25, GREEN)):
        edges = [cell + (edge - cell) * height / (height - disc[0]) for edge in (-disc[1], disc[1])]
        sketch.fill(
            [-disc[1], disc[1], edges[1], edges[0]],
            [disc[0], disc[0], 0, 0],
            color=colour,
            alpha=0.25,
            linewidth=0,
        )
        for edge in edges:
            sketch.plot([cell, edge], [height, 0], color=colour, linewidth=1.0)
        sketch.plot(cell, height, "o", color=colour, markersize=9)
        irradiance = height**4 / (height**2 + (wall - cell) ** 2) ** 2
        irradiance[(wall > edges[0]) & (wall < edges[1])] = 0
        light.plot(wall, irradiance, color=colour, linewidth=1.2)
        total += irradiance
    light.plot(wall, total, color=BLACK, linewidth=2)
    sketch.text(0.16, disc[0], "occluder", color=ORANGE, va="center")
    sketch.text(-0.05, height, "two parts of the object", ha="center", va="bottom", color=GREY)
    sketch.text(0.9, 0.05, "matt wall", ha="right")
    sketch.set(aspect="auto", ylim=(-0.05, 1.12))
    sketch.axis("off")
    light.set(
        xlabel="place on the wall, m", ylabel="light", yticks=(), xlim=(-0.9, 0.9), ylim=(0, None)
    )
    light.text(-0.88, total.max() * 0.9, "sum: what the camera sees", va="top")
    return drawn


def phasors() -> Figure:
    """Wall points as virtual emitters: their waves agree at one voxel, and cancel elsewhere."""
    drawn = figure(8.0, 4.4)
    axes = drawn.subplots()
    wavelength, focus = 0.12, np.array([0.15, 0.75])
    x, z = np.meshgrid(np.linspace(-0.8, 0.8, 401), np.linspace(0.02, 1.1, 271))
    field = np.zeros_like(x, dtype=complex)
    for point in np.linspace(-0.5, 0.5, 41):
        far = np.hypot(x - point, z)
        delay = np.hypot(focus[0] - point, focus[1])
        field += np.exp(2j * np.pi * (far - delay) / wavelength) / far
    axes.pcolormesh(
        x, z, abs(field) / abs(field[z > 0.3]).max(), cmap="Blues", vmax=1.0, rasterized=True
    )
    axes.plot([-0.5, 0.5], [0, 0], color=BLACK, linewidth=5)
    for point in (-0.45, 0.0, 0.45):
        axes.annotate(
            "", focus, (point, 0), arrowprops={"arrowstyle": "-|>", "color": RED, "lw": 1.2}
        )
    axes.plot(*focus, "+", color=RED, markersize=12)
    axes.text(focus[0] + 0.06, focus[1], "a voxel in focus", color=RED, va="center")
    axes.text(0, -0.06, "wall points: lens and sensor of the virtual camera", ha="center", va="top")
    axes.set(aspect="equal", ylim=(-0.15, 1.1), xticks=(), yticks=())
    for side in axes.spines.values():
        side.set_visible(False)
    return drawn
