"""Cubic fits to nearest nodes: slopes, second derivatives and values between scattered nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._vectors import Array
from ...errors import SamplingError
from ..aperture.curves import cross
from ..aperture.quadrature_nodes import polar_nodes
from .wavefront import Wavefront

#: Radius, in disc radii, of a ring of auxiliary points that closes the outermost Voronoi cells.
FAR: Final = 12.0
#: Number of those points.
RING: Final = 64


def cell_areas(sites: Array, radius: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the areas of Voronoi cells, their areas inside a disc, and the neighbouring pairs.

    Parameters
    ----------
    sites : ndarray, (n, 2)
        Points, m, at most 3 disc radii from the origin.
    radius : float
        Radius of the disc about the origin, m.

    Returns
    -------
    whole : ndarray, (n,)
        Area of each cell, m^2. The outermost cells end halfway to a ring of 12 disc radii.
    within : ndarray, (n,)
        Area of each cell inside the disc, m^2; the sum is the disc's area. For a site that
        coincides with another, both areas are 0.
    neighbours : ndarray of int, (m, 2)
        Index pairs of sites with a common cell edge.
    """
    from scipy.spatial import Voronoi

    n = len(sites)
    angle = 2 * np.pi * (np.arange(RING) + 0.5) / RING
    ring = FAR * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([sites / radius, ring])
    diagram = Voronoi(points)
    pairs = np.asarray(diagram.ridge_points, dtype=np.int64)
    corners = np.asarray(diagram.ridge_vertices, dtype=np.int64)
    closed = (corners >= 0).all(axis=1)
    pairs, corners = pairs[closed], corners[closed]
    start, end = diagram.vertices[corners[:, 0]], diagram.vertices[corners[:, 1]]
    whole, within = np.zeros(n + RING), np.zeros(n + RING)
    for side in (0, 1):
        owner = pairs[:, side]
        a, b = start - points[owner], end - points[owner]
        swept = cross(a, b)
        turn = np.sign(swept)
        whole += np.bincount(owner, np.abs(swept) / 2, minlength=n + RING)
        within += np.bincount(owner, turn * _sectors(start, end), minlength=n + RING)
    inner = (pairs < n).all(axis=1)
    scale = radius**2
    return whole[:n] * scale, np.maximum(within[:n], 0.0) * scale, pairs[inner]


def _sectors(a: Array, b: Array) -> Array:
    """Signed area inside the unit disc of the triangles (origin, a, b), (n,); a and b (n, 2)."""
    d = b - a
    square = np.sum(d * d, axis=1)
    along = -np.sum(a * d, axis=1)
    # Solve |a + t d| = 1 for t.
    root = along**2 - square * (np.sum(a * a, axis=1) - 1)
    crosses = (root > 0) & (square > 0)
    half = np.sqrt(np.where(crosses, root, 0.0))
    safe = np.where(square > 0, square, 1.0)
    enter, leave = ((along + s * half) / safe for s in (-1, 1))
    crosses &= (enter < 1) & (leave > 0)
    enter, leave = np.clip(enter, 0, 1), np.clip(leave, 0, 1)
    p, q = a + enter[:, None] * d, a + leave[:, None] * d
    cut = _angle(a, p) / 2 + cross(p, q) / 2 + _angle(q, b) / 2
    return np.where(crosses, cut, _angle(a, b) / 2)


def _angle(a: Array, b: Array) -> Array:
    """Signed angle from a to b, rad."""
    return np.asarray(np.arctan2(cross(a, b), np.sum(a * b, axis=1)))


Indices = NDArray[np.int64]

#: Number of nearest nodes to fit the nine terms of a cubic to. Each larger number is tried only
#: where the previous nodes lie on a few lines.
NEAREST: Final = (24, 96, 384)
#: Log determinant of the terms' correlations below which the nodes lie on a few lines; about -21
#: for random nodes.
IN_LINES: Final = -30.0
#: Number of nearest nodes that count as neighbours when jumps of the aberration are sought.
CLOSE: Final = 6
#: Number of nodes fitted at a time, small enough for the processor's cache.
BLOCK: Final = 4096
#: Amplitude times area, relative to the strongest node, below which a node counts as dark.
FAINT: Final = 1e-12
#: Ridge added to the normal equations, relative to their mean diagonal; it keeps the solution
#: finite for nodes on a line.
RIDGE: Final = 1e-13


