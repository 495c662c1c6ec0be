"""Light that roughness scatters, as a sum over separations of pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, memory_limit
from ..aperture.quadrature_nodes import gauss_legendre
from ..transform.wide_pixels import binned, tail_pixels
from ..wave.detilted import Residual
from ..window.rim_tails import edge_ratio
from ..window.window import Window, peak_pixel, ray_reach
from .otf import CELL_BYTES, Transfer, cells_across, transfer
from .view import RoughView

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Share of the diffuse transfer function's height that is left out.
CUT: Final = 1e-13
#: How much finer than the rule of thumb nodes may become before giving up.
FINEST: Final = 7.0
EPSILON: Final = 1e-12
#: Pixels of the window about the light, at least, on each side of its middle.
PARTS: Final = 4
#: Share of the window's side from which a smaller one about the light does not pay.
WORTH: Final = 0.5
#: Distance from rays and halo, Airy units, from which the diffraction tail falls as 1/r^3.
FAR: Final = 20.0
#: Bytes of a node and of a pixel of the window while the sum runs.
NODE_BYTES, PIXEL_BYTES = 250.0, 160.0
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
    """Inputs of the sum over separations.

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

    def counts(self, fineness: float) -> tuple[list[int], int]:
        """Nodes of every run of lags, and directions, that waves over the window take."""
        x, y = self.window.reach_from(self.residual.shift)
        out_u, out_v, last_lag = self._outermost(math.pi * np.arange(64) / 64)
        last = float(np.hypot(out_u, out_v).max())
        v = abs(self.per_metre) * (math.hypot(x, y) + self.spread) * last
        n_directions = math.ceil(fineness * math.ceil((v + 12 * v ** (1 / 3) + 48) / 2))
        edges = self._runs(float(last_lag.max()))
        runs = [
            math.ceil(fineness * math.ceil(0.55 * v * (high - low) / edges[-1] + 64))
            for low, high in pairwise(edges)
        ]
        return runs, n_directions

    def separations(self, fineness: float) -> Separations:
        """Nodes for waves over the window, more by a factor of ``fineness`` each way."""
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


def scattered_light(
    residual: Residual,
    view: RoughView,
    window: Window,
    pixel_integrated: bool,
    coherent: Array,
    tol: float,
) -> tuple[Array, float]:
    """Light that a rough wall scatters into each sample, the whole plane 1, and its error.

    Parameters
    ----------
    residual : Residual
    view : RoughView
    window : Window
    pixel_integrated : bool
    coherent : ndarray, (ny, nx)
        The core on the same samples, to whose peak ``tol`` is relative as well.
    tol : float

    Returns
    -------
    light : ndarray, (ny, nx)
    error : float
        In the same unit.

    Notes
    -----
    Pixels far wider than the light show none of its detail. Then a window about it is summed that
    is as small as ``tol`` lets it be; what lies beyond is spread over the pixels as the diffraction
    tail, ``1/r^3``, and all that is more than such a tail holds counts as error.
    """
    cells, best = first_cells(residual, view, window.pitch, tol), None
    for n in (cells, 2 * cells, 4 * cells):
        if best is not None and CELL_BYTES * n**2 > memory_limit():
            break
        found = _with_cells(residual, view, window, pixel_integrated, coherent, tol, n)
        if best is None or found[1] < best[1]:
            best = found
        if not n or best[1] <= 0.7 * tol * float(np.max(coherent + best[0])):
            break
    assert best is not None
    return best


def first_cells(residual: Residual, view: RoughView, pitch: float, tol: float) -> int:
    """Cells across a polar pupil from which the transfer function is taken first; 0 of a grid."""
    if residual.wavefront.layout != "polar":
        return 0
    # errors are relative to a peak that the aberration lowers and the halo's own does not tell
    alone = _blur(residual, view, pitch)[1]
    return cells_across(residual, tol / (1 + alone / peak_pixel(residual, pitch)))


def _blur(residual: Residual, view: RoughView, pitch: float) -> tuple[float, float]:
    """Standard deviation, m, of the scattered light, and the share of it in the middle's pixel."""
    blur = view.halo(residual.wavefront) / 3
    return blur, 1.0 if blur == 0 else min(1.0, pitch**2 / (2 * math.pi * blur**2))


