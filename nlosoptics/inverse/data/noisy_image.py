"""Image data that were checked against an image model, with their noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from ..._checks import positive, real, squarable
from ...errors import SceneError
from ...imaging.forward_model import ForwardModel
from .arrays import as_numpy, check_finite, check_shape, is_tensor, real_array, shape_of, total
from .measurement import measured
from .models import half_weights, model_shape, object_power, passed_power, power
from .noise import clipped_pixels, lit_pixels, pixel_noise, surrounded

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class NoisyImage:
    """Image with its known background subtracted, and its noise.

    ``data`` (H, W): image minus the known background, float64. Excluded pixels hold the weighted
    mean. ``sigma``: reference noise: 1/sigma^2 is the mean of 1/noise_sigma^2 over the pixels.
    ``weights`` (H, W): (sigma/noise_sigma)^2, mean 1. Excluded pixels, which have infinite noise,
    have weight 0. ``fit_background``: whether there is a further background of unknown strength.
    ``background_shape`` (H, W): shape of that background, mean 1. ``template``: the image as given
    if it was a tensor; None for an array. ``bad_pixels`` (H, W): mask of the pixels that were found
    to be dead, hot or saturated, and are excluded too; None if none was. ``saturated`` (H, W): mask
    of those of them that are saturated; None if no pixel is. ``least`` (H, W): values that the
    saturated pixels would at least have without saturation, in the unit of ``data``; not finite for
    all other pixels. None if no pixel is saturated.
    """

    data: Array
    sigma: float
    weights: Array
    fit_background: bool
    background_shape: Array
    template: Any
    bad_pixels: Mask | None = None
    saturated: Mask | None = None
    least: Array | None = None

    @property
    def counted(self) -> int:
        """Number of pixels with finite noise; the others are excluded from fits."""
        return int(np.count_nonzero(self.weights))

    def noise_power(self) -> float:
        """Return the expected sum of squares of noise and of excluded pixels, over all pixels.

        An excluded pixel holds the mean of the others. Its error has the variance of the image
        itself.
        """
        counts = self.weights > 0.0
        values = self.data[counts]
        noise = self.sigma**2 * total((1.0 / self.weights[counts])[None])
        return noise + (self.data.size - values.size) * float(values.var())

    def weighted(self, values: Array) -> Array:
        """Return values (H, W) times the pixel weights."""
        return values * self.weights

    def background_strength(self, values: Array) -> float:
        """Return the best-fitting strength of the unknown background; 0 if it is known."""
        if not self.fit_background:
            return 0.0
        shape = self.background_shape
        # a veil can be dark in all pixels that count
        return total(self.weighted(shape * values)) / (total(self.weighted(shape * shape)) or 1.0)

    def background(self, strength: float) -> Array:
        """Return the unknown background for a given strength, which is its mean over the image."""
        return strength * self.background_shape

    def without_background(self) -> Array:
        """Return the image (H, W) minus the unknown background that best fits it alone."""
        return self.data - self.background(self.background_strength(self.data))

    def whitened(self, values: Array) -> Array:
        """Return values (H, W) times the roots of the weights: of noise, equally strong noise."""
        return values * np.sqrt(self.weights)

    def border_strength(self) -> float:
        """Return the strength of the unknown background at the image's border; 0 if it is known."""
        if not self.fit_background:
            return 0.0

        values, shape = (
            np.concatenate((edges[0], edges[-1], edges[:, 0], edges[:, -1]))
            for edges in (self.data, self.background_shape)
        )
        lit = shape > 0.5
        values = values[lit] / shape[lit]
        return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0

    def span(self) -> float:
        """Return the brightest minus the darkest pixel, at least the noise."""
        return max(float(self.data.max()) - float(self.data.min()), self.sigma)

    def working_dtype(self) -> Any:
        """Return float32, or float64 if the noise is close to rounding errors of float32 FFTs."""
        return np.float32 if self.sigma > 1e-4 * self.span() else np.float64

    def score(self, explained: Array | float) -> float:
        """Return the weighted rms of data minus ``explained``, divided by the noise."""
        residual = self.data - explained
        rms = math.sqrt(total(self.weighted(residual * residual)) / self.counted)
        return rms / self.sigma if self.sigma > 0.0 else rms

    def is_background(self, model: ForwardModel | None = None) -> bool:
        """Return whether no object is detected against the unknown background and noise.

        ``model``: image model; if omitted, all frequencies are taken to pass.

        Weighted sums of the spectrum's power are compared with their distributions for white
        noise. The weights are the transfer function's power times 1, 1/f and 1/f^2, for dots,
        strokes and extended objects, relative to their mean, so that the strength of the noise does
        not matter. A weighted sum of exponential variables is nearly a gamma variable with the same
        first three moments. Noise alone is taken for an object in one image of 1000.
        """
        if self.sigma == 0.0:
            return True
        rest = self.whitened(self.without_background())
        shape = rest.shape
        passed = 1.0 if model is None else passed_power(model)
        if not self.fit_background:  # even light is an object then
            strength = float(rest.mean()) * math.sqrt(rest.size) / self.sigma
            if 0.5 * math.erfc(strength / math.sqrt(2.0)) < 1e-3:
                return False
        kinds = [passed * object_power(shape) ** half for half in (0.0, 0.5, 1.0)]
        chances = [_chance(power(rest), kind, shape) for kind in kinds]
        return len(kinds) * min(chances) > 1e-3

    def like_input(self, values: Array) -> Any:
        """Convert a result to the input's kind: array, or tensor of the same type and device."""
        if self.template is None:
            return as_numpy(values).astype(np.float64)
        import torch

        dtype = self.template.dtype if self.template.is_floating_point() else torch.float32
        return torch.as_tensor(values).detach().to(device=self.template.device, dtype=dtype)


