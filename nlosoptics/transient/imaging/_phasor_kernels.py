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


@njit(cache=True, nogil=True)
def fill_kernels(across, up, away, ways, first, step, kernels):
    """Fill ``kernels`` (k, z, y, x) with exp(i ways k r).

    r is the length of the vector (across[x], up[y], away[z]), m. Each wavenumber follows from the
    one before by a factor exp(i step ways r).
    """
    values = np.empty(len(across), np.complex128)
    turns = np.empty(len(across), np.complex128)
    for flat in range(len(away) * len(up)):
        z, y = flat // len(up), flat % len(up)
        for x in range(len(across)):
            path = ways * math.sqrt(across[x] ** 2 + up[y] ** 2 + away[z] ** 2)
            values[x] = complex(math.cos(first * path), math.sin(first * path))
            turns[x] = complex(math.cos(step * path), math.sin(step * path))
        for k in range(kernels.shape[0]):
            for x in range(len(across)):
                kernels[k, z, y, x] = values[x]
                values[x] *= turns[x]


@njit(cache=True, nogil=True)
def multiply_row(spectrum, kernel, row):
    """Fill ``row`` with spectrum times kernel; a half kernel is continued by its mirror image."""
    count = len(row)
    half = min(count, len(kernel))
    for x in range(half):
        row[x] = spectrum[x] * kernel[x]
    for x in range(half, count):
        row[x] = spectrum[x] * kernel[count - x]


@njit(cache=True, nogil=True)
def add_product(spectrum, kernel, row, product):
    """Add spectrum * kernel to ``product``, folded to the period of ``product``.

    Summing b periods of a transform gives b times the transform of every b-th sample, so that the
    inverse transform returns only the samples at voxels.
    """
    rows, columns = product.shape
    height, width = spectrum.shape
    for y in range(height):
        multiply_row(spectrum[y], kernel[y if y < len(kernel) else height - y], row)
        line = product[y % rows]
        for start in range(0, width, columns):
            for x in range(columns):
                line[x] += row[start + x]


@njit(cache=True, nogil=True)
def multiply_waves(spectra, kernels, products):
    """Set products[k, z] to spectra[k] * kernels[k, z], folded to the period of the product."""
    height, width = spectra.shape[1:]
    row = np.empty(width, products.dtype)
    for k in range(products.shape[0]):
        for z in range(products.shape[1]):
            product, kernel = products[k, z], kernels[k, z]
            if product.shape == (height, width):
                for y in range(height):
                    other = kernel[y if y < len(kernel) else height - y]
                    multiply_row(spectra[k, y], other, product[y])
            else:
                product[:] = 0.0
                add_product(spectra[k], kernel, row, product)


@njit(cache=True, nogil=True)
def sum_waves(spectra, kernels, products):
    """Set products[z] to the sum over k of spectra[k] * kernels[k, z], folded to its period."""
    row = np.empty(spectra.shape[2], products.dtype)
    products[:] = 0.0
    for k in range(kernels.shape[0]):
        for z in range(kernels.shape[1]):
            add_product(spectra[k], kernels[k, z], row, products[z])


@njit(cache=True, nogil=True)
def add_waves(fields, xs, ys, zs, far, first, step, turns, total):
    """Add the sum over k of fields[k] turns[t, k] exp(i k r) to ``total`` (t, z, y, x).

    Wavenumbers are k = first + j step. r is the distance of a voxel from the point ``far`` (1, 3),
    m, and 0 if ``far`` is empty.
    """
    legs = far.shape[0] > 0
    for flat in range(len(zs) * len(ys)):
        z, y = flat // len(ys), flat % len(ys)
        values = np.ones(len(xs), np.complex128)
        steps = np.ones(len(xs), np.complex128)
        if legs:
            square = (ys[y] - far[0, 1]) ** 2 + (zs[z] - far[0, 2]) ** 2
            for x in range(len(xs)):
                leg = math.sqrt((xs[x] - far[0, 0]) ** 2 + square)
                values[x] = complex(math.cos(first * leg), math.sin(first * leg))
                steps[x] = complex(math.cos(step * leg), math.sin(step * leg))
        for k in range(fields.shape[0]):
            for t in range(total.shape[0]):
                for x in range(len(xs)):
                    total[t, z, y, x] += fields[k, z, y, x] * values[x] * turns[t, k]
            for x in range(len(xs)):
                values[x] *= steps[x]
