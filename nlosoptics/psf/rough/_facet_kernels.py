"""Compiled mean of the transfer function over a lattice of random facets."""

from __future__ import annotations

import math

from numba import prange

from ...kernels.parallel import threaded

ROW = math.sqrt(3.0) / 2.0  # distance between rows of an equilateral lattice of side 1


@threaded(error_model="numpy")
def pair_terms(x, y, variance, per_side, out):
    """Fill ``out`` with the mean of ``exp(-Var[phase(r) - phase(r + d)]/2)`` over positions r.

    The separations d = (x, y) (n,) are in units of the lattice side, and ``variance`` is that of
    the phase at a node, rad^2. The positions are the centres of ``per_side`` x ``per_side`` equal
    parts of the lattice cell. The height at a point is the mean of three nodes with barycentric
    weights, and nodes are independent. The variance of a difference is therefore that of a node
    times the sum of the squared differences of all weights.
    """
    for k in prange(x.size):
        row = y[k] / ROW
        column = x[k] - 0.5 * row
        total = 0.0
        for q in range(per_side):
            for p in range(per_side):
                a, b = (p + 0.5) / per_side, (q + 0.5) / per_side
                if a + b <= 1.0:
                    here = ((0, 0, 1.0 - a - b), (1, 0, a), (0, 1, b))
                else:
                    here = ((1, 1, a + b - 1.0), (0, 1, 1.0 - a), (1, 0, 1.0 - b))
                i, j = math.floor(a + column), math.floor(b + row)
                c, d = a + column - i, b + row - j
                i, j = int(i), int(j)
                if c + d <= 1.0:
                    there = ((i, j, 1.0 - c - d), (i + 1, j, c), (i, j + 1, d))
                else:
                    there = ((i + 1, j + 1, c + d - 1.0), (i, j + 1, 1.0 - c), (i + 1, j, 1.0 - d))
                square = 0.0
                for one in range(3):
                    square += here[one][2] * here[one][2] + there[one][2] * there[one][2]
                    for two in range(3):
                        if here[one][0] == there[two][0] and here[one][1] == there[two][1]:
                            square -= 2.0 * here[one][2] * there[two][2]
                total += math.exp(-0.5 * variance * square)
        out[k] = total / (per_side * per_side)
