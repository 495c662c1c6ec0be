"""A wave without its piston and tilt, and where its rays land.

The tilt is an exact shift of the image; only what is left needs sampling.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SamplingError
from ..aperture.aperture import Aperture
from ..aperture.quadrature_nodes import KEPT, frozen, kept_polar_nodes
from .cell_series import CellSpectrum
from .fits import fitted_terms, projection
from .polar_series import PolarSpectrum, ring_of
from .pupil_polynomials import LowPolynomial, low_polynomial
from .scattered_fits import LocalFits, local_fits
from .wavefront import Wavefront

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rays:
    """Slopes of the residual aberration, one ray each.

    Parameters
    ----------
    x, y : ndarray
        Where the rays land in the image, m, from the point the tilt leads to.
    energy : ndarray
        Share of the light, sum 1; 0 on the rim.
    slope : float
        Largest gradient of the residual aberration.
    reach : float
        Half the side of the square that holds every ray, m.
    """

    x: Array
    y: Array
    energy: Array
    slope: float
    reach: float


class Heights(NamedTuple):
    """Lowest, highest and mean aberration of the lit pupil, and its rms about the mean, m."""

    low: float
    high: float
    mean: float
    rms: float


@dataclass(frozen=True, eq=False)
class Residual:
    """Wavefront split into piston, tilt and the rest.

    Parameters
    ----------
    wavefront : Wavefront
        As given.
    tilt : (float, float)
        dW/du and dW/dv of the weighted least-squares plane.
    aberration : ndarray
        What is left, m, at the wavefront's nodes.
    """

    wavefront: Wavefront
    tilt: tuple[float, float]
    aberration: Array

    @property
    def wavenumber(self) -> float:
        """2 pi/wavelength, 1/m."""
        return 2 * np.pi / self.wavefront.wavelength

    @property
    def airy_unit(self) -> float:
        """Wavelength times F-number, m."""
        return self.wavefront.wavelength * self.wavefront.f_number

    @property
    def shift(self) -> tuple[float, float]:
        """Where the tilt moves the image, (x, y), m."""
        d = self.wavefront.image_distance
        return self.tilt[0] * d, self.tilt[1] * d

    @cached_property
    def amplitude_sum(self) -> float:
        """Integral of the amplitude over the pupil, m^2: the unaberrated field on the axis."""
        return float(np.sum(self.wavefront.amplitude * self.wavefront.weights))

    @cached_property
    def half_width(self) -> float:
        """Farthest light in u or v from the axis, m; it limits the image's bandwidth."""
        wave = self.wavefront
        if wave.aperture is not None:
            return wave.aperture.half_width
        if wave.layout == "polar":
            return wave.pupil_radius
        lit = wave.amplitude * wave.weights > 0
        farthest = float(max(np.abs(wave.u[lit]).max(), np.abs(wave.v[lit]).max()))
        if wave.layout == "scattered":
            return max(farthest, wave.pupil_radius)
        edge = farthest + wave.pupil_pitch / 2
        # Cells that the rim cuts reach beyond it, those of a plain map do not.
        return edge if np.ptp(wave.weights) == 0 else min(edge, wave.pupil_radius)

    @property
    def nyquist_pitch(self) -> float:
        """Widest image sampling that keeps the intensity, m; lambda N/2 for a round pupil."""
        wave = self.wavefront
        return wave.wavelength * abs(wave.image_distance) / (4 * self.half_width)

    @cached_property
    def energy(self) -> float:
        """Integral of the squared amplitude over the pupil, m^2."""
        return float(np.sum(self.wavefront.amplitude**2 * self.wavefront.weights))

    def pixel_share(self, pitch: float) -> float:
        """Share of the light through the pupil in a pixel whose mean is the ideal peak."""
        wave = self.wavefront
        area = (pitch * self.amplitude_sum) ** 2
        return area / (self.energy * (wave.wavelength * wave.image_distance) ** 2)

    @property
    def is_uniform(self) -> bool:
        """Whether the amplitude is the same at every node."""
        return self.wavefront.is_uniform

    @cached_property
    def heights(self) -> Heights:
        """Extremes, mean and rms of the residual aberration over the lit pupil."""
        from . import _wave_kernels

        if self.is_flat:
            return Heights(0.0, 0.0, 0.0, 0.0)
        wave = self.wavefront
        share = (wave.amplitude * wave.weights).ravel()
        return Heights(*_wave_kernels.moments(self.aberration.ravel(), share))

    @cached_property
    def is_flat(self) -> bool:
        """Whether nothing at all is left of the aberration of an evenly lit polar wavefront."""
        even = self.wavefront.layout == "polar" and self.is_uniform
        return even and not self.aberration.any()

    @cached_property
    def series(self) -> PolarSpectrum | CellSpectrum:
        """Series of the residual aberration of a polar wavefront or one of cells."""
        return self.wavefront.series(self.aberration)

    @cached_property
    def low(self) -> LowPolynomial | None:
        """Polynomial that the residual of few polar nodes is to rounding; None for another."""
        wave = self.wavefront
        if wave.layout != "polar" or wave.u.size > KEPT or self.is_flat:
            return None
        return low_polynomial(self.aberration, wave.pupil_radius, wave.obscuration)

    def degrees(self, threshold: float) -> tuple[int, int]:
        """Highest degrees, see `PolarSpectrum.degrees`, of terms above the threshold, m."""
        return self.series.degrees(threshold) if self.low is None else self.low.degrees

    @cached_property
    def amplitude_series(self) -> PolarSpectrum | CellSpectrum:
        """The same of the amplitude."""
        return self.wavefront.series(self.wavefront.amplitude)

    @property
    def aperture(self) -> Aperture:
        """Outline of the pupil of a wavefront that has one.

        Raises
        ------
        SamplingError
            If it has none.
        """
        aperture = self.wavefront.aperture
        if aperture is None:
            raise SamplingError("this wavefront has no aperture; sample it with nodes='cells'")
        return aperture

    @property
    def polar_series(self) -> tuple[PolarSpectrum, PolarSpectrum | None]:
        """Series of a polar wavefront's residual aberration, and of its amplitude if it varies.

        Raises
        ------
        SamplingError
            If the wavefront is not polar.
        """
        pair = self.series, None if self.is_uniform else self.amplitude_series
        if isinstance(pair[0], CellSpectrum) or isinstance(pair[1], CellSpectrum):
            raise SamplingError(
                "this wavefront of cells cannot be put on a grid; sample it with nodes='grid'"
            )
        return pair[0], pair[1]

    @cached_property
    def local(self) -> LocalFits:
        """Cubics about the lit nodes of a grid or of scattered nodes."""
        return local_fits(self.wavefront, self.aberration)

    @cached_property
    def spacing(self) -> float:
        """Pitch of a grid, or side of the mean area of a lit scattered node, m."""
        wave = self.wavefront
        if wave.layout == "grid":
            return wave.pupil_pitch
        return float(np.sqrt(wave.weights.ravel()[self.local.indices].mean()))

    @cached_property
    def truncation(self) -> float:
        """Relative error of the pupil function for lack of polar or cell nodes, at worst."""
        if not self.wavefront.is_spectral:
            return 0.0
        amplitude = 0.0
        if not self.is_uniform:
            amplitude = self.amplitude_series.truncation() / float(self.wavefront.amplitude.max())
        left = self.series.truncation() if self.low is None else self.low.misfit
        return self.wavenumber * left + amplitude

    @cached_property
    def rays(self) -> Rays:
        """One ray from every node, and from the rims of a polar wavefront or of patches."""
        wave = self.wavefront
        if wave.is_spectral:
            return self.traced(*wave.u.shape)
        if wave.layout == "scattered":
            lit = self.local.indices
            du, dv = self.local.slopes.T
            return self._landing(du, dv, wave.amplitude[lit] ** 2 * wave.weights[lit])
        return self._landing(*self._grid_slopes())

    def traced(self, *counts: int) -> Rays:
        """Rays from nodes of a shape (see `Wavefront.nodes`), or the present ones, and rims."""
        wave = self.wavefront
        if self.is_flat:  # they all land in one point
            return Rays(np.zeros((1, 1)), np.zeros((1, 1)), np.ones((1, 1)), 0.0, 0.0)
        counts = tuple(max(pair) for pair in zip(counts, wave.u.shape, strict=True))
        if self.low is None:
            du, dv, energy = self.series.slopes(*counts)
        else:
            ring = ring_of(counts[0], counts[1], wave.obscuration)
            du, dv = self.low.slopes(ring.cosine, ring.sine, ring.rho.ravel())
            energy = ring.share
        if not self.is_uniform:
            inner = np.s_[:-1] if self.wavefront.layout == "polar" else np.s_[:, 1:-1, 1:-1]
            energy = energy.copy()
            energy[inner] *= self.amplitude_series.at_nodes(*counts) ** 2
        return self._landing(du, dv, energy)

    def _landing(self, du: Array, dv: Array, energy: Array) -> Rays:
        from . import _wave_kernels

        x, y = np.empty(du.shape), np.empty(dv.shape)
        d = self.wavefront.image_distance
        steepest, reach = _wave_kernels.landing(du.ravel(), dv.ravel(), d, x.ravel(), y.ravel())
        return Rays(x, y, energy / energy.sum(), steepest, reach)

    @cached_property
    def _grid_cells(self) -> tuple[NDArray[np.int64], float]:
        """Labels of a grid's squares, the same within a cell, and what `mixed_area` counts.

        Squares that cells share have labels of their own, since whose wave they hold is chance.
        """
        wave = self.wavefront
        if wave.aperture is None or len(wave.aperture.cells) == 1:
            return np.zeros(wave.u.shape, dtype=np.int64), 0.0
        total, most, owners = wave.aperture.grid_shares(wave.u.shape[0], wave.pupil_pitch)
        shared = total - most
        labels = np.where(shared > 1e-9, -1 - np.arange(owners.size).reshape(owners.shape), owners)
        # how far apart the waves of neighbours in different cells are
        wide = 0.0
        phase = np.exp(1j * self.wavenumber * self.aberration)
        for axis in (0, 1):
            step = np.abs(np.diff(phase, axis=axis))
            lit = np.take(total, range(1, len(total)), axis) > 0
            lit &= np.take(total, range(len(total) - 1), axis) > 0
            across = lit & (np.diff(owners, axis=axis) != 0)
            wide = max(wide, float(np.max(step, where=across, initial=0.0)))
        return labels, wide * float(np.sum(shared) / np.sum(total))

    @property
    def mixed_area(self) -> float:
        """Share of the pupil in squares of a grid that hold the wave of another of its cells.

        Times the largest difference of neighbouring cells' pupil functions, 2 at most.
        """
        return self._grid_cells[1]

    def grid_jump(self) -> tuple[float, tuple[int, ...]]:
        """Largest step of the residual between lit neighbours, waves, and its pixel or node.

        Cells of an aperture may stand at any height.
        """
        wave = self.wavefront
        if wave.layout == "scattered":
            node = int(self.local.indices[self.local.jump_at])
            return self.local.jump / wave.wavelength, (node,)
        lit, (owners, _) = wave.amplitude * wave.weights > 0, self._grid_cells
        worst, where = 0.0, (0, 0)
        for axis in (0, 1):
            jump = np.abs(np.diff(self.aberration, axis=axis))
            both = lit[1:] & lit[:-1] if axis == 0 else lit[:, 1:] & lit[:, :-1]
            both = both & (np.diff(owners, axis=axis) == 0)
            jump = np.where(both, jump, 0.0)
            if jump.size and jump.max() > worst:
                worst = float(jump.max())
                row, column = np.unravel_index(np.argmax(jump), jump.shape)
                where = (int(row), int(column))
        return worst / wave.wavelength, where

    def _grid_slopes(self) -> tuple[Array, Array, Array]:
        """Central differences, one-sided where a neighbour is dark, 0 where both are."""
        wave = self.wavefront
        energy = wave.amplitude**2 * wave.weights
        lit = energy > 0
        slopes = []
        for axis in (1, 0):
            surface = np.moveaxis(self.aberration, axis, 1)
            mask, owner = np.moveaxis(lit, axis, 1), np.moveaxis(self._grid_cells[0], axis, 1)
            both = mask[:, 1:] & mask[:, :-1] & (np.diff(owner, axis=1) == 0)
            step = np.where(both, np.diff(surface, axis=1), 0.0)
            count = both.astype(np.float64)
            total, pairs = np.zeros_like(surface), np.zeros_like(surface)
            total[:, 1:] += step
            total[:, :-1] += step
            pairs[:, 1:] += count
            pairs[:, :-1] += count
            slope = total / (np.maximum(pairs, 1.0) * wave.pupil_pitch)
            slopes.append(np.moveaxis(slope, 1, axis))
        return slopes[0], slopes[1], energy


