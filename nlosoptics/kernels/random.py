"""Uniform numbers addressed by place, compiled: the same address gives the same bits anywhere."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
SHIFT = np.uint64(11)


@njit(cache=True, inline="always")
def _rounds(c0, c1, c2, c3, k0, k1):
    """Philox4x32-10, all words held in uint64: Salmon et al., SC 2011."""
    for _ in range(10):
        p0, p1 = np.uint64(0xD2511F53) * c0, np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (p1 >> HALF) ^ c1 ^ k0, p1 & LOW, (p0 >> HALF) ^ c3 ^ k1, p0 & LOW
        k0, k1 = (k0 + np.uint64(0x9E3779B9)) & LOW, (k1 + np.uint64(0xBB67AE85)) & LOW
    return c0, c1, c2, c3


@njit(cache=True)
def philox(counters, seed, words):
    """Fill ``words`` (n, 4) uint32 with those of the counters (n, 4) uint32 and a 64-bit key."""
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
    """Uniform number in [0, 1), 53 bits, of its address; all arguments uint64, stream < 2^32."""
    a, b, _, _ = _rounds(ray & LOW, ray >> HALF, draw & LOW, stream, seed & LOW, seed >> HALF)
    return float(((a << HALF) | b) >> SHIFT) * 1.1102230246251565e-16


@njit(cache=True)
def scramble(columns, matrices, out):
    """Multiply columns (dimensions, 32) by binary matrices (groups, dimensions, 32), uint32.

    A matrix is given by the digits that each digit goes to.
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
    """Point ``index`` of one scrambled Sobol dimension: ``columns`` (32,) and ``shift``, uint32."""
    x = np.uint64(shift)
    bit = 0
    while index:
        # all ones or none: a jump on these digits would be guessed wrong half of the time
        x ^= columns[bit] & (np.uint64(0) - (index & np.uint64(1)))
        index >>= np.uint64(1)
        bit += 1
    # the middle of the cell of 2^-32 that the digits name
    return (float(x) + 0.5) * 2.3283064365386963e-10


@njit(cache=True)
def draw(sampler, group, index, ray, number):
    """Uniform number ``number`` of a ray: Sobol while its dimensions last, Philox beyond.

    ``sampler`` is (seed, columns (groups, dimensions, 32), shifts (groups, dimensions)); without
    dimensions all numbers are Philox's. The ray is point ``index`` of its group.
    """
    seed, columns, shifts = sampler
    if number < columns.shape[1]:
        return sobol(columns[group, number], shifts[group, number], np.uint64(index))
    return uniform(seed, np.uint64(301), np.uint64(ray), np.uint64(number))


@njit(cache=True)
def disc(u, v):
    """Point of the unit disc, by areas kept in order: Shirley and Chiu, J. Graph. Tools 2, 1997."""
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if a == 0.0 and b == 0.0:
        return 0.0, 0.0
    if abs(a) > abs(b):
        r, turn = a, 0.25 * math.pi * (b / a)
    else:
        r, turn = b, 0.5 * math.pi - 0.25 * math.pi * (a / b)
    return r * math.cos(turn), r * math.sin(turn)
