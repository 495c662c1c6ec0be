"""Directional albedos by numerical quadrature, for lobes without a closed form."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ._material import Array, Material


def directional_albedo(theta: Array, integral: Callable[[float], float]) -> Array:
    """Return ``integral(theta)`` for every angle of incidence, in the shape of ``theta``."""
    return np.array([integral(t) for t in theta.ravel().tolist()]).reshape(theta.shape)


def _panels(edges: ArrayLike) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights on the panels between ``edges`` (n, ...), axis 0."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    edges = np.asarray(edges, dtype=np.float64)
    middles, halves = (edges[1:] + edges[:-1]) / 2, np.diff(edges, axis=0) / 2
    points = middles[:, None] + np.multiply.outer(nodes, halves).swapaxes(0, 1)
    heavy = np.multiply.outer(weights, halves).swapaxes(0, 1)
    return points.reshape(-1, *edges.shape[1:]), heavy.reshape(-1, *edges.shape[1:])


def over_exitant_angles(material: Material, theta: float) -> float:
    """Integrate f cos(theta) of a wide lobe over the exitant hemisphere, for one incidence angle.

    The panels end at the kinks of the full Oren-Nayar model: exitant angle equal to the incident
    angle, and azimuth pi/2.
    """
    edges = theta + 0.05 * np.array([-20.0, -8, -3, -1, 0, 1, 3, 8, 20])
    edges = np.concatenate([[0.0], edges[(edges > 0) & (edges < math.pi / 2)], [math.pi / 2]])
    polar, polar_weights = _panels(edges)
    # azimuths on one side of the plane of incidence; the result is doubled
    turn, turn_weights = _panels([0.0, 0.05, 0.15, 0.5, math.pi / 2, math.pi])
    p, a = np.meshgrid(polar, turn, indexing="ij")
    exitant = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1)
    incident = (math.sin(theta), 0.0, math.cos(theta))
    f = material.evaluate(incident, exitant, (0.0, 0.0, 1.0))
    return 2 * float((f * np.sin(p) * np.cos(p) * polar_weights[:, None] * turn_weights).sum())


def around_incident(theta: float, angle: float) -> float:
    """Integrate f cos(theta) of a retroreflecting lobe of albedo 1 over cones about theta."""
    sharp = angle**-2
    polar, weights = _panels(np.linspace(0.0, min(8.5 * angle, math.pi), 9))
    weights *= sharp * np.exp(-2 * sharp * np.sin(polar / 2) ** 2) * np.sin(polar)
    # azimuths from the horizon, where the exitant cosine is 0, to that of the steepest exitant
    level, across = math.cos(theta) * np.cos(polar), max(math.sin(theta), 1e-300) * np.sin(polar)
    first = np.arccos(np.clip(level / across, -1.0, 1.0))
    turn, turn_weights = _panels(np.linspace(first, math.pi, 3))
    mu = np.maximum(level - across * np.cos(turn), 0.0)
    inside = (turn_weights * mu / np.maximum(math.cos(theta) + mu, 1e-300)).sum(axis=0)
    return float(2.0 * inside @ weights / (-math.pi * math.expm1(-2.0 * sharp)))


def over_slopes(material: Material, theta: float, scale: float, *, smooth: bool = True) -> float:
    """Integrate f cos(theta) of a half-vector lobe over the facet slopes (p, q), for one angle.

    The facet with normal (-p, -q, 1) reflects the light to the exitant o, with
    ``dOmega_o = 4 (i.h) cos^3(h) dp dq``. Facets that reflect below the horizon lie outside a
    circle of radius 1/cos(theta) about (-tan(theta), 0).
    """
    sine, cosine = math.sin(theta), math.cos(theta)
    reach = 8.5 * scale if smooth else 1e7 * scale  # the rest is below exp(-36) or 1e-12
    # q = sin(turn)/cos(theta) removes the square-root singularity at the ends of the circle
    last = min(1.0, reach * cosine)
    if smooth:
        turns = np.linspace(0.0, math.asin(last), 5)
    else:
        turns = np.arcsin(np.append(_doublings(scale * cosine, last), last))
    turn, turn_weights = _panels(turns)
    q, q_weights = np.sin(turn) / cosine, np.cos(turn) / cosine * turn_weights
    # equals cos(turn)/cos(theta) - tan(theta), but without cancellation at grazing incidence
    top = (1 - q * q) * cosine / (np.cos(turn) + sine)
    bottom = -(np.cos(turn) + sine) / cosine
    low, high = np.clip(bottom, -reach, reach), np.clip(top, -reach, reach)
    if smooth:
        edges = np.linspace(low, high, 5)
    else:
        lobe = _doublings(scale, reach)[:, None] * np.ones(turn.size)
        ends = np.geomspace(1e-9, 0.25, 11)[:, None] * (high - low)
        stacked = np.concatenate([[low, high], lobe, -lobe, low + ends, high - ends])
        edges = np.sort(np.clip(stacked, low, high), axis=0)
    p, p_weights = _panels(edges)
    facet = np.stack(np.broadcast_arrays(-p, -q, 1.0), axis=-1)
    cos_h = 1 / np.linalg.norm(facet, axis=-1)
    half = facet * cos_h[..., None]
    incident = np.array([sine, 0.0, cosine])
    along = half @ incident
    exitant = 2 * along[..., None] * half - incident
    f = material.evaluate(incident, exitant, (0.0, 0.0, 1.0))
    integrand = f * np.maximum(exitant[..., 2], 0.0) * 4 * along * cos_h**3
    return 2 * float((integrand * p_weights * q_weights).sum())


def _doublings(scale: float, last: float) -> Array:
    """Return 0 and ``scale`` times powers of 4 below ``last``: panels that widen along a tail."""
    count = max(0, math.ceil(math.log(last / scale, 4.0)))
    return np.append(0.0, scale * 4.0 ** np.arange(count))
