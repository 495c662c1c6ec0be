"""The figure of world and camera frames, drawn over the sketch of an example scene."""

from pathlib import Path

import numpy as np
from tables import ROOT, figure

from nlosoptics import Scene, views

LENGTH = 0.3  # of the arrows, m


def pages(target: Path) -> None:
    """Write ``frames.svg`` into a folder."""
    scene = Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml")
    drawn = figure(10.5, 5.6)
    top, side = views.scene_sketch(scene, axes=drawn.subplots(1, 2))
    position = np.array(scene.camera.position)
    e1, e2, n = scene.camera.frame
    arrows = [
        (np.zeros(3), np.eye(3)[i], f"${name}$", "#000000") for i, name in enumerate("xyz")
    ] + [
        (position, axis, f"${name}$", "#0072B2")
        for axis, name in ((e1, "e_1"), (e2, "e_2"), (n, "n"))
    ]
    for view, (across, up) in ((top, (0, 2)), (side, (2, 1))):
        for start, axis, name, colour in arrows:
            step = LENGTH * axis[[across, up]]
            if np.hypot(*step) < 0.75 * LENGTH:  # toward the viewer
                continue
            begin = start[[across, up]]
            view.annotate(
                "",
                begin + step,
                begin,
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8},
            )
            view.annotate(
                name,
                begin + 1.2 * step,
                color=colour,
                ha="center",
                va="center",
                fontsize=13,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
            )
    for view in (top, side):
        if view.get_legend() is not None:
            view.get_legend().remove()
    handles, labels = top.get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=4)
    views.save(drawn, target / "frames.svg")
