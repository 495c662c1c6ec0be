"""The transforms from a wave to its point spread: what each costs, may reach, and computes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from ..._checks import fits_memory
from ..._vectors import Array
from ...errors import SamplingError
from ..window import error_bounds
from ..window.grids import PupilGrid, pupil_grid
from . import airy, antialiased_fft, antialiased_pupil, costs, geometric, mdft, nufft, quadrature
from .task import Image, Result, Soft, Task

#: Aberration, waves peak to valley, up to which the geometric method is not tried.
MANY_WAVES: Final = 20


class Transform:
    """One way from a wave to its image."""

    vector = True  # Whether it computes the high-aperture model

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach; empty if it may be reached."""
        return ""

    def seconds(self, task: Task) -> float:
        """Predict the run time on one core, s."""
        raise NotImplementedError

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        raise NotImplementedError

    def image(self, task: Task) -> Image:
        """Compute mean intensity, its error relative to the peak, and the factor to the level."""
        raise NotImplementedError


class Airy(Transform):
    """Closed form of a wave without aberration."""

    vector = False

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach."""
        bound = airy.error_bound(task.residual)
        if bound <= task.tol:
            return ""
        if math.isinf(bound):
            return "the wave is not flat"
        return f"the error of neglecting the aberration is {bound:.2g}"

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        return costs.CALL + 3e-8 * math.prod(task.samples.shape)  # one Bessel function per point

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return 64.0 * math.prod(task.samples.shape)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        residual = task.residual
        bound = airy.error_bound(residual)
        if math.isinf(bound):
            waves = float(np.abs(residual.aberration).max()) / residual.wavefront.wavelength
            raise SamplingError(
                f"the residual aberration reaches {waves:.3g} waves, too much for the closed "
                "form; use method='quadrature'"
            )
        fits_memory("the closed form", self.n_bytes(task), "use fewer pixels")
        filtering = 0.0 if task.rule is None else error_bounds.FILTER
        return task.averaged(airy.intensity(residual, task.samples)), bound + filtering, 1.0


class Quadrature(Transform):
    """Sum over so many polar or cell nodes that their error is that of rounding."""

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach."""
        return _by_nodes(task, 0.0)

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        return task.components * costs.sum_over_nodes(math.prod(task.counts), task.samples)

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return nufft.n_bytes(math.prod(task.counts), task.samples)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        counts, samples = task.counts, task.samples
        epsilon = nufft.epsilon(math.prod(counts), samples, task.tol, task.components)
        mean, peak, secant = task.sum(quadrature.nodes(task.residual, samples, counts), epsilon)
        gain = task.gain(peak)
        lost = task.residual.truncation * gain
        error = task.bound(mean, lost, lost**2) + task.transform_error(mean, epsilon) * gain
        return mean, error, peak / secant


class FewNodes(Transform):
    """Sum over as few polar or cell nodes as ``tol`` allows."""

    vector = False

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach."""
        return _by_nodes(task, task.coarse.core)

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        digits = -math.log10(task.coarse.epsilon)
        per_node = 3e-8 + 1e-9 * digits**2
        nodes = math.prod(task.coarse.counts)
        return 6e-4 + per_node * nodes + 1.2e-8 * math.prod(task.samples.shape)

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return nufft.n_bytes(math.prod(task.coarse.counts), task.samples)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        image = _coarse(task, task.coarse)
        if image[1] > task.tol:  # the edge may be brighter than predicted
            more = quadrature.coarse(task.residual, task.samples, task.tol, task.growth, sure=True)
            if more.counts != task.coarse.counts:
                image = _coarse(task, more)
        return image


class SoftGrid(FewNodes):
    """FFTs of a grid with softened rims for waves that are polynomials, else few nodes."""

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach."""
        return super().refusal(task) if task.soft is None else ""

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        if task.soft is None:
            return super().seconds(task)
        grid, samples = task.soft.grid, task.samples
        size = round(grid.period / samples.pitch)
        columns = min(size, 2 * grid.centre) + samples.shape[1]
        return costs.CALL + 3e-8 * grid.radius**2 + 5e-10 * size * columns * math.log2(size)

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        if task.soft is None:
            return super().n_bytes(task)
        return antialiased_fft.n_bytes(task.samples, task.soft.grid, task.rule)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        if task.soft is None:
            return super().image(task)
        image = _soft(task, task.soft)
        if image[1] > task.tol:  # the peak is lower than predicted
            finer = task.soft_grid(task.soft.rim, task.tol / 8)
            image = _soft(task, task.soft._replace(grid=finer))
        return image if image[1] <= task.tol else super().image(task)


