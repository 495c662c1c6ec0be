"""Draw the pictures of the README: ``python docs/figures.py``.

The first shows what its commands make; run it again when those change. The picture
of peers is drawn from the stored results of ``benchmarks/psf_peers.py``.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import nlosoptics as nlos
from nlosoptics import limits, views
from nlosoptics.scene import Scene
from nlosoptics.views.canvas import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, VERMILION, new_axes

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


def room(scene: Scene, axes: Axes) -> None:
    """Draw the room from above, with every part named where it is."""
    x = np.linspace(-0.5, 0.5, 201) * scene.wall.size[0]
    axes.plot(x, scene.wall.height(x, 0 * x), color=BLACK, linewidth=4)
    camera, laser, hidden = scene.camera.position, scene.laser.position, scene.object_point
    spot = np.array([scene.laser.aim[0], 0.0, float(scene.wall.height(*scene.laser.aim[:2]))])
    low, high = scene.occluding_mesh.bounds
    partition = [low[2], min(high[2], FLOOR)]
    axes.plot([(low + high)[0] / 2] * 2, partition, color=BROWN, linewidth=7, solid_capstyle="butt")
    sight = np.array([camera, camera + (hidden - camera) * 0.4])
    axes.plot(sight[:, 0], sight[:, 2], color=GREY, linestyle=":", linewidth=2)
    axes.text(-0.045, 0.9, "×", color=GREY, fontsize=24, ha="center", va="center")
    arrows(axes, np.array([laser, spot]), color=VERMILION, linewidth=2)
    arrows(axes, np.array([spot, hidden, (0, 0, 0), camera]), color=ORANGE, linewidth=2)
    half = scene.hidden.size[0] / 2
    axes.plot(hidden[0] + np.array([-half, half]), [hidden[2]] * 2, color=GREEN, linewidth=6)
    axes.plot(camera[0], camera[2], "s", color=BLUE, markersize=14)
    style = {"ha": "center", "fontsize": 15}
    axes.text(0, -0.06, "wall", color=BLACK, **style)
    axes.text(camera[0] - 0.05, camera[2] + 0.03, "camera", color=BLUE, ha="right", fontsize=15)
    axes.text(laser[0], laser[2] + 0.12, "laser", color=VERMILION, **style)
    axes.text(hidden[0], hidden[2] + 0.12, "hidden\neye chart", color=GREEN, va="top", **style)
    axes.text(-0.05, 1.32, "partition", color=BROWN, fontsize=15, ha="right")
    axes.set(xlim=(-0.78, 0.78), ylim=(1.39, -0.17), aspect="equal")
    axes.axis("off")


def lead() -> None:
    """Draw the room, the camera image and the reconstruction: in a row, and stacked for phones."""
    scene = nlos.Scene.load(SCENES / "corner.toml")
    result = nlos.simulate(scene, seed=0, reconstruct=True)
    titles = ("A partition hides the chart", "What the camera records", "What nlosoptics recovers")
    row = new_axes(3, width=13.5, height=4.9)
    tall = Figure(figsize=(4.5, 12.9), layout="constrained").subplots(3, 1)
    for axes, name in ((row, "corner.png"), (tall, "corner_tall.png")):
        room(scene, axes[0])
        views.image(result.image, object_scale=limits.object_scale(scene), axes=axes[1])
        (length,) = axes[1].texts
        length.set(text=length.get_text().removesuffix(" on the object"), fontsize=15)
        views.reconstruction(result.reconstruction, axes=axes[2:])
        for drawn in axes[1:]:
            drawn.child_axes[0].remove()
            drawn.axis("off")
        for drawn, title in zip(axes, titles, strict=True):
            drawn.set_title(title, fontsize=17)
        views.save(axes, FIGURES / name)


def peers() -> None:
    """Draw run time against error of point spread functions by nlosoptics and its peers."""
    sys.path.insert(0, str(ROOT / "docs" / "_ext"))
    from performance.point_spreads import draw_psf_peers
    from tables import rows

    views.save(draw_psf_peers(rows("psf_peers.json")), FIGURES / "psf_peers.png")


if __name__ == "__main__":
    lead()
    peers()
