"""Nodes of a pupil of any outline, kept between waves of the same pupil."""

from __future__ import annotations

import math
from functools import lru_cache

from ..._checks import whole
from ..._vectors import Array
from .aperture import Aperture
from .quadrature_nodes import KEPT, frozen, polar_nodes


def pupil_points(
    radius: float, obscuration: float, outline: Aperture | None, counts: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Return nodes of a pupil for integrals, and their areas; at most `KEPT` of them are kept.

    Parameters
    ----------
    radius, obscuration : float
        Outer radius, m, of a disc or ring, and its inner radius divided by the outer.
    outline : Aperture or None
        Outline of a pupil that is neither disc nor ring.
    counts : tuple of int
        Shape of the result: rings and points per ring, or (n_patches, n_s, n_t) of the outline.
    """
    counts = tuple(whole("samples", n) for n in counts)
    return (_kept if math.prod(counts) <= KEPT else _points)(radius, obscuration, outline, counts)


def _points(
    radius: float, obscuration: float, outline: Aperture | None, counts: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Compute the nodes of a pupil."""
    if outline is None:
        return polar_nodes(radius, counts[0], counts[1], obscuration)
    n_patches, n_s, n_t = counts
    whole("the number of patches", n_patches, len(outline.owners), len(outline.owners))
    return outline.nodes(n_s, n_t)


@lru_cache(maxsize=32)
def _kept(
    radius: float, obscuration: float, outline: Aperture | None, counts: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Return the nodes of a pupil, read-only."""
    u, v, weights = map(frozen, _points(radius, obscuration, outline, counts))
    return u, v, weights
