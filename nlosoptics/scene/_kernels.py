"""Heights of relay walls and lobes of materials, as compiled scalar functions.

A wall is handed over as ``terms``, (n, 8) float64: one row a summand, its kind in column 0 and
its parameters behind; and ``tables``, a flat float64 array that gridded terms point into.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

PLANE, SPHERE, CYLINDER, WAVE, GRID = 0, 1, 2, 3, 4
GRID_CHANNELS = 4  # value, d/dx, d/dy, d2/dxdy at every node


@njit(cache=True, inline="always")
def _hermite(t, step):
    """Cubic Hermite basis at t in [0, 1], with first and second derivatives in x."""
    t2 = t * t
    t3 = t2 * t
    values = (1 - 3 * t2 + 2 * t3, 3 * t2 - 2 * t3, (t - 2 * t2 + t3) * step, (t3 - t2) * step)
    first = ((6 * t2 - 6 * t) / step, (6 * t - 6 * t2) / step, 1 - 4 * t + 3 * t2, 3 * t2 - 2 * t)
    second = (
        (12 * t - 6) / (step * step),
        (6 - 12 * t) / (step * step),
        (6 * t - 4) / step,
        (6 * t - 2) / step,
    )
    return values, first, second


@njit(cache=True)
def _grid(row, tables, x, y):
    """Bicubic Hermite patch: row = (kind, x0, y0, step_x, step_y, n_x, n_y, offset)."""
    step_x, step_y = row[3], row[4]
    n_x, n_y, offset = int(row[5]), int(row[6]), int(row[7])
    fx, fy = (x - row[1]) / step_x, (y - row[2]) / step_y
    if not (-1e-9 <= fx <= n_x - 1 + 1e-9 and -1e-9 <= fy <= n_y - 1 + 1e-9):
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    ix = min(max(int(math.floor(fx)), 0), n_x - 2)
    iy = min(max(int(math.floor(fy)), 0), n_y - 2)
    bx, bx1, bx2 = _hermite(fx - ix, step_x)
    by, by1, by2 = _hermite(fy - iy, step_y)
    h = hx = hy = hxx = hxy = hyy = 0.0
    channel = n_x * n_y
    for j in range(2):
        for i in range(2):
            node = offset + (iy + j) * n_x + ix + i
            for dy in range(2):
                for dx in range(2):
                    c = tables[node + channel * (dx + 2 * dy)]
                    a, b = i + 2 * dx, j + 2 * dy
                    h += c * bx[a] * by[b]
                    hx += c * bx1[a] * by[b]
                    hy += c * bx[a] * by1[b]
                    hxx += c * bx2[a] * by[b]
                    hxy += c * bx1[a] * by1[b]
                    hyy += c * bx[a] * by2[b]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def surface(terms, tables, x, y):
    """Height of the wall and its derivatives (h, hx, hy, hxx, hxy, hyy) at (x, y).

    NaN where the wall has no height; callers turn that into a status.
    """
    h = hx = hy = hxx = hxy = hyy = 0.0
    for i in range(terms.shape[0]):
        row = terms[i]
        kind = int(row[0])
        if kind == SPHERE:
            c = row[1]  # signed curvature, positive toward the room at the rim
            root_sq = 1.0 - c * c * (x * x + y * y)
            if not root_sq > 0.0:
                return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
            root = math.sqrt(root_sq)
            # sag in the form that keeps its relative accuracy near the vertex
            h += c * (x * x + y * y) / (1.0 + root)
            hx += c * x / root
            hy += c * y / root
            cube = root * root_sq
            hxx += c * (1.0 - c * c * y * y) / cube
            hyy += c * (1.0 - c * c * x * x) / cube
            hxy += c * c * c * x * y / cube
        elif kind == CYLINDER:
            c, ax, ay = row[1], row[2], row[3]  # (ax, ay): unit vector across the axis
            t = ax * x + ay * y
            root_sq = 1.0 - c * c * t * t
            if not root_sq > 0.0:
                return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
            root = math.sqrt(root_sq)
            first, second = c * t / root, c / (root * root_sq)
            h += c * t * t / (1.0 + root)
            hx += first * ax
            hy += first * ay
            hxx += second * ax * ax
            hxy += second * ax * ay
            hyy += second * ay * ay
        elif kind == WAVE:
            a, kx, ky, phase = row[1], row[2], row[3], row[4]
            cosine, sine = math.cos(kx * x + ky * y + phase), math.sin(kx * x + ky * y + phase)
            h += a * cosine
            hx -= a * kx * sine
            hy -= a * ky * sine
            hxx -= a * kx * kx * cosine
            hxy -= a * kx * ky * cosine
            hyy -= a * ky * ky * cosine
        elif kind == GRID:
            g = _grid(row, tables, x, y)
            h += g[0]
            hx += g[1]
            hy += g[2]
            hxx += g[3]
            hxy += g[4]
            hyy += g[5]
    return h, hx, hy, hxx, hxy, hyy


@njit(cache=True)
def surfaces(terms, tables, x, y, out):
    """Fill ``out`` (n, 6) with `surface` at every (x, y)."""
    for i in range(x.size):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = surface(
            terms, tables, x[i], y[i]
        )


@njit(cache=True)
def _full_terms(mu_i, mu_o, s, s2):
    """C2 and C3 of the full Oren-Nayar 1994 model, without its first coefficient."""
    mu_max, mu_min = max(mu_i, mu_o, 1e-300), min(mu_i, mu_o)
    alpha, beta = math.acos(min(1.0, mu_min)), math.acos(min(1.0, mu_max))
    sin_alpha = math.sin(alpha)
    if sin_alpha < 1e-150:
        return 0.0
    cos_tan = s / (sin_alpha * mu_max)  # cos(dphi) tan(beta)
    c2 = math.sin(alpha)
    if s < 0.0:
        c2 -= (2.0 * beta / math.pi) ** 3
    c3 = 0.125 * s2 / (s2 + 0.09) * (4.0 * alpha * beta / math.pi**2) ** 2
    sin_beta = math.sin(beta)
    cos_dphi = min(1.0, max(-1.0, s / (sin_alpha * sin_beta))) if sin_beta > 1e-150 else 0.0
    between = math.tan(min(0.5 * (alpha + beta), 0.5 * math.pi))
    return 0.45 * s2 / (s2 + 0.09) * c2 * cos_tan + (1.0 - abs(cos_dphi)) * c3 * between


@njit(cache=True)
def oren_nayar(mu_i, mu_o, cos_between, albedo, slope_rms, full):
    """Oren-Nayar lobe f_r in 1/sr, free of angles: Wolff's qualitative fit, or the full model.

    ``cos_between`` is the dot product of the incident and exitant unit vectors, both pointing away
    from the surface; ``cos(dphi) sin(alpha) tan(beta) = S / max(mu_i, mu_o)`` with
    ``S = cos_between - mu_i mu_o``.
    """
    if mu_i < 0.0 or mu_o < 0.0:
        return 0.0
    s2 = slope_rms * slope_rms
    mu_max = max(mu_i, mu_o, 1e-300)  # both at grazing: large, yet finite
    s = cos_between - mu_i * mu_o
    direct = 1.0 - 0.5 * s2 / (s2 + 0.33)
    if full:
        direct += _full_terms(mu_i, mu_o, s, s2)
    elif s > 0.0:
        direct += 0.45 * s2 / (s2 + 0.09) * s / mu_max
    sines = math.sqrt(max(0.0, 1.0 - mu_i * mu_i)) * math.sqrt(max(0.0, 1.0 - mu_o * mu_o))
    # at normal incidence the azimuth has no meaning, and beta = 0 removes its term
    cos_dphi = min(1.0, max(-1.0, s / sines)) if sines > 1e-300 else 0.0
    beta = 2.0 * math.acos(min(1.0, mu_max)) / math.pi
    mutual = 0.17 * albedo * s2 / (s2 + 0.13) * (1.0 - cos_dphi * beta * beta)
    return albedo / math.pi * (direct + mutual)


@njit(cache=True)
def _masked_cosine(mu, alpha):
    """Cosine over Smith's masking, mu (1 + Lambda), which stays above zero down to grazing.

    ``Lambda = exp(-a^2)/(2 a sqrt(pi)) - erfc(a)/2`` with ``a = mu / (alpha sin)``.
    """
    spread = alpha * math.sqrt(max(0.0, 1.0 - mu * mu))
    if spread < 0.1 * mu:  # a > 10: Lambda < 1e-45
        return mu
    a = mu / spread
    return mu + 0.5 * (spread * math.exp(-a * a) / math.sqrt(math.pi) - mu * math.erfc(a))


@njit(cache=True)
def beckmann(mu_i, mu_o, cos_between, reflectance, slope_rms):
    """Microfacet lobe f_r in 1/sr: Beckmann normals, separable Smith shadowing, flat Fresnel."""
    if mu_i < 0.0 or mu_o < 0.0 or slope_rms <= 0.0:
        return 0.0
    alpha_sq = 2.0 * slope_rms * slope_rms
    half_sq = 2.0 + 2.0 * cos_between  # squared length of the half vector
    if half_sq <= 0.0:
        return 0.0
    cos_sq = min(1.0, (mu_i + mu_o) ** 2 / half_sq)
    if 1.0 - cos_sq > 700.0 * alpha_sq * cos_sq:
        return 0.0  # exp(-700) against a lobe of 1/alpha^2
    density = math.exp((cos_sq - 1.0) / (alpha_sq * cos_sq)) / (math.pi * alpha_sq * cos_sq**2)
    alpha = math.sqrt(alpha_sq)
    return reflectance * density / (4.0 * _masked_cosine(mu_i, alpha) * _masked_cosine(mu_o, alpha))


LAMBERT, OREN_NAYAR, OREN_NAYAR_FULL, BECKMANN = 0, 1, 2, 3


@njit(cache=True)
def evaluate(lobes, mu_i, mu_o, cos_between, out):
    """Sum of lobes, ``lobes`` (n, 4): kind, strength, slope rms, common factor; ``out`` (m,)."""
    for i in range(out.size):
        total = 0.0
        for j in range(lobes.shape[0]):
            kind = int(lobes[j, 0])
            if kind == LAMBERT:
                if mu_i[i] >= 0.0 and mu_o[i] >= 0.0:
                    total += lobes[j, 3] * lobes[j, 1] / math.pi
            elif kind == BECKMANN:
                total += lobes[j, 3] * beckmann(
                    mu_i[i], mu_o[i], cos_between[i], lobes[j, 1], lobes[j, 2]
                )
            else:
                total += lobes[j, 3] * oren_nayar(
                    mu_i[i],
                    mu_o[i],
                    cos_between[i],
                    lobes[j, 1],
                    lobes[j, 2],
                    kind == OREN_NAYAR_FULL,
                )
        out[i] = total


NO_TABLES = np.zeros(1)
