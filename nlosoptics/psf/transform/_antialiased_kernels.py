"""Compiled kernels of grids with soft rims: pupil, folding, error bounds.

Kernels that most runs need allocate no arrays: to load them, numba would import its own arrays.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit
from ..wave._wave_kernels import phasors


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
def turned(values, out):
    """Fill ``out`` (columns, n) with the transpose of ``values`` (rows, columns), padded by 0."""
    rows, columns = values.shape
    for i in range(columns):
        for j in range(rows):
            out[i, j] = values[j, i]
        for j in range(rows, out.shape[1]):
            out[i, j] = 0.0


@njit(cache=True, nogil=True)
def squares(field, scale, out):
    """Fill ``out`` (rows, n) with ``scale |field|^2`` of the first n columns of ``field``."""
    for i in range(out.shape[0]):
        line = out[i]
        for j in range(line.shape[0]):
            value = field[i, j]
            line[j] = scale * (value.real * value.real + value.imag * value.imag)


@njit(cache=True, nogil=True)
def pixel_rows(field, scale, start, factor, taps, line, out):
    """Add ``scale |field|^2`` of rows from ``start`` on to the pixel rows ``out`` (pixels, n).

    Pixel row p is the sum of the rows from ``p factor`` on, weighted by ``taps``. ``line`` (n,) is
    overwritten.
    """
    for i in range(field.shape[0]):
        row, n = start + i, line.shape[0]
        for j in range(n):
            value = field[i, j]
            line[j] = scale * (value.real * value.real + value.imag * value.imag)
        last = min(row // factor, out.shape[0] - 1)
        for p in range(max((row - taps.shape[0]) // factor + 1, 0), last + 1):
            pixels, weight = out[p], taps[row - p * factor]
            for j in range(n):
                pixels[j] += weight * line[j]


@njit(cache=True, nogil=True)
def waves(first, step, cosines, sines):
    """Fill ``cosines`` (m, c + 1) and ``sines`` (m, c) of ``2 pi x k``, x = first, first + step...

    k counts from 0 for cosines and from 1 for sines. ``first`` and ``step`` are in turns.
    """
    count = sines.shape[1]
    turns, size = np.empty(count), np.ones(count)
    real, imaginary = np.empty(count), np.empty(count)
    for i in range(sines.shape[0]):
        for k in range(count):
            turns[k] = (first + i * step) * (k + 1)
        phasors(turns, size, real, imaginary)
        cosines[i, 0] = 1.0
        cosines[i, 1:] = real
        sines[i] = imaginary


@njit(cache=True, nogil=True)
def folded(values, even, odd):
    """Fill ``even`` (c + 1, n) and ``odd`` (c, n) with sums and differences of opposite rows.

    Rows of ``values`` (2 c + 1, n) have the indices -c to c.
    """
    centre = odd.shape[0]
    even[0] = values[centre]
    for k in range(centre):
        one, other = values[centre + 1 + k], values[centre - 1 - k]
        for j in range(values.shape[1]):
            even[k + 1, j] = one[j] + other[j]
            odd[k, j] = one[j] - other[j]


@njit(cache=True, nogil=True)
def refolded(even, odd, out_even, out_odd):
    """Combine even and odd parts (m, 2 c + 1) of the first pass and fold them along the other axis.

    ``even - i odd`` is the transform at +x and ``even + i odd`` that at -x. Columns of ``out_even``
    (c + 1, 2 n) and ``out_odd`` (c, 2 n) hold both signs of x, in increasing order: first the real
    parts, then the imaginary parts, so that later loops are vectorised.
    """
    centre, columns = out_odd.shape[0], out_even.shape[1] // 2
    for i in range(even.shape[0]):
        above, below = columns // 2 + i, (columns - 1) // 2 - i
        a, b = even[i, centre], odd[i, centre]
        out_even[0, above], out_even[0, columns + above] = a.real + b.imag, a.imag - b.real
        out_even[0, below], out_even[0, columns + below] = a.real - b.imag, a.imag + b.real
    for k in range(centre):
        line, other = out_even[k + 1], out_odd[k]
        for i in range(even.shape[0]):
            above, below = columns // 2 + i, (columns - 1) // 2 - i
            a, b = even[i, centre + 1 + k], odd[i, centre + 1 + k]
            c, d = even[i, centre - 1 - k], odd[i, centre - 1 - k]
            p, q = a + c, b + d
            line[above], line[columns + above] = p.real + q.imag, p.imag - q.real
            line[below], line[columns + below] = p.real - q.imag, p.imag + q.real
            p, q = a - c, b - d
            other[above], other[columns + above] = p.real + q.imag, p.imag - q.real
            other[below], other[columns + below] = p.real - q.imag, p.imag + q.real


@njit(cache=True, nogil=True)
def split_squares(even, odd, scale, above, below):
    """Fill ``above`` (m, n) with ``scale |even - i odd|^2``, ``below`` with that of the sum.

    The sum is ``even + i odd``. Both are (m, 2 n), with the real parts in the first n columns. The
    rows of ``below`` are in reverse order.
    """
    last, n = above.shape[0] - 1, above.shape[1]
    for i in range(above.shape[0]):
        up, down = above[i], below[last - i]
        a, b, c, d = even[i, :n], even[i, n:], odd[i, :n], odd[i, n:]
        for j in range(n):
            real, imaginary = a[j] + d[j], b[j] - c[j]
            up[j] = scale * (real * real + imaginary * imaginary)
        for j in range(n):  # a loop of its own: with two outputs it is not vectorised
            real, imaginary = a[j] - d[j], b[j] + c[j]
            down[j] = scale * (real * real + imaginary * imaginary)


@njit(cache=True, nogil=True)
def _leak(s, width):
    """Evaluate `antialiased_disc.leak` for one distance ``s``, in periods, and a step width."""
    return 0.5 * math.erfc((0.5 - s) / width)


@njit(cache=True, nogil=True)
def rim_errors(distance, period, reach, edges, zones, landing, width, out):
    """Fill ``out`` (n,) with a bound of the field error within each of the increasing distances.

    Lengths are in Airy units; a period of ``period`` has ``period/2`` cells per pupil radius. Rows
    of ``zones`` (m, 2) are a distance beyond the rim, cells, and the field's strength there.
    ``landing`` (2, k) holds radii relative to the pupil's and the largest landing distance of rays
    from them. See `antialiased_pupil.rim_of`.
    """
    cells = 0.5 * period
    base = 2.0 * _leak(reach / period, width) / max(math.pi * reach, 1.0) * edges
    for i in range(zones.shape[0]):
        radius, k = 1.0 + zones[i, 0] / cells, 0
        while k < landing.shape[1] - 2 and landing[0, k + 1] < radius:
            k += 1
        slope = (landing[1, k + 1] - landing[1, k]) / (landing[0, k + 1] - landing[0, k])
        lands = slope * (min(radius, landing[0, k + 1]) - landing[0, k]) + landing[1, k]
        base += zones[i, 1] / cells * _leak(lands / period, width)
    most = 0.0
    for i in range(distance.shape[0]):
        far = distance[i] + reach
        tail = min(1.0, math.sqrt(8.0 / (math.pi * max(math.pi * far, 1.0) ** 3)))
        most = max(most, 3.0 * _leak(far / period, width) * tail * edges)
        out[i] = most + base


@njit(cache=True, nogil=True)
def least_period(least, widest, light, goal, error, distance, reach, edges, zones, landing, width):
    """Find the smallest period, within 1 %, whose `rim_errors` change the intensity by < ``goal``.

    ``light`` is the field's envelope at the distances. The search runs from ``least`` to
    ``widest``, which is returned if no period suffices. ``error`` (n,) is overwritten.
    """
    low, high, period = least, widest, least
    while True:
        rim_errors(distance, period, reach, edges, zones, landing, width, error)
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


@njit(cache=True, nogil=True)
def block_maxima(intensity, first, pitch, line, strongest, far):
    """Fill ``strongest`` (blocks, blocks) with the largest intensity in each block of an image.

    ``far`` (blocks, blocks) is the largest distance of a block's samples from the origin, where
    ``first`` (x, y) is the position of the sample [0, 0]. ``line`` (columns,) is overwritten.
    """
    ny, nx = intensity.shape
    down, along = strongest.shape
    for i in range(down):
        top, bottom = (i * ny + down - 1) // down, ((i + 1) * ny - 1) // down
        y = max(abs(first[1] + top * pitch), abs(first[1] + bottom * pitch))
        line[:] = 0.0
        for row in range(top, bottom + 1):
            for column in range(nx):  # over whole rows, so that the compiler vectorises the loop
                value = intensity[row, column]
                line[column] = value if value > line[column] else line[column]
        for j in range(along):
            left, right = (j * nx + along - 1) // along, ((j + 1) * nx - 1) // along
            x = max(abs(first[0] + left * pitch), abs(first[0] + right * pitch))
            most = 0.0
            for column in range(left, right + 1):
                most = max(most, line[column])
            strongest[i, j] = most
            far[i, j] = math.hypot(x, y)
