"""A wave without its piston and tilt, and the landing points of its rays in the image.

The tilt is an exact shift of the image, so only the residual aberration must be sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._vectors import Array
from ...errors import SamplingError
from .cell_series import CellSpectrum
from .fits import fitted_terms
from .polar_series import PolarSpectrum
from .scattered_fits import LocalFits, local_fits
from .wavefront import Wavefront


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of the residual aberration, one per node.

    Parameters
    ----------
    x, y : ndarray
        Landing points in the image, m, relative to the image point that the tilt shifts to. Their
        shape follows the wavefront's layout.
    energy : ndarray
        Fraction of the energy in each ray, of the shape of x; sum 1, 0 for rays from the rim.
    slope : float
        Largest gradient of the residual aberration, rad.
    reach : float
        Largest ``|x|`` or ``|y|``, m.
    """

    x: Array
    y: Array
    energy: Array
    slope: float
    reach: float

    def densest(self, side: float) -> float:
        """Return the largest fraction of the energy in a square bin of a side, m."""
        columns, rows = (np.rint(part / side).astype(np.int64) for part in (self.x, self.y))
        columns, rows = columns - columns.min(), rows - rows.min()
        index = rows * (columns.max() + 1) + columns
        return float(np.bincount(index.ravel(), weights=self.energy.ravel()).max())


class Heights(NamedTuple):
    """Minimum, maximum and mean aberration over the lit pupil, and rms about the mean, m."""

    low: float
    high: float
    mean: float
    rms: float


