"""The part of the relay wall that a lens sees an object point by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene import Camera, Wall

Array = NDArray[np.float64]
SAMPLES: Final = 97  # per side of the patch that is searched
GROWTHS: Final = 24  # doublings and tightenings, after which nothing is found


@dataclass(frozen=True, eq=False)
class Footprint:
    """A rectangle of wall that holds every mirror reflection of a point in a lens.

    Parameters
    ----------
    low, high : ndarray, (2,)
        Its corners, x and y, m.
    points : ndarray, (n, 3)
        Points of the wall in it, world, m, whose light passes the lens or next to it.
    """

    low: Array
    high: Array
    points: Array


def lens_footprint(wall: Wall, object_point: Array, camera: Camera) -> Footprint:
    """Search the wall for the points that reflect an object point into a lens.

    Parameters
    ----------
    wall : Wall
    object_point : ndarray, (3,)
        World, m, in front of the wall.
    camera : Camera

    Returns
    -------
    Footprint
        About a sample too wide on every side.

    Raises
    ------
    SceneError
        If the point is behind the wall or nothing of it is reflected into the lens.

    Notes
    -----
    A rectangle about the reflection in the plane z = 0 is sampled, grown until no lit sample lies
    on its edge, and tightened about the lit ones. A sample is lit when its light passes the lens
    plane within the lens, or nearer to it than to the light of a neighbouring sample.
    """
    o = np.asarray(object_point, dtype=np.float64)
    if o[2] <= 0:
        raise SceneError(f"object_point has z = {o[2]:g} m, behind the wall; must be above 0")
    low, high = _mirror_box(o, camera)
    edge = np.array([np.inf, np.inf] if wall.size is None else wall.size) / 2
    for _ in range(GROWTHS):
        inner_low, inner_high = np.maximum(low, -edge), np.minimum(high, edge)
        size = high - low
        if (inner_low < inner_high).all():
            low, high = inner_low, inner_high
            axes = [np.linspace(a, b, SAMPLES) for a, b in zip(low, high, strict=True)]
            points, lit = _lit(wall, o, camera, *axes)
            columns, rows = (np.flatnonzero(lit.any(axis=k)) for k in (0, 1))
            if len(rows):
                first, last = (np.array([columns[k], rows[k]]) for k in (0, -1))
                open_low = (first == 0) & (low > -edge)
                open_high = (last == SAMPLES - 1) & (high < edge)
                if not (open_low | open_high).any():
                    step = (high - low) / (SAMPLES - 1)
                    within = Footprint(
                        np.maximum(low + (first - 1) * step, -edge),
                        np.minimum(low + (last + 1) * step, edge),
                        points[lit],
                    )
                    if ((last - first) * 3 >= SAMPLES).all():
                        return within
                    low, high = within.low, within.high
                    continue
        low, high = low - size / 2, high + size / 2
    raise SceneError(
        f"no light from {np.array2string(o, precision=4)} m is reflected by the wall into the "
        "lens; enlarge the wall, move the object or aim at another part"
    )


def _mirror_box(o: Array, camera: Camera) -> tuple[Array, Array]:
    """Where a plane mirror z = 0 shows the point to the lens, with room around, (2,) each."""
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
    return hits.min(axis=0) - room, hits.max(axis=0) + room


def _lit(
    wall: Wall, o: Array, camera: Camera, x: Array, y: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Points (ny, nx, 3) of the wall and whether their light passes the lens or next to it."""
    gx, gy = np.meshgrid(x, y)
    surface = surfaces(wall, gx, gy)
    points = np.stack([gx, gy, surface[..., 0]], axis=-1)
    normals = np.stack([-surface[..., 1], -surface[..., 2], np.ones_like(gx)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    incident = points - o
    ends, _ = lens_plane(points, reflected(incident, normals), camera)
    u, v = ((ends - np.array(camera.position)) @ axis for axis in camera.frame[:2])
    spread = np.zeros_like(u)
    for axis in (0, 1):
        step = np.hypot(np.diff(u, axis=axis), np.diff(v, axis=axis))
        step = np.where(np.isfinite(step), step, 0.0)
        for part in (np.s_[1:], np.s_[:-1]):
            view = spread[part] if axis == 0 else spread[:, part]
            np.maximum(view, step, out=view)
    front = np.sum(incident * normals, axis=-1) < 0
    # NaN, where the wall has no height or sends light elsewhere, compares false
    return points, front & (np.hypot(u, v) <= camera.stop_diameter / 2 + spread)


def surfaces(wall: Wall, x: Array, y: Array) -> Array:
    """Height and derivatives of the wall, (..., 6), NaN where it has no height."""
    if not wall._compiled:
        return wall.derivatives(x, y)
    from ..scene import _kernels

    out = np.empty((x.size, 6))
    _kernels.surfaces(*wall._terms(), np.ravel(x), np.ravel(y), out)
    return out.reshape(*x.shape, 6)


def reflected(directions: Array, normals: Array) -> Array:
    """Unit directions of light reflected by mirrors, (..., 3)."""
    d = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(d - 2 * np.sum(d * normals, axis=-1, keepdims=True) * normals)


def lens_plane(points: Array, directions: Array, camera: Camera) -> tuple[Array, Array]:
    """Where rays (..., 3) pass the plane of the lens, world, m, and how far they go, m.

    NaN for those that do not go toward it.
    """
    axis = camera.axis
    toward = directions @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        length = ((np.array(camera.position) - points) @ axis) / toward
    length = np.where((toward < 0) & (length > 0), length, np.nan)
    return points + length[..., None] * directions, length
