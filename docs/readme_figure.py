"""Draw the README's first picture: ``python docs/readme_figure.py``."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

import nlosoptics as nlos
from nlosoptics import limits, views
from nlosoptics.scene import Scene
from nlosoptics.views.canvas import new_axes
from nlosoptics.views.palette import BLACK, BLUE, BROWN, GREEN, ORANGE, VERMILION

ROOT = Path(__file__).parents[1]
FLOOR = 1.35  # m from the wall, where the picture ends


def room(scene: Scene, axes: Axes) -> None:
    """Draw the room from above, with every part named where it is."""
    x = np.linspace(-0.5, 0.5, 201) * scene.wall.size[0]
    axes.plot(x, scene.wall.height(x, 0 * x), color=BLACK, linewidth=4)
    camera, laser, hidden = scene.camera.position, scene.laser.position, scene.object_point
    spot = np.array([scene.laser.aim[0], 0.0, float(scene.wall.height(*scene.laser.aim[:2]))])
    low, high = scene.occluding_mesh.bounds
    partition = [low[2], min(high[2], FLOOR)]
    axes.plot([(low + high)[0] / 2] * 2, partition, color=BROWN, linewidth=7, solid_capstyle="butt")
    axes.plot([laser[0], spot[0]], [laser[2], spot[2]], color=VERMILION, linewidth=2)
    path = np.array([spot, hidden, (0, 0, 0), camera])
    axes.plot(path[:, 0], path[:, 2], color=ORANGE, linestyle="--")
    half = scene.hidden.size[0] / 2
    axes.plot(hidden[0] + np.array([-half, half]), [hidden[2]] * 2, color=GREEN, linewidth=5)
    axes.plot(camera[0], camera[2], "s", color=BLUE, markersize=11)
    style = {"ha": "center", "fontsize": 12}
    axes.text(0, -0.07, "relay wall", color=BLACK, **style)
    axes.text(camera[0] - 0.16, camera[2] + 0.02, "camera", color=BLUE, **style)
    axes.text(laser[0], laser[2] + 0.1, "laser", color=VERMILION, **style)
    axes.text(hidden[0], hidden[2] + 0.11, "hidden chart", color=GREEN, **style)
    axes.text(-0.05, 1.3, "partition", color=BROWN, fontsize=12, ha="right")
    axes.plot([0.4, 0.65], [1.36, 1.36], color=BLACK, linewidth=2)
    axes.text(0.525, 1.33, "0.25 m", **style)
    axes.set(xlim=(-0.72, 0.72), ylim=(1.42, -0.17), aspect="equal")
    axes.axis("off")


if __name__ == "__main__":
    scene = nlos.Scene.load(ROOT / "examples" / "scenes" / "corner.toml")
    result = nlos.simulate(scene, seed=0, reconstruct=True)
    axes = new_axes(3, width=13.5, height=4.9)
    room(scene, axes[0])
    views.image(result.image, object_scale=limits.object_scale(scene), axes=axes[1])
    views.reconstruction(result.reconstruction, axes=axes[2:])
    for drawn in axes[1:]:
        drawn.child_axes[0].remove()
        drawn.axis("off")
    for drawn, title in zip(
        axes,
        ("Room, from above", "Camera image", "Reconstruction"),
        strict=True,
    ):
        drawn.set_title(title, fontsize=15)
    views.save(axes, ROOT / "docs" / "figures" / "corner.png")
