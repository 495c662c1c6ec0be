"""Compiled kernels of batches: pupil functions on mirrored nodes, intensities, and their adjoints.

Nodes and image points are mirrored about both axes. Parts of a function are numbered by parity:
even in u and v, odd in u, odd in v, odd in both.
"""

from __future__ import annotations

import math

import numpy as np

from ...kernels.compiling import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _phasors(turns, cosine, sine):
    """Fill ``cosine`` and ``sine`` of 2 pi ``turns`` (n,), to rounding error.

    Taylor series on an eighth of a turn to either side of a quarter; a loop without branches or
    calls is compiled to vector instructions.
    """
    for i in range(turns.shape[0]):
        quarter = math.floor(4.0 * turns[i] + 0.5)
        x = 2.0 * math.pi * (turns[i] - 0.25 * quarter)
        y = x * x
        s = 1.0 - y / 110.0 * (1.0 - y / 156.0 * (1.0 - y / 210.0 * (1.0 - y / 272.0)))
        s = x * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * s))))
        c = 1.0 - y / 182.0 * (1.0 - y / 240.0 * (1.0 - y / 306.0))
        c = 1.0 - y / 56.0 * (1.0 - y / 90.0 * (1.0 - y / 132.0 * c))
        c = 1.0 - y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * c))
        # cosines and signs of the quarters 0, 1, 2, 3 as polynomials of their number
        q = quarter - 4.0 * math.floor(0.25 * quarter)
        odd = q - 2.0 * math.floor(0.5 * q)
        down = 1.0 - 2.0 * math.floor(0.5 * q)
        cosine[i] = down * (c + odd * (-s - c))
        sine[i] = down * (s + odd * (c - s))


@njit(cache=True, nogil=True, error_model="numpy")
def _turns(values, ramps, b, turns):
    """Fill ``turns`` (4, n) of wave ``b`` at nodes (u, v), (-u, v), (u, -v), (-u, -v)."""
    for i in range(turns.shape[1]):
        even, both = values[0, b, i], values[3, b, i]
        along_u, along_v = values[1, b, i] + ramps[0, i], values[2, b, i] + ramps[1, i]
        turns[0, i] = even + along_u + along_v + both
        turns[1, i] = even - along_u + along_v - both
        turns[2, i] = even + along_u - along_v - both
        turns[3, i] = even - along_u - along_v + both


@njit(cache=True, nogil=True, error_model="numpy")
def pupil_parts(values, ramps, sizes, parts):
    """Fill ``parts`` (2, 2, 2, waves, n): parity in u, parity in v, real or imaginary, of pupils.

    ``values`` (4, waves, n) are parts of the aberration in turns, to which the linear ``ramps``
    (2, n), in turns, are added. ``sizes`` (4, n) are amplitudes times areas.
    """
    n = sizes.shape[1]
    turns, cosine, sine = np.empty((4, n)), np.empty((4, n)), np.empty((4, n))
    for b in range(values.shape[1]):
        _turns(values, ramps, b, turns)
        _phasors(turns.ravel(), cosine.ravel(), sine.ravel())
        for k, wave in ((0, cosine), (1, sine)):
            for i in range(n):
                p, q = sizes[0, i] * wave[0, i], sizes[1, i] * wave[1, i]
                r, s = sizes[2, i] * wave[2, i], sizes[3, i] * wave[3, i]
                parts[0, 0, k, b, i] = (p + q) + (r + s)
                parts[1, 0, k, b, i] = (p - q) + (r - s)
                parts[0, 1, k, b, i] = (p + q) - (r + s)
                parts[1, 1, k, b, i] = (p - q) - (r - s)


