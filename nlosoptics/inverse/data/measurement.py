"""Checked image data with their noise, the input of every solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..._checks import positive, real
from ...errors import SamplingError, SceneError

# Standard normal quantile at 3/4: median of |x| over sigma.
_MEDIAN_OVER_SIGMA = 0.6744897501960817
_BLOCK = 12
# Noise below this part of the image's range is near float32's rounding in the transforms.
_FLOAT32_NOISE = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Measurement:
    """Image with its known background subtracted, and its noise.

    Parameters
    ----------
    data : Tensor, (H, W)
        Image minus the known background, float64. Excluded pixels hold the weighted mean.
    sigma : float
        Reference noise: 1/sigma^2 is the mean of 1/noise_sigma^2 over the pixels.
    weights : Tensor or None, (H, W)
        (sigma/noise_sigma)^2, mean 1; None for uniform noise. Excluded pixels, which have infinite
        noise, have weight 0.
    sigma_estimated : bool
        Whether the noise was estimated from the image.
    fit_background : bool
        Whether there is a further background of unknown strength.
    background_shape : Tensor or None, (H, W)
        Shape of that background, mean 1; None if it is uniform.
    template : Tensor or None
        The image as given if it was a tensor; None for an array.
    """

    data: Tensor
    sigma: float
    weights: Tensor | None
    sigma_estimated: bool
    fit_background: bool
    background_shape: Tensor | None
    template: Tensor | None

    @property
    def counted(self) -> int:
        """Number of pixels with finite noise; the others are excluded from fits."""
        if self.weights is None:
            return self.data.numel()
        return int(torch.count_nonzero(self.weights))

    def noise_power(self) -> float:
        """Return the expected sum of squares of noise and of excluded pixels, over all pixels.

        An excluded pixel holds the mean of the others. Its error has the variance of the image
        itself.
        """
        if self.weights is None:
            return self.sigma**2 * self.data.numel()
        counts = self.weights > 0.0
        values = self.data[counts]
        missing = self.data.numel() - values.numel()
        noise = self.sigma**2 * total((1.0 / self.weights[counts])[None])
        return noise + missing * float(values.var(correction=0))

    def weighted(self, values: Tensor) -> Tensor:
        """Return values (H, W) times the pixel weights."""
        return values if self.weights is None else values * self.weights

    def weighted_mean(self, values: Tensor) -> float:
        """Return the mean of values (H, W) with the pixel weights, which have mean 1."""
        return total(self.weighted(values)) / values.numel()

    def background_strength(self, values: Tensor) -> float:
        """Return the best-fitting strength of the unknown background; 0 if it is known."""
        if not self.fit_background:
            return 0.0
        shape = self.background_shape
        if shape is None:
            return self.weighted_mean(values)
        return total(self.weighted(shape * values)) / total(self.weighted(shape * shape))

    def background(self, strength: float) -> Tensor | float:
        """Return the unknown background for a given strength, which is its mean over the image."""
        return strength if self.background_shape is None else strength * self.background_shape

    def border_strength(self) -> float:
        """Return the strength of the unknown background at the image's border; 0 if it is known."""
        if not self.fit_background:
            return 0.0
        values = _border(self.data)
        if self.background_shape is None:
            return float(values.median())
        shape = _border(self.background_shape)
        lit = shape > 0.5
        return float((values[lit] / shape[lit]).median()) if bool(lit.any()) else 0.0

    def span(self) -> float:
        """Return the brightest minus the darkest pixel, at least the noise."""
        return max(float(self.data.max()) - float(self.data.min()), self.sigma)

    def working_dtype(self) -> torch.dtype:
        """Return float32, or float64 if the noise is close to rounding errors of float32 FFTs."""
        return torch.float32 if self.sigma > _FLOAT32_NOISE * self.span() else torch.float64

    def score(self, explained: Tensor | float) -> float:
        """Return the weighted rms of data minus ``explained``, divided by the noise."""
        residual = self.data - explained
        rms = math.sqrt(total(self.weighted(residual * residual)) / self.counted)
        return rms / self.sigma if self.sigma > 0.0 else rms

    def is_background(self) -> bool:
        """Return whether the background alone explains the data within three standard errors."""
        return self.is_noise_about(self.background(self.background_strength(self.data)))

    def is_noise_about(self, explained: Tensor | float) -> bool:
        """Return whether data minus ``explained`` is noise, within three standard errors.

        The mean of n squared residuals has variance 2/n; an estimated noise adds 16/n, the measured
        spread of `estimate_noise` (2/sqrt(n) relative, in sigma).
        """
        if self.sigma == 0.0:
            return True
        variance = (18.0 if self.sigma_estimated else 2.0) / self.counted
        return self.score(explained) ** 2 <= 1.0 + 3.0 * math.sqrt(variance)

    def like_input(self, values: Tensor) -> Any:
        """Convert a result to the input's kind: array, or tensor of the same type and device."""
        if self.template is None:
            return values.detach().to(device="cpu", dtype=torch.float64).numpy()
        dtype = self.template.dtype if self.template.is_floating_point() else torch.float32
        return values.detach().to(device=self.template.device, dtype=dtype)


