"""Intersections of rays with the relay wall: the first hit of every ray."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import expect, numbers
from ..._nouns import Noun
from ..._vectors import dot
from ...errors import SceneError
from ...kernels.codes import BUMPS, CYLINDER, FACETS, GRID, SPHERE, WAVE
from ...scene.walls.analytic import Wall
from ...scene.walls.height_maps import CallableWall, grid_limits
from ...scene.walls.relief import relief_limits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hits(Noun):
    """First intersections of rays with a relay wall, as `intersect` returns them.

    The arrays are read-only. Their shapes begin with that of the array of rays, written (...).

    Parameters
    ----------
    distance : ndarray, shape (...)
        Distance from the origin of each ray to its hit, m; NaN without a hit.
    points : ndarray, shape (..., 3)
        Hit points, world frame (origin at the centre of the relay wall, z toward the room, y up),
        m; NaN without a hit.
    normals : ndarray, shape (..., 3)
        Unit normals of the wall at the hits, toward the room, world frame; NaN without a hit.
    status : ndarray of int8, shape (...)
        Outcome for each ray. 0 (``Hits.HIT``): hit. 1 (``Hits.MISS``): no hit, and the ray does not
        travel toward the wall's mean plane z = 0. 2 (``Hits.OUTSIDE``): no hit, because the ray
        meets that plane outside the wall's edges. 3 (``Hits.UNRESOLVED``): the ray touches or
        grazes the wall, so that float64 cannot resolve the hit. 4 (``Hits.BEHIND``): the ray starts
        behind the wall or arrives from behind.

    See Also
    --------
    intersect : Hits of rays on a relay wall.
    """

    HIT: ClassVar = 0
    MISS: ClassVar = 1
    OUTSIDE: ClassVar = 2
    UNRESOLVED: ClassVar = 3
    BEHIND: ClassVar = 4

    distance: Array
    points: Array
    normals: Array
    status: NDArray[np.int8]

    def __post_init__(self) -> None:
        for array in (self.distance, self.points, self.normals, self.status):
            array.flags.writeable = False

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Whether each ray hits the surface, (...) bool."""
        return np.asarray(self.status == Hits.HIT)


def intersect(wall: Wall, origins: ArrayLike, directions: ArrayLike) -> Hits:
    """Find the first point at which every ray hits the relay wall, from the room side.

    Parameters
    ----------
    wall : Wall
        Relay wall, such as ``scene.wall``.
    origins : array_like, (..., 3)
        Starting points of the rays, world frame (origin at the centre of the relay wall, z toward
        the room, y up), m.
    directions : array_like, (..., 3)
        Direction vectors in the world frame, of any length but zero. The shapes of ``origins``
        and ``directions`` broadcast.

    Returns
    -------
    Hits
        Distance, point, normal and status of each ray. The relative error of the distance is below
        1e-12, except for grazing rays.

    Raises
    ------
    SceneError
        If a ray holds NaN or infinity, a direction is zero, or the shapes do not broadcast.

    See Also
    --------
    intersect_mesh : First hits of rays on a mesh.
    nlosoptics.scene.Wall : Base class of all walls.

    Notes
    -----
    Planes, spheres and cylinders are intersected in closed form. For other walls, let f be the
    height of the ray above the wall, f' its derivative along the ray, and M a bound on its second
    derivative. The search begins where the ray enters the box given by the wall's edges, lowest
    and highest point. A root found by Newton's method is certainly the first one if its distance
    from there is below ``2 |f'| / M``, with f' at the root.

    For all other rays, points are tried in steps along the ray. Each step is the positive root s of
    ``f + f' s - M s^2/2 = 0``. Such a step never passes a crossing, and near a crossing it
    converges like Newton's method. On a wall of facets each step ends within its facet.

    The slope of a sphere or cylinder is infinite at its rim. If a `nlosoptics.scene.SumWall` has
    such a part, hits are searched only up to 0.999 times the radius from its axis; the axis of a
    sphere is the line through its centre along z.

    Examples
    --------
    >>> from nlosoptics import raytrace
    >>> from nlosoptics.scene import ConcaveWall
    >>> wall = ConcaveWall(5.0, size=1.0)
    >>> hits = raytrace.intersect(wall, (0.1, 0.0, 1.0), [(0, 0, -1), (1, 0, 0)])
    >>> hits.status.tolist(), round(float(hits.distance[0]), 6)
    ([0, 1], 0.999)
    """
    expect("wall", wall, "Wall")
    if wall.is_flat:
        return _plane(wall, *_rays(origins, directions))
    if isinstance(wall, CallableWall):
        return _callable(wall, *_rays(origins, directions))
    from . import _wall_kernels

    o, d, shape = flat_rays(origins, directions)
    count = math.prod(shape)
    distance, status = np.empty(count), np.empty(count, dtype=np.int8)
    points, normals = np.empty((count, 3)), np.empty((count, 3))
    compiled = compiled_wall(wall, 8.0 * count)  # a march takes some 8 heights
    bad = _wall_kernels.intersect(*compiled, o, d, distance, points, normals, status)
    if bad:
        _rays(origins, directions)  # raises an error that names the first bad ray
    return Hits(
        distance.reshape(shape),
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        status.reshape(shape),
    )


