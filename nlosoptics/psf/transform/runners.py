"""Run a given transform: one function for each method of `point_spread`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from ..wave.detilted import Residual
from ..window import error_bounds
from ..window.grids import PupilGrid, pupil_grid
from ..window.pixels import PixelRule
from ..window.window import Window
from . import (
    airy,
    geometric,
    high_aperture,
    mdft,
    nufft,
    quadrature,
)

Array = NDArray[np.float64]
#: Methods for each layout; the first sums over nodes of the wave and computes any part of an image.
ABLE = {
    "polar": ("quadrature", "nufft", "fft", "airy", "geometric"),
    "cells": ("quadrature", "nufft", "fft", "geometric"),
    "grid": ("mdft", "nufft", "fft", "geometric"),
    "scattered": ("nufft", "geometric"),
}
#: Pixel side, Airy units, up to which errors are assumed not to average out over a pixel.
NO_BEATS = 0.8


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
    polarisation : "unpolarised" or float, optional
        Polarisation of the high-aperture model; None for the scalar model.
    """

    residual: Residual
    tol: float
    pitch: float
    shape: tuple[int, int]
    rule: PixelRule | None
    whole: bool = True
    polarisation: high_aperture.Polarisation | None = None

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
    def coarse(self) -> quadrature.Coarse:
        """Nodes of a polar or cells wave that suffice for ``tol``, in a window with a dark edge."""
        return quadrature.coarse(self.residual, self.samples, self.tol, self.growth)

    @cached_property
    def growth(self) -> Array:
        """Error of the nodes of a polar or cells wave without image point and count."""
        return quadrature.growth(self.residual)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Shape of the nodes of a polar or cells wave that the window needs."""
        counts = quadrature.node_counts(self.residual, self.samples, self.growth)
        if self.polarisation is None:
            return counts
        more = high_aperture.more_nodes(self.residual)
        return tuple(n + extra for n, extra in zip(counts, more, strict=True))

    @property
    def components(self) -> int:
        """Number of transforms of the model."""
        if self.polarisation is None:
            return 1
        return 5 if isinstance(self.polarisation, str) else 3

    def weights(self, u: Array, v: Array) -> list[Array | float]:
        """Return the weights of the field's components at pupil coordinates, m."""
        distance = self.residual.wavefront.image_distance
        return high_aperture.field_weights(u, v, distance, self.polarisation)

    def levels(self, nodes: nufft.Nodes) -> tuple[float, float]:
        """Return `high_aperture.levels` of nodes."""
        distance = self.residual.wavefront.image_distance
        return high_aperture.levels(nodes, distance, self.polarisation)

    def gain(self, peak: float) -> float:
        """Return the largest weight of a node relative to the square root of the ideal peak."""
        if self.polarisation is None:
            return 1.0
        sine = high_aperture.check_cone(self.residual)
        return 1 / math.sqrt(peak * math.sqrt(1 - sine**2))

    def sum(self, nodes: nufft.Nodes, epsilon: float) -> tuple[Array, float, float]:
        """Return the mean intensity of a sum over nodes, 1 at the ideal peak, and `levels`."""
        peak, secant = self.levels(nodes)
        fields = (
            nufft.field(self.residual, nodes, self.samples, epsilon, weight)
            for weight in self.weights(nodes.u, nodes.v)
        )
        mean = self.averaged(reduce(np.add, map(nufft.squares, fields)))
        mean /= peak
        return mean, peak, secant

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
    reason : str
        One line: why this method and this model were used.
    model : {"scalar", "high-aperture"}
        Model of diffraction.
    model_error : float
        Upper bound of the scalar model's error relative to the peak; 0 for the high-aperture model.
    """

    method: str
    mean: Array
    error: float
    level: float
    reason: str = ""
    model: str = "high-aperture"
    model_error: float = 0.0


#: Mean intensity, error relative to its peak, and factor from `Task.level` to `Result.level`.
Image = tuple[Array, float, float]


def transform(task: Task, method: str) -> Result:
    """Run a transform by name; raise `SamplingError` if the wave's layout does not allow it."""
    run: dict[str, Callable[[Task], Image]] = {
        "airy": _airy,
        "quadrature": _quadrature,
        "fft": _fft,
        "mdft": _mdft,
        "nufft": _nufft,
        "geometric": _geometric,
    }
    layout = task.residual.wavefront.layout
    able = ABLE[layout] if task.polarisation is None else (ABLE[layout][0], "geometric")
    if method not in able:
        model = "" if task.polarisation is None else " by the high-aperture model"
        raise SamplingError(
            f"method = '{method}' cannot transform{model} a wavefront of layout '{layout}'; use "
            f"method='{able[0]}' or 'auto', or sample the wave with other nodes"
        )
    mean, error, ratio = run[method](task)
    return Result(method, mean, error, task.level * ratio)


