"""Pupil nodes and the area that each stands for."""

from __future__ import annotations

import math
from functools import lru_cache

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, in_range, positive, whole

Array = NDArray[np.float64]

#: Most nodes of a pupil that are kept for the next wave, 0.4 MB.
KEPT = 2**14


@lru_cache(maxsize=64)
def gauss_legendre(n: int) -> tuple[Array, Array]:
    """Half-open fractions ``(1 + x)/2`` of the Gauss-Legendre nodes x, ascending, and weights.

    The weights sum to 1. The fraction is sin^2(theta/2), which keeps its digits near 0. Both are
    kept, and read-only.
    """
    theta = ducc0.misc.GL_thetas(n)
    return frozen(np.sin(theta / 2) ** 2), frozen(ducc0.misc.GL_weights(n, 1) / (4 * math.pi))


def frozen(array: Array) -> Array:
    """The array itself, from now on read-only."""
    array.setflags(write=False)
    return array


def polar_nodes(
    radius: float, n_r: int, n_theta: int, obscuration: float = 0.0
) -> tuple[Array, Array, Array]:
    """Nodes of a round or annular pupil: Gauss-Legendre in r^2, equal steps in angle.

    Exact for polynomials of u and v whose degree is below min(4 n_r, n_theta).

    Parameters
    ----------
    radius : float
        Outer radius, m.
    n_r, n_theta : int
        Radii and angles.
    obscuration : float
        Inner radius as a fraction of the outer, 0 to 1.

    Returns
    -------
    u, v, weights : ndarray
        (n_r, n_theta); m, m and m^2. The weights sum to the pupil's area.
    """
    u, v, weights = shared_polar_nodes(radius, n_r, n_theta, obscuration)
    if u.size > KEPT:
        return u, v, weights
    return u.copy(), v.copy(), weights.copy()


def shared_polar_nodes(
    radius: float, n_r: int, n_theta: int, obscuration: float
) -> tuple[Array, Array, Array]:
    """`polar_nodes`, those kept and read-only where there are at most `KEPT`."""
    radius, obscuration = positive("radius", radius, unit="m"), _inner(obscuration)
    n_r, n_theta = whole("n_r", n_r), whole("n_theta", n_theta)
    fits_memory(f"{n_r} x {n_theta} pupil nodes", 80.0 * n_r * n_theta, "use fewer")
    make = kept_polar_nodes if n_r * n_theta <= KEPT else _polar_nodes
    return make(radius, n_r, n_theta, obscuration)


def _polar_nodes(
    radius: float, n_r: int, n_theta: int, obscuration: float
) -> tuple[Array, Array, Array]:
    inner = obscuration**2
    fraction, weight = gauss_legendre(n_r)
    r = radius * np.sqrt(inner + (1 - inner) * fraction)
    angle = 2 * math.pi * np.arange(n_theta) / n_theta
    area = math.pi * radius**2 * (1 - inner) / n_theta
    weights = np.repeat((area * weight)[:, None], n_theta, axis=1)
    return r[:, None] * np.cos(angle), r[:, None] * np.sin(angle), weights


@lru_cache(maxsize=16)
def kept_polar_nodes(
    radius: float, n_r: int, n_theta: int, obscuration: float
) -> tuple[Array, Array, Array]:
    """`polar_nodes` of checked arguments, at most `KEPT` nodes, kept and read-only."""
    u, v, weights = _polar_nodes(radius, n_r, n_theta, obscuration)
    return frozen(u), frozen(v), frozen(weights)


@lru_cache(maxsize=16)
def kept_even(n_r: int, n_theta: int) -> Array:
    """Amplitude 1 on at most `KEPT` polar nodes, kept and read-only."""
    return frozen(np.ones((n_r, n_theta)))


def grid_nodes(radius: float, samples: int, obscuration: float = 0.0) -> tuple[Array, Array, Array]:
    """Square grid over a round or annular pupil, each cell with its exact area inside.

    Parameters
    ----------
    radius : float
        Outer radius, m.
    samples : int
        Cells per side.
    obscuration : float
        Inner radius as a fraction of the outer, 0 to 1.

    Returns
    -------
    u, v, weights : ndarray
        (samples, samples), rows are v; m, m and m^2. Coordinates are
        ``(arange(n) - n//2) * pitch`` with the pitch at which the pupil just fits:
        ``2 radius/n`` for odd n, ``2 radius/(n - 1)`` for even n.
    """
    positive("radius", radius, unit="m")
    samples = whole("samples", samples, 2)
    fits_memory(f"a pupil of {samples} x {samples} samples", 80.0 * samples**2, "use fewer")
    pitch = fitting_pitch(radius, samples)
    axis = (np.arange(samples, dtype=np.float64) - samples // 2) * pitch
    share = circle_shares(axis, axis, pitch, radius)
    if _inner(obscuration) > 0:
        share -= circle_shares(axis, axis, pitch, obscuration * radius)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v, np.maximum(share, 0.0) * pitch**2


def fitting_pitch(radius: float, samples: int) -> float:
    """Pitch at which a centred disc just fits a grid whose middle sample is ``samples//2``."""
    return 2 * radius / (samples - 1 + samples % 2)


def circle_shares(
    x: Array, y: Array, pitch: float, radius: float, pitch_y: float | None = None
) -> Array:
    """Share of each cell of the grid ``y`` by ``x`` that lies within ``radius`` of 0, (ny, nx).

    Cells are squares, or ``pitch`` by ``pitch_y``.
    """
    height = pitch if pitch_y is None else pitch_y
    edges_x = np.append(x - pitch / 2, x[-1] + pitch / 2)
    edges_y = np.append(y - height / 2, y[-1] + height / 2)
    corner = _corner_areas(edges_x, edges_y, radius)
    share = np.diff(np.diff(corner, axis=0), axis=1) / (pitch * height)
    # cells outside hold the rounding of areas up to radius^2, which must not pass for light
    share[share < 4 * np.finfo(np.float64).eps * radius**2 / (pitch * height)] = 0.0
    return np.clip(share, 0.0, 1.0)


def _corner_areas(x: Array, y: Array, radius: float) -> Array:
    """Signed area of the disc within the rectangle from 0 to each corner, (len(y), len(x)).

    Inside the circle it is x y; beyond, the part left of ``xs = sqrt(R^2 - y^2)`` is a rectangle
    and the rest the area under the arc, ``G(x) - G(xs)``.
    """

    def other_leg(t: Array) -> Array:
        return np.sqrt((radius - t) * (radius + t))

    def under_arc(t: Array) -> Array:
        # An arcsine would lose half the digits at t = R; here an error of the leg cancels.
        leg = other_leg(t)
        return (t * leg + radius**2 * np.arctan2(t, leg)) / 2

    ax, ay = np.minimum(np.abs(x), radius), np.minimum(np.abs(y), radius)
    xs = other_leg(ay)
    inside = ax <= xs[:, None]
    bent = (ay * xs - under_arc(xs))[:, None] + under_arc(ax)
    area = np.where(inside, ay[:, None] * ax, bent)
    return np.asarray(area * np.sign(y)[:, None] * np.sign(x))


def _inner(obscuration: float) -> float:
    in_range("obscuration", obscuration, 0.0, 0.99)
    return float(obscuration)
