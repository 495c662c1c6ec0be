"""Compiled pixels and bins of detected light."""

from __future__ import annotations

import math

from ...kernels.codes import GROUPS
from ...kernels.compiling import njit
from ..light._point_kernels import landing
from ..light._surround_kernels import three, unit


@njit(cache=True, nogil=True)
def sort_light(
    camera, first, layers, power, length, legs, last, ends, shape, bins, cells, slots, powers, rays
):
    """Find the pixel and the bin of the light in each path that reaches the lens; return a count.

    ``camera`` is that of `World`. The other inputs have one row per ray, of which ``first`` is the
    number of the first: ``layers`` (layer of the image, and number of layers), ``power`` (W, 0
    without a path), ``length`` of the path (m), ``legs`` (its first leg, m), the ``last`` vertices
    and the points ``ends`` on the lens (m). ``shape`` is (ny, nx) and ``bins`` (start and width of
    a bin, m, number of bins, whether to count the outer legs).

    For each path the outputs get ``cells`` = (group, layer, row, column) and ``slots`` = (group,
    layer, bin + 1), as one number each, with one slot before the first bin and one after the last.
    ``powers`` and ``rays`` get the power and the ray's position in the block.
    """
    ny, nx = shape
    start, width, n_bins, outer = bins
    layer, n_layers = layers
    pitch = 2.0 * camera[15] / nx
    count = 0
    for i in range(power.size):
        if power[i] <= 0.0:
            continue
        p = three(ends[i], 0)
        d, r = unit(p, last[i])
        x, y = landing(camera, p, d)
        # the point is on the detector, but rounding may move it across the edge
        column = min(max(int(math.floor(x / pitch + 0.5 * nx)), 0), nx - 1)
        row = min(max(int(math.floor(y / pitch + 0.5 * ny)), 0), ny - 1)
        path = length[i] if outer else length[i] - legs[i] - r
        slot = int(math.floor(min(max((path - start) / width, -1.0), float(n_bins)))) + 1
        group = (first + i) % GROUPS
        deep = group * n_layers + layer[i]
        cells[count] = (deep * ny + row) * nx + column
        slots[count] = deep * (n_bins + 2) + slot
        powers[count], rays[count] = power[i], i
        count += 1
    return count
