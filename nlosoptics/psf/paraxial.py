"""Second-order optics of a scene in closed form: no ray is aimed, no wave is sampled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene import Scene

Array = NDArray[np.float64]


def wave_bends(scene: Scene, points: Array) -> Array:
    """Second derivatives of W over the lens, for object points.

    Parameters
    ----------
    scene : Scene
    points : ndarray, (n, 3)
        World, m.

    Returns
    -------
    ndarray, (n, 2, 2)
        Along the camera's e1 and e2, 1/m: that of the wall, ``-(cos_i + cos_o) M_0^T K M``, and of
        the focus. M_0 is M of a flat wall. The wall is taken where it would be met if it were
        flat, so slopes of the mean wall are left out.
    """
    e1, e2, axis = scene.camera.frame
    lens = np.array(scene.camera.position)
    mirrored = points * (1.0, 1.0, -1.0)
    depth = (mirrored - lens) @ axis
    share = lens[2] / (lens[2] - mirrored[:, 2])
    hits = lens + share[:, None] * (mirrored - lens)
    legs = points - hits, lens - hits
    lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
    units = [leg / length[:, None] for leg, length in zip(legs, lengths, strict=True)]
    cos_sum = units[0][:, 2] + units[1][:, 2]
    flat = np.zeros((len(points), 2, 2))
    for unit, length in zip(units, lengths, strict=True):
        inside = unit[:, :2]
        flat += (np.eye(2) - inside[:, :, None] * inside[:, None, :]) / length[:, None, None]
    axes = np.stack([e1, e2])
    across = axes - (units[1] @ axes.T)[:, :, None] * units[1][:, None, :]
    into = np.swapaxes(across[:, :, :2], 1, 2) / lengths[1][:, None, None]
    focus = (1 / depth - 1 / scene.focus_distance)[:, None, None] * np.eye(2)
    if scene.wall.is_flat:
        return np.asarray(focus)
    _, _, _, xx, xy, yy = scene.wall.derivatives(hits[:, 0], hits[:, 1]).T
    bend = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    first = np.linalg.solve(flat, into)
    seen = np.linalg.solve(flat - cos_sum[:, None, None] * bend, into)
    wall = -cos_sum[:, None, None] * np.swapaxes(first, 1, 2) @ bend @ seen
    return np.asarray(wall + focus)
