"""Optical transfer function of a smooth wave at any separation of pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from ..aperture.quadrature_nodes import grid_nodes
from ..wave.detilted import Residual
from ..wave.polar_series import values_at
from ..window.rim_tails import edge_ratio

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Cells across a polar wave that is put on a grid, at least.
CELLS = 512
#: The same where an error is given.
FEW_CELLS = 128
#: Largest step of the aberration between its cells, waves.
STEP = 0.08
#: Bytes of a cell at the peak.
CELL_BYTES: Final = 400.0
#: Order of the spline; 3 and 5 are the ones with small error constants.
ORDER: Final = 5


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer function of a wave without its piston and tilt, 1 at separation 0.

    Parameters
    ----------
    at : callable
        Separations (du, dv), m, to complex values; 0 beyond the pupil's diameter.
    reach : float
        Separation beyond which it is 0, m.
    error : float
        Expected largest error.
    """

    at: Callable[[Array, Array], ComplexArray]
    reach: float
    error: float


def transfer(residual: Residual, cells: int = 0) -> Transfer:
    """Transfer function of a polar or grid wave; from ``cells`` across a polar one, 0 for enough.

    A clear pupil's is the common area of two displaced pupils in closed form. Any other is that,
    or on a grid the cells' own, times the smooth ratio that aberration and amplitude make of it,
    from a lattice, so that the rim's share of the error divides out.
    """
    wave = residual.wavefront
    if wave.layout not in ("polar", "grid"):
        raise SamplingError(
            f"the transfer function needs a polar wavefront or a grid, and this one is "
            f"{wave.layout}; sample it with nodes='grid'"
        )
    if wave.layout == "polar":
        radius, inner = wave.pupil_radius, wave.obscuration * wave.pupil_radius

        def clear(du: Array, dv: Array) -> Array:
            return annulus_overlap(np.hypot(du, dv), radius, inner)

        reference: Callable[[Array, Array], Array] = clear
        # what a tilt's removal leaves is rounding
        flat = residual.wavenumber * float(np.abs(residual.aberration).max()) < 1e-12
        if residual.is_uniform and flat:
            return Transfer(lambda du, dv: clear(du, dv).astype(np.complex128), 2 * radius, 1e-14)
        pupil, weights, pitch = _on_grid(residual, cells or cells_across(residual))
        jump = residual.rays.slope * pitch / wave.wavelength
        edge = 2 * radius
    else:
        amplitude = wave.amplitude * wave.weights
        pupil = amplitude * np.exp(1j * residual.wavenumber * residual.aberration)
        weights, pitch, jump = amplitude, wave.pupil_pitch, residual.grid_jump()[0]
        lit = np.hypot(wave.u, wave.v)[amplitude > 0].max()
        edge = 2 * (float(lit) + pitch)
        reference = _cells(amplitude, float(np.sum(amplitude * wave.amplitude)) * pitch**2, pitch)
    ratio = LatticeRatio(weights, pitch).of(pupil)
    centre = float(ratio(np.zeros(1), np.zeros(1))[0].real)
    n = 2 * wave.pupil_radius / pitch
    # the spline's error for a wave that turns by jump a cell, and the cells' blunted cusp at 0
    cusp = (0.3 if wave.aperture is None else 0.6) * edge_ratio(wave) / n
    cusp = cusp if wave.layout == "grid" else 0.0
    error = (2 * math.pi * jump) ** (ORDER + 1) / 3e4 + cusp
    # the ratio's, measured on waves of low order: at contact, and along the rim
    error += residual.truncation + 0.25 / n**1.5 + 0.6 * jump / n

    def at(du: Array, dv: Array) -> ComplexArray:
        return np.asarray(reference(du, dv) * ratio(du, dv) / centre)

    return Transfer(at, edge, error)


def annulus_overlap(d: Array, radius: float, inner: float = 0.0) -> Array:
    """Common area of two equal annuli a distance apart, over the area of one."""
    if inner == 0:
        return _overlap(d, radius, radius) / (math.pi * radius**2)
    both = _overlap(d, radius, radius) - 2 * _overlap(d, radius, inner) + _overlap(d, inner, inner)
    return both / (math.pi * (radius**2 - inner**2))


