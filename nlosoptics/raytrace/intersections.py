"""First hit of rays on the relay wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..scene.walls import CYLINDER, GRID, SPHERE, WAVE, Wall

Array = NDArray[np.float64]

HIT: Final = 0
MISS: Final = 1
OUTSIDE: Final = 2
UNRESOLVED: Final = 3
BEHIND: Final = 4


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet a wall; read-only arrays of the rays' shape.

    Parameters
    ----------
    distance : ndarray, (...)
        From the origin along the unit direction, m; NaN where there is no hit.
    points : ndarray, (..., 3)
        World, m; NaN where there is no hit.
    normals : ndarray, (..., 3)
        Unit normals toward the room; NaN where there is no hit.
    status : ndarray of int8, (...)
        0 hit; 1 no hit, the ray does not go down toward the mean plane; 2 it does, but beyond the
        wall's edges; 3 it touches the wall or grazes it too long to be resolved; 4 it starts
        behind the wall or comes through its back.
    """

    distance: Array
    points: Array
    normals: Array
    status: NDArray[np.int8]

    def __post_init__(self) -> None:
        for array in (self.distance, self.points, self.normals, self.status):
            array.flags.writeable = False

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Whether each ray meets the wall."""
        return np.asarray(self.status == HIT)


def intersect(wall: Wall, origins: ArrayLike, directions: ArrayLike) -> Hits:
    """First hit of every ray on the wall, from its room side.

    Parameters
    ----------
    wall : Wall
    origins : array_like, (..., 3)
        World, m.
    directions : array_like, (..., 3)
        World, of any length but zero; the shapes broadcast.

    Returns
    -------
    Hits
        Distances good to 1e-12 of the ray's length, except where rays graze.

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, or a direction is zero.

    Notes
    -----
    Planes, spheres and cylinders are closed forms. Other walls are marched: with M a bound on the
    second derivative of the height above the wall along the ray, the root of f + f' s - M s^2/2 is
    a step that never passes a crossing and turns into Newton's near one.

    A sum of walls that has a curved term and no size is searched to 0.999 of its radius.
    """
    o, d = _rays(origins, directions)
    if wall.is_flat:
        return _plane(wall, o, d)
    from . import _kernels

    shape = o.shape[:-1]
    terms, tables = wall._terms()
    count = math.prod(shape)
    distance = np.full(count, np.nan)
    points, normals = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    status = np.empty(count, dtype=np.int8)
    curvature, box, slab, rim = _bounds(wall, terms, tables)
    _kernels.intersect(
        terms,
        tables,
        curvature,
        box,
        slab,
        rim,
        o.reshape(-1, 3),
        d.reshape(-1, 3),
        distance,
        points,
        normals,
        status,
    )
    return Hits(
        distance.reshape(shape),
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        status.reshape(shape),
    )


def _rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
    """Origins and unit directions of one shape (..., 3), checked."""
    o, d = (np.asarray(v, dtype=np.float64) for v in (origins, directions))
    for name, v in (("origins", o), ("directions", d)):
        if v.ndim == 0 or v.shape[-1] != 3:
            raise SceneError(f"{name} has shape {v.shape}; give (..., 3), x, y and z in m")
        if not np.isfinite(v).all():
            place = np.argwhere(~np.isfinite(v))[0][:-1].tolist()
            raise SceneError(f"{name}{place} holds NaN or infinity; give finite components")
    largest = np.abs(d).max(axis=-1)
    if (largest == 0.0).any():
        place = np.argwhere(largest == 0.0)[0].tolist()
        raise SceneError(f"directions{place} is zero; a ray needs a direction")
    d = d / largest[..., None]  # first, so that squares neither overflow nor vanish
    d = d / np.sqrt((d * d).sum(axis=-1))[..., None]
    try:
        o, d = np.broadcast_arrays(o, d)
    except ValueError:
        raise SceneError(
            f"origins {o.shape} and directions {d.shape} do not broadcast; give equal shapes"
        ) from None
    # copies: a broadcast of one ray is contiguous and yet not its own
    return np.array(o, order="C"), np.array(d, order="C")


def _plane(wall: Wall, o: Array, d: Array) -> Hits:
    """Hits on the plane z = 0, without compiled code."""
    status = np.where(o[..., 2] < 0, BEHIND, np.where(d[..., 2] < 0, HIT, MISS)).astype(np.int8)
    down = status == HIT
    distance = np.full(status.shape, np.nan)
    np.divide(o[..., 2], -d[..., 2], out=distance, where=down)
    points = o + distance[..., None] * d
    points[..., 2] = np.where(down, 0.0, np.nan)
    status[down & ~wall.contains(points[..., 0], points[..., 1])] = OUTSIDE
    missed = status != HIT
    distance[missed] = np.nan
    points[missed] = np.nan
    normals = np.zeros_like(points)
    normals[..., 2] = 1.0
    normals[missed] = np.nan
    return Hits(distance, points, normals, status)


def _bounds(wall: Wall, terms: Array, tables: Array) -> tuple[Array, Array, Array, float]:
    """Limits of a search: curvature of gridded terms, box, height slab and rim."""
    margin = 0.999  # of a radius: at the rim itself the slope is infinite
    size = wall.size
    box = np.array([math.inf, math.inf] if size is None else [size[0] / 2, size[1] / 2])
    single = len(terms) == 1
    rim = math.inf
    for row in terms if not single else ():
        if row[0] == SPHERE:
            rim = min(rim, margin / abs(row[1]))
        elif row[0] == CYLINDER:
            along = 0 if row[2] else 1
            box[along] = min(box[along], margin / abs(row[1]))
    if np.hypot(*box) <= rim:
        rim = math.inf
    slab = np.zeros(2)
    curvature = np.zeros(len(terms))
    for i, row in enumerate(terms):
        if row[0] == WAVE:
            slab += (-abs(row[1]), abs(row[1]))
        elif row[0] in (SPHERE, CYLINDER):
            slab += (min(0.0, 1 / row[1]), max(0.0, 1 / row[1]))
        elif row[0] == GRID:
            low, high, curvature[i] = _grid_limits(row, tables)
            slab += (low, high)
    pad = 1e-9 + 1e-12 * np.abs(slab).max()  # rounding must not cut a crest
    slab[0] -= pad
    slab[1] += pad
    return curvature, box, slab, rim


def _grid_limits(row: Array, tables: Array) -> tuple[float, float, float]:
    """Lowest and highest height of a bicubic Hermite surface and a bound on its curvature.

    From the Hermite basis on [0, 1]: values mix convexly, slopes add at most step/4 of their
    size; a first derivative is at most 3/2 of the difference quotient plus the largest slope; a
    second derivative is linear between nodes.
    """
    sx, sy, nx, ny, offset = row[3], row[4], int(row[5]), int(row[6]), int(row[7])
    v, vx, vy, vxy = tables[offset : offset + 4 * nx * ny].reshape(4, ny, nx)

    def top(a: Array) -> float:
        return float(np.abs(a).max())

    def second(values: Array, slopes: Array, step: float) -> float:
        quotient = 6 * np.diff(values) / step
        start, stop = slopes[:, :-1], slopes[:, 1:]
        return (
            max(top(quotient - 4 * start - 2 * stop), top(quotient - 2 * start - 4 * stop)) / step
        )

    swing = (sx * top(vx) + sy * top(vy)) / 4 + sx * sy * top(vxy) / 16
    hxx = second(v, vx, sx) + sy / 4 * second(vy, vxy, sx)
    hyy = second(v.T, vy.T, sy) + sx / 4 * second(vx.T, vxy.T, sy)
    rows, columns = np.diff(v, axis=0) / sy, np.diff(vy, axis=1) / sx
    twist = 1.5 * top(np.diff(rows, axis=1)) / sx + top(np.diff(vx, axis=0)) / sy
    hxy = 1.5 * twist + 1.5 * top(columns) + top(vxy)
    return float(v.min()) - swing, float(v.max()) + swing, max(hxx, hyy) + hxy
