"""Correlation of a reconstruction with the truth, independent of its position."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import whole
from ...errors import SamplingError
from .arrays import check_finite, real_array
from .reconstruction import Reconstruction

Array = NDArray[np.float64]


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

    See Also
    --------
    Reconstruction : Result of every solver.

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
    >>> from nlosoptics.inverse import registered_correlation
    >>> truth = np.random.default_rng(0).random((16, 16))
    >>> round(registered_correlation(3.0 * np.roll(truth, (2, 5), (0, 1)) + 1.0, truth), 6)
    1.0
    """
    upsampling = whole("upsampling", upsampling)
    first, second = _mean_free("reconstruction", reconstruction), _mean_free("truth", truth)
    if first.shape != second.shape:
        raise SamplingError(
            f"reconstruction has shape {first.shape} and truth {second.shape}; "
            "resample one to the other's pixels"
        )
    norm = math.sqrt(float((first * first).sum()) * float((second * second).sum()))
    if norm == 0.0:
        return 0.0
    turns = (first, first[::-1, ::-1]) if flip else (first,)
    return max(_highest_peak(turned, second, upsampling) for turned in turns) / norm


def _highest_peak(first: Array, second: Array, upsampling: int) -> float:
    """Return the largest circular cross-correlation, at shifts of 1/``upsampling`` pixel."""
    spectrum = np.conj(np.fft.fft2(first)) * np.fft.fft2(second)
    correlation = np.fft.ifft2(spectrum).real
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    steps = np.arange(-upsampling, upsampling + 1) / upsampling
    rows, columns = spectrum.shape
    by_row = np.exp(2j * np.pi * np.outer(peak[0] + steps, np.fft.fftfreq(rows)))
    by_column = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(columns), peak[1] + steps))
    near = (by_row @ spectrum @ by_column).real / spectrum.size
    return float(max(correlation[peak], near.max() if upsampling > 1 else -math.inf))


def _mean_free(name: str, image: Any) -> Array:
    """Return an image minus its mean, checked."""
    values = real_array(name, image.object if isinstance(image, Reconstruction) else image)
    if values.ndim != 2 or not values.size:
        raise SamplingError(f"{name} has shape {values.shape}; give one image, (H, W)")
    check_finite(name, values, "replace them before comparing")
    centred: Array = values - values.mean()
    # Rounding errors of a uniform image must not count as structure.
    if np.abs(centred).max() <= 1e-14 * np.abs(values).max():
        centred[:] = 0.0
    return centred
