"""Least-squares terms of an aberration, one weighting for all that remove or report them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .wavefronts import Wavefront

Array = NDArray[np.float64]


def fitted_terms(wavefront: Wavefront, terms: Array) -> Array:
    """Coefficients (n_terms,), m, of the terms (n_terms, ...) that fit the aberration best.

    Nodes weigh with amplitude times area, which is what the Strehl ratio sees to second order.
    Terms that the pupil cannot tell apart, as across a slit, share their part.
    """
    flat = terms.reshape(len(terms), -1)
    weights = (wavefront.amplitude * wavefront.weights).ravel()
    # einsum without BLAS: the same bits for any thread count
    moments = np.einsum("ip,jp,p->ij", flat, flat, weights)
    right = np.einsum("ip,p,p->i", flat, weights, wavefront.aberration.ravel())
    return np.asarray(np.linalg.pinv(moments, hermitian=True) @ right)


def projection(terms: Array, weights: Array) -> Array:
    """Share (n_terms, nodes) of each node's value in the coefficients of `fitted_terms`.

    ``weights`` are amplitude times area, of the shape of one of the ``terms``.
    """
    flat = terms.reshape(len(terms), -1)
    moments = np.einsum("ip,jp,p->ij", flat, flat, weights.ravel())
    inverse = np.linalg.pinv(moments, hermitian=True)
    return np.asarray(np.einsum("ij,jp,p->ip", inverse, flat, weights.ravel()))