def _chance(spectrum: Array, weights: Array, shape: tuple[int, ...]) -> float:
    """Return the probability that white noise has this weighted sum of power, or more.

    ``spectrum`` and ``weights`` are half spectra. The noise's power is the mean of the spectrum.
    """
    twice = half_weights(shape)
    count, whole = float(twice.sum()), float((twice * spectrum).sum())
    weights = weights - float((twice * weights).sum()) / max(count, 1.0)
    weights = weights / max(float(np.abs(weights).max()), 1e-300)
    squares, cubes = (float((twice * weights**k).sum()) for k in (2, 3))
    if whole == 0.0 or min(squares, cubes) <= 1e-9:  # all frequencies weigh the same
        return 1.0
    variance, third = 2.0 * squares, 8.0 * cubes
    freedom = 4.0 * variance**3 / third**2
    deviation = float((twice * weights * spectrum).sum()) * count / whole / math.sqrt(variance)
    value = max(freedom + deviation * math.sqrt(freedom), 0.0)
    return float(special.gammaincc(freedom, value))


def noisy_image(
    image: Any, model: ForwardModel | tuple[int, int], *, measured_scale: bool = True
) -> NoisyImage:
    """Check a `Measurement` of one image, or an image alone, against an image model.

    ``model`` may be the shape (H, W) if the point spread is unknown; the noise is then estimated
    without it, and no bad pixels are sought. Saturated pixels are those that the measurement
    states, by default the `clipped_pixels`. ``measured_scale``: whether the noise of the image sets
    the scale of a stated noise; if not, the stated one is also meant to cover errors of the model.
    """
    given = measured(image)
    shape, passed = (
        (model, None) if isinstance(model, tuple) else (model_shape(model), passed_power(model))
    )
    masked, full = _mask("masked", given.masked, shape), _mask("saturated", given.saturated, shape)
    masked = masked & ~full
    data = _picture("image", given.image, shape, masked)
    stated = _stated_noise(given.noise_sigma, shape, masked)
    valid = ~masked & np.isfinite(stated)
    if full.any():
        full = full if passed is None else lit_pixels(data, passed, ~masked, full)
        valid &= ~_mask("saturated", given.saturated, shape)
    elif passed is not None and given.saturated is None and valid.any():
        full = clipped_pixels(data, passed, valid, float(stated[valid].max()) or math.inf)
        valid &= ~full
    background = given.background
    if shape_of("background", background):
        background = _picture("background", background, shape, ~valid)
    else:
        background = real("background", background)
    data = data - background
    if not valid.any():
        raise SceneError(
            "every pixel is masked, saturated or of infinite noise, so that none counts; expose "
            "shorter"
        )
    least = np.where(full, data, -np.inf) if full.any() else None
    data = surrounded(data, ~valid)
    noise, bad = pixel_noise(data, passed, ~valid, stated, measured_scale)
    if not noise.any() and float(data.max()) > float(data.min()):
        raise SceneError(
            "the estimated noise of the image is 0 although it is not uniform; give noise_sigma"
        )
    valid &= ~bad
    data, sigma, weights = _weighed(data, noise, valid)
    bad = bad | full
    return NoisyImage(
        data=data,
        sigma=sigma,
        weights=weights,
        fit_background=given.fit_background,
        background_shape=_background_shape(given.background_shape, shape),
        template=given.image if is_tensor(given.image) else None,
        bad_pixels=bad if bad.any() else None,
        saturated=full if full.any() else None,
        least=least,
    )


