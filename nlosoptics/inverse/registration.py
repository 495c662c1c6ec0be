"""How alike a reconstruction and the truth are, wherever the reconstruction lies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from .._checks import whole
from ..errors import SamplingError, SceneError
from .reconstructions import Reconstruction

Array = NDArray[np.float64]


def registered_correlation(
    reconstruction: Any, truth: Any, *, upsampling: int = 20, flip: bool = False
) -> float:
    """Largest Pearson correlation over all shifts of a reconstruction.

    Scale and offset do not count, and neither does the position, which an image leaves open (a
    wavefront's tilt moves the object).

    Parameters
    ----------
    reconstruction : Reconstruction, ndarray or Tensor
        (H, W).
    truth : ndarray or Tensor
        (H, W).
    upsampling : int
        Steps of the shift per pixel; 1 for whole pixels.
    flip : bool
        Whether half a turn is allowed as well, which an autocorrelation leaves open.

    Returns
    -------
    float
        From -1 to 1; 0 where one of the two is uniform.

    Raises
    ------
    SamplingError
        If the shapes differ or are not two-dimensional.
    SceneError
        If a value is not finite.

    Notes
    -----
    The circular cross-correlation of the two mean-free images over the product of their norms is
    the Pearson correlation at each shift, shifts between pixels meaning band-limited
    interpolation. Its peak among whole pixels is refined by a matrix DFT [1]_.

    References
    ----------
    .. [1] Guizar-Sicairos, Thurman and Fienup, Optics Letters 33 (2008) 156.
    """
    upsampling = whole("upsampling", upsampling)
    if isinstance(reconstruction, Reconstruction):
        reconstruction = reconstruction.object
    first = _mean_free("reconstruction", reconstruction)
    second = _mean_free("truth", truth)
    if first.shape != second.shape:
        raise SamplingError(
            f"reconstruction has shape {first.shape} and truth {second.shape}; "
            "resample one to the other's pixels"
        )
    norm = math.sqrt(float((first * first).sum()) * float((second * second).sum()))
    if norm == 0.0:
        return 0.0
    best = _highest_peak(first, second, upsampling)
    if flip:
        best = max(best, _highest_peak(first[::-1, ::-1], second, upsampling))
    return best / norm


def _highest_peak(first: Array, second: Array, upsampling: int) -> float:
    """Largest circular cross-correlation of two images over all shifts."""
    spectrum = np.conj(fft.fft2(first)) * fft.fft2(second)
    correlation = fft.ifft2(spectrum).real
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    best = float(correlation[peak])
    if upsampling > 1:
        best = max(best, _refined_peak(spectrum, peak, upsampling))
    return best


def _refined_peak(spectrum: Any, peak: tuple[Any, ...], upsampling: int) -> float:
    """Largest cross-correlation within a pixel of its peak, in steps of 1/upsampling pixel."""
    steps = np.arange(-upsampling, upsampling + 1) / upsampling
    rows, columns = spectrum.shape
    row_shifts = peak[0] + steps
    column_shifts = peak[1] + steps
    by_row = np.exp(2j * np.pi * np.outer(row_shifts, fft.fftfreq(rows)))
    by_column = np.exp(2j * np.pi * np.outer(fft.fftfreq(columns), column_shifts))
    size = int(spectrum.size)
    return float((by_row @ spectrum @ by_column).real.max()) / size


def _mean_free(name: str, image: Any) -> Array:
    if hasattr(image, "detach"):
        image = image.detach().cpu().numpy()
    values = np.asarray(image, dtype=np.float64)
    if values.ndim != 2:
        raise SamplingError(f"{name} has shape {values.shape}; give one image, (H, W)")
    if not np.isfinite(values).all():
        raise SceneError(
            f"{name} has {np.count_nonzero(~np.isfinite(values))} values that are not finite; "
            "mend it before comparing"
        )
    centred: Array = values - values.mean()
    # What rounding leaves of a uniform image is not structure.
    if np.abs(centred).max() <= 1e-14 * np.abs(values).max():
        centred[:] = 0.0
    return centred
