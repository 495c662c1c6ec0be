"""First-order optics of the relay wall as seen from the exit pupil."""

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
    """How the exit pupil sees the wall about the chief ray, in first order.

    Parameters
    ----------
    footprint : ndarray, (2, 2)
        M, which takes a step (du, dv) in the exit pupil to the step of the point that it sees in
        the wall's tangent plane.
    cos_sum : float
        Sum of the cosines of incidence and exitance.
    effective_distance : ndarray, (2, 2)
        m: inverse of the path's second derivatives over the wall; ``d1 d2/(d1 + d2)`` times the
        unit matrix at normal incidence on a flat wall.
    """

    footprint: Array
    cos_sum: float
    effective_distance: Array


@dataclass(frozen=True, eq=False)
class _Chief:
    """First-order optics of a wall at the points that pupil nodes see.

    Parameters
    ----------
    points : ndarray, (n, 3)
        World, m.
    cosines : ndarray, (n,)
        Sum of the cosines of incidence and exitance.
    bend : ndarray, (n, 2, 2)
        Second derivatives of the path over the wall, 1/m.
    footprint : ndarray, (n, 2, 2)
        M, which takes a step in the lens to the step of the point that it sees in the wall.
    """

    points: Array
    cosines: Array
    bend: Array
    footprint: Array


def facet_reach(scene: Scene, *, slope_rms: float) -> tuple[float, float]:
    """How far along the wall facets throw the light of a pupil point, and the patch it sees, m.

    Parameters
    ----------
    scene : Scene
    slope_rms : float
        Per axis, rad.

    Returns
    -------
    reach : float
        ``(cos_i + cos_o) slope_rms d_eff`` at the chief ray, across the direction in which it is
        the larger; ``2 slope_rms d_eff`` at normal incidence.
    patch : float
        Smaller half width of the wall patch that the pupil sees, M times its radius.
    """
    chief = _optics(scene, np.zeros((1, 2)))
    throw = chief.cosines[0] * np.linalg.norm(np.linalg.inv(chief.bend[0]), 2)
    narrow = np.linalg.norm(chief.footprint[0], -2)
    return float(slope_rms * throw), float(narrow * exit_pupil(scene).entrance_radius)


def wall_view(scene: Scene, object_point: ArrayLike | None = None) -> WallView:
    """How the exit pupil of a scene sees the wall about the chief ray.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        Where the chief ray starts, world, m; by default the hidden object's reference point.

    Returns
    -------
    WallView

    Raises
    ------
    CausticError
        If the mean wall's W is undefined.

    Notes
    -----
    M is that of `pupil_slopes`, with the exit pupil's magnification taken out.
    """
    o = None if object_point is None else np.array(vector("object_point", object_point))
    return _view_of(_optics(scene, np.zeros((1, 2)), o), _zoom(scene))


def view_along(scene: Scene, zoom: float, object_point: Array, hit: Array) -> WallView:
    """`wall_view` along a chief ray that is already aimed.

    Parameters
    ----------
    scene : Scene
    zoom : float
        Size of the exit pupil over that of the lens.
    object_point : ndarray, (3,)
        World, m.
    hit : ndarray, (3,)
        Where the chief ray meets the wall, world, m.

    Returns
    -------
    WallView
    """
    return _view_of(_optics(scene, np.zeros((1, 2)), object_point, hit[None]), zoom)


def _view_of(chief: _Chief, zoom: float) -> WallView:
    return WallView(
        footprint=chief.footprint[0] / zoom,
        cos_sum=float(chief.cosines[0]),
        effective_distance=np.linalg.inv(chief.bend[0]),
    )


def _zoom(scene: Scene) -> float:
    """Exit pupil over lens: 1 but where the wall is the stop."""
    return exit_pupil(scene).image_distance / scene.image_distance


def _optics(
    scene: Scene, on_lens: Array, o: Array | None = None, points: Array | None = None
) -> _Chief:
    """First-order optics of the mean wall for points (n, 2) of the lens.

    ``o`` is the object point, by default the reference point, and ``points`` (n, 3) is where its
    rays meet the wall, if that is already known.
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
    return _Chief(points, cosines, total, np.linalg.solve(total, into))


def _wall_frames(wall: Wall, points: Array) -> tuple[Array, Array, Array]:
    """Tangents (n, 2, 3), normals (n, 3) and bends (n, 2, 2), 1/m, of the wall at its points."""
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
