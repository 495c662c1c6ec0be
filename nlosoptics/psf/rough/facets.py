"""Mean transfer function of a wall of random facets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from ..._vectors import Array
from ...scene import FacetWall
from ..aperture.quadrature_nodes import gauss_legendre
from .view import RoughView

#: Gauss nodes along each axis of a pair of facets; the error is below 3e-8 at any rms phase.
NODES: Final = 12
#: Distance between rows of an equilateral lattice of side 1.
ROW: Final = math.sqrt(0.75)
#: First and last row and column of the table, in cells. It serves separations up to 2 cells, whose
#: rows and columns lie beyond -2.31, and one period.
FIRST, LAST = -2.5, 3.0
#: Points of the table per cell.
PER_CELL: Final = 32


@dataclass(frozen=True, eq=False)
class FacetView(RoughView):
    """Statistics of walls of random triangular facets, with the geometry of the exit pupil.

    Such a wall has random heights at the nodes of a lattice, joined by flat triangles (facets).

    Parameters
    ----------
    roughness : FacetWall
        One of these walls, which gives cell size and slope. Its seed is not used: results are means
        over all seeds and positions of the lattice.
    footprint : ndarray, (2, 2)
        Matrix M: two pupil points at the distance (vector) d see wall points at the distance M d.
    rayleigh_parameter : float
        Rms phase s that the heights add to the wave, rad, averaged over the area of the facets.
    effective_distance : ndarray (2, 2) or None
        Distance over which wall ripples diffract on their way to the pupil, m, see `WallView`.

    Notes
    -----
    Heights are Gaussian at every point, but their variance is larger at the lattice nodes than
    inside the facets. Roughness multiplies the optical transfer function by the mean of
    ``exp(-Var[phase(x) - phase(x + M d)]/2)`` over all positions x in a lattice cell. At distances
    of more than two cells this factor is periodic, because the nodes form a lattice. A moderately
    rough wall of facets therefore also diffracts like a weak grating.
    """

    term_seconds: ClassVar[float] = 1e-5

    roughness: FacetWall  # type: ignore[assignment]

    @property
    def length(self) -> float:
        """Side of the lattice, m."""
        return self.roughness.cell

    @property
    def has_tails(self) -> bool:
        """True: the edges between facets diffract light farther than Gaussian heights do."""
        return True

    @property
    def node_variance(self) -> float:
        """Variance of the phase at a lattice node, rad^2: twice the mean over the facets."""
        return 2 * self.rayleigh_parameter**2

    @cached_property
    def coherent_fraction(self) -> float:
        """Fraction of the energy in the sharp core: squared mean of ``exp(i phase)``, 0 to 1."""
        node, weight = gauss_legendre(2 * NODES)
        a, b = node[:, None], node * (1 - node[:, None])  # a triangle, as in `pair_terms`
        square = (1 - a - b) ** 2 + a**2 + b**2
        area = 2 * weight[:, None] * (1 - a) * weight
        return float(np.sum(area * np.exp(-0.5 * self.node_variance * square)) ** 2)

    @property
    def scattered_fraction(self) -> float:
        """Fraction of the energy outside the core, in the halo, 0 to 1."""
        return 1.0 - self.coherent_fraction

    def on_wall(self, x: Array, y: Array) -> Array:
        """Return `scattered_transfer` at distances (x, y), m, between wall points."""
        from scipy import ndimage

        x, y = np.broadcast_arrays(x, y)
        if x.size <= 50_000:
            return self._summed(x, y)
        found = np.empty(x.shape)
        lag = np.hypot(x, y) / self.roughness.cell
        row = y / (self.roughness.cell * ROW)
        place = np.stack([row, x / self.roughness.cell - 0.5 * row])
        # the transfer function is periodic there
        place = np.where(lag > LAST - 1, LAST - 1 + place % 1.0, place)
        close = lag < 1.2
        found[close] = self._summed(x[close], y[close])
        found[~close] = ndimage.map_coordinates(
            self._table, (place[:, ~close] - FIRST) * PER_CELL, order=3, prefilter=False
        )
        return found

    def _summed(self, x: Array, y: Array) -> Array:
        """Return `on_wall` by integrals over all pairs of facets."""
        from . import _facet_kernels as kernels

        cell, out = self.roughness.cell, np.empty(x.size)
        kernels.pair_terms(
            np.ravel(x) / cell, np.ravel(y) / cell, self.node_variance, *gauss_legendre(NODES), out
        )
        return out.reshape(x.shape) - self.coherent_fraction

    @cached_property
    def _table(self) -> Array:
        """Cubic spline of the transfer function at steps of rows and columns of the lattice."""
        from scipy import ndimage

        # a quarter of a cell beyond all points in use, where the spline depends on its boundary
        steps = FIRST + np.arange((LAST + 0.25 - FIRST) * PER_CELL) / PER_CELL
        row, column = np.meshgrid(steps, steps, indexing="ij")
        cell = self.roughness.cell
        values = self._summed((column + 0.5 * row) * cell, row * cell * ROW)
        return np.asarray(ndimage.spline_filter(values))

    def scattered_transfer(self, du: Array, dv: Array) -> Array:
        """Return the scattered part of the transfer function at separations in the pupil, m."""
        m = self.footprint
        return self.on_wall(m[0, 0] * du + m[0, 1] * dv, m[1, 0] * du + m[1, 1] * dv)

    @cached_property
    def _decay(self) -> tuple[Array, Array]:
        """Separations on the wall, m, and the largest relative transfer function at each."""
        lags = np.append(0.0, np.geomspace(1e-4, 4.0, 161)) * self.roughness.cell
        turn = np.linspace(0, math.pi / 6, 7)[:, None]  # the lattice's mirror symmetry
        found = np.abs(self.on_wall(lags * np.cos(turn), lags * np.sin(turn)))
        return lags, found.max(axis=0) / found[0, 0]

    def last_lag(self, cut: float) -> float:
        """Return the separation, m, beyond which the scattered part is below ``cut`` of its peak.

        It is infinite where the lattice's periodic part exceeds ``cut``.
        """
        lags, found = self._decay
        # the grating orders below 1e-9 are negligible
        above = np.nonzero(found > max(cut, 1e-9))[0]
        if not above.size:
            return float(lags[1])
        return math.inf if above[-1] == lags.size - 1 else float(lags[above[-1] + 1])
