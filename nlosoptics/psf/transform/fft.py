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
    """Return the smallest fast transform size whose image pitch is at most the Nyquist pitch."""
    samples = 2 * residual.half_width / residual.wavefront.pupil_pitch
    return int(ducc0.fft.good_size(math.ceil(2 * samples - 1e-9)))


def image_pitch(residual: Residual, size: int) -> float:
    """Return the image pitch, m, of a grid wavefront padded to ``size``."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / (size * wave.pupil_pitch)


def padded_size(residual: Residual, pitch: float) -> int:
    """Return the FFT samples per side of the padded pupil for an image pitch ``pitch``, m.

    `check_padding` tests whether this pitch aliases.

    Raises
    ------
    SamplingError
        If the size is not a whole number.
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
    """Refuse padding to less than twice the pupil, which aliases the intensity."""
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.6g} m is wider than the Nyquist pitch {residual.nyquist_pitch:.6g} m "
            "(padding Q below 2); use a finer pitch, or method='mdft'"
        )


def intensity_in(
    residual: Residual, grid: PupilGrid, window: Window, size: int, rule: PixelRule | None
) -> Array:
    """Compute the image intensity in a window, 1 at the ideal peak.

    Parameters
    ----------
    residual : Residual
        Wave, for the tilt's shift and the sign of the image distance.
    grid : PupilGrid
        Pupil function.
    window : Window
        Sample points.
    size : int
        Padded transform size.
    rule : PixelRule or None
        Average over pixels; None for point samples.

    Returns
    -------
    ndarray, (ny, nx)
    """
    passes = []
    for axis, (first, count) in enumerate(zip(window.first, window.shape[::-1], strict=True)):
        # Whole samples of the shift move the window; the fraction is a phase ramp on the pupil.
        start = (first - residual.shift[axis]) / window.pitch
        whole = round(start)
        turns = (start - whole) / size * (np.arange(grid.values.shape[0]) - grid.centre)
        ramp = np.exp(-2j * math.pi * math.copysign(1, residual.wavefront.image_distance) * turns)
        passes.append(padded_pass(size, whole, count, ramp, residual.wavefront.image_distance > 0))
    return intensity(grid.values, passes[0], passes[1], window.shape, rule)


def padded_pass(
    size: int, start: int, count: int, ramp: ComplexArray | None, forward: bool
) -> Pass:
    """Return a function that transforms zero-padded rows, up to a phase factor per sample.

    The intensity does not depend on that phase. The rows are first multiplied by ``ramp``. The
    function returns ``count`` samples from ``start`` on, continued periodically.
    """
    # Slices, since indexing single columns is as slow as the transform.
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
