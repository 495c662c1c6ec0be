"""First-order (linear) optics of the relay wall as seen from the exit pupil."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import expect
from ..._nouns import Noun
from ..._vectors import Array
from ...scene import Scene, Wall
from .aiming import aim, point_of, pupil_points
from .exit_pupil import exit_pupil


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

    Notes
    -----
    A lens point p sees the wall point M p, with the matrix
    ``M = [P_i/d1 + P_o/d2 - (cos_i + cos_o) K]^-1 E/d2``. The symbols are:

    - i and o: the rays from the wall point to the object (i) and to the lens (o), of lengths d1 and
      d2; cos_i and cos_o are the cosines of their angles to the wall's normal,
    - P_i and P_o: the matrix ``1 - e e^T`` for the ray i or o, with e the component of the ray's
      unit vector in the wall's tangent plane,
    - K: second derivatives of the mean wall, positive if the wall is concave to the room,
    - E: 2 x 2 matrix of scalar products. The u and v axes are projected onto the plane that is
      perpendicular to the ray o; row 1 has their products with t1, row 2 those with t2.

    If the lens is the stop, it is also the exit pupil, and ``footprint`` is M. If the wall is the
    stop, the exit pupil is the image of the wall by the lens. The light to the image's centre
    crosses the pupil and the lens in discs, whose radii have a ratio m; then ``footprint`` is M/m.
    """
    scene = expect("scene", scene, "Scene")
    o = point_of(scene, object_point)
    zoom = exit_pupil(scene).image_distance / scene.image_distance
    axis = scene.camera.axis
    lens = pupil_points(np.array(scene.camera.position), axis, np.zeros((1, 2)))
    return view_along(scene, zoom, o, aim(scene.wall, o, lens, axis).points[0])


def view_along(scene: Scene, zoom: float, object_point: Array, hit: Array) -> WallView:
    """Return the first-order map from the exit pupil to the wall for a known chief ray.

    The ray meets the wall at ``hit`` (3,), m. ``zoom`` is the size of the exit pupil over
    that of the cone on the lens, negative for an inverted image of the wall.
    """
    tangents, normal, bend = _wall_frame(scene.wall, hit)
    cosines, flat, into = first_order(scene, object_point[None], hit[None], tangents, normal)
    total = flat[0] - cosines[0] * bend
    return WallView(
        footprint=np.asarray(np.linalg.solve(total, into[0]) / zoom, dtype=np.float64),
        cos_sum=float(cosines[0]),
        effective_distance=np.asarray(np.linalg.inv(total), dtype=np.float64),
        point=np.array(hit),
        tangents=tangents,
    )


def first_order(
    scene: Scene, points: Array, hits: Array, tangents: Array, normal: Array
) -> tuple[Array, Array, Array]:
    """Return first-order terms of the paths from points by wall points ``hits`` to the lens.

    Both are (n, 3), m. The terms are ``cos_i + cos_o`` (n,), and the matrices (n, 2, 2) of
    `wall_view`: ``P_i/d1 + P_o/d2``, and E/d2.
    """
    frame = scene.camera.frame
    cosines, flat = np.zeros(len(hits)), np.zeros((len(hits), 2, 2))
    for ends in (points, np.array(scene.camera.position)):
        leg = ends - hits
        length = np.linalg.norm(leg, axis=1)
        unit = leg / length[:, None]
        cosines += unit @ normal
        inside = unit @ tangents.T
        flat += (np.eye(2) - inside[:, :, None] * inside[:, None, :]) / length[:, None, None]
    # E_ab = t_a (I - s_o s_o^T) e_b, for the leg to the lens, which comes last
    across = frame[:2] - (unit @ frame[:2].T)[:, :, None] * unit[:, None, :]
    return cosines, flat, tangents @ np.swapaxes(across, 1, 2) / length[:, None, None]


def _wall_frame(wall: Wall, point: Array) -> tuple[Array, Array, Array]:
    """Return tangents (2, 3), normal (3,) and curvature matrix (2, 2), 1/m, at a wall point."""
    if wall.is_flat:
        return np.eye(3)[:2], np.eye(3)[2], np.zeros((2, 2))
    _, hx, hy, hxx, hxy, hyy = wall.derivatives(point[:1], point[1:2])[0]
    steep = np.sqrt(1 + hx**2 + hy**2)
    normal = np.array([-hx, -hy, 1.0]) / steep
    first = np.array([1.0, 0.0, hx]) / np.sqrt(1 + hx**2)
    tangents = np.stack([first, np.cross(normal, first)])
    flat = tangents[:, :2]
    return tangents, normal, flat @ np.array([[hxx, hxy], [hxy, hyy]]) @ flat.T / steep
