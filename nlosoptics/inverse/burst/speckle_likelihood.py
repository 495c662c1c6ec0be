"""Likelihood of an object, given images of it through independent, unknown speckle patterns.

An image is ``y_k = o * [e (1 + s_k)] + noise``, with the object o of unit sum, the smooth mean
point spread e and the relative speckle s_k. Where e hardly changes over the object's size, the
fluctuation ``(y_k - m)/m`` about the mean image m is ``o * s_k``, stationary, and the unknown
patterns are integrated out: only their spectra of second and third order are needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ..data.arrays import half_spectrum_weights
from ..data.models import squared

Array = NDArray[np.float64]


def speckle_power(
    shape: tuple[int, int], cutoff: float, *, pixel_integrated: bool, patterns: int
) -> Array:
    """Return the power spectrum of relative fully developed speckle, pixels squared, as ``rfft2``.

    It is the transfer function of the clear pupil (the pupil's autocorrelation), times the area of
    one speckle, that of the pupil's inverse (Goodman, Speckle Phenomena in Optics, 2nd ed.,
    sec. 4.4). ``cutoff`` of the intensity is in cycles per pixel, twice the pupil's radius.
    """
    y, x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
    r = np.minimum(np.hypot(y, x) / cutoff, 1.0)
    overlap = 2.0 / math.pi * (np.arccos(r) - r * np.sqrt(1.0 - r * r))
    if pixel_integrated:
        overlap = overlap * (np.sinc(y) * np.sinc(x)) ** 2
    return np.asarray(overlap * (4.0 / (math.pi * cutoff**2 * patterns)))


@dataclass(frozen=True, eq=False, kw_only=True)
class BurstLikelihood:
    """Log-likelihood of an object on the pixels of the images, to third order of their cumulants.

    The power of each frequency is exponentially distributed about its model (Whittle). The phases
    follow from the third cumulant, by Edgeworth's expansion: speckle is skewed, and its Wiener
    estimate is most skewed for the right phases. The bispectrum of speckle, an overlap of three
    pupils, is taken as the product of three roots of its power spectrum, exact to first order.
    """

    waves: NDArray[np.complex128]  # (K, H, W//2 + 1); ``rfft2`` of the scaled fluctuations
    power: Array  # (H, W//2 + 1); their mean power per pixel
    speckle: Array  # (H, W//2 + 1); power spectrum of the speckle, pixels squared
    noise: float  # power of the noise
    lags: Array  # (H, W); autocorrelation of the window, 1 at shift 0
    used: NDArray[np.bool_]  # (H, W//2 + 1); frequencies at which the model holds
    share: float  # effective number of pixels in the window over that of the frame
    skewness: float  # third cumulant of the speckle in one pixel, its variance being 1

    @classmethod
    def of(
        cls,
        images: Array,
        speckle: Array,
        cutoff: float,
        *,
        edge: float = 1.0 / 8.0,
        low: float = 4.0,
        smooth: float = 1.0 / 20.0,
        dark: float = 0.1,
    ) -> BurstLikelihood:
        """Reduce images (K, H, W) to their fluctuations.

        ``speckle``, ``cutoff``: as of `speckle_power`. ``edge``, ``smooth``: widths of the window's
        edges and of the Gaussian that makes the envelope from the mean image, over the frame's
        side. ``low``: frequency, cycles per frame, from which the model holds; facets of a wall add
        to the power of speckle below it. ``dark``: envelope over its maximum at which the window
        falls to a half.
        """
        count, rows, columns = images.shape
        mean = images.mean(axis=0)
        envelope = ndimage.gaussian_filter(mean, (smooth * rows, smooth * columns), mode="nearest")
        brightest = float(envelope.max())
        envelope = np.maximum(envelope / brightest, 0.1 * dark)
        window = np.multiply.outer(*(_taper(n, edge * n) for n in (rows, columns)))
        window *= envelope**2 / (envelope**2 + dark**2)
        squares, cubes, fourths = (float((window**p).mean()) for p in (2, 3, 4))
        # The mean image contains 1/K of each, so that differences have smaller cumulants.
        variance = squares * (1.0 - 1.0 / count)
        scaled = (images - mean) * window / (envelope * brightest * math.sqrt(variance))
        waves = np.asarray(fft.rfft2(scaled))
        power = squared(waves).mean(axis=0) / mean.size
        y, x = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)
        beyond = np.hypot(y, x) > cutoff
        twice = np.broadcast_to(half_spectrum_weights(columns), power.shape)
        lags = fft.ifft2(squared(fft.fft2(window, (2 * rows, 2 * columns)))).real
        near = (np.r_[: n - n // 2, 2 * n - n // 2 : 2 * n] for n in (rows, columns))
        skewness = cubes / squares**1.5 * (1.0 - 2.0 / count) / math.sqrt(1.0 - 1.0 / count)
        return cls(
            waves=waves,
            power=power,
            speckle=speckle,
            noise=float((power * twice)[beyond].sum() / twice[beyond].sum()),
            lags=np.asarray(lags[np.ix_(*near)] / lags[0, 0]),
            used=(np.hypot(y * rows, x * columns) >= low) & ~beyond,
            share=squares**2 / fourths,
            # 2 for the exponential distribution, for one pattern; sqrt of the area: see `third`
            skewness=2.0 * math.sqrt(float(speckle[0, 0])) * skewness,
        )

    def spectrum(self, waves: NDArray[np.complex128]) -> Array:
        """Return the model of `power` for an object's ``rfft2``."""
        return np.maximum(self.smoothed(self.speckle * squared(waves)), 0.0) + self.noise

    def smoothed(self, power: Array) -> Array:
        """Return a power spectrum (H, W//2 + 1) as the window smooths it."""
        return np.asarray(fft.rfft2(fft.irfft2(power, self.lags.shape) * self.lags).real)

    def second(self, waves: NDArray[np.complex128]) -> tuple[float, Array]:
        """Return the log-likelihood of the power, and its gradient with respect to the object."""
        model = self.spectrum(waves)
        weight = 0.5 * len(self.waves) * self.share * self.used
        twice = half_spectrum_weights(self.lags.shape[1])
        value = -float((twice * weight * (np.log(model) + self.power / model)).sum())
        slope = weight * (self.power / model - 1.0) / model
        slope = 2.0 * self.lags.size * self.smoothed(slope) * self.speckle
        return value, fft.irfft2(slope * waves, self.lags.shape)

    def third(self, waves: NDArray[np.complex128], model: Array) -> tuple[float, Array]:
        """Return the term of third order, and its gradient, for a given model of the power.

        With g the object's image of one unit of the speckle's white source, and w the image over
        the model's covariance C, it is ``c/6 sum (g w)^3 - c^2/12 sum (g C^-1 g)^3`` (McCullagh,
        Tensor Methods in Statistics, sec. 5.4), c the `skewness` and sums over all shifts.
        """
        shape = (self.lags.shape[0], self.lags.shape[1])
        root = np.sqrt(self.speckle) * self.used
        filters = root / model
        cubes, slope = 0.0, np.zeros(waves.shape, dtype=np.complex128)
        for image in self.waves:
            estimate = fft.irfft2(np.conj(waves) * filters * image, shape)
            square = estimate * estimate
            cubes += float((square * estimate).sum())
            slope += image * np.conj(fft.rfft2(square))
        response = fft.irfft2(root * filters * squared(waves), shape)
        square = response * response
        first = self.share * self.skewness / 6.0
        last = self.share * self.skewness**2 / 12.0 * len(self.waves) * self.lags.size
        slope = 3.0 * first * filters * slope
        slope -= 6.0 * last * root * filters * waves * fft.rfft2(square).real
        value = first * cubes - last * float((square * response).sum())
        return value, fft.irfft2(slope, shape)

    def cumulants(self, waves: NDArray[np.complex128]) -> tuple[float, float]:
        """Return the third cumulant of the images for an object's ``rfft2``, and its expectation.

        Both are in nats: the first part of the value of `third`, and twice its second part.
        """
        model = self.spectrum(waves)
        value, _ = self.third(waves, model)
        double, _ = self.third(2.0 * waves, model)
        # value = a - b, double = 8 a - 64 b
        last = (8.0 * value - double) / 56.0
        return value + last, 2.0 * last

    def frequencies(self, waves: NDArray[np.complex128]) -> float:
        """Return the number of frequencies, of a half plane, at which speckle exceeds the noise."""
        return float(np.count_nonzero((self.spectrum(waves) > 2.0 * self.noise) & self.used))


def _taper(length: int, edge: float) -> Array:
    """Return a window (length,) that rises as a squared sine over ``edge`` pixels at both ends."""
    place = np.minimum(np.arange(length), np.arange(length)[::-1]) + 0.5
    return np.asarray(np.sin(0.5 * math.pi * np.minimum(place / edge, 1.0)) ** 2)
