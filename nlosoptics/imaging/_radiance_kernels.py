"""Light that groups of object patches send to the wall points of pixels."""

from __future__ import annotations

import math

import numpy as np

from ..kernels.compiling import njit


@njit(cache=True, nogil=True)
def arriving(flux, on_y, on_x, on_height, normals, views, strength, incidence, between):
    """Interpolate one group's vector irradiance to pixels; return its size and its cosines."""
    rows, columns = strength.shape
    count_y, count_x, count_height = flux.shape[:3]
    part, vector = np.empty(columns), np.empty((3, columns))
    for i in range(rows):
        for c in range(3):
            vector[c] = 0.0
            for h in range(count_height):
                part[:] = 0.0
                for m in range(count_x):
                    at_row = 0.0
                    for k in range(count_y):
                        at_row += on_y[i, k] * flux[k, m, h, c]
                    for j in range(columns):
                        part[j] += at_row * on_x[m, j]
                for j in range(columns):
                    vector[c, j] += part[j] * on_height[h, i, j]
        for j in range(columns):
            x, y, z = vector[0, j], vector[1, j], vector[2, j]
            size = math.sqrt(x * x + y * y + z * z)
            strength[i, j] = size
            size = max(size, 1e-300)
            x, y, z = x / size, y / size, z / size
            incidence[i, j] = x * normals[0, i, j] + y * normals[1, i, j] + z * normals[2, i, j]
            between[i, j] = x * views[0, i, j] + y * views[1, i, j] + z * views[2, i, j]
