"""Steps of total variation's splitting on numpy arrays, each in one pass over memory.

An iteration of the method of multipliers (ADMM) consists of Fourier transforms and of these steps.
Arrays are changed in place. ``free`` and ``seen`` are the object and its image that solve the
quadratic part, on the FFT grid (rows, columns), whose first corner is the frame (H, W). New values
are over-relaxed: moved `RELAXATION` times as far from the old ones. ``level`` is the background's
strength and ``ratio`` the multiplier over the data penalty: a pixel keeps 1/(1 + ratio weight) of
its misfit.

``sums`` (3, columns) receive sums of columns in double precision, since the sum of a column's terms
depends on the order of rows alone, and columns can be summed side by side: `shrink_edges`, the
total variation; `keep_positive`, the squares of the object, of its change and of ``free`` minus the
object; `relax_image`, the squares of the misfit before, and the two sums whose ratio is the best
strength of the background; `weigh_misfit`, the squares of what is kept of the misfit, and minus
half the derivative with respect to ``ratio``. Numbers are brought to the arrays' precision first.
No divisor is zero; a check for it, which numba's own error model makes, would take three times as
long as the rest.
"""

import math

import numpy as np

from ...kernels.compiling import njit

# From the old value to the new one, relative to a step without over-relaxation. From sweeps over
# smooth and speckle kernels, 128^2 and 512^2.
RELAXATION = 1.7
TINY = 1e-30  # length of a gradient below which it has no direction


@njit(cache=True, error_model="numpy")
def pull(edges, edge_dual, edge_penalty, signed, sign_dual, sign_penalty, out):
    across, along = out.dtype.type(edge_penalty), out.dtype.type(sign_penalty)
    rows, columns = out.shape
    for row in range(rows):
        above = row - 1 if row else rows - 1
        for column in range(columns):
            here = edges[0, above, column] - edge_dual[0, above, column]
            here -= edges[0, row, column] - edge_dual[0, row, column]
            here -= edges[1, row, column] - edge_dual[1, row, column]
            there = signed[row, column] - sign_dual[row, column]
            out[row, column] = across * here + along * there
        for column in range(1, columns):
            left = edges[1, row, column - 1] - edge_dual[1, row, column - 1]
            out[row, column] += across * left
        out[row, 0] += across * (edges[1, row, columns - 1] - edge_dual[1, row, columns - 1])


@njit(cache=True, error_model="numpy")
def mix(image, pull, filtered, inverse, transfer):
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            free = filtered[row, column] * image[row, column]
            free += inverse[row, column] * pull[row, column]
            image[row, column] = free
            pull[row, column] = transfer[row, column] * free


@njit(cache=True, error_model="numpy")
def shrink_edges(free, edges, edge_dual, most, sums):
    kind = free.dtype.type
    relaxation, limit, zero, tiny = kind(RELAXATION), kind(most), kind(0.0), kind(TINY)
    rows, columns = free.shape
    right = np.empty(columns, free.dtype)
    for row in range(rows):
        below = row + 1 if row + 1 < rows else 0
        for column in range(columns - 1):
            right[column] = free[row, column + 1]
        right[columns - 1] = free[row, 0]
        for column in range(columns):
            y, x = edges[0, row, column], edges[1, row, column]
            y += relaxation * (free[below, column] - free[row, column] - y)
            x += relaxation * (right[column] - free[row, column] - x)
            y += edge_dual[0, row, column]
            x += edge_dual[1, row, column]
            length = math.sqrt(y * y + x * x)
            left = max(length - limit, zero)
            sums[0, column] += left
            share = left / max(length, tiny)
            edges[0, row, column] = y * share
            edges[1, row, column] = x * share
            edge_dual[0, row, column] = y - y * share
            edge_dual[1, row, column] = x - x * share


@njit(cache=True, error_model="numpy")
def keep_positive(free, signed, sign_dual, high, wide, sums):
    relaxation, zero = free.dtype.type(RELAXATION), free.dtype.type(0.0)
    for row in range(free.shape[0]):
        allowed = wide if row < high else 0
        for column in range(free.shape[1]):
            old = signed[row, column]
            moved = old + relaxation * (free[row, column] - old) + sign_dual[row, column]
            new = max(moved, zero) if column < allowed else zero
            sums[0, column] += new * new
            sums[1, column] += (new - old) * (new - old)
            sums[2, column] += (free[row, column] - new) * (free[row, column] - new)
            sign_dual[row, column] = moved - new
            signed[row, column] = new


@njit(cache=True, error_model="numpy")
def relax_image(seen, predicted, dual, image, shape, weights, level, ratio, sums):
    kind = seen.dtype.type
    relaxation, one, level, ratio = kind(RELAXATION), kind(1.0), kind(level), kind(ratio)
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            predicted[row, column] += relaxation * (seen[row, column] - predicted[row, column])
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            weight, unit = weights[row, column], shape[row, column]
            misfit = seen[row, column] + level * unit - image[row, column]
            sums[0, column] += weight * misfit * misfit
            predicted[row, column] += dual[row, column]
            part = weight * unit / (one + ratio * weight)
            sums[1, column] += part * (image[row, column] - predicted[row, column])
            sums[2, column] += part * unit


@njit(cache=True, error_model="numpy")
def weigh_misfit(predicted, image, shape, weights, level, ratio, sums):
    kind = image.dtype.type
    one, level, ratio = kind(1.0), kind(level), kind(ratio)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            weight = weights[row, column]
            kept = one / (one + ratio * weight)
            misfit = predicted[row, column] + level * shape[row, column] - image[row, column]
            part = weight * (misfit * kept) * (misfit * kept)
            sums[0, column] += part
            sums[1, column] += part * kept * weight


@njit(cache=True, error_model="numpy")
def split_misfit(predicted, dual, image, shape, weights, level, ratio):
    kind = image.dtype.type
    one, level, ratio = kind(1.0), kind(level), kind(ratio)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            misfit = predicted[row, column] + level * shape[row, column] - image[row, column]
            dual[row, column] = misfit - misfit / (one + ratio * weights[row, column])
            predicted[row, column] -= dual[row, column]