@dataclass(frozen=True, eq=False)
class Residual:
    """Wave separated into its tilt and the residual aberration without piston and tilt.

    Parameters
    ----------
    wavefront : Wavefront
        Wave with all its terms.
    tilt : (float, float)
        Slopes dW/du and dW/dv of the plane that fits the aberration W, by least squares weighted by
        the amplitude, rad.
    aberration : ndarray
        Aberration minus this plane (residual aberration), m, in the shape of ``wavefront.u``.
    """

    wavefront: Wavefront
    tilt: tuple[float, float]
    aberration: Array
    #: Whether a polynomial series interpolates the wave between its nodes.
    has_series: ClassVar[bool] = True

    @property
    def wavenumber(self) -> float:
        """Wavenumber, 2 pi/wavelength, 1/m."""
        return 2 * np.pi / self.wavefront.wavelength

    @property
    def airy_unit(self) -> float:
        """Airy unit: wavelength times F-number, m."""
        return self.wavefront.wavelength * self.wavefront.f_number

    @property
    def shift(self) -> tuple[float, float]:
        """Image shift (x, y) caused by the tilt, m."""
        d = self.wavefront.image_distance
        return self.tilt[0] * d, self.tilt[1] * d

    @cached_property
    def amplitude_sum(self) -> float:
        """Integral of the amplitude over the pupil, m^2."""
        return float(np.sum(self.wavefront.amplitude * self.wavefront.weights))

    @property
    def half_width(self) -> float:
        """Largest ``|u|`` or ``|v|`` at which light passes the pupil, m."""
        outline = self.wavefront.aperture
        return self.wavefront.pupil_radius if outline is None else outline.half_width

    @property
    def farthest(self) -> float:
        """Largest distance from the axis at which light passes the pupil, m."""
        outline = self.wavefront.aperture
        return self.wavefront.pupil_radius if outline is None else outline.bounding_radius

    @property
    def is_round(self) -> bool:
        """Whether the pupil is known to be a disc or ring."""
        return self.has_series and self.wavefront.aperture is None

    @property
    def is_disc(self) -> bool:
        """Whether the pupil is known to be a full disc."""
        return self.is_round and self.wavefront.obscuration == 0

    @property
    def nyquist_pitch(self) -> float:
        """Nyquist pitch of the image, m: largest distance of samples that resolves the intensity.

        It is lambda N/2 for a round pupil, with the wavelength lambda and the F-number N.
        """
        wave = self.wavefront
        return wave.wavelength * abs(wave.image_distance) / (4 * self.half_width)

    @cached_property
    def energy(self) -> float:
        """Integral of the squared amplitude over the pupil, m^2."""
        return float(np.sum(self.wavefront.amplitude**2 * self.wavefront.weights))

    def pixel_share(self, pitch: float) -> float:
        """Return the energy in a small pixel at the peak of the image without aberration.

        Parameters
        ----------
        pitch : float
            Pixel side, m.

        Returns
        -------
        float
            Peak intensity times pixel area, as a fraction of the transmitted energy. It exceeds 1
            for a pixel much wider than the Airy disc.
        """
        wave = self.wavefront
        area = (pitch * self.amplitude_sum) ** 2
        return area / (self.energy * (wave.wavelength * wave.image_distance) ** 2)

    @property
    def is_uniform(self) -> bool:
        """Whether the amplitude is the same at every node."""
        return self.wavefront.is_uniform

    @cached_property
    def heights(self) -> Heights:
        """Extremes, mean and rms of the residual aberration over the lit pupil.

        The extremes include those on the rims, where no node of a series lies.
        """
        share, path = self.wavefront.amplitude * self.wavefront.weights, self.aberration
        lit, total = path[share > 0], float(np.sum(share))
        mean = float(np.sum(share * path)) / total
        square = float(np.sum(share * (path - mean) ** 2)) / total
        if self.has_series and not self.is_plane:
            lit = np.append(lit, self.series.on_rims())
        return Heights(float(lit.min()), float(lit.max()), mean, math.sqrt(square))

    @property
    def is_plane(self) -> bool:
        """Whether the residual is exactly 0."""
        return not self.aberration.any()

    @property
    def is_flat(self) -> bool:
        """Whether the wave has a uniform amplitude and a residual of exactly 0."""
        return self.is_uniform and self.is_plane

    @cached_property
    def series(self) -> PolarSpectrum | CellSpectrum:
        """Polynomial series of the residual aberration; `SamplingError` without `has_series`."""
        return self.wavefront.series(self.aberration)

    @cached_property
    def amplitude_series(self) -> PolarSpectrum | CellSpectrum:
        """Polynomial series of the amplitude; `SamplingError` without `has_series`."""
        return self.wavefront.series(self.wavefront.amplitude)

    @property
    def polar_series(self) -> tuple[PolarSpectrum, PolarSpectrum | None]:
        """Series of a polar residual aberration, and of the amplitude or None if it is uniform.

        Raises
        ------
        SamplingError
            If the wavefront is not polar.
        """
        pair = self.series, None if self.is_uniform else self.amplitude_series
        if isinstance(pair[0], CellSpectrum) or isinstance(pair[1], CellSpectrum):
            raise SamplingError(
                "a wavefront of layout 'cells' cannot be resampled to a grid; sample it with "
                "nodes='grid'"
            )
        return pair[0], pair[1]

    @cached_property
    def truncation(self) -> float:
        """Estimated relative error of the pupil function from too few nodes of its series."""
        amplitude = 0.0
        if not self.is_uniform:
            amplitude = self.amplitude_series.truncation() / float(self.wavefront.amplitude.max())
        return self.wavenumber * self.series.truncation() + amplitude

    @cached_property
    def rays(self) -> Rays:
        """One ray per node; of a series, also rays from the rims."""
        return self.traced(*self.wavefront.u.shape)

    def traced(self, *counts: int) -> Rays:
        """Return rays from at least the given number of nodes of a series, and from the rims.

        ``counts`` is the shape of `Wavefront.nodes`.
        """
        if self.is_flat:  # all rays land in one point
            return Rays(np.zeros((1, 1)), np.zeros((1, 1)), np.ones((1, 1)), 0.0, 0.0)
        counts = tuple(max(pair) for pair in zip(counts, self.wavefront.u.shape, strict=True))
        du, dv, energy = self.series.slopes(*counts)
        if not self.is_uniform:
            energy = energy.copy()
            energy[self.series.inner] *= self.amplitude_series.at_nodes(*counts) ** 2
        return self._landing(du, dv, energy)

    def dense_rays(self, n: int) -> Rays:
        """Return rays from about ``n`` nodes across the pupil, as far as a series allows it."""
        return self.traced(*self.series.mesh(n, 400))

    def _landing(self, du: Array, dv: Array, energy: Array) -> Rays:
        """Return the rays of given slopes, with their energies normalised to sum 1."""
        slope = math.sqrt(np.max(du * du + dv * dv))
        x, y = du * self.wavefront.image_distance, dv * self.wavefront.image_distance
        reach = float(max(np.abs(x).max(), np.abs(y).max()))
        return Rays(x, y, energy / energy.sum(), slope, reach)

    # Properties of samples; those of a series are here, those of grids and scattered points below.

    @cached_property
    def local(self) -> LocalFits:
        """Cubic fits about the lit nodes."""
        return local_fits(self.wavefront, self.aberration)

    @property
    def spacing(self) -> float:
        """Distance between neighbouring samples, m; 0 for a series."""
        return 0.0

    @property
    def full_period(self) -> tuple[float, int] | None:
        """Pitch, m, and number of samples across a period of the image; None if none is exact."""
        return None

    @property
    def mixed_area(self) -> float:
        """Estimated relative error from samples that several aperture cells share."""
        return 0.0

    def jump(self) -> tuple[float, tuple[int, ...]]:
        """Return the largest step between neighbouring samples, waves, and its index."""
        return 0.0, ()


