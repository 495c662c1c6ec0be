"""Values and slopes of many polar waves at once, by products with one basis.

The basis is that of `PolarSpectrum`: Legendre polynomials of the squared radius times cosines and
sines of the angle. It is divided into four parts by parity, so that values at nodes mirrored about
both axes take a quarter of the operations.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..._vectors import product
from ..aperture.quadrature_nodes import frozen, gauss_legendre, shared_polar_nodes
from ..wave.fits import projection
from ..wave.polar_series import analysis, fraction_of, legendre_tables, rho_of
from ..wave.wavefront import Wavefront
from ..wave.zernikes import kept_zernikes, zernike, zernike_order

Array = NDArray[np.float64]
#: Whether the parts even in both, odd in u, odd in v and odd in both hold sines, and odd orders.
PARTS = ((False, False), (False, True), (True, True), (True, False))


class PolarBasis:
    """Series on polar nodes up to a degree in the squared radius and an angular order.

    Parameters
    ----------
    n_r, n_theta : int
        Shape of the nodes of `polar_nodes`.
    obscuration : float
        Inner radius of the pupil as a fraction of the outer.
    degree, order : int, optional
        Highest Legendre degree and angular order; all that the nodes hold by default.
    """

    def __init__(
        self,
        n_r: int,
        n_theta: int,
        obscuration: float,
        degree: int | None = None,
        order: int | None = None,
    ) -> None:
        self.obscuration = obscuration
        self.n_k = n_r if degree is None else degree + 1
        most = n_theta // 2 if order is None else order
        rho = rho_of(gauss_legendre(n_r)[0], obscuration)
        radial = analysis(n_r)[: self.n_k]
        angle = 2 * math.pi * np.arange(n_theta) / n_theta
        self.orders, self._angular, self._radial = [], [], []
        for sines, odd in PARTS:
            orders = np.arange(1 if odd else 2 if sines else 0, most + 1, 2)
            if sines and n_theta % 2 == 0:  # the sine of the highest order is 0 at the nodes
                orders = orders[orders < n_theta // 2]
            share = np.where((orders == 0) | (2 * orders == n_theta), 1, 2) / n_theta
            self.orders.append(orders)
            self._angular.append((np.sin if sines else np.cos)(np.outer(angle, orders)) * share)
            self._radial.append(radial / rho if odd else radial)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of terms of each part."""
        return tuple(self.n_k * len(orders) for orders in self.orders)

    def analysed(self, values: Array) -> list[Array]:
        """Return the coefficients (waves, n_k, orders) of each part of waves (.., n_r, n_theta)."""
        flat = values.reshape(-1, values.shape[2])
        found = product(flat, np.concatenate(self._angular, axis=1))
        found = found.reshape(*values.shape[:2], -1)
        ends = np.cumsum([len(orders) for orders in self.orders])[:-1]
        parts = np.split(found, ends, axis=2)
        return [product(one, part) for one, part in zip(self._radial, parts, strict=True)]

    def at(self, u: Array, v: Array) -> list[Array]:
        """Return the terms of each part, (terms, n), at points u, v relative to the radius."""
        rho, angle = np.hypot(u, v), np.arctan2(v, u)
        radial = legendre_tables(self.n_k, fraction_of(rho, self.obscuration))[0]
        found = []
        for (sines, odd), orders in zip(PARTS, self.orders, strict=True):
            waves = (np.sin if sines else np.cos)(np.outer(orders, angle))
            rows = radial * rho if odd else radial
            found.append((rows[:, None] * waves).reshape(-1, u.size))
        return found

    def slopes_at(self, rho: Array, angle: Array) -> tuple[list[Array], list[Array]]:
        """Return the derivatives of all terms along u and v, each part (terms, n).

        Points are given by rho = r/radius and angle, (n,); derivatives are per radius.
        """
        value, slope = legendre_tables(self.n_k, fraction_of(rho, self.obscuration))
        slope = slope * (2 * rho / (1 - self.obscuration**2))
        cosine, sine = np.cos(angle), np.sin(angle)
        along_u, along_v = [], []
        for (sines, odd), orders in zip(PARTS, self.orders, strict=True):
            phase = np.outer(orders, angle)
            wave = np.sin(phase) if sines else np.cos(phase)
            turn = (np.cos(phase) if sines else -np.sin(phase)) * orders[:, None]
            per_r, over_r = (rho * slope + value, value) if odd else (slope, value / rho)
            out, round_ = (a[:, None] * b for a, b in ((per_r, wave), (over_r, turn)))
            along_u.append((out * cosine - round_ * sine).reshape(-1, rho.size))
            along_v.append((out * sine + round_ * cosine).reshape(-1, rho.size))
        return along_u, along_v


class SmoothModes:
    """Zernike polynomials up to a degree, by parity.

    Parameters
    ----------
    degree : int
        Highest degree in u and v.
    """

    def __init__(self, degree: int) -> None:
        found: list[list[int]] = [[], [], [], []]
        for index in range(1, (degree + 1) * (degree + 2) // 2 + 1):
            m = zernike_order(index)[1]
            found[PARTS.index((m < 0, m % 2 == 1))].append(index)
        self.indices = found

    def at(self, u: Array, v: Array) -> list[Array]:
        """Return the modes of each parity, (modes, n), at points u, v relative to the radius."""
        rho, angle = np.hypot(u, v), np.arctan2(v, u)
        shape = -1, u.size  # of no modes too
        return [
            np.array([zernike(j, rho, angle) for j in part]).reshape(shape) for part in self.indices
        ]

    def on_nodes(self, parts: list[Array], wave: Wavefront) -> Array:
        """Return the gradient at polar nodes, (waves, n_r, n_theta), from that of all modes.

        Its product with any sum of the modes is the sum of their derivatives, ``parts`` (waves,
        modes). As a density over the pupil it is such a sum itself.
        """
        order = tuple(j for part in self.indices for j in part)
        table = _kept_projection(order, *wave.u.shape, wave.obscuration)
        return product(np.concatenate(parts, axis=1), table).reshape(-1, *wave.u.shape)


@lru_cache(maxsize=4)
def _kept_projection(indices: tuple[int, ...], n_r: int, n_theta: int, obscuration: float) -> Array:
    """Projection (modes, nodes) of polar nodes onto Zernike polynomials, cached and read-only."""
    weights = shared_polar_nodes(1.0, n_r, n_theta, obscuration)[2]
    return frozen(projection(kept_zernikes(indices, "noll", n_r, n_theta, obscuration), weights))


def magnitudes(parts: list[Array], n_orders: int) -> Array:
    """Return the largest value of each term over all angles, (waves, n_k, n_orders).

    ``parts`` is the result of `PolarBasis.analysed`; cosines and sines of one order are combined.
    """
    waves, n_k, _ = parts[0].shape
    squares = np.zeros((waves, n_k, n_orders))
    for (sines, odd), part in zip(PARTS, parts, strict=True):
        first = 1 if odd else 2 if sines else 0
        squares[:, :, first::2][:, :, : part.shape[2]] += part**2
    return np.sqrt(squares)
