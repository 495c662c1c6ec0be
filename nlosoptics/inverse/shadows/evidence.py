"""Evidence of an object in the light of a matt wall, with object and ambient light integrated out.

The image is ``y = A f + B c + n``. The object f is Gaussian with a power spectrum that falls as the
square of the spatial frequency, as in natural scenes; c are the coefficients of a polynomial over
the wall, and n is the noise. Its scale, the strength of the object and the order of the polynomial
maximise the evidence.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from .wall_image import WallImage

Array = NDArray[np.float64]


class Evidence(NamedTuple):
    """Best linear Gaussian model of a wall's image.

    ``log`` is the natural logarithm of its evidence, ``gain`` how much it exceeds that of the best
    model without an object, and ``order`` the polynomial's order, -1 for none. For each of the
    colours: ``strength``, prior variance of the object at the lowest frequency; ``scale``, variance
    of the noise over the expected one; ``modes``, the effective number of modes above the noise.
    ``estimate`` (N, C) is the posterior mean of the object, ``error`` (N, C) its standard deviation
    and ``correlation`` the correlation with the object that the model expects.
    """

    log: float
    gain: float
    order: int
    strength: Array
    scale: Array
    modes: Array
    estimate: Array
    error: Array
    correlation: float


def cosines(shape: tuple[int, int], most: int) -> tuple[Array, Array]:
    """Return the lowest cosine modes (N, n) of a grid of cells, and their prior variances (n,).

    The variance is ``1/(f^2 + f_0^2)`` at the spatial frequency f, for f_0 of half a cycle per
    longer side, relative to that of the mean.
    """
    rows, columns = (scipy.fft.idct(np.eye(n), axis=0, norm="ortho") for n in shape)
    v, u = (np.arange(n) / n for n in shape)
    frequency = np.add.outer(v**2, u**2).ravel() * max(shape) ** 2
    lowest = np.argsort(frequency, kind="stable")[:most]
    modes = np.einsum("ai,bj->ijab", rows, columns).reshape(len(frequency), -1)[lowest].T
    return np.ascontiguousarray(modes), 1.0 / (1.0 + frequency[lowest])


def evidence(
    data: WallImage, matrix: Array, shape: tuple[int, int], *, most: int = 600
) -> Evidence:
    """Return the best linear model of an image for the operator ``matrix`` (P, N).

    ``shape`` is that of the grid of cells, and ``most`` limits the number of its cosine modes.
    """
    basis, prior = cosines(shape, most)
    basis = basis * np.sqrt(prior)
    response = data.over_noise(matrix) @ basis
    gram, moment = response.T @ response, response.T @ data.values
    power = (data.values**2).sum(0)
    best = nothing = None
    for order in data.orders:
        smooth = data.ambient(order)
        seen, light = smooth.T @ response, smooth.T @ data.values
        values, vectors = np.linalg.eigh(gram - seen.T @ seen)
        values = np.maximum(values, 0.0)
        projected = vectors.T @ (moment - seen.T @ light)
        left = power - (light**2).sum(0)
        count = (len(data.values) - smooth.shape[1]) / data.correlated
        price = smooth.shape[1] * np.log(power).sum()
        none = -0.5 * (count * np.log(left / count).sum() + price)
        fits = [_strongest(values, projected[:, c], left[c], count) for c in range(len(left))]
        log = sum(fit[0] for fit in fits) - 0.5 * price
        nothing = none if nothing is None else max(nothing, none)
        if best is None or log > best[0]:
            best = (log, order, values, vectors, projected, fits)
    assert best is not None and nothing is not None
    log, order, values, vectors, projected, fits = best
    strength, scale = (np.array(part) for part in zip(*(fit[1:] for fit in fits), strict=True))
    share = np.outer(values, strength) / (1.0 + np.outer(values, strength))
    mean = projected * strength / (1.0 + np.outer(values, strength))
    rotated = basis @ vectors
    variance = (rotated**2) @ ((1.0 - share) * strength) * scale
    whole = np.outer((basis**2).sum(1), strength) * scale
    return Evidence(
        log=log,
        gain=log - nothing,
        order=order,
        strength=strength * scale,
        scale=scale,
        modes=share.sum(0),
        estimate=rotated @ mean * data.sigma,
        error=np.sqrt(variance) * data.sigma,
        correlation=math.sqrt(max(0.0, 1.0 - float((variance.mean(0) / whole.mean(0)).mean()))),
    )


def _strongest(
    values: Array, projected: Array, left: float, count: float
) -> tuple[float, float, float]:
    """Return the log evidence at its maximum over the object's strength, strength and noise.

    The strength is relative to the noise's variance, which takes its most probable value, but at
    least half the expected one.
    """

    def cost(log_strength: float) -> tuple[float, float]:
        strength = math.exp(log_strength)
        weighed = 1.0 + strength * values
        unexplained = left - strength * float((projected**2 / weighed).sum())
        scale = max(unexplained / count, 0.5)
        fit = count * math.log(scale) + unexplained / scale - count
        return 0.5 * (fit + float(np.log(weighed).sum())), scale

    grid = np.arange(-3.0, 30.0) - math.log(max(float(values[-1]), 1e-300))
    start = grid[np.argmin([cost(value)[0] for value in grid])]
    best = scipy.optimize.minimize_scalar(
        lambda value: cost(value)[0], bounds=(start - 1.0, start + 1.0), method="bounded"
    )
    return -float(best.fun), math.exp(best.x), cost(best.x)[1]