def total(values: Tensor) -> float:
    """Return the sum of an image in double precision.

    Rows are summed first, so that the result has the same bits for any number of threads.
    """
    return float(values.sum(dim=-1, dtype=torch.float64).sum())


def measurement(
    image: Any,
    shape: tuple[int, int],
    *,
    noise_sigma: Any,
    background: Any,
    fit_background: bool,
    background_shape: Any,
) -> Measurement:
    """Check an image against a model's shape (H, W), and return it with its noise.

    The keyword arguments are those of the solvers, for example `tv_deconvolve`.
    """
    template = image if isinstance(image, Tensor) else None
    device = torch.device("cpu") if template is None else template.device
    data = _picture("image", image, shape, device)
    if not shape_of("background", background):
        data = data - real("background", background)
    else:
        data = data - _picture("background", background, shape, device)
    weights = None
    if noise_sigma is None:
        sigma = estimate_noise(data.cpu().numpy())
        if sigma == 0.0 and float(data.max()) > float(data.min()):
            raise SceneError(
                "the estimated noise of the image is 0 although it is not uniform; give noise_sigma"
            )
    elif not shape_of("noise_sigma", noise_sigma):
        sigma = _positive_sigma(noise_sigma)
    else:
        sigmas = _picture("noise_sigma", noise_sigma, shape, device, infinite=True)
        least = float(sigmas.min())
        if math.isinf(least):
            raise SceneError(
                "noise_sigma is infinite in every pixel, so that none counts; give finite noise "
                "for the valid pixels"
            )
        _positive_sigma(least)
        weights = sigmas.pow(-2)
        sigma = (total(weights) / weights.numel()) ** -0.5
        weights = weights * sigma**2
        # an excluded pixel must not affect the range of the image
        mean = total(weights * data) / weights.numel()
        data = torch.where(weights > 0.0, data, torch.full_like(data, mean))
    return Measurement(
        data=data,
        sigma=sigma,
        weights=weights,
        sigma_estimated=noise_sigma is None,
        fit_background=fit_background,
        background_shape=_background_shape(background_shape, shape, device),
        template=template,
    )


def real_array(name: str, value: Any) -> NDArray[np.float64]:
    """Return an array, a tensor or nested sequences as a float64 array.

    Parameters
    ----------
    name : str
        Name of the argument in error messages.
    value : array_like or Tensor
        Real numbers.

    Raises
    ------
    SceneError
        If values are not real numbers, or rows differ in length.
    """
    try:
        if isinstance(value, Tensor):
            if value.is_complex():
                raise TypeError
            return value.detach().to(device="cpu", dtype=torch.float64).numpy()
        if np.iscomplexobj(value):
            raise TypeError
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(
            f"{name} of type {type(value).__name__} is not an array of real numbers; "
            "give an array or a tensor"
        ) from None


def shape_of(name: str, value: Any) -> tuple[int, ...]:
    """Return the shape of a number, an array, a tensor or nested sequences.

    Parameters
    ----------
    name : str
        Name of the argument in error messages.
    value : array_like or Tensor
        Value to examine.

    Raises
    ------
    SceneError
        If rows differ in length.
    """
    try:
        return tuple(np.shape(value))
    except ValueError:
        raise SceneError(
            f"{name} of type {type(value).__name__} has rows that differ in shape; "
            "give an array or a tensor"
        ) from None