def _overlap(d: Array, a: float, b: float) -> Array:
    """Common area of two discs of radii a >= b whose centres are d apart: two sectors, two legs."""
    # half angles by arctan2 of the lens's half chord, which keeps their digits at contact
    product = (a + b - d) * (d + a - b) * (d - a + b) * (d + a + b)
    chord = np.sqrt(np.maximum(product, 0.0))  # times d, over 1/2
    first = np.arctan2(chord, d**2 + a**2 - b**2)
    second = np.arctan2(chord, d**2 - a**2 + b**2)
    area = a**2 * first + b**2 * second - chord / 2
    return np.where(d >= a + b, 0.0, np.where(d <= a - b, math.pi * b**2, area))


def cells_across(residual: Residual, error: float | None = None) -> int:
    """Cells across a polar wave's pupil: `CELLS` or more, or as many as an error probably takes.

    What cells err by in an image is seldom more than a tenth of what they may err by at some
    separation, since roughness damps the far ones.
    """
    wave = residual.wavefront
    waves = 2 * wave.pupil_radius * residual.rays.slope / wave.wavelength
    if error is None:
        return math.ceil(max(CELLS, waves / STEP))
    step = min(0.25, max(STEP, math.sqrt(math.cbrt(1.5e3 * error)) / (2 * math.pi)))
    rim, slope = math.cbrt(0.025 / error) ** 2, math.sqrt(0.06 * waves / error)
    return math.ceil(max(float(FEW_CELLS), waves / step, rim, slope))


def _on_grid(residual: Residual, n: int) -> tuple[ComplexArray, Array, float]:
    """Pupil function of a polar wave on cells, the cells' areas alone, and their pitch."""
    wave = residual.wavefront
    fits_memory(f"the transfer function of {n} x {n} cells", CELL_BYTES * n * n, "use a larger tol")
    u, v, weights = grid_nodes(wave.pupil_radius, n + 1 - n % 2, wave.obscuration)
    lit = weights > 0
    path, size = values_at(*residual.polar_series, u[lit], v[lit], 1e-10)
    pupil = np.zeros(u.shape, dtype=np.complex128)
    pupil[lit] = weights[lit] * np.exp(1j * residual.wavenumber * path)
    if size is not None:
        pupil[lit] *= size
    return pupil, weights, float(u[0, 1] - u[0, 0])


def _correlation(values: NDArray[np.complex128] | Array) -> ComplexArray:
    """Sums over p of ``P(p + d) P*(p)``, separation 0 in the middle of (2 n, 2 n)."""
    n = values.shape[0]
    padded = np.zeros((2 * n, 2 * n), dtype=np.complex128)
    padded[:n, :n] = values
    ducc0.fft.c2c(padded, out=padded, nthreads=1)
    padded = (padded.real**2 + padded.imag**2).astype(np.complex128)
    ducc0.fft.c2c(padded, out=padded, forward=False, inorm=2, nthreads=1)
    return np.asarray(np.fft.fftshift(padded))


class LatticeRatio:
    """Correlation of pupil functions on a lattice over that of their weights, by spline.

    Parameters
    ----------
    weights : ndarray
        (n, n), below 0 at a softened rim alone.
    pitch : float
        m.
    """

    def __init__(self, weights: Array, pitch: float) -> None:
        self.plain = _correlation(weights).real
        self.centre, self.pitch = weights.shape[0], pitch
        self.seen = self.plain > 1e-5 * self.plain[self.centre, self.centre]

    def of(self, pupil: ComplexArray) -> Callable[[Array, Array], ComplexArray]:
        """Ratio at separations (du, dv), m, of a pupil function (n, n)."""
        from scipy import ndimage

        table = np.zeros(self.plain.shape, dtype=np.complex128)
        np.divide(_correlation(pupil), self.plain, out=table, where=self.seen)
        parts: list[Array] = [ndimage.spline_filter(p, ORDER) for p in (table.real, table.imag)]

        def at(du: Array, dv: Array) -> ComplexArray:
            place = np.stack([dv, du]) / self.pitch + self.centre
            real, imag = (
                ndimage.map_coordinates(part, place, order=ORDER, prefilter=False) for part in parts
            )
            return np.asarray(real + 1j * imag)

        return at


def _cells(amplitude: Array, energy: float, pitch: float) -> Callable[[Array, Array], Array]:
    """Correlation of cells of constant amplitude, over the light they pass.

    Between the lattice's separations it is bilinear. At 0 it is 1: cells that a rim cuts count
    there with their share, not with its square.
    """
    from scipy import ndimage

    table = _correlation(amplitude).real / energy
    n = amplitude.shape[0]
    table[n, n] = 1.0

    def at(du: Array, dv: Array) -> Array:
        place = np.stack([dv, du]) / pitch + n
        return np.asarray(ndimage.map_coordinates(table, place, order=1))

    return at
