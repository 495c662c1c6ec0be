"""The wave at the exit pupil from traced rays."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive
from ...errors import CausticError, SamplingError, SceneError
from ...raytrace import RayPaths
from ...raytrace.fans.paths import DETECTED, ESCAPED
from ...scene import pupil_frame
from ..wave.scattered_fits import cell_areas
from ..wave.wavefront import Removed, Wavefront
from .exit_pupil import ExitPupil

Array = NDArray[np.float64]

FEWEST: Final = 64  # detected rays
DEGREE: Final = 5  # of the polynomial through the rays about the pupil's centre
NEAREST: Final = 48  # rays that it goes through
HOLE: Final = 10.0  # times the median area of a ray, beyond which light is missing there


def wavefront_from_rays(paths: RayPaths, exit_pupil: ExitPupil, wavelength: float) -> Wavefront:
    """Wave of the rays from one object point by one reflection to the lens.

    Parameters
    ----------
    paths : RayPaths
        As of `raytrace.pupil_rays`: they start at one point, are reflected once and end in the
        plane of the lens. Those that escape beside the lens tell the density at its rim.
    exit_pupil : ExitPupil
        The lens as its own exit pupil.
    wavelength : float
        m.

    Returns
    -------
    Wavefront
        Layout "scattered", one node for each detected ray in their order. ``aberration`` is the
        path's excess over the distance from the mirrored object point, without the piston and tilt
        of the chief ray, which are in ``removed``, as in `psf.wavefront`; the defocus of a camera
        that is focused elsewhere is not in it. ``amplitude`` is the root of power per area, 1 at
        the pupil's centre. ``weights`` are the areas of the rays' Voronoi cells within the pupil;
        they add up to its area. A sum over rays is to weigh with amplitude times area, which is
        the root of the area that a ray of equal power stands for.

    Raises
    ------
    SceneError
        If the paths are not such paths, or the wall is the stop.
    SamplingError
        If there are too few rays, or light is missing in a part of the pupil.
    CausticError
        If the path lengths of neighbours contradict the rays' directions: rays cross, or are too
        few for the wall's roughness.

    Notes
    -----
    A ray's direction is the gradient of the path length, so that every ray gives W and its slopes.
    A polynomial of degree 5 through those near the centre gives W and its slopes there.
    """
    positive("wavelength", wavelength, unit="m")
    start, bounce, ends, share, n_inside = _checked(paths, exit_pupil)
    places, axes = _pupil_places(ends, bounce, exit_pupil)
    radius = exit_pupil.radius
    inside = places[:n_inside]
    farthest = float(np.hypot(*inside.T).max())
    if farthest > radius * (1 + 1e-9):
        raise SceneError(
            f"a detected ray is {farthest:.6g} m off the pupil's centre, limit {radius:.6g} m, its "
            "radius; trace with the scene of this pupil"
        )
    near = np.hypot(*places.T) < 2 * radius  # all of the detected ones, first in order
    whole, _, neighbours = cell_areas(places[near], radius)
    _, area, _ = cell_areas(inside, radius)
    _check_cover(whole[:n_inside])
    mirrored = ends[:n_inside] - start * (1.0, 1.0, -1.0)
    distance = np.linalg.norm(mirrored, axis=1)
    excess = np.asarray(paths.path_length)[paths.status == DETECTED] - distance
    onward = ends[:n_inside] - bounce[:n_inside]
    onward /= np.linalg.norm(onward, axis=1, keepdims=True)
    slopes = (onward - mirrored / distance[:, None]) @ axes[:2].T
    pairs = neighbours[(neighbours < n_inside).all(axis=1)]
    _check_agreement(inside, excess, slopes, pairs, wavelength)
    piston, tilt = _centre_terms(inside, excess, slopes)
    density = share[:n_inside] / whole[:n_inside]
    amplitude = np.sqrt(density / _centre_density(inside, density))
    return Wavefront(
        u=inside[:, 0],
        v=inside[:, 1],
        aberration=excess - piston - inside @ tilt,
        amplitude=amplitude,
        weights=area,
        wavelength=wavelength,
        image_distance=exit_pupil.image_distance,
        pupil_radius=radius,
        layout="scattered",
        removed=Removed(piston=piston, tilt=(float(tilt[0]), float(tilt[1]))),
    )


def _checked(paths: RayPaths, pupil: ExitPupil) -> tuple[Array, Array, Array, Array, int]:
    """Start, wall points and ends (n, 3), powers, and how many are detected: those come first."""
    if pupil.stop != "lens":
        raise SceneError(
            "exit_pupil.stop is the wall, whose image the rays do not reach; enlarge wall.size or "
            "use psf.wavefront"
        )
    if paths.points.ndim != 3 or paths.points.shape[1:] < (3, 3):
        raise SceneError(
            f"paths.points have shape {paths.points.shape}; keep paths of three vertices or more"
        )
    detected = np.flatnonzero(paths.status == DETECTED)
    if len(detected) < FEWEST:
        raise SamplingError(
            f"{len(detected)} rays are detected, limit {FEWEST}; launch "
            f"{max(2, -(-FEWEST // max(1, len(detected))))} times as many"
        )
    wrong = paths.n_bounces[detected] != 1
    if wrong.any():
        raise SceneError(
            f"path {detected[np.argmax(wrong)]} has {paths.n_bounces[detected][wrong][0]} bounces; "
            "a wave front is made of paths with one"
        )
    beside = np.flatnonzero((paths.status == ESCAPED) & (paths.n_bounces == 1))
    last, wall_points = paths.points[beside, -1], paths.points[beside, 1]
    beside = beside[(last != wall_points).any(axis=1)]
    order = np.concatenate([detected, beside])
    points = paths.points[order]
    start = points[0, 0]
    apart = float(np.abs(points[:, 0] - start).max())
    if apart > 0:
        raise SceneError(
            f"paths start up to {apart:.3g} m apart; a wave front has one object point, as of "
            "raytrace.pupil_rays"
        )
    return start, points[:, 1], points[:, -1], paths.weight[order], len(detected)


def _pupil_places(ends: Array, bounce: Array, pupil: ExitPupil) -> tuple[Array, Array]:
    """Coordinates (n, 2) of the ends in the pupil plane that they span, and its axes (3, 3)."""
    offsets = ends - pupil.centre
    _, _, rows = np.linalg.svd(offsets[: 8 * FEWEST], full_matrices=False)
    normal = rows[2]
    if np.mean((bounce - ends) @ normal) < 0:
        normal = -normal
    off = float(np.abs(offsets @ normal).max())
    if off > 1e-9 * max(1.0, float(np.abs(offsets).max()) / pupil.radius):
        raise SceneError(
            f"paths end up to {off:.3g} m off a plane through exit_pupil.centre; trace with the "
            "scene of this pupil"
        )
    axes = pupil_frame(normal)
    return offsets @ axes[:2].T, axes


def _check_cover(areas: Array) -> None:
    """Refuse rays that leave a part of the pupil dark."""
    median, worst = float(np.median(areas)), int(np.argmax(areas))
    if areas[worst] > HOLE * median:
        raise SamplingError(
            f"detected ray {worst} stands alone in {areas[worst]:.3g} m^2, limit {HOLE:g} times "
            f"the median {median:.3g} m^2: the wall's edge cuts the light, or rays are too few; "
            "enlarge wall.size, launch more rays, or use psf.wavefront with nodes='grid'"
        )
    if areas.min() <= 0:
        raise SceneError(
            f"detected ray {int(np.argmin(areas))} ends where another does; give each ray once"
        )


def _check_agreement(
    places: Array, excess: Array, slopes: Array, pairs: NDArray[np.int64], wavelength: float
) -> None:
    """Refuse neighbours whose path lengths and directions belong to different waves."""
    a, b = pairs.T
    step = np.sum((slopes[a] + slopes[b]) / 2 * (places[b] - places[a]), axis=1)
    miss = np.abs(excess[b] - excess[a] - step)
    worst = int(np.argmax(miss))
    if miss[worst] > wavelength / 4:
        raise CausticError(
            f"rays {a[worst]} and {b[worst]}, neighbours in the pupil, differ by "
            f"{miss[worst] / wavelength:.3g} waves from what their directions say, limit 0.25: "
            "rays cross, or are too few for this wall; launch more, or use a smoother wall"
        )


def _nearest(places: Array, count: int) -> tuple[NDArray[np.int64], float]:
    """Indices of the points nearest to the centre, and the distance of the farthest of them."""
    distance = np.hypot(*places.T)
    chosen = np.argsort(distance, kind="stable")[:count]
    return chosen, float(distance[chosen[-1]])


def _centre_terms(places: Array, excess: Array, slopes: Array) -> tuple[float, Array]:
    """W, m, and its slopes at the pupil's centre."""
    chosen, scale = _nearest(places, NEAREST)
    x, y = (places[chosen] / scale).T
    orders = [(i, k - i) for k in range(DEGREE + 1) for i in range(k, -1, -1)]
    values = np.stack([x**i * y**j for i, j in orders], axis=1)
    along_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in orders], axis=1)
    along_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in orders], axis=1)
    shift = float(excess[chosen[0]])  # what is fitted is to be small
    right = np.concatenate(
        [excess[chosen] - shift, slopes[chosen, 0] * scale, slopes[chosen, 1] * scale]
    )
    fit = np.linalg.lstsq(np.concatenate([values, along_x, along_y]), right, rcond=None)[0]
    return float(fit[0]) + shift, fit[1:3] / scale


def _centre_density(places: Array, density: Array) -> float:
    """Power per area at the pupil's centre, by a quadratic through the rays about it."""
    chosen, scale = _nearest(places, NEAREST)
    x, y = (places[chosen] / scale).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return float(np.linalg.lstsq(terms, density[chosen], rcond=None)[0][0])
