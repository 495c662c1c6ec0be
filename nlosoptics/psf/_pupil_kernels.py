"""Pupil functions of polynomial waves on a grid, and phasors."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

#: Adding it rounds a double of less than 2^51 to a whole number; no call, so loops keep vectors.
WHOLE = 6755399441055744.0


@njit(cache=True)
def phasors(turns, size, real, imaginary):
    """Fill ``real`` and ``imaginary`` (n,) with ``size exp(2 pi i turns)``, to 3e-16.

    Half turns are taken off, which is exact, and the rest is a Taylor series up to pi/2.
    """
    for i in range(turns.shape[0]):
        halves = (2.0 * turns[i] + WHOLE) - WHOLE
        odd = halves - 2.0 * ((0.5 * halves + WHOLE) - WHOLE)
        strength = size[i] * (1.0 - 2.0 * odd * odd)
        x = 2.0 * math.pi * (turns[i] - 0.5 * halves)
        s = x * x
        cosine = 1.0 / 1124000727777607680000.0
        cosine = 1.0 / 2432902008176640000.0 - s * cosine
        cosine = 1.0 / 6402373705728000.0 - s * cosine
        cosine = 1.0 / 20922789888000.0 - s * cosine
        cosine = 1.0 / 87178291200.0 - s * cosine
        cosine = 1.0 / 479001600.0 - s * cosine
        cosine = 1.0 / 3628800.0 - s * cosine
        cosine = 1.0 / 40320.0 - s * cosine
        cosine = 1.0 / 720.0 - s * cosine
        cosine = 1.0 / 24.0 - s * cosine
        cosine = 0.5 - s * cosine
        cosine = 1.0 - s * cosine
        sine = 1.0 / 51090942171709440000.0
        sine = 1.0 / 121645100408832000.0 - s * sine
        sine = 1.0 / 355687428096000.0 - s * sine
        sine = 1.0 / 1307674368000.0 - s * sine
        sine = 1.0 / 6227020800.0 - s * sine
        sine = 1.0 / 39916800.0 - s * sine
        sine = 1.0 / 362880.0 - s * sine
        sine = 1.0 / 5040.0 - s * sine
        sine = 1.0 / 120.0 - s * sine
        sine = 1.0 / 6.0 - s * sine
        sine = x * (1.0 - s * sine)
        real[i] = strength * cosine
        imaginary[i] = strength * sine


@njit(cache=True)
def _profile(r, low, steps, table):
    """Softened rim at the radius ``r`` by six points of its table, ``steps`` a cell from ``low``.

    The table has two points more at either end; 1 below it and 0 beyond.
    """
    place = (r - low) * steps
    if place < 0.0:
        return 1.0
    at = int(place)
    if at + 6 > table.shape[0]:
        return 0.0
    t = place - at
    # Lagrange's weights of the points -2 to 3
    a, b, d, e, f = t + 2.0, t + 1.0, t - 1.0, t - 2.0, t - 3.0
    value = table[at] * (b * t * d * e * f) / -120.0 + table[at + 1] * (a * t * d * e * f) / 24.0
    value += (
        table[at + 2] * (a * b * d * e * f) / -12.0 + table[at + 3] * (a * b * t * e * f) / 12.0
    )
    value += (
        table[at + 4] * (a * b * t * d * f) / -24.0 + table[at + 5] * (a * b * t * d * e) / 120.0
    )
    return value


@njit(cache=True)
def _cut(y, lows, highs, steps, tables, size):
    """Fill ``size`` (2 centre + 1,) with softened rims on the line at ``y``; return its half width.

    The half width is that of its lit part, cells.
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


@njit(cache=True)
def soft_pupil(coefficients, amplitudes, step, lows, highs, steps, tables, centre, out):
    """Add a pupil with softened rims to ``out`` (rows, columns), wrapped; return its sum.

    The phase, turns, is ``sum coefficients[i, j] u^i v^j``, u and v in ``step`` a cell from
    ``centre``, and so is the amplitude, 1 where there are no such ``amplitudes``. ``tables`` (1 or
    2, n) are the softened rims, outer and inner, of `_profile`.
    """
    rows, columns = out.shape
    n = 2 * centre + 1
    degree = coefficients.shape[0] - 1
    turns, rim, size = np.empty(n), np.empty(n), np.empty(n)
    real, imaginary = np.empty(n), np.empty(n)
    across = np.empty(max(degree + 1, amplitudes.shape[0]))
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
            size[first:last] = rim[first:last]
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


