"""Fan of rays from one object point via the mirroring wall to the lens."""

from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import expect, fits_memory, vector, whole
from ..._random import checked_seed, philox
from ...scene import Scene
from ...scene.parts.camera import pupil_frame
from ..intersection.intersections import intersect
from .footprints import lens_footprint, lens_plane, reflected
from .paths import DETECTED, ESCAPED, LEFT, RayPaths

Array = NDArray[np.float64]


def pupil_rays(
    scene: Scene, *, object_point: ArrayLike | None = None, n_rays: int, seed: int = 0
) -> RayPaths:
    """Trace a fan of rays from one object point via the mirroring wall to the lens.

    The wall is treated as a perfect mirror that has the wall's shape. The rays sample the pupil
    evenly, for example for a spot diagram or to compute the wave.

    Parameters
    ----------
    scene : Scene
        Scene with a smooth wall or a height map. The wall's material and ``wall_roughness`` are
        ignored; to include the roughness, pass ``scene.with_relief()``.
    object_point : array_like, (3,), optional
        Object point, world frame (origin at the centre of the relay wall, z toward the room, y up),
        m. By default the centre of the hidden image, or the centroid of the hidden mesh.
    n_rays : int
        Number of rays, at least 16.
    seed : int
        Seed of the random shift of the regular pattern of ray directions, 0 to 2^64 - 1.

    Returns
    -------
    RayPaths
        ``points`` (n_rays, 3, 3): object point, wall point, point in the plane of the lens. A ray
        that misses the wall, or is not reflected toward the lens, repeats its last vertex.
        ``status``: 0 for rays through the lens, 3 for rays that would meet the wall again, 1 for
        all others. ``weight``: power of each ray, W, for a point source of 1 W/sr, without losses
        at wall and lens. ``standard_error`` is that of independent random rays; the error of this
        regular fan is smaller.

    Raises
    ------
    SceneError
        If a value is out of range, or no light from the point is reflected into the lens.
    MemoryLimitError
        If the rays would not fit in memory.

    See Also
    --------
    trace_point : Light of one object point to the detector.
    nlosoptics.psf.wavefront_from_rays : Wave from traced ray paths.
    nlosoptics.psf.spot_diagram : Points at which rays meet the image plane.

    Notes
    -----
    The fan covers all light from the point to the lens, plus a margin. Its directions form a rank-1
    lattice (a regular set of points) in Lambert's equal-area projection about the fan's axis, so
    that every ray represents the same solid angle. A smooth wall maps them to a smoothly distorted
    lattice on the lens.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> rays = raytrace.pupil_rays(scene, n_rays=1024, seed=0)
    >>> rays.points.shape, sorted({int(status) for status in rays.status})
    ((1024, 3, 3), [0, 1])
    >>> round(rays.mean_path_length, 2)
    2.05
    """
    scene = expect("scene", scene, "Scene")
    o = scene.object_point
    if object_point is not None:
        o = np.array(vector("object_point", object_point))
    n_rays = whole("n_rays", n_rays, 16)
    fits_memory(f"{n_rays} rays", 400.0 * n_rays, "launch fewer")
    directions, solid_angle = _fan(scene, o, n_rays, checked_seed(seed))
    points = np.repeat(o[None, None], 3, axis=1).repeat(n_rays, axis=0)
    n_bounces = np.zeros(n_rays, dtype=np.int32)
    status = np.full(n_rays, ESCAPED, dtype=np.int8)
    path_length = np.zeros(n_rays)
    hits = intersect(scene.wall, o, directions)
    met = np.flatnonzero(hits.hit)
    wall_points, normals = hits.points[met], hits.normals[met]
    onward = reflected(directions[met], normals)
    ends, reach = lens_plane(wall_points, onward, scene.camera)
    points[met, 1:] = wall_points[:, None]
    path_length[met], n_bounces[met] = hits.distance[met], 1
    again = _met_again(scene, wall_points + 1e-9 * normals, onward, reach)
    status[met[again]] = LEFT
    arrived = ~np.isnan(reach) & ~again
    points[met[arrived], 2] = ends[arrived]
    path_length[met[arrived]] += reach[arrived]
    across = np.linalg.norm(ends[arrived] - np.array(scene.camera.position), axis=1)
    status[met[arrived]] = np.where(across <= scene.camera.stop_diameter / 2, DETECTED, ESCAPED)
    return _with_ledger(points, path_length, n_bounces, status, solid_angle)


