"""The hidden object as a light source: patches, sample points, and visible parts of a mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._vectors import dot
from ..raytrace import intersect_mesh, occluded
from ..scene import MeshObject, PlanarObject, Scene
from .geometry import picture_points

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
#: Centre, axes (right, up, normal) and size of a plane, m.
Plate = tuple[Array, Array, tuple[float, float]]

MAX_PATCHES = 4096


@dataclass(frozen=True, eq=False, kw_only=True)
class Patches:
    """Small patches that represent a surface."""

    points: Array  # (n, 3): Positions, m, and unit normals toward the lit front, world frame
    normals: Array
    areas: Array  # (n,): Patch areas times relative reflectance, m^2


def object_patches(
    hidden: PlanarObject | MeshObject,
    irradiance: Callable[[Array], Array] | None = None,
    step: float = math.inf,
) -> Patches:
    """Represent the hidden object by patches, for its diffuse illumination of the wall.

    A picture gets about 50 size/distance patches along each side, at least 8 and at most 64. Each
    is placed at its centre of reflectance, which leaves an error of order (patch/distance)^2, below
    1e-3 of the light. Dark patches are dropped. The triangles of a mesh are subdivided or sampled
    by area; parts of a mesh that hide one another are not detected.
    """
    if isinstance(hidden, MeshObject):
        return _mesh_patches(hidden.surface)
    picture = hidden.reflectance
    right, up, normal = hidden.axes
    drop = (hidden.size[0] * abs(right[2]) + hidden.size[1] * abs(up[2])) / 2
    nearest = hidden.position[2] - drop  # positive, guaranteed by PlanarObject
    edges: list[NDArray[np.intp]] = []
    for texels, extent in zip(picture.shape, hidden.size[::-1], strict=True):
        count = min(max(math.ceil(50 * extent / nearest), 8), 64)
        samples = max(count, min(extent / step, 512))
        repeat = max(1, math.ceil(samples / texels))
        picture = np.repeat(picture, repeat, axis=len(edges))
        edges.append(np.linspace(0, texels * repeat, count + 1).astype(np.intp))
    rows, columns = (
        (np.arange(n) + 0.5) * (texels / n)
        for n, texels in zip(picture.shape, hidden.reflectance.shape, strict=True)
    )
    if irradiance is not None:
        lines = [
            irradiance(picture_points(hidden, columns, np.full_like(columns, row))) for row in rows
        ]
        picture = picture * np.array(lines)
    light = _block_sums(picture, edges)
    lit = light > 0.0
    row = _block_sums(picture * rows[:, None], edges)[lit] / light[lit]
    column = _block_sums(picture * columns, edges)[lit] / light[lit]
    points = picture_points(hidden, column, row)
    areas = light[lit] * (hidden.size[0] * hidden.size[1] / picture.size)
    if irradiance is not None:
        there = irradiance(points)
        areas = np.divide(areas, there, out=np.zeros_like(areas), where=there > 0.0)
    return Patches(points=points, normals=np.broadcast_to(normal, points.shape), areas=areas)


def _block_sums(picture: Array, edges: list[NDArray[np.intp]]) -> Array:
    sums = np.add.reduceat(picture, edges[0][:-1], axis=0)
    return np.asarray(np.add.reduceat(sums, edges[1][:-1], axis=1))


def resampled(picture: Array, shape: tuple[int, int]) -> Array:
    """Return the means of a picture over ``shape`` equal cells."""
    for axis, count in enumerate(shape):
        texels = picture.shape[axis]
        if texels != count:
            edges = np.linspace(0.0, texels, count + 1)[:, None] - np.arange(texels)
            parts = np.diff(np.clip(edges, 0.0, 1.0), axis=0) * (count / texels)
            picture = np.moveaxis(np.tensordot(parts, picture, (1, axis)), 0, axis)
    return picture


def _mesh_patches(mesh: trimesh.Trimesh) -> Patches:
    area = np.asarray(mesh.area_faces, dtype=np.float64)
    size = math.sqrt(area.sum() / 512)
    triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
    points, facing, areas = [], [], []
    cuts = np.maximum(1, np.ceil(np.sqrt(2 * area) / size)).astype(np.intp)
    for n in np.unique(cuts):
        chosen = cuts == n
        spots = np.einsum("pk,tkc->tpc", _barycentric(int(n)), triangles[chosen])
        points.append(spots.reshape(-1, 3))
        facing.append(np.repeat(normals[chosen], n * n, axis=0))
        areas.append(np.repeat(area[chosen] / n**2, n * n))
    point, normal, share = (np.concatenate(a) for a in (points, facing, areas))
    if len(share) > MAX_PATCHES:
        # equal steps of area along the list of triangles
        steps = (np.arange(MAX_PATCHES) + 0.5) / MAX_PATCHES * share.sum()
        chosen = np.searchsorted(np.cumsum(share), steps)
        total = share.sum() / MAX_PATCHES
        point, normal, share = point[chosen], normal[chosen], np.full(MAX_PATCHES, total)
    return Patches(points=point, normals=normal, areas=share)


def _barycentric(n: int) -> Array:
    """Centroids of the n^2 equal parts of a triangle, (n^2, 3)."""
    upright = [(3 * i + 1, 3 * j + 1) for i in range(n) for j in range(n - i)]
    inverted = [(3 * i + 2, 3 * j + 2) for i in range(n) for j in range(n - i - 1)]
    ab = np.array(upright + inverted, dtype=np.float64) / (3 * n)
    return np.column_stack([ab, 1.0 - ab.sum(axis=1)])


def object_samples(hidden: PlanarObject | MeshObject, count: int) -> Patches:
    """Represent the hidden object by points of equal reflecting area.

    The points follow an additive recurrence (low-discrepancy sequence). The fraction of points in
    any part of the object has an error of about count^(-3/4). Unlike a grid of patches, the points
    have no rows that could line up with a shadow's edge.
    """
    if isinstance(hidden, MeshObject):
        u, v, w = _even(count, 3)
        mesh = hidden.surface
        share = np.cumsum(np.asarray(mesh.area_faces, dtype=np.float64))
        face = np.searchsorted(share, u * share[-1])
        a, b, c = np.moveaxis(np.asarray(mesh.triangles)[face], 1, 0)
        root = np.sqrt(v)[:, None]
        points = (1.0 - root) * a + root * ((1.0 - w[:, None]) * b + w[:, None] * c)
        normals, total = np.asarray(mesh.face_normals)[face], float(share[-1])
    else:
        picture = hidden.reflectance
        light = picture.sum(axis=1)
        if not light.any():
            count = 0
        u, v = _even(count, 2)
        row, below = _quantiles(np.broadcast_to(light, (count, len(light))), u)
        column, left = _quantiles(picture[row], v)
        points = picture_points(hidden, column + left, row + below)
        normals = np.broadcast_to(hidden.axes[2], points.shape)
        total = float(light.sum()) * hidden.size[0] * hidden.size[1] / picture.size
    areas = np.full(len(points), total / max(len(points), 1))
    return Patches(points=points, normals=normals, areas=areas)


def _even(count: int, axes: int) -> Array:
    """Return ``count`` low-discrepancy points of the unit square or cube, (count, axes).

    R sequence, whose steps follow from the root of x^(axes+1) = x + 1.
    """
    root = {2: 1.3247179572447460, 3: 1.2207440846057596}[axes]
    steps = root ** -np.arange(1.0, axes + 1)
    return np.asarray((0.5 + steps[:, None] * np.arange(1, count + 1)) % 1.0)


def _quantiles(weights: Array, share: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the cells (n,) at which cumulative weights (n, k) reach shares (n,), 0 up to below 1.

    Also returned is the fraction of each cell that is needed, (n,).
    """
    summed = np.cumsum(weights, axis=1)
    wanted = share * summed[:, -1]
    cell = (summed <= wanted[:, None]).sum(axis=1)
    each = np.arange(len(cell))
    own = weights[each, cell]
    return cell, np.clip(1.0 - (summed[each, cell] - wanted) / own, 0.0, 1.0)


