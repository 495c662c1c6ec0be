"""Light of a whole picture at wall points, past exact shadows, without a matrix."""

from __future__ import annotations

import numpy as np

from ..kernels.compiling import njit
from ._penumbra_kernels import _buffers, _differences, _light, _shadow


@njit(cache=True, nogil=True)
def fill_sums(nodes, frame, plane, mesh, speeds, spot, wall, source, right, wide, out):
    """Fill ``out`` (n, 2) with the mean radiance of wall points past the shadows, and without.

    The source's samples are blocks of cells of a picture, see `_put` for ``right``. Unless pixels
    are ``wide``, the light without shadows is that of their middle point.
    """
    points, normals, weights, lens = nodes
    shape, light, total = source[0].shape, np.empty(source[0].shape), np.zeros((1, 1))
    rows, columns = right.shape
    tall, side = rows // shape[0], columns // shape[1]
    buffers, pieces = _buffers(mesh, spot), np.empty((256, 4))
    beyond, none = np.zeros((rows, shape[1])), np.empty((0, 0))
    middle, whole = points.shape[1] // 2, 0.0
    for p in range(len(points)):
        out[p] = 0.0
        if weights[p, middle] == 0.0:
            continue
        for k in range(points.shape[1]):
            if weights[p, k] == 0.0:
                continue
            if wide or out[p, 1] == 0.0:
                at = k if wide else middle
                _light(points[p, at], normals[p, at], lens[at], plane, wall, source, light)
                whole = 0.0
                for row in range(rows):
                    from_right = 0.0
                    for block in range(shape[1] - 1, -1, -1):
                        beyond[row, block] = from_right
                        from_right += light[row // tall, block] * right[row, block * side]
                    whole += from_right
            pieces, n = _shadow(
                points, p, k, frame, (rows, columns), mesh, speeds, spot, buffers, pieces
            )
            total[0, 0] = 0.0
            weighed = light, right, beyond, total
            _differences(buffers[0], pieces, n, (rows, columns), none, weighed)
            out[p, 0] += weights[p, k] * max(whole - total[0, 0], 0.0)
            out[p, 1] += weights[p, k] * whole
