"""Phase retrieval by projections from many random starts at once, and averages of their objects."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..data.arrays import half_spectrum_weights

# Power iterations of the spectral start; the direction converges long before.
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
    """Return the leading eigenvector of ``sum y_i^2 a_i a_i'``, scaled to the measurements.

    ``sizes`` are the moduli ``y = |A x|``; ``forward`` and ``adjoint`` are the linear map A with
    rows a_i' and its conjugate transpose. ``first`` starts the power iteration, and ``used`` are
    the measurements to use. Those above three times the rms are omitted, since a few of them would
    dominate the sum.
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
    """Solve ``|A x| = y`` by estimating phases and solving for x in turn [1]_.

    ``sizes`` are the moduli y, in the shape of ``forward(x)``. ``forward`` is A, ``least_squares``
    returns the x that minimises ``|A x - c|`` for given c, and ``start`` is the first x. The
    iteration stops at a relative change of x of ``tolerance``, or after ``max_iterations``. Returns
    the last x and its relative error ``| |A x| - y | / |y|``.

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


# Final iterations that alternate between both constraints only.
_SETTLING = 50
# Fienup's feedback decreases to zero; Luke's relaxation decreases between the two values.
_FEEDBACK = 2.0
_RELAXATION = (0.9, 0.5)
#: Largest number of samples in a tensor; the restarts are divided accordingly.
CHUNK = 2**20
# Restarts whose Fourier error exceeds the least by at most this fraction are averaged.
_AS_GOOD = 0.02


def projected(
    objects: Tensor, modulus: Tensor, support: Tensor, method: str, share: float
) -> Tensor:
    """Make one iteration towards non-negative objects whose spectra have a given modulus.

    Parameters
    ----------
    objects : Tensor, (R, H, W)
        Objects of the restarts.
    modulus : Tensor, (H, W//2 + 1)
        Modulus of the object's ``rfft2``.
    support : Tensor of bool, (H, W)
        Pixels that may be bright.
    method : {"hio", "raar"}
        Hybrid input-output (Fienup 1982), with feedback decreasing from 2 to 0, or relaxed averaged
        alternating reflections (Luke 2005), with relaxation decreasing from 0.9 to 0.5.
    share : float
        Completed fraction of the iterations.
    """
    projection = _with_modulus(objects, modulus)
    if method == "hio":
        feedback = _FEEDBACK * (1.0 - share)
        bright = support & (projection > 0.0)
        return torch.where(bright, projection, objects - feedback * projection)
    relaxation = _RELAXATION[0] + (_RELAXATION[1] - _RELAXATION[0]) * share
    reflection = allowed(2.0 * projection - objects, support)
    return relaxation * (reflection + objects) + (1.0 - 2.0 * relaxation) * projection


def settled(objects: Tensor, modulus: Tensor, support: Tensor) -> Tensor:
    """Return objects (R, H, W) after final iterations between the two constraints only."""
    for _ in range(_SETTLING):
        objects = allowed(_with_modulus(objects, modulus), support)
    return objects


def allowed(objects: Tensor, support: Tensor) -> Tensor:
    """Return the non-negative parts of objects (R, H, W) within their support."""
    return objects.clamp_min(0.0) * support


def fourier_errors(objects: Tensor, modulus: Tensor) -> Tensor:
    """Return the relative rms differences (R,) of the objects' spectral moduli from ``modulus``."""
    twice = torch.from_numpy(half_spectrum_weights(objects.shape[-1])).to(modulus)
    misfit = (torch.fft.rfft2(objects).abs() - modulus) ** 2 * twice
    whole = (modulus**2 * twice).sum()
    errors: Tensor = (misfit.sum(dim=(-2, -1)) / whole).sqrt()
    return errors


def averaged(objects: Tensor, errors: Tensor) -> Tensor:
    """Average the best restart and all nearly as good ones, after aligning them to the best.

    If the modulus is noisy, the restarts end at the same object with different errors, which their
    mean reduces.
    """
    best = int(errors.argmin())
    reference = objects[best]
    good = errors <= (1.0 + _AS_GOOD) * errors[best]
    moved = [onto(candidate, reference) for candidate in objects[good]]
    return torch.stack(moved).mean(dim=0)


def onto(picture: Tensor, reference: Tensor) -> Tensor:
    """Shift an object by whole pixels to match a reference.

    It is also turned by half a turn if that improves the match.
    """
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


def _with_modulus(objects: Tensor, modulus: Tensor) -> Tensor:
    """Return the objects closest to the given ones whose spectra have the given modulus."""
    spectrum = torch.fft.rfft2(objects)
    size = spectrum.abs().clamp_min(torch.finfo(modulus.dtype).tiny)
    result: Tensor = torch.fft.irfft2(spectrum * (modulus / size), s=tuple(objects.shape[-2:]))
    return result
