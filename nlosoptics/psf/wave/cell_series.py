"""Spectral interpolation on the patches of an aperture: one tensor Legendre series per patch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..aperture.aperture import Aperture
from ..aperture.curves import cross
from ..aperture.quadrature_nodes import gauss_legendre
from .polar_series import _legendre, _legendre_slopes

Array = NDArray[np.float64]

#: Least s at which slopes are taken: at s = 0 a patch may shrink to a point, where the Jacobian
#: vanishes.
NEAREST = 1e-3
#: Safety factor on the rms of the highest terms as a truncation estimate. It allows for the missing
#: terms, for their aliases, and for a Jacobian that varies over a patch.
LACK = 4.0
#: rms of a term relative to the largest, below which its coefficient is rounding error.
ROUNDING = 1e-15


class CellSpectrum:
    """Legendre series in s and t of a function sampled on `Aperture.nodes`.

    Parameters
    ----------
    values : ndarray, (n_patches, n_s, n_t)
        Real samples.
    aperture : Aperture
        Outline whose patches hold the nodes.
    """

    def __init__(self, values: Array, aperture: Aperture) -> None:
        self.aperture = aperture
        self.shape = values.shape
        # Nodes per patch along s and t, under the names that `PolarSpectrum` uses.
        self.n_r, self.n_theta = values.shape[1:]
        sides = [_analysis(n) for n in values.shape[1:]]
        # einsum does not call BLAS, so results are bit-identical for any thread count.
        half = np.einsum("ki,pij->pkj", sides[0], values)
        self.coefficients = np.einsum("mj,pkj->pkm", sides[1], half)

    def truncation(self) -> float:
        """Estimate the truncation error: `LACK` times the rms of the highest terms.

        The highest terms are about an eighth of the degrees along s and along t.
        """
        k, m = (2 * np.arange(n) + 1 for n in self.shape[1:])
        power = self.coefficients**2 / (k[:, None] * m)
        n_k, n_m = (max(2, n // 8) for n in self.shape[1:])
        high = power[:, -n_k:].sum(axis=(1, 2)) + power[:, :-n_k, -n_m:].sum(axis=(1, 2))
        return LACK * float(np.sum(self.aperture.patch_areas * np.sqrt(high)) / self.aperture.area)

    def degrees(self, threshold: float) -> tuple[int, int]:
        """Return the highest degrees in s and t with a coefficient above threshold and rounding."""
        size = np.abs(self.coefficients).max(axis=0)
        k, m = (np.sqrt(2 * np.arange(n) + 1) for n in self.shape[1:])
        above = (size > threshold) & (size > ROUNDING * float(size.max()) * k[:, None] * m)
        along_s, along_t = np.nonzero(above.any(axis=1))[0], np.nonzero(above.any(axis=0))[0]
        return int(along_s.max(initial=0)), int(along_t.max(initial=0))

    def at_nodes(self, n_patches: int, n_s: int, n_t: int) -> Array:
        """Return values on the aperture's nodes of the given shape, (n_patches, n_s, n_t)."""
        tables = [
            _legendre(n, gauss_legendre(count)[0])
            for n, count in zip(self.shape[1:], (n_s, n_t), strict=True)
        ]
        return self._sum(*tables)

    def slopes(self, n_patches: int, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
        """Return the gradient on the nodes and on the edges of the patches.

        Returns
        -------
        du, dv : ndarray
            Derivatives, (n_patches, n_s + 2, n_t + 2), unit of the values per m.
        weights : ndarray
            Area of each node, (n_patches, n_s + 2, n_t + 2), m^2; 0 on the edges.
        """
        (s, w_s), (t, w_t) = gauss_legendre(n_s), gauss_legendre(n_t)
        s, t = np.concatenate([[NEAREST], s, [1.0]]), np.concatenate([[0.0], t, [1.0]])
        tables = [_legendre(n, x) for n, x in zip(self.shape[1:], (s, t), strict=True)]
        _, along_s, along_t = self.aperture.map(s, t)
        jacobian = cross(along_s, along_t)
        by_s = self._sum(_legendre_slopes(tables[0]), tables[1])
        by_t = self._sum(tables[0], _legendre_slopes(tables[1]))
        du = (by_s * along_t[..., 1] - by_t * along_s[..., 1]) / jacobian
        dv = (by_t * along_s[..., 0] - by_s * along_t[..., 0]) / jacobian
        share = np.zeros_like(du)
        share[:, 1:-1, 1:-1] = jacobian[:, 1:-1, 1:-1] * (w_s[:, None] * w_t)
        return du, dv, share

    def _sum(self, along_s: Array, along_t: Array) -> Array:
        """Evaluate the series from tables of Legendre polynomials along s and along t."""
        half = np.einsum("ki,pkm->pim", along_s, self.coefficients)
        return np.asarray(np.einsum("mj,pim->pij", along_t, half))


def _analysis(n: int) -> Array:
    """Return the matrix (n, n) from values on n Gauss-Legendre nodes to Legendre coefficients."""
    fraction, weights = gauss_legendre(n)
    return np.asarray((2 * np.arange(n) + 1)[:, None] * _legendre(n, fraction) * weights)
