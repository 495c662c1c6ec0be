"""Compiled moveout of the paths of a single laser point to confocal paths."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.parallel import threaded


@threaded()
def dip_moveout(series, corner, pitch, points, spacing, start, width, first, moved):
    """Fill ``moved`` (n, m) with the paths whose ellipsoids touch confocal spheres about points.

    ``series`` (ny, nx, n_bins) is the light at sensors from ``corner`` on in steps of ``pitch``,
    both (x, y) relative to the laser point, with bins of ``width`` from ``start``, m. ``points``
    (n, 2) are relative to the laser point, too. The bins of ``moved`` begin at ``first``. Sensors
    beyond a point, as seen from the laser, contribute, in steps of at most ``spacing``.
    """
    ny, nx, n_bins = series.shape
    ends = corner + pitch * np.array([nx - 1.0, ny - 1.0])
    reach = math.hypot(max(abs(corner[0]), abs(ends[0])), max(abs(corner[1]), abs(ends[1])))
    for p in prange(len(points)):
        away = math.hypot(points[p, 0], points[p, 1])
        across, up = (points[p, 0] / away, points[p, 1] / away) if away > 0.0 else (1.0, 0.0)
        away = max(away, 0.05 * spacing)
        moved[p] = 0.0
        apart = away
        while apart < reach:
            # the range that matters is proportional to the distance from the laser
            step = min(spacing, 0.1 * apart)
            apart += step
            x, y = (apart * across - corner[0]) / pitch[0], (apart * up - corner[1]) / pitch[1]
            if not (0.0 <= x <= nx - 1 and 0.0 <= y <= ny - 1):
                continue  # a laser point beside the grid
            i, j = min(int(x), nx - 2), min(int(y), ny - 2)
            a, b = x - i, y - j
            share = 1.0 - (2.0 * away / apart - 1.0) ** 2
            for k in range(moved.shape[1]):
                path = first + (k + 0.5) * width
                whole = math.sqrt(path * path / share + apart * apart)
                u = (whole - start) / width - 0.5
                t = int(math.floor(u))
                if t < 0 or t > n_bins - 2:
                    continue
                c, total = u - t, 0.0
                for near, weight in ((t, 1.0 - c), (t + 1, c)):
                    low = (1.0 - a) * series[j, i, near] + a * series[j, i + 1, near]
                    high = (1.0 - a) * series[j + 1, i, near] + a * series[j + 1, i + 1, near]
                    total += weight * ((1.0 - b) * low + b * high)
                moved[p, k] += step * total * path / (share * whole)