@njit(cache=True)
def _along_row(coefficients, y, step, centre, across, out, first):
    """Fill ``out`` with ``sum coefficients[i, j] u^i y^j`` at the columns from ``first`` on."""
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


@njit(cache=True)
def turned(values, out):
    """Fill ``out`` (columns, n) with the transpose of ``values`` (rows, columns), then with 0."""
    rows, columns = values.shape
    for i in range(columns):
        for j in range(rows):
            out[i, j] = values[j, i]
        for j in range(rows, out.shape[1]):
            out[i, j] = 0.0


@njit(cache=True)
def squares(field, scale, out):
    """Fill ``out`` (rows, n) with ``scale |field|^2`` of the first n columns of ``field``."""
    for i in range(out.shape[0]):
        line = out[i]
        for j in range(line.shape[0]):
            value = field[i, j]
            line[j] = scale * (value.real * value.real + value.imag * value.imag)


@njit(cache=True)
def waves(first, step, cosines, sines):
    """Fill ``cosines`` (m, c + 1) of 2 pi x k, x = first, first + step, ... and ``sines`` (m, c).

    k counts from 0, or from 1 for sines; ``first`` and ``step`` in turns.
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


@njit(cache=True)
def folded(values, even, odd):
    """Fill ``even`` (c + 1, n) and ``odd`` (c, n) with sums and differences of opposite rows.

    The rows of ``values`` (2 c + 1, n) count from -c.
    """
    centre = odd.shape[0]
    even[0] = values[centre]
    for k in range(centre):
        one, other = values[centre + 1 + k], values[centre - 1 - k]
        for j in range(values.shape[1]):
            even[k + 1, j] = one[j] + other[j]
            odd[k, j] = one[j] - other[j]


@njit(cache=True)
def refolded(even, odd, out_even, out_odd):
    """Fold rows (m, 2 c + 1) along their other axis, each to its columns of both signs of x.

    ``even - i odd`` is that of +x, from the middle of ``out_even`` (c + 1, n) and ``out_odd``
    (c, n) on, ``even + i odd`` that of -x, back from there.
    """
    centre, columns = out_odd.shape[0], out_even.shape[1]
    for i in range(even.shape[0]):
        a, b = even[i, centre], odd[i, centre]
        out_even[0, columns // 2 + i] = complex(a.real + b.imag, a.imag - b.real)
        out_even[0, (columns - 1) // 2 - i] = complex(a.real - b.imag, a.imag + b.real)
    for k in range(centre):
        line, other = out_even[k + 1], out_odd[k]
        for i in range(even.shape[0]):
            above, below = columns // 2 + i, (columns - 1) // 2 - i
            a, b = even[i, centre + 1 + k], odd[i, centre + 1 + k]
            c, d = even[i, centre - 1 - k], odd[i, centre - 1 - k]
            p, q = a + c, b + d
            line[above] = complex(p.real + q.imag, p.imag - q.real)
            line[below] = complex(p.real - q.imag, p.imag + q.real)
            p, q = a - c, b - d
            other[above] = complex(p.real + q.imag, p.imag - q.real)
            other[below] = complex(p.real - q.imag, p.imag + q.real)


@njit(cache=True)
def split_squares(even, odd, scale, above, below):
    """Fill ``above`` (m, n) with ``scale |even - i odd|^2``, ``below`` with that of the other sign.

    The rows of ``below`` are in the opposite order.
    """
    last = above.shape[0] - 1
    for i in range(above.shape[0]):
        up, down = above[i], below[last - i]
        for j in range(above.shape[1]):
            a, b = even[i, j], odd[i, j]
            real, imaginary = a.real + b.imag, a.imag - b.real
            up[j] = scale * (real * real + imaginary * imaginary)
            real, imaginary = a.real - b.imag, a.imag + b.real
            down[j] = scale * (real * real + imaginary * imaginary)


@njit(cache=True)
def polar_fit(values, waves, weights, modes, heights):
    """Fill ``heights`` (orders, terms) with the terms of ``values`` (rings, spokes).

    ``waves`` (orders, spokes) along the angle, ``weights`` and ``modes`` (orders, terms, rings)
    along the radius. Returns the largest misfit and the largest value.
    """
    rings, spokes = values.shape
    orders, terms = heights.shape
    heights[:] = 0.0
    # spokes first, so that the loops over the orders keep vectors
    turned = np.ascontiguousarray(waves.T)
    share, height = np.empty(orders), np.zeros((terms, orders))
    along = np.ascontiguousarray(weights.transpose(2, 1, 0))
    most = 0.0
    for i in range(rings):
        share[:] = 0.0
        for j in range(spokes):
            value = values[i, j]
            most = max(most, abs(value))
            for m in range(orders):
                share[m] += turned[j, m] * value
        for k in range(terms):
            for m in range(orders):
                height[k, m] += along[i, k, m] * share[m]
    misfit = 0.0
    line = np.empty(spokes)
    for i in range(rings):
        line[:] = values[i]
        for m in range(orders):
            part = 0.0
            for k in range(terms):
                part += height[k, m] * modes[m, k, i]
            for j in range(spokes):
                line[j] -= part * waves[m, j]
        for j in range(spokes):
            misfit = max(misfit, abs(line[j]))
    heights[:] = height.T
    return misfit, most


@njit(cache=True)
def polynomial(powers, rho, cosine, sine, out):
    """Fill ``out`` (radii, angles) with ``sum powers[i, j] u^i v^j``."""
    n = powers.shape[0]
    for k in range(rho.shape[0]):
        for m in range(cosine.shape[0]):
            u, v = rho[k] * cosine[m], rho[k] * sine[m]
            total = 0.0
            for i in range(n - 1, -1, -1):
                value = 0.0
                for j in range(n - 1 - i, -1, -1):
                    value = value * v + powers[i, j]
                total = total * u + value
            out[k, m] = total


@njit(cache=True)
def slopes(powers, rho, cosine, sine, du, dv):
    """Fill ``du`` and ``dv`` (radii, angles) with the slopes of ``sum powers[i, j] u^i v^j``."""
    n = powers.shape[0]
    u, v = np.empty(cosine.shape[0]), np.empty(cosine.shape[0])
    value, slope = np.empty_like(u), np.empty_like(u)
    for k in range(rho.shape[0]):
        u[:] = rho[k] * cosine
        v[:] = rho[k] * sine
        along, across = du[k], dv[k]
        along[:] = 0.0
        across[:] = 0.0
        for i in range(n - 1, -1, -1):
            value[:] = 0.0
            slope[:] = 0.0
            for j in range(n - 1 - i, -1, -1):
                for m in range(u.shape[0]):
                    slope[m] = slope[m] * v[m] + value[m]
                    value[m] = value[m] * v[m] + powers[i, j]
            for m in range(u.shape[0]):
                across[m] = across[m] * u[m] + slope[m]
            if i > 0:
                for m in range(u.shape[0]):
                    along[m] = along[m] * u[m] + i * value[m]


@njit(cache=True)
def moments(path, share):
    """Lowest and highest of ``path``, its mean and its rms about that, where ``share`` is lit."""
    low, high, mean, square, total = math.inf, -math.inf, 0.0, 0.0, 0.0
    for i in range(path.size):
        if share[i] > 0.0:
            low, high = min(low, path[i]), max(high, path[i])
            mean += share[i] * path[i]
            total += share[i]
    mean /= total
    for i in range(path.size):
        square += share[i] * (path[i] - mean) ** 2
    return low, high, mean, math.sqrt(square / total)


@njit(cache=True)
def landing(du, dv, distance, x, y):
    """Fill ``x`` and ``y`` with slopes times the distance; return the steepest, the farthest."""
    steepest = farthest = 0.0
    for i in range(du.shape[0]):
        steepest = max(steepest, du[i] * du[i] + dv[i] * dv[i])
        x[i], y[i] = du[i] * distance, dv[i] * distance
        farthest = max(farthest, abs(x[i]), abs(y[i]))
    return math.sqrt(steepest), farthest


@njit(cache=True)
def jacobian_extremes(x, y, r, apart):
    """Least and most of the area of the image of the cells between rings and spokes, over theirs.

    ``x`` and ``y`` (rings, spokes) are the landing points, ``r`` the rings' radii; of rings less
    than ``apart`` from each other differences would be rounding.
    """
    rings, spokes = x.shape
    low, high = math.inf, -math.inf
    turn = math.sin(2 * math.pi / spokes)
    for i in range(rings - 1):
        if r[i + 1] - r[i] <= apart:
            continue
        own = (r[i + 1] * r[i + 1] - r[i] * r[i]) * turn
        for j in range(spokes):
            k = j + 1 if j + 1 < spokes else 0
            # diagonals of the cells: their cross product is twice the area
            first_x, first_y = x[i + 1, k] - x[i, j], y[i + 1, k] - y[i, j]
            second_x, second_y = x[i + 1, j] - x[i, k], y[i + 1, j] - y[i, k]
            area = (first_x * second_y - first_y * second_x) / own
            low, high = min(low, area), max(high, area)
    return low, high


@njit(cache=True)
def densest(x, y, energy, reach, side):
    """Most energy in a square of ``side``, of squares that cover ``reach`` either way."""
    n = int(2.0 * reach / side + 0.5) + 2
    bins = np.zeros((n, n))
    for i in range(x.size):
        bins[int((y[i] + reach) / side + 0.5), int((x[i] + reach) / side + 0.5)] += energy[i]
    return bins.max()


@njit(cache=True)
def _leak(s, width):
    """`rims.leak` of a step of a width."""
    return 0.5 * math.erfc((0.5 - s) / width)


@njit(cache=True)
def rim_errors(distance, period, reach, edges, zones, landing, width, out):
    """Fill ``out`` (n,) with the error of a softened rim up to each of the rising distances.

    Lengths in Airy units, a period of which holds ``period / 2`` cells a radius. ``zones`` (m, 2)
    are cells beyond the rim and the strength of each, ``landing`` (2, k) radii from the axis and
    how far a ray from there lands at most; see `soft_pupils`.
    """
    cells = 0.5 * period
    base = 2.0 * _leak(reach / period, width) / max(math.pi * reach, 1.0) * edges
    for i in range(zones.shape[0]):
        lands = np.interp(1.0 + zones[i, 0] / cells, landing[0], landing[1])
        base += zones[i, 1] / cells * _leak(lands / period, width)
    most = 0.0
    for i in range(distance.shape[0]):
        far = distance[i] + reach
        tail = min(1.0, math.sqrt(8.0 / (math.pi * max(math.pi * far, 1.0) ** 3)))
        most = max(most, 3.0 * _leak(far / period, width) * tail * edges)
        out[i] = most + base


@njit(cache=True)
def least_period(least, widest, light, goal, distance, reach, edges, zones, landing, width):
    """Period whose `rim_errors` change the ``light`` by less than ``goal``, to a hundredth.

    From ``least`` on; the ``widest`` where none does.
    """
    error = np.empty_like(distance)
    low, high, period = least, widest, least
    while True:
        rim_errors(distance, period, reach, edges, zones, landing, width, error)
        if np.max(2.0 * light * error + error * error) < goal:
            high = period
        else:
            low = period
        if high <= 1.01 * low or high == least:
            return high
        period = math.sqrt(low * high)


@njit(cache=True)
def block_maxima(intensity, first, pitch, strongest, far):
    """Fill ``strongest`` and ``far`` (blocks, blocks) with the most of each block of an image.

    ``far`` is the distance from [0, 0] of its farthest sample, ``first`` (x, y) the place of the
    first one.
    """
    ny, nx = intensity.shape
    down, along = strongest.shape
    line = np.empty(nx)
    for i in range(down):
        top, bottom = (i * ny + down - 1) // down, ((i + 1) * ny - 1) // down
        y = max(abs(first[1] + top * pitch), abs(first[1] + bottom * pitch))
        line[:] = 0.0
        for row in range(top, bottom + 1):
            for column in range(nx):  # whole rows at once, so that the loop keeps vectors
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


@njit(cache=True)
def turned_gradient(d_r, d_theta, cosine, sine, du, dv):
    """Fill ``du`` and ``dv`` (rings, spokes) from the slopes along the radius and across it."""
    for i in range(d_r.shape[0]):
        for j in range(d_r.shape[1]):
            du[i, j] = cosine[j] * d_r[i, j] - sine[j] * d_theta[i, j]
            dv[i, j] = sine[j] * d_r[i, j] + cosine[j] * d_theta[i, j]
