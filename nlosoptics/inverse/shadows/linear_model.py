"""Evidence of an object in the light of a matt wall, with object and ambient light integrated out.

The image is ``y = A f + B c + n``. The object f is Gaussian with a power spectrum that falls as the
square of the spatial frequency, as in natural scenes; c are the coefficients of a polynomial over
the wall, and n is the noise. Its scale, the strength of the object and the order of the polynomial
maximise the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..._checks import whole
from ...errors import SamplingError, SceneError
from ..data.arrays import MEDIAN_OVER_SIGMA, real_array

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WallImage:
    """Pixels of a wall over their noise, (P, C), and polynomials over the wall, (P, K).

    ``used`` (H W,) selects the P pixels that count, of an image of ``shape`` (H, W). ``values`` and
    the orthonormal ``polynomials`` are divided by the ``noise`` (P,) that all colours share, and
    the values also by the rms noise ``sigma`` (C,) of each colour. ``correlated`` is the number of
    pixels that err together; the noise is multiplied by its root, so that sums of squares count
    independent pixels.
    """

    values: Array
    used: NDArray[np.bool_]
    noise: Array
    sigma: Array
    polynomials: Array
    orders: Sequence[int]
    shape: tuple[int, int]
    correlated: float = 1.0

    def over_noise(self, matrix: Array) -> Array:
        """Return the rows (P, N) of an operator that count, over the noise."""
        return np.asarray(matrix[self.used] / self.noise[:, None])

    def of_correlated(self, residual: Array, side: int = 3) -> WallImage:
        """Return the image for as many pixels that err together as a residual (P, C) shows.

        White noise has the same variance in the means of squares of ``side`` pixels, over the
        number of their pixels, as in the pixels. An error of the model varies slowly.
        """
        grid = np.full((self.shape[0] * self.shape[1], residual.shape[1]), np.nan)
        grid[self.used] = residual
        rows, columns = (n // side for n in self.shape)
        grid = grid.reshape(*self.shape, -1)[: rows * side, : columns * side]
        means = grid.reshape(rows, side, columns, side, -1).mean((1, 3))
        means = means[np.isfinite(means).all(2)]
        ratio = side**2 * (means**2).mean(0) / (residual**2).mean(0) if len(means) else np.ones(1)
        factor = max(1.0, float(ratio.mean())) / self.correlated
        return replace(
            self,
            values=self.values / math.sqrt(factor),
            noise=self.noise * math.sqrt(factor),
            correlated=self.correlated * factor,
        )

    def ambient(self, order: int) -> Array:
        """Return the polynomials up to an order, none for -1."""
        return self.polynomials[:, : (order + 1) * (order + 2) // 2]


def wall_image(
    image: Any,
    pixels: tuple[int, int],
    noise: Any = None,
    reference: Any = None,
    ambient: int | None = None,
    most: int = 6,
) -> WallImage:
    """Check an image and sum it over the operator's ``pixels``; see `shadow_fit`."""
    light = seen = _colours("image", image)
    if reference is not None:
        dark = _colours("reference", reference, light.shape)
        light, seen = light - dark, light + dark
    if noise is None:
        variance = _variance_by_neighbours(light, seen)
    else:
        rms = _colours("noise", noise, light.shape)
        variance = np.where(rms > 0.0, rms**2, 0.0)
    if not (variance > 0.0).all():
        raise SceneError("noise is not above 0 in all pixels; state the rms noise of each pixel")
    (rows, columns), colours = pixels, light.shape[2]
    if light.shape[0] % rows or light.shape[1] % columns:
        raise SamplingError(
            f"image has {light.shape[0]} x {light.shape[1]} pixels and the operator {rows} x "
            f"{columns}; give an operator of a whole fraction of them along each side"
        )
    shape = (rows, light.shape[0] // rows, columns, light.shape[1] // columns, colours)
    light, variance = (
        part.reshape(shape).sum((1, 3)).reshape(-1, colours) for part in (light, variance)
    )
    used = np.isfinite(light).all(1) & np.isfinite(variance).all(1)
    if np.count_nonzero(used) < 64:
        raise SamplingError(
            f"image has {np.count_nonzero(used)} pixels of finite value and noise, must be at "
            "least 64; give a larger part of the wall"
        )
    light, variance = light[used], variance[used]
    sigma = np.sqrt(variance.mean(0))
    relative = np.sqrt((variance / sigma**2).mean(1))
    orders = range(-1, most + 1)
    if ambient is not None:
        orders = range(whole("ambient", ambient, -1, 12), ambient + 1)
    y, x = (2.0 * (np.arange(n) + 0.5) / n - 1.0 for n in pixels)
    plane = legendre.legvander2d(*np.meshgrid(x, y), [orders[-1] + 1] * 2)
    degree = np.add.outer(*[np.arange(orders[-1] + 2)] * 2).ravel()
    lowest = np.argsort(degree, kind="stable")[: (orders[-1] + 1) * (orders[-1] + 2) // 2]
    smooth = plane.reshape(rows * columns, -1)[:, lowest][used] / relative[:, None]
    return WallImage(
        values=light / relative[:, None] / sigma,
        used=used,
        noise=relative,
        sigma=sigma,
        polynomials=np.linalg.qr(smooth)[0],
        orders=orders,
        shape=pixels,
    )


def _colours(name: str, values: Any, shape: tuple[int, ...] | None = None) -> Array:
    """Return an image as float64 (H, W, C), broadcast to a shape if one is given."""
    array = real_array(name, values)
    array = array[..., None] if array.ndim == 2 else array
    try:
        array = array if shape is None else np.broadcast_to(array, shape)
    except ValueError:
        raise SamplingError(
            f"{name} has shape {np.shape(values)}; give numbers, (H, W) or (H, W, C) as the image"
        ) from None
    if array.ndim != 3 or array.size == 0:
        raise SamplingError(f"{name} has shape {np.shape(values)}; give (H, W) or (H, W, C)")
    return array


def _variance_by_neighbours(light: Array, seen: Array, groups: int = 16) -> Array:
    """Estimate the variance of each pixel, a + b times its light, from neighbouring pixels.

    The difference of second differences along both axes is free of smooth light; its median square
    in groups of equal brightness resists edges [Immerkaer, CVIU 64 (1996) 300].
    """
    if min(light.shape[:2]) < 16:
        raise SamplingError(
            f"image has {light.shape[0]} x {light.shape[1]} pixels, must have at least 16 x 16 to "
            "estimate its noise; state the noise"
        )
    kernel = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]) / 6.0
    lit = np.maximum(seen, 0.0)
    finite = np.isfinite(lit)
    mean = float(lit[finite].sum()) / max(int(np.count_nonzero(finite)), 1)
    level = lit / max(mean, 1e-300)
    result = np.empty_like(light)
    for colour in range(light.shape[2]):
        rough = scipy.signal.convolve2d(light[..., colour], kernel, mode="valid").ravel() ** 2
        # their mean does not depend on the differences: a pixel's own noise would
        around = scipy.signal.convolve2d(level[..., colour], np.ones((3, 3)) / 9.0, mode="valid")
        near = around.ravel()
        good = np.flatnonzero(np.isfinite(rough + near))
        if len(good) < 4 * groups:
            raise SamplingError(
                f"image has {len(good)} pixels among finite ones, must have at least {4 * groups} "
                "to estimate its noise; state the noise"
            )
        parts = np.array_split(good[np.argsort(near[good], kind="stable")], groups)
        squares = np.array([np.median(rough[part]) / MEDIAN_OVER_SIGMA**2 for part in parts])
        columns = np.stack([np.ones(groups), [near[part].mean() for part in parts]], 1)
        fit = np.full(groups, squares.mean())
        for _ in range(3):  # weights by the squares themselves would favour the low ones
            weight = 1.0 / np.maximum(fit, 1e-3 * squares.mean() + 1e-300)
            constant, slope = scipy.optimize.nnls(columns * weight[:, None], squares * weight)[0]
            fit = columns @ [constant, slope]
        result[..., colour] = constant + slope * level[..., colour]
    return np.where(np.isnan(result), np.inf, result)