def _fan(scene: Scene, o: Array, n_rays: int, seed: int) -> tuple[Array, float]:
    """Return unit directions (n_rays, 3) that fill the lens via the wall, and their solid angle."""
    toward = lens_footprint(scene.wall, o, scene.camera).points - o
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    axis = toward.mean(axis=0)
    axis /= np.linalg.norm(axis)
    e1, e2, _ = pupil_frame(axis)
    # Lambert's equal-area projection: radius 2 sin(theta/2) for the angle theta to the axis
    flat = np.stack([toward @ e1, toward @ e2], axis=1)
    flat *= np.sqrt(2 / (1 + toward @ axis))[:, None]
    low, high = flat.min(axis=0), flat.max(axis=0)
    # at least 1.5 ray spacings outside the lens, so that rays at its rim have neighbours
    margin = max(0.05, 1.5 / (math.sqrt(n_rays) - 3))
    width = (1 + 2 * margin) * (high - low)
    middle = (low + high) / 2
    # the projection ends at radius 2, the backward direction
    width = np.minimum(width, 2 * (1.4 - np.abs(middle)))
    places = middle + (_lattice(n_rays, seed) - 0.5) * width
    square = np.sum(places**2, axis=1)
    directions = (np.sqrt(1 - square / 4)[:, None] * places) @ np.stack([e1, e2])
    directions += (1 - square / 2)[:, None] * axis
    return directions, float(width.prod())


def _lattice(n: int, seed: int) -> Array:
    """Return the points (n, 2) of a rank-1 lattice in the unit square with a random shift."""
    near = round(n / ((1 + math.sqrt(5)) / 2))
    best, generator = -1.0, 1
    multiple = np.arange(1, min(n, 4 * math.isqrt(n) + 2))
    for candidate in range(max(1, near - 16), min(n, near + 17)):
        if math.gcd(candidate, n) != 1:
            continue
        x = multiple / n
        y = (multiple * candidate % n) / n
        shortest = float((x**2 + np.minimum(y, 1 - y) ** 2).min())
        if shortest > best:
            best, generator = shortest, candidate
    words = philox(np.array([0, 0, 0, 402], dtype=np.uint32), seed)
    index = np.arange(n, dtype=np.int64)
    places = np.stack([index / n, (index * generator % n) / n], axis=1)
    return np.asarray((places + words[:2] / 2.0**32) % 1.0)


def _met_again(scene: Scene, starts: Array, directions: Array, reach: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rays that hit the wall a second time before the lens plane."""
    if scene.wall.is_flat or not len(starts):
        return np.zeros(len(starts), dtype=bool)
    second = intersect(scene.wall, starts, directions)
    far = np.where(np.isnan(reach), np.inf, reach)
    distance = np.where(second.hit, second.distance, np.inf)
    return np.asarray(distance < far)


def _with_ledger(
    points: Array,
    path_length: Array,
    n_bounces: NDArray[np.int32],
    status: NDArray[np.int8],
    solid_angle: float,
) -> RayPaths:
    """Return `RayPaths` with the power balance of an isotropic source of 1 W/sr."""
    n = len(status)
    names = ("detected", "escaped", "absorbed", "left")
    counts = np.bincount(status, minlength=len(names))
    share = counts / n
    errors = solid_angle * np.sqrt(share * (1 - share) / n)
    flux = float(solid_angle * share[DETECTED])
    named = {name: k for k, name in enumerate(names) if counts[k]}
    detected = status == DETECTED
    error = float(errors[DETECTED])
    return RayPaths(
        points=points,
        path_length=path_length,
        weight=np.full(n, solid_angle / n),
        n_bounces=n_bounces,
        status=status,
        ledger=MappingProxyType({k: float(solid_angle * share[i]) for k, i in named.items()}),
        ledger_error=MappingProxyType({k: float(errors[i]) for k, i in named.items()}),
        flux=flux,
        standard_error=error,
        by_bounce=np.array([0.0, flux]),
        by_bounce_error=np.array([0.0, error]),
        mean_path_length=float(path_length[detected].mean()) if detected.any() else 0.0,
        n_rays=n,
    )
