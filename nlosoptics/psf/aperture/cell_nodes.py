"""Nodes of an aperture's patches, kept between waves of the same pupil."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..._checks import whole
from .aperture import Aperture
from .quadrature_nodes import KEPT, frozen, shared_polar_nodes

Array = NDArray[np.float64]


def shared_cell_nodes(aperture: Aperture, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
    """Return `Aperture.nodes` without a copy: kept and read-only if there are at most `KEPT`."""
    if len(aperture.owners) * n_s * n_t > KEPT:
        return aperture.nodes(n_s, n_t)
    return _kept_nodes(aperture, n_s, n_t)


def pupil_points(
    radius: float, obscuration: float, outline: Aperture | None, counts: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Return nodes of a pupil for integrals, and their areas, without a copy.

    Parameters
    ----------
    radius, obscuration : float
        Outer radius, m, of a disc or ring, and its inner radius divided by the outer.
    outline : Aperture or None
        Outline of a pupil that is neither disc nor ring.
    counts : tuple of int
        Shape of the result: rings and points per ring, or (n_patches, n_s, n_t) of the outline.
    """
    if outline is None:
        n_r, n_theta = counts
        return shared_polar_nodes(radius, n_r, n_theta, obscuration)
    n_patches, n_s, n_t = counts
    whole("the number of patches", n_patches, len(outline.owners), len(outline.owners))
    return shared_cell_nodes(outline, n_s, n_t)


@lru_cache(maxsize=16)
def _kept_nodes(aperture: Aperture, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
    """Return nodes and areas, read-only."""
    u, v, weights = map(frozen, aperture.nodes(n_s, n_t))
    return u, v, weights
