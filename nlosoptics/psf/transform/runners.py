"""Run a given transform: one function for each method of `point_spread`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from ..wave.detilted import Residual
from ..window import antialiased_disc, error_bounds
from ..window.grids import PupilGrid, pupil_grid, pupil_grid_from_polar
from ..window.pixels import PixelRule
from ..window.window import Window
from . import (
    airy,
    antialiased_fft,
    antialiased_pupil,
    fft,
    geometric,
    mdft,
    nufft,
    quadrature,
)

Array = NDArray[np.float64]
#: Least number of samples across the pupil if a polar wave is resampled to a grid.
LEAST_SAMPLES = 512
#: Pixel side, Airy units, up to which errors are assumed not to average out over a pixel.
NO_BEATS = 0.8
#: Phase, rad, below which series terms of a polar wavefront need not be resolved by its nodes.
NEGLIGIBLE = 1e-10


class SoftTask(NamedTuple):
    """Polynomial wave, what its rim's errors depend on, and its image period in Airy units."""

    wave: antialiased_pupil.SoftWave
    rim: antialiased_pupil.Rim
    period: float

    def grid(self, task: Task, method: str) -> antialiased_fft.Grid:
        """Return the pupil grid for ``"fft"`` or ``"mdft"``."""
        reach = antialiased_disc.SHORT_REACH if task.tol >= 1e-4 else antialiased_disc.REACH
        if method == "fft":
            return antialiased_fft.padded(task.residual, task.samples, self.period, reach)
        return antialiased_fft.whole(task.residual, self.period, reach)

    def n_bytes(self, task: Task, method: str) -> float:
        """Return the peak memory of ``"fft"`` or ``"mdft"``, bytes."""
        grid, folded = self.grid(task, method), method == "mdft"
        need = antialiased_fft.folded_bytes if folded else antialiased_fft.padded_bytes
        return need(task.samples, grid, task.rule)


@dataclass(frozen=True, eq=False)
class Task:
    """Input of every transform.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    tol : float
        Largest permitted error, relative to the peak.
    pitch : float
        Image sampling or pixel side, m.
    shape : (int, int)
        (ny, nx).
    rule : PixelRule or None
        Average over pixels; None for point samples.
    whole : bool
        Whether the window holds the rays.
    """

    residual: Residual
    tol: float
    pitch: float
    shape: tuple[int, int]
    rule: PixelRule | None
    whole: bool = True

    @property
    def pixels(self) -> Window:
        """Sample points or pixel centres of the result."""
        return Window.centred(self.pitch, self.shape)

    @property
    def samples(self) -> Window:
        """Points at which the intensity is computed; finer than `pixels` for pixel averages."""
        return self.pixels if self.rule is None else self.rule.window(self.pitch, self.shape)

    @property
    def level(self) -> float:
        """Fraction of the transmitted energy in a pixel whose mean is the ideal peak."""
        return self.residual.pixel_share(self.pitch)

    @property
    def pixel(self) -> float:
        """Pixel side used in error bounds, Airy units; 0 for point samples.

        With an aperture at most `NO_BEATS`, since its lobes may be wider than an Airy unit.
        """
        pixel = 0.0 if self.rule is None else self.pitch / self.residual.airy_unit
        return pixel if self.residual.wavefront.aperture is None else min(pixel, NO_BEATS)

    @cached_property
    def soft(self) -> SoftTask | None:
        """Input of the softened-grid transforms; None if the wave is not polynomial."""
        found = antialiased_pupil.soft_wave(self.residual, self.tol)
        if found is None:
            return None
        rim = antialiased_pupil.rim_of(self.residual, found)
        period = antialiased_pupil.period_of(self.residual, rim, self.samples, self.tol)
        return SoftTask(found, rim, period)

    @cached_property
    def coarse(self) -> quadrature.Coarse:
        """Nodes of a wave on cells that suffice for ``tol`` in a window with a dark edge."""
        residual, samples = self.residual, self.samples
        peak = antialiased_pupil.predicted_peak(residual)
        reach = min(samples.shape) * samples.pitch / 2 - math.hypot(*residual.shift)
        beyond = np.asarray(max(reach - residual.rays.reach, 0.0)) / residual.airy_unit
        # Straight edges of a rim make spikes, with a field above that of a clear disc.
        dark = min(3 * float(error_bounds.tail(beyond)), math.sqrt(peak))
        return quadrature.coarse(residual, samples, self.tol, peak, dark)

    def bound(
        self,
        intensity: Array,
        field_error: Array | float,
        energy_error: float,
        spill: Array | float = 0.0,
    ) -> float:
        """Return an upper bound of the error relative to the peak, on these pixels."""
        return error_bounds.intensity_error(
            intensity,
            field_error,
            energy_error,
            spill=spill,
            pixel=self.pixel,
            level=self.level,
        )

    def transform_error(self, mean: Array, epsilon: float) -> float:
        """Bound the error of the NUFFT by `error_bounds.transform_error` on these pixels."""
        if self.whole:
            return error_bounds.transform_error(mean, epsilon, pixel=self.pixel)
        # light outside the window, a field of at most 1, leaks into it
        return 2 * epsilon / math.sqrt(float(mean.max())) + epsilon**2 / float(mean.max())

    def means(self, field: NDArray[np.complexfloating]) -> Array:
        """Return the intensity of a field at `samples`, averaged over pixels if required."""
        return self.averaged(field.real**2 + field.imag**2)

    def averaged(self, fine: Array) -> Array:
        """Return an intensity at `samples`, averaged over pixels if required."""
        if self.rule is None:
            return fine
        return self.rule.mean_down(self.rule.mean(fine))


