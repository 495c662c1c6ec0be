"""Polynomials of u and v through the samples of a polar wave.

`fitted` takes any degree, at the cost of every node times every term. A `LowPolynomial` is found
order by order of the angle in one pass over the nodes, and gives at once what a series would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..aperture.quadrature_nodes import frozen, polar_nodes
from .fits import projection
from .zernikes import zernike, zernike_order

Array = NDArray[np.float64]

#: Degree of a `LowPolynomial`, which holds the aberrations of third and fifth order.
LOW = 6


@dataclass(frozen=True, eq=False)
class LowPolynomial:
    """Aberration ``sum powers[i, j] (u/R)^i (v/R)^j`` of a degree up to `LOW`.

    Parameters
    ----------
    powers : ndarray
        (degree + 1, degree + 1), the unit of the values.
    misfit : float
        Largest error at a node.
    radius : float
        R, m.
    obscuration : float
    """

    powers: Array
    misfit: float
    radius: float
    obscuration: float

    @property
    def degrees(self) -> tuple[int, int]:
        """Highest Legendre degree along the radius squared and highest angular order."""
        degree = len(self.powers) - 1
        return degree // 2, degree

    def slopes(self, cosine: Array, sine: Array, rho: Array) -> tuple[Array, Array]:
        """Derivatives along u and v, 1/m, at radii over R and angles, (len(rho), len(cosine))."""
        from . import _wave_kernels

        shape = len(rho), len(cosine)
        du, dv = np.empty(shape), np.empty(shape)
        _wave_kernels.slopes(self.powers / self.radius, rho, cosine, sine, du, dv)
        return du, dv

    def on_rims(self, cosine: Array, sine: Array) -> Array:
        """Values on the inner and the outer rim, (2, len(cosine)); the centre where none is."""
        from . import _wave_kernels

        rho, values = np.array([self.obscuration, 1.0]), np.empty((2, len(cosine)))
        _wave_kernels.polynomial(self.powers, rho, cosine, sine, values)
        return values


def low_polynomial(values: Array, radius: float, obscuration: float) -> LowPolynomial | None:
    """Polynomial that values on polar nodes are to rounding; None if there is none so low."""
    from . import _wave_kernels

    if values.shape[0] < LOW or values.shape[1] < 2 * LOW + 2:
        return None
    orders = _orders(*values.shape, obscuration)
    heights = np.empty(orders.weights.shape[:2])
    misfit, largest = _wave_kernels.polar_fit(
        values, orders.waves, orders.weights, orders.modes, heights
    )
    if misfit > 1e-14 * largest:
        return None
    # einsum without BLAS: the same bits for any thread count
    powers = np.einsum("mk,mkij->ij", heights, orders.powers)
    lit = np.abs(heights) > 1e-15 * largest
    degree = int(np.max(orders.degrees, where=lit, initial=1))
    return LowPolynomial(powers[: degree + 1, : degree + 1], misfit, radius, obscuration)


class _Orders(NamedTuple):
    """Zernike terms up to `LOW`, sorted by angular order; zeros where an order has fewer."""

    waves: Array
    """(orders, angles): cosines and sines."""
    weights: Array
    """(orders, terms, radii): what each ring counts in a term."""
    modes: Array
    """(orders, terms, radii): terms along the radius."""
    powers: Array
    """(orders, terms, LOW + 1, LOW + 1): see `powers_of`."""
    degrees: NDArray[np.int64]
    """(orders, terms)."""


@lru_cache(maxsize=16)
def _orders(n_r: int, n_theta: int, obscuration: float) -> _Orders:
    u, v, area = polar_nodes(1.0, n_r, n_theta, obscuration)
    r, angle = np.hypot(u[:, 0], v[:, 0]), 2 * math.pi * np.arange(n_theta) / n_theta
    found: dict[int, list[int]] = {}
    for index in range(1, (LOW + 1) * (LOW + 2) // 2 + 1):
        found.setdefault(zernike_order(index)[1], []).append(index)
    most = max(map(len, found.values()))
    waves = np.array([np.cos(m * angle) if m >= 0 else np.sin(-m * angle) for m in found])
    weights, modes = np.zeros((2, len(found), most, n_r))
    powers = np.zeros((len(found), most, LOW + 1, LOW + 1))
    degrees = np.zeros((len(found), most), dtype=np.int64)
    for row, (m, indices) in enumerate(found.items()):
        # at the angle where the wave is 1
        crest = 0.0 if m >= 0 else math.pi / (2 * -m)
        terms = np.array([zernike(j, r, np.full_like(r, crest)) for j in indices])
        share = projection(terms, area[:, 0])
        modes[row, : len(indices)] = terms
        weights[row, : len(indices)] = share / np.sum(waves[row] ** 2)
        powers[row, : len(indices)] = [powers_of(j, LOW) for j in indices]
        degrees[row, : len(indices)] = [zernike_order(j)[0] for j in indices]
    for table in (waves, weights, modes, powers):
        frozen(table)
    return _Orders(waves, weights, modes, powers, degrees)


def fitted(values: Array, obscuration: float, degree: int) -> tuple[Array, float]:
    """Powers of u/R and v/R through values on polar nodes, and the most they err by."""
    project, powers, basis = _projection(*values.shape, obscuration, degree)
    # einsum without BLAS: the same bits for any thread count
    heights = np.einsum("tp,p->t", project, values.ravel())
    left = values.ravel() - np.einsum("tp,t->p", basis, heights)
    return np.einsum("t,tij->ij", heights, powers), float(np.abs(left).max())


@lru_cache(maxsize=8)
def _projection(
    n_r: int, n_theta: int, obscuration: float, degree: int
) -> tuple[Array, Array, Array]:
    """Least-squares weights of the nodes for each Zernike term, its powers of u and v, its values.

    (terms, nodes), (terms, degree + 1, degree + 1), (terms, nodes); unit radius.
    """
    u, v, weights = (nodes.ravel() for nodes in polar_nodes(1.0, n_r, n_theta, obscuration))
    count = (degree + 1) * (degree + 2) // 2
    basis = np.array([zernike(j, np.hypot(u, v), np.arctan2(v, u)) for j in range(1, count + 1)])
    powers = np.array([powers_of(j, degree) for j in range(1, count + 1)])
    return frozen(projection(basis, weights)), frozen(powers), frozen(basis)


def powers_of(index: int, degree: int) -> Array:
    """Noll's Zernike polynomial as powers of u and v, (degree + 1, degree + 1)."""
    n, m = zernike_order(index)
    table = np.zeros((degree + 1, degree + 1))
    scale = math.sqrt((n + 1) * (1 if m == 0 else 2))
    for s in range((n - abs(m)) // 2 + 1):
        k = (n - abs(m)) // 2 - s  # r^(n - 2 s) = r^2k r^|m|
        height = (-1) ** s * math.comb(n - s, s) * math.comb(n - 2 * s, k)
        for a in range(k + 1):  # (u^2 + v^2)^k
            for b in range(abs(m) + 1):  # (u + iv)^|m|, its real or imaginary part
                if b % 2 == (m < 0):
                    place = 2 * a + abs(m) - b, 2 * (k - a) + b
                    sign = (-1) ** (b // 2)
                    table[place] += scale * height * sign * math.comb(k, a) * math.comb(abs(m), b)
    return table
