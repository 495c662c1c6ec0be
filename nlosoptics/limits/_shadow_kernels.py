"""Parts of a rectangle of cells that a point sees past opaque triangles."""

from __future__ import annotations

import numpy as np
from numba import prange

from ..kernels.compiling import njit

NEAR = 1e-9  # nearest and farthest part of a path, as a fraction, that an occluder can block


@njit(cache=True)
def _clipped(corners, depth, count, level, above, out, out_depth):
    """Clip a convex polygon to depths above or below a level; return the number of corners left.

    ``corners`` (count, 2) and ``depth`` (count,) hold the polygon, ``out`` and ``out_depth`` get
    the result.
    """
    kept = 0
    for i in range(count):
        j = (i + 1) % count
        first, second = depth[i] - level, depth[j] - level
        if not above:
            first, second = -first, -second
        if first >= 0.0:
            out[kept] = corners[i]
            out_depth[kept] = depth[i]
            kept += 1
        if (first >= 0.0) != (second >= 0.0):
            t = first / (first - second)
            out[kept] = corners[i] + t * (corners[j] - corners[i])
            out_depth[kept] = depth[i] + t * (depth[j] - depth[i])
            kept += 1
    return kept


@njit(cache=True)
def hide(point, vertices, faces, frame, samples):
    """Set those samples of a rectangle to 0 that triangles hide from a point."""
    rows, columns = samples.shape
    height = 0.0
    for k in range(3):
        height += frame[3, k] * (frame[0, k] - point[k])
    if height == 0.0:
        return
    at = np.zeros(2)
    for i in range(2):
        for k in range(3):
            at[i] += frame[1 + i, k] * (point[k] - frame[0, k])
    # for each vertex its depth, 1 on the rectangle's plane, its offset from the point along the
    # sides, and its perspective projection in units of samples
    seen = np.empty((len(vertices), 5))
    for v in range(len(vertices)):
        depth, across, up = 0.0, 0.0, 0.0
        for k in range(3):
            step = vertices[v, k] - point[k]
            depth += frame[3, k] * step / height
            across += frame[1, k] * step
            up += frame[2, k] * step
        seen[v, 0], seen[v, 1], seen[v, 2] = depth, across, up
        if depth > NEAR:
            seen[v, 3] = (at[0] + across / depth) * columns
            seen[v, 4] = (at[1] + up / depth) * rows
    corners, other = np.empty((5, 2)), np.empty((5, 2))
    depth, other_depth = np.empty(5), np.empty(5)
    for t in range(len(faces)):
        nearest, farthest = np.inf, -np.inf
        for c in range(3):
            level = seen[faces[t, c], 0]
            nearest, farthest = min(nearest, level), max(farthest, level)
        if farthest < NEAR or nearest > 1.0 - NEAR:
            continue
        count = 3
        if nearest >= NEAR and farthest <= 1.0 - NEAR:
            for c in range(3):
                corners[c, 0], corners[c, 1] = seen[faces[t, c], 3], seen[faces[t, c], 4]
        else:
            for c in range(3):
                v = faces[t, c]
                depth[c], corners[c, 0], corners[c, 1] = seen[v, 0], seen[v, 1], seen[v, 2]
            count = _clipped(corners, depth, 3, NEAR, True, other, other_depth)
            count = _clipped(other, other_depth, count, 1.0 - NEAR, False, corners, depth)
            for c in range(count):
                corners[c, 0] = (at[0] + corners[c, 0] / depth[c]) * columns
                corners[c, 1] = (at[1] + corners[c, 1] / depth[c]) * rows
        if count >= 3:
            _fill(corners, count, samples)


@njit(cache=True)
def _fill(corners, count, samples):
    """Set those samples to 0 that lie in a convex polygon, in units of samples (count, 2)."""
    rows, columns = samples.shape
    low, high, west, east = np.inf, -np.inf, np.inf, -np.inf
    for c in range(count):
        low, high = min(low, corners[c, 1]), max(high, corners[c, 1])
        west, east = min(west, corners[c, 0]), max(east, corners[c, 0])
    if east < 0.5 or west > columns - 0.5:
        return
    first = max(0, int(np.ceil(max(low, -1.0) - 0.5)))
    last = min(rows - 1, int(np.floor(min(high, rows + 1.0) - 0.5)))
    for row in range(first, last + 1):
        y = row + 0.5
        left, right = np.inf, -np.inf
        for c in range(count):
            d = (c + 1) % count
            y0, y1 = corners[c, 1], corners[d, 1]
            if (y0 <= y) != (y1 <= y):
                x = corners[c, 0] + (y - y0) / (y1 - y0) * (corners[d, 0] - corners[c, 0])
                left, right = min(left, x), max(right, x)
        start = max(0, int(np.ceil(max(left, -1.0) - 0.5)))
        stop = min(columns - 1, int(np.floor(min(right, columns + 1.0) - 0.5)))
        for column in range(start, stop + 1):
            samples[row, column] = 0


@njit(cache=True, parallel=True)
def seen_shares(points, open_paths, vertices, faces, frame, lit, cells):
    """Return the share of each cell that is lit and seen, averaged over groups of points.

    Returns shares, 0 to 1; cells in rows.
    """
    n_y, n_x = cells
    down, across = lit.shape[0] // n_y, lit.shape[1] // n_x
    out = np.zeros((len(points), n_y * n_x))
    scale = 1.0 / (down * across * points.shape[1])
    for group in prange(len(points)):
        samples = np.empty_like(lit)
        for k in range(points.shape[1]):
            if not open_paths[group, k]:
                continue
            samples[:] = lit
            hide(points[group, k], vertices, faces, frame, samples)
            for row in range(n_y):
                for column in range(n_x):
                    count = 0
                    for i in range(row * down, (row + 1) * down):
                        for j in range(column * across, (column + 1) * across):
                            count += samples[i, j]
                    out[group, row * n_x + column] += count
        for cell in range(n_y * n_x):
            out[group, cell] *= scale
    return out