class Evidence(NamedTuple):
    """Best linear Gaussian model of a wall's image.

    ``log`` is the natural logarithm of its evidence, ``gain`` how much it exceeds that of the best
    model without an object, and ``order`` the polynomial's order, -1 for none. For each of the
    colours: ``scale``, variance of the noise over the expected one, and ``modes``, the effective
    number of modes above the noise.
    ``estimate`` (N, C) is the posterior mean of the object, ``error`` (N, C) its standard
    deviation, and ``correlation`` the correlation with the object that the model expects.
    ``patterns`` (N, K) are the object's modes, of the same prior variance, ``share`` (K, C) is the
    part of each that the estimate contains, and ``variance`` (K, C) that of its coefficient.
    """

    log: float
    gain: float
    order: int
    scale: Array
    modes: Array
    estimate: Array
    error: Array
    correlation: float
    patterns: Array
    share: Array
    variance: Array

    def noise(self) -> tuple[float, float]:
        """Return the sum of squares that noise adds to the estimate, and its standard error."""
        overlaps, variance = self.patterns.T @ self.patterns, self.share * self.variance
        error = math.sqrt(2.0 * float((variance * (overlaps**2 @ variance)).sum()))
        return float((np.diag(overlaps) @ variance).sum()), error

    def resolved(self, values: Array, shape: tuple[int, int]) -> Array:
        """Return the estimate (N, C) from a noiseless image of an object (N, C)."""
        return np.asarray(self.patterns @ (self.share * (self._inverse(shape) @ values)))

    def not_negative(self, shape: tuple[int, int]) -> tuple[float, NDArray[np.bool_]]:
        """Return the log evidence of an object that is nowhere negative, and its lit cells (N,).

        By Laplace's method: the most probable object with this constraint is less probable than the
        estimate. Lit are the cells in which it is above 0.
        """
        inverse, log, lit = self._inverse(shape), self.log, np.zeros(len(self.estimate), bool)
        for estimate, variance in zip(self.estimate.T, self.variance.T, strict=True):
            precision = inverse.T @ (inverse / variance[:, None])
            values = _not_negative(precision, precision @ estimate)
            lit |= values > 0.0
            log -= 0.5 * float((values - estimate) @ precision @ (values - estimate))
        return log, lit

    def _inverse(self, shape: tuple[int, int]) -> Array:
        """Return the matrix (K, N) from an object to the coefficients of its patterns."""
        modes, prior = cosines(shape)
        return np.asarray(((self.patterns.T @ modes) / prior) @ modes.T)