def flat_rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """Return origins and directions as (n, 3) arrays, values unchecked, and the rays' shape."""
    o, d = numbers("origins", origins), numbers("directions", directions)
    if min(o.ndim, d.ndim) == 0 or (o.shape[-1], d.shape[-1]) != (3, 3) or o.shape != d.shape:
        o, d = _rays(o, d)
    shape = o.shape[:-1]
    # other layouts would make numba compile the kernels again
    o, d = (np.require(v.reshape(-1, 3), requirements=("C", "W")) for v in (o, d))
    return o, d, shape


def _rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
    """Return checked origins and unit directions of equal shape (..., 3)."""
    o, d = numbers("origins", origins), numbers("directions", directions)
    for name, v in (("origins", o), ("directions", d)):
        if v.ndim == 0 or v.shape[-1] != 3:
            raise SceneError(f"{name} has shape {v.shape}; give (..., 3), with x, y and z in m")
        if not np.isfinite(v).all():
            place = np.argwhere(~np.isfinite(v))[0][:-1].tolist()
            raise SceneError(f"{name}{place} holds NaN or infinity; give finite components")
    # numpy's own maximum and sum over an axis of length 3 take many times as long
    largest = np.maximum(np.maximum(abs(d[..., 0]), abs(d[..., 1])), abs(d[..., 2]))
    if (largest == 0.0).any():
        place = np.argwhere(largest == 0.0)[0].tolist()
        raise SceneError(f"directions{place} is zero; give a direction of any other length")
    d = d / largest[..., None]  # scaled first, so that the squares neither overflow nor underflow
    d /= np.sqrt(dot(d, d))[..., None]
    try:
        o, d = np.broadcast_arrays(o, d)
    except ValueError:
        raise SceneError(
            f"origins {o.shape} and directions {d.shape} do not broadcast; give equal shapes"
        ) from None
    # copies, since a broadcast array shares its memory between rays
    return np.array(o, order="C"), np.array(d, order="C")


def _plane(wall: Wall, o: Array, d: Array) -> Hits:
    """Return the hits on the plane z = 0, without compiled code."""
    status = np.where(
        o[..., 2] < 0, Hits.BEHIND, np.where(d[..., 2] < 0, Hits.HIT, Hits.MISS)
    ).astype(np.int8)
    down = status == Hits.HIT
    distance = np.full(status.shape, np.nan)
    np.divide(o[..., 2], -d[..., 2], out=distance, where=down)
    points = o + distance[..., None] * d
    points[..., 2] = np.where(down, 0.0, np.nan)
    status[down & ~wall.contains(points[..., 0], points[..., 1])] = Hits.OUTSIDE
    missed = status != Hits.HIT
    distance[missed] = np.nan
    points[missed] = np.nan
    normals = np.zeros_like(points)
    normals[..., 2] = 1.0
    normals[missed] = np.nan
    return Hits(distance, points, normals, status)


