"""Shadows of black occluders: fractions of each pixel's light that is not blocked.

Light of the image travels from the laser spot to the object, to the wall and through the lens. The
diffuse background follows the same three legs via all points of the object. Each leg is tested as
a line of sight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import expect, fits_memory
from .._nouns import Noun
from .._vectors import dot
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

SIDE = 4  # sample paths along each side of a pixel, each through its own point of the lens
SAMPLES = 1024  # points that represent the object as a source
NODES = 65  # pixels along each side of the detector at which the wall's light is summed
SHADOW_BYTES = 450  # measured memory per pixel


@dataclass(frozen=True, eq=False, kw_only=True)
class Shadows(Noun):
    """Fractions of the light that pass the black occluders of a scene; 1 without any shadow.

    `cast_shadows` computes them for each image pixel. The arrays are read-only. Light that the wall
    scatters diffusely covers the image like a veil; its intensity in a pixel is multiplied by both
    ``view`` and ``veil``.

    Parameters
    ----------
    image : ndarray, (ny, nx)
        For the object's image, the whole way from the laser spot via object and wall to the lens:
        fraction of the paths that are not blocked, averaged over the area of the pixel and over the
        lens.
    view : ndarray, (ny, nx)
        For diffuse light, the way from the wall to the lens: fraction of the paths that are not
        blocked, averaged over the area of the pixel and over the lens.
    veil : ndarray, (ny, nx)
        For diffuse light, the way from the laser spot via the object to the wall point that the
        pixel sees: fraction of this light that is not blocked.
    spot : float
        Fraction of the lens that receives direct light from the laser spot.

    See Also
    --------
    cast_shadows : Fractions of light that occluders let through.
    """

    image: Array
    view: Array
    veil: Array
    spot: float

    def __post_init__(self) -> None:
        for array in (self.image, self.view, self.veil):
            array.flags.writeable = False


def cast_shadows(scene: Scene) -> Shadows:
    """Compute which fractions of the light the occluders of a scene let through.

    Parameters
    ----------
    scene : Scene
        Scene with occluders; without any, all fractions are 1.

    Returns
    -------
    Shadows
        In each image pixel, the fractions ``image`` for the object's image, and ``view`` and
        ``veil`` for diffuse light; and the fraction ``spot`` for direct light of the laser spot.

    Raises
    ------
    SceneError
        If the laser beam misses the wall or is cut by an occluder.
    MemoryLimitError
        If the paths of all pixels would not fit in memory.

    See Also
    --------
    form_image : Image in electrons, with noise.
    nlosoptics.scene.Occluder : Surface that blocks light, black or of any material.
    nlosoptics.raytrace.occluded : Whether a mesh blocks lines of sight.

    Notes
    -----
    ``Shadows.image`` concerns paths from the laser spot via object and wall to the lens, and
    ``Shadows.view`` their last part, from wall to lens. Both are fractions of 16 paths per pixel,
    each with its own point of the pixel and its own point of the lens. Their error at the edge of a
    shadow is a few hundredths.

    The paths are found from the chief ray of each point of the pixel, which passes through the
    centre of the lens and is traced exactly. The path through another point of the lens is
    approximated. It starts at the object point of the chief ray, and is reflected by the plane that
    touches the wall at the wall point of the chief ray.

    ``Shadows.veil`` concerns diffuse light on its way from the laser spot via the object to the
    wall. It is computed at 65 x 65 pixels as a sum over 1024 points of the object, and interpolated
    bilinearly between these pixels. Its error is a few thousandths, or a few hundredths at the edge
    of a shadow that an occluder close to the wall casts on it.

    The laser spot is treated as a point, and its image is dimmed uniformly.
    """
    expect("scene", scene, "Scene")
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


def repainted(shadows: Shadows, scene: Scene) -> Shadows:
    """Return the shadows of a scene, given those of the same scene with another picture.

    Only the veil depends on the picture.
    """
    mesh = scene.occluding_mesh
    if mesh is None:
        return shadows
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    seen = wall_visibility(scene, rays) > 0
    return replace(shadows, veil=_veil_share(scene, mesh, laser_spot(scene), rays, seen))


def check_beam(scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot) -> None:
    """Raise if an occluder cuts the laser beam, on its axis or at its edge."""
    laser = np.array(scene.laser.position)
    across = np.linalg.svd(spot.incident[None])[2][1:]
    angles = 2 * math.pi * np.arange(16) / 16
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ across
    offsets = np.concatenate([np.zeros((1, 3)), scene.laser.beam_diameter / 2 * rim])
    # intersection of each ray with the tangent plane at the spot
    cosine = float((spot.incident * spot.normal).sum())
    ends = spot.point + offsets - np.outer(offsets @ spot.normal / cosine, spot.incident)
    cut = occluded(mesh, laser + offsets, ends)
    if cut.any():
        raise SceneError(
            f"scene.occluders cut the laser's beam from {scene.laser.position} m to the wall at "
            f"{tuple(round(float(c), 6) for c in spot.point)} m; move the occluder or the laser"
        )


def _lens_points(scene: Scene) -> Array:
    """Return SIDE^2 evenly spread points on the lens relative to its centre, world axes, m."""
    k = np.arange(SIDE**2)
    radius = scene.camera.stop_diameter / 2 * np.sqrt((k + 0.5) / SIDE**2)
    turn = k * math.pi * (3.0 - math.sqrt(5.0))  # golden angle
    disc = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return np.asarray(disc @ scene.camera.frame[:2])


def _path_shares(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot, seen: Mask
) -> tuple[Array, Array]:
    """Return unblocked fractions (ny, nx) of the image's paths and of the view of the wall.

    The image's paths go from spot to object, wall and lens; the view from the wall to the lens.
    ``seen`` marks pixels that look at the wall.
    """
    met, free, viewed = (np.zeros(seen.shape) for _ in range(3))
    centres, pitch = pixel_centres(scene.camera), scene.camera.image_pitch
    for rays, lens in _sample_rays(scene, centres, pitch):
        use = seen & np.isfinite(rays.distance)
        met_wall = on_wall(scene, rays, use, lens)
        open_view = ~occluded(mesh, lens, met_wall)
        viewed[use] += open_view
        points, hit = _object_points(scene, rays, use)
        lit = np.zeros(hit.shape, dtype=bool)
        lit[hit] = ~occluded(mesh, met_wall[hit], points) & ~occluded(mesh, points, spot.point)
        met[use] += hit
        free[use] += lit & open_view
    image = np.ones(seen.shape)
    np.divide(free, met, out=image, where=met > 0)
    return image, np.where(seen, viewed / SIDE**2, 1.0)


def _sample_rays(
    scene: Scene, centres: tuple[Array, Array], pitch: float
) -> Iterator[tuple[ChiefRays, Array]]:
    """Yield chief rays of points spread over square areas of side ``pitch`` about ``centres``, m.

    Each set of rays has its own lens point.
    """
    x, y = centres
    lens = np.array(scene.camera.position) + _lens_points(scene)
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * pitch
    for k in range(SIDE**2):
        # stride 7: neighbouring points of the pixel get distant points of the lens
        row, column = divmod(7 * k % SIDE**2, SIDE)
        yield chief_rays(scene, x + steps[column], y + steps[row]), lens[k]


def on_wall(scene: Scene, rays: ChiefRays, use: Mask, lens: Array) -> Array:
    """Return the wall points (m, 3), m, of rays through a point of the lens.

    Each ray goes to the point in focus on its chief ray. The wall is replaced by its tangent plane
    at the chief ray's wall point. ``use`` selects the rays and ``lens`` (3,) is the point, m.
    """
    ahead = scene.focus_distance / rays.cos_axis[use]
    line = np.array(scene.camera.position) + ahead[:, None] * rays.directions[use] - lens
    normals = rays.normals[use]
    height = dot(rays.points[use] - lens, normals)
    return np.asarray(lens + (height / dot(line, normals))[:, None] * line)


def _object_points(scene: Scene, rays: ChiefRays, use: Mask) -> tuple[Array, Mask]:
    """Object points (m, 3) that the rays in use meet, and the mask of those rays."""
    hidden = scene.hidden
    if not isinstance(hidden, PlanarObject):
        hits = intersect_mesh(hidden.surface, rays.points[use], rays.reflected[use])
        return hits.points[hits.hit], hits.hit
    column, row = (c[use] for c in picture_coordinates(hidden, rays))
    rows, columns = hidden.reflectance.shape
    # comparisons with NaN are false
    hit = (column >= 0) & (column <= columns) & (row >= 0) & (row <= rows)
    return picture_points(hidden, column[hit], row[hit]), hit


def _veil_share(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot, rays: ChiefRays, seen: Mask
) -> Array:
    """Return the unblocked fraction (ny, nx) of diffuse light from the object to the wall.

    Each pixel stands for the wall point that it sees. ``seen`` marks pixels that look at the wall.
    """
    diffuse, patches = scene.wall_material.diffuse, object_samples(scene.hidden, SAMPLES)
    if diffuse is None or not seen.any() or not len(patches.areas):
        return np.ones(seen.shape)
    lit = ~occluded(mesh, patches.points, spot.point)
    rows, columns = (_nodes(count) for count in seen.shape)
    at = np.ix_(rows, columns)
    x, y = pixel_centres(scene.camera)
    x, y = np.broadcast_arrays(x[columns], y[rows, None])
    on, height, normals = seen[at], rays.points[at][..., 2], rays.normals[at]
    # rays beyond the wall's edge are continued to its mean height
    height = np.where(on, height, rays.points[seen][:, 2].mean())
    normals = np.where(on[..., None], normals, (0.0, 0.0, 1.0)).reshape(-1, 3)
    nodes = Nodes(scene, x.ravel(), y.ravel(), height.ravel())
    share = np.ones(nodes.count)
    for block, toward, light in arrivals(scene, spot, patches, nodes.points):
        used = nodes.used[block]
        facing, view = normals[used][:, None], -nodes.directions[block][:, None]
        light *= np.maximum(dot(toward, facing), 0.0)
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
    """Return the indices of at most NODES pixels at which fractions are computed.

    The first and the last of ``count`` pixels are included.
    """
    return np.unique(np.rint(np.linspace(0, count - 1, min(NODES, count))).astype(np.intp))


def _bilinear(
    values: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, ...]
) -> Array:
    """Interpolate values given at pixels ``rows`` and ``columns`` bilinearly to all pixels."""
    for axis, nodes in enumerate((rows, columns)):
        at = np.arange(shape[axis])
        low = np.minimum(np.searchsorted(nodes, at, side="right") - 1, max(len(nodes) - 2, 0))
        high = np.minimum(low + 1, len(nodes) - 1)
        part = (at - nodes[low]) / np.maximum(nodes[high] - nodes[low], 1)
        below, above = values.take(low, axis), values.take(high, axis)
        values = below + (part[:, None] if axis == 0 else part) * (above - below)
    return values
