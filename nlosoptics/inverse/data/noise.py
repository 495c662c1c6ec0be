"""Noise of an image, estimated from its pixels, and the pixels that are not noise but faulty."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage

from ..._checks import squarable
from ...errors import SamplingError
from ...imaging.forward_model import ForwardModel
from .arrays import check_finite, check_shape, real_array
from .models import (
    beyond_optics,
    expected_signal,
    half_weights,
    model_shape,
    noise_share,
    passed_power,
    periodic_spectrum,
    squared,
)
from .outliers import lone_pixels, noise_of_neighbours, predicted

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Width of the window in which masked pixels get their value, pixels; least weight of valid ones.
_AROUND, _LEAST_AROUND = 1.5, 1e-3
_LEAST_SIDE = 3  # pixels along each side of an image


def estimate_noise(image: ArrayLike | Any, model: ForwardModel | None = None) -> float:
    """Estimate the rms noise of an image from its pixels.

    The noise must be uncorrelated between pixels. Its strength may vary over the image.

    Parameters
    ----------
    image : array_like or Tensor
        Image, (H, W), at least 3 x 3 pixels.
    model : ForwardModel, optional
        Image model of shape (H, W): the convolution with the known point spread function (PSF). If
        given, the noise is measured at those spatial frequencies that the PSF does not transmit, if
        there are enough of them.

    Returns
    -------
    float
        Rms noise in the unit of the image; 0 for a uniform image or one with identical rows or
        columns.

    See Also
    --------
    tv_deconvolve : Non-negative deconvolution with total variation.
    nlosoptics.imaging.CameraImage : Corrected camera image with its masked pixels.

    Notes
    -----
    Without a model, second differences of the image along both axes are taken [1]_, in which a
    smooth image nearly vanishes and noise remains. The noise follows from the median of their
    magnitudes [2]_ in blocks of about 12 x 12 pixels, whose squares are averaged; a block whose
    median is zero contributes its rms value instead. For uniform noise the result is 2 % too high,
    with a relative standard deviation of 2/sqrt(number of pixels). Fine detail of a sharp image
    increases it: by up to 35 % for images of 64 x 64 pixels with 0.5 % noise.

    With a model, the noise is measured at spatial frequencies f at which the image contains almost
    nothing else: where the power of the image of a typical object, 1/f^2 times the squared modulus
    of the transfer function, scaled to the image's variance, is below 5 % of the noise's. For n
    frequencies the relative standard error is 1/sqrt(2 n). If fewer than 500 are found, the result
    by second differences is returned. Differences between opposite edges of the image are removed
    first, because they would spread over all frequencies [3]_; if a Hann window shows less noise by
    more than 10 %, its result is taken. Dead, hot and clipped pixels are
    replaced by predictions first.

    References
    ----------
    .. [1] Immerkaer, Computer Vision and Image Understanding 64 (1996) 300.
    .. [2] Donoho and Johnstone, Biometrika 81 (1994) 425.
    .. [3] Moisan, J. Math. Imaging Vis. 39 (2011) 161.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import estimate_noise
    >>> image = 100.0 + np.random.default_rng(0).normal(0.0, 3.0, size=(256, 256))
    >>> round(estimate_noise(image), 1)
    3.1
    """
    values = real_array("image", image)
    _check_side(values.shape)
    check_finite("image", values, "replace bad pixels by their neighbours")
    squarable("image", float(np.abs(values).max()))
    if model is None:
        return noise_of_neighbours(values)
    check_shape("image", values, model_shape(model))
    passed, none = passed_power(model), np.zeros(values.shape, dtype=bool)
    masked = clipped_pixels(values, passed, ~none)
    return float(pixel_noise(surrounded(values, masked), passed, masked)[0].max())


def _noise_beyond(image: Array, passed: Array, first: float, filled: Mask) -> tuple[float, bool]:
    """Return the rms noise from the frequencies that show no object, and whether it is sure.

    ``first`` is an estimate, which is returned if there are too few such frequencies. The result is
    sure if the optics pass less than 1 % of the power there, so that no object shows. Pixels that
    are ``filled`` hold predictions.

    Light that the frame cuts off spreads over all frequencies; of it `periodic_spectrum` leaves the
    part from bent edges. A Hann window leaves hardly any, but sees the middle of the frame only; it
    counts if its noise is less by more than 10 %, two of its standard errors.
    """
    window = np.multiply.outer(*(np.hanning(length + 2)[1:-1] for length in image.shape))
    window, mean = window / math.sqrt((window**2).mean()), np.average(image, weights=window)
    first /= math.sqrt(1.0 - filled.mean())
    share = noise_share(image.shape)
    spectrum = periodic_spectrum(image)
    whole = _dark_rms(spectrum, passed, share, first, filled, np.ones(image.shape))
    middle = fft.rfft2((image - mean) * window)
    apart = _dark_rms(middle, passed, np.ones_like(share), first, filled, window**2)
    return apart if apart[0] < 0.9 * whole[0] else whole


def _dark_rms(
    spectrum: NDArray[np.complex128],
    passed: Array,
    share: Array,
    first: float,
    filled: Mask,
    weights: Array,
) -> tuple[float, bool]:
    """Return what `_noise_beyond` does, for a spectrum in which noise has a share of power.

    Filled pixels get the values that make the power beyond the optics least. As each parameter of a
    least-squares fit, each of them takes the noise of one frequency.
    """
    # frequencies: a relative standard error of 3 %, that of 64 x 64 differences; 7 % if filled
    # pixels spoil these
    least = 100 if filled.any() else 500
    twice, sigma, shape = half_weights(filled.shape), first, filled.shape
    image_power = least_power = squared(spectrum) / filled.size
    for _ in range(3):  # the frequencies depend on the noise; three rounds change it below 1 %
        signal = expected_signal(image_power, passed, sigma**2, shape)
        beyond = beyond_optics(signal, sigma**2) & (twice > 0.0)
        if filled.any():
            change = predicted(np.zeros(shape), filled, spectrum, beyond.astype(np.float64))
            least_power = squared(spectrum + fft.rfft2(change)) / filled.size
        whole = float((twice * share)[beyond].sum())
        left = whole - float(weights[filled].sum())  # they take as much of the object's detail
        variance = float((twice * least_power)[beyond].sum()) / max(left, 1.0)
        variance -= float((twice * signal)[beyond].sum()) / max(whole, 1.0)
        if left < least or variance <= 0.0:
            return first, False
        sigma = math.sqrt(variance)
    dark = beyond & (passed < 0.01 * float(passed.max()))
    return sigma, float(twice[dark].sum()) >= 500


def pixel_noise(
    image: Array,
    passed: Array | None,
    masked: Mask,
    stated: Array | float = 0.0,
    measured_scale: bool = True,
) -> tuple[Array, Mask]:
    """Return the rms noise of each pixel, (H, W), and the mask of dead and hot pixels.

    ``stated`` (H, W) is the noise that the caller states, which gives the shape, and is 0 if
    unknown. With ``measured_scale`` the image gives the scale: its frequencies beyond the optics'
    cut-off. With too few of them the estimate is an upper bound, to which detail adds. ``passed``
    is the squared modulus of the transfer function; None if it is unknown, so that no bad pixels
    are sought. Pixels that are ``masked`` hold means of the others around them, which have hardly
    any noise. An image with less noise than 1e-6 of its range is no camera's.
    """
    bad, stated = np.zeros(image.shape, dtype=bool), np.broadcast_to(stated, image.shape)
    mean = math.sqrt(float((stated[~masked] ** 2).mean()))
    if mean > 0.0 and min(image.shape) < _LEAST_SIDE:
        return stated, bad
    _check_side(image.shape)
    sigma, sure = noise_of_neighbours(image), False
    if passed is not None:
        bad, filled = lone_pixels(image, passed, sigma, stated, masked=masked)
        if masked.any() or bad.any():
            sigma = noise_of_neighbours(filled)
        if sigma > 0.0:
            sigma, sure = _noise_beyond(filled, passed, sigma, bad | masked)
    if mean == 0.0:
        return np.full(image.shape, sigma), bad
    if not measured_scale or sigma <= 1e-6 * float(np.ptp(image)):
        return stated, bad
    return stated * (sigma / mean if sure else min(sigma / mean, 1.0)), bad


def surrounded(values: Array, masked: Mask) -> Array:
    """Return an image in which masked pixels hold the weighted mean of the others around them."""
    if not masked.any():
        return values
    valid = ndimage.gaussian_filter((~masked).astype(np.float64), _AROUND)
    sums = ndimage.gaussian_filter(np.where(masked, 0.0, values), _AROUND)
    mean = float(values[~masked].mean())
    around = np.where(valid > _LEAST_AROUND, sums / np.maximum(valid, _LEAST_AROUND), mean)
    return np.where(masked, around, values)


def clipped_pixels(image: Array, passed: Array, valid: Mask, most: float = math.inf) -> Mask:
    """Return the mask of the pixels that a converter has clipped after all noise.

    These are the pixels of the largest value, if there are more than three for each one of the
    second largest value. Without noise of at least 0.6 of the converter's steps, an object that is
    bright and even has equal pixels too, and none is taken as clipped. ``most`` is the largest
    stated noise. Hot pixels often have the largest value as well, but deviate alone, which hardly
    any clipped pixel does.
    """
    low, top = float(image[valid].min()), float(image[valid].max())
    full = valid & (image == top)
    levels = np.unique(image[valid & (image >= 0.5 * (top + low))])
    n_full, none = int(np.count_nonzero(full)), np.zeros(image.shape, dtype=bool)
    if len(levels) < 2 or n_full < 3 + 3 * np.count_nonzero(valid & (image == levels[-2])):
        return none
    sigma = min(noise_of_neighbours(surrounded(image, full | ~valid)), most)
    if sigma < max(0.6 * float(np.diff(levels).min()), 1e-6 * (top - low)):
        return none
    lit = lit_pixels(image, passed, valid, full)
    return lit if 2 * np.count_nonzero(lit) >= n_full else none


def lit_pixels(image: Array, passed: Array, valid: Mask, full: Mask) -> Mask:
    """Return those of the ``full`` pixels that are not hot, which deviate alone."""
    filled = surrounded(image, ~valid)
    alone, _ = lone_pixels(filled, passed, noise_of_neighbours(filled), masked=~valid)
    return full & ~alone


def _check_side(shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or min(shape) < _LEAST_SIDE:
        raise SamplingError(
            f"image has shape {shape}, noise needs at least {_LEAST_SIDE} x {_LEAST_SIDE} pixels; "
            "give noise_sigma"
        )
