"""Counter-based uniform random numbers: the same address gives the same bits on any thread."""

from __future__ import annotations

import math

import numpy as np

from .compiling import njit

LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
SHIFT = np.uint64(11)


@njit(cache=True)
def _rounds(c0, c1, c2, c3, k0, k1):
    """Return the four words of Philox4x32-10, in uint64 variables; Salmon et al., SC 2011."""
    for _ in range(10):
        p0, p1 = np.uint64(0xD2511F53) * c0, np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (p1 >> HALF) ^ c1 ^ k0, p1 & LOW, (p0 >> HALF) ^ c3 ^ k1, p0 & LOW
        k0, k1 = (k0 + np.uint64(0x9E3779B9)) & LOW, (k1 + np.uint64(0xBB67AE85)) & LOW
    return c0, c1, c2, c3


@njit(cache=True)
def philox(counters, seed, words):
    """Fill ``words`` (n, 4), uint32, with the Philox words of ``counters`` and the key ``seed``."""
    k0, k1 = seed & LOW, seed >> HALF
    for i in range(counters.shape[0]):
        a, b, c, d = _rounds(
            np.uint64(counters[i, 0]),
            np.uint64(counters[i, 1]),
            np.uint64(counters[i, 2]),
            np.uint64(counters[i, 3]),
            k0,
            k1,
        )
        words[i, 0], words[i, 1], words[i, 2], words[i, 3] = a, b, c, d


@njit(cache=True)
def uniform(seed, stream, ray, draw):
    """Return the uniform number in [0, 1), 53 bits, of an address.

    All arguments are uint64; ``stream`` is below 2^32.
    """
    a, b, _, _ = _rounds(ray & LOW, ray >> HALF, draw & LOW, stream, seed & LOW, seed >> HALF)
    return float(((a << HALF) | b) >> SHIFT) * 1.1102230246251565e-16


@njit(cache=True)
def scramble(columns, matrices, out):
    """Multiply Sobol columns by random binary matrices, which scrambles the points.

    Parameters
    ----------
    columns : ndarray of uint32, (dimensions, 32)
        Generator columns of each dimension.
    matrices : ndarray of uint32, (groups, dimensions, 32)
        Matrices by columns: element k holds the digits to which digit k contributes.
    out : ndarray of uint32, (groups, dimensions, 32)
        Scrambled columns; filled.
    """
    for group in range(out.shape[0]):
        for dimension in range(out.shape[1]):
            for k in range(32):
                x, left = np.uint32(0), columns[dimension, k]
                for digit in range(32):
                    if (left >> np.uint32(digit)) & np.uint32(1):
                        x ^= matrices[group, dimension, digit]
                out[group, dimension, k] = x


@njit(cache=True)
def sobol(columns, shift, index):
    """Return coordinate ``index`` of one scrambled Sobol dimension, in (0, 1).

    ``columns`` (32,) are its generator columns and ``shift`` its digital shift, uint32.
    """
    x = np.uint64(shift)
    bit = 0
    while index:
        # a mask of all ones or zeros instead of a branch, which would be mispredicted half the time
        x ^= columns[bit] & (np.uint64(0) - (index & np.uint64(1)))
        index >>= np.uint64(1)
        bit += 1
    # centre of the interval of width 2^-32 that the digits determine
    return (float(x) + 0.5) * 2.3283064365386963e-10


@njit(cache=True)
def draw(sampler, group, index, ray, number):
    """Return uniform number ``number`` of a ray: from Sobol points, beyond their dimensions Philox.

    ``sampler`` is (seed, columns (groups, dimensions, 32), shifts (groups, dimensions)). With zero
    dimensions all numbers come from Philox. The ray is point ``index`` of its group.
    """
    seed, columns, shifts = sampler
    if number < columns.shape[1]:
        return sobol(columns[group, number], shifts[group, number], np.uint64(index))
    return uniform(seed, np.uint64(301), np.uint64(ray), np.uint64(number))


@njit(cache=True)
def disc(u, v):
    """Map the unit square to the unit disc with equal areas.

    Neighbours stay neighbours: Shirley and Chiu, J. Graph. Tools 2, 1997.
    """
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if a == 0.0 and b == 0.0:
        return 0.0, 0.0
    if abs(a) > abs(b):
        r, turn = a, 0.25 * math.pi * (b / a)
    else:
        r, turn = b, 0.5 * math.pi - 0.25 * math.pi * (a / b)
    return r * math.cos(turn), r * math.sin(turn)