def _airy(task: Task) -> Image:
    """Compute mean intensity and error bound by the closed form without aberration."""
    residual = task.residual
    bound = airy.error_bound(residual)
    if math.isinf(bound):
        raise SamplingError(
            f"the residual aberration reaches {_waves(residual):.3g} waves, too much for the "
            "closed form; use method='quadrature'"
        )
    samples = task.samples
    fits_memory("the closed form", 64.0 * samples.shape[0] * samples.shape[1], "use fewer pixels")
    filtering = 0.0 if task.rule is None else error_bounds.FILTER
    return task.averaged(airy.intensity(residual, samples)), bound + filtering, 1.0


def _quadrature(task: Task) -> Image:
    """Compute mean intensity and error bound by a sum over polar or cell nodes."""
    counts, samples = task.counts, task.samples
    epsilon = nufft.epsilon(math.prod(counts), samples, task.tol, task.components)
    mean, peak, secant = task.sum(quadrature.nodes(task.residual, samples, counts), epsilon)
    gain = task.gain(peak)
    lost = task.residual.truncation * gain
    error = task.bound(mean, lost, lost**2) + task.transform_error(mean, epsilon) * gain
    return mean, error, peak / secant


def _fft(task: Task) -> Image:
    """Compute mean intensity and error bound by as few samples of the pupil as ``tol`` allows."""
    if not task.residual.wavefront.is_spectral:
        return _mdft(task)
    image = _coarse(task, task.coarse)
    if image[1] > task.tol:  # the edge may be brighter than predicted
        more = quadrature.coarse(task.residual, task.samples, task.tol, task.growth, sure=True)
        if more.counts != task.coarse.counts:
            image = _coarse(task, more)
    return image


def _coarse(task: Task, coarse: quadrature.Coarse) -> Image:
    """Return the image by a sum over few nodes, and its error bound from that of each block."""
    residual = task.residual
    nodes = quadrature.nodes(residual, task.samples, coarse.counts)
    fine = nufft.squares(nufft.field(residual, nodes, task.samples, coarse.epsilon))
    mean = task.averaged(fine)
    strongest, far = _blocks(task, mean)
    noise = nufft.noise(residual, nodes, task.samples, fine, coarse.epsilon, strongest.shape)
    error = residual.truncation + coarse.field_errors(residual, far) + noise
    return mean, task.bound(strongest, error, math.inf), 1.0


