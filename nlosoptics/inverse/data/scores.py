"""Similarity of a reconstruction and the truth, independent of the reconstruction's position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..._checks import positive, whole
from ...errors import SamplingError
from .arrays import check_finite, real_array
from .reconstruction import Reconstruction

Array = NDArray[np.float64]

# Half a window of structural similarity: 3.5 times 1.5 pixels.
_SSIM_EDGE = 5


def registered_correlation(
    reconstruction: Any, truth: Any, *, upsampling: int = 20, flip: bool = False
) -> float:
    """Return the Pearson correlation of a reconstruction with the truth at the best shift.

    Brightness, offset and position of the reconstruction do not matter. An image does not determine
    the position of the object, because a tilt of the wavefront shifts the image.

    Parameters
    ----------
    reconstruction : Reconstruction, ndarray or Tensor
        Reconstructed object, (H, W).
    truth : ndarray or Tensor
        True object, (H, W).
    upsampling : int
        Number of steps per pixel in which the shift is searched; 1 for whole pixels.
    flip : bool
        Whether to try the reconstruction turned by half a turn as well. Phase retrieval needs this,
        since an object and its turned copy have the same autocorrelation.

    Returns
    -------
    float
        Largest correlation over all shifts, 0 to 1; 0 if an image is uniform.

    Raises
    ------
    SamplingError
        If the shapes differ or are not two-dimensional.
    SceneError
        If a value is not finite or not a real number.

    See Also
    --------
    registered_scores : Also computes PSNR and SSIM.

    Notes
    -----
    Both images are treated as periodic. Their circular cross-correlation, after subtraction of the
    means and division by the product of the norms, is the Pearson correlation at each shift. Its
    mean over all shifts is 0, so that its largest value is not negative. The largest value among
    whole pixels is refined by a matrix Fourier transform with band-limited interpolation [1]_.

    References
    ----------
    .. [1] Guizar-Sicairos, Thurman and Fienup, Optics Letters 33 (2008) 156.

    Examples
    --------
    >>> import numpy as np
    import scipy  # its parts are loaded on first use
    >>> from nlosoptics.inverse import registered_correlation
    >>> truth = np.random.default_rng(0).random((16, 16))
    >>> round(registered_correlation(3.0 * np.roll(truth, (2, 5), (0, 1)) + 1.0, truth), 6)
    1.0
    """
    upsampling = whole("upsampling", upsampling)
    first, second = _pair(reconstruction, truth)
    norm = math.sqrt(float((first * first).sum()) * float((second * second).sum()))
    if norm == 0.0:
        return 0.0
    return _placed(first, second, upsampling, flip)[0] / norm


@dataclass(frozen=True)
class RegisteredScores:
    """Similarity of a reconstruction and the true object, after a fit of shift, scale and offset.

    Parameters
    ----------
    correlation : float
        Pearson correlation at the best shift, 0 to 1.
    psnr : float
        Peak signal-to-noise ratio, dB; infinite for identical images.
    ssim : float
        Mean structural similarity, at most 1.

    See Also
    --------
    registered_scores : Correlation, PSNR and SSIM with the truth.
    """

    correlation: float
    psnr: float
    ssim: float


def registered_scores(
    reconstruction: Any,
    truth: Any,
    *,
    upsampling: int = 20,
    flip: bool = False,
    data_range: float | None = None,
) -> RegisteredScores:
    """Return correlation, PSNR and SSIM of a reconstruction and the true object.

    The reconstruction is first registered: it is shifted, scaled and given an offset such that it
    fits the truth best.

    Parameters
    ----------
    reconstruction : Reconstruction, ndarray or Tensor
        Reconstructed object, (H, W), at least 11 x 11.
    truth, upsampling, flip
        See `registered_correlation`.
    data_range : float or None
        Range of values to which PSNR and SSIM refer, in the unit of the truth. None: the range of
        the truth.

    Returns
    -------
    RegisteredScores
        Correlation, peak signal-to-noise ratio (PSNR) and structural similarity (SSIM).

    See Also
    --------
    registered_correlation : Computes the correlation alone.

    Notes
    -----
    The shift is that of the largest correlation; the image is treated as periodic and interpolated
    within its band limit. Scale and offset are least-squares values. Structural similarity [1]_
    uses Gaussian windows with a standard deviation of 1.5 pixels, truncated at 5 pixels, population
    variances and the constants 0.01 and 0.03. It is averaged without the 5 pixels nearest to each
    edge.

    References
    ----------
    .. [1] Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Process. 13 (2004) 600.
    """
    upsampling = whole("upsampling", upsampling)
    first, second = _pair(reconstruction, truth)
    if min(first.shape) < 2 * _SSIM_EDGE + 1:
        raise SamplingError(
            f"images of {first.shape} pixels are too small for windows of 11 x 11; "
            "compare larger ones"
        )
    if data_range is None:
        data_range = float(np.ptp(second))
    peak = positive("data_range", data_range, remedy="give one for a uniform truth")
    _, moved = _placed(first, second, upsampling, flip)
    squares = float((moved * moved).sum())
    overlap = float((moved * second).sum())
    fitted = moved * (overlap / squares if squares > 0.0 else 0.0)
    norm = math.sqrt(squares * float((second * second).sum()))
    error = float(((fitted - second) ** 2).mean())
    return RegisteredScores(
        correlation=overlap / norm if norm > 0.0 else 0.0,
        psnr=10.0 * math.log10(peak**2 / error) if error > 0.0 else math.inf,
        ssim=_structural_similarity(fitted, second, float(real_array("truth", truth).mean()), peak),
    )


def _structural_similarity(first: Array, second: Array, offset: float, peak: float) -> float:
    """Return the mean SSIM of two mean-free images, whose common mean is ``offset``."""

    def local_mean(picture: Array) -> Array:
        smooth = ndimage.gaussian_filter(picture, 1.5, truncate=3.5)
        return smooth[_SSIM_EDGE:-_SSIM_EDGE, _SSIM_EDGE:-_SSIM_EDGE]

    means = local_mean(first), local_mean(second)
    spreads = [local_mean(p * p) - m * m for p, m in zip((first, second), means, strict=True)]
    common = local_mean(first * second) - means[0] * means[1]
    a, b = (m + offset for m in means)
    light, contrast = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    likeness = (2.0 * a * b + light) * (2.0 * common + contrast)
    return float((likeness / ((a * a + b * b + light) * (sum(spreads) + contrast))).mean())


def _placed(first: Array, second: Array, upsampling: int, flip: bool) -> tuple[float, Array]:
    """Shift the first image to its best match with the second.

    Returns the largest circular cross-correlation and the shifted image. If ``flip``, the image
    turned by half a turn is tried too.
    """
    best, moved = -math.inf, first
    for candidate in (first, first[::-1, ::-1])[: 2 if flip else 1]:
        height, shift = _highest_peak(candidate, second, upsampling)
        if height > best:
            best, moved = height, _shifted(candidate, shift)
    return best, moved


def _highest_peak(
    first: Array, second: Array, upsampling: int
) -> tuple[float, tuple[float, float]]:
    """Return the largest circular cross-correlation of two images and its shift (rows, columns)."""
    spectrum = np.conj(np.fft.fft2(first)) * np.fft.fft2(second)
    correlation = np.fft.ifft2(spectrum).real
    row, column = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    found = [(float(correlation[row, column]), (float(row), float(column)))]
    if upsampling > 1:
        found.append(_refined_peak(spectrum, (row, column), upsampling))
    return max(found, key=lambda one: one[0])


def _refined_peak(
    spectrum: Any, peak: tuple[Any, ...], upsampling: int
) -> tuple[float, tuple[float, float]]:
    """Search the peak of a cross-correlation in steps of 1/``upsampling`` pixel.

    ``spectrum`` is its 2-D FFT and ``peak`` the best whole shift. Returns value and shift.
    """
    steps = np.arange(-upsampling, upsampling + 1) / upsampling
    rows, columns = spectrum.shape
    row_shifts = peak[0] + steps
    column_shifts = peak[1] + steps
    by_row = np.exp(2j * np.pi * np.outer(row_shifts, np.fft.fftfreq(rows)))
    by_column = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(columns), column_shifts))
    values = (by_row @ spectrum @ by_column).real
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    shift = float(row_shifts[row]), float(column_shifts[column])
    return float(values[row, column]) / int(spectrum.size), shift


def _shifted(picture: Array, shift: tuple[float, float]) -> Array:
    """Shift an image by (rows, columns), periodically; fractions by its Fourier series."""
    if shift[0].is_integer() and shift[1].is_integer():
        return np.roll(picture, (int(shift[0]), int(shift[1])), (0, 1))
    ramp = [
        np.exp(-2j * np.pi * s * np.fft.fftfreq(n))
        for s, n in zip(shift, picture.shape, strict=True)
    ]
    return np.asarray(np.fft.ifft2(np.fft.fft2(picture) * ramp[0][:, None] * ramp[1]).real)


def _pair(reconstruction: Any, truth: Any) -> tuple[Array, Array]:
    """Return both images minus their means, checked to have the same shape."""
    if isinstance(reconstruction, Reconstruction):
        reconstruction = reconstruction.object
    first = _mean_free("reconstruction", reconstruction)
    second = _mean_free("truth", truth)
    if first.shape != second.shape:
        raise SamplingError(
            f"reconstruction has shape {first.shape} and truth {second.shape}; "
            "resample one to the other's pixels"
        )
    return first, second


def _mean_free(name: str, image: Any) -> Array:
    values = real_array(name, image)
    if values.ndim != 2 or not values.size:
        raise SamplingError(f"{name} has shape {values.shape}; give one image, (H, W)")
    check_finite(name, values, "replace them before comparing")
    centred: Array = values - values.mean()
    # Rounding errors of a uniform image must not count as structure.
    if np.abs(centred).max() <= 1e-14 * np.abs(values).max():
        centred[:] = 0.0
    return centred