def _callable(wall: CallableWall, origins: Array, directions: Array) -> Hits:
    """Return the hits on a wall of Python functions, by the march of `marched_hit` in numpy."""
    shape = origins.shape[:-1]
    o, d = origins.reshape(-1, 3), directions.reshape(-1, 3)
    half = (math.inf, math.inf) if wall.size is None else (wall.size[0] / 2, wall.size[1] / 2)
    top = wall.max_height + 1e-9  # m, so that rounding does not cut off a crest
    low, high = np.zeros(len(o)), np.full(len(o), math.inf)
    for axis, reach in enumerate((*half, top)):
        if reach == math.inf:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.array([[-reach], [reach]]) - o[:, axis]) / d[:, axis]
        level, inside = d[:, axis] == 0, np.abs(o[:, axis]) <= reach
        low = np.where(level, np.where(inside, low, math.inf), np.maximum(low, ends.min(axis=0)))
        high = np.where(level, high, np.minimum(high, ends.max(axis=0)))
    over = (np.abs(o[:, :2]) <= half).all(axis=1)
    missed = np.where(d[:, 2] < 0, Hits.OUTSIDE, Hits.MISS)
    status = np.where(over & (o[:, 2] < -top), Hits.BEHIND, missed)
    scale = 1e-13 * np.maximum(np.sqrt((o * o).sum(axis=1)), 1e-3)
    bound = wall.max_curvature * (d[:, 0] ** 2 + d[:, 1] ** 2)
    t, distance = low.copy(), np.full(len(o), np.nan)
    active = np.flatnonzero((low <= high) & (low < math.inf))  # not level beside an endless wall
    status[active] = Hits.UNRESOLVED
    for step in range(500):
        if not len(active):
            break
        x, y, z = (o[active] + t[active, None] * d[active]).T
        surface = wall.derivatives(x, y)
        f = z - surface[:, 0]
        slope = d[active, 2] - (surface[:, 1:3] * d[active, :2]).sum(axis=1)
        touching = f <= scale[active]
        going = np.ones(len(active), dtype=bool)
        if step == 0:
            under = f < -scale[active]
            back = under & ((low[active] == 0) | (o[active, 2] < -top))
            status[active[under]] = np.where(back, Hits.BEHIND, missed[active])[under]
            going &= ~under
        landed = going & touching & (slope < 0)
        rows = active[landed]
        distance[rows] = np.maximum(t[rows] - f[landed] / slope[landed], 0.0)
        status[rows] = Hits.HIT
        going &= ~landed & ~(touching & (t[active] > 0))  # a ray that only touches stays unresolved
        f = np.where(touching, 0.0, f)
        gone = going & (t[active] >= high[active])
        m = bound[active]
        root = np.sqrt(slope * slope + 2.0 * m * f)
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(slope < 0, 2.0 * f / (root - slope), (slope + root) / m)
        gone |= going & (slope >= 0) & (m == 0)
        status[active[gone]] = missed[active[gone]]
        nearer = np.minimum(t[active] + ahead, high[active])
        going &= ~gone & (nearer > t[active])
        active, nearer = active[going], nearer[going]
        t[active] = nearer
    points = o + distance[:, None] * d
    normals = np.full_like(points, np.nan)
    hit = status == Hits.HIT
    normals[hit] = wall.normal(points[hit, 0], points[hit, 1])
    return Hits(
        distance.reshape(shape),
        points.reshape(*shape, 3),
        normals.reshape(*shape, 3),
        status.astype(np.int8).reshape(shape),
    )


def compiled_wall(wall: Wall, uses: float) -> tuple[Any, ...]:
    """Return a wall as its kernels take it: terms, tables and the limits of `search_bounds`.

    ``uses`` is the expected number of evaluations. What the wall does not need is None, for which
    numba compiles a shorter function.
    """
    if wall.is_flat:
        return None, None, None, *search_bounds(wall, np.zeros((0, 8)), np.zeros(0))[1:]
    from ...kernels.heights import tables_for
    from ...kernels.relief import with_draws

    terms, tables = wall.compiled()
    curvature, box, slab, rim = search_bounds(wall, terms, tables)
    terms, tables = with_draws(terms, tables, box, uses)
    conic = len(terms) == 1 and terms[0, 0] in (SPHERE, CYLINDER)
    return terms, tables_for(terms, tables), None if conic else curvature, box, slab, rim


def search_bounds(wall: Wall, terms: Array, tables: Array) -> tuple[Array, Array, Array, float]:
    """Return the limits within which a wall is searched for hits.

    These are upper bounds on the curvature of each gridded or random term (n,), 1/m, half sizes in
    x and y (2,), lowest and highest height (2,), and the largest distance from the z axis, m.
    """
    margin = 0.999  # relative to the radius, since the slope is infinite at the rim itself
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
            low, high, curvature[i] = grid_limits(row, tables)
            slab += (low, high)
        elif row[0] in (FACETS, BUMPS):
            height, curvature[i] = relief_limits(row)
            slab += (-height, height)
    pad = 1e-9 + 1e-12 * np.abs(slab).max()  # m, so that rounding does not cut off a crest
    slab[0] -= pad
    slab[1] += pad
    return curvature, box, slab, rim
