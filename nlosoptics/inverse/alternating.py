"""Phases of any linear measurements by alternating minimisation."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

# Power iterations of the start; the leading vector's direction settles long before.
_POWER_ITERATIONS = 50
# Measurements over this many times their rms are left out of the start (Chen and Candes 2015).
_TRUNCATION = 3.0


def spectral_start(
    sizes: Tensor,
    forward: Callable[[Tensor], Tensor],
    adjoint: Callable[[Tensor], Tensor],
    *,
    first: Tensor,
    used: Tensor,
) -> Tensor:
    """Leading vector of ``sum y_i^2 a_i a_i'`` over some of the measurements, at their norm.

    Parameters
    ----------
    sizes : Tensor
        ``y = |A x|``.
    forward, adjoint : callable
        A and its conjugate transpose.
    first : Tensor
        Where the power iteration starts, as x.
    used : Tensor
        bool, as y: the measurements that the start may see. Those over three times the rms are
        left out of it besides, since a few would otherwise decide it.
    """
    squares = sizes * sizes
    limit = _TRUNCATION**2 * squares[used].mean()
    weights = torch.where(used & (squares <= limit), squares, 0.0)
    vector = first / first.norm()
    for _ in range(_POWER_ITERATIONS):
        vector = adjoint(weights * forward(vector))
        vector = vector / vector.norm().clamp_min(torch.finfo(sizes.dtype).tiny)
    seen = forward(vector)[used].abs()
    scale = sizes[used].norm() / seen.norm().clamp_min(torch.finfo(sizes.dtype).tiny)
    start: Tensor = vector * scale
    return start


def alternating_minimisation(
    sizes: Tensor,
    forward: Callable[[Tensor], Tensor],
    least_squares: Callable[[Tensor], Tensor],
    start: Tensor,
    *,
    max_iterations: int,
    tolerance: float,
) -> tuple[Tensor, float]:
    """Phases, then the vector that fits them best, in turns [1]_.

    Parameters
    ----------
    sizes : Tensor
        ``y = |A x|``.
    forward : callable
        A.
    least_squares : callable
        x of least ``|A x - c|`` for given c.
    start : Tensor
    max_iterations : int
    tolerance : float
        Relative change of x per iteration at which to stop.

    Returns
    -------
    vector : Tensor
    error : float
        ``| |A x| - y | / |y|``.

    References
    ----------
    .. [1] Netrapalli, Jain and Sanghavi, Advances in Neural Information Processing Systems 26
       (2013) 2796; IEEE Trans. Signal Process. 63 (2015) 4814.
    """
    vector = start
    for _ in range(max_iterations):
        seen = forward(vector)
        new = least_squares(sizes * torch.sgn(seen))
        change = float((new - vector).norm()) / max(float(new.norm()), 1e-300)
        vector = new
        if change <= tolerance:
            break
    misfit = forward(vector).abs() - sizes
    return vector, math.sqrt(float((misfit * misfit).sum()) / float((sizes * sizes).sum()))
