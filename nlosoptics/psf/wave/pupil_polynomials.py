"""Polynomials in u and v fitted to the samples of a polar wave.

`polynomial_of` takes degrees up to 10; its cost is nodes times terms. `low_polynomial` fits degrees
up to `LOW` order by order in angle, and is much cheaper than a series.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._vectors import read_only
from ..aperture.quadrature_nodes import frozen, polar_nodes
from .fits import projection
from .polar_series import PolarSpectrum
from .zernikes import zernike, zernike_order

Array = NDArray[np.float64]

#: Highest degree of a `LowPolynomial`; degree 6 covers third- and fifth-order aberrations.
LOW = 6


@dataclass(frozen=True, eq=False)
class LowPolynomial:
    """Aberration ``sum powers[i, j] (u/R)^i (v/R)^j`` of a degree up to `LOW`.

    Parameters
    ----------
    powers : ndarray, (degree + 1, degree + 1)
        Coefficients, m.
    misfit : float
        Largest absolute error at a node, m.
    radius : float
        Pupil radius R, m.
    obscuration : float
        Inner radius as a fraction of R.
    """

    powers: Array
    misfit: float
    radius: float
    obscuration: float

    @property
    def degrees(self) -> tuple[int, int]:
        """Highest Legendre degree in the radius squared, and highest angular order."""
        degree = len(self.powers) - 1
        return degree // 2, degree

    def slopes(self, cosine: Array, sine: Array, rho: Array) -> tuple[Array, Array]:
        """Return dW/du and dW/dv at radii rho = r/R and angles, (len(rho), len(cosine)).

        ``cosine`` and ``sine`` are those of the angles.
        """
        from . import _wave_kernels

        shape = len(rho), len(cosine)
        du, dv, work = np.empty(shape), np.empty(shape), np.empty((4, len(cosine)))
        places = read_only(rho), read_only(cosine), read_only(sine)
        _wave_kernels.slopes(self.powers / self.radius, *places, work, du, dv)
        return du, dv

    def on_rims(self, cosine: Array, sine: Array) -> Array:
        """Return values on the inner rim (or at the centre) and the outer, (2, len(cosine)), m."""
        from . import _wave_kernels

        rho, values = np.array([self.obscuration, 1.0]), np.empty((2, len(cosine)))
        _wave_kernels.polynomial(self.powers, rho, cosine, sine, values)
        return values


def low_polynomial(values: Array, radius: float, obscuration: float) -> LowPolynomial | None:
    """Return the polynomial that equals values on polar nodes to rounding error.

    ``values`` (n_r, n_theta) are in m, ``radius`` is the pupil's, m. Returns None if no polynomial
    up to degree `LOW` fits, or if there are too few nodes to tell.
    """
    if values.shape[0] < LOW or values.shape[1] < 2 * LOW + 2:
        return None
    orders = _orders(*values.shape, obscuration)
    # einsum does not call BLAS, so results are bit-identical for any thread count.
    share = np.einsum("ij,jm->im", values, orders.turned)
    heights = np.einsum("ikm,im->mk", orders.along, share)
    parts = np.einsum("mk,mki->mi", heights, orders.modes)
    left = values - np.einsum("mi,mj->ij", parts, orders.waves)
    misfit, largest = float(np.abs(left).max()), float(np.abs(values).max())
    if misfit > 1e-14 * largest:
        return None
    powers = np.einsum("mk,mkij->ij", heights, orders.powers)
    lit = np.abs(heights) > 1e-15 * largest
    degree = int(np.max(orders.degrees, where=lit, initial=1))
    return LowPolynomial(powers[: degree + 1, : degree + 1], misfit, radius, obscuration)


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


class _Orders(NamedTuple):
    """Zernike terms up to `LOW`, sorted by angular order and padded with zeros.

    Attributes
    ----------
    waves : ndarray, (orders, angles)
        Angular parts: cosines and sines.
    turned : ndarray, (angles, orders)
        Their transpose.
    along : ndarray, (radii, terms, orders)
        Projection of the rings' angular components onto each term.
    modes : ndarray, (orders, terms, radii)
        Radial parts.
    powers : ndarray, (orders, terms, LOW + 1, LOW + 1)
        Coefficients of the powers of u and v, see `powers_of`.
    degrees : ndarray of int, (orders, terms)
        Radial degrees.
    """

    waves: Array
    turned: Array
    along: Array
    modes: Array
    powers: Array
    degrees: NDArray[np.int64]


@lru_cache(maxsize=16)
def _orders(n_r: int, n_theta: int, obscuration: float) -> _Orders:
    """Return the Zernike terms on polar nodes, cached and read-only."""
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
        # An angle at which the angular part is 1.
        crest = 0.0 if m >= 0 else math.pi / (2 * -m)
        terms = np.array([zernike(j, r, np.full_like(r, crest)) for j in indices])
        share = projection(terms, area[:, 0])
        modes[row, : len(indices)] = terms
        weights[row, : len(indices)] = share / np.sum(waves[row] ** 2)
        powers[row, : len(indices)] = [powers_of(j, LOW) for j in indices]
        degrees[row, : len(indices)] = [zernike_order(j)[0] for j in indices]
    turned, along = np.ascontiguousarray(waves.T), np.ascontiguousarray(weights.T)
    for table in (waves, turned, along, modes, powers):
        frozen(table)
    return _Orders(waves, turned, along, modes, powers, degrees)


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