def _stated_noise(value: Any, shape: tuple[int, int], masked: Mask) -> Array:
    """Return the noise of each pixel that the caller states, (H, W); 0 if it is unknown."""
    if value is None:
        return np.zeros(shape)
    remedy = "give None to have it estimated"
    if not shape_of("noise_sigma", value):
        return np.full(shape, positive("noise_sigma", value, remedy=remedy))
    sigmas = np.where(masked, np.inf, _picture("noise_sigma", value, shape, masked, infinite=True))
    if math.isinf(sigmas.min()):
        raise SceneError(
            "noise_sigma is infinite in every pixel, so that none counts; give finite noise "
            "for the valid pixels"
        )
    positive("noise_sigma", float(sigmas.min()), remedy=remedy)
    return sigmas


def _weighed(data: Array, noise: Array, valid: Mask) -> tuple[Array, float, Array]:
    """Return image, reference noise and weights, as in `NoisyImage`, for the noise of each pixel.

    ``valid`` (H, W) are the pixels that count.
    """
    uniform = float(noise[valid].max())
    if uniform == float(noise[valid].min()) and (valid.all() or uniform == 0.0):
        return data, uniform, np.ones(data.shape)
    weights = np.divide(1.0, noise**2, out=np.zeros_like(noise), where=valid)
    sigma = (total(weights) / weights.size) ** -0.5
    weights = weights * sigma**2
    # an excluded pixel must not affect the range of the image
    data = np.where(valid, data, total(weights * data) / weights.size)
    return data, sigma, weights


def _background_shape(value: Any, shape: tuple[int, int]) -> Array:
    if value is None:
        return np.ones(shape)
    picture = _picture("background_shape", value, shape)
    mean = total(picture) / picture.size
    if float(picture.min()) < 0.0 or mean <= 0.0:
        raise SceneError(
            f"background_shape spans {float(picture.min()):g} to {float(picture.max()):g}, must be "
            "non-negative with some light; leave it out for a uniform background"
        )
    return picture / mean


def _mask(name: str, value: Any, shape: tuple[int, int]) -> Mask:
    """Return a mask of pixels; no pixel if it is None."""
    if value is None:
        return np.zeros(shape, dtype=bool)
    masked = as_numpy(value)
    check_shape(name, masked, shape, "like the image; give one value for each pixel")
    if masked.all():
        raise SceneError(f"{name} is True in every pixel, so that none counts; leave some out")
    return masked


def _picture(
    name: str,
    value: Any,
    shape: tuple[int, int],
    masked: Mask | bool = False,
    *,
    infinite: bool = False,
) -> Array:
    picture = real_array(name, value)
    check_shape(name, picture, shape)
    ignored = masked | (picture == np.inf) if infinite else masked
    check_finite(name, picture, "mark bad pixels by Measurement(..., masked=...)", ignored)
    squarable(name, float(np.abs(picture[~ignored]).max(initial=0.0)))
    return picture
