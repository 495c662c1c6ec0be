"""Pupil functions on square grids, for the Cartesian transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..._checks import fits_memory
from ..._vectors import Array, ComplexArray
from ..wave.detilted import Residual
from ..wave.polar_series import values_at
from . import antialiased_disc
from .pixels import PixelRule

#: A function that transforms the last axis of (rows, n) to (rows, m).
Pass = Callable[[ComplexArray], ComplexArray]


def intensity(
    values: ComplexArray,
    along_x: Pass,
    along_y: Pass,
    shape: tuple[int, int],
    rule: PixelRule | None,
) -> Array:
    """Return the squared modulus of a two-dimensional transform, or its means over pixels.

    Rows of the image are transformed and squared in blocks, so that the field of a wide window is
    never in memory as a whole.

    Parameters
    ----------
    values : ndarray, (rows, n)
        Pupil function, complex.
    along_x, along_y : callable
        Transforms of the last axis; that of the columns of ``values`` is the first.
    shape : (int, int)
        Samples (ny, nx) of the field.
    rule : PixelRule or None
        Averages samples over pixels; None for point samples.

    Returns
    -------
    ndarray
        (ny, nx) samples, or as many pixels as the rule makes of them.
    """
    from ..wave import _wave_kernels

    ny, nx = shape
    half = np.empty((ny, values.shape[1]), dtype=np.complex128)
    for block in _blocks(values.shape[1], ny):
        half[:, block] = along_y(values.T[block]).T
    image = np.empty((ny, nx if rule is None else rule.count(nx)))
    for block in _blocks(ny, nx):
        strip = along_x(half[block])
        energy = image[block] if rule is None else np.empty(strip.shape)
        _wave_kernels.squares(strip, energy)
        if rule is not None:
            image[block] = rule.mean(energy)
    return image if rule is None else rule.mean_down(image)


def _blocks(count: int, length: int) -> Iterator[slice]:
    """Yield slices of ``count`` rows of a length, small enough for the processor's cache."""
    step = max(8, 2**15 // length)
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


#: Number of nodes evaluated at a time, small enough for the processor's cache.
BLOCK = 2**16


@dataclass(frozen=True, eq=False)
class PupilGrid:
    """Pupil function ``A exp(ikW)`` of a wave without piston and tilt, on a square grid.

    Parameters
    ----------
    values : ndarray, (n, n)
        Amplitude times area times exp(ikW), complex128. v increases from row to row, u along a row;
        sample [n//2, n//2] is on the axis. Values are scaled such that without aberration their sum
        is 1.
    pitch : float
        Spacing of the samples in the pupil, m.
    jump : float
        Largest difference of the aberration between neighbouring samples, wavelengths.
    rim : {"soft", "cut", "map"}
        Treatment of the pupil's rim: blurred over a few squares ("soft"), squares weighted by their
        area inside ("cut"), or a pixel map used as it is ("map").
    """

    values: ComplexArray
    pitch: float
    jump: float
    rim: Literal["soft", "cut", "map"]

    @property
    def centre(self) -> int:
        """Index of the row and column on the axis."""
        return int(self.values.shape[0] // 2)


def pupil_grid(residual: Residual) -> PupilGrid:
    """Return the pupil function of a grid wavefront on its own samples."""
    wave = residual.wavefront
    size = wave.amplitude * wave.weights / residual.amplitude_sum
    values = size * np.exp(1j * residual.wavenumber * residual.aberration)
    cut = wave.aperture is not None or np.ptp(wave.weights) > 0
    rim: Literal["cut", "map"] = "cut" if cut else "map"
    return PupilGrid(values, wave.pupil_pitch, residual.jump()[0], rim)


def grid_size(radius: float, pitch: float) -> int:
    """Return the odd number of cells per side that cover a centred disc and its softened rim."""
    return 2 * (int(np.ceil(radius / pitch)) + antialiased_disc.REACH) + 1


def pupil_grid_from_polar(residual: Residual, pitch: float) -> PupilGrid:
    """Return the pupil function of a polar wavefront on a grid, with softened rims.

    ``pitch`` is that of the grid, m. The wave is evaluated by its series.
    """
    wave = residual.wavefront
    n = grid_size(wave.pupil_radius, pitch)
    fits_memory(f"a pupil grid of {n} x {n} samples", 20.0 * n * n, "use a smaller shape")
    axis = np.arange(n, dtype=np.float64) - n // 2
    edges = (1.0, wave.obscuration) if wave.obscuration > 0 else (1.0,)
    discs = [antialiased_disc.SoftDisc(edge * wave.pupil_radius / pitch) for edge in edges]
    largest = residual.wavenumber * float(np.abs(residual.aberration).max())
    # Relative accuracy of the aberration that gives the phase to 1e-8 rad.
    epsilon = float(np.clip(1e-8 / max(largest, 1.0), 1e-13, 1e-8))
    series, amplitude = residual.polar_series
    values = np.zeros((n, n), dtype=np.complex128)
    total = 0.0
    block = max(1, BLOCK // n)
    for start in range(0, n, block):
        y = axis[start : start + block, None]
        r = np.hypot(y, axis)
        size = discs[0](r) if len(discs) == 1 else discs[0](r) - discs[1](r)
        rows, columns = np.nonzero(size)
        if not rows.size:
            continue  # rows outside the disc; the transform does not accept empty input
        part = size[rows, columns]
        if residual.is_flat:
            pupil = part.astype(np.complex128)
        else:
            u, v = axis[columns] * pitch, y[rows, 0] * pitch
            path, transmitted = values_at(series, amplitude, u, v, epsilon)
            if transmitted is not None:
                part = part * transmitted
            pupil = part * np.exp(1j * residual.wavenumber * path)
        total += float(np.sum(part))
        values[start + rows, columns] = pupil
    values /= total
    return PupilGrid(values, pitch, residual.rays.slope * pitch / wave.wavelength, rim="soft")
