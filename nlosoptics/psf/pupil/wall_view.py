"""First-order (linear) optics of the relay wall as seen from the exit pupil."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import vector
from ..._nouns import Noun
from ...scene import Scene, Wall
from .aiming import aim, pupil_points
from .exit_pupil import exit_pupil

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class WallView(Noun):
    """Linear map from points of the exit pupil to the wall points from which light reaches them.

    It is an expansion about the chief ray, which goes from the object point via the wall to the
    centre of the lens. Roughness of the wall acts on the wave through this map.

    Parameters
    ----------
    footprint : ndarray, (2, 2)
        Matrix M. Seen from a pupil point displaced by (du, dv), the object's light comes from a
        wall point displaced by M (du, dv) in the wall's tangent plane.
    cos_sum : float
        Sum of the cosines of the chief ray's angles of incidence and of reflection at the wall. A
        wall height h changes the path by ``-cos_sum * h``.
    effective_distance : ndarray, (2, 2)
        Distance over which wall ripples diffract on their way to the pupil, m, as a matrix. For a
        flat wall at normal incidence it is ``d1 d2/(d1 + d2)`` times the unit matrix, with d1 and
        d2 the distances from the wall to object and lens. In general it is the inverse of the
        second derivatives of the path length with respect to the wall point.
    point : ndarray, (3,)
        Point at which the chief ray meets the wall, in world coordinates, m.
    tangents : ndarray, (2, 3)
        Two unit vectors in the wall's tangent plane at that point, in world coordinates. Steps on
        the wall are given along them.

    See Also
    --------
    wall_view : Computes it for a scene.
    """

    footprint: Array
    cos_sum: float
    effective_distance: Array
    point: Array
    tangents: Array


@dataclass(frozen=True, eq=False)
class _Chief:
    """First-order optics of a wall at the points that lens points see.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Wall points, world frame, m.
    cosines : ndarray, (n,)
        Sum of the cosines of incidence and exitance.
    bend : ndarray, (n, 2, 2)
        Second derivatives of the path over the wall's tangent plane, 1/m.
    footprint : ndarray, (n, 2, 2)
        Matrix M from a step in the lens to the step of the wall point that it sees.
    tangents : ndarray, (n, 2, 3)
        Unit vectors of the wall's tangent planes, world.
    """

    points: Array
    cosines: Array
    bend: Array
    footprint: Array
    tangents: Array


def wall_view(scene: Scene, object_point: ArrayLike | None = None) -> WallView:
    """Compute how points of a scene's exit pupil map to the wall points they see, to first order.

    The point spread functions of rough walls use this map, for example `mean_point_spread`.

    Parameters
    ----------
    scene : Scene
        Scene with the camera, the hidden object and the wall.
    object_point : array_like, (3,), optional
        Object point in world coordinates, m, at which the chief ray starts. Default: the hidden
        object's reference point, that is the centre of a planar object or the centroid of a mesh.

    Returns
    -------
    WallView
        The map (``footprint``, (2, 2), without unit), the wall point of the chief ray (``point``,
        (3,), world frame, m) and further geometry of the reflection at this point.

    Raises
    ------
    CausticError
        If several rays or none connect the object point with the lens via the wall.

    See Also
    --------
    mean_point_spread : Mean PSF over all walls of one roughness.
    pupil_slopes : Wave slopes caused by facet tilts.

    Notes
    -----
    Let M be the matrix that maps displacements on the lens to displacements on the wall, m to m;
    `pupil_slopes` gives its formula. If the lens is the stop, it is also the exit pupil, and
    ``footprint`` is M. If the wall is the stop, the exit pupil is the image of the wall by the
    lens. The light to the image's centre crosses the pupil and the lens in discs, whose radii have
    a ratio m; then ``footprint`` is M/m.
    """
    o = None if object_point is None else np.array(vector("object_point", object_point))
    return _view_of(_optics(scene, np.zeros((1, 2)), o), _zoom(scene))


def view_along(scene: Scene, zoom: float, object_point: Array, hit: Array) -> WallView:
    """Return the first-order map from the exit pupil to the wall for a known chief ray."""
    return _view_of(_optics(scene, np.zeros((1, 2)), object_point, hit[None]), zoom)


def _view_of(chief: _Chief, zoom: float) -> WallView:
    """Return the view from the exit pupil, given the optics ``chief`` of the chief ray at the lens.

    ``zoom`` is the ratio of the exit pupil's size to that of the cone on the lens.
    """
    return WallView(
        footprint=chief.footprint[0] / zoom,
        cos_sum=float(chief.cosines[0]),
        effective_distance=np.linalg.inv(chief.bend[0]),
        point=np.array(chief.points[0]),
        tangents=np.array(chief.tangents[0]),
    )


def _zoom(scene: Scene) -> float:
    """Ratio of the exit pupil's size to that of the cone on the lens; 1 if the lens is the stop.

    It is negative if the wall is the stop, whose image is inverted.
    """
    return exit_pupil(scene).image_distance / scene.image_distance


def _optics(
    scene: Scene, on_lens: Array, o: Array | None = None, points: Array | None = None
) -> _Chief:
    """First-order optics of the mean wall for points ``on_lens`` (n, 2), m.

    ``o`` (3,) is the object point, by default the reference point. ``points`` (n, 3) are the wall
    points of its rays, world frame, m; they are found by aiming if omitted.
    """
    o, axes = scene.object_point if o is None else o, scene.camera.frame
    ends = pupil_points(scene.camera.position, axes[2], on_lens)
    if points is None:
        points = aim(scene.wall, o, ends, axes[2]).points
    tangents, normal, bend = _wall_frames(scene.wall, points)
    legs = [o - points, ends - points]
    lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
    units = [leg / length[:, None] for leg, length in zip(legs, lengths, strict=True)]
    cosines = sum(np.sum(unit * normal, axis=1) for unit in units)
    total = -cosines[:, None, None] * bend
    for unit, length in zip(units, lengths, strict=True):
        inside = np.einsum("nak,nk->na", tangents, unit)
        total += (np.eye(2) - inside[:, :, None] * inside[:, None, :]) / length[:, None, None]
    # E_ab = t_a (I - s_o s_o^T) e_b
    across = axes[:2] - (units[1] @ axes[:2].T)[:, :, None] * units[1][:, None, :]
    into = np.einsum("nak,nbk->nab", tangents, across) / lengths[1][:, None, None]
    return _Chief(points, cosines, total, np.linalg.solve(total, into), tangents)


def _wall_frames(wall: Wall, points: Array) -> tuple[Array, Array, Array]:
    """Tangents (n, 2, 3), normals (n, 3) and curvature matrices (n, 2, 2), 1/m, at wall points."""
    if wall.is_flat:
        n = len(points)
        frame = np.broadcast_to(np.eye(3), (n, 3, 3))
        return frame[:, :2], frame[:, 2], np.zeros((n, 2, 2))
    _, hx, hy, hxx, hxy, hyy = wall.derivatives(points[:, 0], points[:, 1]).T
    zero, one = np.zeros_like(hx), np.ones_like(hx)
    steep = np.sqrt(1 + hx**2 + hy**2)
    normal = np.stack([-hx, -hy, one], axis=1) / steep[:, None]
    first = np.stack([one, zero, hx], axis=1) / np.sqrt(1 + hx**2)[:, None]
    tangents = np.stack([first, np.cross(normal, first)], axis=1)
    hessian = np.stack([np.stack([hxx, hxy], axis=1), np.stack([hxy, hyy], axis=1)], axis=1)
    flat = tangents[:, :, :2]
    bend = np.einsum("nai,nij,nbj->nab", flat, hessian, flat) / steep[:, None, None]
    return tangents, normal, bend