class _Sampled(Residual):
    """Wave that is known at its samples only: no series interpolates it."""

    has_series = False

    @cached_property
    def truncation(self) -> float:
        """Error of interpolation: there is none."""
        return 0.0

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Samples that light passes."""
        return np.asarray(self.wavefront.amplitude * self.wavefront.weights > 0)

    @property
    def half_width(self) -> float:
        """Largest ``|u|`` or ``|v|`` of a lit sample, m."""
        wave, lit = self.wavefront, self.lit
        return float(max(np.abs(wave.u[lit]).max(), np.abs(wave.v[lit]).max()))

    @property
    def farthest(self) -> float:
        """Largest distance of a lit sample from the axis, m."""
        wave, lit = self.wavefront, self.lit
        return math.sqrt(float((wave.u[lit] ** 2 + wave.v[lit] ** 2).max()))

    def dense_rays(self, n: int) -> Rays:
        """Return the rays of the samples."""
        return self.rays


class ScatteredResidual(_Sampled):
    """Wave at arbitrary points of a disc or ring."""

    @property
    def half_width(self) -> float:
        """Largest ``|u|`` or ``|v|`` of a lit sample or of the rim, m."""
        return max(super().half_width, self.wavefront.pupil_radius)

    @property
    def farthest(self) -> float:
        """Largest distance of a lit sample or of the rim from the axis, m."""
        return max(super().farthest, self.wavefront.pupil_radius)

    @property
    def spacing(self) -> float:
        """Square root of the mean area of lit samples, m."""
        return float(np.sqrt(self.wavefront.weights.ravel()[self.local.indices].mean()))

    @cached_property
    def rays(self) -> Rays:
        """One ray per lit sample."""
        wave, lit = self.wavefront, self.local.indices
        du, dv = self.local.slopes.T
        return self._landing(du, dv, wave.amplitude[lit] ** 2 * wave.weights[lit])

    def jump(self) -> tuple[float, tuple[int, ...]]:
        """Return the largest step between neighbouring samples, waves, and its index."""
        node = int(self.local.indices[self.local.jump_at])
        return self.local.jump / self.wavefront.wavelength, (node,)


class GridResidual(_Sampled):
    """Wave on the squares of a grid."""

    @property
    def half_width(self) -> float:
        """Largest ``|u|`` or ``|v|`` at which light passes the pupil, m."""
        wave = self.wavefront
        if wave.aperture is not None:
            return wave.aperture.half_width
        edge = super().half_width + wave.pupil_pitch / 2
        # A rim cell of an area-weighted grid extends beyond the pupil; a map's cells are whole.
        return edge if np.ptp(wave.weights) == 0 else min(edge, wave.pupil_radius)

    @property
    def spacing(self) -> float:
        """Pitch of the grid, m."""
        return self.wavefront.pupil_pitch

    @property
    def full_period(self) -> tuple[float, int]:
        """Pitch, m, and number of samples across a period of the image.

        Samples are Nyquist's, or slightly closer: a whole number of them per period.
        """
        size = math.ceil(4 * self.half_width / self.spacing - 1e-9)
        wave = self.wavefront
        return wave.wavelength * abs(wave.image_distance) / (size * self.spacing), size

    @cached_property
    def rays(self) -> Rays:
        """One ray per sample.

        Its slopes are central differences, one-sided where one neighbour is dark, 0 where both are.
        """
        wave, slopes = self.wavefront, []
        for axis in (1, 0):
            total, pairs = np.zeros_like(wave.u), np.zeros_like(wave.u)
            sides = (np.s_[1:], np.s_[:-1]) if axis == 0 else (np.s_[:, 1:], np.s_[:, :-1])
            step, both = self._steps(axis)
            for side in sides:
                total[side] += step
                pairs[side] += both
            slopes.append(total / (np.maximum(pairs, 1.0) * wave.pupil_pitch))
        return self._landing(slopes[0], slopes[1], wave.amplitude**2 * wave.weights)

    def _steps(self, axis: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return the steps between neighbours along an axis, and where they are of the wave.

        Elsewhere they are 0: between a lit sample and a dark one, and between different cells of an
        aperture, since segments may have any piston.
        """
        both = np.diff(self._cells[0], axis=axis) == 0
        return np.where(both, np.diff(self.aberration, axis=axis), 0.0), both

    @cached_property
    def _cells(self) -> tuple[NDArray[np.int64], float]:
        """Label of the aperture cell of each lit grid square, and the value of `mixed_area`.

        A dark square has a label of its own, and so has one that several cells share: its sample
        holds the wave of only one of them, so that differences with its neighbours are not slopes.
        """
        wave, whole, mixed = self.wavefront, self.lit, 0.0
        owners = np.zeros(wave.u.shape, dtype=np.int64)
        if wave.aperture is not None and len(wave.aperture.cells) > 1:
            total, most, owners = wave.aperture.grid_shares(wave.u.shape[0], wave.pupil_pitch)
            shared = total - most
            whole = whole & (shared <= 1e-9)
            # Largest difference of the pupil function between neighbours in different cells.
            wide = 0.0
            phase = np.exp(1j * self.wavenumber * self.aberration)
            for axis in (0, 1):
                step = np.abs(np.diff(phase, axis=axis))
                inside = np.take(total, range(1, len(total)), axis) > 0
                inside &= np.take(total, range(len(total) - 1), axis) > 0
                across = inside & (np.diff(owners, axis=axis) != 0)
                wide = max(wide, float(np.max(step, where=across, initial=0.0)))
            mixed = wide * float(np.sum(shared) / np.sum(total))
        return np.where(whole, owners, -1 - np.arange(owners.size).reshape(owners.shape)), mixed

    @property
    def mixed_area(self) -> float:
        """Estimated relative error from grid squares that several aperture cells share.

        It is the fraction of the pupil's area that is sampled with another cell's wave, times the
        largest difference of neighbouring cells' pupil functions, which is at most 2.
        """
        return self._cells[1]

    def jump(self) -> tuple[float, tuple[int, ...]]:
        """Return the largest step of the residual between lit neighbours, waves, and its index."""
        steps = [np.abs(self._steps(axis)[0]) for axis in (0, 1)]
        largest = max(steps, key=np.max)  # that along the first axis if both are equal
        row, column = np.unravel_index(np.argmax(largest), largest.shape)
        return float(largest.max()) / self.wavefront.wavelength, (int(row), int(column))


def split(wavefront: Wavefront) -> Residual:
    """Remove piston and tilt from a wavefront: its amplitude-weighted least-squares plane."""
    scale = wavefront.pupil_radius
    made = {"grid": GridResidual, "scattered": ScatteredResidual}.get(wavefront.layout, Residual)
    if not wavefront.aberration.any():
        return made(wavefront, (0.0, 0.0), wavefront.aberration)
    plane = np.stack([np.ones_like(wavefront.u), wavefront.u / scale, wavefront.v / scale])
    fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, plane)
    aberration = wavefront.aberration - fit[0]
    aberration -= fit[1] * plane[1]
    aberration -= fit[2] * plane[2]
    return made(wavefront, (float(fit[1] / scale), float(fit[2] / scale)), aberration)