def mesh_hits(
    mesh: trimesh.Trimesh, source: Array, origins: Array, directions: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """First intersections of rays with a mesh, restricted to points that the source lights.

    A point is lit if its triangle faces the source and no other part of the mesh is in between.
    """
    hits = intersect_mesh(mesh, origins, directions)
    met = np.nonzero(hits.hit)[0]
    point, normal = hits.points[met], np.asarray(mesh.face_normals)[hits.triangle[met]]
    facing = dot(directions[met], normal) < 0.0
    facing &= dot(point - source, normal) < 0.0
    met, point, normal = met[facing], point[facing], normal[facing]
    free = ~occluded(mesh, np.broadcast_to(source, point.shape), point)
    points, normals = np.zeros(origins.shape), np.zeros(origins.shape)
    lit = np.zeros(len(origins), dtype=bool)
    chosen = met[free]
    points[chosen], normals[chosen], lit[chosen] = point[free], normal[free], True
    return points, normals, lit


def plate(scene: Scene) -> Plate:
    """Return centre, axes (right, up, normal) and size of the object's plane, m, world frame.

    A mesh is replaced by a plate that faces the wall and has the mesh's width and height.
    """
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        return np.array(hidden.position), hidden.axes, (hidden.size[0], hidden.size[1])
    extent = np.ptp(np.asarray(hidden.surface.vertices), axis=0)
    axes = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    return scene.object_point, axes, (float(extent[0]), float(extent[1]))
