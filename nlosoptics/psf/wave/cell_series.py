"""Spectral interpolation on the patches of an aperture: one tensor Legendre series per patch."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ..._vectors import Array, product
from ..aperture.aperture import Aperture
from ..aperture.curves import cross
from ..aperture.quadrature_nodes import KEPT, frozen, gauss_legendre
from .polar_series import Mesh, PolarSpectrum, _legendre_slopes, analysis, legendre

#: Least s at which slopes are taken: at s = 0 a patch may shrink to a point, where the Jacobian
#: vanishes.
NEAREST = 1e-3
#: Safety factor on the rms of the highest terms as a truncation estimate. It allows for the missing
#: terms, for their aliases, and for a Jacobian that varies over a patch.
LACK = 4.0
#: rms of a term relative to the largest, below which its coefficient is rounding error.
ROUNDING = 1e-15


class CellSpectrum:
    """Smooth function on a pupil of any outline, interpolated from samples at `Aperture.nodes`.

    On each patch of the aperture it is a sum of Legendre polynomials of the patch coordinates s and
    t, and passes through the samples.

    Parameters
    ----------
    values : ndarray, (n_patches, n_s, n_t)
        Real samples, such as a wave aberration in m.
    aperture : Aperture
        Outline of the pupil, with the patches.
    """

    def __init__(self, values: Array, aperture: Aperture) -> None:
        self.aperture = aperture
        self.shape = values.shape
        # Nodes per patch along s and t, under the names that `PolarSpectrum` uses.
        self.n_r, self.n_theta = values.shape[1:]
        self.coefficients = _products(values, analysis(values.shape[1]), analysis(values.shape[2]))

    def truncation(self) -> float:
        """Estimate the error between the samples: four times the rms of the highest terms.

        The highest terms are about an eighth of the degrees along s and along t.
        """
        return LACK * float(np.sum(self.aperture.patch_areas * self._terms[1]) / self.aperture.area)

    def degrees(self, threshold: float) -> tuple[int, int]:
        """Return the highest degrees in s and t with a coefficient above threshold and rounding."""
        size = self._terms[0]
        rounding = ROUNDING * float(size.max()) * _norms(*self.shape[1:])
        above = size > np.maximum(threshold, rounding)
        along_s, along_t = np.nonzero(above.any(axis=1))[0], np.nonzero(above.any(axis=0))[0]
        return int(along_s.max(initial=0)), int(along_t.max(initial=0))

    #: Digits of an integral by n nodes along either coordinate, see `quadrature.growth`.
    orders = (2, 2)
    #: Points of the result of `slopes` that are nodes.
    inner = np.s_[:, 1:-1, 1:-1]

    def mesh(self, n: int, most: int) -> tuple[int, int, int]:
        """Return the shape of a mesh of ``n`` points per side of a patch.

        All patches together have at most the points of ``most`` rings of four times as many.
        """
        n = min(n, math.ceil(2 * most / math.sqrt(self.shape[0])))
        return self.shape[0], n, n

    def on_rims(self) -> Array:
        """Return the values on the nodes and edges of the patches."""
        tables = (_edged(n, n, 0.0)[0] for n in self.shape[1:])
        return _products(self.coefficients, *tables)

    @property
    def sides(self) -> tuple[float, float]:
        """Half the largest change of a pupil coordinate along each coordinate of a patch, m."""
        along_s, along_t = self.aperture.patch_size
        return along_s / 2, along_t / 2

    def bounds(self) -> tuple[Array, Array]:
        """Return bounds of the terms of each degree along both coordinates, unit of the values."""
        sizes = self._terms[0]
        return sizes.sum(axis=1), sizes.sum(axis=0)

    def least_nodes(self, *counts: int) -> tuple[int, int]:
        """Return numbers of nodes at which the series can be evaluated, not below ``counts``."""
        n_s, n_t = counts
        return n_s, n_t

    @cached_property
    def _terms(self) -> tuple[Array, Array]:
        """Largest modulus of each coefficient over all patches; rms of each patch's high terms."""
        first_k, first_m = (max(n - max(2, n // 8), 0) for n in self.shape[1:])
        # a term of degrees k and m has the mean square 1/((2 k + 1)(2 m + 1))
        squares = (self.coefficients / _norms(*self.shape[1:])) ** 2
        squares[:, :first_k, :first_m] = 0.0
        return np.abs(self.coefficients).max(axis=0), np.sqrt(squares.sum(axis=(1, 2)))

    def at_nodes(self, n_patches: int, n_s: int, n_t: int) -> Array:
        """Return values on the aperture's nodes of the given shape, (n_patches, n_s, n_t)."""
        tables = (_synthesis(n, count) for n, count in zip(self.shape[1:], (n_s, n_t), strict=True))
        return _products(self.coefficients, *tables)

    def points(self, n_patches: int, n_s: int, n_t: int) -> Mesh:
        """Return the points of `slopes`, with the coordinates s and t of the patches."""
        s, t = _with_edges(n_s, NEAREST), _with_edges(n_t, 0.0)
        u, v = np.moveaxis(self.aperture.map(s, t)[0], -1, 0)
        return Mesh(u, v, s, t, gauss_legendre(n_s)[1][:, None], gauss_legendre(n_t)[1])

    def slopes(self, n_patches: int, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
        """Return the gradient on the nodes and on the edges of the patches.

        Returns
        -------
        du, dv : ndarray
            Derivatives, (n_patches, n_s + 2, n_t + 2), unit of the values per m.
        weights : ndarray
            Area of each node, (n_patches, n_s + 2, n_t + 2), m^2; 0 on the edges.
        """
        make = _kept_frame if n_patches * n_s * n_t <= KEPT else _frame
        frame = make(self.aperture, n_s, n_t)
        (s, s_rate), (t, t_rate) = (
            _edged(n, count, first)
            for n, count, first in zip(self.shape[1:], (n_s, n_t), (NEAREST, 0.0), strict=True)
        )
        by_s = _products(self.coefficients, s_rate, t)
        by_t = _products(self.coefficients, s, t_rate)
        du = by_s * frame.u_of_s + by_t * frame.u_of_t
        dv = by_s * frame.v_of_s + by_t * frame.v_of_t
        return du, dv, frame.share


def spectrum(
    values: Array, radius: float, obscuration: float, outline: Aperture | None
) -> PolarSpectrum | CellSpectrum:
    """Return the series of values at nodes of `pupil_points`, whose pupil it takes."""
    if outline is None:
        return PolarSpectrum(values, radius, obscuration)
    return CellSpectrum(values, outline)


class _Frame(NamedTuple):
    """Geometry of `CellSpectrum.slopes`: du = u_of_s dW/ds + u_of_t dW/dt, dv alike; areas."""

    u_of_s: Array
    u_of_t: Array
    v_of_s: Array
    v_of_t: Array
    share: Array


def _frame(aperture: Aperture, n_s: int, n_t: int) -> _Frame:
    """Compute the geometry on nodes and edges, (n_patches, n_s + 2, n_t + 2) each."""
    _, along_s, along_t = aperture.map(_with_edges(n_s, NEAREST), _with_edges(n_t, 0.0))
    jacobian, weights = cross(along_s, along_t), (gauss_legendre(n)[1] for n in (n_s, n_t))
    share = np.zeros_like(jacobian)
    share[:, 1:-1, 1:-1] = jacobian[:, 1:-1, 1:-1] * np.multiply.outer(*weights)
    parts = along_t[..., 1], -along_s[..., 1], -along_t[..., 0], along_s[..., 0]
    u_of_s, u_of_t, v_of_s, v_of_t = (frozen(part / jacobian) for part in parts)
    return _Frame(u_of_s, u_of_t, v_of_s, v_of_t, frozen(share))


_kept_frame = lru_cache(maxsize=8)(_frame)


def _with_edges(count: int, first: float) -> Array:
    """Return a coordinate of nodes, between that of the first and of the last edge."""
    return np.concatenate([[first], gauss_legendre(count)[0], [1.0]])


def _products(values: Array, first: Array, second: Array) -> Array:
    """Return ``first values second^T`` for each patch of ``values`` (n_patches, n_s, n_t)."""
    return product(first, product(values, second.T))


@lru_cache(maxsize=64)
def _norms(n_s: int, n_t: int) -> Array:
    """Return the coefficients (n_s, n_t) of Legendre terms of rms 1."""
    k, m = (np.sqrt(2 * np.arange(n) + 1) for n in (n_s, n_t))
    return frozen(k[:, None] * m)


@lru_cache(maxsize=64)
def _synthesis(n: int, count: int) -> Array:
    """Return the matrix (count, n) from n Legendre coefficients to values on count nodes."""
    return frozen(np.ascontiguousarray(legendre(n, gauss_legendre(count)[0]).T))


@lru_cache(maxsize=64)
def _edged(n: int, count: int, first: float) -> tuple[Array, Array]:
    """Return the matrices (count + 2, n) to values and to slopes on nodes and both edges."""
    table = legendre(n, _with_edges(count, first))
    slopes = np.ascontiguousarray(_legendre_slopes(table).T)
    return frozen(np.ascontiguousarray(table.T)), frozen(slopes)
