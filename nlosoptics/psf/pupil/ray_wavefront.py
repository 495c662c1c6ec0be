"""The wave in the exit pupil, computed from traced rays."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, expect, positive
from ..._vectors import Array
from ...errors import CausticError, SamplingError, SceneError
from ...raytrace import RayPaths
from ...raytrace.fans.paths import DETECTED, ESCAPED
from ...scene.parts.camera import pupil_frame
from ..wave.removed import Removed
from ..wave.scattered_fits import cell_areas
from ..wave.wavefront import Wavefront
from .exit_pupil import ExitPupil

#: Least number of detected rays.
FEWEST: Final = 64


def wavefront_from_rays(paths: RayPaths, exit_pupil: ExitPupil, wavelength: float) -> Wavefront:
    """Compute the wave in the exit pupil from traced rays of one object point.

    Parameters
    ----------
    paths : RayPaths
        Traced rays, such as those of `raytrace.pupil_rays`. All start at one point, are reflected
        once at the wall and end in the plane of the lens. Rays that pass beside the lens are used,
        too: they show the density of rays at the rim.
    exit_pupil : ExitPupil
        Exit pupil of the scene, from `exit_pupil`; the lens must be the stop.
    wavelength : float
        Vacuum wavelength, m.

    Returns
    -------
    Wavefront
        Wave with ``layout`` = "scattered" (arbitrary sample points, see `Wavefront`), with one
        sample point for each ray that meets the lens, in the order of the rays. The aberration is a
        path length minus a reference length. The path length is that of the ray, from the object
        point to the lens. The reference length is the straight distance from the mirror image of
        the object point to the same point of the lens. The mirror is the plane z = 0, which is the
        mean plane of the wall. Piston and tilt of the chief ray are subtracted and reported in
        ``removed``. The amplitude is the square root of power per area, 1 at the pupil's centre.

    Raises
    ------
    SceneError
        If the rays do not start at one point, are not reflected exactly once or do not end in the
        plane of the lens; if two rays end at one point; or if the wall is the stop.
    SamplingError
        If fewer than 64 rays meet the lens, or none meets a part of it.
    CausticError
        If the path lengths of neighbouring rays contradict the rays' directions: rays cross, or
        there are too few for the wall's roughness.

    See Also
    --------
    wavefront : Wave of a scene, by rays aimed at given pupil points.

    Notes
    -----
    The direction of a ray is the gradient of the path length. Every ray therefore gives the
    aberration W and its slopes. A polynomial of degree 5 is fitted to both near the pupil's centre;
    its value and slopes there are the piston and tilt that are subtracted.

    The area that a ray represents (``weights``) is that of its Voronoi cell inside the pupil. The
    defocus of a camera that is focused on another plane than the mirrored object is not included.
    """
    paths = expect("paths", paths, "RayPaths")
    positive("wavelength", wavelength, unit="m")
    start, bounce, ends, share, n_inside = _checked(paths, exit_pupil)
    places, axes = _pupil_places(ends, bounce, exit_pupil)
    radius = exit_pupil.radius
    inside = places[:n_inside]
    farthest = float(np.hypot(*inside.T).max())
    if farthest > radius * (1 + 1e-9):
        raise SceneError(
            f"a detected ray is {farthest:.6g} m from exit_pupil.centre, limit {radius:.6g} m, its "
            "radius; trace the rays with the scene of this pupil"
        )
    near = np.hypot(*places.T) < 2 * radius  # contains all detected rays, which come first
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
    """Check paths and return their start (3,), wall points and ends (n, 3), and powers (n,).

    The last result is the number of detected rays, which come first.
    """
    if pupil.stop != "lens":
        raise SceneError(
            "exit_pupil.stop is the wall, but the rays end on the lens; enlarge wall.size or use "
            "psf.wavefront"
        )
    if paths.points.ndim != 3 or paths.points.shape[1:] < (3, 3):
        raise SceneError(
            f"paths.points have shape {paths.points.shape}; keep paths of three vertices or more"
        )
    detected = np.flatnonzero(paths.status == DETECTED)
    if len(detected) < FEWEST:
        raise SamplingError(
            f"paths holds {counted(len(detected), 'detected ray')}, limit {FEWEST}; launch "
            f"{max(2, -(-FEWEST // max(1, len(detected))))} times as many"
        )
    wrong = paths.n_bounces[detected] != 1
    if wrong.any():
        raise SceneError(
            f"path {detected[np.argmax(wrong)]} has {paths.n_bounces[detected][wrong][0]} bounces, "
            "limit 1; give paths with one reflection, as raytrace.pupil_rays"
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
            f"paths start up to {apart:.3g} m apart, limit 0; give paths from one object point, as "
            "raytrace.pupil_rays"
        )
    return start, points[:, 1], points[:, -1], paths.weight[order], len(detected)


def _pupil_places(ends: Array, bounce: Array, pupil: ExitPupil) -> tuple[Array, Array]:
    """Coordinates (n, 2), m, of the paths' ends in the plane that they span, and its axes (3, 3).

    The axes are two in the plane and its normal, which points toward the wall.
    """
    offsets = ends - pupil.centre
    _, _, rows = np.linalg.svd(offsets[: 8 * FEWEST], full_matrices=False)
    normal = rows[2]
    if np.mean((bounce - ends) @ normal) < 0:
        normal = -normal
    off = float(np.abs(offsets @ normal).max())
    if off > 1e-9 * max(1.0, float(np.abs(offsets).max()) / pupil.radius):
        raise SceneError(
            f"paths end up to {off:.3g} m off a plane through exit_pupil.centre; trace the rays "
            "with the scene of this pupil"
        )
    axes = pupil_frame(normal)
    return offsets @ axes[:2].T, axes


def _check_cover(areas: Array) -> None:
    """Raise an error if a part of the pupil has no rays, or two rays end at one point."""
    median, worst = float(np.median(areas)), int(np.argmax(areas))
    if areas[worst] > 10 * median:
        raise SamplingError(
            f"detected ray {worst} is the only one in {areas[worst]:.3g} m^2, limit 10 times "
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
    """Raise `CausticError` if path lengths and directions of neighbouring rays disagree."""
    a, b = pairs.T
    step = np.sum((slopes[a] + slopes[b]) / 2 * (places[b] - places[a]), axis=1)
    miss = np.abs(excess[b] - excess[a] - step)
    worst = int(np.argmax(miss))
    if miss[worst] > wavelength / 4:
        raise CausticError(
            f"path lengths of rays {a[worst]} and {b[worst]}, neighbours in the pupil, differ by "
            f"{miss[worst] / wavelength:.3g} waves from the prediction of their directions, limit "
            "0.25: rays cross, or are too few for this wall; launch more, or use a smoother wall"
        )


def _nearest(places: Array, count: int) -> tuple[NDArray[np.int64], float]:
    """Indices of the points nearest to the pupil's centre, and the largest of their distances."""
    distance = np.hypot(*places.T)
    chosen = np.argsort(distance, kind="stable")[:count]
    return chosen, float(distance[chosen[-1]])


def _centre_terms(places: Array, excess: Array, slopes: Array) -> tuple[float, Array]:
    """W, m, and its slopes (2,) at the pupil's centre, from a polynomial fit."""
    chosen, scale = _nearest(places, 48)
    x, y = (places[chosen] / scale).T
    orders = [(i, k - i) for k in range(6) for i in range(k, -1, -1)]
    values = np.stack([x**i * y**j for i, j in orders], axis=1)
    along_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in orders], axis=1)
    along_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in orders], axis=1)
    shift = float(excess[chosen[0]])  # subtracted so that the fitted values are small
    right = np.concatenate(
        [excess[chosen] - shift, slopes[chosen, 0] * scale, slopes[chosen, 1] * scale]
    )
    fit = np.linalg.lstsq(np.concatenate([values, along_x, along_y]), right, rcond=None)[0]
    return float(fit[0]) + shift, fit[1:3] / scale


def _centre_density(places: Array, density: Array) -> float:
    """Power per area at the pupil's centre, from a quadratic fit to the nearest rays."""
    chosen, scale = _nearest(places, 48)
    x, y = (places[chosen] / scale).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return float(np.linalg.lstsq(terms, density[chosen], rcond=None)[0][0])
