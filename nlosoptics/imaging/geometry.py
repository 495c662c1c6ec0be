"""Chief rays from the detector via the relay wall to the object, and averages over pixels.

A chief ray starts at the detector point (x, y), passes through the centre of the lens along
(-x, -y, d) in the camera's frame and is mirrored by the wall. An object point on this ray is imaged
at (x, y). One reflection reverses handedness: an image array drawn with row 0 on top shows the
hidden picture upright and mirror-reversed if the camera is upright.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .._vectors import dot
from ..errors import SceneError
from ..raytrace import intersect
from ..scene import Camera, PlanarObject, Scene, SumWall, Wall

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False, kw_only=True)
class ChiefRays:
    """Chief rays traced backward from the detector to the wall and on toward the object."""

    directions: Array  # (..., 3): Unit vectors away from the lens, world frame
    cos_axis: Array  # (...): Cosines of the angles to the optical axis
    distance: Array  # (...): Distances from lens to wall, m; NaN where a ray misses the wall
    # (..., 3): Points on the wall, m, and unit normals, world frame. Just beyond the wall's edge
    # they lie on its continuation; NaN where a ray misses
    points: Array
    normals: Array
    # (..., 3): Unit vectors from the wall toward the object, world frame; NaN where a ray misses
    reflected: Array


def pixel_centres(camera: Camera) -> tuple[Array, Array]:
    """Return detector coordinates x (nx,) and y (ny,) of the pixel centres, m."""
    y, x = (
        (np.arange(n, dtype=np.float64) - (n - 1) / 2) * camera.image_pitch for n in camera.shape
    )
    return x, y


def pixel_edges(camera: Camera) -> tuple[Array, Array]:
    """Return detector coordinates x (nx + 1,) and y (ny + 1,) of the pixel edges, m."""
    y, x = ((np.arange(n + 1, dtype=np.float64) - n / 2) * camera.image_pitch for n in camera.shape)
    return x, y


def chief_rays(scene: Scene, x: Array, y: Array) -> ChiefRays:
    """Trace the chief rays of the detector grid with columns at ``x`` and rows at ``y``.

    Returns rays with arrays of shape (ny, nx) or (ny, nx, 3), or of the shape of ``x`` and ``y``
    if these are arrays of two axes.
    """
    distance = scene.image_distance
    e1, e2, axis = scene.camera.frame
    if x.ndim == 1:
        x, y = x[None, :], y[:, None]
    directions = distance * axis - x[..., None] * e1 - y[..., None] * e2
    length = np.sqrt(x**2 + y**2 + distance**2)
    directions /= length[..., None]
    hits = intersect(_with_margin(scene), np.array(scene.camera.position), directions)
    along = dot(directions, hits.normals)
    return ChiefRays(
        directions=directions,
        cos_axis=distance / length,
        distance=hits.distance,
        points=hits.points,
        normals=hits.normals,
        reflected=directions - 2.0 * along[..., None] * hits.normals,
    )


def _with_margin(scene: Scene) -> Wall:
    """Return the wall extended beyond its edges by more than the lens's footprint on it."""
    wall = scene.wall
    if wall.size is None:
        return wall
    margin = 2.0 * scene.camera.stop_diameter
    size = (wall.size[0] + margin, wall.size[1] + margin)
    try:
        if isinstance(wall, SumWall):
            return SumWall(*wall.terms, size=size)
        if "size" in getattr(wall, "__dataclass_fields__", {}):
            return replace(wall, size=size)  # type: ignore[type-var]
    except SceneError:  # a spherical cap close to a hemisphere cannot be extended
        pass
    return wall


def on_wall(scene: Scene, rays: ChiefRays, use: NDArray[np.bool_], lens: Array) -> Array:
    """Return the wall points (m, 3), m, of rays through a point of the lens.

    Each ray goes to the point in focus on its chief ray. The wall is replaced by its tangent plane
    at the chief ray's wall point. ``use`` selects the rays and ``lens`` (3,) is the point, m.
    """
    ahead = scene.focus_distance / rays.cos_axis[use]
    line = np.array(scene.camera.position) + ahead[:, None] * rays.directions[use] - lens
    normals = rays.normals[use]
    height = dot(rays.points[use] - lens, normals)
    return np.asarray(lens + (height / dot(line, normals))[:, None] * line)