@dataclass(frozen=True, eq=False)
class Result:
    """Output of a transform.

    Parameters
    ----------
    method : str
        Name of the method.
    mean : ndarray, (ny, nx)
        Intensity at points, or averaged over pixels; 1 at the ideal peak.
    error : float
        Upper bound of the error, relative to the largest intensity.
    level : float
        Factor from ``mean`` to the fraction of the transmitted energy per pixel.
    """

    method: str
    mean: Array
    error: float
    level: float


def transform(task: Task, method: str) -> Result:
    """Run a transform by name; raise `SamplingError` if the wave's layout does not allow it."""
    run: dict[str, Callable[[Task], tuple[Array, float]]] = {
        "airy": _airy,
        "quadrature": _quadrature,
        "fft": _fft,
        "mdft": _mdft,
        "nufft": _nufft,
        "geometric": _geometric,
    }
    mean, error = run[method](task)
    return Result(method, mean, error, task.level)


def _airy(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by the closed form without aberration."""
    residual = task.residual
    if residual.wavefront.layout != "polar":
        raise SamplingError(
            "the closed form needs a wavefront of layout 'polar', not "
            f"'{residual.wavefront.layout}'; sample it with nodes='polar', or use "
            f"method='{_sum_of(residual)}'"
        )
    bound = airy.error_bound(residual)
    if math.isinf(bound):
        raise SamplingError(
            f"the residual aberration reaches {_waves(residual):.3g} waves, too much for the "
            "closed form; use method='quadrature'"
        )
    samples = task.samples
    fits_memory("the closed form", 64.0 * samples.shape[0] * samples.shape[1], "use fewer pixels")
    filtering = 0.0 if task.rule is None else error_bounds.FILTER
    return task.averaged(airy.intensity(residual, samples)), bound + filtering


def _quadrature(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by a sum over polar or cell nodes."""
    residual = task.residual
    if not residual.wavefront.is_spectral:
        raise SamplingError(
            "quadrature needs a wavefront of layout 'polar' or 'cells', not "
            f"'{residual.wavefront.layout}'; sample it with nodes='cells' or nodes='polar', or use "
            f"method='{_sum_of(residual)}'"
        )
    epsilon = quadrature.epsilon(residual, task.samples, task.tol)
    mean = task.means(quadrature.field(residual, task.samples, epsilon))
    lost = residual.truncation
    return mean, task.bound(mean, lost, lost**2) + task.transform_error(mean, epsilon)


def _fft(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by a zero-padded FFT of a grid."""
    residual, samples = task.residual, task.samples
    if residual.wavefront.layout == "cells":
        return _cells(task)
    _check_not_scattered(residual, "fft")
    soft = _soft(task, "fft")
    if soft is not None:
        return soft
    fft.check_padding(residual, samples.pitch)
    if residual.wavefront.layout == "polar":
        size = polar_size(task)
        grid = pupil_grid_from_polar(residual, grid_period_pitch(task, size))
        _check_jump(task, grid.jump, None)
    else:
        if task.rule is not None:
            raise SamplingError(
                "fft samples the image of a grid wavefront at a pitch of its own, which does not "
                "divide the pixels; use method='mdft' with pixel_integrated=True"
            )
        size = fft.padded_size(residual, samples.pitch)
        _check_jump(task, *residual.grid_jump())
        _check_period(task)
        grid = pupil_grid(residual)
    fits_memory(
        f"the transform of {grid.values.shape[0]} x {size} samples",
        48.0 * grid.values.shape[0] * size,
        "use a smaller shape",
    )
    mean = fft.intensity_in(residual, grid, samples, size, task.rule)
    return mean, grid_bound(task, mean, grid)


def _cells(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by a sum over as few nodes as ``tol`` allows."""
    nodes = task.coarse
    image = _cells_image(task, nodes)
    bright = antialiased_pupil.predicted_peak(task.residual)
    if image[1] > task.tol:  # the edge may be brighter than predicted
        more = quadrature.coarse(task.residual, task.samples, task.tol, bright, math.sqrt(bright))
        if more != nodes:
            image = _cells_image(task, more)
    return image


def _cells_image(task: Task, nodes: quadrature.Coarse) -> tuple[Array, float]:
    """Return the image of a wave on cells, and its error bound from that of each block."""
    residual = task.residual
    mean = task.means(quadrature.field(residual, task.samples, nodes.epsilon, nodes.counts))
    half = 0.0 if task.rule is None else task.pitch / 2
    strongest, far = antialiased_pupil.block_maxima(residual, task.pixels, mean, half)
    error = residual.truncation + nodes.field_errors(residual, far)
    rounding = 2 * task.transform_error(mean, nodes.epsilon)
    return mean, task.bound(strongest, error, math.inf) + rounding


def _soft(task: Task, method: str) -> tuple[Array, float] | None:
    """Transform a polynomial wave by ``fft`` or ``mdft``; return None if it is not polynomial."""
    soft = task.soft
    if soft is None:
        return None
    image = _soft_image(task, soft, method)
    if task.tol < image[1] < 8 * task.tol:
        # The peak is lower than predicted, so that the relative error is larger.
        period = antialiased_pupil.period_of(task.residual, soft.rim, task.samples, task.tol / 8)
        image = _soft_image(task, soft._replace(period=period), method)
    return image


def _soft_image(task: Task, soft: SoftTask, method: str) -> tuple[Array, float]:
    """Return the image of a polynomial wave from its softened grid, and its error bound."""
    residual, wave, grid = task.residual, soft.wave, soft.grid(task, method)
    run = antialiased_fft.padded_image if method == "fft" else antialiased_fft.folded_image
    mean = run(residual, wave, task.samples, grid, task.rule)
    half = 0.0 if task.rule is None else task.pitch / 2
    strongest, far = antialiased_pupil.block_maxima(residual, task.pixels, mean, half)
    rings, unit = antialiased_pupil.RINGS * far.max(), residual.airy_unit
    ring = np.minimum(np.searchsorted(rings, far), rings.size - 1)
    error = soft.rim.errors(rings / unit, grid.period / unit)[ring]
    lost = residual.truncation + wave.misfit * wave.strength + grid.error
    return mean, task.bound(strongest, error + lost, math.inf)


def _mdft(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by a transform of a grid to any pitch."""
    residual, samples = task.residual, task.samples
    if residual.wavefront.layout == "cells":
        raise SamplingError(
            "mdft needs a grid, and this wavefront has the layout 'cells'; use method='fft', or "
            "sample it with nodes='grid'"
        )
    _check_not_scattered(residual, "mdft")
    soft = _soft(task, "mdft")
    if soft is not None:
        return soft
    if residual.wavefront.layout == "polar":
        grid = pupil_grid_from_polar(residual, grid_period_pitch(task, polar_size(task)))
        _check_jump(task, grid.jump, None)
    else:
        grid = checked_grid(task)
    n = grid.values.shape[0]
    fits_memory(
        f"the transform of {n} samples to {samples.shape[0]} x {samples.shape[1]}",
        144.0 * n * n + 48.0 * n * max(samples.shape) + 72.0 * math.prod(samples.shape),
        "use a smaller shape",
    )
    mean = mdft.intensity_in(residual, grid, samples, task.rule)
    return mean, grid_bound(task, mean, grid)


def _check_not_scattered(residual: Residual, method: str) -> None:
    """Refuse scattered nodes for a method that needs a grid."""
    if residual.wavefront.layout == "scattered":
        raise SamplingError(
            f"{method} needs a grid, and this wavefront is scattered; use method='nufft', or "
            "sample it with nodes='polar' or 'grid'"
        )


def _sum_of(residual: Residual) -> str:
    """Return the method that uses the given nodes of this layout."""
    layout = residual.wavefront.layout
    return {"cells": "quadrature", "grid": "mdft"}.get(layout, "nufft")


def _nufft(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by a sum over the given nodes."""
    residual, samples = task.residual, task.samples
    wave = residual.wavefront
    if wave.is_spectral:
        need = quadrature.node_counts(residual, samples, NEGLIGIBLE)
        if need != wave.u.shape:
            now, wanted = (" x ".join(map(str, n)) for n in (wave.u.shape, need))
            raise SamplingError(
                f"{now} {wave.layout} nodes are too few for this window, which needs {wanted}; use "
                f"wavefront.resampled{need[-2:]}, a smaller shape, or method='quadrature'"
            )
    else:
        check_sampling(task)
    epsilon = nufft.epsilon(wave.u.size, samples, task.tol)
    mean = task.means(nufft.field(residual, samples, epsilon))
    rounding = task.transform_error(mean, epsilon)
    if wave.is_spectral:
        lost = residual.truncation + 10 * NEGLIGIBLE
        return mean, task.bound(mean, lost, lost**2) + rounding
    if wave.layout == "grid":
        return mean, grid_bound(task, mean, pupil_grid(residual)) + rounding
    return mean, _scattered_bound(task, mean, epsilon) + rounding


def _scattered_bound(task: Task, mean: Array, epsilon: float) -> float:
    """Bound the error of scattered nodes by comparison with polar nodes of the same wave."""
    wave = task.residual.wavefront
    field, total, true_energy, doubt = nufft.reference(task.residual, task.samples, epsilon)
    better = task.means(field)
    energy = float(np.sum(wave.amplitude**2 * wave.weights))
    flux = (total / task.residual.amplitude_sum) ** 2
    # factors for the three normalisations: ideal-peak, flux, unit-sum
    levels = (1.0, flux, flux * energy / true_energy)
    worst = max(float(np.abs(better * level - mean).max()) for level in levels)
    return 1.2 * worst / float(mean.max()) + task.bound(mean, doubt, doubt**2)


def _geometric(task: Task) -> tuple[Array, float]:
    """Compute mean intensity and error bound by the density of rays."""
    if task.rule is None:
        raise SamplingError(
            "rays give the energy per pixel, not the intensity at points; use pixel_integrated=True"
        )
    energy, error = geometric.density(task.residual, task.pixels)
    return energy / task.level, error


def grid_bound(task: Task, mean: Array, grid: PupilGrid) -> float:
    """Bound the error of a pupil grid's edge, its truncation and its damping."""
    half = 0.0 if task.rule is None else task.pitch / 2
    found = error_bounds.edge_errors(task.residual, grid, task.pixels.x, task.pixels.y, half)
    lost = task.residual.truncation
    bound = task.bound(mean, found.field + lost, found.energy + lost**2, found.spill)
    if task.rule is None:
        return bound
    return bound + error_bounds.damping_error(task.residual, grid, task.pitch)


def checked_grid(task: Task) -> PupilGrid:
    """Return the pupil of a grid wavefront, after checks of its sampling."""
    check_sampling(task)
    return pupil_grid(task.residual)


def check_sampling(task: Task) -> None:
    """Refuse grid or scattered nodes that are too few for the wave or for the window."""
    _check_jump(task, *task.residual.grid_jump())
    _check_period(task)


def polar_size(task: Task) -> int:
    """Return the padded transform size for a polar wave: image period over sampling pitch."""
    residual, samples = task.residual, task.samples
    reach = max(samples.reach_from(residual.shift))
    # Three lower limits of the period: twice the window's reach; the spot's diameter and a margin
    # for the step of `antialiased_disc.leak`; `LEAST_SAMPLES` across the pupil.
    period = max(
        2 * reach,
        4.4 * residual.rays.reach + 16 * residual.airy_unit,
        LEAST_SAMPLES * residual.airy_unit,
    )
    return int(np.ceil(period / samples.pitch - 1e-9))


def grid_period_pitch(task: Task, size: int) -> float:
    """Return the pupil pitch, m, at which the image repeats after ``size`` samples."""
    wave = task.residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / (size * task.samples.pitch)


def _check_jump(task: Task, jump: float, pixel: tuple[int, ...] | None) -> None:
    """Refuse a wave whose aberration steps by more than half a wave between neighbours."""
    if jump > 0.5:
        wave = task.residual.wavefront
        n = wave.u.shape[0]
        where, need = "", math.ceil(n * jump / 0.5)
        if wave.layout != "polar":
            where = f" at {'pixel' if wave.layout == 'grid' else 'node'} {pixel}"
            power = 2 if wave.layout == "scattered" else 1
            # The remedy must also satisfy `_check_period`.
            more = max(jump / 0.5, _period_share(task))
            # A margin: in a denser set of scattered nodes, another pair may be the farthest apart.
            more *= 1.2 if power == 2 else 1.0
            need = math.ceil(n * more**power)
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves{where}, limit 0.50; use {need} or more pupil "
            f"samples (now {n}), or polar nodes"
        )


def _period_share(task: Task) -> float:
    """Return the least image period at which no repeat overlaps the window, over the period."""
    residual = task.residual
    wave = residual.wavefront
    need = max(task.pixels.reach_from(residual.shift)) + residual.rays.reach
    if task.rule is not None:  # up to the edges of the pixels, and the core of the repeat
        need += task.pitch / 2 + residual.airy_unit
    return need * residual.spacing / (wave.wavelength * abs(wave.image_distance))


def _check_period(task: Task) -> None:
    """Refuse a window that overlaps a repeat of the spot due to the pupil's sampling."""
    residual = task.residual
    wave = residual.wavefront
    period = wave.wavelength * abs(wave.image_distance) / residual.spacing
    need = _period_share(task) * period
    if need > period * (1 + 1e-9):
        n = wave.u.shape[0]
        more = (need / period) ** (2 if wave.layout == "scattered" else 1)
        raise SamplingError(
            f"the pupil samples repeat the spot every {period:.3g} m, inside the window, which "
            f"needs {need:.3g} m; use {math.ceil(n * more)} or more pupil samples (now "
            f"{n}), or a smaller shape"
        )


def _waves(residual: Residual) -> float:
    """Return the largest modulus of the residual aberration, waves."""
    return float(np.abs(residual.aberration).max()) / residual.wavefront.wavelength