@dataclass(frozen=True, eq=False)
class LocalFits:
    """Cubic polynomials for aberration and amplitude about every lit node.

    Parameters
    ----------
    places : ndarray, (n, 2)
        Coordinates (u, v) of the lit nodes, m.
    indices : ndarray of int, (n,)
        Indices of the lit nodes in the flattened wavefront.
    aberration : ndarray, (10, n)
        Coefficients of `terms` for the aberration, m; their arguments are distances from the node
        divided by ``scale``.
    amplitude : ndarray, (10, n)
        Coefficients of `terms` for the amplitude.
    scale : ndarray, (n,)
        Distance to the farthest node of each fit, m.
    jump : float
        Largest difference of the aberration between neighbouring nodes, m.
    jump_at : int
        Index, among the lit nodes, of a node with this difference.
    """

    places: Array
    indices: Indices
    aberration: Array
    amplitude: Array
    scale: Array
    jump: float
    jump_at: int

    @property
    def slopes(self) -> Array:
        """Gradient of the aberration at the nodes, (n, 2)."""
        return np.asarray((self.aberration[1:3] / self.scale).T)

    def on_polar(
        self, wave: Wavefront, n_r: int, n_theta: int
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Interpolate the wave to polar nodes of its pupil by blending the three nearest cubics.

        Returns
        -------
        u, v, weights, aberration, amplitude, doubt : ndarray, (n_r n_theta,)
            Coordinates, m; areas, m^2; aberration, m; amplitude; and the weighted standard
            deviation of the three predictions of the aberration, m.
        """
        u, v, weights = (
            a.ravel() for a in polar_nodes(wave.pupil_radius, n_r, n_theta, wave.obscuration)
        )
        count = min(4, len(self.places))
        distance, owner = _nearest(self.places, np.stack([u, v], axis=1), count)
        used = max(1, count - 1)
        share = (1 - distance[:, :used] / (distance[:, -1:] * (1 + 1e-9) + 1e-300)) ** 2
        share /= share.sum(axis=1, keepdims=True)
        path, height = np.empty_like(share), np.empty_like(share)
        for i in range(used):
            site = owner[:, i]
            step = terms(
                (u - self.places[site, 0]) / self.scale[site],
                (v - self.places[site, 1]) / self.scale[site],
            )
            path[:, i] = np.einsum("tn,tn->n", step, self.aberration[:, site])
            height[:, i] = np.einsum("tn,tn->n", step, self.amplitude[:, site])
        mean = np.einsum("ni,ni->n", share, path)
        doubt = np.sqrt(np.einsum("ni,ni->n", share, (path - mean[:, None]) ** 2))
        amplitude = np.maximum(np.einsum("ni,ni->n", share, height), 0.0)
        return u, v, weights, mean, amplitude, doubt


def terms(x: Array, y: Array) -> Array:
    """Return the ten monomials of x and y up to the third degree, (10, ...)."""
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])


def local_fits(wave: Wavefront, aberration: Array) -> LocalFits:
    """Fit a cubic about each lit node of a grid or scattered wavefront.

    Each cubic passes through its own node; the weight of other nodes falls with distance.

    Parameters
    ----------
    wave : Wavefront
        Wave with the nodes and the amplitude.
    aberration : ndarray
        Aberration to fit, m, of the shape of the wave's nodes.

    Raises
    ------
    SamplingError
        If nodes lie on a few lines, so that slopes across them are unknown.
    """
    strength = (wave.amplitude * wave.weights).ravel()
    indices = np.flatnonzero(strength > FAINT * strength.max())
    places = np.stack([wave.u.ravel()[indices], wave.v.ravel()[indices]], axis=1)
    values = np.stack([aberration.ravel()[indices], wave.amplitude.ravel()[indices]])
    n = len(indices)
    series = np.zeros((2, 10, n))
    series[:, 0] = values
    scale = np.full(n, wave.pupil_radius)
    rise = np.zeros(n)
    left = np.arange(n if n > 1 else 0)
    for count in NEAREST:
        k, again = min(count, n - 1), []
        for start in range(0, len(left), BLOCK):
            block = left[start : start + BLOCK]
            distance, near = _nearest(places, places[block], k + 1)
            near = near[:, 1:]
            scale[block] = np.maximum(distance[:, -1], 1e-12 * wave.pupil_radius)
            step = (places[near] - places[block, None]) / scale[block, None, None]
            change = values[:, near] - values[:, block, None]
            series[:, 1:, block], volume = _solved(step, change)
            rise[block] = np.maximum(rise[block], np.abs(change[0, :, :CLOSE]).max(axis=1))
            again.append(block[volume < IN_LINES])
        left = np.concatenate(again) if again else left
    if left.size:
        raise SamplingError(
            f"wavefront node {int(indices[left[0]])} and the {k} nodes nearest to it lie on a few "
            "lines, so that slopes across them are unknown; spread more nodes over the pupil"
        )
    return LocalFits(
        places,
        indices,
        series[0],
        series[1],
        scale,
        float(rise.max()),
        int(np.argmax(rise)),
    )


def _nearest(places: Array, points: Array, count: int) -> tuple[Array, Indices]:
    """Distances and indices (m, count) of the places nearest to each of the points (m, 2)."""
    from scipy.spatial import cKDTree

    found = cKDTree(places).query(points, k=list(range(1, count + 1)))
    return np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)


def _solved(step: Array, rise: Array) -> tuple[Array, Array]:
    """Fit cubics without constant term to the changes of two functions about b nodes.

    ``step`` (b, k, 2) are the scaled distances to k other nodes and ``rise`` (2, b, k) the changes.
    Returns the coefficients (2, 9, b), and the log determinant of the terms' correlations (b,),
    see `IN_LINES`.
    """
    basis = np.moveaxis(terms(step[..., 0], step[..., 1])[1:], 0, 2)
    weight = np.maximum(1.1 - np.sum(step**2, axis=2), 0.0) ** 2
    # einsum does not call BLAS, so results are bit-identical for any thread count.
    moments = np.einsum("bkt,bk,bks->bts", basis, weight, basis)
    right = np.einsum("bkt,bk,fbk->btf", basis, weight, rise)
    size = np.sqrt(np.einsum("btt->bt", moments)).clip(min=1e-150)
    volume = np.linalg.slogdet(moments / (size[:, :, None] * size[:, None, :]))[1]
    trace = np.einsum("btt->b", moments) / 9
    moments[:, np.arange(9), np.arange(9)] += RIDGE * trace[:, None]
    found = np.linalg.solve(moments, right)
    return np.moveaxis(found, (2, 1), (0, 1)), np.asarray(volume)