def wall_visibility(scene: Scene, rays: ChiefRays) -> Array:
    """Fraction of each pixel's light cone that the wall's edges and the field stop transmit.

    The lens's footprint on the wall is approximated by an affine image of the lens disc on the
    tangent plane. This is exact at one edge or two opposite edges; at corners the fractions are
    multiplied.
    """
    camera = scene.camera
    seen = np.isfinite(rays.distance)
    if camera.field_stop is not None:
        seen &= rays.cos_axis >= np.cos(camera.field_stop / 2)
    visible = seen.astype(np.float64)
    if scene.wall.size is None:
        return visible
    d, n = rays.directions[seen], rays.normals[seen]
    along, across = dot(d, n), [dot(n, e) for e in camera.frame[:2]]
    # the cone shrinks linearly from the lens to the point in focus
    part = rays.distance[seen] * rays.cos_axis[seen] / scene.focus_distance
    scale = camera.stop_diameter / 2 * np.abs(1.0 - part) / along
    for i, half in enumerate((scene.wall.size[0] / 2, scene.wall.size[1] / 2)):
        reach = np.zeros(part.shape)
        for e, turned in zip(camera.frame[:2], across, strict=True):
            reach += (e[i] * along - d[:, i] * turned) ** 2
        reach = np.maximum(np.abs(scale) * np.sqrt(reach), 1e-15)
        at = rays.points[..., i][seen]
        inside = _disc_part((half - at) / reach) + _disc_part((half + at) / reach) - 1.0
        visible[seen] *= np.maximum(inside, 0.0)
    return visible


def _disc_part(chord: Array) -> Array:
    """Fraction of the unit disc's area below a chord at a signed distance from the centre."""
    part = (chord > 0.0).astype(np.float64)
    cut = abs(chord) < 1.0
    c = chord[cut]
    part[cut] = 1.0 - (np.arccos(c) - c * np.sqrt(1.0 - c * c)) / np.pi
    return part


def picture_coordinates(hidden: PlanarObject, rays: ChiefRays) -> tuple[Array, Array]:
    """Intersections of mirrored chief rays with the front of the picture's plane.

    Returns coordinates in texels: texel (i, j) spans rows i to i + 1 and columns j to j + 1, with
    row 0 on top. NaN where a ray does not meet the front of the plane.
    """
    right, up = plane_coordinates(hidden, rays)
    rows, columns = hidden.reflectance.shape
    return (right / hidden.size[0] + 0.5) * columns, (0.5 - up / hidden.size[1]) * rows


def plane_coordinates(hidden: PlanarObject, rays: ChiefRays) -> tuple[Array, Array]:
    """Return the points of `picture_coordinates` in metres, right of and above the position."""
    right, up, normal = hidden.axes
    toward = np.array(hidden.position) - rays.points
    facing = dot(rays.reflected, normal)
    height = dot(toward, normal)
    # comparisons with NaN, from rays that miss the wall, are false
    meets = (facing < 0.0) & (height < 0.0)
    t = np.full(facing.shape, np.nan)
    np.divide(height, facing, out=t, where=meets)
    offset = t[..., None] * rays.reflected - toward
    return dot(offset, right), dot(offset, up)


def picture_positions(hidden: PlanarObject, rays: ChiefRays) -> tuple[Array, Array]:
    """Intersections of mirrored chief rays with the picture's plane, relative to its half size."""
    right, up = plane_coordinates(hidden, rays)
    return np.nan_to_num(2.0 * right / hidden.size[0]), np.nan_to_num(2.0 * up / hidden.size[1])


def picture_points(hidden: PlanarObject, column: Array, row: Array) -> Array:
    """Return world points (n, 3), m, for texel coordinates (n,) of a picture."""
    right, up, _ = hidden.axes
    rows, columns = hidden.reflectance.shape
    across = (column / columns - 0.5) * hidden.size[0]
    upward = (0.5 - row / rows) * hidden.size[1]
    return np.asarray(hidden.position + across[:, None] * right + upward[:, None] * up)


def area_average(picture: Array, column: Array, row: Array) -> Array:
    """Average a picture of square texels over quadrilateral footprints, see `Footprints`."""
    return Footprints((picture.shape[0], picture.shape[1]), column, row).average(picture)


