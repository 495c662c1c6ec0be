"""Least-squares fit of terms to an aberration, with the weights that the whole library uses."""

from __future__ import annotations

import numpy as np

from ..._vectors import Array


def fitted_terms(aberration: Array, weights: Array, terms: Array) -> Array:
    """Return the least-squares coefficients of terms fitted to an aberration, (n_terms,), m.

    Parameters
    ----------
    aberration : ndarray, (...)
        Wave aberration at the nodes, m.
    weights : ndarray, (...)
        Amplitude times area of each node, m^2. With these weights the variance of the aberration
        gives the loss of Strehl ratio to second order.
    terms : ndarray, (n_terms, ...)
        Terms at the nodes. Of terms that are linearly dependent on the pupil, as on a narrow slit,
        the solution of least norm is returned.
    """
    flat, weights, inverse = _inverse_moments(terms, weights)
    right = np.einsum("ip,p,p->i", flat, weights, aberration.ravel())
    return np.asarray(inverse @ right)


def projection(terms: Array, weights: Array) -> Array:
    """Return the matrix (n_terms, nodes) from an aberration to the result of `fitted_terms`.

    ``terms`` (n_terms, ...) are given at the nodes, ``weights`` (...) are amplitude times area.
    """
    flat, weights, inverse = _inverse_moments(terms, weights)
    return np.asarray(np.einsum("ij,jp,p->ip", inverse, flat, weights))


def _inverse_moments(terms: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return terms (n_terms, nodes), weights (nodes,) and the inverse of the terms' products."""
    flat, weights = terms.reshape(len(terms), -1), weights.ravel()
    # einsum does not call BLAS, so results are bit-identical for any thread count.
    moments = np.einsum("ip,jp,p->ij", flat, flat, weights)
    return flat, weights, np.asarray(np.linalg.pinv(moments, hermitian=True))
