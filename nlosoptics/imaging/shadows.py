"""What occluders hide: shares of each pixel's light that reach it past black bodies.

A path to a pixel's image runs from the laser's spot to the object, to the wall and through the
lens; the diffuse background takes the same legs by any point of the object. Each leg is one line
of sight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import fits_memory
from .._nouns import Noun
from ..errors import SceneError
from ..raytrace import intersect_mesh, occluded
from ..scene import PlanarObject, Scene
from .geometry import (
    ChiefRays,
    chief_rays,
    picture_coordinates,
    picture_points,
    pixel_centres,
    wall_visibility,
)
from .objects import object_samples
from .radiometry import LaserSpot, Nodes, arrivals, laser_spot

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIDE = 4  # sample paths along each side of a pixel, each to a point of the lens of its own
SAMPLES = 1024  # points of the object that light the wall
NODES = 65  # pixels along each side of the detector at which the wall's light is summed
TURN = math.pi * (3.0 - math.sqrt(5.0))  # golden angle: even points on a disc
RIM = 16  # rays around the laser beam
SHADOW_BYTES = 450  # of memory per pixel, measured


@dataclass(frozen=True, eq=False, kw_only=True)
class Shadows(Noun):
    """What occluders leave of the light; arrays (ny, nx), read-only, 1 where they hide nothing.

    Parameters
    ----------
    image : ndarray
        Share of each pixel's paths spot - object - wall - lens that are free, over its area and
        the lens.
    view : ndarray
        Share of each pixel's paths wall - lens that are free.
    veil : ndarray
        Share of the object's diffuse light that reaches the wall where each pixel looks.
    spot : float
        Share of the lens that the laser's spot lights straight.
    """

    image: Array
    view: Array
    veil: Array
    spot: float

    def __post_init__(self) -> None:
        for array in (self.image, self.view, self.veil):
            array.flags.writeable = False


def cast_shadows(scene: Scene) -> Shadows:
    """Test every leg of the light of an image against the scene's occluders.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Shadows

    Raises
    ------
    SceneError
        If the laser's beam misses the wall, or an occluder cuts it before that.
    MemoryLimitError
        If the paths of all pixels would not fit in memory.

    Notes
    -----
    ``image`` and ``view`` are shares of 16 paths, each with its own place in the pixel and on the
    lens, so pixels in a shadow's edge err by some hundredths. Paths through a lens point cross the
    wall's tangent plane on the way to the point in focus, and meet the object where the chief ray
    does. ``veil`` sums over 1024 points of the object at 65 by 65 pixels and is bilinear in
    between: good to some thousandths, and to some hundredths at the edge of a shadow that an
    occluder close to the wall casts on it. The spot counts as a point, and its image is evenly
    dimmed.
    """
    ny, nx = scene.camera.shape
    fits_memory(
        f"the shadows of {nx} x {ny} pixels (camera.pixels, camera.binning)",
        SHADOW_BYTES * nx * ny,
        "read fewer pixels or bin more",
    )
    spot = laser_spot(scene)
    mesh = scene.occluding_mesh
    if mesh is None:
        return Shadows(
            image=np.ones((ny, nx)), view=np.ones((ny, nx)), veil=np.ones((ny, nx)), spot=1.0
        )
    check_beam(scene, mesh, spot)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    seen = wall_visibility(scene, rays) > 0
    image, view = _path_shares(scene, mesh, spot, seen)
    lens = np.array(scene.camera.position) + _lens_points(scene)
    return Shadows(
        image=image,
        view=view,
        veil=_veil_share(scene, mesh, spot, rays, seen),
        spot=1.0 - float(occluded(mesh, spot.point, lens).mean()),
    )


def check_beam(scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot) -> None:
    """Refuse an occluder in the laser's beam, on its axis or at its rim."""
    laser = np.array(scene.laser.position)
    across = np.linalg.svd(spot.incident[None])[2][1:]
    angles = 2 * math.pi * np.arange(RIM) / RIM
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ across
    offsets = np.concatenate([np.zeros((1, 3)), scene.laser.beam_diameter / 2 * rim])
    # where each ray meets the tangent plane of the spot
    cosine = float((spot.incident * spot.normal).sum())
    ends = spot.point + offsets - np.outer(offsets @ spot.normal / cosine, spot.incident)
    cut = occluded(mesh, laser + offsets, ends)
    if cut.any():
        raise SceneError(
            f"scene.occluders cut the laser's beam from {scene.laser.position} m to the wall at "
            f"{tuple(round(float(c), 6) for c in spot.point)} m; move the occluder or the laser"
        )


def _lens_points(scene: Scene) -> Array:
    """Even points on the lens about its centre, world axes, m, (SIDE^2, 3)."""
    k = np.arange(SIDE**2)
    radius = scene.camera.stop_diameter / 2 * np.sqrt((k + 0.5) / SIDE**2)
    disc = np.stack([radius * np.cos(TURN * k), radius * np.sin(TURN * k)], axis=1)
    return np.asarray(disc @ scene.camera.frame[:2])


