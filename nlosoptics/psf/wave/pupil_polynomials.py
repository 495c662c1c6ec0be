"""Polynomials in u and v fitted to the samples of a polar wave."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from ..._vectors import Array
from ..aperture.quadrature_nodes import frozen, polar_nodes
from .fits import projection
from .polar_series import PolarSpectrum
from .zernikes import zernike, zernike_order


def polynomial_of(
    series: PolarSpectrum, values: Array, obscuration: float, threshold: float
) -> tuple[Array, float] | None:
    """Fit a polynomial in u/R and v/R to values on polar nodes.

    Returns the coefficients (degree + 1, degree + 1) and the largest error at a node. The degree is
    that of the terms of ``series`` above the threshold. Returns None if it exceeds 10: polynomials
    of higher degree grow too fast outside the rim.
    """
    radial, angular = series.degrees(threshold)
    degree = max(2 * radial + 1, angular)
    if degree > 10:
        return None
    project, powers, basis = _projection(*values.shape, obscuration, degree)
    # einsum does not call BLAS, so results are bit-identical for any thread count.
    heights = np.einsum("tp,p->t", project, values.ravel())
    left = values.ravel() - np.einsum("tp,t->p", basis, heights)
    return np.einsum("t,tij->ij", heights, powers), float(np.abs(left).max())


@lru_cache(maxsize=8)
def _projection(
    n_r: int, n_theta: int, obscuration: float, degree: int
) -> tuple[Array, Array, Array]:
    """Return the tables that `polynomial_of` uses, on polar nodes of the unit disc.

    They are the projection onto the Zernike terms, (terms, nodes); the terms' coefficients in
    powers of u and v, (terms, degree + 1, degree + 1); and their values at the nodes, (terms,
    nodes).
    """
    u, v, weights = (nodes.ravel() for nodes in polar_nodes(1.0, n_r, n_theta, obscuration))
    count = (degree + 1) * (degree + 2) // 2
    basis = np.array([zernike(j, np.hypot(u, v), np.arctan2(v, u)) for j in range(1, count + 1)])
    powers = np.array([powers_of(j, degree) for j in range(1, count + 1)])
    return frozen(projection(basis, weights)), frozen(powers), frozen(basis)


def powers_of(index: int, degree: int) -> Array:
    """Coefficients of a Noll Zernike polynomial in powers of u and v, (degree + 1, degree + 1)."""
    n, m = zernike_order(index)
    table = np.zeros((degree + 1, degree + 1))
    scale = math.sqrt((n + 1) * (1 if m == 0 else 2))
    for s in range((n - abs(m)) // 2 + 1):
        k = (n - abs(m)) // 2 - s  # r^(n - 2 s) = r^2k r^|m|
        height = (-1) ** s * math.comb(n - s, s) * math.comb(n - 2 * s, k)
        for a in range(k + 1):  # (u^2 + v^2)^k
            for b in range(abs(m) + 1):  # real or imaginary part of (u + iv)^|m|
                if b % 2 == (m < 0):
                    place = 2 * a + abs(m) - b, 2 * (k - a) + b
                    sign = (-1) ** (b // 2)
                    table[place] += scale * height * sign * math.comb(k, a) * math.comb(abs(m), b)
    return table