@njit(cache=True, nogil=True, error_model="numpy")
def phase_gradients(values, ramps, sizes, parts, out):
    """Fill ``out`` (4, waves, n), the gradient with respect to ``values``.

    ``parts`` is the gradient with respect to the result of `pupil_parts`.
    """
    n = sizes.shape[1]
    turns, cosine, sine = np.empty((4, n)), np.empty((4, n)), np.empty((4, n))
    slope = np.empty((4, n))
    for b in range(values.shape[1]):
        _turns(values, ramps, b, turns)
        _phasors(turns.ravel(), cosine.ravel(), sine.ravel())
        for node in range(4):
            across, up = 1.0 - 2.0 * (node % 2), 1.0 - 2.0 * (node // 2)
            for i in range(n):
                real = parts[0, 0, 0, b, i] + across * parts[1, 0, 0, b, i]
                real += up * (parts[0, 1, 0, b, i] + across * parts[1, 1, 0, b, i])
                imag = parts[0, 0, 1, b, i] + across * parts[1, 0, 1, b, i]
                imag += up * (parts[0, 1, 1, b, i] + across * parts[1, 1, 1, b, i])
                angle = imag * cosine[node, i] - real * sine[node, i]
                slope[node, i] = 2.0 * math.pi * sizes[node, i] * angle
        for i in range(n):
            p, q, r, s = slope[0, i], slope[1, i], slope[2, i], slope[3, i]
            out[0, b, i] = (p + q) + (r + s)
            out[1, b, i] = (p - q) + (r - s)
            out[2, b, i] = (p + q) - (r + s)
            out[3, b, i] = (p - q) - (r - s)


@njit(cache=True, nogil=True, error_model="numpy")
def intensities(fields, scale, out):
    """Fill ``out`` (ny, nx) with ``scale |U|^2``.

    ``fields`` (2, 2, 2, rows, columns) holds sums over the parts of a pupil: times the cosine or
    sine along u, along v, and real or imaginary, so that
    ``U(x, y) = [0, 0] - i [1, 0] - i [0, 1] - [1, 1]``. Sines change sign with x and y. [0, 0] is
    the sample next to the middle, which has three mirror images.
    """
    ny, nx = out.shape
    half = (nx + 1) // 2
    left = np.empty((2, half))
    for j in range((ny + 1) // 2):
        up, down = out[ny // 2 + j, nx // 2 :], out[(ny - 1) // 2 - j, nx // 2 :]
        for i in range(half):
            even_r, even_i = fields[0, 0, 0, j, i], fields[0, 0, 1, j, i]
            u_r, u_i = fields[1, 0, 0, j, i], fields[1, 0, 1, j, i]
            v_r, v_i = fields[0, 1, 0, j, i], fields[0, 1, 1, j, i]
            both_r, both_i = fields[1, 1, 0, j, i], fields[1, 1, 1, j, i]
            a, b, c, d = even_r - both_r, even_i - both_i, u_i + v_i, u_r + v_r
            up[i] = scale * ((a + c) * (a + c) + (b - d) * (b - d))
            left[1, i] = scale * ((a - c) * (a - c) + (b + d) * (b + d))
            a, b, c, d = even_r + both_r, even_i + both_i, u_i - v_i, u_r - v_r
            down[i] = scale * ((a + c) * (a + c) + (b - d) * (b - d))
            left[0, i] = scale * ((a - c) * (a - c) + (b + d) * (b + d))
        up, down = out[ny // 2 + j, :half], out[(ny - 1) // 2 - j, :half]
        for i in range(half):
            up[i], down[i] = left[0, half - 1 - i], left[1, half - 1 - i]


@njit(cache=True, nogil=True, error_model="numpy")
def field_gradients(fields, scale, gradient, out):
    """Fill ``out``, shaped like ``fields`` of `intensities`, with the gradient of a function.

    ``gradient`` (ny, nx) is its gradient with respect to the intensities.
    """
    ny, nx = gradient.shape
    half = (nx + 1) // 2
    left = np.empty((2, half))
    for j in range((ny + 1) // 2):
        up, down = gradient[ny // 2 + j, :half], gradient[(ny - 1) // 2 - j, :half]
        for i in range(half):
            left[0, half - 1 - i], left[1, half - 1 - i] = up[i], down[i]
        up, down = gradient[ny // 2 + j, nx // 2 :], gradient[(ny - 1) // 2 - j, nx // 2 :]
        # a sample on an axis is its own mirror image
        weight = scale if j == 0 and ny % 2 else 2.0 * scale
        for i in range(half):
            even_r, even_i = fields[0, 0, 0, j, i], fields[0, 0, 1, j, i]
            u_r, u_i = fields[1, 0, 0, j, i], fields[1, 0, 1, j, i]
            v_r, v_i = fields[0, 1, 0, j, i], fields[0, 1, 1, j, i]
            both_r, both_i = fields[1, 1, 0, j, i], fields[1, 1, 1, j, i]
            first, second = weight * up[i], weight * left[0, i]
            third, fourth = weight * down[i], weight * left[1, i]
            a, b, c, d = even_r - both_r, even_i - both_i, u_i + v_i, u_r + v_r
            first_r, first_i = first * (a + c), first * (b - d)
            fourth_r, fourth_i = fourth * (a - c), fourth * (b + d)
            a, b, c, d = even_r + both_r, even_i + both_i, u_i - v_i, u_r - v_r
            third_r, third_i = third * (a + c), third * (b - d)
            second_r, second_i = second * (a - c), second * (b + d)
            out[0, 0, 0, j, i] = (first_r + second_r) + (third_r + fourth_r)
            out[0, 0, 1, j, i] = (first_i + second_i) + (third_i + fourth_i)
            out[1, 0, 0, j, i] = (second_i - first_i) + (fourth_i - third_i)
            out[1, 0, 1, j, i] = (first_r - second_r) + (third_r - fourth_r)
            out[0, 1, 0, j, i] = (third_i + fourth_i) - (first_i + second_i)
            out[0, 1, 1, j, i] = (first_r + second_r) - (third_r + fourth_r)
            out[1, 1, 0, j, i] = (second_r - first_r) + (third_r - fourth_r)
            out[1, 1, 1, j, i] = (second_i - first_i) + (third_i - fourth_i)
        if nx % 2:
            out[:, :, :, j, 0] *= 0.5