def estimate_noise(image: ArrayLike) -> float:
    """Estimate the rms noise of an image, assuming that it is white within about 12 pixels.

    Parameters
    ----------
    image : array_like or Tensor
        Image, (H, W), at least 3 x 3 pixels.

    Returns
    -------
    float
        Rms noise in image units; 0 for a uniform image or one with identical rows or columns.

    Raises
    ------
    SamplingError
        If the array is not a single image of at least 3 x 3 pixels.
    SceneError
        If a value is not finite or not a real number.

    See Also
    --------
    tv_deconvolve : Non-negative, with total variation.
    nlosoptics.imaging.CameraImage : Corrected camera image with its noise.

    Notes
    -----
    The estimate is the median absolute response to a second difference along both axes [1]_ [2]_,
    on which smooth images and a few edges have little effect. It is taken in blocks of about 12
    pixels, because signal-dependent noise would otherwise be underestimated, and the squares are
    averaged. A block with zero median, for example a dark region with few counts, contributes its
    rms response instead. For white noise the result is 2 % too high, with a relative spread of
    2/sqrt(pixels).

    References
    ----------
    .. [1] Immerkaer, Computer Vision and Image Understanding 64 (1996) 300.
    .. [2] Donoho and Johnstone, Biometrika 81 (1994) 425.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import estimate_noise
    >>> image = 100.0 + np.random.default_rng(0).normal(0.0, 3.0, size=(256, 256))
    >>> round(estimate_noise(image), 1)
    3.1
    """
    values = real_array("image", image)
    if values.ndim != 2 or min(values.shape) < 3:
        raise SamplingError(
            f"image has shape {values.shape}, noise needs at least 3 x 3 pixels; give noise_sigma"
        )
    if not np.isfinite(values).all():
        raise SceneError(
            f"image has {np.count_nonzero(~np.isfinite(values))} of {values.size} values that are "
            "not finite; replace bad pixels by their neighbours"
        )
    # The mask (1, -2, 1) x (1, -2, 1) has norm 6.
    response = np.abs(np.diff(np.diff(values, n=2, axis=0), n=2, axis=1)) / 6.0
    counts = [max(1, length // _BLOCK) for length in response.shape]
    sides = [length // count for length, count in zip(response.shape, counts, strict=True)]
    whole_blocks = response[: counts[0] * sides[0], : counts[1] * sides[1]]
    tiles = whole_blocks.reshape(counts[0], sides[0], counts[1], sides[1]).swapaxes(1, 2)
    blocks = tiles.reshape(counts[0] * counts[1], -1)
    medians = np.median(blocks, axis=1)
    squares = np.where(
        medians > 0.0, (medians / _MEDIAN_OVER_SIGMA) ** 2, (blocks * blocks).mean(axis=1)
    )
    return math.sqrt(float(squares.mean()))


def _background_shape(value: Any, shape: tuple[int, int], device: torch.device) -> Tensor | None:
    if value is None:
        return None
    picture = _picture("background_shape", value, shape, device)
    mean = total(picture) / picture.numel()
    if float(picture.min()) < 0.0 or mean <= 0.0:
        raise SceneError(
            f"background_shape spans {float(picture.min()):g} to {float(picture.max()):g}, must be "
            "non-negative with some light; leave it out for a uniform background"
        )
    return picture / mean


def _border(picture: Tensor) -> Tensor:
    return torch.cat((picture[0], picture[-1], picture[:, 0], picture[:, -1]))


def _positive_sigma(sigma: float) -> float:
    return positive("noise_sigma", sigma, remedy="give None to have it estimated")


def _picture(
    name: str, value: Any, shape: tuple[int, int], device: torch.device, *, infinite: bool = False
) -> Tensor:
    if isinstance(value, Tensor) and not value.is_complex():
        picture = value.detach().to(device=device, dtype=torch.float64)
    else:
        picture = torch.tensor(real_array(name, value), device=device)
    if tuple(picture.shape) != shape:
        raise SamplingError(
            f"{name} has shape {tuple(picture.shape)}, must be {shape} like the model; "
            "resample it or build the model for that shape"
        )
    good = torch.isfinite(picture)
    if infinite:
        good |= torch.isposinf(picture)
    n_bad = int((~good).sum())
    if n_bad:
        raise SceneError(
            f"{name} has {n_bad} of {picture.numel()} values that are not finite; "
            "replace bad pixels by their neighbours"
        )
    return picture