class Footprints:
    """Quadrilateral footprints of pixels on a picture of ``shape`` (rows, columns) square texels.

    ``column`` and ``row`` (ny + 1, nx + 1) are texel coordinates of the corners; NaN if undefined.

    By Green's theorem the integral over a footprint is the integral of F dy along its outline,
    where F(x, y) is the picture integrated along the row up to x. Between texel borders F is
    linear, so that the midpoint rule is exact for texels of any size. Neighbouring footprints
    share their outlines, so that no light is lost or counted twice. A footprint that is folded or
    has no area is sampled at its centre.
    """

    def __init__(self, shape: tuple[int, int], column: Array, row: Array) -> None:
        self.shape, self._pixels = shape, (column.shape[0] - 1, column.shape[1] - 1)
        known = np.isfinite(column) & np.isfinite(row)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        touched = whole & _touches(column, shape[1]) & _touches(row, shape[0])
        i, j = np.nonzero(touched)
        if not i.size:
            i = j = np.zeros(1, dtype=np.intp)
        self._window = slice(i.min(), i.max() + 1), slice(j.min(), j.max() + 1)
        corners = slice(i.min(), i.max() + 2), slice(j.min(), j.max() + 2)
        touched = touched[self._window]
        x, y = (np.where(known, c, 0.0)[corners] for c in (column, row))
        self._across = x[:, :-1], y[:, :-1], x[:, 1:], y[:, 1:]
        self._upward = x[:-1], y[:-1], x[1:], y[1:]
        turned = _turn(x, y)
        self._sound = touched & ((turned > 0).all(axis=0) | (turned < 0).all(axis=0))
        self._folded = touched & ~self._sound
        middle = [c[:-1, :-1] + c[1:, :-1] + c[:-1, 1:] + c[1:, 1:] for c in (x, y)]
        u, v = (np.floor(c[self._folded] / 4).astype(np.intp) for c in middle)
        within = (u >= 0) & (u < shape[1]) & (v >= 0) & (v < shape[0])
        self._centres = v * within, u * within, within
        # of the trapezia between each segment and x = 0
        across, upward = (
            (x0 + (x1 - x0) / 2) * (y1 - y0) for x0, y0, x1, y1 in (self._across, self._upward)
        )
        self._area = across[:-1] + upward[:, 1:] - across[1:] - upward[:, :-1]

    def average(self, picture: Array) -> Array:
        """Return the mean of a picture over each footprint, (ny, nx); 0 if it is undefined."""
        result = np.zeros(self._pixels)
        if not (self._sound.any() or self._folded.any()):
            return result
        summed = np.zeros((self.shape[0], self.shape[1] + 1))
        np.cumsum(picture, axis=1, out=summed[:, 1:])
        across, upward = (
            _outline_integral(summed, *segments) for segments in (self._across, self._upward)
        )
        light = across[:-1] + upward[:, 1:] - across[1:] - upward[:, :-1]
        average = np.zeros(light.shape)
        np.divide(light, self._area, out=average, where=self._sound)
        rows, columns, within = self._centres
        average[self._folded] = np.where(within, picture[rows, columns], 0.0)
        result[self._window] = average
        return result

    def adjoint(self, values: Array) -> Array:
        """Return the adjoint of `average`: values of the texels from values (ny, nx) of pixels."""
        values = values[self._window]
        share = np.zeros(values.shape)
        np.divide(values, self._area, out=share, where=self._sound)
        across = np.pad(share, ((0, 1), (0, 0))) - np.pad(share, ((1, 0), (0, 0)))
        upward = np.pad(share, ((0, 0), (1, 0))) - np.pad(share, ((0, 0), (0, 1)))
        summed = np.zeros((self.shape[0], self.shape[1] + 1))
        for light, segments in ((across, self._across), (upward, self._upward)):
            for part, rise, (i, j), right, weight in _outline_parts(self.shape, *segments):
                weight *= (light.ravel()[part] * rise)[:, None]
                for column, factor in ((j, 1.0 - right), (j + 1, right)):
                    at = (i * summed.shape[1] + column).ravel()
                    total = np.bincount(at, (factor * weight).ravel(), summed.size)
                    summed += total.reshape(summed.shape)
        result = np.ascontiguousarray(summed[:, :0:-1].cumsum(axis=1)[:, ::-1])
        rows, columns, within = self._centres
        np.add.at(result, (rows, columns), within * values[self._folded])
        return result


def _touches(c: Array, count: int) -> NDArray[np.bool_]:
    """Return a mask of the footprints that overlap the texels 0 to ``count`` along one axis."""
    corners = (c[:-1, :-1], c[1:, :-1], c[:-1, 1:], c[1:, 1:])
    low = np.minimum(np.minimum(*corners[:2]), np.minimum(*corners[2:]))
    high = np.maximum(np.maximum(*corners[:2]), np.maximum(*corners[2:]))
    return np.asarray((high > 0) & (low < count))


