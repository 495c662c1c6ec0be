"""Least squares with total variation over a grid of cells, for values in a box."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]


def least_variation(
    gram: Array,
    moment: Array,
    shape: tuple[int, int],
    modes: float,
    *,
    start: Array,
    brightest: Array,
    tolerance: float,
    most: int,
    every: int = 20,
) -> tuple[Array, list[float]]:
    """Minimise ``1/2 f'Gf - f'v + weight TV(f)`` over ``0 <= f <= brightest`` (C,).

    Returns f (N, C), and the relative change of each iteration. G is ``gram`` (N, N) and v is
    ``moment`` (N, C), scaled such that values are of order 1. TV is the sum over the cells of the
    norm of the forward differences along both axes in all colours, so that colours share edges.

    The prior ``exp(-weight TV)`` is most probable where ``weight TV`` equals the number of
    ``modes`` above the noise [1]_. The weight is set to that value after each ``every``
    iterations, up to twice its value for ``start`` (N, C), an estimate in the box. The alternating
    direction method of multipliers splits off differences and box [2]_; its linear equations are
    factored once for each penalty.

    References
    ----------
    .. [1] MacKay, Neural Computation 4 (1992) 415.
    .. [2] Boyd et al., Foundations and Trends in Machine Learning 3 (2011) 1.
    """
    down, across = (_differences(n) for n in shape)
    rows, columns = (scipy.sparse.eye(n) for n in shape)
    ahead = scipy.sparse.vstack(
        [scipy.sparse.kron(down, columns), scipy.sparse.kron(rows, across)], format="csr"
    )
    back = ahead.T.tocsr()
    stiffness, relaxation = 10.0, 1.6
    curvature = (back @ ahead).toarray() + np.eye(len(gram))
    factor = scipy.linalg.cho_factor(gram + stiffness * curvature)
    inside, pulled = start, np.zeros_like(moment)
    edges, bent = np.zeros((2, *moment.shape)), np.zeros((2, *moment.shape))
    changes: list[float] = []

    def flat(pairs: Array) -> Array:
        return pairs.reshape(-1, moment.shape[1])

    def implied() -> float:
        steps = (ahead @ inside).reshape(edges.shape)
        return modes / max(float(np.sqrt((steps**2).sum((0, 2))).sum()), 1e-300)

    most_weight = 2.0 * (weight := implied())
    for step in range(1, most + 1):
        right = moment + stiffness * (back @ flat(edges - bent) + inside - pulled)
        values = scipy.linalg.cho_solve(factor, right, check_finite=False)
        steps = (
            relaxation * (ahead @ values).reshape(edges.shape) + (1.0 - relaxation) * edges + bent
        )
        least = weight / stiffness
        length = np.sqrt((steps**2).sum((0, 2)))[:, None]
        earlier, edges = edges, steps * (1.0 - least / np.maximum(length, least))
        bent = steps - edges
        moved = relaxation * values + (1.0 - relaxation) * inside + pulled
        before, inside = inside, np.clip(moved, 0.0, brightest)
        pulled = moved - inside
        # an object that vanishes has no change relative to itself
        size = max(_norm(inside), tolerance * math.sqrt(inside.size))
        changes.append(max(_norm(inside - before), _norm(values - inside)) / size)
        if step % every == 0:
            wanted = min(implied(), most_weight)
            settled = abs(wanted / weight - 1.0) < 0.05
            weight = min(max(wanted, 0.5 * weight), 2.0 * weight)
            if settled and changes[-1] < tolerance:
                break
            # the penalty balances the relative errors of constraints and of multipliers
            split = (ahead @ values).reshape(edges.shape)
            apart = math.hypot(_norm(values - inside), _norm(split - edges)) / _norm(values)
            moving = _norm(back @ flat(edges - earlier) + inside - before)
            ratio = math.sqrt(apart / max(moving / _norm(back @ flat(bent) + pulled), 1e-12))
            if not 1.0 / 3.0 < ratio < 3.0:
                ratio = min(max(ratio, 0.1), 10.0)
                stiffness, bent, pulled = stiffness * ratio, bent / ratio, pulled / ratio
                factor = scipy.linalg.cho_factor(gram + stiffness * curvature)
    return inside, changes


def _differences(count: int) -> Any:
    """Return the matrix of forward differences of a row, (count, count); its last row is 0."""
    one = np.eye(count)
    return scipy.sparse.csr_array(np.diff(one, axis=0, append=one[-1:]))


def _norm(values: Array) -> float:
    return max(float(np.linalg.norm(values)), 1e-300)
