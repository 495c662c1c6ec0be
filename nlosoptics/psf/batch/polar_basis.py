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
    """Basis of smooth functions on a disc or ring, to interpolate many waves at once.

    A basis function is a Legendre polynomial of r^2, times the cosine or sine of an angular order m
    (times r if m is odd). The functions are divided into four parts by parity: even in both u and
    v, odd in u, odd in v, and odd in both.

    Parameters
    ----------
    n_r, n_theta : int
        Number of rings and of points per ring of the samples, see `polar_nodes`.
    obscuration : float
        Inner radius of the pupil divided by the outer.
    degree, order : int, optional
        Highest Legendre degree and highest angular order; by default the highest that the samples
        determine, ``n_r - 1`` and ``n_theta//2``.
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
        """Number of basis functions of each of the four parts."""
        return tuple(self.n_k * len(orders) for orders in self.orders)

    def analysed(self, values: Array) -> list[Array]:
        """Return the coefficients of functions that are given by samples.

        Parameters
        ----------
        values : ndarray, (waves, n_r, n_theta)
            Samples of each wave on the polar nodes.

        Returns
        -------
        list of ndarray, (waves, n_degrees, n_orders)
            Coefficients of each of the four parts.
        """
        flat = values.reshape(-1, values.shape[2])
        found = product(flat, np.concatenate(self._angular, axis=1))
        found = found.reshape(*values.shape[:2], -1)
        ends = np.cumsum([len(orders) for orders in self.orders])[:-1]
        parts = np.split(found, ends, axis=2)
        return [product(one, part) for one, part in zip(self._radial, parts, strict=True)]

    def at(self, u: Array, v: Array) -> list[Array]:
        """Return the values of all basis functions at points of the pupil.

        Parameters
        ----------
        u, v : ndarray, (n,)
            Coordinates divided by the pupil's radius.

        Returns
        -------
        list of ndarray, (functions, n)
            Values for each of the four parts.
        """
        rho, angle = np.hypot(u, v), np.arctan2(v, u)
        radial = legendre_tables(self.n_k, fraction_of(rho, self.obscuration))[0]
        found = []
        for (sines, odd), orders in zip(PARTS, self.orders, strict=True):
            waves = (np.sin if sines else np.cos)(np.outer(orders, angle))
            rows = radial * rho if odd else radial
            found.append((rows[:, None] * waves).reshape(-1, u.size))
        return found

    def slopes_at(self, rho: Array, angle: Array) -> tuple[list[Array], list[Array]]:
        """Return the derivatives of all basis functions along u and v.

        Parameters
        ----------
        rho, angle : ndarray, (n,)
            Polar coordinates of the points: radius divided by the pupil's radius, above 0, and
            angle from u toward v, rad.

        Returns
        -------
        along_u, along_v : list of ndarray, (functions, n)
            Derivatives for each of the four parts, with lengths in units of the pupil's radius.
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
    """All Zernike polynomials up to a degree, sorted by parity.

    The four parts are the polynomials even in both u and v, odd in u, odd in v, and odd in both.

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
        """Return the values of all polynomials at points of the pupil.

        Parameters
        ----------
        u, v : ndarray, (n,)
            Coordinates divided by the pupil's radius.

        Returns
        -------
        list of ndarray, (polynomials, n)
            Values for each of the four parts.
        """
        rho, angle = np.hypot(u, v), np.arctan2(v, u)
        shape = -1, u.size  # of no modes too
        return [
            np.array([zernike(j, rho, angle) for j in part]).reshape(shape) for part in self.indices
        ]

    def on_nodes(self, parts: list[Array], wave: Wavefront) -> Array:
        """Convert derivatives with respect to Zernike coefficients into a gradient at pupil nodes.

        Parameters
        ----------
        parts : list of ndarray, (waves, polynomials)
            Derivatives of a loss function with respect to the coefficients, for each of the four
            parts.
        wave : Wavefront
            Wave with the layout "polar", which gives the nodes.

        Returns
        -------
        ndarray, (waves, n_r, n_theta)
            Gradient. Its sum of products with one of the polynomials is the derivative with respect
            to the coefficient of that polynomial. Divided by the area of each node, it is a
            sum of the polynomials.
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
