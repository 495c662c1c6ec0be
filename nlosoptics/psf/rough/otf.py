"""Optical transfer function of a smooth wave at arbitrary separations of pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import ducc0
import numpy as np
import scipy  # loads scipy.ndimage on first use
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import Array, ComplexArray
from ..aperture.quadrature_nodes import grid_nodes
from ..wave.detilted import Residual
from ..wave.polar_series import values_at
from ..window.rim_tails import edge_ratio

#: Peak memory per cell, bytes, and least number of cells across the pupil.
CELL_BYTES, LEAST_CELLS = 400.0, 128


@dataclass(frozen=True, eq=False)
class Transfer:
    """Optical transfer function of a wave, as a function of the distance between pupil points."""

    # Function of the components (du, dv) of a distance between two pupil points, m, that returns
    # complex values: 1 at distance 0, and 0 beyond the pupil's diameter. The distance is the
    # spatial frequency in the image times wavelength times image distance.
    at: Callable[[Array, Array], ComplexArray]
    reach: float  # Distance beyond which the function is 0, m
    error: float  # Estimate of the largest error of the function


def transfer(residual: Residual, cells: int = 0) -> Transfer:
    """Compute the optical transfer function of a wave of the layout "polar" or "grid".

    A polar wave is resampled to a grid of ``cells`` squares across the pupil; 0 for the default.
    For a pupil without aberration the function is the overlap area of two displaced pupils: in
    closed form for polar nodes, that of the cells for a grid. Aberration and amplitude multiply it
    by a smooth ratio, which is interpolated from a lattice. The error due to the rim cancels in
    that ratio.
    """
    wave = residual.wavefront
    reference: Callable[[Array, Array], Array]
    if wave.layout == "polar":
        radius, inner = wave.pupil_radius, wave.obscuration * wave.pupil_radius

        def clear(du: Array, dv: Array) -> Array:
            return annulus_overlap(np.hypot(du, dv), radius, inner)

        reference = clear
        # removing a pure tilt leaves only rounding errors
        flat = residual.wavenumber * float(np.abs(residual.aberration).max()) < 1e-12
        if residual.is_uniform and flat:
            return Transfer(lambda du, dv: clear(du, dv).astype(np.complex128), 2 * radius, 1e-14)
        pupil, weights, pitch = _on_grid(residual, cells or cells_across(residual))
        jump, edge, cusp = residual.rays.slope * pitch / wave.wavelength, 2 * radius, 0.0
    else:
        weights, pitch = wave.amplitude * wave.weights, wave.pupil_pitch
        pupil = weights * np.exp(1j * residual.wavenumber * residual.aberration)
        lit = np.hypot(wave.u, wave.v)[weights > 0].max()
        jump, edge = residual.jump()[0], 2 * (float(lit) + pitch)
        reference = _cells(weights, float(np.sum(weights * wave.amplitude)) * pitch**2, pitch)
        # the cells' rounded cusp at separation 0
        cusp = (0.3 if wave.aperture is None else 0.6) * edge_ratio(wave)
    ratio = _lattice_ratio(pupil, weights, pitch)
    centre = float(ratio(np.zeros(1), np.zeros(1))[0].real)
    n = 2 * wave.pupil_radius / pitch
    # the spline's error for a phase step of jump waves per cell
    error = (2 * math.pi * jump) ** 6 / 3e4 + cusp / n
    # Error of the ratio, measured on low-order aberrations: where the rims touch, and along them.
    error += residual.truncation + 0.25 / n**1.5 + 0.6 * jump / n

    def at(du: Array, dv: Array) -> ComplexArray:
        return np.asarray(reference(du, dv) * ratio(du, dv) / centre)

    return Transfer(at, edge, error)


def annulus_overlap(d: Array, radius: float, inner: float = 0.0) -> Array:
    """Return the overlap area of two equal annuli at a distance ``d``, over the area of one."""
    if inner == 0:
        return _overlap(d, radius, radius) / (math.pi * radius**2)
    both = _overlap(d, radius, radius) - 2 * _overlap(d, radius, inner) + _overlap(d, inner, inner)
    return both / (math.pi * (radius**2 - inner**2))


def _overlap(d: Array, a: float, b: float) -> Array:
    """Return the overlap area of two discs of radii a >= b at a distance d of their centres."""
    # Two sectors minus two triangles. Half angles by arctan2 are accurate also near contact.
    product = (a + b - d) * (d + a - b) * (d - a + b) * (d + a + b)
    chord = np.sqrt(np.maximum(product, 0.0))  # chord length times d
    first = np.arctan2(chord, d**2 + a**2 - b**2)
    second = np.arctan2(chord, d**2 - a**2 + b**2)
    area = a**2 * first + b**2 * second - chord / 2
    return np.where(d >= a + b, 0.0, np.where(d <= a - b, math.pi * b**2, area))


def cells_across(residual: Residual, error: float | None = None) -> int:
    """Return the number of cells across a polar wave's pupil: the default, or for an image error.

    The error of an image is seldom more than a tenth of the largest error at any separation, since
    roughness damps long separations. The rule for a given ``error`` makes use of that.
    """
    wave = residual.wavefront
    waves = 2 * wave.pupil_radius * residual.rays.slope / wave.wavelength
    if error is None:
        return math.ceil(max(512, waves / 0.08))
    step = min(0.25, max(0.08, math.sqrt(math.cbrt(1.5e3 * error)) / (2 * math.pi)))
    rim, slope = math.cbrt(0.025 / error) ** 2, math.sqrt(0.06 * waves / error)
    return math.ceil(max(LEAST_CELLS, waves / step, rim, slope))


def _on_grid(residual: Residual, n: int) -> tuple[ComplexArray, Array, float]:
    """Return the pupil function of a polar wave on n or n + 1 cells across, areas and pitch, m.

    The pupil function includes the areas of the cells, in squares of the pupil's radius.
    """
    wave = residual.wavefront
    fits_memory(f"the transfer function of {n} x {n} cells", CELL_BYTES * n * n, "use a larger tol")
    u, v, weights = grid_nodes(1.0, n + 1 - n % 2, wave.obscuration)
    lit = weights > 0
    path, size = values_at(
        *residual.polar_series, wave.pupil_radius * u[lit], wave.pupil_radius * v[lit], 1e-10
    )
    pupil = np.zeros(u.shape, dtype=np.complex128)
    pupil[lit] = weights[lit] * np.exp(1j * residual.wavenumber * path)
    if size is not None:
        pupil[lit] *= size
    return pupil, weights, wave.pupil_radius * float(u[0, 1] - u[0, 0])


def _correlation(values: NDArray[np.complex128] | Array) -> ComplexArray:
    """Return the autocorrelation ``sum_p P(p + d) P*(p)``, (2 n, 2 n), with d = 0 at [n, n]."""
    n = values.shape[0]
    padded = np.zeros((2 * n, 2 * n), dtype=np.complex128)
    padded[:n, :n] = values
    ducc0.fft.c2c(padded[:n], axes=(1,), out=padded[:n], nthreads=1)
    ducc0.fft.c2c(padded, axes=(0,), out=padded, nthreads=1)
    power = padded.real**2 + padded.imag**2
    # the transform of real values; that of the other half are its conjugates
    half = ducc0.fft.r2c(power, forward=False, inorm=2, nthreads=1)
    padded[:, : n + 1] = half
    padded[0, n + 1 :] = np.conj(half[0, n - 1 : 0 : -1])
    padded[1:, n + 1 :] = np.conj(half[:0:-1, n - 1 : 0 : -1])
    return np.asarray(np.fft.fftshift(padded))


def _lattice_ratio(
    pupil: ComplexArray, weights: Array, pitch: float
) -> Callable[[Array, Array], ComplexArray]:
    """Return the autocorrelation of a pupil function over that of its weights, by a spline.

    Both are (n, n) on cells of a pitch, m; ``pupil`` includes the weights. The result is a function
    of separations (du, dv), m. It is 0 where the autocorrelation of the weights is negligible.
    """
    plain, centre = _correlation(weights).real, weights.shape[0]
    table = np.zeros(plain.shape, dtype=np.complex128)
    lit = plain > 1e-5 * plain[centre, centre]
    np.divide(_correlation(pupil), plain, out=table, where=lit)
    spline = scipy.ndimage.spline_filter(table, 5, output=np.complex128, mode="mirror")

    def at(du: Array, dv: Array) -> ComplexArray:
        place = np.stack([dv, du]) / pitch + centre
        return np.asarray(
            scipy.ndimage.map_coordinates(spline, place, order=5, prefilter=False, mode="mirror")
        )

    return at


def _cells(amplitude: Array, energy: float, pitch: float) -> Callable[[Array, Array], Array]:
    """Return the autocorrelation of cells of constant amplitude, over the transmitted energy.

    It is bilinear between the separations of the lattice. At separation 0 it is set to 1, since a
    cell that the rim cuts contributes its area fraction there, not the square of it.
    """
    table = _correlation(amplitude).real / energy
    n = amplitude.shape[0]
    table[n, n] = 1.0

    def at(du: Array, dv: Array) -> Array:
        place = np.stack([dv, du]) / pitch + n
        return np.asarray(scipy.ndimage.map_coordinates(table, place, order=1))

    return at