def _with_cells(
    residual: Residual,
    view: RoughView,
    window: Window,
    pixel_integrated: bool,
    coherent: Array,
    tol: float,
    cells: int,
) -> tuple[Array, float]:
    """`scattered_light` by a transfer function from so many cells across the pupil."""
    smooth = transfer(residual, cells)
    if pixel_integrated:
        share = -math.expm1(-(view.rayleigh_parameter**2))
        for half in inner_halves(residual, view, window, tol):
            found = _about_the_light(residual, view, window, half, share, smooth, tol, cells)
            if found[1] <= 0.5 * tol * float(np.max(coherent + found[0])):
                return found
    halo = Halo(residual, view, window, pixel_integrated, smooth.reach)
    light, nodes, _, missed = halo.converged(smooth.at, coherent, tol)
    return light, missed + _transfer_error(halo, nodes, light, smooth, cells)


def inner_halves(
    residual: Residual, view: RoughView, window: Window, tol: float
) -> Iterator[float]:
    """Half sides, m, of the windows about the light that are tried; none where they do not pay."""
    unit = residual.airy_unit
    reach = ray_reach(residual) + view.halo(residual.wavefront)
    # beyond half lies a share 2/(pi^2 half) of the light, which errs by reach^2/half^2 of itself
    half = max(reach + FAR * unit, math.cbrt(reach**2 * unit / (math.pi**2 * tol / 4)))
    if view.roughness.autocorrelation != "gaussian":
        # a share (blur/half)^2 or more of slopes with long tails lies beyond
        blur, alone = _blur(residual, view, window.pitch)
        peak = 1 / (1 / alone + 1 / peak_pixel(residual, window.pitch))
        half = max(half, math.sqrt(2) * blur / math.sqrt(0.5 * tol * peak))
    while 2 * half < WORTH * window.pitch * min(window.shape):
        yield half
        half *= 3


def inner_window(window: Window, half: float) -> tuple[Window, int]:
    """Odd parts of pixels about the middle one's centre, and how many make a pixel's side."""
    parts = max(1, math.ceil(PARTS * window.pitch / half)) | 1
    n = 2 * math.ceil(half * parts / window.pitch) + 1
    return Window.centred(window.pitch / parts, (n, n)), parts


def _about_the_light(
    residual: Residual,
    view: RoughView,
    window: Window,
    half: float,
    share: float,
    smooth: Transfer,
    tol: float,
    cells: int,
) -> tuple[Array, float]:
    """Scattered light by a sum over a small window and a tail beyond, and its error."""
    inner, parts = inner_window(window, half)
    halo = Halo(residual, view, inner, True, smooth.reach)
    light, nodes, _, missed = halo.converged(smooth.at, np.zeros(inner.shape), tol / 10)
    error = min(parts, inner.shape[0]) * (
        missed + _transfer_error(halo, nodes, light, smooth, cells)
    )
    half = inner.shape[0] * inner.pitch / 2
    missing = max(share - float(light.sum()), 0.0)
    unit, reach = residual.airy_unit, ray_reach(residual) + view.halo(residual.wavefront)
    tail = share * edge_ratio(residual.wavefront) * 4 * math.sqrt(2) * unit / (math.pi**3 * half)
    error += min(missing, tail) * min(1.0, 0.01 + (reach / half) ** 2) + abs(missing - tail)
    found = binned(light, parts, window.shape)
    found += missing * tail_pixels(window.shape, ((half / window.pitch,) * 2,) * 2)
    return found, error


def _transfer_error(
    halo: Halo, nodes: Separations, light: Array, smooth: Transfer, cells: int
) -> float:
    """Error of the scattered light that comes from the transfer function's own error.

    At most its bound over all separations. Of a polar wave, what cells twice as wide change in the
    image: its error falls as the power 3/2 of the cells or faster, so that this is twice what the
    finer ones leave.
    """
    bound = float(np.abs(nodes.factor).sum()) * smooth.error
    # below, another lattice would cost more than it says
    if halo.residual.wavefront.layout != "polar" or smooth.error < 1e-12:
        return bound
    coarse = transfer(halo.residual, max(cells // 2, 16))
    change = halo.image(nodes, coarse.at(nodes.du, nodes.dv)) - light
    return min(bound, float(np.abs(change).max()))
