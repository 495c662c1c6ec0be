"""Pupil functions on a square grid, for the Cartesian transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..wave.detilted import Residual
from ..wave.polar_series import values_at
from . import antialiased_disc
from .pixels import PixelRule

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Transforms the last axis of (rows, n) to (rows, m).
Pass = Callable[[ComplexArray], ComplexArray]

#: Memory of a block of rows, few enough to stay in the cache.
BLOCK_BYTES = 2**22


def intensity(
    values: ComplexArray,
    along_x: Pass,
    along_y: Pass,
    shape: tuple[int, int],
    rule: PixelRule | None,
) -> Array:
    """|transform|^2 of the given shape, averaged over pixels when a rule is given, (ny, nx).

    Columns are transformed in blocks and squared at once, so that the field of a wide window is
    never held.
    """
    ny, nx = shape
    rows = values.shape[0]
    half = np.empty((rows, nx), dtype=np.complex128)
    for block in _blocks(rows, nx):
        half[block] = along_x(values[block])
    strips = []
    for block in _blocks(nx, ny):
        strip = along_y(half[:, block].T)
        energy = strip.real**2 + strip.imag**2
        strips.append(energy if rule is None else rule.mean(energy))
    image = np.ascontiguousarray(np.concatenate(strips).T)
    return image if rule is None else rule.mean(image)


def _blocks(count: int, length: int) -> Iterator[slice]:
    step = max(1, BLOCK_BYTES // (16 * length))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


#: Nodes evaluated at a time, few enough to stay in the cache.
BLOCK = 2**16


@dataclass(frozen=True, eq=False)
class PupilGrid:
    """Amplitude times cell area times exp(ikW) of a residual, summing to 1 without aberration.

    Parameters
    ----------
    values : ndarray
        (n, n) complex128, rows are v; sample [centre, centre] is on the axis.
    pitch : float
        m.
    jump : float
        Largest step of the residual between neighbours, waves.
    rim : {"soft", "cut", "map"}
        Softened for the grid, cut into cells weighted by area, or a map taken as it is.
    """

    values: ComplexArray
    pitch: float
    jump: float
    rim: Literal["soft", "cut", "map"]

    @property
    def centre(self) -> int:
        """Index of the axis."""
        return int(self.values.shape[0] // 2)


def pupil_grid(residual: Residual) -> PupilGrid:
    """Take a grid wavefront's own samples."""
    wave = residual.wavefront
    size = wave.amplitude * wave.weights / residual.amplitude_sum
    values = size * np.exp(1j * residual.wavenumber * residual.aberration)
    cut = wave.aperture is not None or np.ptp(wave.weights) > 0
    rim: Literal["cut", "map"] = "cut" if cut else "map"
    return PupilGrid(values, wave.pupil_pitch, residual.grid_jump()[0], rim)


def grid_size(radius: float, pitch: float) -> int:
    """Odd number of cells that cover a centred disc and its softened rim."""
    return 2 * (int(np.ceil(radius / pitch)) + antialiased_disc.REACH) + 1


def pupil_grid_from_polar(residual: Residual, pitch: float) -> PupilGrid:
    """Evaluate a polar wavefront's series on a grid, with antialiased rims."""
    wave = residual.wavefront
    n = grid_size(wave.pupil_radius, pitch)
    fits_memory(f"a pupil grid of {n} x {n} samples", 20.0 * n * n, "ask for a smaller window")
    axis = np.arange(n, dtype=np.float64) - n // 2
    discs = [antialiased_disc.SoftDisc(wave.pupil_radius / pitch)]
    if wave.obscuration > 0:
        discs.append(antialiased_disc.SoftDisc(wave.obscuration * wave.pupil_radius / pitch))
    flat = not np.any(residual.aberration)
    largest = residual.wavenumber * float(np.abs(residual.aberration).max())
    # The phase to 1e-8 rad.
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
            continue  # above or below the disc; an empty transform is refused
        part = size[rows, columns]
        if flat and amplitude is None:
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
