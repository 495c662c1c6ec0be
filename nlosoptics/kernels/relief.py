"""Random reliefs of walls without tables: each node's draw depends on the seed and its indices.

The term of a relief is one row: its kind, FACETS or BUMPS; a length (the side of the lattice
cell, or the correlation length), m; a height rms (of the nodes, or of the surface), m; the low and
high 32 bits of the seed; the position of the lattice, x and y, m; and the place of draws in the
wall's tables, 0 without them.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import prange

from .codes import BUMPS, FACETS
from .compiling import njit
from .parallel import threaded
from .random import HALF, SHIFT, _rounds

NODES: Final = 302  # stream number of the random generator
ROW: Final = math.sqrt(0.75)  # distance of an equilateral lattice's rows, in cell sides
#: Nodes along a side of the square over which bumps are summed; outside, weights are below 2e-14.
WINDOW: Final = 16
BELL = np.exp(-0.5 * np.arange(1 - WINDOW // 2, WINDOW // 2 + 1) ** 2)
FURTHEST: Final = 2.0**31  # node index beyond which addresses would repeat
MOST_NODES: Final = 2**27  # nodes of a table
STORED: Final = 2**24  # nodes that are stored for rays
CHUNK: Final = 4096  # points or nodes that a thread takes at once


@njit(cache=True)
def node(low, high, i, j):
    """Return the standard normal draw of lattice node (i, j); ``low`` and ``high`` are the seed.

    Box-Muller with two uniform numbers of 53 bits.
    """
    a, b, c, d = _rounds(
        # two's complement maps negative indices to distinct addresses
        np.uint64(i & 0xFFFFFFFF),
        np.uint64(j & 0xFFFFFFFF),
        np.uint64(0),
        np.uint64(NODES),
        low,
        high,
    )
    # never 0, whose logarithm is infinite
    u = (float(((a << HALF) | b) >> SHIFT) + 0.5) * 1.1102230246251565e-16
    v = float(((c << HALF) | d) >> SHIFT) * 1.1102230246251565e-16
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)


@njit(cache=True)
def _facet_place(row, x, y):
    """Return the lattice cell (i, j) of a point and its place in it, in cell sides."""
    b = (y - row[6]) / (ROW * row[1])
    a = (x - row[5]) / row[1] - 0.5 * b
    i, j = np.floor(a), np.floor(b)
    return i, j, a - i, b - j


@njit(cache=True)
def _bump_place(row, x, y):
    """Return the square (i, j) of the node lattice and the place in it, in node distances."""
    a, b = 2.0 * (x - row[5]) / row[1], 2.0 * (y - row[6]) / row[1]
    i, j = np.floor(a), np.floor(b)
    return i, j, a - i, b - j


@njit(cache=True)
def facet_edge(row, x, y, dx, dy, slack):
    """Return how far (x, y) can move along (dx, dy) until it is past an edge of its facet.

    The edge is passed by ``slack``, m, at least the rounding of x and y, so that a ray that
    advances by this never stays on an edge. Infinite for a direction of zero.
    """
    _, _, a, b = _facet_place(row, x, y)
    db = dy / (ROW * row[1])
    da = dx / row[1] - 0.5 * db
    past, nearest = slack / row[1], math.inf
    c, dc = a + b, da + db
    # the three families of lines are the integers of a, b and a + b
    for place, speed in ((a, da), (b, db), (c - np.floor(c), dc)):
        if speed > 0.0:
            nearest = min(nearest, (1.0 - place + past) / speed)
        elif speed < 0.0:
            nearest = min(nearest, (place + past) / -speed)
    return nearest


@njit(cache=True)
def _plane(corner, along_a, along_b, a, b):
    """Return a facet's height and its slopes along the lattice, from three node draws.

    In the lower triangle, a + b <= 1, the corner is (i, j); in the upper one it is (i+1, j+1).
    """
    if a + b <= 1.0:
        ha, hb = along_a - corner, along_b - corner
        return corner + a * ha + b * hb, ha, hb
    ha, hb = corner - along_a, corner - along_b
    return corner - (1.0 - a) * ha - (1.0 - b) * hb, ha, hb


@njit(cache=True)
def facets(row, x, y):
    """Return height and slopes (h, hx, hy) of a surface of facets; NaN beyond 2^31 cells."""
    i, j, a, b = _facet_place(row, x, y)
    if not max(abs(i), abs(j)) < FURTHEST:
        return math.nan, math.nan, math.nan
    low, high, p, q = np.uint64(row[3]), np.uint64(row[4]), int(i), int(j)
    if a + b <= 1.0:
        corner = node(low, high, p, q)
        h, ha, hb = _plane(corner, node(low, high, p + 1, q), node(low, high, p, q + 1), a, b)
    else:
        corner = node(low, high, p + 1, q + 1)
        h, ha, hb = _plane(corner, node(low, high, p, q + 1), node(low, high, p + 1, q), a, b)
    slope = row[2] / row[1]
    return row[2] * h, slope * ha, slope * (hb - 0.5 * ha) / ROW


@njit(cache=True)
def _weigh(place, weights):
    """Fill the weights exp(-t^2/2) of the nodes along a side of the window.

    ``place`` in [0, 1] is that in the window's middle cell. The exponent is expanded, so that two
    exponentials serve all nodes.
    """
    ratio = math.exp(place)
    power = math.exp(-0.5 * place * place) / ratio ** (WINDOW // 2 - 1)
    for k in range(WINDOW):
        weights[k] = power * BELL[k]
        power *= ratio


@njit(cache=True)
def bumps(row, tables, x, y):
    """Return (h, hx, hy, hxx, hxy, hyy) of a Gaussian surface; NaN beyond 2^31 nodes.

    White noise on a square lattice of half the correlation length is convolved with a Gaussian.
    The draws come from the part of ``tables`` that `with_draws` appended, if there is one.
    """
    i, j, a, b = _bump_place(row, x, y)
    if not max(abs(i), abs(j)) < FURTHEST:
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    low, high, at = np.uint64(row[3]), np.uint64(row[4]), int(row[7])
    first, start = int(i) + 1 - WINDOW // 2, int(j) + 1 - WINDOW // 2
    across, place = 0, 0
    if at > 0:
        left, bottom = first - int(tables[at]), start - int(tables[at + 1])
        across, up = int(tables[at + 2]), int(tables[at + 3])
        place = at + 4 + bottom * across + left
        at = at if 0 <= left <= across - WINDOW and 0 <= bottom <= up - WINDOW else 0
    columns, rows, sums = np.empty(WINDOW), np.empty(WINDOW), np.zeros((3, WINDOW))
    _weigh(a, columns)
    _weigh(b, rows)
    for q in range(WINDOW):
        w, t = rows[q], b - (q + 1 - WINDOW // 2)
        for p in range(WINDOW):
            if at > 0:
                c = tables[place + q * across + p] * w
            else:
                c = node(low, high, first + p, start + q) * w
            sums[0, p] += c
            sums[1, p] -= t * c
            sums[2, p] += (t * t - 1.0) * c
    h = hx = hy = hxx = hxy = hyy = 0.0
    for p in range(WINDOW):
        w, s = columns[p], a - (p + 1 - WINDOW // 2)
        h += sums[0, p] * w
        hx -= s * w * sums[0, p]
        hxx += (s * s - 1.0) * w * sums[0, p]
        hy += w * sums[1, p]
        hxy -= s * w * sums[1, p]
        hyy += w * sums[2, p]
    size, rate = row[2] / math.sqrt(math.pi), 2.0 / row[1]
    slope, bend = size * rate, size * rate * rate
    return size * h, slope * hx, slope * hy, bend * hxx, bend * hxy, bend * hyy


@threaded()
def _draw_table(row, first, start, table):
    """Fill ``table`` with the draws of the nodes from (first, start) on, rows along the lattice."""
    low, high = np.uint64(row[3]), np.uint64(row[4])
    for q in prange(table.shape[0]):
        for p in range(table.shape[1]):
            table[q, p] = node(low, high, first + p, start + q)


@threaded()
def _facet_heights(row, x, y, first, start, table, out):
    """Fill ``out`` (n,) with the heights of facets, from a table of draws unless it is empty."""
    known = table.size > 0
    # a tuple stays in registers, while the row could change with ``out``
    place = (row[0], row[1], row[2], row[3], row[4], row[5], row[6])
    for chunk in prange((out.size + CHUNK - 1) // CHUNK):
        for n in range(chunk * CHUNK, min(out.size, (chunk + 1) * CHUNK)):
            if not known:
                out[n] = facets(row, x[n], y[n])[0]
                continue
            i, j, a, b = _facet_place(place, x[n], y[n])
            p, q = int(i) - first, int(j) - start
            if a + b <= 1.0:
                h, _, _ = _plane(table[q, p], table[q, p + 1], table[q + 1, p], a, b)
            else:
                h, _, _ = _plane(table[q + 1, p + 1], table[q + 1, p], table[q, p + 1], a, b)
            out[n] = place[2] * h


@threaded()
def _bump_heights(row, x, y, first, start, table, out):
    """Fill ``out`` (n,) with the heights of bumps, from a table of draws unless it is empty."""
    known, flat = table.size > 0, table.reshape(-1)
    size = row[2] / math.sqrt(math.pi)
    for chunk in prange((out.size + CHUNK - 1) // CHUNK):
        sums, columns, rows = np.empty(WINDOW), np.empty(WINDOW), np.empty(WINDOW)
        for n in range(chunk * CHUNK, min(out.size, (chunk + 1) * CHUNK)):
            if not known:
                out[n] = bumps(row, flat, x[n], y[n])[0]
                continue
            i, j, a, b = _bump_place(row, x[n], y[n])
            left, bottom = int(i) + 1 - WINDOW // 2 - first, int(j) + 1 - WINDOW // 2 - start
            _weigh(a, columns)
            _weigh(b, rows)
            sums[:] = 0.0
            for q in range(WINDOW):
                w = rows[q]
                # every column has its own sum, in the order of `bumps`, so that it vectorises
                for p in range(WINDOW):
                    sums[p] += table[bottom + q, left + p] * w
            h = 0.0
            for p in range(WINDOW):
                h += sums[p] * columns[p]
            out[n] = size * h


def with_draws(terms: Any, tables: Any, half: Any, evaluations: float) -> tuple[Any, Any]:
    """Return terms and tables with the draws of bumps over a rectangle, which have the same bits.

    Rays evaluate a wall at scattered points, each of which needs `WINDOW` squared draws.

    Parameters
    ----------
    terms : ndarray, (n, 8)
        Height terms of a wall.
    tables : ndarray, (m,)
        Their tables.
    half : ndarray, (2,)
        Half sizes of the rectangle in x and y, m; may be infinite.
    evaluations : float
        Expected number of points. No draws are stored if drawing on demand takes fewer, or for
        more than `STORED` nodes.
    """
    terms, parts, length = terms.copy(), [tables], len(tables)
    for row in terms:
        if row[0] != BUMPS or not np.isfinite(half).all():
            continue
        pitch = 0.5 * row[1]
        corner = np.floor((-half - row[5:7]) / pitch) - WINDOW // 2
        counts = np.floor((half - row[5:7]) / pitch) + WINDOW // 2 + 1 - corner
        nodes = float(counts.prod())
        if nodes > min(STORED, WINDOW * WINDOW * evaluations) or abs(corner).max() > FURTHEST / 2:
            continue
        draws = np.empty((int(counts[1]), int(counts[0])))
        _draw_table(row, int(corner[0]), int(corner[1]), draws)
        parts += [corner, counts, draws.ravel()]
        row[7] = length
        length += 4 + draws.size
    return terms, np.concatenate(parts)


def relief_heights(row: Any, x: Any, y: Any, out: Any) -> None:
    """Fill ``out`` with a relief's heights at many points, with the bits of `heights.surface`.

    The nodes of the points' bounding rectangle are drawn once into a table, unless there are more
    of them than draws on demand, or than `MOST_NODES`.

    Parameters
    ----------
    row : ndarray, (8,)
        Term of kind FACETS or BUMPS.
    x, y : ndarray, (n,)
        Finite coordinates, m, contiguous.
    out : ndarray, (n,)
        Heights, m; NaN beyond 2^31 nodes from the lattice's origin.
    """
    if not out.size:
        return
    is_facets = row[0] == FACETS
    wx, wy = (row[1], ROW * row[1]) if is_facets else (0.5 * row[1], 0.5 * row[1])
    b = [(v - row[6]) / wy for v in (float(y.min()), float(y.max()))]
    a = [(v - row[5]) / wx for v in (float(x.min()), float(x.max()))]
    if is_facets:
        a = [a[0] - 0.5 * b[1], a[1] - 0.5 * b[0]]
    # one node for rounding, and the neighbours that a point needs
    margin = 2 if is_facets else WINDOW // 2 + 1
    first, start = math.floor(a[0]) - margin, math.floor(b[0]) - margin
    columns, rows = math.floor(a[1]) + margin + 1 - first, math.floor(b[1]) + margin + 1 - start
    needed = columns * rows
    far = max(abs(v) for v in (*a, *b)) >= FURTHEST - 2 * WINDOW
    on_demand = (3 if is_facets else WINDOW * WINDOW) * out.size
    table = np.empty((0, 0))
    if not far and needed <= min(on_demand, MOST_NODES):
        table = np.empty((rows, columns))
        _draw_table(row, first, start, table)
    (_facet_heights if is_facets else _bump_heights)(row, x, y, first, start, table, out)
