"""Compiled loops over sampled waves: phasors and squared moduli.

Kernels that a plan needs allocate no arrays: to load them, numba would import its own arrays.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit

#: Adding and subtracting it rounds a double below 2^51 to an integer. Without a call to a rounding
#: function the loop is vectorised.
WHOLE = 6755399441055744.0
#: Magnitudes of the terms of the Taylor series of cosine and of sine, the highest degree first.
COSINE = tuple(1.0 / math.factorial(n) for n in range(22, -1, -2))
SINE = tuple(1.0 / math.factorial(n) for n in range(21, 0, -2))
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
        cosine, sine = COSINE[0], SINE[0]
        for term in COSINE[1:]:
            cosine = term - s * cosine
        for term in SINE[1:]:
            sine = term - s * sine
        real[i] = strength * cosine
        imaginary[i] = strength * (x * sine)


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


@njit(cache=True, nogil=True)
def squares(field, out):
    """Fill ``out`` (rows, n) with the squared modulus of ``field``."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            value = field[i, j]
            out[i, j] = value.real * value.real + value.imag * value.imag