def _turn(x: Array, y: Array) -> Array:
    """Return the cross products of adjacent sides at the four corners of every footprint.

    Their signs tell whether a quadrilateral is convex.
    """
    px = (x[:-1, :-1], x[:-1, 1:], x[1:, 1:], x[1:, :-1])
    py = (y[:-1, :-1], y[:-1, 1:], y[1:, 1:], y[1:, :-1])
    corners = []
    for k in range(4):
        a, b, c = k, (k + 1) % 4, (k + 2) % 4
        corners.append((px[b] - px[a]) * (py[c] - py[b]) - (py[b] - py[a]) * (px[c] - px[b]))
    return np.stack(corners)


def _outline_integral(summed: Array, x0: Array, y0: Array, x1: Array, y1: Array) -> Array:
    """Return the integrals of F dy along straight segments, in their shape.

    ``summed`` is the picture summed along its rows, from which F(x, y) follows. The segments go
    from (x0, y0) to (x1, y1), in texels.
    """
    total = np.zeros(x0.size)
    texels = summed.shape[0], summed.shape[1] - 1
    for part, rise, (i, j), right, weight in _outline_parts(texels, x0, y0, x1, y1):
        low = summed[i, j]
        total[part] = ((low + right * (summed[i, j + 1] - low)) * weight).sum(axis=1) * rise
    return total.reshape(x0.shape)


def _outline_parts(
    shape: tuple[int, int], x0: Array, y0: Array, x1: Array, y1: Array
) -> Iterator[tuple[Index, Array, tuple[Index, Index], Array, Array]]:
    """Yield segments, their dy, and where the integrals along them sample the summed picture.

    F is interpolated between the columns j and j + 1 of row i, with the share of the right one.
    Weights are parts of the segment, 0 outside the picture.
    """
    rows, columns = shape
    x0, y0, dx, dy = (a.ravel() for a in (x0, y0, x1 - x0, y1 - y0))
    counts = _crossings(x0, dx, columns)[1] + _crossings(y0, dy, rows)[1]
    order = np.argsort(-counts, kind="stable")  # group segments with similar numbers of cuts
    start = 0
    while start < order.size:
        stop = start + max(1, 2**20 // (int(counts[order[start]]) + 2))  # bounds the memory
        part = order[start:stop]
        cuts = _cuts(x0[part], dx[part], y0[part], dy[part], rows, columns)
        middle, step = (cuts[:, 1:] + cuts[:, :-1]) / 2, np.diff(cuts, axis=1)
        u = np.clip(x0[part, None] + middle * dx[part, None], 0.0, columns)
        v = y0[part, None] + middle * dy[part, None]
        inside = (v > 0.0) & (v < rows)
        i = np.where(inside, v, 0.0).astype(np.intp)
        j = np.minimum(u.astype(np.intp), columns - 1)
        yield part, dy[part], (i, j), u - j, np.where(inside, step, 0.0)
        start = stop


def _crossings(start: Array, change: Array, count: int) -> tuple[Array, NDArray[np.intp]]:
    """First texel border (0 to count) that each segment crosses, and the number of crossings."""
    low = np.clip(np.ceil(np.minimum(start, start + change)), 0, count + 1)
    high = np.clip(np.floor(np.maximum(start, start + change)), -1, count)
    return low, np.maximum(high - low + 1, 0).astype(np.intp)


def _cuts(x0: Array, dx: Array, y0: Array, dy: Array, rows: int, columns: int) -> Array:
    """Return the parameters, 0 to 1, at which segments cross texel borders.

    They are sorted along the last axis and padded with 1.
    """
    tables = [np.zeros((x0.size, 1)), np.ones((x0.size, 1))]
    for start, change, count in ((x0, dx, columns), (y0, dy, rows)):
        low, number = _crossings(start, change, count)
        width = int(number.max(initial=0))
        border = low[:, None] + np.arange(width)
        crossed = (np.arange(width) < number[:, None]) & (change != 0.0)[:, None]
        at = np.ones(border.shape)
        np.divide(border - start[:, None], change[:, None], out=at, where=crossed)
        tables.append(np.clip(at, 0.0, 1.0))
    return np.sort(np.concatenate(tables, axis=1), axis=1)
