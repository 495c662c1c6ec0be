"""The figure of a letter in each layout of capture files, as stored and as seen from the wall."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat
from tables import figure

from nlosoptics import views
from nlosoptics.transient import TransientCapture, wall_grid

#: An F for a viewer who looks from the wall into the room; the top row comes first.
LETTER = np.array(
    [[int(cell == "#") for cell in row] for row in (".####", ".#...", ".###.", ".#...")]
)


def pages(target: Path) -> None:
    """Write ``layouts.svg`` into a folder."""
    wall = wall_grid(1.0, 7)
    F = np.zeros((7, 7))
    F[2:6, 1:6] = LETTER[::-1, ::-1]  # y grows upward, and x to the left of this viewer
    ours = TransientCapture(
        H=F[None], laser_points=wall, sensor_points=wall, delta_t=0.1, pairing="confocal"
    )
    drawn = figure(9.0, 4.6)
    panels = drawn.subplots(2, 3)
    with tempfile.TemporaryDirectory() as folder:
        first, second, third = (Path(folder) / f"letter.{end}" for end in ("hdf5", "mat", "npy"))
        ours.save(first)
        with h5py.File(first) as file:
            tal = file["H"][0]
        lct = F[::-1].T
        savemat(second, {"rect_data": lct[:, :, None], "width": 0.5})
        np.save(third, F[::-1, :, None])
        plain = {"array": "array", "axes": "-y,x,t", "side": 1.0}
        captures = [
            ("this library and y-tal, H[t, x, y]", tal, TransientCapture.load(first)),
            ("LCT, rect_data[x, -y, t]", lct, TransientCapture.load(second, delta_t=0.1)),
            (
                'an array with axes "-y,x,t"',
                F[::-1],
                TransientCapture.load(third, delta_t=0.1, **plain),
            ),
        ]
    for (name, stored, capture), (above, below) in zip(captures, panels.T, strict=True):
        above.imshow(stored, cmap="Greys")
        above.set(title=name, xlabel="second spatial index", ylabel="first spatial index")
        x, y = (capture.sensor_points[..., k] for k in (0, 1))
        below.pcolormesh(x, y, capture.H[0], cmap="Greys")
        below.set(title="seen from the wall", xlabel="x, m", ylabel="y, m", aspect="equal")
        below.set(xticks=(-0.4, 0.0, 0.4), yticks=(-0.4, 0.0, 0.4))
        below.invert_xaxis()
    views.save(drawn, target / "layouts.svg")