def _blocks(task: Task, intensity: Array) -> tuple[Array, Array]:
    """Return the largest intensity in each of 8 x 8 blocks of a window, and their distances.

    Distances, m, are those of the farthest edge of a pixel from the tilt's image point.
    """
    window, shift = task.pixels, task.residual.shift
    starts = [np.arange(min(n, 8)) * n // min(n, 8) for n in window.shape]
    strongest = np.maximum.reduceat(intensity, starts[0], axis=0)
    strongest = np.maximum.reduceat(strongest, starts[1], axis=1)
    axes = window.y - shift[1], window.x - shift[0]
    far = [np.maximum.reduceat(np.abs(v), at) for v, at in zip(axes, starts, strict=True)]
    half = 0.0 if task.rule is None else task.pitch / 2
    return strongest, np.hypot(far[0][:, None], far[1]) + math.sqrt(2) * half


def _mdft(task: Task) -> Image:
    """Compute mean intensity and error bound by a chirp transform of a grid."""
    residual, samples = task.residual, task.samples
    check_sampling(task)
    grid = pupil_grid(residual)
    n = grid.values.shape[0]
    fits_memory(
        f"the transform of {n} samples to {samples.shape[0]} x {samples.shape[1]}",
        144.0 * n * n + 48.0 * n * max(samples.shape) + 72.0 * math.prod(samples.shape),
        "use a smaller shape",
    )
    if task.polarisation is None:
        mean = mdft.intensity_in(residual, grid, samples, task.rule)
        return mean, grid_bound(task, mean, grid), 1.0
    wave, nodes = residual.wavefront, nufft.own_nodes(residual)
    lit = wave.amplitude * wave.weights > 0
    (peak, secant), mean = task.levels(nodes), np.zeros(task.shape)
    for weight in task.weights(nodes.u, nodes.v):
        values = np.zeros_like(grid.values)
        values[lit] = grid.values[lit] * weight
        mean += mdft.intensity_in(residual, replace(grid, values=values), samples, task.rule)
    mean /= peak
    return mean, grid_bound(task, mean, grid) * task.gain(peak) ** 2, peak / secant


def _nufft(task: Task) -> Image:
    """Compute mean intensity and error bound by a sum over scattered nodes."""
    residual, samples = task.residual, task.samples
    wave = residual.wavefront
    if wave.layout != "scattered":
        return _mdft(task) if wave.layout == "grid" else _quadrature(task)
    check_sampling(task)
    epsilon = nufft.epsilon(wave.u.size, samples, task.tol, task.components)
    nodes = nufft.own_nodes(residual)
    mean, peak, secant = task.sum(nodes, epsilon)
    gain = task.gain(peak)
    error = _scattered_bound(task, nodes, mean, epsilon)
    return mean, error + task.transform_error(mean, epsilon) * gain, peak / secant


def _scattered_bound(task: Task, nodes: nufft.Nodes, mean: Array, epsilon: float) -> float:
    """Bound the error of scattered nodes by comparison with polar nodes of the same wave."""
    better, doubt = nufft.reference_nodes(task.residual, task.samples)
    truth, true_peak, true_secant = task.sum(better, epsilon)
    peak, secant = task.levels(nodes)
    # factors for the three normalisations: ideal-peak, flux, unit-sum
    flux = (better.total / nodes.total) ** 2 * (true_peak * secant / (true_secant * peak))
    levels = (1.0, flux, flux * nodes.energy / better.energy)
    worst = max(float(np.abs(truth * level - mean).max()) for level in levels)
    lost = doubt * task.gain(peak)
    return 1.2 * worst / float(mean.max()) + task.bound(mean, lost, lost**2)


def _geometric(task: Task) -> Image:
    """Compute mean intensity and error bound by the density of rays."""
    if task.rule is None:
        raise SamplingError(
            "rays give the energy per pixel, not the intensity at points; use pixel_integrated=True"
        )
    bright, ratio = task.residual, 1.0
    wave = bright.wavefront
    if task.polarisation is not None:  # each ray has its energy times 1/cos
        square = (wave.u**2 + wave.v**2) / wave.image_distance**2
        # Unlit samples outside the cone stay dark.
        amplitude = wave.amplitude * np.maximum(1 - square, 1e-12) ** -0.25
        bright = replace(bright, wavefront=replace(wave, amplitude=amplitude))
        peak, secant = task.levels(nufft.own_nodes(task.residual))
        ratio = peak / secant
    energy, error = geometric.density(bright, task.pixels)
    return energy / (task.level * ratio), error, ratio


def grid_bound(task: Task, mean: Array, grid: PupilGrid) -> float:
    """Bound the error of a pupil grid's edge, its truncation and its damping."""
    half = 0.0 if task.rule is None else task.pitch / 2
    found = error_bounds.edge_errors(task.residual, grid, task.pixels.x, task.pixels.y, half)
    lost = task.residual.truncation
    bound = task.bound(mean, found.field + lost, found.energy + lost**2, found.spill)
    if task.rule is None:
        return bound
    return bound + error_bounds.damping_error(task.residual, grid, task.pitch)


def check_sampling(task: Task) -> None:
    """Refuse grid or scattered nodes that are too few for the wave or for the window."""
    residual, wave = task.residual, task.residual.wavefront
    n, (jump, node), share = wave.u.shape[0], residual.grid_jump(), _period_share(task)
    # numbers of scattered nodes grow as the square of their density
    power = 2 if wave.layout == "scattered" else 1
    if jump > 0.5:
        # A margin: in a denser set of scattered nodes, another pair may be the farthest apart.
        need = math.ceil(n * max(jump / 0.5, share) ** power * (1.0 if power == 1 else 1.44))
        where = f"{'pixel' if power == 1 else 'node'} {node}"
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves at {where}, limit 0.50; use {need} or more pupil "
            f"samples (now {n}), or polar nodes"
        )
    if share > 1 + 1e-9:
        period = wave.wavelength * abs(wave.image_distance) / residual.spacing
        raise SamplingError(
            f"the pupil samples repeat the spot every {period:.3g} m, inside the window, which "
            f"needs {share * period:.3g} m; use {math.ceil(n * share**power)} or more pupil "
            f"samples (now {n}), or a smaller shape"
        )


def _period_share(task: Task) -> float:
    """Return the least image period at which no repeat overlaps the window, over the period."""
    residual = task.residual
    wave = residual.wavefront
    need = max(task.pixels.reach_from(residual.shift)) + residual.rays.reach
    if task.rule is not None:  # up to the edges of the pixels, and the core of the repeat
        need += task.pitch / 2 + residual.airy_unit
    return need * residual.spacing / (wave.wavelength * abs(wave.image_distance))


def _waves(residual: Residual) -> float:
    """Return the largest modulus of the residual aberration, waves."""
    return float(np.abs(residual.aberration).max()) / residual.wavefront.wavelength
