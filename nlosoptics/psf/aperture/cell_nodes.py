"""Nodes of an aperture's patches, kept between waves of the same pupil."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .aperture import Aperture
from .quadrature_nodes import KEPT, frozen

Array = NDArray[np.float64]


def shared_cell_nodes(aperture: Aperture, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
    """Return `Aperture.nodes` without a copy: kept and read-only if there are at most `KEPT`."""
    if len(aperture.owners) * n_s * n_t > KEPT:
        return aperture.nodes(n_s, n_t)
    return _kept_nodes(aperture, n_s, n_t)


@lru_cache(maxsize=16)
def _kept_nodes(aperture: Aperture, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
    """Return nodes and areas, read-only."""
    u, v, weights = map(frozen, aperture.nodes(n_s, n_t))
    return u, v, weights
