"""Halo of a rough wall: its mean scattered intensity, as a sum over separations of pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import ducc0
import numpy as np

from ..._checks import fits_memory, memory_limit
from ..._vectors import Array, ComplexArray
from ..aperture.quadrature_nodes import gauss_legendre
from ..transform import costs
from ..transform.wide_pixels import MODEL, binned, tail_pixels
from ..wave.detilted import Residual
from ..window.rim_tails import edge_ratio
from ..window.window import Window, peak_pixel, ray_reach
from .otf import CELL_BYTES, LEAST_CELLS, Transfer, cells_across, transfer
from .view import RoughView

#: First and largest refinement of the nodes relative to the rule of thumb, made for small errors.
FIRST: Final = 0.7
#: Relative accuracy of the non-uniform transform.
EPSILON: Final = 1e-12
#: Largest side of the inner window relative to the window's, for which it is used.
WORTH: Final = 0.5
#: Distance from rays and halo, Airy units, beyond which the diffraction tail falls as 1/r^3.
FAR: Final = 20.0
#: Memory per node and per pixel of the window during the sum, bytes.
NODE_BYTES, PIXEL_BYTES = 250.0, 160.0


@dataclass(frozen=True, eq=False)
class Separations:
    """Quadrature points for the halo of a rough wall: distances between two points of the pupil.

    The halo is the Fourier transform of an optical transfer function over these distances. Each
    distance (a vector) stands for itself and its opposite.
    """

    # (n_lags, n_directions); Components of the distances along u and v, m.
    du: Array
    dv: Array
    # (n_lags n_directions, 2); Phase step from one image sample to the next, along y and x, rad.
    coord: Array
    # (n_lags, n_directions); Weight of the distance in the sum, without the transfer function of
    # the smooth wave.
    factor: ComplexArray


@dataclass(frozen=True, eq=False)
class Halo:
    """Computation of the halo that roughness scatters, by a sum over distances in the pupil."""

    residual: Residual  # Wave of the smooth wall, without piston and tilt
    view: RoughView  # Statistics and geometry of the roughness
    window: Window  # Image samples or pixels
    pixel_integrated: bool  # Whether to integrate over pixels instead of sampling at their centres
    # Distance between pupil points beyond which the transfer function of the smooth wave is 0, m.
    edge: float

    @property
    def per_metre(self) -> float:
        """Phase per metre of pupil distance and metre of image coordinate, rad/m^2, signed."""
        wave = self.residual.wavefront
        return 2 * math.pi / (wave.wavelength * wave.image_distance)

    def counts(self, fineness: float) -> tuple[list[int], int]:
        """Return the number of lags in each run, and of directions, that resolve the window.

        ``fineness`` scales all numbers.
        """
        x, y = self.window.reach_from(self.residual.shift)
        if self.pixel_integrated:  # up to the edges of the pixels
            x, y = x + self.window.pitch / 2, y + self.window.pitch / 2
        out_u, out_v, last_lag = self._outermost(math.pi * np.arange(64) / 64)
        last = float(np.hypot(out_u, out_v).max())
        v = abs(self.per_metre) * math.hypot(x, y) * last
        n_directions = math.ceil(fineness * math.ceil((v + 12 * v ** (1 / 3) + 48) / 2))
        edges = self._runs(float(last_lag.max()))
        runs = [
            math.ceil(fineness * math.ceil(0.55 * v * (high - low) / edges[-1] + 64))
            for low, high in pairwise(edges)
        ]
        return runs, n_directions

    def separations(self, fineness: float) -> Separations:
        """Return the nodes of the sum, with the numbers of `counts`."""
        counts, n_directions = self.counts(fineness)
        fits_memory(
            f"{sum(counts)} x {n_directions} separations to {self.window.shape} samples",
            NODE_BYTES * sum(counts) * n_directions + PIXEL_BYTES * math.prod(self.window.shape),
            "use a larger tol or wider pixels",
        )
        directions = math.pi * np.arange(n_directions) / n_directions
        out_u, out_v, last_lag = self._outermost(directions)
        edges = self._runs(float(last_lag.max()))
        lag, step = [], []
        for (low, high), n in zip(pairwise(edges), counts, strict=True):
            tau, weight = gauss_legendre(n)
            # Denser toward the pupil's diameter, where the transfer function falls as power 3/2.
            share, weight = tau * (2 - tau), 2 * (1 - tau) * weight
            bottom, top = np.minimum(low, last_lag), np.minimum(high, last_lag)
            lag.append(bottom + share[:, None] * (top - bottom))
            step.append(weight[:, None] * (top - bottom))
        lags, steps = np.concatenate(lag), np.concatenate(step)
        return self._weighted(
            lags * (out_u / last_lag), lags * (out_v / last_lag), lags, steps / n_directions
        )

    def image(self, nodes: Separations, smooth: ComplexArray) -> Array:
        """Return the scattered intensity (ny, nx) for a smooth transfer function at the nodes.

        Values are energies per sample, relative to the energy of the smooth image.
        """
        image = np.empty(self.window.shape, dtype=np.complex128)
        ducc0.nufft.nu2u(
            points=(nodes.factor * smooth).ravel(),
            coord=nodes.coord,
            forward=True,
            epsilon=EPSILON,
            nthreads=1,
            out=image,
        )
        # Terms of opposite separations are complex conjugates; their sum is twice the real part.
        return np.ascontiguousarray(image.real)

    def converged(
        self,
        at: Callable[[Array, Array], ComplexArray],
        coherent: Array,
        tol: float,
    ) -> tuple[Array, Separations, float]:
        """Compute the scattered intensity with nodes refined until it has converged.

        The number of nodes per direction grows by 1.5 until the change is below a tenth of ``tol``
        times the peak of it and ``coherent``, or they are 7 times as many as the rule of thumb.
        """
        fineness = FIRST
        nodes = self.separations(0.7 * fineness)
        coarse = self.image(nodes, at(nodes.du, nodes.dv))
        while True:
            nodes = self.separations(fineness)
            fine = self.image(nodes, at(nodes.du, nodes.dv))
            # the error of the coarser nodes bounds that of the finer ones
            missed = float(np.abs(fine - coarse).max())
            enough = missed <= 0.1 * tol * float(np.max(coherent + fine))
            if enough or 1.5 * fineness > 7:
                return fine, nodes, missed
            coarse = fine
            fineness *= 1.5

    def _weighted(self, du: Array, dv: Array, lag: Array, steps: Array) -> Separations:
        """Return the nodes (du, dv), m, of the sum over separations, with weights and phases.

        ``lag`` are the separations on the wall and ``steps`` their quadrature weights, m.
        """
        wave, pitch = self.residual.wavefront, self.window.pitch
        area = math.pi * lag * steps / abs(float(np.linalg.det(self.view.footprint)))
        factor = 2 * area * self.view.scattered_transfer(du, dv)
        factor *= (pitch / (wave.wavelength * wave.image_distance)) ** 2
        if self.pixel_integrated:
            turns = self.per_metre * pitch / (2 * math.pi)
            factor = factor * np.sinc(turns * du) * np.sinc(turns * dv)
        ny, nx = self.window.shape
        x = self.window.first[0] + (nx // 2) * pitch - self.residual.shift[0]
        y = self.window.first[1] + (ny // 2) * pitch - self.residual.shift[1]
        turned = factor * np.exp(-1j * self.per_metre * (x * du + y * dv))
        coord = np.stack([dv.ravel(), du.ravel()], axis=1) * (self.per_metre * pitch)
        return Separations(du, dv, coord, turned)

    def _outermost(self, directions: Array) -> tuple[Array, Array, Array]:
        """Return the largest separations (du, dv) along directions on the wall, rad; their lags.

        All are in m.
        """
        units = np.stack([np.cos(directions), np.sin(directions)])
        back = np.linalg.solve(self.view.footprint, units)
        last = np.minimum(self.view.last_lag(1e-13), self.edge / np.hypot(*back))
        return last * back[0], last * back[1], last

    def _runs(self, last: float) -> list[float]:
        """Return the lags, m, that bound the runs of nodes; several runs if C has a long tail."""
        length = self.view.length
        # 8 correlation lengths first, then longer by a factor of 4
        edges, end = [0.0], 8 / 2 * length
        while 2 * end < last:
            edges.append(end)
            end *= 4
        return [*edges, last]


@dataclass(frozen=True, eq=False)
class Scattering:
    """Halo of a rough wall in a window of the image: its predicted cost, and its computation.

    The halo is the mean intensity of the light that roughness scatters. If it is much narrower
    than a pixel, it is computed on fine samples in a small square around the centre only. The
    energy outside this square is distributed over the pixels as ``1/r^3``, with r the distance from
    the centre, as diffraction at the rim does. Missing energy that this law does not explain counts
    as error.
    """

    residual: Residual  # Wave of the smooth wall, without piston and tilt
    view: RoughView  # Statistics and geometry of the roughness
    window: Window  # Image samples or pixels
    pixel_integrated: bool  # Whether to integrate over pixels instead of sampling at their centres
    tol: float  # Largest error, relative to the peak of the whole image

    def seconds(self, cells: int = 0) -> float:
        """Predict the run time on one core, s; ``cells`` across a pupil grid still to be made."""
        taken = self._nodes[: 2 if not self._is_narrow else 3 if self.tol > 1e-4 else 4]
        lattices = self._across(cells) ** 2 * (1.25 if self.first_cells else 2.0)
        images = taken[-1] if self.first_cells else 0  # of the coarser cells
        again = self._growth[0]
        pixels = 0 if self._inner is self.window else math.prod(self.window.shape)
        seconds = costs.scattered(
            again * lattices, again * (sum(taken) + images), math.prod(self._inner.shape), pixels
        )
        return seconds + self.view.term_seconds * sum(taken)

    def n_bytes(self, cells: int = 0) -> float:
        """Predict the peak memory, bytes; ``cells`` as for `seconds`."""
        nodes = self._nodes[3 if self.tol < 6e-4 or self._is_narrow else 1]
        in_sum = NODE_BYTES * nodes + PIXEL_BYTES * math.prod(self._inner.shape)
        lattice = CELL_BYTES * (self._growth[1] * self._across(cells)) ** 2
        return max(lattice, in_sum) + PIXEL_BYTES * math.prod(self.window.shape)

    def run(self, coherent: Array) -> tuple[Array, float]:
        """Compute the scattered energy (ny, nx), and its error.

        ``coherent`` is the rest of the image. The transfer function is refined to at most four
        times the first number of cells.
        """
        n = first = self.first_cells
        best = self._with_cells(n, coherent)
        while n < 4 * first:
            excess = best[1] / (0.7 * self.tol * float(np.max(coherent + best[0])))
            # the error falls about as the square of the cells' size; a tenth is to spare
            n = min(4 * first, math.ceil(max(1.25, 1.1 * math.sqrt(excess)) * n))
            if excess <= 1.0 or CELL_BYTES * n**2 > memory_limit():
                break
            finer = self._with_cells(n, coherent)
            best = min(best, finer, key=lambda result: result[1])
        return best

    @cached_property
    def first_cells(self) -> int:
        """Number of grid squares across the pupil to try first in `transfer`.

        It is 0 for a wave on a grid, whose own squares are used.
        """
        if not self.residual.wavefront.is_spectral:
            return 0
        # The error is relative to the halo's peak; the image's width lowers it by 1 + alone/peak.
        alone, peak = self._blur[1], peak_pixel(self.residual, self.window.pitch)
        return cells_across(self.residual, self.tol / (1 + alone / peak))

    def _across(self, cells: int) -> int:
        return self.first_cells or cells or len(self.residual.wavefront.u)

    @cached_property
    def _inner(self) -> Window:
        """Finely sampled window to try first; the whole window if it would not be faster."""
        half = next(self._halves(), None)
        return self.window if half is None else inner_window(self.window, half)[0]

    @cached_property
    def _nodes(self) -> list[int]:
        """Numbers of nodes that are tried in turn."""
        halo = Halo(self.residual, self.view, self._inner, True, self._edge)
        # two more steps, which small errors may take, and which a narrow halo takes
        steps = (0.7 * FIRST, FIRST, 1.5 * FIRST, 2.25 * FIRST)
        return [sum(runs) * n for runs, n in map(halo.counts, steps)]

    @property
    def _edge(self) -> float:
        return 2 * self.residual.wavefront.pupil_radius

    @property
    def _is_narrow(self) -> bool:
        """Whether roughness does not damp the errors at long separations."""
        on_wall = self._edge * math.sqrt(abs(float(np.linalg.det(self.view.footprint))))
        return self.view.last_lag(1e-3) > on_wall

    @property
    def _waves(self) -> float:
        """Aberration across the pupil at the steepest slope, waves."""
        return self._edge * self.residual.rays.slope / self.residual.wavefront.wavelength

    @property
    def _growth(self) -> tuple[float, float]:
        """Cost of all numbers of cells over that of the first, and the last number over it."""
        least = 2.0 if self.tol < 3e-4 and self.first_cells else 1.0
        if self.first_cells == 0 or self._waves <= 1.0:
            return 1.0, least
        if self._inner is not self.window:  # errors of the cells add up within a wide pixel
            return 4.0, 4.0
        # finer cells are needed in about half of these cases, and take twice as long
        often = self.first_cells > LEAST_CELLS or (self._is_narrow and self._waves > 5.0)
        return 1.5 if often else 1.0, 3.0 if self._is_narrow else max(least, 1.4)

    @cached_property
    def _blur(self) -> tuple[float, float]:
        """Standard deviation of the halo, m, and its energy fraction in the central pixel."""
        blur, pitch = self.view.halo(self.residual.wavefront) / 3, self.window.pitch
        return blur, 1.0 if blur == 0 else min(1.0, pitch**2 / (2 * math.pi * blur**2))

    def _with_cells(self, cells: int, coherent: Array) -> tuple[Array, float]:
        """Compute `run` by a transfer function from ``cells`` across the pupil."""
        smooth = transfer(self.residual, cells)
        if self.pixel_integrated:
            for half in self._halves():
                light, error, by_cells = self._about_the_light(half, smooth, cells)
                enough = error <= 0.5 * self.tol * float(np.max(coherent + light))
                # finer cells cost less than a wider square
                if enough or (by_cells > error / 2 and cells < 4 * self.first_cells):
                    return light, error
        halo = Halo(self.residual, self.view, self.window, self.pixel_integrated, smooth.reach)
        light, nodes, missed = halo.converged(smooth.at, coherent, self.tol)
        return light, missed + _transfer_error(halo, nodes, light, smooth, cells)

    def _halves(self) -> Iterator[float]:
        """Yield the half sides, m, of the finely sampled squares to try.

        Nothing is yielded if they would not be faster than sampling all pixels.
        """
        unit, pitch, tol = self.residual.airy_unit, self.window.pitch, self.tol
        (blur, alone), reach = self._blur, self._reach
        # The tail outside has the energy 2/(pi^2 half), with the relative error reach^2/half^2.
        half = max(reach + FAR * unit, math.cbrt(reach**2 * unit / (math.pi**2 * tol / 4)))
        peak = 1 / (1 / alone + 1 / peak_pixel(self.residual, pitch))
        # The tail's model must leave a fifth of the permitted error to all else.
        half = max(half, MODEL * _tail_energy(unit) / (0.4 * tol * peak))
        if self.view.has_tails:
            # A halo with long tails has the fraction (blur/half)^2 or more outside.
            half = max(half, math.sqrt(2) * blur / math.sqrt(0.5 * tol * peak))
        while 2 * half < WORTH * pitch * min(self.window.shape):
            yield half
            half *= 3

    @property
    def _reach(self) -> float:
        """Image distance within which the rays and the halo arrive, m."""
        return ray_reach(self.residual) + self.view.halo(self.residual.wavefront)

    def _about_the_light(
        self, half: float, smooth: Transfer, cells: int
    ) -> tuple[Array, float, float]:
        """Compute the energy by the sum in an inner window and a tail outside, and its error.

        ``half`` is the inner window's half side, m. The last number is the error by the cells.
        """
        inner, parts = inner_window(self.window, half)
        halo = Halo(self.residual, self.view, inner, True, smooth.reach)
        light, nodes, missed = halo.converged(smooth.at, np.zeros(inner.shape), self.tol / 10)
        often = min(parts, inner.shape[0])
        by_cells = often * _transfer_error(halo, nodes, light, smooth, cells)
        error = often * missed + by_cells
        half, share = inner.shape[0] * inner.pitch / 2, self.view.scattered_fraction
        missing = max(share - float(light.sum()), 0.0)
        tail = share * edge_ratio(self.residual.wavefront) * _tail_energy(self.residual.airy_unit)
        tail /= half
        error += min(missing, tail) * min(1.0, MODEL + (self._reach / half) ** 2)
        error += abs(missing - tail)
        found = binned(light, parts, self.window.shape)
        found += missing * tail_pixels(self.window.shape, ((half / self.window.pitch,) * 2,) * 2)
        return found, error, by_cells


def inner_window(window: Window, half: float) -> tuple[Window, int]:
    """Return a window of fine pixels around the centre, and their number per side of a pixel.

    ``half`` is half the side of the new window, m.
    """
    parts = max(1, math.ceil(4 * window.pitch / half)) | 1
    n = 2 * math.ceil(half * parts / window.pitch) + 1
    return Window.centred(window.pitch / parts, (n, n)), parts


def _tail_energy(unit: float) -> float:
    """Return a clear disc's diffracted energy beyond a square, times half the square's side, m."""
    return 4 * math.sqrt(2) * unit / math.pi**3


def _transfer_error(
    halo: Halo, nodes: Separations, light: Array, smooth: Transfer, cells: int
) -> float:
    """Estimate the error of the scattered energy due to that of the transfer function.

    It is at most the transfer function's error times the sum of all weights. For a polar wave it
    is also estimated by the change of the image if the cells are twice as wide. Since the error
    scales with the power 3/2 of the cell size or a higher one, that change is about twice the
    error.
    """
    bound = float(np.abs(nodes.factor).sum()) * smooth.error
    # Below 1e-12 the cost of another lattice outweighs the tighter estimate.
    if cells == 0 or smooth.error < 1e-12:
        return bound
    coarse = transfer(halo.residual, max(cells // 2, 16))
    change = halo.image(nodes, coarse.at(nodes.du, nodes.dv)) - light
    return min(bound, float(np.abs(change).max()))
