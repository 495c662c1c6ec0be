"""Pupil functions on a square grid, for the Cartesian transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._checks import fits_memory
from . import rims
from .residuals import Residual

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


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
    soft : bool
        Whether the rim was softened, or cut into cells.
    """

    values: ComplexArray
    pitch: float
    jump: float
    soft: bool

    @property
    def centre(self) -> int:
        """Index of the axis."""
        return self.values.shape[0] // 2


def pupil_grid(residual: Residual) -> PupilGrid:
    """Take a grid wavefront's own samples."""
    wave = residual.wavefront
    size = wave.amplitude * wave.weights / residual.amplitude_sum
    values = size * np.exp(1j * residual.wavenumber * residual.aberration)
    return PupilGrid(values, wave.pupil_pitch, residual.grid_jump()[0], soft=False)


def grid_size(radius: float, pitch: float) -> int:
    """Odd number of cells that cover a centred disc and its softened rim."""
    return 2 * (int(np.ceil(radius / pitch)) + rims.REACH) + 1


def pupil_grid_from_polar(residual: Residual, pitch: float) -> PupilGrid:
    """Evaluate a polar wavefront's series on a grid, the rims softened for it (`rims`)."""
    wave = residual.wavefront
    n = grid_size(wave.pupil_radius, pitch)
    fits_memory(f"a pupil grid of {n} x {n} samples", 100.0 * n * n, "ask for a smaller window")
    axis = (np.arange(n) - n // 2) * pitch
    size = _soft_annulus(axis / pitch, wave.pupil_radius / pitch, wave.obscuration)
    rows, columns = np.nonzero(size)
    u, v = axis[columns], axis[rows]
    size = size[rows, columns]
    if not residual.is_uniform:
        size *= residual.amplitude_series.at(u, v, 1e-10)
    size /= np.sum(size)
    values = np.zeros((n, n), dtype=np.complex128)
    if np.any(residual.aberration):
        largest = residual.wavenumber * float(np.abs(residual.aberration).max())
        # The phase to 1e-8 rad.
        epsilon = float(np.clip(1e-8 / largest, 1e-13, 1e-8))
        phase = residual.wavenumber * residual.series.at(u, v, epsilon)
        values[rows, columns] = size * np.exp(1j * phase)
    else:
        values[rows, columns] = size
    return PupilGrid(values, pitch, residual.rays.slope * pitch / wave.wavelength, soft=True)


def _soft_annulus(axis: Array, radius: float, obscuration: float) -> Array:
    """Weights on the grid ``axis`` x ``axis``, in cells."""
    r = np.hypot(axis[:, None], axis)
    size = rims.soft_disc(r, radius)
    if obscuration > 0:
        size -= rims.soft_disc(r, obscuration * radius)
    return size
