"""Compiled kernels of grids with soft rims: pupil, squares, error bounds.

Kernels that most runs need allocate no arrays: to load them, numba would import its own arrays.
"""

from __future__ import annotations

import math

from ...kernels.compiling import njit
from ..wave._wave_kernels import phasors
from ..window.antialiased_disc import STEP

#: Distances outside the rim, cells, at which leakage is evaluated, and the leakage from there times
#: cells per radius.
ZONES = tuple(
    (t, 6.0 * math.exp(-((math.pi * STEP * t) ** 2)) / (math.pi * t))
    for t in (1.5, 4.5, 7.5, 10.5, 13.5, 16.5)
)


@njit(cache=True, nogil=True)
def _profile(r, low, steps, table):
    """Interpolate a softened rim at the radius ``r``, cells, by six points of its table.

    The table has ``steps`` points per cell from ``low`` on, with two more at either end. The value
    is 1 below ``low`` and 0 beyond the table.
    """
    place = (r - low) * steps
    if place < 0.0:
        return 1.0
    at = int(place)
    if at + 6 > table.shape[0]:
        return 0.0
    t = place - at
    # Lagrange weights of the points -2 to 3
    a, b, d, e, f = t + 2.0, t + 1.0, t - 1.0, t - 2.0, t - 3.0
    value = table[at] * (b * t * d * e * f) / -120.0 + table[at + 1] * (a * t * d * e * f) / 24.0
    value += (
        table[at + 2] * (a * b * d * e * f) / -12.0 + table[at + 3] * (a * b * t * e * f) / 12.0
    )
    value += (
        table[at + 4] * (a * b * t * d * f) / -24.0 + table[at + 5] * (a * b * t * d * e) / 120.0
    )
    return value


@njit(cache=True, nogil=True)
def _cut(y, lows, highs, steps, tables, size):
    """Fill ``size`` (2 centre + 1,) with the pupil's transmission on the line at ``y``, cells.

    Returns the half width of the part that can be above 0, cells.
    """
    centre = size.shape[0] // 2
    half = min(centre, int(math.sqrt(highs[0] * highs[0] - y * y)))
    flat = -1
    if y < lows[0]:
        flat = int(math.sqrt(lows[0] * lows[0] - y * y))
    for x in range(half + 1):
        if x < flat:
            size[centre + x] = 1.0
        else:
            size[centre + x] = _profile(math.sqrt(x * x + y * y), lows[0], steps, tables[0])
    if tables.shape[0] > 1 and y < highs[1]:
        inside = int(math.sqrt(highs[1] * highs[1] - y * y))
        for x in range(min(half, inside) + 1):
            size[centre + x] -= _profile(math.sqrt(x * x + y * y), lows[1], steps, tables[1])
    for x in range(1, half + 1):
        size[centre - x] = size[centre + x]
    return half


@njit(cache=True, nogil=True)
def soft_pupil(coefficients, amplitudes, step, lows, highs, steps, tables, centre, work, out):
    """Add a pupil with softened rims to ``out`` (rows, columns), periodically wrapped.

    The phase in turns is ``sum coefficients[i, j] u^i v^j``, with u and v counted from the cell
    ``centre`` in steps of ``step`` per cell. ``amplitudes`` are coefficients of the same form, or
    of size 0 for an amplitude of 1. ``tables`` (1 or 2, n) hold the outer and the inner softened
    rim, see `_profile`. ``work`` (6, 2 centre + 1 or more) is overwritten; its rows are not shorter
    than the coefficients'. Returns the sum of the amplitude.
    """
    rows, columns = out.shape
    turns, rim, size, across, real, imaginary = work[0], work[1], work[2], work[3], work[4], work[5]
    total = 0.0
    for line in range(2 * centre + 1):
        y = (line + 1) // 2 * (2 * (line % 2) - 1)  # 0, 1, -1, 2, -2, ...
        if abs(y) >= highs[0]:
            break
        if y >= 0:
            half = _cut(float(y), lows, highs, steps, tables, rim)
        first, last = centre - half, centre + half + 1
        if amplitudes.shape[0] > 0:
            _along_row(amplitudes, y * step, step, centre, across, size[first:last], first)
            for column in range(first, last):
                size[column] *= rim[column]
        else:
            for column in range(first, last):
                size[column] = rim[column]
        _along_row(coefficients, y * step, step, centre, across, turns[first:last], first)
        for column in range(first, last):
            total += size[column]
        phasors(turns[first:last], size[first:last], real[first:last], imaginary[first:last])
        wrapped = out[(centre + y) % rows]
        start = first
        while start < last:
            lap = start // columns
            end = min(last, (lap + 1) * columns)
            for column in range(start, end):
                wrapped[column - lap * columns] += complex(real[column], imaginary[column])
            start = end
    return total