class Chirp(Transform):
    """Chirp transform of a grid to any pitch."""

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        return task.components * costs.map_sums(len(task.residual.wavefront.u), task.samples)

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return costs.map_bytes(len(task.residual.wavefront.u), task.samples)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        residual, samples = task.residual, task.samples
        _check_sampling(task, 1)
        grid = pupil_grid(residual)
        n = grid.values.shape[0]
        fits_memory(
            f"the transform of {n} samples to {samples.shape[0]} x {samples.shape[1]}",
            144.0 * n * n + 48.0 * n * max(samples.shape) + 72.0 * math.prod(samples.shape),
            "use a smaller shape",
        )
        wave, nodes = residual.wavefront, nufft.own_nodes(residual)
        lit = wave.amplitude * wave.weights > 0
        (peak, secant), mean = task.levels(nodes), np.zeros(task.shape)
        for weight in task.weights(nodes.u, nodes.v):
            values = np.zeros_like(grid.values)
            values[lit] = grid.values[lit] * weight
            mean += mdft.intensity_in(residual, replace(grid, values=values), samples, task.rule)
        mean /= peak
        return mean, grid_bound(task, mean, grid) * task.gain(peak) ** 2, peak / secant


class Scattered(Transform):
    """Sum over scattered nodes."""

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        own = task.residual.aberration.size
        reference = math.prod(nufft.reference_counts(task.residual, task.samples))
        sums = sum(costs.sum_over_nodes(n, task.samples) for n in (own, reference))
        return task.components * (sums + 1.3e-6 * reference)

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return nufft.n_bytes(task.residual.wavefront.u.size, task.samples)

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        residual = task.residual
        _check_sampling(task, 2)
        epsilon = nufft.epsilon(residual.aberration.size, task.samples, task.tol, task.components)
        nodes = nufft.own_nodes(residual)
        mean, peak, secant = task.sum(nodes, epsilon)
        error = _scattered_bound(task, nodes, mean, epsilon)
        return mean, error + task.transform_error(mean, epsilon) * task.gain(peak), peak / secant


