"""Zero-padded fast Fourier transform of a pupil grid."""

from __future__ import annotations

import math

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError
from .pixels import PixelRule
from .pupil_grids import PupilGrid
from .residuals import Residual
from .separable import ComplexArray, Pass, intensity
from .windows import Window

Array = NDArray[np.float64]


def default_size(residual: Residual) -> int:
    """Padded size at which the image pitch is just below Nyquist's, a fast one."""
    width = 2 * residual.half_width + residual.wavefront.pupil_pitch
    return int(ducc0.fft.good_size(math.ceil(2 * width / residual.wavefront.pupil_pitch)))


def image_pitch(residual: Residual, size: int) -> float:
    """Image pitch of a padded grid wavefront, m."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / (size * wave.pupil_pitch)


def padded_size(residual: Residual, pitch: float) -> int:
    """Padded size that gives an image pitch.

    Raises
    ------
    SamplingError
        If the size is not whole, or below twice the pupil.
    """
    wave = residual.wavefront
    size = wave.wavelength * abs(wave.image_distance) / (pitch * wave.pupil_pitch)
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.6g} m is wider than Nyquist's {residual.nyquist_pitch:.6g} m "
            "(padding Q below 2); use a finer pitch, or pixel_integrated=True with method='mdft'"
        )
    if abs(size - round(size)) > 1e-9 * size:
        nearest = image_pitch(residual, max(1, round(size)))
        raise SamplingError(
            f"pitch = {pitch:.9g} m needs {size:.6g} padded samples, not a whole number; use pitch "
            f"= {nearest:.12g} m, or method='mdft'"
        )
    return round(size)


def intensity_in(
    residual: Residual, grid: PupilGrid, window: Window, size: int, rule: PixelRule | None
) -> Array:
    """Image intensity in a window of the padded transform, 1 at the ideal peak."""
    n = grid.values.shape[0]
    sign = math.copysign(1.0, residual.wavefront.image_distance)
    values = grid.values
    passes = []
    for axis, (first, count) in enumerate(zip(window.first, window.shape[::-1], strict=True)):
        # Whole samples of the shift move the window, the fraction is a ramp on the pupil.
        start = (first - residual.shift[axis]) / window.pitch
        whole = round(start)
        ramp = np.exp(
            -2j * math.pi * sign * (start - whole) / size * (np.arange(n) - grid.centre)
        )
        values = values * (ramp if axis == 0 else ramp[:, None])
        passes.append(_padded_pass(size, (whole + np.arange(count)) % size, sign > 0))
    return intensity(values, passes[0], passes[1], rule)


def _padded_pass(size: int, wanted: NDArray[np.int64], forward: bool) -> Pass:
    """Transform of zero-padded rows, up to a phase that the intensity does not see."""

    def transform(rows: ComplexArray) -> ComplexArray:
        padded = np.zeros((rows.shape[0], size), dtype=np.complex128)
        padded[:, : rows.shape[1]] = rows
        ducc0.fft.c2c(padded, axes=(1,), forward=forward, out=padded, nthreads=1)
        return padded[:, wanted]

    return transform
