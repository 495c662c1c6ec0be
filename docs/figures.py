"""Draw the pictures of the README: ``python docs/figures.py``.

The first shows what its commands make; run it again when those change. The picture
of peers is drawn from the stored results of ``benchmarks/psf_peers.py``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import nlosoptics as nlos
from nlosoptics import limits, views
from nlosoptics.scene import Scene
from nlosoptics.views.canvas import BLACK, BLUE, BROWN, GREEN, ORANGE, VERMILION, new_axes

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "examples" / "scenes"
FIGURES = ROOT / "docs" / "figures"
FLOOR = 1.35  # m from the wall, where the picture ends


def arrows(axes: Axes, path: np.ndarray, **style: object) -> None:
    """Draw a path in the x-z plane with an arrow head in the middle of each of its legs."""
    axes.plot(path[:, 0], path[:, 2], **style)
    for start, end in zip(path[:-1, [0, 2]], path[1:, [0, 2]], strict=True):
        middle = start + 0.55 * (end - start)
        head = {"arrowstyle": "-|>", "color": style["color"], "mutation_scale": 20, "shrinkB": 0}
        axes.annotate("", middle, start, arrowprops=head | {"linewidth": 0})


@dataclass(frozen=True)
class Row:
    """A scene, its titles and names, where that of the occluder stands, and what is drawn, m."""

    scene: str
    titles: tuple[str, str, str]
    hidden: str
    occluder: tuple[str, float, float]  # name, x, z
    ends: tuple[float, float]  # x of the drawing's sides


CHART = Row(
    "corner",
    ("A partition hides the chart", "What the camera records", "What nlosoptics recovers"),
    "hidden\neye chart",
    ("partition", -0.26, 1.32),
    (-0.78, 0.78),
)
LETTER = Row(
    "letter_discs",
    ("A matt wall, discs before a letter", "Shadows on the wall", "Recovered from the shadows"),
    "hidden letter",
    ("discs", 0.14, 0.34),
    (-1.0, 1.45),
)


def room(row: Row, scene: Scene, axes: Axes) -> None:
    """Draw the room from above, with every part named where it is."""
    x = np.linspace(-0.5, 0.5, 201) * scene.wall.size[0]
    axes.plot(x, scene.wall.height(x, 0 * x), color=BLACK, linewidth=4)
    camera, laser, hidden = map(
        np.asarray, (scene.camera.position, scene.laser.position, scene.object_point)
    )
    spot = np.array([scene.laser.aim[0], 0.0, float(scene.wall.height(*scene.laser.aim[:2]))])
    seen = np.array(scene.camera.aim)
    for occluder in scene.occluders:
        low, high = occluder.surface.bounds[:, [0, 2]]
        if high[0] - low[0] < high[1] - low[1]:  # upright, and thin
            axes.vlines((low + high)[0] / 2, low[1], min(high[1], FLOOR), color=BROWN, linewidth=7)
        else:
            axes.hlines((low + high)[1] / 2, low[0], high[0], color=BROWN, linewidth=4)
    arrows(axes, np.array([laser, spot]), color=VERMILION, linewidth=2)
    arrows(axes, np.array([spot, hidden, seen, camera]), color=ORANGE, linewidth=2)
    half = scene.hidden.size[0] / 2
    axes.plot(hidden[0] + np.array([-half, half]), [hidden[2]] * 2, color=GREEN, linewidth=6)
    axes.plot(camera[0], camera[2], "s", color=BLUE, markersize=14)
    style = {"ha": "center", "fontsize": 15}
    axes.text(0, -0.06, "wall", color=BLACK, **style)
    axes.text(camera[0] - 0.05, camera[2] + 0.03, "camera", color=BLUE, ha="right", fontsize=15)
    axes.text(laser[0], laser[2] + 0.12, "laser", color=VERMILION, **style)
    axes.text(hidden[0], hidden[2] + 0.12, row.hidden, color=GREEN, va="top", **style)
    name, x, z = row.occluder
    axes.text(x, z, name, color=BROWN, **style)
    axes.set(xlim=row.ends, ylim=(1.43, -0.17), aspect="equal")
    axes.axis("off")


def draw(row: Row, axes: Sequence[Axes]) -> None:
    """Draw room, camera image and reconstruction of a scene."""
    scene = nlos.Scene.load(SCENES / f"{row.scene}.toml")
    result = nlos.simulate(scene, seed=0, reconstruct=True)
    room(row, scene, axes[0])
    views.image(result.image, object_scale=limits.object_scale(scene), axes=axes[1])
    for length in axes[1].texts:
        length.set(text=length.get_text().removesuffix(" on the object"), fontsize=15)
    mirrored = bool(scene.wall_material.mirror_lobes)
    views.reconstruction(result.reconstruction, mirrored=mirrored, axes=axes[2:])
    for drawn in axes[1:]:
        drawn.child_axes[0].remove()
        drawn.axis("off")
    for drawn, title in zip(axes, row.titles, strict=True):
        drawn.set_title(title, fontsize=17)


def lead() -> None:
    """Draw a glossy and a matt wall, each in a row, and the glossy one stacked for phones."""
    axes = new_axes(6, columns=3, width=13.5, height=9.4)
    draw(CHART, axes[:3])
    draw(LETTER, axes[3:])
    views.save(axes, FIGURES / "two_walls.png")
    tall = Figure(figsize=(4.5, 12.9), layout="constrained").subplots(3, 1)
    draw(CHART, tall)
    views.save(tall, FIGURES / "corner_tall.png")


def peers() -> None:
    """Draw run time against error of point spread functions by nlosoptics and its peers."""
    sys.path.insert(0, str(ROOT / "docs" / "_ext"))
    from performance.point_spreads import draw_psf_peers
    from tables import rows

    views.save(draw_psf_peers(rows("psf_peers.json")), FIGURES / "psf_peers.png")


if __name__ == "__main__":
    lead()
    peers()
