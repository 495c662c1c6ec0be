"""Compiled choice of lobes: directions of scattered rays, their densities, and narrow lobes."""

from __future__ import annotations

import math

from ...kernels.brdf import is_mirror, lobe, lobe_pdf, sample_lobe, total_strength
from ...kernels.codes import BECKMANN, WARD_1992
from ...kernels.compiling import njit
from ._surround_kernels import dot

# Lobes up to this slope rms, rad, are called narrow. Light that they reflect several times in a row
# is traced by `_chain_kernels`, as long as their facets are tilted by at most STEEPEST, rad.
NARROW_SLOPE = 0.1
STEEPEST = 0.3


@njit(cache=True)
def tangents(n):
    """Return two unit vectors perpendicular to n and to each other."""
    sign = math.copysign(1.0, n[2])
    p = -1.0 / (sign + n[2])
    q = n[0] * n[1] * p
    return (1.0 + sign * n[0] * n[0] * p, sign * q, -sign * n[0]), (
        q,
        sign + n[1] * n[1] * p,
        -n[1],
    )


@njit(cache=True)
def lobe_chance(lobes, j, total, eye):
    """Return the probability of drawing lobe ``j`` of a table of lobes."""
    strength = lobes[j, 4]
    if strength <= 0.0:
        return 0.0
    if not eye:
        return strength / total
    some = 0
    for k in range(lobes.shape[0]):
        some += 1 if lobes[k, 4] > 0.0 else 0
    return 0.5 * strength / total + 0.5 / some


@njit(cache=True)
def lobe_density(lobes, mu_i, mu_o, cos_between, eye):
    """Return the probability density, 1/sr, with which `lobe_direction` draws a direction."""
    total = total_strength(lobes)
    density = 0.0
    for j in range(lobes.shape[0]):
        chance = lobe_chance(lobes, j, total, eye)
        if chance > 0.0:
            density += chance * lobe_pdf(lobes, j, mu_i, mu_o, cos_between)
    return density


@njit(cache=True)
def lobe_direction(lobes, incident, n, u, v, w, eye):
    """Draw a direction from the lobes; return it with the weight of a chosen mirror, else -1."""
    a, b = tangents(n)
    ix, iy, iz = dot(incident, a), dot(incident, b), dot(incident, n)
    total = total_strength(lobes)
    chosen, left = -1, w
    for j in range(lobes.shape[0]):
        chance = lobe_chance(lobes, j, total, eye)
        if chance > 0.0 and (chosen < 0 or left >= 0.0):
            chosen = j
        left -= chance
    if chosen < 0:
        return n, 0.0
    x, y, z, _ = sample_lobe(lobes, chosen, ix, iy, iz, u, v)
    d = (
        x * a[0] + y * b[0] + z * n[0],
        x * a[1] + y * b[1] + z * n[1],
        x * a[2] + y * b[2] + z * n[2],
    )
    if is_mirror(lobes, chosen):
        return d, lobes[chosen, 1] * lobes[chosen, 3] / lobe_chance(lobes, chosen, total, eye)
    return d, -1.0


@njit(cache=True)
def is_narrow(lobes, j):
    """Return whether lobe ``j`` reflects light and is narrow; a smooth mirror is narrow too."""
    kind, slope = lobes[j, 0], lobes[j, 2]
    limit = NARROW_SLOPE * (math.sqrt(2.0) if kind >= WARD_1992 else 1.0)
    return kind >= BECKMANN and slope <= limit and lobes[j, 1] * lobes[j, 3] > 0.0


@njit(cache=True)
def facet_slope_sq(mu_i, mu_o, cos_between):
    """Return the squared tangent of the angle between half vector and normal."""
    both = (mu_i + mu_o) ** 2
    return max(0.0, 2.0 + 2.0 * cos_between - both) / both if both > 0.0 else math.inf


@njit(cache=True)
def narrow_part(lobes, mu_i, mu_o, cos_between):
    """Return f_r of the narrow lobes, 1/sr, without smooth mirrors; 0 beyond STEEPEST."""
    total = 0.0
    if facet_slope_sq(mu_i, mu_o, cos_between) <= STEEPEST * STEEPEST:
        for j in range(lobes.shape[0]):
            if lobes[j, 2] > 0.0 and is_narrow(lobes, j):
                total += lobe(lobes, j, mu_i, mu_o, cos_between)
    return total
