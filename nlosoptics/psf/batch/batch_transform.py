"""Fourier transform of many waves on one pupil, by matrix products, and its adjoint.

Nodes and image points are mirrored about both axes. A sum over nodes becomes sums of parts that are
even or odd in u and v, times cosines or sines: first along u, chord by chord, then along v. Waves
are transformed in blocks of `BLOCK`, each on one thread, so that no result depends on the number of
threads.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import carried
from ..._vectors import product_into
from ...raytrace.intersection.meshes import threads, worker_pool
from ..aperture.quadrature_nodes import frozen
from ..window.pixels import PixelRule
from ..window.window import Window
from .chord_nodes import ChordNodes
from .polar_basis import PolarBasis

Array = NDArray[np.float64]

#: Waves per block: enough rows for fast products along chords, few enough for the cache.
BLOCK = 16
#: Image points whose phase factors are multiplied from those of a coarse and a fine step.
RUN = 16


@dataclass(frozen=True, eq=False)
class BatchTransform:
    """Transform from the series of waves in turns to intensities in a window.

    Parameters
    ----------
    basis : PolarBasis
        Series of the waves.
    nodes : ChordNodes
        Nodes in a quadrant of the pupil.
    sizes : ndarray, (4, n)
        Amplitude times area of each node and of its mirror images in u, in v and in both; sum 1.
    radius : float
        Phase, in turns per metre of image, between the pupil's centre and its rim, signed as the
        image distance.
    window : Window
        Image points.
    rule : PixelRule or None
        Average over pixels; None for point samples.
    scale : float
        Intensity without aberration at the ideal peak.
    single : bool
        Whether pupils and fields are in single precision.
    """

    basis: PolarBasis
    nodes: ChordNodes
    sizes: Array
    radius: float
    window: Window
    rule: PixelRule | None
    scale: float
    single: bool

    @property
    def kind(self) -> np.dtype[Any]:
        """Data type of pupils and fields."""
        return np.dtype("f4" if self.single else "f8")

    @cached_property
    def terms(self) -> list[Array]:
        """Terms of each part of the series at the nodes, (terms, n)."""
        return [frozen(part) for part in self.basis.at(self.nodes.u, self.nodes.heights)]

    @cached_property
    def ramps(self) -> Array:
        """Phases along u and v that move the window's middle to frequency 0, (2, n), turns."""
        rates = []
        for first, count in zip(self.window.first, self.window.shape[::-1], strict=True):
            rates.append(-self.radius * (first + (count - 1) / 2 * self.window.pitch))
        return np.stack([rates[0] * self.nodes.u, rates[1] * self.nodes.heights])

    @cached_property
    def columns(self) -> list[NDArray[Any]]:
        """Cosines and sines (2, nodes, points) of each chord for half of the columns."""
        waves = self._waves(self.nodes.u, self.window.shape[1])
        return [waves[:, a:b] for a, b in pairwise(self.nodes.starts)]

    @cached_property
    def rows(self) -> NDArray[Any]:
        """Cosines and sines (2, points, chords) for half of the rows."""
        waves = self._waves(self.nodes.v, self.window.shape[0])
        return np.ascontiguousarray(waves.transpose(0, 2, 1))

    @cached_property
    def means(self) -> tuple[Array, Array] | None:
        """Averages of rows, (ny, samples), and of columns, (samples, nx); None for points."""
        if self.rule is None:
            return None
        along_y, along_x = map(self.rule.matrix, self.window.shape)
        return along_y, np.ascontiguousarray(along_x.T)

    def _waves(self, places: Array, count: int) -> NDArray[Any]:
        """Return cosines and sines of places, in radii, for half of the points of an axis."""
        half = (count + 1) // 2
        step = 2j * math.pi * self.radius * self.window.pitch * places[:, None]
        coarse = np.exp(step * RUN * np.arange(-(-half // RUN)))
        fine = np.exp(step * (np.arange(RUN) + (0.0 if count % 2 else 0.5)))
        phases = (coarse[:, :, None] * fine[:, None, :]).reshape(len(places), -1)[:, :half]
        return np.stack([phases.real, phases.imag]).astype(self.kind, copy=False)

    def intensities(self, series: list[Array], out: Array, helpers: int | None = None) -> Array:
        """Fill ``out`` (waves, ny, nx) and return the peak of each wave over `scale`, (waves,).

        ``series`` is the result of `PolarBasis.analysed`, in turns. ``helpers`` is the number of
        threads besides the calling one; by default all.
        """
        peaks = np.empty(len(out))

        def run(work: _Workspace, first: int, last: int) -> None:
            work.spread(series, first, last)
            for b in range(last - first):
                if self.means is None:
                    work.intensity(b, out[first + b])
                else:
                    work.intensity(b, work.fine)
                    product_into(work.fine, self.means[1], work.half)
                    product_into(self.means[0], work.half, out[first + b])
                peaks[first + b] = out[first + b].max() / self.scale

        self._on_threads(run, len(out), helpers)
        return peaks

    def gradients(
        self,
        series: list[Array],
        gradient: Array,
        modes: list[Array],
        helpers: int | None = None,
    ) -> list[Array]:
        """Return the gradient of a function of the intensities with respect to modes, in turns.

        Parameters
        ----------
        series : list of ndarray
            As for `intensities`.
        gradient : ndarray, (waves, ny, nx)
            Gradient with respect to the intensities.
        modes : list of ndarray
            Values (modes, n) at the nodes, of modes of each parity.
        helpers : int, optional
            As for `intensities`.

        Returns
        -------
        list of ndarray
            Derivatives (waves, modes) with respect to the coefficients of each parity.
        """
        found = [np.empty((len(gradient), len(part))) for part in modes]

        def run(work: _Workspace, first: int, last: int) -> None:
            work.spread(series, first, last)
            for b in range(last - first):
                given = gradient[first + b]
                if self.means is not None:
                    product_into(self.means[0].T, given, work.half)
                    product_into(work.half, self.means[1].T, work.fine)
                    given = work.fine
                work.pull_back(b, given)
            work.gather(modes, found, first, last)

        self._on_threads(run, len(gradient), helpers)
        return found

    def _on_threads(
        self, run: Callable[[_Workspace, int, int], None], count: int, helpers: int | None
    ) -> None:
        """Call ``run`` for all blocks of waves, on the calling thread and on helpers.

        The calling thread takes every block that no helper has begun, so that a call from a thread
        of the pool never waits for the pool.
        """
        self.terms, self.ramps, self.columns, self.rows, self.means  # noqa: B018  made once
        waiting = iter(range(0, count, BLOCK))
        lock = threading.Lock()

        def take(_: int) -> None:
            work = _Workspace(self)
            while True:
                with lock:
                    first = next(waiting, None)
                if first is None:
                    return
                run(work, first, min(first + BLOCK, count))

        wanted = threads() - 1 if helpers is None else helpers
        wanted = min(wanted, -(-count // BLOCK) - 1)
        begun = [worker_pool().submit(carried(take), i) for i in range(wanted)]
        try:
            take(0)
        finally:
            for one in begun:
                if not one.cancel():
                    one.result()

    def memory(self, count: int) -> float:
        """Return the memory of the tables, and of the workspaces for ``count`` waves, bytes."""
        n, (ny, nx) = len(self.nodes.u), self.window.shape
        x, y, rows = (nx + 1) // 2, (ny + 1) // 2, len(self.nodes.v)
        tables = n * (sum(self.basis.sizes) / 4 + 6 * x) + 2 * rows * y
        work = BLOCK * (24 * n + 16 * rows * x) + 16 * x * y
        work += 0 if self.rule is None else ny * (3 * nx)
        return 8.0 * (tables + min(threads(), -(-count // BLOCK)) * work)


class _Workspace:
    """Arrays of one thread, reused by all its blocks of waves."""

    def __init__(self, plan: BatchTransform) -> None:
        from . import _batch_kernels

        self.kernels = _batch_kernels
        n, chords, (ny, nx) = len(plan.nodes.u), len(plan.nodes.v), plan.window.shape
        x, y = (nx + 1) // 2, (ny + 1) // 2
        self.plan = plan
        self.values = np.zeros((4, BLOCK, n))
        self.parts = np.empty((2, 2, 2, BLOCK, n), plan.kind)
        self.halves = np.empty((2, 2, 2, BLOCK, chords, x), plan.kind)
        self.fields = np.empty((2, 2, 2, y, x), plan.kind)
        if plan.means is not None:
            self.fine = np.empty((ny, nx))
            self.half = np.empty((ny, plan.means[1].shape[1]))

    @cached_property
    def slopes(self) -> NDArray[Any]:
        """Gradient with respect to `halves`."""
        return np.zeros_like(self.halves)

    @cached_property
    def field_slopes(self) -> NDArray[Any]:
        """Gradient with respect to `fields`."""
        return np.empty_like(self.fields)

    def spread(self, series: list[Array], first: int, last: int) -> None:
        """Sum the pupils of waves ``first`` to ``last`` along u, into `halves`."""
        plan = self.plan
        for part, terms, out in zip(series, plan.terms, self.values, strict=True):
            chosen = part[first:last].reshape(last - first, -1)
            product_into(chosen, terms, out[: last - first])
        self.kernels.pupil_parts(self.values, plan.ramps, plan.sizes, self.parts)
        for i, (along, halves) in enumerate(self._chords(self.parts, self.halves)):
            product_into(along, plan.columns[i], halves)

    def _chords(
        self, parts: NDArray[Any], halves: NDArray[Any]
    ) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return each chord's nodes (2, rows, nodes) and columns (2, rows, points)."""
        flat, wide = (
            parts.reshape(2, 4 * BLOCK, -1),
            halves.reshape(2, 4 * BLOCK, -1, halves.shape[-1]),
        )
        starts = self.plan.nodes.starts
        return [(flat[:, :, a:b], wide[:, :, i]) for i, (a, b) in enumerate(pairwise(starts))]

    def intensity(self, b: int, out: Array) -> None:
        """Fill ``out`` with the intensity of wave ``b`` of the block."""
        product_into(self.plan.rows[None, :, None], self.halves[:, :, :, b], self.fields)
        self.kernels.intensities(self.fields, self.plan.scale, out)

    def pull_back(self, b: int, gradient: Array) -> None:
        """Set `slopes` of wave ``b`` from the gradient with respect to its intensities."""
        product_into(self.plan.rows[None, :, None], self.halves[:, :, :, b], self.fields)
        self.kernels.field_gradients(self.fields, self.plan.scale, gradient, self.field_slopes)
        back = self.plan.rows.transpose(0, 2, 1)[None, :, None]
        product_into(back, self.field_slopes, self.slopes[:, :, :, b])

    def gather(self, modes: list[Array], found: list[Array], first: int, last: int) -> None:
        """Store the gradients of waves ``first`` to ``last``, see `BatchTransform.gradients`."""
        plan = self.plan
        own = np.empty_like(self.values)
        for i, (along, slopes) in enumerate(self._chords(self.parts, self.slopes)):
            product_into(slopes, plan.columns[i].transpose(0, 2, 1), along)
        self.kernels.phase_gradients(self.values, plan.ramps, plan.sizes, self.parts, own)
        for out, table, slopes in zip(found, modes, own, strict=True):
            product_into(slopes[: last - first], table.T, out[first:last])
