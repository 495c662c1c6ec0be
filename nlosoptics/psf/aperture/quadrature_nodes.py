"""Nodes and area weights of round and annular pupils."""

from __future__ import annotations

import math
from functools import lru_cache

import ducc0
import numpy as np

from ..._checks import fits_memory, in_range, positive, whole
from ..._vectors import Array

#: Largest number of nodes of a pupil that is cached for later waves, 0.4 MB.
KEPT = 2**14


@lru_cache(maxsize=64)
def gauss_legendre(n: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes on (0, 1), ascending, and their weights, which sum to 1.

    A node is ``(1 + x)/2`` with x = -cos(theta), computed as sin^2(theta/2) to keep relative
    accuracy near 0. Both arrays are cached and read-only.
    """
    theta = ducc0.misc.GL_thetas(n)
    return frozen(np.sin(theta / 2) ** 2), frozen(ducc0.misc.GL_weights(n, 1) / (4 * math.pi))


def frozen(array: Array) -> Array:
    """Make an array read-only and return it."""
    array.setflags(write=False)
    return array


def polar_nodes(
    radius: float, n_r: int, n_theta: int, obscuration: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return points on concentric rings of a round or annular pupil, with weights for integrals.

    The sum of ``weights * f(u, v)`` is the integral of a function f over the pupil. It is exact for
    polynomials in u and v of degree below min(4 n_r, n_theta).

    Parameters
    ----------
    radius : float
        Outer radius of the pupil, m.
    n_r, n_theta : int
        Number of rings, and of points on each ring.
    obscuration : float
        Inner radius of the pupil divided by the outer, 0 to 0.99. Default 0, a full disc.

    Returns
    -------
    u, v : ndarray
        Coordinates of the points (nodes), (n_r, n_theta), m.
    weights : ndarray
        Area that each node represents, (n_r, n_theta), m^2. The weights sum to the pupil's area.

    See Also
    --------
    grid_nodes : Square grid over a circular pupil.

    Notes
    -----
    The squared radii are Gauss-Legendre nodes, in ascending order; no node lies at the centre or on
    the rim. The angles are evenly spaced and begin on the u axis.

    Examples
    --------
    >>> from nlosoptics import psf
    >>> u, v, weights = psf.polar_nodes(radius=1e-3, n_r=4, n_theta=16)
    >>> u.shape
    (4, 16)
    >>> print(f"{1e6 * weights.sum():.6f} mm^2")
    3.141593 mm^2
    """
    radius = positive("radius", radius, unit="m")
    obscuration = in_range("obscuration", obscuration, 0.0, 0.99)
    n_r, n_theta = whole("n_r", n_r), whole("n_theta", n_theta)
    fits_memory(f"{n_r} x {n_theta} pupil nodes", 80.0 * n_r * n_theta, "use fewer")
    inner = obscuration**2
    fraction, weight = gauss_legendre(n_r)
    r = radius * np.sqrt(inner + (1 - inner) * fraction)
    angle = 2 * math.pi * np.arange(n_theta) / n_theta
    area = math.pi * radius**2 * (1 - inner) / n_theta
    weights = np.repeat((area * weight)[:, None], n_theta, axis=1)
    return r[:, None] * np.cos(angle), r[:, None] * np.sin(angle), weights


def grid_nodes(radius: float, samples: int, obscuration: float = 0.0) -> tuple[Array, Array, Array]:
    """Return a square grid over a round or annular pupil, with the area of each square inside it.

    Parameters
    ----------
    radius : float
        Outer radius of the pupil, m.
    samples : int
        Grid squares per side, n, 2 or more.
    obscuration : float
        Inner radius of the pupil divided by the outer, 0 to 0.99. Default 0, a full disc.

    Returns
    -------
    u, v : ndarray
        Centres of the squares, (n, n), m: ``(arange(n) - n//2) * pitch``; v increases from row to
        row, u along a row. The grid just encloses the pupil, so that the side ``pitch`` of a square
        is ``2 radius/n`` for odd n and ``2 radius/(n - 1)`` for even n.
    weights : ndarray
        Area of the part of each square inside the pupil, (n, n), m^2. It is exact also for squares
        that the rim crosses.

    See Also
    --------
    polar_nodes : Gauss nodes of a circular pupil.
    """
    positive("radius", radius, unit="m")
    samples = whole("samples", samples, 2)
    fits_memory(f"a pupil of {samples} x {samples} samples", 80.0 * samples**2, "use fewer")
    pitch = fitting_pitch(radius, samples)
    axis = (np.arange(samples, dtype=np.float64) - samples // 2) * pitch
    share = circle_shares(axis, axis, pitch, radius)
    if in_range("obscuration", obscuration, 0.0, 0.99) > 0:
        share -= circle_shares(axis, axis, pitch, obscuration * radius)
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v, np.maximum(share, 0.0) * pitch**2


def fitting_pitch(radius: float, samples: int) -> float:
    """Pitch at which a centred disc just fits a grid with sample ``samples//2`` at its centre."""
    return 2 * radius / (samples - 1 + samples % 2)


def circle_shares(
    x: Array, y: Array, pitch: float, radius: float, pitch_y: float | None = None
) -> Array:
    """Fraction of each grid cell within ``radius`` of the origin, (ny, nx).

    Cells are centred at ``x`` (nx,) and ``y`` (ny,), m. They are ``pitch`` wide and ``pitch_y``
    high, m; squares by default.
    """
    height = pitch if pitch_y is None else pitch_y
    edges_x = np.append(x - pitch / 2, x[-1] + pitch / 2)
    edges_y = np.append(y - height / 2, y[-1] + height / 2)
    corner = _corner_areas(edges_x, edges_y, radius)
    share = np.diff(np.diff(corner, axis=0), axis=1) / (pitch * height)
    # Outside the disc the differences of areas up to radius^2 leave rounding error, not area.
    share[share < 4 * np.finfo(np.float64).eps * radius**2 / (pitch * height)] = 0.0
    return np.clip(share, 0.0, 1.0)


def _corner_areas(x: Array, y: Array, radius: float) -> Array:
    """Signed area of the disc inside the rectangle from the origin to each corner, (ny, nx).

    For a corner inside the circle it is x y. Otherwise it is a rectangle up to
    ``xs = sqrt(R^2 - y^2)``, plus the area ``G(x) - G(xs)`` under the arc beyond.
    """

    def other_leg(t: Array) -> Array:
        return np.sqrt((radius - t) * (radius + t))

    def under_arc(t: Array) -> Array:
        # An arcsine would lose half the digits near t = R; here errors of `leg` cancel.
        leg = other_leg(t)
        return (t * leg + radius**2 * np.arctan2(t, leg)) / 2

    ax, ay = np.minimum(np.abs(x), radius), np.minimum(np.abs(y), radius)
    xs = other_leg(ay)
    inside = ax <= xs[:, None]
    bent = (ay * xs - under_arc(xs))[:, None] + under_arc(ax)
    area = np.where(inside, ay[:, None] * ax, bent)
    return np.asarray(area * np.sign(y)[:, None] * np.sign(x))