def split(wavefront: Wavefront) -> Residual:
    """Take piston and tilt, the least-squares plane weighted by amplitude, out of a wavefront."""
    scale = wavefront.pupil_radius
    size = wavefront.u.size
    if not wavefront.aberration.any():
        return Residual(wavefront, (0.0, 0.0), wavefront.aberration)
    if wavefront.layout == "polar" and size <= KEPT and wavefront.is_uniform:
        plane, project = _kept_plane(*wavefront.u.shape, wavefront.obscuration)
        # einsum without BLAS: the same bits for any thread count
        fit = np.einsum("ip,p->i", project, wavefront.aberration.ravel())
    else:
        plane = np.stack([np.ones_like(wavefront.u), wavefront.u / scale, wavefront.v / scale])
        fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, plane)
    aberration = wavefront.aberration - fit[0]
    aberration -= fit[1] * plane[1]
    aberration -= fit[2] * plane[2]
    return Residual(wavefront, (float(fit[1] / scale), float(fit[2] / scale)), aberration)


@lru_cache(maxsize=16)
def _kept_plane(n_r: int, n_theta: int, obscuration: float) -> tuple[Array, Array]:
    """Piston and tilts (3, n_r, n_theta) of even light, and what a node counts in each (3, nodes).

    Kept, and read-only.
    """
    u, v, weights = kept_polar_nodes(1.0, n_r, n_theta, obscuration)
    plane = np.stack([np.ones_like(u), u, v])
    return frozen(plane), frozen(projection(plane, weights))