@njit(cache=True, nogil=True)
def _along_row(coefficients, y, step, centre, across, out, first):
    """Fill ``out`` with ``sum coefficients[i, j] u^i y^j`` at columns from ``first`` on.

    ``u = (column - centre) step``. ``across`` is a workspace of at least degree + 1 values.
    """
    degree = coefficients.shape[0] - 1
    for i in range(degree + 1):
        across[i] = coefficients[i, degree - i]
        for j in range(degree - i - 1, -1, -1):
            across[i] = across[i] * y + coefficients[i, j]
    for k in range(out.shape[0]):
        out[k] = across[degree]
    for i in range(degree - 1, -1, -1):
        for k in range(out.shape[0]):
            out[k] = out[k] * ((first + k - centre) * step) + across[i]


@njit(cache=True, nogil=True)
def _leak(s):
    """Evaluate `antialiased_disc.leak` for one distance ``s``, in periods."""
    return 0.5 * math.erfc((0.5 - s) / STEP)


@njit(cache=True, nogil=True)
def rim_errors(distance, period, reach, edges, landing, out):
    """Fill ``out`` (n,) with a bound of the field error within each of the increasing distances.

    Lengths are in Airy units; a period of ``period`` has ``period/2`` cells per pupil radius.
    ``landing`` (2, k) holds radii relative to the pupil's and the largest landing distance of rays
    from them. See `antialiased_pupil.rim_of`.
    """
    cells = 0.5 * period
    base = 2.0 * _leak(reach / period) / max(math.pi * reach, 1.0) * edges
    for beyond, strength in ZONES:
        radius, k = 1.0 + beyond / cells, 0
        while k < landing.shape[1] - 2 and landing[0, k + 1] < radius:
            k += 1
        slope = (landing[1, k + 1] - landing[1, k]) / (landing[0, k + 1] - landing[0, k])
        lands = slope * (min(radius, landing[0, k + 1]) - landing[0, k]) + landing[1, k]
        base += strength / cells * _leak(lands / period)
    most = 0.0
    for i in range(distance.shape[0]):
        far = distance[i] + reach
        tail = min(1.0, math.sqrt(8.0 / (math.pi * max(math.pi * far, 1.0) ** 3)))
        most = max(most, 3.0 * _leak(far / period) * tail * edges)
        out[i] = most + base


@njit(cache=True, nogil=True)
def least_period(least, widest, light, goal, error, distance, reach, edges, landing):
    """Find the smallest period, within 1 %, whose `rim_errors` change the intensity by < ``goal``.

    ``light`` is the field's envelope at the distances. The search runs from ``least`` to
    ``widest``, which is returned if no period suffices. ``error`` (n,) is overwritten.
    """
    low, high, period = least, widest, least
    while True:
        rim_errors(distance, period, reach, edges, landing, error)
        enough = True
        for i in range(error.shape[0]):
            enough &= 2.0 * light[i] * error[i] + error[i] * error[i] < goal
        if enough:
            high = period
        else:
            low = period
        if high <= 1.01 * low or high == least:
            return high
        period = math.sqrt(low * high)