class Rays(Transform):
    """Density of the rays in the image, without diffraction."""

    def refusal(self, task: Task) -> str:
        """Return why ``tol`` is out of reach."""
        least, waves = geometric.least_error(task.residual, task.pitch), task.regime.peak_to_valley
        if task.rule is None:
            return "rays have no intensity at points"
        if waves <= MANY_WAVES:
            return f"{waves:.3g} waves are too few, limit {MANY_WAVES}"
        if least > task.tol:
            return f"error of at least {least:.2g} on pixels of {task.regime.pixel:.3g} lambda N"
        return ""

    def seconds(self, task: Task) -> float:
        """Predict the run time, s."""
        # two passes, the second for the error estimate
        return 3e-3 + 4e-7 * math.prod(geometric.ray_counts(task.residual, task.pixels))

    def n_bytes(self, task: Task) -> float:
        """Predict the peak memory, bytes."""
        return 400.0 * math.prod(geometric.ray_counts(task.residual, task.pixels))

    def image(self, task: Task) -> Image:
        """Compute the image and its error."""
        if task.rule is None:
            raise SamplingError(
                "rays give the energy per pixel, not the intensity at points; use "
                "pixel_integrated=True"
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


_rings: dict[str, Transform] = {
    "quadrature": Quadrature(),
    "fft": FewNodes(),
    "geometric": Rays(),
}
_rings["nufft"] = _rings["quadrature"]
_grid = Chirp()
#: Transforms for each layout by their names; the first computes any part of an image.
ABLE: Final[dict[str, dict[str, Transform]]] = {
    "polar": {**_rings, "fft": SoftGrid(), "airy": Airy()},
    "cells": _rings,
    "grid": {"mdft": _grid, "nufft": _grid, "fft": _grid},
    "scattered": {"nufft": Scattered()},
}


def able(task: Task) -> dict[str, Transform]:
    """Return the transforms for a wave's layout and model by their names."""
    every = ABLE[task.residual.wavefront.layout]
    return {name: one for name, one in every.items() if one.vector or task.polarisation is None}


def transform(task: Task, method: str) -> Result:
    """Run a transform by name; raise `SamplingError` if the wave's layout does not allow it."""
    layout, ways = task.residual.wavefront.layout, able(task)
    if method not in ways:
        model = "" if task.polarisation is None else " by the high-aperture model"
        raise SamplingError(
            f"method = '{method}' cannot transform{model} a wavefront of layout '{layout}'; use "
            f"method='{next(iter(ways))}' or 'auto', or sample the wave with other nodes"
        )
    mean, error, ratio = ways[method].image(task)
    return Result(method, mean, error, task.level * ratio)


def _by_nodes(task: Task, missing: float) -> str:
    """Return why nodes leave too large an error; ``missing`` is the field's by their number."""
    # lower bound of the relative error, since the peak is at most 1
    least = 2 * error_bounds.beat(task.pixel) * (task.residual.truncation + missing)
    return f"error of at least {least:.2g} for its nodes" if least > task.tol else ""


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


def _soft(task: Task, soft: Soft) -> Image:
    """Return the image of a polynomial wave from its softened grid, and its error bound."""
    residual, unit = task.residual, task.residual.airy_unit
    mean = antialiased_fft.image(residual, soft.wave, task.samples, soft.grid, task.rule)
    strongest, far = _blocks(task, mean)
    rings = antialiased_pupil.RINGS * far.max()
    ring = np.minimum(np.searchsorted(rings, far), rings.size - 1)
    error = soft.rim.errors(rings / unit, soft.grid.period / unit)[ring]
    lost = residual.truncation + soft.wave.misfit * soft.wave.strength + soft.grid.error
    return mean, task.bound(strongest, error + lost, math.inf), 1.0


def _blocks(task: Task, intensity: Array) -> tuple[Array, Array]:
    """Return the largest intensity in each of 8 x 8 blocks of a window, and their distances.

    Distances, m, are those of the farthest edge of a pixel from the tilt's image point.
    """
    window, shift = task.pixels, task.residual.shift
    starts = [np.linspace(0, n, min(n, 8) + 1).astype(int)[:-1] for n in window.shape]
    rows = np.array([part.max(axis=0) for part in np.split(intensity, starts[0][1:])])
    strongest = np.maximum.reduceat(rows, starts[1], axis=1)
    axes = window.y - shift[1], window.x - shift[0]
    far = [np.maximum.reduceat(np.abs(v), at) for v, at in zip(axes, starts, strict=True)]
    half = 0.0 if task.rule is None else task.pitch / 2
    return strongest, np.hypot(far[0][:, None], far[1]) + math.sqrt(2) * half


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


def grid_bound(task: Task, mean: Array, grid: PupilGrid) -> float:
    """Bound the error of a pupil grid's edge and of its damping."""
    half = 0.0 if task.rule is None else task.pitch / 2
    found = error_bounds.edge_errors(task.residual, grid, task.pixels.x, task.pixels.y, half)
    bound = task.bound(mean, found.field, found.energy, found.spill)
    damped = 0.0 if task.rule is None else task.pitch
    return bound + error_bounds.damping_error(task.residual, grid, damped)


def _check_sampling(task: Task, power: int) -> None:
    """Refuse samples that are too few for the wave or for the window.

    Their number grows as this power of their density: 1 for those along a side of a grid, 2 for
    all scattered ones.
    """
    residual, wave = task.residual, task.residual.wavefront
    n, (jump, node), share = wave.u.shape[0], residual.jump(), _period_share(task)
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
