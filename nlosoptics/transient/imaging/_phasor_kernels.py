"""Compiled loops of the Rayleigh-Sommerfeld sums; the callers check and allocate.

Functions that work on planes are single-threaded, because their callers distribute planes over
threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...kernels.compiling import njit
from ...kernels.parallel import threaded

ALONE, ALL, PAIRED = 0, 1, 2


@njit(cache=True)
def distance(a, b):
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True)
def add_path(path, first, step, spectrum, field):
    """Add spectrum[j] * exp(i k path) to ``field[j]``, for k = first + j step.

    Four wavenumbers advance in parallel, which avoids a chain of dependent products.
    """
    turn = complex(math.cos(step * path), math.sin(step * path))
    one = complex(math.cos(first * path), math.sin(first * path))
    two = one * turn
    turn *= turn
    three, four = one * turn, two * turn
    turn *= turn
    count = len(spectrum)
    for j in range(0, count - 3, 4):
        field[j] += spectrum[j] * one
        field[j + 1] += spectrum[j + 1] * two
        field[j + 2] += spectrum[j + 2] * three
        field[j + 3] += spectrum[j + 3] * four
        one *= turn
        two *= turn
        three *= turn
        four *= turn
    rest = count - count % 4
    if rest < count:
        field[rest] += spectrum[rest] * one
    if rest + 1 < count:
        field[rest + 1] += spectrum[rest + 1] * two
    if rest + 2 < count:
        field[rest + 2] += spectrum[rest + 2] * three


@threaded()
def direct_sum(voxels, near, far, legs, first, step, spectrum, turns, fields):
    """Fill ``fields`` (times, voxels) with sums of spectrum[j, i, k] exp(i k (path + t)).

    The sum runs over points j, i and wavenumbers k. ``legs`` defines the path; ALONE:
    |x - near_i|; ALL: |x - far_j| + |x - near_i|; PAIRED: |x - far_i| + |x - near_i|.
    ``turns`` (times, k) is exp(i k t).
    """
    n_far = far.shape[0] if legs == ALL else 1
    for v in prange(voxels.shape[0]):
        field = np.zeros(spectrum.shape[2], np.complex128)
        for j in range(n_far):
            lead = distance(voxels[v], far[j]) if legs == ALL else 0.0
            for i in range(near.shape[0]):
                leg = distance(voxels[v], near[i])
                if legs == PAIRED:
                    lead = distance(voxels[v], far[i])
                add_path(leg + lead, first, step, spectrum[j, i], field)
        for t in range(turns.shape[0]):
            total = 0j
            for k in range(len(field)):
                total += turns[t, k] * field[k]
            fields[t, v] = total


@njit(cache=True)
def bell(u, taps, beta):
    """Return the gridding kernel at a distance u in samples."""
    inside = 1.0 - (2.0 * u / taps) ** 2
    return math.exp(beta * (math.sqrt(inside) - 1.0)) if inside > 0.0 else 0.0


@njit(cache=True, nogil=True)
def fill_kernels(across, up, away, ways, sampling, first, kernels):
    """Fill ``kernels`` (n, 2, y, x) with exp(i wave r), gridded to the distances of n samples.

    r is ``ways`` times the length of the vector (across[x], up[y], away), m. Sample j is the
    distance (first + j) pitch. Real and imaginary part are apart. ``sampling`` is (wave, pitch,
    taps, beta), the last two for `bell`.
    """
    wave, pitch, taps, beta = sampling
    kernels[:] = 0.0
    for y in range(len(up)):
        square = up[y] ** 2 + away**2
        for x in range(len(across)):
            r = ways * math.sqrt(across[x] ** 2 + square)
            real, imaginary = math.cos(wave * r), math.sin(wave * r)
            u = r / pitch - first
            low = int(math.ceil(u - 0.5 * taps))
            for j in range(low, low + taps):
                w = bell(u - j, taps, beta)
                kernels[j, 0, y, x] = w * real
                kernels[j, 1, y, x] = w * imaginary


@njit(cache=True, nogil=True)
def correlate(kernels, walls, start, products):
    """Fill ``products`` (t, c, blocks, p) with the sum over j of kernel j times wall start + j + t.

    ``kernels`` (blocks, n, 2, p) and ``walls`` (blocks, c, m, 2, p) are transforms in blocks of p
    frequencies, with real and imaginary part apart; c counts the quadrants that share a kernel. n
    is even.
    """
    n_times = products.shape[0]
    sums = np.empty((n_times, 2, kernels.shape[3]), kernels.dtype)
    for block in range(kernels.shape[0]):
        for c in range(walls.shape[1]):
            sums[:] = 0.0
            for t in range(0, n_times - 1, 2):
                for j in range(0, kernels.shape[1], 2):
                    _add_four(kernels[block], walls[block, c], j, start + j + t, t, sums)
            if n_times % 2:
                for j in range(kernels.shape[1]):
                    t = n_times - 1
                    _add_one(kernels[block], walls[block, c], j, start + j + t, t, sums)
            for t in range(n_times):
                for x in range(sums.shape[2]):
                    products[t, c, block, x] = complex(sums[t, 0, x], sums[t, 1, x])


@njit(cache=True)
def _add_one(kernel, wall, j, i, t, sums):
    """Add kernel j times wall i to sum t."""
    for x in range(sums.shape[2]):
        sums[t, 0, x] += kernel[j, 0, x] * wall[i, 0, x] - kernel[j, 1, x] * wall[i, 1, x]
        sums[t, 1, x] += kernel[j, 0, x] * wall[i, 1, x] + kernel[j, 1, x] * wall[i, 0, x]


@njit(cache=True)
def _add_four(kernel, wall, j, i, t, sums):
    """Add kernels j and j + 1 to sums t and t + 1 at once, which saves reading and writing."""
    for x in range(sums.shape[2]):
        a, b, c, d = kernel[j, 0, x], kernel[j, 1, x], kernel[j + 1, 0, x], kernel[j + 1, 1, x]
        p, q, r, s = wall[i, 0, x], wall[i, 1, x], wall[i + 1, 0, x], wall[i + 1, 1, x]
        v, w = wall[i + 2, 0, x], wall[i + 2, 1, x]
        sums[t, 0, x] += a * p - b * q + c * r - d * s
        sums[t, 1, x] += a * q + b * p + c * s + d * r
        sums[t + 1, 0, x] += a * r - b * s + c * v - d * w
        sums[t + 1, 1, x] += a * s + b * r + c * w + d * v


@njit(cache=True, nogil=True)
def add_moments(fields, place, times, sampling, first, total):
    """Add fields, interpolated to each voxel's leg from ``far`` plus t, to ``total`` (t, y, x).

    ``fields`` (n, y, x) are gridded samples at the moments (first + j) pitch, m, without the
    carrier exp(i wave t). ``place`` is (xs, ys, z, far) of the voxels. The leg is 0 if ``far``
    is empty.
    """
    (xs, ys, z, far), (wave, pitch, taps, beta) = place, sampling
    for y in range(len(ys)):
        for x in range(len(xs)):
            leg = 0.0
            if far.shape[0] > 0:
                square = (ys[y] - far[0, 1]) ** 2 + (z - far[0, 2]) ** 2
                leg = math.sqrt((xs[x] - far[0, 0]) ** 2 + square)
            for t in range(len(times)):
                moment = leg + times[t]
                u = moment / pitch - first
                low = int(math.ceil(u - 0.5 * taps))
                field = 0j
                for j in range(taps):
                    field += bell(u - low - j, taps, beta) * fields[low + j, y, x]
                turn = complex(math.cos(wave * moment), math.sin(wave * moment))
                total[t, y, x] += field * turn
