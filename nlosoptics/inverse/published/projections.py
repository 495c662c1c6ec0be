"""Phase retrieval by projections on many restarts at once, and how restarts agree."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

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
        Maximum number of iterations.
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


Projections = Literal["hio", "raar"]

# The last iterations of either method only enforce both constraints.
_SETTLING = 50
# Fienup's feedback falls to zero while it runs; Luke's relaxation falls between the two values.
_FEEDBACK = 2.0
_RELAXATION = (0.9, 0.5)
# Tensors of a chunk of restarts hold so many samples.
_CHUNK = 2**20
# Restarts whose Fourier error is within this part of the least are averaged.
_AS_GOOD = 0.02


def projected(
    modulus: Tensor,
    support: Tensor,
    starts: Tensor,
    *,
    method: Projections,
    iterations: int,
    watch: Callable[[float, Tensor], bool],
) -> tuple[Tensor, Tensor]:
    """Non-negative objects in a support whose spectra have a modulus.

    Parameters
    ----------
    modulus : Tensor
        (H, W//2 + 1).
    support : Tensor
        (H, W) bool.
    starts : Tensor
        (R, H, W).
    method : {"hio", "raar"}
        Hybrid input-output (Fienup 1982), its feedback falling from 2 to 0, or relaxed averaged
        alternating reflections (Luke 2005), its relaxation from 0.9 to 0.5.
    iterations : int
    watch : callable
        Called with the fraction done and the objects so far, (R', H, W); where it returns False,
        these are settled and are all.

    Returns
    -------
    objects : Tensor
        (R, H, W).
    errors : Tensor
        (R,), rms of the spectra's moduli against ``modulus``, relative.
    """
    per_chunk = max(1, _CHUNK // support.numel())
    chunks = [starts[i : i + per_chunk] for i in range(0, len(starts), per_chunk)]
    found: list[Tensor] = []
    for number, chunk in enumerate(chunks):
        objects = chunk * support
        on = True
        for iteration in range(iterations):
            share = iteration / iterations
            objects = _step(objects, modulus, support, method, share)
            if iteration % 20 == 19:
                allowed = _allowed(objects, support)
                on = watch((number + share) / len(chunks), torch.cat([*found, allowed]))
            if not on:
                break
        for _ in range(_SETTLING):
            objects = _allowed(_with_modulus(objects, modulus), support)
        found.append(objects)
        if not on:
            break
    objects = torch.cat(found)
    return objects, fourier_errors(objects, modulus)


def fourier_errors(objects: Tensor, modulus: Tensor) -> Tensor:
    """Rms of (R, H, W) objects' spectral moduli against one, relative, (R,)."""
    columns = objects.shape[-1]
    # A half spectrum holds every column but the first, and the last of an even grid, for two.
    twice = torch.full_like(modulus[0], 2.0)
    twice[0] = 1.0
    if columns % 2 == 0:
        twice[-1] = 1.0
    misfit = (torch.fft.rfft2(objects).abs() - modulus) ** 2 * twice
    whole = (modulus**2 * twice).sum()
    errors: Tensor = (misfit.sum(dim=(-2, -1)) / whole).sqrt()
    return errors


def averaged(objects: Tensor, errors: Tensor) -> Tensor:
    """Mean of the best restart and those as good, each moved and turned onto the best.

    Where the moduli are noisy, restarts end at different errors of the same picture; their mean
    has less of them.
    """
    best = int(errors.argmin())
    reference = objects[best]
    good = errors <= (1.0 + _AS_GOOD) * errors[best]
    moved = [onto(candidate, reference) for candidate in objects[good]]
    return torch.stack(moved).mean(dim=0)


def onto(picture: Tensor, reference: Tensor) -> Tensor:
    """A picture moved by whole samples, and turned by half a turn where that fits better."""
    spectrum = torch.fft.rfft2(reference - reference.mean())
    best, found = -math.inf, picture
    for candidate in (picture, picture.flip(0, 1)):
        product = spectrum * torch.fft.rfft2(candidate).conj()
        overlap = torch.fft.irfft2(product, s=tuple(picture.shape))
        peak = int(overlap.argmax())
        if float(overlap.flatten()[peak]) > best:
            best = float(overlap.flatten()[peak])
            found = candidate.roll(divmod(peak, picture.shape[1]), (0, 1))
    return found


def _step(
    objects: Tensor, modulus: Tensor, support: Tensor, method: Projections, share: float
) -> Tensor:
    projection = _with_modulus(objects, modulus)
    if method == "hio":
        feedback = _FEEDBACK * (1.0 - share)
        allowed = support & (projection > 0.0)
        return torch.where(allowed, projection, objects - feedback * projection)
    relaxation = _RELAXATION[0] + (_RELAXATION[1] - _RELAXATION[0]) * share
    reflection = _allowed(2.0 * projection - objects, support)
    return relaxation * (reflection + objects) + (1.0 - 2.0 * relaxation) * projection


def _with_modulus(objects: Tensor, modulus: Tensor) -> Tensor:
    """The nearest picture whose spectrum has the modulus."""
    spectrum = torch.fft.rfft2(objects)
    size = spectrum.abs().clamp_min(torch.finfo(modulus.dtype).tiny)
    result: Tensor = torch.fft.irfft2(spectrum * (modulus / size), s=tuple(objects.shape[-2:]))
    return result


def _allowed(objects: Tensor, support: Tensor) -> Tensor:
    return objects.clamp_min(0.0) * support
