"""Footprint of a lens on the wall: the part in which the lens sees an object point mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SceneError
from ...scene import Camera, Wall

Array = NDArray[np.float64]
LEVELS: Final = 9  # largest number of subdivisions of the cells of a searched rectangle
CORNERS: Final = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Footprint:
    """Rectangle (corners, m) of all mirror reflections of a point into a lens, and such points.

    The ``points`` (n, 3), m, reflect light through the lens or close to its edge.
    """

    low: Array
    high: Array
    points: Array


def lens_footprint(wall: Wall, object_point: Array, camera: Camera) -> Footprint:
    """Find the part of the wall that reflects light from an object point (world, m) into a lens.

    The search starts with a rectangle around the reflection in the plane z = 0, enlarged for the
    wall's slopes, and divides it into cells. A cell counts as lit if the light reflected at its
    corners overlaps the lens, with a margin. Lit cells are subdivided until their light is much
    narrower than the lens. The rectangle is doubled until no cell at its border is lit.
    `SceneError` if the point is behind the wall, or none of its light is reflected into the lens.
    """
    o = np.asarray(object_point, dtype=np.float64)
    if o[2] <= 0:
        raise SceneError(f"object_point has z = {o[2]:g} m, behind the wall; must be above 0 m")
    low, high = _mirror_box(wall, o, camera)
    edge = np.array([np.inf, np.inf] if wall.size is None else wall.size) / 2
    for _ in range(24):
        inner_low, inner_high = np.maximum(low, -edge), np.minimum(high, edge)
        if (inner_low < inner_high).all():
            points = _lit_points(wall, o, camera, inner_low, inner_high)
            if len(points):
                first, last = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
                slack = 1e-9 * (inner_high - inner_low)
                open_low = (first <= inner_low + slack) & (inner_low > -edge)
                open_high = (last >= inner_high - slack) & (inner_high < edge)
                if not (open_low | open_high).any():
                    return Footprint(first, last, points)
            whole = (inner_low == -edge).all() and (inner_high == edge).all()
            if whole or _counts(wall, inner_low, inner_high).prod() > 500_000:
                break
        low, high = low - (high - low) / 2, high + (high - low) / 2
    raise SceneError(
        f"no light from {np.array2string(o, precision=4)} m is reflected by the wall into the "
        "lens; enlarge the wall, move the object or aim at another part"
    )


def _mirror_box(wall: Wall, o: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the corners (2,) of a search rectangle in x and y, m."""
    angle = 2 * np.pi * np.arange(16) / 16
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ camera.frame[:2]
    rim = np.array(camera.position) + camera.stop_diameter / 2 * across
    if rim[:, 2].min() <= 0:
        raise SceneError(
            f"the lens reaches z = {rim[:, 2].min():g} m, behind the wall; use a smaller stop or "
            "move the camera into the room"
        )
    share = o[2] / (o[2] + rim[:, 2:])
    hits = o[:2] + share * (rim[:, :2] - o[:2])
    room = 0.25 * (hits.max(axis=0) - hits.min(axis=0))
    if np.isfinite(wall.finest_period):
        # a slope shifts the reflection point by 2 slope d_eff, more at oblique incidence
        legs = [np.linalg.norm(end - hits.mean(axis=0)) for end in (o[:2], rim[:, :2].mean(axis=0))]
        legs = [np.hypot(leg, z) for leg, z in zip(legs, (o[2], rim[:, 2].mean()), strict=True)]
        slope = wall.max_curvature * wall.finest_period / (2 * np.pi)
        room = room + min(4 * slope * legs[0] * legs[1] / (legs[0] + legs[1]), sum(legs))
    return hits.min(axis=0) - room, hits.max(axis=0) + room


def _lit_points(wall: Wall, o: Array, camera: Camera, low: Array, high: Array) -> Array:
    """Return wall points (n, 3), m, close to those that reflect the object into the lens."""
    radius = camera.stop_diameter / 2
    counts = _counts(wall, low, high)
    _fit(float(counts.prod()))
    side = (high - low) / counts
    index = np.stack(np.meshgrid(*(np.arange(n) for n in counts)), axis=-1).reshape(-1, 2)
    cells, lit_points = low + index * side, []
    for level in range(LEVELS):
        corners = cells[:, None] + side * CORNERS
        points, landed = _landings(wall, o, camera, corners)
        dark = np.isnan(landed)
        least = np.where(dark, np.inf, landed).min(axis=1)
        most = np.where(dark, -np.inf, landed).max(axis=1)
        some = np.asarray(~dark.all(axis=(1, 2)))
        spread = np.where(some[:, None], most - least, 0.0)
        lit = (least - spread / 2 <= radius) & (most + spread / 2 >= -radius)
        lit = lit.all(axis=1) & some
        # at the last level accept wider cells; those still wider, as at the rim of a sphere, send
        # a negligible part of their light into the lens
        limit = 0.125 * radius if level < LEVELS - 1 else radius
        fine: NDArray[np.bool_] = np.logical_and(lit, (spread <= limit).all(axis=1))
        lit_points.append(points[fine[:, None] & ~dark.any(axis=-1)])
        cells = cells[lit & ~fine]
        if not len(cells):
            break
        _fit(4.0 * len(cells))
        side = side / 2
        cells = (cells[:, None] + side * CORNERS).reshape(-1, 2)
    return np.concatenate(lit_points)


def _counts(wall: Wall, low: Array, high: Array) -> Array:
    """Return the number of cells along x and y of a search rectangle, (2,)."""
    return np.asarray(np.maximum(48, np.ceil(8 * (high - low) / wall.finest_period)))


def _fit(n_cells: float) -> None:
    """Raise `MemoryLimitError` if ``n_cells`` search cells would not fit in memory."""
    fits_memory(f"{n_cells:.3g} wall cells", 1000.0 * n_cells, "use a smoother or smaller wall")


def _landings(wall: Wall, o: Array, camera: Camera, places: Array) -> tuple[Array, Array]:
    """Return wall points and the points where their reflected light meets the lens plane."""
    surface = surfaces(wall, places[..., 0], places[..., 1])
    points = np.concatenate([places, surface[..., :1]], axis=-1)
    normals = np.stack([-surface[..., 1], -surface[..., 2], np.ones(places.shape[:-1])], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    incident = points - o
    ends, _ = lens_plane(points, reflected(incident, normals), camera)
    front = np.sum(incident * normals, axis=-1) < 0
    landed = (ends - np.array(camera.position)) @ camera.frame[:2].T
    return points, np.where(front[..., None], landed, np.nan)


def surfaces(wall: Wall, x: Array, y: Array) -> Array:
    """Return the height and its derivatives, (..., 6), with NaN where the wall has no height."""
    if not wall.is_compiled:
        return wall.derivatives(x, y)
    return wall.surface_values(np.ravel(x), np.ravel(y)).reshape(*x.shape, 6)


def reflected(directions: Array, normals: Array) -> Array:
    """Return unit directions after specular reflection at surfaces with unit normals, (..., 3)."""
    d = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(d - 2 * np.sum(d * normals, axis=-1, keepdims=True) * normals)


def lens_plane(points: Array, directions: Array, camera: Camera) -> tuple[Array, Array]:
    """Return where rays meet the plane of the lens, (..., 3), m, and their lengths (...), m.

    Both are NaN for rays that do not approach the plane from the front.
    """
    axis = camera.axis
    toward = directions @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        length = ((np.array(camera.position) - points) @ axis) / toward
    length = np.where((toward < 0) & (length > 0), length, np.nan)
    return points + length[..., None] * directions, length
