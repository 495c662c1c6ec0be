"""Quadrature nodes of a disc or ring on chords, symmetric about both axes.

Rows of constant v are shared by all nodes of a chord, so that a Fourier transform separates into
matrix products along u and then along v. Unlike a grid, the nodes end at the rims, where no wave
needs to be continued, and the sum converges spectrally.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..aperture.quadrature_nodes import gauss_legendre

Array = NDArray[np.float64]


class ChordNodes(NamedTuple):
    """Nodes in the quadrant u > 0, v > 0 of the unit disc; each has three mirror images.

    Attributes
    ----------
    v : ndarray, (rows,)
        Height of each chord, relative to the radius.
    starts : tuple of int, (rows + 1,)
        Nodes ``starts[i]`` to ``starts[i + 1]`` lie on chord i.
    u : ndarray, (n,)
        Coordinate of each node along its chord, relative to the radius.
    weights : ndarray, (n,)
        Area of each node, relative to the squared radius. Their sum is a quarter of the pupil's.
    """

    v: Array
    starts: tuple[int, ...]
    u: Array
    weights: Array

    @property
    def heights(self) -> Array:
        """Coordinate v of each node, (n,)."""
        return np.repeat(self.v, np.diff(self.starts))


class Need(NamedTuple):
    """Phases and accuracy for which chord nodes are chosen.

    Attributes
    ----------
    along_u, along_v : float
        Largest change of the phase over one pupil radius along a chord, and in any direction, rad.
    degree : int
        Degree of the aberration.
    digits : float
        Accuracy of the sum relative to the ideal peak, as -log10.
    """

    along_u: float
    along_v: float
    degree: int
    digits: float

    def count(self, phase: float, bend: float = 1.0) -> int:
        """Return an even number of Gauss nodes that integrate exp(i phase s), 0 < s < 1.

        The law is that of `quadrature.coarse_counts`. ``bend`` is the length of an arc in the
        pupil's coordinates over that of its chord.
        """
        n = phase / 4 + 0.67 * math.cbrt(self.digits**2) * math.cbrt(phase) + bend * self.degree / 2
        return 2 * math.ceil(n / 2 + 1)


def chord_nodes(obscuration: float, need: Need) -> ChordNodes:
    """Return the nodes of a disc, or of a ring of inner radius ``obscuration``."""
    rows: list[tuple[float, float, float, float]] = []  # v, weight of v, ends of the chord
    if obscuration == 0.0:
        # Gauss-Chebyshev of the second kind: a chord of half length c has an integral c f(c^2)
        n = need.count(2 * need.along_v)
        for i in range(1, n // 2 + 1):
            angle = math.pi * i / (n + 1)
            rows.append(
                (math.cos(angle), math.pi / (n + 1) * math.sin(angle), 0.0, math.sin(angle))
            )
    else:
        # above the inner rim, v = cos(angle), an even function of the angle
        arc = math.acos(obscuration)
        nodes, weights = _half(need.count(2 * arc * need.along_v, math.pi / 2))
        for angle, w in zip((arc * nodes).tolist(), weights.tolist(), strict=True):
            rows.append((math.cos(angle), arc * math.sin(angle) * w, 0.0, math.sin(angle)))
        # between the rims, v = e sin(angle)
        nodes, weights = _half(need.count(math.pi * obscuration * need.along_v, math.pi / 2))
        for angle, w in zip((math.pi / 2 * nodes).tolist(), weights.tolist(), strict=True):
            v, inner = obscuration * math.sin(angle), obscuration * math.cos(angle)
            rows.append((v, math.pi / 2 * inner * w, inner, math.sqrt((1 - v) * (1 + v))))
    u, areas = [], []
    for _, weight, inner, outer in rows:
        if inner == 0.0:
            nodes, weights = _half(need.count(2 * outer * need.along_u))
        else:
            nodes, weights = gauss_legendre(need.count((outer - inner) * need.along_u))
        u.append(inner + (outer - inner) * nodes)
        areas.append(weight * (outer - inner) * weights)
    starts = np.cumsum([0, *map(len, u)]).tolist()
    heights = np.array([row[0] for row in rows])
    return ChordNodes(heights, tuple(starts), np.concatenate(u), np.concatenate(areas))


def _half(count: int) -> tuple[Array, Array]:
    """Return the positive half of an even number of Gauss nodes on (-1, 1), and their weights.

    The weights sum to 1.
    """
    nodes, weights = gauss_legendre(count)
    return 2 * nodes[count // 2 :] - 1, 2 * weights[count // 2 :]
