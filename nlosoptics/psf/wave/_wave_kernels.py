"""Compiled loops over sampled waves: phasors, polynomials, slopes and moments.

Kernels that a plan needs allocate no arrays: to load them, numba would import its own arrays.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit

#: Adding and subtracting it rounds a double below 2^51 to an integer. Without a call to a rounding
#: function the loop is vectorised.
WHOLE = 6755399441055744.0
#: Nodes whose phasors are computed at a time; their parts fit into the processor's nearest cache.
BLOCK = 1024


@njit(cache=True)
def phasors(turns, size, real, imaginary):
    """Fill ``real`` and ``imaginary`` (n,) with ``size exp(2 pi i turns)``, accurate to 3e-16.

    Whole half turns are subtracted, which is exact. The remaining angle, at most pi/2, goes into
    Taylor series of sine and cosine.
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
def tilted_wave(u, v, path, size, along, across, per_metre, out):
    """Fill the complex ``out`` (n,) with a wave at points u, v (n,), in blocks.

    It has the amplitude ``size`` (n,) and the phase ``along u + across v + per_metre path``, turns.
    """
    turns, real, imaginary = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, out.shape[0], BLOCK):
        stop = min(start + BLOCK, out.shape[0])
        count = stop - start
        x, y, paths, part = u[start:stop], v[start:stop], path[start:stop], out[start:stop]
        for i in range(count):
            turns[i] = along * x[i] + across * y[i] + per_metre * paths[i]
        phasors(turns[:count], size[start:stop], real[:count], imaginary[:count])
        for i in range(count):
            part[i] = complex(real[i], imaginary[i])


@njit(cache=True, nogil=True)
def unit_wave(phase, turns, out):
    """Fill the complex ``out`` (n,) with ``exp(2 pi i turns phase)``, in blocks."""
    part, size, real, imaginary = np.empty(BLOCK), np.ones(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, out.shape[0], BLOCK):
        count = min(BLOCK, out.shape[0] - start)
        given, line = phase[start : start + count], out[start : start + count]
        for i in range(count):
            part[i] = turns * given[i]
        phasors(part[:count], size[:count], real[:count], imaginary[:count])
        for i in range(count):
            line[i] = complex(real[i], imaginary[i])


@njit(cache=True, nogil=True)
def delayed(waves, u, v, along, mixed, across):
    """Multiply plane waves (n, m) by ``exp(-2 pi i turns)``; u (m,) and v (n,) are frequencies.

    The turns are ``along u^2 + mixed u v + across v^2``.
    """
    count = u.shape[0]
    turns, size = np.empty(count), np.ones(count)
    real, imaginary = np.empty(count), np.empty(count)
    for i in range(v.shape[0]):
        line = waves[i]
        for j in range(count):
            turns[j] = -(along * u[j] * u[j] + mixed * u[j] * v[i] + across * v[i] * v[i])
        phasors(turns, size, real, imaginary)
        for j in range(count):
            line[j] *= complex(real[j], imaginary[j])


@njit(cache=True)
def polynomial(powers, rho, cosine, sine, out):
    """Fill ``out`` (radii, angles) with the polynomial ``sum powers[i, j] u^i v^j``."""
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
def slopes(powers, rho, cosine, sine, work, du, dv):
    """Fill ``du``, ``dv`` (radii, angles) with the gradient of ``sum powers[i, j] u^i v^j``.

    ``work`` (4, angles) is overwritten.
    """
    n = powers.shape[0]
    u, v, value, slope = work[0], work[1], work[2], work[3]
    for k in range(rho.shape[0]):
        along, across = du[k], dv[k]
        for m in range(u.shape[0]):
            u[m], v[m] = rho[k] * cosine[m], rho[k] * sine[m]
            along[m] = across[m] = 0.0
        for i in range(n - 1, -1, -1):
            for m in range(u.shape[0]):
                value[m] = slope[m] = 0.0
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
    """Return minimum, maximum, mean and rms about the mean of ``path`` (n,).

    ``share`` (n,) are weights; points of weight 0 are ignored.
    """
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
def jacobian_extremes(x, y, r, apart):
    """Return the extremes of the signed ratio of image area to pupil area on a polar grid.

    ``x`` and ``y`` (rings, spokes) are the rays' landing points and ``r`` (rings,) the rings'
    radii. Cells between rings less than ``apart`` apart are skipped, because differences would be
    rounding errors.
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
            # The cross product of a cell's diagonals is twice its area.
            first_x, first_y = x[i + 1, k] - x[i, j], y[i + 1, k] - y[i, j]
            second_x, second_y = x[i + 1, j] - x[i, k], y[i + 1, j] - y[i, k]
            area = (first_x * second_y - first_y * second_x) / own
            low, high = min(low, area), max(high, area)
    return low, high


@njit(cache=True, nogil=True)
def squares(field, out):
    """Fill ``out`` (rows, n) with the squared modulus of ``field``."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            value = field[i, j]
            out[i, j] = value.real * value.real + value.imag * value.imag
