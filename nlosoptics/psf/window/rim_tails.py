"""Bounds on the diffraction tails of a pupil, from the straight edges and arcs of its rims."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from ..._vectors import Array
from ..aperture.aperture import Aperture
from ..aperture.curves import cross, lengths
from ..wave.wavefront import Wavefront

#: Largest contribution of an arc with radius of curvature rho, in units of sqrt(rho/f).
ARC = 1.2


def edge_ratio(wave: Wavefront, outline: Aperture | None = None) -> float:
    """Return the ratio of rim length to area, divided by that of a disc of the pupil radius.

    ``outline`` is the pupil's outline if the wave does not contain it.
    """
    aperture = outline or wave.aperture
    if aperture is None:
        return 1 / (1 - wave.obscuration)
    return aperture.perimeter * wave.pupil_radius / (2 * aperture.area)


def tail(aperture: Aperture, x: Array, y: Array) -> Array:
    """Bound the field of a clear aperture, 1 at its peak, at spatial frequencies (x, y), 1/m.

    The transform is a sum over the rim. A straight edge contributes
    ``L sinc(f_t L) f_n/(2 pi f^2 A)`` (Komrska, JOSA 72, 1382 (1982)). An arc contributes
    ``sqrt(rho/f)/(2 pi f A)`` where its normal is along f. The frequency is the image position
    divided by wavelength times distance.
    """
    f = np.hypot(x, y)
    f = np.maximum(f, 1e-3 / aperture.bounding_radius)  # avoids 0; the bound is 1 below this
    edges, arcs = _split(aperture)
    total = np.zeros(np.broadcast(x, y).shape)
    for along_u, along_v, length, number in edges:
        along = np.maximum(math.pi * np.abs(x * along_u + y * along_v), 1 / length)
        total += number / along
    for length, rho in arcs:
        total += np.minimum(length, ARC * np.sqrt(rho / f))
    return np.asarray(np.minimum(total / (2 * math.pi * f * aperture.area), 1.0))


def reach(aperture: Aperture, scale: float, pitch: float, share: float) -> float:
    """Distance beyond which the spikes of straight edges are below ``share`` in any pixel, m.

    ``share`` is a fraction of the total energy, ``pitch`` the pixel side, m, and ``scale`` the
    wavelength times the distance, m^2. Edges of one direction, of length L each and S in total,
    make a spike perpendicular to them. It has the energy ``S^2/(4 pi^2 A r^2)`` per area, over a
    width of about ``2 scale/L``.
    """
    edges, _ = _split(aperture)
    farthest = 0.0
    for _, _, length, number in edges:
        covered = pitch * min(pitch, 2 * scale / length)
        square = (length * number) ** 2 * covered / (4 * math.pi**2 * aperture.area * share)
        farthest = max(farthest, math.sqrt(square))
    return farthest


@lru_cache(maxsize=8)
def _split(aperture: Aperture) -> tuple[Array, Array]:
    """Divide a pupil's rims into straight edges, grouped by direction and length, and arcs.

    Each row of edges (n, 4) has the components of a unit vector, the length, m, and the number of
    such edges; each row of arcs (m, 2) has the length and the largest radius of curvature, m.
    """
    rims, size = aperture.rims, lengths(aperture.rims)
    bent = rims.turn != 0
    found: dict[tuple[int, int, int], int] = {}
    for step, length in zip(rims.step[~bent], size[~bent], strict=True):
        a, b = (round(1e6 * x / length) for x in step)
        # Rounded before this, so that rounding error does not split vertical edges into two groups.
        if (a, b) < (0, 0):
            a, b = -a, -b
        key = (a, b, round(1e6 * length / aperture.bounding_radius))
        found[key] = found.get(key, 0) + 1
    keys = np.array(list(found), dtype=np.float64).reshape(-1, 3) / 1e6
    keys[:, 2] = np.maximum(keys[:, 2], 1e-6) * aperture.bounding_radius
    edges = np.column_stack([keys, list(found.values())])
    # largest radius of curvature, |r'|^3/|r' x r''|
    rate = np.hypot(*np.moveaxis(rims.rate(np.linspace(0, 1, 33)), -1, 0))[bent].max(axis=1)
    bend = np.abs(rims.turn[bent]) ** 3 * np.abs(cross(rims.cosine, rims.sine))[bent]
    return edges, np.column_stack([size[bent], rate**3 / bend])
