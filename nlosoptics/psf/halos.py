"""Light that roughness scatters, as a sum over separations of pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray

from .._checks import fits_memory
from .nodes import gauss_legendre
from .residuals import Residual
from .rough_views import RoughView
from .windows import Window

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Share of the diffuse transfer function's height that is left out.
CUT: Final = 1e-13
#: How much finer than the rule of thumb nodes may become before giving up.
FINEST: Final = 7.0
EPSILON: Final = 1e-12
#: Correlation lengths over which one run of nodes follows C and its tail; further runs grow by 4.
FIRST_RUN: Final = 8.0


@dataclass(frozen=True, eq=False)
class Separations:
    """Nodes of the sum, each standing for itself and its opposite.

    Parameters
    ----------
    du, dv : ndarray
        (n_lags, n_directions), separations of pupil points, m.
    coord : ndarray
        (n_lags n_directions, 2), radians per image sample along y and x.
    factor : ndarray
        Complex: light per image sample, before the smooth transfer function.
    """

    du: Array
    dv: Array
    coord: Array
    factor: ComplexArray


@dataclass(frozen=True, eq=False)
class Halo:
    """What the sum over separations needs.

    Parameters
    ----------
    residual : Residual
    view : RoughView
        Of the roughness that scatters.
    window : Window
    pixel_integrated : bool
    edge : float
        Separation beyond which the smooth transfer function is 0, m.
    spread : float
        How far from its rays' middle the pattern that is scattered reaches itself, m.
    """

    residual: Residual
    view: RoughView
    window: Window
    pixel_integrated: bool
    edge: float
    spread: float = 0.0

    @property
    def per_metre(self) -> float:
        """Radians per metre of separation and of image."""
        wave = self.residual.wavefront
        return 2 * math.pi / (wave.wavelength * wave.image_distance)

    def separations(self, fineness: float) -> Separations:
        """Nodes for waves over the window, more by a factor of ``fineness`` each way."""
        x, y = self.window.reach_from(self.residual.shift)
        directions = math.pi * np.arange(64) / 64
        last = float(np.hypot(*self._outermost(directions)[:2]).max())
        v = abs(self.per_metre) * (math.hypot(x, y) + self.spread) * last
        n_directions = math.ceil(fineness * math.ceil((v + 12 * v ** (1 / 3) + 48) / 2))
        directions = math.pi * np.arange(n_directions) / n_directions
        out_u, out_v, last_lag = self._outermost(directions)
        edges = self._runs(float(last_lag.max()))
        counts = [
            math.ceil(fineness * math.ceil(0.55 * v * (high - low) / edges[-1] + 64))
            for low, high in pairwise(edges)
        ]
        fits_memory(
            f"{sum(counts)} x {n_directions} separations to {self.window.shape} samples",
            250.0 * sum(counts) * n_directions + 80.0 * math.prod(self.window.shape),
            "use a smaller shape",
        )
        lag, step = [], []
        for (low, high), n in zip(pairwise(edges), counts, strict=True):
            tau, weight = gauss_legendre(n)
            # denser toward the pupil's diameter, where the transfer function ends as a power 3/2
            share, weight = tau * (2 - tau), 2 * (1 - tau) * weight
            bottom, top = np.minimum(low, last_lag), np.minimum(high, last_lag)
            lag.append(bottom + share[:, None] * (top - bottom))
            step.append(weight[:, None] * (top - bottom))
        lags, steps = np.concatenate(lag), np.concatenate(step)
        return self._weighted(
            lags * (out_u / last_lag), lags * (out_v / last_lag), lags, steps / n_directions
        )

    def image(self, nodes: Separations, smooth: ComplexArray) -> Array:
        """Diffuse light of each sample, the whole plane 1, for a transfer function at the nodes."""
        image = np.empty(self.window.shape, dtype=np.complex128)
        ducc0.nufft.nu2u(
            points=(nodes.factor * smooth).ravel(),
            coord=nodes.coord,
            forward=True,
            epsilon=EPSILON,
            nthreads=1,
            out=image,
        )
        # opposite separations are each other's conjugate
        return np.ascontiguousarray(image.real)

    def converged(
        self,
        at: Callable[[Array, Array], ComplexArray],
        coherent: Array,
        tol: float,
        fineness: float = 1.0,
    ) -> tuple[Array, Separations, ComplexArray, float]:
        """Diffuse light, its nodes, the transfer function there, and what the nodes miss.

        The latter in units of the light's own, next to which ``tol`` stands relative to the peak of
        both parts. Nodes start at ``fineness`` and are refined by half until a tenth of it is met.
        """
        nodes = self.separations(0.7 * fineness)
        coarse = self.image(nodes, at(nodes.du, nodes.dv))
        while True:
            nodes = self.separations(fineness)
            smooth = at(nodes.du, nodes.dv)
            fine = self.image(nodes, smooth)
            # what the coarser nodes miss bounds what these do
            missed = float(np.abs(fine - coarse).max())
            enough = missed <= 0.1 * tol * float(np.max(coherent + fine))
            if enough or 1.5 * fineness > FINEST:
                return fine, nodes, smooth, missed
            coarse = fine
            fineness *= 1.5

    def _weighted(self, du: Array, dv: Array, lag: Array, steps: Array) -> Separations:
        """Nodes with all that the sum needs of them."""
        wave, pitch = self.residual.wavefront, self.window.pitch
        area = math.pi * lag * steps / abs(float(np.linalg.det(self.view.footprint)))
        factor = 2 * area * self.view.diffuse_transfer(lag)
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
        """Last separations (du, dv) along directions on the wall, and their lags, m."""
        units = np.stack([np.cos(directions), np.sin(directions)])
        back = np.linalg.solve(self.view.footprint, units)
        last = np.minimum(self.view.last_lag(CUT), self.edge / np.hypot(*back))
        return last * back[0], last * back[1], last

    def _runs(self, last: float) -> list[float]:
        """Lags at which runs of nodes meet, m: one run, or more for a tail much wider than C."""
        length = self.view.roughness.correlation_length
        edges, end = [0.0], FIRST_RUN / 2 * length
        while 2 * end < last:
            edges.append(end)
            end *= 4
        return [*edges, last]
