"""Ray aiming by walls defined by a Python function, for all pupil nodes at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._vectors import Array
from ...scene import Wall
from . import _aiming_kernels


def aim(wall: Wall, o: Array, nodes: Array, starts: Array, axis: Array, out: Array) -> None:
    """Fill ``out`` (n, 8) with the stationary paths; the columns are those of the kernel `aim`.

    Newton's method with backtracking on the gradient of each path.
    """

    def stationarity(rows: NDArray[np.int64], at: Array) -> Array:
        found = np.empty((len(rows), 5))
        _aiming_kernels.stationarities(
            o, nodes[rows], at, wall.derivatives(at[:, 0], at[:, 1]), found
        )
        return found

    points = starts.copy()
    state = stationarity(np.arange(len(nodes)), points)
    norm = np.hypot(state[:, 0], state[:, 1])
    active = np.flatnonzero(norm > 0)
    for _ in range(60):
        gx, gy, hxx, hxy, hyy = state[active].T
        det = hxx * hyy - hxy * hxy
        steep = np.abs(det) >= 1e-14 * np.abs(state[active, 2:]).max(axis=1, initial=0.0) ** 2
        active, gx, gy, hxx, hxy, hyy, det = (
            a[steep] for a in (active, gx, gy, hxx, hxy, hyy, det)
        )
        step = -np.stack([hyy * gx - hxy * gy, hxx * gy - hxy * gx], axis=1) / det[:, None]
        waiting, moved = np.arange(len(active)), []
        for halving in range(40):
            if not len(waiting):
                break
            rows = active[waiting]
            trial = points[rows] + 0.5**halving * step[waiting]
            found = stationarity(rows, trial)
            length = np.hypot(found[:, 0], found[:, 1])
            better = length < norm[rows]
            kept = rows[better]
            points[kept], state[kept], norm[kept] = trial[better], found[better], length[better]
            moved.append(kept)
            waiting = waiting[~better]
        active = np.sort(np.concatenate(moved)) if moved else active[:0]
        active = active[norm[active] > 0]
        if not len(active):
            break
    # Rounding stops the descent. The error of the paths is of second order in the gradient left.
    surfaces = wall.derivatives(points[:, 0], points[:, 1])
    _aiming_kernels.describe(o, nodes, points, surfaces, axis, out)
    out[:, 7] = norm < _aiming_kernels.ROUNDED
