"""Sum over pupil nodes of any layout to a window, by a non-uniform fast Fourier transform.

Each node, or traced ray, has the weight amplitude times area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import Array, read_only
from ..wave.detilted import Residual
from ..window.window import Window

ComplexArray = NDArray[np.complexfloating[Any, Any]]

#: Number of nodes plus points up to which the transform uses the accuracy `BEST`.
SMALL = 200_000
#: Relative accuracy of the transform: the best available, and the coarsest used of given nodes.
BEST, FAST = 2e-13, 1e-8
#: Coarsest accuracy used of chosen nodes: beyond it the largest error exceeds twice the requested.
COARSEST = 1e-3


@dataclass(frozen=True, eq=False)
class Nodes:
    """Pupil nodes of a sum; all arrays have one shape.

    Parameters
    ----------
    u, v, path : ndarray
        Coordinates and residual aberration, m.
    amplitude, areas : ndarray
        Amplitude, and the area that each node represents, m^2.
    """

    u: Array
    v: Array
    path: Array
    amplitude: Array
    areas: Array

    @cached_property
    def total(self) -> float:
        """Integral of the amplitude, m^2."""
        return float(np.sum(self.amplitude * self.areas))

    @cached_property
    def share(self) -> Array:
        """Contribution of each node to the ideal peak of the field, sum 1."""
        return self.amplitude * self.areas / self.total

    @cached_property
    def energies(self) -> Array:
        """Squared amplitude times area of each node, m^2."""
        return self.amplitude**2 * self.areas

    @cached_property
    def energy(self) -> float:
        """Integral of the squared amplitude, m^2."""
        return float(np.sum(self.energies))


def epsilon(n_nodes: int, window: Window, tol: float, components: int = 1) -> float:
    """Return the relative accuracy to request of transforms: the best one if they are cheap."""
    if components * (n_nodes + window.shape[0] * window.shape[1]) <= SMALL:
        return BEST
    return max(min(FAST, tol / 100), BEST)


def n_bytes(n_nodes: int, window: Window) -> float:
    """Return the peak memory: 100 bytes per node, 64 per image point with oversampling."""
    return 100.0 * n_nodes + 64.0 * window.shape[0] * window.shape[1]


def check_memory(counts: tuple[int, ...], window: Window) -> None:
    """Refuse a sum over nodes of a shape ``counts`` to a window that does not fit into memory."""
    fits_memory(
        f"the sum over {' x '.join(map(str, counts))} nodes to {window.shape[0]} x "
        f"{window.shape[1]} points",
        n_bytes(math.prod(counts), window),
        "use a smaller shape",
    )


def field(
    residual: Residual,
    nodes: Nodes,
    window: Window,
    epsilon: float = BEST,
    weight: Array | float = 1.0,
) -> ComplexArray:
    """Compute ``sum A w exp(ikW) exp(-2 pi i x.p/(lambda d))`` over nodes at points of a window.

    Parameters
    ----------
    residual : Residual
        Wave, for the wavelength, the image distance and the tilt's shift, from which x is counted.
    nodes : Nodes
        Pupil nodes.
    window : Window
        Image points x.
    epsilon : float
        Requested error of the transform, relative in the rms sense.
    weight : ndarray or float
        Further factor of each node.

    Returns
    -------
    ndarray of complex, (ny, nx)
        1 at the reference point without aberration, for a ``weight`` of 1.
    """
    from ..wave import _wave_kernels

    check_memory(nodes.u.shape, window)
    wave = residual.wavefront
    per_metre = 1 / (wave.wavelength * wave.image_distance)
    # The transform's modes run from -n//2, so its mode 0 is sample n//2.
    along, across = (
        per_metre * (shift - first - (n // 2) * window.pitch)
        for shift, first, n in zip(residual.shift, window.first, window.shape[::-1], strict=True)
    )
    points: ComplexArray = np.empty(nodes.u.size, dtype=np.complex128)
    parts = nodes.u, nodes.v, nodes.path, nodes.share * weight
    _wave_kernels.tilted_wave(
        *(read_only(part.ravel()) for part in parts), along, across, 1 / wave.wavelength, points
    )
    # a single row or column is a transform in one dimension
    axes = [axis for axis, n in enumerate(window.shape) if n > 1] or [0]
    coord: NDArray[np.floating[Any]] = np.empty((nodes.u.size, len(axes)))
    for k, axis in enumerate(axes):
        coord[:, k] = (nodes.v, nodes.u)[axis].ravel()
    coord *= 2 * math.pi * window.pitch * per_metre
    image = np.empty([window.shape[axis] for axis in axes], dtype=points.dtype)
    ducc0.nufft.nu2u(
        points=points, coord=coord, forward=True, epsilon=epsilon, nthreads=1, out=image
    )
    return image.reshape(window.shape)


def squares(field: ComplexArray) -> Array:
    """Return the squared modulus of a field."""
    from ..wave import _wave_kernels

    intensity = np.empty(field.shape)
    _wave_kernels.squares(field, intensity)
    return intensity


def noise(
    residual: Residual,
    nodes: Nodes,
    window: Window,
    intensity: Array,
    epsilon: float,
    blocks: tuple[int, int],
) -> Array:
    """Estimate the largest error of the modulus of `field` by the transform, in each block.

    The row of the brightest sample, or the column if that is longer, is computed again, a hundred
    times as accurate. The transform's kernel is a product over both directions, so that the errors
    along them add; twice their sum allows for samples beyond this line.
    """
    row, column = np.unravel_index(int(intensity.argmax()), window.shape)
    (ny, nx), (x, y), pitch = window.shape, window.first, window.pitch
    line, coarse = Window(pitch, (1, nx), (x, y + float(row) * pitch)), intensity[row]
    if ny > nx:
        line = Window(pitch, (ny, 1), (x + float(column) * pitch, y))
        coarse = intensity[:, column]
    fine = field(residual, nodes, line, max(epsilon / 100, BEST))
    error = np.abs(np.abs(fine.ravel()) - np.sqrt(coarse))
    # of the shorter side, as far from its middle
    sides = (np.linspace(0, error.size, n + 1).astype(int)[:-1] for n in blocks)
    return 2 * np.add.outer(*(np.maximum.reduceat(error, starts) for starts in sides))


def own_nodes(residual: Residual) -> Nodes:
    """Return the lit nodes of the wave, (n,)."""
    wave = residual.wavefront
    lit = wave.amplitude * wave.weights > 0
    parts = wave.u, wave.v, residual.aberration, wave.amplitude, wave.weights
    return Nodes(*(part[lit] for part in parts))


def reference_counts(residual: Residual, window: Window) -> tuple[int, int]:
    """Return the rings and the points per ring of `reference_nodes`."""
    v = math.pi * math.hypot(*window.reach_from(residual.shift)) / residual.airy_unit
    v += residual.wavenumber * residual.rays.slope * residual.wavefront.pupil_radius
    # twelve further degrees for the variation of a smooth amplitude
    return math.ceil(0.29 * v + 19), math.ceil(v + 12 * math.cbrt(v) + 24)


def reference_nodes(residual: Residual, window: Window) -> tuple[Nodes, float]:
    """Return polar nodes of the pupil that scattered nodes sample, as many as a window needs.

    The wave is interpolated to the round or annular pupil. The second result is the error of the
    field due to the interpolation, relative to its ideal peak.
    """
    n_r, n_theta = reference_counts(residual, window)
    fits_memory(
        f"the error estimate by {n_r} x {n_theta} nodes",
        600.0 * n_r * n_theta + n_bytes(0, window),
        "use a smaller shape",
    )
    u, v_, areas, path, amplitude, doubt = residual.local.on_polar(residual.wavefront, n_r, n_theta)
    nodes = Nodes(u, v_, path, amplitude, areas)
    return nodes, residual.wavenumber * float(np.sum(nodes.share * doubt))
