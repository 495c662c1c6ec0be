"""Compiled occlusion test between two points, with a tree of boxes over a mesh."""

from __future__ import annotations

from ...kernels.compiling import njit
from ...raytrace.intersection._triangle_kernels import after

FEW = 24  # number of triangles up to which all are tested without the tree
EDGE = 1e-12  # tolerance in barycentric coordinates, so that adjacent triangles leave no gap
NEAR = 1e-9  # of the connection's length, to ignore the surfaces on which its ends lie


@njit(cache=True)
def _crossed(row, p, d):
    """Whether the segment p + t d, 0 < t < 1, crosses a triangle: Moeller and Trumbore 1997."""
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    x, y, z = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
    det = ax * x + ay * y + az * z
    if det == 0.0:
        return False
    inverse = 1.0 / det
    sx, sy, sz = p[0] - row[0], p[1] - row[1], p[2] - row[2]
    u = inverse * (sx * x + sy * y + sz * z)
    if u < -EDGE or u > 1.0 + EDGE:
        return False
    x, y, z = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    v = inverse * (d[0] * x + d[1] * y + d[2] * z)
    if v < -EDGE or u + v > 1.0 + EDGE:
        return False
    t = inverse * (bx * x + by * y + bz * z)
    return NEAR < t < 1.0 - NEAR


@njit(cache=True)
def _misses(box, p, inverse):
    """Whether the segment p + t d, 0 < t < 1, misses a box; ``inverse`` is 1/d, finite."""
    low, high = 0.0, 1.0
    for k in range(3):
        a, b = (box[k] - p[k]) * inverse[k], (box[3 + k] - p[k]) * inverse[k]
        low, high = max(low, min(a, b)), min(high, max(a, b))
    return low > high


@njit(cache=True)
def _inverse(x):
    return 1.0 / x if abs(x) > 1e-300 else 1e300


@njit(cache=True)
def blocked(rows, boxes, p, d):
    """Whether a triangle lies between p and p + d; both ends may lie on triangles."""
    if rows.shape[0] <= FEW:
        for m in range(rows.shape[0]):  # noqa: SIM110  (numba has no any() of generators)
            if _crossed(rows[m], p, d):
                return True
        return False
    inverse = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    first_leaf = boxes.shape[0] // 2
    node = 0
    while node >= 0:
        if _misses(boxes[node], p, inverse):
            node = after(node)
            continue
        if node < first_leaf:
            node = 2 * node + 1
            continue
        start = 4 * (node - first_leaf)
        for m in range(start, min(start + 4, rows.shape[0])):
            if _crossed(rows[m], p, d):
                return True
        node = after(node)
    return False
