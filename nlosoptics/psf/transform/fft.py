"""Zero-padded fast Fourier transform of a pupil grid."""

from __future__ import annotations

import math

import ducc0
import numpy as np
from numpy.typing import NDArray

from ...errors import SamplingError
from ..wave.detilted import Residual
from ..window.grids import ComplexArray, Pass, PupilGrid, intensity
from ..window.pixels import PixelRule
from ..window.window import Window

Array = NDArray[np.float64]


def default_size(residual: Residual) -> int:
    """Padded size at which the image pitch is just below Nyquist's, a fast one."""
    samples = 2 * residual.half_width / residual.wavefront.pupil_pitch
    return int(ducc0.fft.good_size(math.ceil(2 * samples - 1e-9)))


def image_pitch(residual: Residual, size: int) -> float:
    """Image pitch of a padded grid wavefront, m."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / (size * wave.pupil_pitch)


def padded_size(residual: Residual, pitch: float) -> int:
    """Padded size that gives an image pitch.

    Raises
    ------
    SamplingError
        If the size is not whole.
    """
    wave = residual.wavefront
    size = wave.wavelength * abs(wave.image_distance) / (pitch * wave.pupil_pitch)
    if abs(size - round(size)) > 1e-9 * size:
        nearest = image_pitch(residual, max(1, round(size)))
        raise SamplingError(
            f"pitch = {pitch:.9g} m needs {size:.6g} padded samples, not a whole number; use pitch "
            f"= {nearest:.12g} m, or method='mdft'"
        )
    return round(size)


def check_padding(residual: Residual, pitch: float) -> None:
    """Refuse less than twice the pupil, which an intensity needs."""
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.6g} m is wider than Nyquist's {residual.nyquist_pitch:.6g} m "
            "(padding Q below 2); use a finer pitch, or method='mdft'"
        )


def intensity_in(
    residual: Residual, grid: PupilGrid, window: Window, size: int, rule: PixelRule | None
) -> Array:
    """Image intensity in a window of the padded transform, 1 at the ideal peak."""
    passes = []
    for axis, (first, count) in enumerate(zip(window.first, window.shape[::-1], strict=True)):
        # Whole samples of the shift move the window, the fraction is a ramp on the pupil.
        start = (first - residual.shift[axis]) / window.pitch
        whole = round(start)
        turns = (start - whole) / size * (np.arange(grid.values.shape[0]) - grid.centre)
        ramp = np.exp(-2j * math.pi * math.copysign(1, residual.wavefront.image_distance) * turns)
        passes.append(padded_pass(size, whole, count, ramp, residual.wavefront.image_distance > 0))
    return intensity(grid.values, passes[0], passes[1], window.shape, rule)


def padded_pass(
    size: int, start: int, count: int, ramp: ComplexArray | None, forward: bool
) -> Pass:
    """Transform of zero-padded rows, up to a phase that the intensity does not see.

    Samples from ``start`` on, the period continued where the count passes its end; the rows are
    first multiplied by the ``ramp``.
    """
    # Slices, since picking single columns is as slow as the transform.
    pieces, place = [], start % size
    while count > 0:
        pieces.append(slice(place, min(place + count, size)))
        count -= pieces[-1].stop - place
        place = 0

    def transform(rows: ComplexArray) -> ComplexArray:
        padded = np.zeros((rows.shape[0], size), dtype=np.complex128)
        padded[:, : rows.shape[1]] = rows if ramp is None else rows * ramp
        ducc0.fft.c2c(padded, axes=(1,), forward=forward, out=padded, nthreads=1)
        if len(pieces) == 1:
            return padded[:, pieces[0]]
        return np.concatenate([padded[:, piece] for piece in pieces], axis=1)

    return transform
