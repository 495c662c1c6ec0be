"""Compiled mean of the transfer function over a lattice of random facets."""

from __future__ import annotations

import math

from numba import prange

from ...kernels.compiling import njit
from ...kernels.parallel import threaded

ROW = math.sqrt(3.0) / 2.0  # distance between rows of an equilateral lattice of side 1


@njit(cache=True, error_model="numpy")
def _squared(i, j, c, d, a, b, upper, there_upper):
    """Return the sum of squared differences of the node weights of two points.

    The points are (a, b) in the lattice cell (0, 0) and (c, d) in the cell (i, j), in lattice
    coordinates. ``upper`` selects the triangle beyond the cell's diagonal, whose plane is used
    outside the triangle too.
    """
    if upper:
        here = ((1, 1, a + b - 1.0), (0, 1, 1.0 - a), (1, 0, 1.0 - b))
    else:
        here = ((0, 0, 1.0 - a - b), (1, 0, a), (0, 1, b))
    if there_upper:
        there = ((i + 1, j + 1, c + d - 1.0), (i, j + 1, 1.0 - c), (i + 1, j, 1.0 - d))
    else:
        there = ((i, j, 1.0 - c - d), (i + 1, j, c), (i, j + 1, d))
    square = 0.0
    for one in range(3):
        square += here[one][2] * here[one][2] + there[one][2] * there[one][2]
        for two in range(3):
            if here[one][0] == there[two][0] and here[one][1] == there[two][1]:
                square -= 2.0 * here[one][2] * there[two][2]
    return square


@njit(cache=True, error_model="numpy")
def _pair(i, j, column, row, upper, there_upper, half, nodes, weights):
    """Return the integral of ``exp(-half square)`` over one pair of triangles.

    It is over the points of a triangle of the lattice cell (0, 0) that the separation
    (column, row), in lattice coordinates, moves into a triangle of the cell (i, j).
    """
    # both triangles bound a, b and a + b, in lattice coordinates of the first point
    left, low = i - column, j - row
    first = left + low + (1.0 if there_upper else 0.0)
    start = 1.0 if upper else 0.0
    first, last = max(first, start), min(first, start) + 1.0
    left, right = max(left, 0.0), min(left, 0.0) + 1.0
    low, high = max(low, 0.0), min(low, 0.0) + 1.0
    left, right = max(left, first - high), min(right, last - low)
    if right <= left or high <= low or last <= first:
        return 0.0
    # the exponent is a quadratic polynomial of a and b
    s00 = _squared(i, j, column - i, row - j, 0.0, 0.0, upper, there_upper)
    s10 = _squared(i, j, 1.0 + column - i, row - j, 1.0, 0.0, upper, there_upper)
    s20 = _squared(i, j, 2.0 + column - i, row - j, 2.0, 0.0, upper, there_upper)
    s01 = _squared(i, j, column - i, 1.0 + row - j, 0.0, 1.0, upper, there_upper)
    s02 = _squared(i, j, column - i, 2.0 + row - j, 0.0, 2.0, upper, there_upper)
    s11 = _squared(i, j, 1.0 + column - i, 1.0 + row - j, 1.0, 1.0, upper, there_upper)
    aa, bb = 0.5 * (s20 + s00) - s10, 0.5 * (s02 + s00) - s01
    a1, b1, ab = s10 - s00 - aa, s01 - s00 - bb, s11 - s10 - s01 + s00
    same = i == 0 and j == 0 and upper == there_upper
    # the range of b has corners at these a
    one, two = min(max(first - low, left), right), min(max(last - high, left), right)
    ends = (left, min(one, two), max(one, two), right)
    total = 0.0
    for panel in range(3):
        begin, size = ends[panel], ends[panel + 1] - ends[panel]
        if size <= 0.0:
            continue
        if same:  # the exponent is constant and the range of b changes linearly
            a = begin + 0.5 * size
            total += size * (min(high, last - a) - max(low, first - a)) * math.exp(-half * s00)
            continue
        for p in range(nodes.size):
            a = begin + nodes[p] * size
            bottom = max(low, first - a)
            height = min(high, last - a) - bottom
            line, c0, c1 = 0.0, s00 + a * (a1 + a * aa), b1 + a * ab
            for q in range(nodes.size):
                b = bottom + nodes[q] * height
                line += weights[q] * math.exp(-half * (c0 + b * (c1 + b * bb)))
            total += weights[p] * size * height * line
    return total


@threaded(error_model="numpy")
def pair_terms(x, y, variance, nodes, weights, out):
    """Fill ``out`` with the mean of ``exp(-Var[phase(r) - phase(r + d)]/2)`` over positions r.

    The separations d = (x, y) (n,) are in units of the lattice side, and ``variance`` is that of
    the phase at a node, rad^2. The height at a point is the mean of three nodes with barycentric
    weights, and nodes are independent. The variance of a difference is therefore that of a node
    times the sum of the squared differences of all weights. The integral over each pair of
    triangles uses the Gauss nodes and weights (m,) on the interval from 0 to 1, along both axes.
    """
    for k in prange(x.size):
        row = y[k] / ROW
        column = x[k] - 0.5 * row
        i0, j0 = int(math.floor(column)), int(math.floor(row))
        total = 0.0
        for i in range(i0, i0 + 2):
            for j in range(j0, j0 + 2):
                for pair in range(4):
                    upper, there = pair % 2 == 1, pair >= 2
                    total += _pair(i, j, column, row, upper, there, 0.5 * variance, nodes, weights)
        out[k] = total
