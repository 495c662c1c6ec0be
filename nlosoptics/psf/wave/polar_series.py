"""Spectral interpolation on the polar nodes of a pupil.

A function that is smooth on the disc has, for each angular order m, a radial part that is
r^(m mod 2) times a smooth function of r^2. Samples on Gauss-Legendre nodes of r^2 and uniform
angles therefore give a Legendre-Fourier series. It converges exponentially for smooth functions and
is exact for polynomials.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import NamedTuple

import ducc0
import numpy as np
from numpy.polynomial.legendre import legvander

from ..._vectors import Array, ComplexArray
from ..aperture.quadrature_nodes import frozen, gauss_legendre


class PolarSpectrum:
    """Smooth function on a disc or ring, interpolated from samples at the points of `polar_nodes`.

    The function is a sum of Legendre polynomials of r^2 (degree k) times cosines and sines of the
    angle (angular order m), with a factor r for odd m. It passes through the samples.

    Parameters
    ----------
    values : ndarray, (n_r, n_theta)
        Real samples, such as a wave aberration in m.
    radius : float
        Outer radius of the pupil, m.
    obscuration : float
        Inner radius of the pupil divided by the outer.

    See Also
    --------
    Wavefront.series : Series of a function at the sample points of a wave.
    """

    def __init__(self, values: Array, radius: float, obscuration: float) -> None:
        self.n_r, self.n_theta = values.shape
        self.radius, self.obscuration = radius, obscuration
        waves = np.fft.rfft(values, axis=1, norm="forward")
        if self.n_theta % 2 == 0:
            waves[:, -1] /= 2  # the highest order is the sum of +m and -m
        fraction, _ = gauss_legendre(self.n_r)
        waves[:, 1::2] /= rho_of(fraction, self.obscuration)[:, None]
        # einsum does not call BLAS, so results are bit-identical for any thread count.
        self.coefficients = _product(analysis(self.n_r), waves)

    def truncation(self) -> float:
        """Estimate the error between the samples: sum of the coefficients of the highest terms."""
        size = self._sizes.copy()
        size[:, 1:] *= 2
        # At least four angular orders: a function of period pi/2 has only every fourth.
        n_k = max(2, self.n_r // 8)
        n_m = max(4, size.shape[1] // 8)
        return float(size[-n_k:].sum() + size[:-n_k, -n_m:].sum())

    def degrees(self, threshold: float) -> tuple[int, int]:
        """Return the highest degree k and order m with a coefficient above a threshold.

        Parameters
        ----------
        threshold : float
            Magnitude of a coefficient, in the unit of the samples.
        """
        above = self._sizes > threshold
        radii, orders = np.nonzero(above.any(axis=1))[0], np.nonzero(above.any(axis=0))[0]
        return int(radii.max(initial=0)), int(orders.max(initial=0))

    #: Digits of an integral by n nodes along radius and angle, see `quadrature.growth`.
    orders = (4, 1)
    #: Points of the result of `slopes` that are nodes.
    inner = np.s_[:-1]

    def mesh(self, n: int, most: int) -> tuple[int, int]:
        """Return rings and points per ring of a mesh of about ``n`` rings, at most ``most``."""
        n = min(max(n, 24), most)
        return n, 4 * n

    def on_rims(self) -> Array:
        """Return the values on the outer and inner rim, or at the centre."""
        # Legendre polynomials are 1 at the outer rim and (-1)^k at the inner.
        inner = np.where(np.arange(self.n_r) % 2, -1.0, 1.0)[:, None] * self.coefficients
        waves = np.stack([self.coefficients.sum(axis=0), inner.sum(axis=0)])
        waves[1, 1::2] *= self.obscuration  # odd orders have a factor r/radius
        return self._synthesis(waves, self.n_theta)

    @property
    def sides(self) -> tuple[float, float]:
        """Largest change of a pupil coordinate along the radius, and half of it on a ring, m."""
        return self.radius * math.sqrt(1 - self.obscuration**2), self.radius

    def bounds(self) -> tuple[Array, Array]:
        """Return bounds of the terms of each degree in r and of each angular order."""
        n_k, n_m = self._counts
        sizes = self._sizes[:n_k, :n_m].copy()
        sizes[:, 1:] *= 2
        degree = 2 * np.arange(n_k)[:, None] + np.arange(n_m) % 2
        radial = np.bincount(degree.ravel(), weights=sizes.ravel()).astype(np.float64)
        return radial, sizes.sum(axis=0)

    def least_nodes(self, *counts: int) -> tuple[int, int]:
        """Return numbers of nodes at which the series can be evaluated, not below ``counts``."""
        n_r, n_theta = counts
        return n_r, int(ducc0.fft.good_size(max(n_theta, 2 * self._counts[1]), True))

    def at_nodes(self, n_r: int, n_theta: int) -> Array:
        """Return the function at the points of another set of `polar_nodes` on the same pupil.

        Parameters
        ----------
        n_r, n_theta : int
            Number of rings, and of points per ring, the latter as `least_nodes` returns it.

        Returns
        -------
        ndarray, (n_r, n_theta)
            Values, in the unit of the samples.
        """
        fraction, _ = gauss_legendre(n_r)
        rho = rho_of(fraction, self.obscuration)
        value = self._sum(legendre(self._counts[0], fraction_of(rho, self.obscuration)))
        value[:, 1::2] *= rho[:, None]
        return self._synthesis(value, n_theta)

    def slopes(self, n_r: int, n_theta: int) -> tuple[Array, Array, Array]:
        """Return the gradient at the points of `polar_nodes` and on the outer rim.

        Parameters
        ----------
        n_r, n_theta : int
            Number of rings and of points per ring.

        Returns
        -------
        du, dv : ndarray
            Derivatives along u and v, (n_r + 1, n_theta), unit of the samples per m. The last row
            is the rim.
        weights : ndarray
            Fraction of the pupil's area that each point represents, (n_r + 1, n_theta), of sum 1;
            0 on the rim.
        """
        # Drop coefficients at rounding level: slopes of high-degree polynomials amplify them.
        n_k, n_m = (n + 1 for n in self.degrees(1e-14 * float(self._sizes.max())))
        ring = ring_of(n_r, n_theta, self.obscuration)
        coefficients = self.coefficients[:n_k, :n_m]
        value, per_r = (_product(table.T, coefficients) for table in _rim_tables(n_k, n_r))
        per_r *= ring.bend
        per_r[:, 1::2] = ring.rho * per_r[:, 1::2] + value[:, 1::2]
        value[:, ::2] /= ring.rho
        value *= 1j * np.arange(n_m)
        d_r, d_theta = self._synthesis(np.stack([per_r, value]) / self.radius, n_theta)
        du = ring.cosine * d_r - ring.sine * d_theta
        dv = ring.sine * d_r + ring.cosine * d_theta
        return du, dv, np.repeat(ring.share, n_theta, axis=1)

    def points(self, n_r: int, n_theta: int) -> Mesh:
        """Return the points of `slopes`, with the radius, m, and the angle as coordinates."""
        ring, (_, weights) = ring_of(n_r, n_theta, self.obscuration), gauss_legendre(n_r)
        edges = self.radius * rho_of(np.append(0.0, np.cumsum(weights)), self.obscuration)
        r, turn = self.radius * ring.rho, 2 * math.pi / n_theta
        along_r, angle = np.diff(edges)[:, None], turn * np.arange(n_theta, dtype=np.float64)
        return Mesh(r * ring.cosine, r * ring.sine, r[:, 0], angle, along_r, np.array(turn))

    @cached_property
    def disc_series(self) -> ComplexArray:
        """The function as a Fourier series in two angles, for a non-uniform FFT.

        One angle is that of the point in the pupil. The other, psi, replaces the radius:
        ``r = middle + half cos(psi)``, with the two lengths of `span`. The complex coefficients
        (4 n_r, 2 n_m) are those of psi (rows) and the angle (columns), with n_m the number of
        angular orders; most negative orders first.
        """
        n = 2 * self.n_r
        middle, half = self.span()
        lobes = math.pi * (np.arange(n) + 0.5) / n
        # Chebyshev series in r over the span: degree 2 n_r - 1 holds the radial parts exactly.
        radial = self._polynomial((middle + half * np.cos(lobes)) / self.radius)[0]
        n_m = radial.shape[1]
        cosines = np.cos(np.outer(np.arange(n), lobes)) * (2 / n)
        cosines[0] /= 2
        chebyshev = np.einsum("ji,im->jm", cosines, radial)
        # cos(j psi) contributes to +j and -j; a real function has conjugate terms at +m and -m.
        grid = np.zeros((2 * n, 2 * n_m), dtype=np.complex128)
        grid[n:, n_m:] = chebyshev / 2
        grid[n:0:-1, n_m:] += chebyshev / 2
        grid[:, n_m - 1 : 0 : -1] = np.conj(grid[:, n_m + 1 :])
        return grid

    def span(self) -> tuple[float, float]:
        """Return middle and half width of the range of radii, m: a diameter, or a ring's width."""
        low = self.obscuration * self.radius if self.obscuration > 0 else -self.radius
        return (self.radius + low) / 2, (self.radius - low) / 2

    def rim_series(self, rho: float) -> ComplexArray:
        """Return the radial derivative on a circle, as a Fourier series in the angle.

        Parameters
        ----------
        rho : float
            Radius of the circle divided by that of the pupil.

        Returns
        -------
        ndarray, (2 n_m,)
            Complex coefficients, most negative order first, unit of the samples per m; n_m is the
            number of angular orders.
        """
        waves = self._polynomial(np.array([rho]))[1][0]
        n_m = waves.size
        series = np.zeros(2 * n_m, dtype=np.complex128)
        series[n_m:] = waves
        series[n_m - 1 : 0 : -1] = np.conj(waves[1:])
        return series

    def _sum(self, table: Array) -> ComplexArray:
        """Sum the series over the Legendre degree; result (points, orders)."""
        n_k, n_m = self._counts
        sums = np.zeros((table.shape[1], self.coefficients.shape[1]), dtype=np.complex128)
        sums[:, :n_m] = _product(table[:n_k].T, self.coefficients[:n_k, :n_m])
        return sums

    @cached_property
    def _sizes(self) -> Array:
        """Magnitudes of the coefficients."""
        return np.asarray(np.abs(self.coefficients))

    @cached_property
    def _counts(self) -> tuple[int, int]:
        """Number of degrees and of orders with terms above the rounding error of the largest."""
        degree, order = self.degrees(1e-16 * float(self._sizes.max()))
        return degree + 1, order + 1

    def _polynomial(self, rho: Array) -> tuple[ComplexArray, ComplexArray]:
        """Return the radial parts and their r derivatives at rho = r/radius, (len(rho), n_m)."""
        tables = legendre_tables(self._counts[0], fraction_of(rho, self.obscuration))
        value, slope = (self._sum(table) for table in tables)
        slope *= (2 * rho / (1 - self.obscuration**2))[:, None]
        slope[:, 1::2] = rho[:, None] * slope[:, 1::2] + value[:, 1::2]
        value[:, 1::2] *= rho[:, None]
        return value, slope / self.radius

    def _synthesis(self, waves: ComplexArray, n_theta: int) -> Array:
        """Return values on ``n_theta`` uniform angles from angular orders (last axis)."""
        full = np.zeros((*waves.shape[:-1], n_theta // 2 + 1), dtype=np.complex128)
        waves = waves[..., : full.shape[-1]]
        full[..., : waves.shape[-1]] = waves
        if n_theta % 2 == 0 and waves.shape[-1] == full.shape[-1]:
            full[..., -1] *= 2
        return np.fft.irfft(full, n_theta, axis=-1, norm="forward")


def values_at(
    first: PolarSpectrum, second: PolarSpectrum | None, u: Array, v: Array, epsilon: float
) -> tuple[Array, Array | None]:
    """Evaluate one or two functions on the same pupil at any points, by one non-uniform FFT.

    Outside the pupil they are extrapolated linearly along the radius. ``epsilon`` is the error
    relative to the largest value, 1e-13 or more; ``u`` and ``v`` are in m.
    """
    r, angle = np.hypot(u, v), np.arctan2(v, u)
    radius, inner = first.radius, first.obscuration * first.radius
    middle, half = first.span()
    coord = np.empty((*u.shape, 2))
    np.arccos(np.clip((np.clip(r, inner, radius) - middle) / half, -1.0, 1.0), out=coord[..., 0])
    coord[..., 1] = angle

    def transform(series: list[ComplexArray], points: Array) -> ComplexArray:
        """Evaluate one or two Fourier series at points by a non-uniform FFT."""
        # Both functions are real, so the second travels as the imaginary part.
        grid = series[0] if len(series) == 1 else series[0] + 1j * series[1]
        image: ComplexArray = ducc0.nufft.u2nu(
            grid=grid, coord=points, forward=False, epsilon=epsilon, nthreads=1
        )
        return image

    pair = [first] if second is None else [first, second]
    values = transform([s.disc_series for s in pair], coord.reshape(-1, 2)).reshape(u.shape)
    for rim, outside in ((1.0, r > radius), (first.obscuration, r < inner)):
        if np.any(outside):
            slope = transform([s.rim_series(rim) for s in pair], angle[outside][:, None])
            values[outside] += slope * (r[outside] - rim * radius)
    return values.real, None if second is None else values.imag


def rho_of(fraction: Array, obscuration: float) -> Array:
    """Return r/radius at Legendre coordinates in (0, 1)."""
    inner = obscuration**2
    return np.asarray(np.sqrt(inner + (1 - inner) * fraction))


def fraction_of(rho: Array, obscuration: float) -> Array:
    """Return the Legendre coordinate, 0 at the inner and 1 at the outer rim, at r/radius."""
    inner = obscuration**2
    return np.asarray((rho**2 - inner) / (1 - inner))


@lru_cache(maxsize=64)
def analysis(n: int) -> Array:
    """Matrix (n, n) from samples at ``n`` nodes to Legendre coefficients, cached and read-only."""
    fraction, weights = gauss_legendre(n)
    norms = 2 * np.arange(n) + 1
    return frozen(legendre(n, fraction) * weights * norms[:, None])


def _product(table: Array, waves: ComplexArray) -> ComplexArray:
    """Product of a real and a complex matrix by einsum, bit-identical for any thread count."""
    parts = np.ascontiguousarray(waves).view(np.float64)
    return np.asarray(np.einsum("ij,jk->ik", table, parts)).view(np.complex128)


class Mesh(NamedTuple):
    """Points of a mesh of cells with coordinates s and t, including those on the rims.

    Attributes
    ----------
    u, v : ndarray
        Pupil coordinates, m, of the points of ``slopes`` of a series.
    s, t : ndarray
        Coordinates along the last two axes.
    along_s, along_t : ndarray
        Sides of the cells about the nodes, in a shape that broadcasts to theirs.
    """

    u: Array
    v: Array
    s: Array
    t: Array
    along_s: Array
    along_t: Array


class Ring(NamedTuple):
    """Geometry of polar nodes and, as the last row, of the rim: (n_r + 1) x n_theta points.

    Attributes
    ----------
    rho : ndarray, (n_r + 1, 1)
        Radius over pupil radius.
    bend : ndarray, (n_r + 1, 1)
        Derivative of the Legendre coordinate with respect to ``rho``.
    cosine, sine : ndarray, (n_theta,)
        Of the angles.
    share : ndarray, (n_r + 1, 1)
        Fraction of the pupil's area at each point of a ring; 0 on the rim.
    """

    rho: Array
    bend: Array
    cosine: Array
    sine: Array
    share: Array


@lru_cache(maxsize=16)
def ring_of(n_r: int, n_theta: int, obscuration: float) -> Ring:
    """Return the geometry of polar nodes and the rim, cached and read-only."""
    fraction, weights = gauss_legendre(n_r)
    rho = rho_of(np.append(fraction, 1.0), obscuration)[:, None]
    angle = 2 * math.pi * np.arange(n_theta) / n_theta
    share = np.append(weights, 0.0)[:, None] / n_theta
    parts = rho, 2 * rho / (1 - obscuration**2), np.cos(angle), np.sin(angle), share
    return Ring(*map(frozen, parts))


@lru_cache(maxsize=32)
def _rim_tables(n: int, n_r: int) -> tuple[Array, Array]:
    """Legendre tables at ``n_r`` nodes and the rim, cached and read-only."""
    table, slopes = legendre_tables(n, np.append(gauss_legendre(n_r)[0], 1.0))
    return frozen(table), frozen(slopes)


def legendre_tables(n: int, fraction: Array) -> tuple[Array, Array]:
    """First n Legendre polynomials and their derivatives, (n, len(fraction)) each."""
    table = legendre(n, fraction)
    return table, _legendre_slopes(table)


def legendre(n: int, fraction: Array) -> Array:
    """Legendre polynomials P_k(2 f - 1) for k < n, (n, len(f))."""
    return np.asarray(legvander(2 * fraction - 1, n - 1).T)


def _legendre_slopes(table: Array) -> Array:
    """Derivatives d P_k(2 f - 1)/df from a table, by P'_{k+1} = P'_{k-1} + (2 k + 1) P_k."""
    n = len(table)
    slopes = np.zeros_like(table)
    if n > 1:
        slopes[1] = 1.0
    for k in range(1, n - 1):
        slopes[k + 1] = slopes[k - 1] + (2 * k + 1) * table[k]
    return 2 * slopes
