"""Least-squares terms of an aberration, one weighting for all that remove or report them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def fitted_terms(aberration: Array, weights: Array, terms: Array) -> Array:
    """Return the coefficients (n_terms,), m, of the terms that fit an aberration best.

    Parameters
    ----------
    aberration : ndarray, (...)
        Wave aberration at the nodes, m.
    weights : ndarray, (...)
        Amplitude times area of each node, which the Strehl ratio sees to second order.
    terms : ndarray, (n_terms, ...)
        Terms at the nodes. Those that the pupil cannot tell apart, as across a slit, share their
        part.
    """
    flat, weights = terms.reshape(len(terms), -1), weights.ravel()
    # einsum without BLAS: the same bits for any thread count
    moments = np.einsum("ip,jp,p->ij", flat, flat, weights)
    right = np.einsum("ip,p,p->i", flat, weights, aberration.ravel())
    return np.asarray(np.linalg.pinv(moments, hermitian=True) @ right)


def projection(terms: Array, weights: Array) -> Array:
    """Share (n_terms, nodes) of each node's value in the coefficients of `fitted_terms`.

    ``weights`` are amplitude times area, of the shape of one of the ``terms``.
    """
    flat = terms.reshape(len(terms), -1)
    moments = np.einsum("ip,jp,p->ij", flat, flat, weights.ravel())
    inverse = np.linalg.pinv(moments, hermitian=True)
    return np.asarray(np.einsum("ij,jp,p->ip", inverse, flat, weights.ravel()))