def _not_negative(matrix: Array, right: Array, tries: int = 3) -> Array:
    """Return the x >= 0 of least ``x'Mx/2 - x'r``, by block principal pivoting.

    All wrong signs are exchanged at once; if their number has not fallen in some tries, only the
    last is [Judice and Pires, Computers & Operations Research 21 (1994) 587].
    """
    free, least, left = np.linalg.solve(matrix, right) > 0.0, len(right) + 1, tries
    small = 1e-9 * float(np.abs(right).max())
    while True:
        values = np.zeros(len(right))
        values[free] = scipy.linalg.solve(matrix[np.ix_(free, free)], right[free], assume_a="pos")
        wrong = np.where(free, values < 0.0, matrix @ values - right < -small)
        count = int(np.count_nonzero(wrong))
        if count == 0:
            return values
        left = tries if count < least else left - 1
        least = min(least, count)
        if left >= 0:
            free ^= wrong
        else:
            last = int(np.flatnonzero(wrong)[-1])
            free[last] = not free[last]


def cosines(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return the cosine modes (N, N) of a grid of cells, and their prior variances (N,).

    The variance is ``1/(f^2 + f_0^2)`` at the spatial frequency f, for f_0 of half a cycle per
    longer side, relative to that of the mean.
    """
    rows, columns = (scipy.fft.idct(np.eye(n), axis=0, norm="ortho") for n in shape)
    v, u = (np.arange(n) / n for n in shape)
    frequency = np.add.outer(v**2, u**2).ravel() * max(shape) ** 2
    modes: Array = np.kron(rows, columns).astype(np.float64, copy=False)
    return modes, 1.0 / (1.0 + frequency)


def evidence(data: WallImage, matrix: Array, shape: tuple[int, int]) -> Evidence:
    """Return the best linear model of an image for the operator ``matrix`` (P, N).

    ``shape`` is that of the grid of cells. Orders of the polynomial are tried until the evidence
    has fallen twice.
    """
    basis, prior = cosines(shape)
    basis = basis * np.sqrt(prior)
    response = data.over_noise(matrix) @ basis
    gram, moment = response.T @ response, response.T @ data.values
    power = (data.values**2).sum(0)
    models: list[Any] = []
    nothing, fallen = [], 0
    for order in data.orders:
        smooth = data.ambient(order)
        seen, light = smooth.T @ response, smooth.T @ data.values
        left = power - (light**2).sum(0)
        count = (len(data.values) - smooth.shape[1]) / data.correlated
        price = smooth.shape[1] * np.log(power).sum()
        nothing.append(-0.5 * (sum(_misfit(part, count)[0] for part in left) + price))
        if fallen == 2:
            continue
        values, vectors = np.linalg.eigh(gram - seen.T @ seen)
        # modes that ambient light explains are rounding
        values[values < values.size * np.finfo(float).eps * np.trace(gram)] = 0.0
        projected = (vectors.T @ (moment - seen.T @ light)) * (values > 0.0)[:, None]
        fits = [_strongest(values, projected[:, c], left[c], count) for c in range(len(left))]
        log = sum(fit[0] for fit in fits) - 0.5 * price
        fallen = fallen + 1 if models and log < models[-1][0] else 0
        models.append((log, order, values, vectors, projected, fits))
    log, order, values, vectors, projected, fits = max(models, key=lambda model: model[0])
    strength, scale = (np.array(part) for part in zip(*(fit[1:] for fit in fits), strict=True))
    share = np.outer(values, strength) / (1.0 + np.outer(values, strength))
    mean = projected * strength / (1.0 + np.outer(values, strength))
    rotated = basis @ vectors
    variance = (rotated**2) @ ((1.0 - share) * strength) * scale
    whole = np.outer((basis**2).sum(1), strength) * scale
    return Evidence(
        log=log,
        gain=float(log - max(nothing)),
        order=order,
        scale=scale,
        modes=share.sum(0),
        estimate=rotated @ mean * data.sigma,
        error=np.sqrt(variance) * data.sigma,
        correlation=math.sqrt(max(0.0, 1.0 - float((variance.mean(0) / whole.mean(0)).mean()))),
        patterns=rotated,
        share=share,
        variance=(1.0 - share) * strength * scale * data.sigma**2,
    )


def _strongest(
    values: Array, projected: Array, left: float, count: float
) -> tuple[float, float, float]:
    """Return the log evidence at its maximum over the object's strength, strength and noise.

    The strength is relative to the noise's variance.
    """

    def cost(log_strength: float) -> tuple[float, float]:
        weighed = 1.0 + math.exp(log_strength) * values
        explained = math.exp(log_strength) * float((projected**2 / weighed).sum())
        misfit, scale = _misfit(left - explained, count)
        return 0.5 * (misfit + float(np.log(weighed).sum())), scale

    grid = np.arange(-3.0, 30.0) - math.log(max(float(values[-1]), 1e-200))
    start = grid[np.argmin([cost(value)[0] for value in grid])]
    best = scipy.optimize.minimize_scalar(
        lambda value: cost(value)[0], bounds=(start - 1.0, start + 1.0), method="bounded"
    )
    return -float(best.fun), math.exp(best.x), cost(best.x)[1]


def _misfit(left: float, count: float) -> tuple[float, float]:
    """Return the misfit of a sum of squares, and the best scale of the noise, at least 0.5."""
    scale = max(left / count, 0.5)
    return count * math.log(scale) + left / scale - count, scale