def _path_shares(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot, seen: Mask
) -> tuple[Array, Array]:
    """Free shares of paths spot - object - wall - lens and of paths wall - lens."""
    met, free, viewed = (np.zeros(seen.shape) for _ in range(3))
    for rays, lens in _sample_rays(scene):
        use = seen & np.isfinite(rays.distance)
        on_wall = _on_wall(scene, rays, use, lens)
        open_view = ~occluded(mesh, lens, on_wall)
        viewed[use] += open_view
        points, hit = _object_points(scene, rays, use)
        lit = np.zeros(hit.shape, dtype=bool)
        lit[hit] = ~occluded(mesh, on_wall[hit], points) & ~occluded(mesh, points, spot.point)
        met[use] += hit
        free[use] += lit & open_view
    image = np.ones(seen.shape)
    np.divide(free, met, out=image, where=met > 0)
    return image, np.where(seen, viewed / SIDE**2, 1.0)


def _sample_rays(scene: Scene) -> Iterator[tuple[ChiefRays, Array]]:
    """Chief rays of points spread over each pixel, each set with a point of the lens."""
    x, y = pixel_centres(scene.camera)
    lens = np.array(scene.camera.position) + _lens_points(scene)
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * scene.camera.image_pitch
    for k in range(SIDE**2):
        # seven steps on at a time: neighbours in the pixel are none on the lens
        row, column = divmod(7 * k % SIDE**2, SIDE)
        yield chief_rays(scene, x + steps[column], y + steps[row]), lens[k]


def _on_wall(scene: Scene, rays: ChiefRays, use: Mask, lens: Array) -> Array:
    """Where the lines from a lens point to the points in focus cross the wall's tangent planes."""
    ahead = scene.focus_distance / rays.cos_axis[use]
    line = np.array(scene.camera.position) + ahead[:, None] * rays.directions[use] - lens
    normals = rays.normals[use]
    height = ((rays.points[use] - lens) * normals).sum(axis=-1)
    return np.asarray(lens + (height / (line * normals).sum(axis=-1))[:, None] * line)


def _object_points(scene: Scene, rays: ChiefRays, use: Mask) -> tuple[Array, Mask]:
    """Object points (m, 3) that the rays in use meet, and which rays those are."""
    hidden = scene.hidden
    if not isinstance(hidden, PlanarObject):
        hits = intersect_mesh(hidden.surface, rays.points[use], rays.reflected[use])
        return hits.points[hits.hit], hits.hit
    column, row = (c[use] for c in picture_coordinates(hidden, rays))
    rows, columns = hidden.reflectance.shape
    # NaN compares false
    hit = (column >= 0) & (column <= columns) & (row >= 0) & (row <= rows)
    return picture_points(hidden, column[hit], row[hit]), hit


def _veil_share(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot, rays: ChiefRays, seen: Mask
) -> Array:
    """Share of the object's light that reaches the wall points of the pixels."""
    diffuse, patches = scene.wall_material.diffuse, object_samples(scene.hidden, SAMPLES)
    if diffuse is None or not seen.any() or not len(patches.areas):
        return np.ones(seen.shape)
    lit = ~occluded(mesh, patches.points, spot.point)
    rows, columns = (_nodes(count) for count in seen.shape)
    at = np.ix_(rows, columns)
    x, y = pixel_centres(scene.camera)
    x, y = np.broadcast_arrays(x[columns], y[rows, None])
    on, height, normals = seen[at], rays.points[at][..., 2], rays.normals[at]
    # rays beyond the wall's edge go on to its mean height
    height = np.where(on, height, rays.points[seen][:, 2].mean())
    normals = np.where(on[..., None], normals, (0.0, 0.0, 1.0)).reshape(-1, 3)
    nodes = Nodes(scene, x.ravel(), y.ravel(), height.ravel())
    share = np.ones(nodes.count)
    for block, toward, light in arrivals(scene, spot, patches, nodes):
        used = nodes.used[block]
        facing, view = normals[used][:, None], -nodes.directions[block][:, None]
        light *= np.maximum((toward * facing).sum(axis=-1), 0.0)
        light *= diffuse.evaluate(toward, view, facing)
        free = light * lit
        node, patch = np.nonzero(free)
        hidden = occluded(mesh, nodes.points[block][node], patches.points[patch])
        free[node[hidden], patch[hidden]] = 0.0
        total = light.sum(axis=-1)
        part = np.ones(total.shape)
        np.divide(free.sum(axis=-1), total, out=part, where=total > 0)
        share[used] = part
    return _bilinear(share.reshape(len(rows), len(columns)), rows, columns, seen.shape)


def _nodes(count: int) -> NDArray[np.intp]:
    """Pixels at which shares are summed, the first and the last among them."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(NODES, count))).astype(np.intp))


def _bilinear(
    values: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, ...]
) -> Array:
    """Values at pixels ``rows`` and ``columns``, bilinear over all pixels."""
    for axis, nodes in enumerate((rows, columns)):
        at = np.arange(shape[axis])
        low = np.minimum(np.searchsorted(nodes, at, side="right") - 1, max(len(nodes) - 2, 0))
        high = np.minimum(low + 1, len(nodes) - 1)
        part = (at - nodes[low]) / np.maximum(nodes[high] - nodes[low], 1)
        below, above = values.take(low, axis), values.take(high, axis)
        values = below + (part[:, None] if axis == 0 else part) * (above - below)
    return values
