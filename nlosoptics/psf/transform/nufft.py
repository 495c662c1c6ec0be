"""Sum over pupil nodes of any layout to a window, by a non-uniform fast Fourier transform.

Each node, or traced ray, has the weight amplitude times area.
"""

from __future__ import annotations

import math

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import read_only
from ..wave.detilted import Residual
from ..window.window import Window

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Number of nodes plus points up to which the transform uses the accuracy `BEST`.
SMALL = 200_000
#: Relative accuracy of the transform: the best available, and the coarsest used of given nodes.
BEST, FAST = 2e-13, 1e-8
#: Coarsest accuracy used of chosen nodes: beyond it the largest error exceeds twice the requested.
COARSEST = 1e-3


def epsilon(n_nodes: int, window: Window, tol: float) -> float:
    """Return the relative accuracy to request of the transform: the best one if it is cheap."""
    if n_nodes + window.shape[0] * window.shape[1] <= SMALL:
        return BEST
    return max(min(FAST, tol / 100), BEST)


def n_bytes(n_nodes: int, window: Window) -> float:
    """Return the peak memory: 100 bytes per node, 64 per image point with oversampling."""
    return 100.0 * n_nodes + 64.0 * window.shape[0] * window.shape[1]


def image_field(
    residual: Residual,
    u: Array,
    v: Array,
    path: Array,
    size: Array,
    window: Window,
    epsilon: float,
) -> ComplexArray:
    """Compute ``sum size exp(ik path) exp(-2 pi i x.p/(lambda d))`` at the points of a window.

    Parameters
    ----------
    residual : Residual
        Wave, for the wavelength, the image distance and the tilt's shift, from which x is counted.
    u, v, path, size : ndarray
        Nodes and aberration, m, and weights; all of one shape.
    window : Window
        Image points x.
    epsilon : float
        Requested error of the transform, relative in the rms sense.

    Returns
    -------
    ndarray of complex, (ny, nx)
    """
    points, coord = node_phasors(residual, u, v, path, size, window)
    image = np.empty(window.shape, dtype=np.complex128)
    ducc0.nufft.nu2u(
        points=points, coord=coord, forward=True, epsilon=epsilon, nthreads=1, out=image
    )
    return image


def node_phasors(
    residual: Residual, u: Array, v: Array, path: Array, size: Array, window: Window
) -> tuple[ComplexArray, Array]:
    """Return the points (n,) and coordinates (n, 2) of the transform in `image_field`."""
    from ..wave import _wave_kernels

    wave = residual.wavefront
    per_metre = 1 / (wave.wavelength * wave.image_distance)
    # The transform's modes run from -n//2, so its mode 0 is sample n//2.
    along, across = (
        per_metre * (shift - first - (n // 2) * window.pitch)
        for shift, first, n in zip(residual.shift, window.first, window.shape[::-1], strict=True)
    )
    points = np.empty(u.size, dtype=np.complex128)
    nodes = (read_only(part.ravel()) for part in (u, v, path, size))
    _wave_kernels.tilted_wave(*nodes, along, across, 1 / wave.wavelength, points)
    coord = np.empty((u.size, 2))
    coord[:, 0], coord[:, 1] = v.ravel(), u.ravel()
    coord *= 2 * math.pi * window.pitch * per_metre
    return points, coord


def field(residual: Residual, window: Window, epsilon: float = BEST) -> ComplexArray:
    """Return the image field (ny, nx) of the wavefront's own nodes.

    It is 1 at the reference point without aberration.
    """
    wave = residual.wavefront
    size = wave.amplitude * wave.weights
    lit = size > 0
    count = int(np.count_nonzero(lit))
    fits_memory(
        f"the sum over {count} nodes to {window.shape[0]} x {window.shape[1]} points",
        n_bytes(count, window),
        "use a smaller shape",
    )
    return image_field(
        residual,
        wave.u[lit],
        wave.v[lit],
        residual.aberration[lit],
        size[lit] / residual.amplitude_sum,
        window,
        epsilon,
    )


def reference(
    residual: Residual, window: Window, epsilon: float
) -> tuple[ComplexArray, float, float, float]:
    """Compute a reference field for scattered nodes, to estimate their error.

    The wave is interpolated to polar nodes of the round or annular pupil that it samples.

    Parameters
    ----------
    residual : Residual
        Wave on scattered nodes.
    window : Window
        Image points.
    epsilon : float
        Requested error of the transform, relative in the rms sense.

    Returns
    -------
    field : ndarray of complex, (ny, nx)
        1 at the reference point without aberration.
    total, energy : float
        Integrals of the amplitude and of its square, m^2.
    doubt : float
        Error of the field due to the interpolation.
    """
    u, v_, weights, path, amplitude, doubt = reference_nodes(residual, window)
    total = float(np.sum(amplitude * weights))
    share = amplitude * weights / total
    image = image_field(residual, u, v_, path, share, window, epsilon)
    energy = float(np.sum(amplitude**2 * weights))
    return image, total, energy, residual.wavenumber * float(np.sum(share * doubt))


def reference_nodes(
    residual: Residual, window: Window
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return polar nodes of the pupil that scattered nodes sample, as many as a window needs.

    Returns
    -------
    u, v, weights, path, amplitude, doubt : ndarray, (n,)
        Coordinates, m, areas, m^2, interpolated aberration, m, and amplitude, and the error of the
        aberration, m.
    """
    wave = residual.wavefront
    v = math.pi * math.hypot(*window.reach_from(residual.shift)) / residual.airy_unit
    v += residual.wavenumber * residual.rays.slope * wave.pupil_radius
    # twelve further degrees for the variation of a smooth amplitude
    n_r, n_theta = math.ceil(0.29 * v + 19), math.ceil(v + 12 * v ** (1 / 3) + 24)
    fits_memory(
        f"the error estimate by {n_r} x {n_theta} nodes",
        600.0 * n_r * n_theta + n_bytes(0, window),
        "use a smaller shape",
    )
    return residual.local.on_polar(wave, n_r, n_theta)
