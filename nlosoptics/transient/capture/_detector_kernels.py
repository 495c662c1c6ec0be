"""Compiled Poisson draws of photon counts.

Each bin has its own random numbers, so the counts do not depend on the number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.compiling import njit
from ...kernels.parallel import threaded
from ...kernels.random import uniform

#: Stream of the random generator.
COUNTS = np.uint64(451)


@njit(cache=True)
def _few(mean, seed, address):
    """Draw a Poisson count by inversion of the cumulative distribution."""
    left = uniform(seed, COUNTS, address, np.uint64(0))
    chance = math.exp(-mean)
    count = 0
    # at means below 10, the probability of 200 counts is far below the resolution of a double
    while left >= chance and count < 200:
        left -= chance
        count += 1
        chance *= mean / count
    return float(count)


@njit(cache=True)
def _many(mean, seed, address):
    """Draw a Poisson count by rejection: Hoermann, Insur. Math. Econ. 12, 39 (1993), PTRS."""
    b = 0.931 + 2.53 * math.sqrt(mean)
    a = -0.059 + 0.02483 * b
    inverse = 1.1239 + 1.1328 / (b - 3.4)
    easy = 0.9277 - 3.6224 / (b - 2.0)
    draw = np.uint64(0)
    while True:
        u = uniform(seed, COUNTS, address, draw) - 0.5
        v = 1.0 - uniform(seed, COUNTS, address, draw + np.uint64(1))
        draw += np.uint64(2)
        edge = 0.5 - abs(u)
        if edge <= 0.0:
            continue
        count = math.floor((2.0 * a / edge + b) * u + mean + 0.43)
        if edge >= 0.07 and v <= easy:
            return count
        if count < 0.0 or (edge < 0.013 and v > edge):
            continue
        bound = count * math.log(mean) - mean - math.lgamma(count + 1.0)
        if math.log(v * inverse / (a / (edge * edge) + b)) <= bound:
            return count


@threaded()
def poisson(means, seed, counts):
    """Fill ``counts`` (n,) with Poisson draws of means ``means`` (n,); ``seed`` is uint64."""
    for i in prange(means.shape[0]):
        mean = means[i]
        if mean <= 0.0:
            counts[i] = 0.0
        elif mean < 10.0:
            counts[i] = _few(mean, seed, np.uint64(i))
        else:
            counts[i] = _many(mean, seed, np.uint64(i))
