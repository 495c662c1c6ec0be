"""Waves from a wall of random facets: tilts on the wall become slopes in the pupil."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import vector
from .._nouns import Noun
from ..errors import CausticError, SamplingError, SceneError
from ..raytrace import facet_angles
from ..raytrace.facets import material_slope
from ..scene import Scene, Wall
from .aberration import wavefront
from .aiming import aim, pupil_points
from .pupils import exit_pupil
from .slopes import integrated_slopes
from .wavefronts import Wavefront

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


def facet_wavefront(
    scene: Scene,
    *,
    cell: float,
    slope_rms: float | None = None,
    samples: int = 256,
    seed: int = 0,
) -> tuple[Wavefront, float]:
    """Wave of a wall with a random facet on each of its cells, on a pupil grid.

    Parameters
    ----------
    scene : Scene
        Its wall is the mean one.
    cell : float
        Side of a facet's cell, m.
    slope_rms : float, optional
        Of the facets per axis, rad; by default that of the wall material's strongest lobe that has
        one.
    samples : int
        Cells of the pupil grid per side.
    seed : int
        Of `raytrace.facet_angles`.

    Returns
    -------
    wavefront : Wavefront
        The mean wall's, as of `psf.wavefront`, plus the least-squares wave of the facets' slopes;
        the tilt of the latter is left in.
    curl_residual_rms : float
        rms of the facets' pupil slopes that no wave has, rad; see `wavefront_from_slopes`.

    Raises
    ------
    CausticError
        If the facets throw light past their neighbours, so that W is undefined; or as of
        `psf.wavefront`.
    SamplingError
        If the pupil grid steps over cells.

    Notes
    -----
    A facet of slope s shows a pupil point ``(cos_i + cos_o) s d_eff`` away from the wall point
    that the mean wall shows it, `facet_reach`. Once that passes a cell, several facets or none
    send their light to a pupil point, and once it passes the patch nothing of the mean wave is
    left: then W is undefined. The wave of such slopes may still be wanted as a model: it is what
    `raytrace.facet_angles`, `pupil_slopes` and `wavefront_from_slopes` return one by one.
    """
    if slope_rms is None:
        slope_rms = material_slope(scene)
    slopes, positions = facet_angles(scene, cell=cell, slope_rms=slope_rms, seed=seed)
    reach, patch = facet_reach(scene, slope_rms=slope_rms)
    limit = min(float(cell), patch)
    if reach > limit:
        what = "one cell" if cell <= patch else "the patch that the pupil sees"
        raise CausticError(
            f"facets of slope rms {slope_rms:.3g} rad throw light {reach:.3g} m along the wall, "
            f"limit {limit:.3g} m ({what}), {reach / limit:.3g} times too far: W is undefined; use "
            f"a slope_rms of at most {slope_rms * limit / reach:.3g} rad or rays instead of waves"
        )
    mean = wavefront(scene, nodes="grid", samples=samples)
    # cells beside the disc may have a share of rounding's size
    mask = mean.weights > 1e-12 * mean.pupil_pitch**2
    nodes = np.stack([mean.u[mask], mean.v[mask]], axis=1)
    zoom = _zoom(scene)
    step = mean.pupil_pitch / abs(zoom)
    step *= float(np.linalg.norm(_optics(scene, np.zeros((1, 2))).footprint[0], 2))
    if step > cell:
        raise SamplingError(
            f"neighbours of {samples} x {samples} pupil samples see the wall {step:.3g} m apart, "
            f"limit cell = {cell:.3g} m; use {int(np.ceil(samples * step / cell)) + 1} samples"
        )
    table = np.zeros((*mask.shape, 2))
    table[mask] = pupil_slopes(scene, slopes, positions, nodes)
    rough, residual = integrated_slopes(table, mean.pupil_pitch, mask)
    return replace(mean, aberration=mean.aberration + rough), residual


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


def pupil_slopes(scene: Scene, slopes: ArrayLike, positions: ArrayLike, nodes: ArrayLike) -> Array:
    """Slopes of the wave at fixed pupil points from the tilts of the wall's facets.

    Parameters
    ----------
    scene : Scene
    slopes : array_like, (ny, nx, 2)
        Facet slopes against the mean wall, as of `raytrace.facet_angles`.
    positions : array_like, (ny, nx, 3)
        Centres of the cells, world, m.
    nodes : array_like, (n, 2)
        Points (u, v) of the exit pupil, m.

    Returns
    -------
    ndarray, (n, 2)
        What the facets add to dW/du and dW/dv, rad, in first order of their slopes.

    Raises
    ------
    SamplingError
        If a node sees the wall beyond the cells.
    CausticError
        If the mean wall's W is undefined.

    Notes
    -----
    ``grad_p W = -(cos_i + cos_o) M^T grad h`` with
    ``M = [P_i/d1 + P_o/d2 - (cos_i + cos_o) K]^-1 E/d2``: the pupil point p sees the wall point
    M p. P projects along the two legs, K is the mean wall's bend (positive hollow to the room) and
    E takes the pupil's axes into the wall across the ray.
    """
    table, x, y = _lattice(slopes, positions)
    points = np.asarray(nodes, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise SceneError(f"nodes have shape {points.shape}; give (n, 2) finite u and v in m")
    zoom = _zoom(scene)
    seen = _optics(scene, points / zoom)
    columns, rows = (_cell_index(axis, seen.points[:, k]) for k, axis in enumerate((x, y)))
    outside = (columns < 0) | (columns >= len(x)) | (rows < 0) | (rows >= len(y))
    if outside.any():
        i = int(np.argmax(outside))
        raise SamplingError(
            f"pupil node {i} sees the wall at x = {seen.points[i, 0]:.6g} m, y = "
            f"{seen.points[i, 1]:.6g} m, beyond the cells (x from {x[0]:.6g} to {x[-1]:.6g} m, y "
            f"from {y[0]:.6g} to {y[-1]:.6g} m); give facets over all that the pupil sees"
        )
    tilt = table[rows, columns]
    found = -seen.cosines[:, None] * np.einsum("nba,nb->na", seen.footprint, tilt)
    return np.asarray(found / zoom)


def _zoom(scene: Scene) -> float:
    """Exit pupil over lens: 1 but where the wall is the stop."""
    return exit_pupil(scene).image_distance / scene.image_distance


def _lattice(slopes: ArrayLike, positions: ArrayLike) -> tuple[Array, Array, Array]:
    """Checked slopes and the coordinates of the cells' columns and rows, m."""
    table, places = np.asarray(slopes, np.float64), np.asarray(positions, np.float64)
    if table.ndim != 3 or table.shape[2] != 2 or places.shape != (*table.shape[:2], 3):
        raise SceneError(
            f"slopes have shape {table.shape} and positions {places.shape}; give (ny, nx, 2) and "
            "(ny, nx, 3)"
        )
    if min(table.shape[:2]) < 2:
        raise SceneError(f"slopes have shape {table.shape}; give two cells or more each way")
    if not (np.isfinite(table).all() and np.isfinite(places).all()):
        raise SceneError("slopes or positions hold NaN or infinity; give finite facets")
    x, y = places[0, :, 0], places[:, 0, 1]
    for axis, found in ((x, places[..., 0]), (y[:, None], places[..., 1])):
        step = (axis.ravel()[-1] - axis.ravel()[0]) / (axis.size - 1)
        even = axis.ravel()[0] + step * np.arange(axis.size)
        error = max(float(np.abs(found - axis).max()), float(np.abs(axis.ravel() - even).max()))
        if not (step > 0 and error <= 1e-6 * step):
            raise SceneError(
                f"positions are {error:.3g} m off a lattice of {step:.3g} m; take them from "
                "raytrace.facet_angles"
            )
    return table, x, y


def _cell_index(centres: Array, at: Array) -> NDArray[np.int64]:
    """Index of the cell that holds each coordinate; beyond the ends for those outside."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    return np.asarray(np.floor((at - centres[0]) / step + 0.5), dtype=np.int64)


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
