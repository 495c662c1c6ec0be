"""Shadows of black occluders: fractions of each pixel's light that is not blocked.

Light of the image travels from the laser spot to the object, to the wall and through the lens. The
diffuse background follows the same three legs via all points of the object. Each leg is tested as
a line of sight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import expect, fits_memory
from .._nouns import Noun
from .._vectors import dot
from ..raytrace import intersect_mesh, occluded
from ..scene import FlatWall, PlanarObject, Scene
from .geometry import (
    ChiefRays,
    chief_rays,
    on_wall,
    picture_coordinates,
    picture_points,
    pixel_centres,
    wall_visibility,
)
from .lit_walls import lit_transports, picture_cells, picture_sums
from .objects import object_samples, resampled
from .radiometry import LaserSpot, arrivals, check_beam, laser_spot, lit_spot

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

SIDE = 4  # sample paths along each side of a pixel, each through its own point of the lens
SAMPLES = 1024  # points that represent a mesh as a source
MOST_CELLS = 256  # of a picture along each side, as a source
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


def cast_shadows(scene: Scene, *, exact: bool = False) -> Shadows:
    """Compute which fractions of the light the occluders of a scene let through.

    Parameters
    ----------
    scene : Scene
        Scene with occluders; without any, all fractions are 1.
    exact : bool
        Whether to compute ``veil`` in all pixels of a picture's image, without interpolation.

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

    ``Shadows.veil`` concerns diffuse light on its way via the object to the wall. For a picture, it
    is the ratio of two sums, `WallTransport.forward` with and without occluders, whose shadows have
    exact edges. For a mesh, it is a sum over 1024 points, with an error of a few thousandths.
    Unless ``exact``, pixels are left out where interpolation between others agrees to some 1e-3 of
    the mean.

    The laser spot is treated as a point, and its image is dimmed uniformly.
    """
    scene = expect("scene", scene, "Scene")
    ny, nx = scene.camera.shape
    fits_memory(
        f"the shadows of {nx} x {ny} pixels (camera.pixels, camera.binning)",
        SHADOW_BYTES * nx * ny,
        "read fewer pixels or bin more",
    )
    spot = lit_spot(scene)
    mesh = scene.occluding_mesh
    if mesh is None:
        return Shadows(
            image=np.ones((ny, nx)), view=np.ones((ny, nx)), veil=np.ones((ny, nx)), spot=1.0
        )
    if spot is not None:
        check_beam(scene, mesh, spot)
        if scene.wall_material.specular_reflectance > 0.0:
            scene.check_laser_light()  # the fractions of the image are those of the laser's light
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    seen = wall_visibility(scene, rays) > 0
    image, view = path_shares(scene, mesh, spot, seen)
    lens = np.array(scene.camera.position) + _lens_points(scene)
    return Shadows(
        image=image,
        view=view,
        veil=_veil_share(scene, mesh, rays, seen, exact),
        spot=1.0 if spot is None else 1.0 - float(occluded(mesh, spot.point, lens).mean()),
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
    return replace(shadows, veil=_veil_share(scene, mesh, rays, seen))


def _lens_points(scene: Scene) -> Array:
    """Return SIDE^2 evenly spread points on the lens relative to its centre, world axes, m."""
    k = np.arange(SIDE**2)
    radius = scene.camera.stop_diameter / 2 * np.sqrt((k + 0.5) / SIDE**2)
    turn = k * math.pi * (3.0 - math.sqrt(5.0))  # golden angle
    disc = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return np.asarray(disc @ scene.camera.frame[:2])


def path_shares(
    scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot | None, seen: Mask
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
        lit[hit] = ~occluded(mesh, met_wall[hit], points)
        if spot is not None:
            lit[hit] &= ~occluded(mesh, points, spot.point)
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
    scene: Scene, mesh: trimesh.Trimesh, rays: ChiefRays, seen: Mask, exact: bool = False
) -> Array:
    """Return the unblocked fraction (ny, nx) of diffuse light from the object to the wall.

    ``rays`` are those of the pixel centres, and ``seen`` marks pixels that look at the wall. If
    ``exact``, no pixel is interpolated.
    """
    diffuse, hidden = scene.wall_material.diffuse, scene.hidden
    if diffuse is None or not seen.any():
        return np.ones(seen.shape)
    if isinstance(hidden, PlanarObject):
        x, y = pixel_centres(scene.camera)
        most = [min(n, MOST_CELLS) for n in hidden.reflectance.shape]
        picture = resampled(hidden.reflectance, (most[0], most[1]))
        if scene.wall.is_flat:  # no step at the wall's edge
            scene = replace(scene, wall=FlatWall())
        cells = picture_cells(scene, diffuse, picture.shape)
        sources = lit_transports(scene, cells=cells, material=diffuse)

        def share(row: Index, column: Index) -> Array:
            sums = [scale * picture_sums(one, picture, x[column], y[row]) for one, scale in sources]
            return _ratio(*np.sum(sums, axis=0)) if sources else np.ones(len(row))

    else:
        scene.check_laser_light()
        spot, patches = laser_spot(scene), object_samples(hidden, SAMPLES)
        lit = ~occluded(mesh, patches.points, spot.point)

        def share(row: Index, column: Index) -> Array:
            at, normals = rays.points[row, column], rays.normals[row, column][:, None]
            views, result = -rays.directions[row, column][:, None], np.ones(len(row))
            on = np.flatnonzero(seen[row, column])
            for block, toward, light in arrivals(scene, spot, patches, at[on]):
                used = on[block]
                light *= np.maximum(dot(toward, normals[used]), 0.0)
                light *= diffuse.evaluate(toward, views[used], normals[used])
                free = light * lit
                node, patch = np.nonzero(free)
                hides = occluded(mesh, at[used][node], patches.points[patch])
                free[node[hides], patch[hides]] = 0.0
                result[used] = _ratio(free.sum(axis=-1), light.sum(axis=-1))
            return result

    if exact:
        return share(*np.indices(seen.shape).reshape(2, -1)).reshape(seen.shape)
    # the hard shadow of the object's centre shows where narrow occluders are
    shadow = np.zeros(seen.shape, dtype=bool)
    shadow[seen] = occluded(mesh, rays.points[seen], scene.object_point)
    return _on_lattice(share, shadow)


def _ratio(free: Array, total: Array) -> Array:
    return np.asarray(np.divide(free, total, out=np.ones_like(total), where=total > 0.0))


def _on_lattice(share: Callable[[Index, Index], Array], shadow: Mask, tol: float = 2e-3) -> Array:
    """Return ``share(rows, columns)`` at all pixels, interpolated where that is accurate.

    Blocks of pixels are divided into four until bilinear interpolation from the corners agrees with
    five points between them to ``tol`` of the mean, and down to four pixels at edges of ``shadow``.
    Each block is then interpolated from these points as well, to about a quarter of the difference.
    """
    values = np.full(shadow.shape, np.nan)
    rows, columns = (
        np.unique(np.linspace(0, n - 1, (n + 14) // 16 + 1).round().astype(np.intp))
        for n in shadow.shape
    )

    def at(row: Index, column: Index) -> Array:
        """Return values, computed where they are not known yet."""
        flat = np.unique(np.ravel_multi_index((row, column), values.shape))
        missing = flat[np.isnan(values.ravel()[flat])]
        if len(missing):
            values.ravel()[missing] = share(*np.unravel_index(missing, values.shape))
        return values[row, column]

    at(*(grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij")))
    allowed = tol * float(np.nanmean(values))
    counts = np.pad(shadow.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    low, high = (
        np.meshgrid(rows[part], columns[part], indexing="ij")
        for part in (slice(-1), slice(1, None))
    )
    blocks = np.stack([low, high], axis=1).reshape(2, 2, -1)  # rows, columns of opposite corners
    while blocks.size:
        (r0, r1), (c0, c1) = blocks
        rm, cm = blocks.sum(axis=1) // 2
        between = [(r0, cm), (rm, c0), (rm, cm), (rm, c1), (r1, cm)]
        exact = at(*np.reshape(between, (5, 2, -1)).swapaxes(0, 1).reshape(2, -1)).reshape(5, -1)
        error = np.zeros(len(r0))
        for (row, column), value in zip(between, exact, strict=True):
            parts = (row - r0) / (r1 - r0), (column - c0) / (c1 - c0)
            error = np.maximum(error, np.abs(_bilinear(values, blocks, *parts) - value))
        shadowed = counts[r1 + 1, c1 + 1] - counts[r0, c1 + 1] - counts[r1 + 1, c0] + counts[r0, c0]
        edge = (shadowed > 0) & (shadowed < (r1 - r0 + 1) * (c1 - c0 + 1))
        finer = (error > allowed) | (edge & (np.maximum(r1 - r0, c1 - c0) > 4))
        quarters = np.stack(
            [
                np.stack([(a, b), (c, d)])
                for a, b in ((r0, rm), (rm, r1))
                for c, d in ((c0, cm), (cm, c1))
            ],
            axis=-1,
        )
        _fill(values, quarters[:, :, ~finer].reshape(2, 2, -1))
        blocks = quarters[:, :, finer].reshape(2, 2, -1)
        size = blocks[:, 1] - blocks[:, 0]
        blocks = blocks[..., (size.min(axis=0) > 0) & (size.max(axis=0) > 1)]
    return values


def _bilinear(values: Array, blocks: Index, down: Array, right: Array) -> Array:
    """Interpolate at parts of the way ``down`` and ``right`` in blocks of pixels."""
    (r0, r1), (c0, c1) = blocks
    above = (1.0 - right) * values[r0, c0] + right * values[r0, c1]
    below = (1.0 - right) * values[r1, c0] + right * values[r1, c1]
    return np.asarray((1.0 - down) * above + down * below)


def _fill(values: Array, blocks: Index) -> None:
    """Interpolate all pixels of blocks from their corners."""
    sizes = blocks[:, 1] - blocks[:, 0]
    for height, width in np.unique(sizes[:, sizes.min(axis=0) > 0], axis=1).T:
        some = blocks[..., (sizes[0] == height) & (sizes[1] == width)]
        steps = np.indices((height + 1, width + 1)).reshape(2, -1, 1)
        filled = _bilinear(values, some, steps[0] / height, steps[1] / width)
        values[some[0, 0] + steps[0], some[1, 0] + steps[1]] = filled
