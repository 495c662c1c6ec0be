"""Spectral interpolation on the patches of an aperture: tensor Legendre series, one for each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..aperture.aperture import Aperture
from ..aperture.curves import cross
from ..aperture.quadrature_nodes import gauss_legendre
from .polar_series import _legendre, _legendre_slopes

Array = NDArray[np.float64]

#: Nearest to s = 0 that slopes are taken, where a patch may come to a point.
NEAREST = 1e-3
#: Times the last terms' rms: those that lack, those that they are taken for on too few nodes, and
#: a Jacobian that weighs a part of a patch more than its mean.
LACK = 4.0
#: rms of a term over the largest; below it a coefficient is rounding.
ROUNDING = 1e-15


class CellSpectrum:
    """Legendre series in s and t of samples on `Aperture.nodes`.

    Parameters
    ----------
    values : ndarray
        (n_patches, n_s, n_t), real.
    aperture : Aperture
    """

    def __init__(self, values: Array, aperture: Aperture) -> None:
        self.aperture = aperture
        self.shape = values.shape
        self.n_r, self.n_theta = values.shape[1:]  # of each patch, as `PolarSpectrum` calls them
        sides = [_analysis(n) for n in values.shape[1:]]
        # einsum without BLAS: the same bits for any thread count
        half = np.einsum("ki,pij->pkj", sides[0], values)
        self.coefficients = np.einsum("mj,pkj->pkm", sides[1], half)

    def truncation(self) -> float:
        """Some times the rms of the highest terms, about an eighth each way, over the pupil."""
        k, m = (2 * np.arange(n) + 1 for n in self.shape[1:])
        power = self.coefficients**2 / (k[:, None] * m)
        n_k, n_m = (max(2, n // 8) for n in self.shape[1:])
        high = power[:, -n_k:].sum(axis=(1, 2)) + power[:, :-n_k, -n_m:].sum(axis=(1, 2))
        return LACK * float(np.sum(self.aperture.patch_areas * np.sqrt(high)) / self.aperture.area)

    def degrees(self, threshold: float) -> tuple[int, int]:
        """Highest degrees in s and t of a coefficient above the threshold and above rounding."""
        size = np.abs(self.coefficients).max(axis=0)
        k, m = (np.sqrt(2 * np.arange(n) + 1) for n in self.shape[1:])
        above = (size > threshold) & (size > ROUNDING * float(size.max()) * k[:, None] * m)
        along_s, along_t = np.nonzero(above.any(axis=1))[0], np.nonzero(above.any(axis=0))[0]
        return int(along_s.max(initial=0)), int(along_t.max(initial=0))

    def at_nodes(self, n_patches: int, n_s: int, n_t: int) -> Array:
        """Values on the aperture's nodes (n_patches, n_s, n_t)."""
        tables = [
            _legendre(n, gauss_legendre(count)[0])
            for n, count in zip(self.shape[1:], (n_s, n_t), strict=True)
        ]
        return self._sum(*tables)

    def slopes(self, n_patches: int, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
        """Gradient on the nodes and on the patches' rims.

        Returns
        -------
        du, dv : ndarray
            Derivatives, (n_patches, n_s + 2, n_t + 2), 1/m times the unit of the values.
        weights : ndarray
            The nodes' area, m^2, 0 on the rims.
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
        half = np.einsum("ki,pkm->pim", along_s, self.coefficients)
        return np.asarray(np.einsum("mj,pim->pij", along_t, half))


def _analysis(n: int) -> Array:
    """Matrix (n, n) from values on n Gauss-Legendre nodes to Legendre coefficients."""
    fraction, weights = gauss_legendre(n)
    return np.asarray((2 * np.arange(n) + 1)[:, None] * _legendre(n, fraction) * weights)
