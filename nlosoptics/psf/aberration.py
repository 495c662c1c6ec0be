"""Wave aberration of the relay wall used as a mirror, by aiming."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import one_of, real, vector
from ..errors import CausticError, NotWaveGradeError, SamplingError, SceneError
from ..scene import MeshWall, Scene, Wall, pupil_frame
from ..scene.height_maps import CallableWall
from .nodes import grid_nodes, polar_nodes
from .pupils import exit_pupil
from .wavefronts import Layout, Removed, Wavefront

Array = NDArray[np.float64]
POLAR_SAMPLES = (24, 96)
GRID_SAMPLES = 256


@dataclass(frozen=True, eq=False, kw_only=True)
class AimedRays:
    """Stationary paths from an object point by the wall to pupil points.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Where the paths meet the wall, world, m.
    excess : ndarray, (n,)
        Path length over the distance from the mirrored object point, m.
    spreading : ndarray, (n,)
        Flux on the pupil plane per unit radiant intensity, 1/m^2.
    determinant : ndarray, (n,)
        Of the path's Hessian over (x, y), 1/m^2; it vanishes on a caustic.
    """

    points: Array
    excess: Array
    spreading: Array
    determinant: Array


def aim(wall: Wall, object_point: ArrayLike, nodes: Array, axis: Array) -> AimedRays:
    """Find the path from an object point by the wall to each pupil node.

    Parameters
    ----------
    wall : Wall
    object_point : array_like, (3,)
        World, m, in front of the wall.
    nodes : ndarray, (n, 3)
        Pupil points, world, m, in front of the wall.
    axis : ndarray, (3,)
        Unit normal of the pupil plane.

    Returns
    -------
    AimedRays

    Raises
    ------
    CausticError
        If a node is reached by several rays or by none, or the rays of the pupil have crossed.
    """
    o = np.array(vector("object_point", object_point))
    for name, height in (("object_point", o[2]), ("pupil", float(nodes[:, 2].min()))):
        if height <= 0:
            raise SceneError(f"{name} has z = {height:g} m, behind the wall; must be above 0")
    share = o[2] / (o[2] + nodes[:, 2])
    mirror_hits = o + share[:, None] * (nodes - o)
    if wall.is_flat:
        legs = np.linalg.norm(nodes - o * (1, 1, -1), axis=1)
        cosine = abs((nodes - o * (1, 1, -1)) @ axis) / legs
        mirror_hits[:, 2] = 0.0
        return AimedRays(
            points=mirror_hits,
            excess=np.zeros(len(nodes)),
            spreading=cosine / legs**2,
            determinant=np.ones(len(nodes)),
        )
    from . import _kernels, callable_aiming

    out = np.empty((len(nodes), _kernels.N_COLUMNS))
    nodes, starts = np.ascontiguousarray(nodes), mirror_hits[:, :2].copy()
    if isinstance(wall, CallableWall):
        callable_aiming.aim(wall, o, nodes, starts, axis, out)
    else:
        _kernels.aim(*wall._terms(), o, nodes, starts, axis, out)
    lost = out[:, 7] != _kernels.FOUND
    if lost.any():
        raise CausticError(
            f"{int(lost.sum())} of {len(nodes)} pupil nodes are reached by no single ray by the "
            f"wall, first node {int(np.argmax(lost))}; use a flatter wall or other distances"
        )
    curvature = out[:, 6]
    if out[:, 5].min() < 0 < out[:, 5].max() or curvature.min() < 0 < curvature.max():
        raise CausticError(
            f"the rays of the pupil cross on a caustic (the path's smaller curvature runs from "
            f"{curvature.min():.3g} to {curvature.max():.3g} 1/m); use a flatter wall, a smaller "
            "stop, or distances away from its focus"
        )
    _refuse_several_paths(wall, o, nodes, out)
    return AimedRays(
        points=out[:, :3], excess=out[:, 3], spreading=out[:, 4], determinant=out[:, 5]
    )


def _refuse_several_paths(wall: Wall, o: Array, nodes: Array, aimed: Array) -> None:
    """Search for further stationary points where the wall bends enough to have them."""
    first = aimed[0]
    d1 = float(np.linalg.norm(first[:3] - o))
    d2 = float(np.linalg.norm(first[:3] - nodes[0]))
    cosines = (o[2] / d1, float(nodes[0, 2]) / d2)
    # a wall flatter than this leaves the path convex, and a convex path has one minimum
    least = cosines[0] ** 2 / d1 + cosines[1] ** 2 / d2
    if sum(cosines) * wall.max_curvature < 0.8 * least:
        return
    from . import _kernels

    reach = 2 * math.hypot(o[0] - nodes[0, 0], o[1] - nodes[0, 1]) + o[2] + float(nodes[0, 2])
    if math.isfinite(wall.finest_period):
        slope = wall.max_curvature * wall.finest_period / (2 * math.pi)
        reach = min(reach, 4 * slope * d1 * d2 / (d1 + d2) + 2 * wall.finest_period)
    n_starts = int(min(129, max(9, 2 * math.ceil(4 * reach / wall.finest_period) + 1)))
    offsets = np.linspace(-reach, reach, n_starts)
    for node in (0, len(nodes) - 1):
        centre = aimed[node, :2]
        around = centre + np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        for x, y, status in _stationary_points(wall, o, nodes[node], around, 1.0):
            apart = math.hypot(x - centre[0], y - centre[1])
            if status == _kernels.FOUND and apart > 1e-6 and bool(wall.contains(x, y)):
                raise CausticError(
                    f"the wall shows the object more than once: light also arrives from "
                    f"x = {x:.4g} m, y = {y:.4g} m beside x = {centre[0]:.4g} m, "
                    f"y = {centre[1]:.4g} m; use a flatter wall or rays instead of waves"
                )


def _stationary_points(
    wall: Wall, o: Array, p: Array, starts: Array, side: float
) -> Iterator[tuple[float, float, int]]:
    """Stationary wall points (x, y, status) of the path from O to p, from several starts."""
    from . import _kernels, callable_aiming

    if isinstance(wall, CallableWall):
        targets = np.broadcast_to(p, (len(starts), 3)).copy()
        points, status = callable_aiming.stationary_points(wall, o, targets, starts, side)
        yield from zip(points[:, 0].tolist(), points[:, 1].tolist(), status.tolist(), strict=True)
        return
    terms, tables = wall._terms()
    for x, y in starts:
        yield _kernels.stationary_point(terms, tables, o, p, x, y, side)


def _check_nodes(nodes: Array) -> None:
    if nodes.ndim != 2 or nodes.shape[1] != 2:
        raise SceneError(f"nodes have shape {nodes.shape}; give (n, 2), u and v in m")
    if not np.isfinite(nodes).all():
        raise SceneError("nodes hold NaN or infinity; give finite pupil coordinates in m")


def _pupil_points(centre: ArrayLike, axis: Array, nodes: Array) -> Array:
    """World coordinates of pupil nodes (n, 2) in the plane through ``centre`` across ``axis``."""
    e1, e2, _ = pupil_frame(axis)
    return np.asarray(np.asarray(centre) + nodes[:, :1] * e1 + nodes[:, 1:] * e2)


def wall_aberration(
    wall: Wall,
    object_point: ArrayLike,
    pupil_centre: ArrayLike,
    pupil_aim: ArrayLike,
    nodes: ArrayLike,
) -> Array:
    """Wave aberration of a wall used as a mirror, against the mirrored object point.

    Parameters
    ----------
    wall : Wall
    object_point, pupil_centre, pupil_aim : array_like, (3,)
        World, m. The pupil plane passes through ``pupil_centre`` across the direction to
        ``pupil_aim``.
    nodes : array_like, (n, 2)
        Pupil coordinates (u, v), m, along ``e1 = unit(Y x n)`` and ``e2 = n x e1``, n toward
        ``pupil_aim``, Y = (0, 1, 0) (X where n is parallel to Y).

    Returns
    -------
    ndarray, (n,)
        W, m, positive for a longer path; 0 at (0, 0).

    Raises
    ------
    CausticError
        If W has several values or none.
    NotWaveGradeError
        If the wall is a mesh that does not follow one smooth surface.

    Notes
    -----
    ``W = [|O-H| + |H-p| - |O'-p|](p) - [same](0)`` with H the stationary (Fermat) wall point and
    O' the mirror image of O in z = 0; differences of lengths are taken as
    ``(a^2 - b^2)/(a + b)``, so that W keeps about 1e-17 m.
    """
    centre = np.array(vector("pupil_centre", pupil_centre))
    axis = np.array(vector("pupil_aim", pupil_aim)) - centre
    if not axis.any():
        raise SceneError("pupil_aim equals pupil_centre; aim at a point of the wall")
    axis /= np.linalg.norm(axis)
    flat_nodes = np.asarray(nodes, dtype=np.float64)
    _check_nodes(flat_nodes)
    with_centre = np.concatenate([np.zeros((1, 2)), flat_nodes])
    rays = aim(wall, object_point, _pupil_points(centre, axis, with_centre), axis)
    return np.asarray(rays.excess[1:] - rays.excess[0])


def path_difference(
    wall: Wall,
    source: ArrayLike,
    target: ArrayLike,
    reference: float,
    *,
    wall_point: ArrayLike | None = None,
) -> float:
    """Length of the path source - wall - target minus a reference length.

    Parameters
    ----------
    wall : Wall
    source, target : array_like, (3,)
        World, m. A target behind the wall is a virtual image: its leg counts negative.
    reference : float
        Signed reference length, m.
    wall_point : array_like, (2,), optional
        (x, y) of the wall point, m; by default the stationary (Fermat) one.

    Returns
    -------
    float
        m, carried in twice the working precision and rounded once.

    Raises
    ------
    CausticError
        If no stationary path is found.
    """
    from . import _kernels

    o, p = np.array(vector("source", source)), np.array(vector("target", target))
    reference = real("reference", reference)
    if wall_point is None:
        z = abs(p[2])
        share = o[2] / (o[2] + z) if o[2] + z > 0 else 0.0
        x, y = (o + share * (p - o))[:2]
        side = 1.0 if p[2] >= float(wall.height(x, y)) else -1.0
        if wall.is_flat and side < 0:
            raise CausticError("a virtual target of a flat wall has no single stationary path")
        if not wall.is_flat:
            start = np.array([[x, y]])
            x, y, status = next(_stationary_points(wall, o, p, start, side))
            if status != _kernels.FOUND:
                raise CausticError(
                    f"no stationary path from {source!r} by the wall to {target!r}; "
                    "give wall_point, or other points"
                )
    else:
        x, y = (real("wall_point", c) for c in np.asarray(wall_point, dtype=np.float64)[:2])
    height = float(wall.height(x, y))
    side = 1.0 if p[2] >= height else -1.0
    hit = np.array([x, y, height])
    return float(_kernels.path_difference(o, hit, p, side, reference))


def wavefront(
    scene: Scene,
    object_point: ArrayLike | None = None,
    nodes: str | ArrayLike = "polar",
    *,
    samples: Any = None,
    reference: str = "mirror_image",
) -> Wavefront:
    """Wave at the exit pupil from one object point by the relay wall.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        World, m; by default the hidden object's reference point.
    nodes : {"polar", "grid"} or array_like (n, 2)
        Pupil nodes; an array holds (u, v) in the exit pupil, m.
    samples : (int, int) or int, optional
        Radii and angles of polar nodes (default 24, 96); side of a grid (default 256).
    reference : {"mirror_image", "best_focus"}
        Remove the chief ray's piston and tilt, which shift the image exactly; or fit and remove
        defocus as well. ``removed`` reports them.

    Returns
    -------
    Wavefront
        In exit-pupil coordinates, parallel to the image's axes.

    Raises
    ------
    CausticError, NotWaveGradeError
        Where W is undefined or the wall is not known well enough.
    SamplingError
        If the wall's edge cuts the pupil and polar nodes are asked for.

    Notes
    -----
    The amplitude follows the spreading of ray tubes, 1/sqrt(J), from the van Vleck determinant of
    the path. A camera focused elsewhere than on the mirrored object adds its defocus.
    """
    one_of("reference", reference, ("mirror_image", "best_focus"))
    wavelength = scene.laser.wavelength
    _check_wave_grade(scene.wall, wavelength)
    o = (
        scene.object_point
        if object_point is None
        else np.array(vector("object_point", object_point))
    )
    pupil = exit_pupil(scene)
    radius = pupil.radius
    layout: Layout = "scattered"
    if isinstance(nodes, str):
        if nodes not in ("polar", "grid"):
            raise SceneError(f"nodes = {nodes!r} is unknown, must be polar, grid or (n, 2) numbers")
        layout = "polar" if nodes == "polar" else "grid"
    if layout == "polar":
        u, v, weights = polar_nodes(radius, *(samples or POLAR_SAMPLES))
    elif layout == "grid":
        u, v, weights = grid_nodes(radius, samples or GRID_SAMPLES)
    else:
        points = np.asarray(nodes, dtype=np.float64)
        _check_nodes(points)
        u, v = points[:, 0].copy(), points[:, 1].copy()
        weights = np.full(len(u), math.pi * radius**2 / len(u))

    # the lens is the exit pupil, or the cone from the image through it, inverted if behind
    zoom = pupil.image_distance / scene.image_distance
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    flat = np.stack([np.append(0.0, u), np.append(0.0, v)], axis=1) / zoom
    points = _pupil_points(centre, axis, flat)
    rays = aim(scene.wall, o, points, axis)
    aberration = rays.excess[1:] - rays.excess[0] + _defocus(scene, o, flat[1:])
    amplitude = np.sqrt(rays.spreading[1:] / rays.spreading[0])
    if pupil.stop == "lens":
        inside = scene.wall.contains(rays.points[1:, 0], rays.points[1:, 1])
        if layout == "polar" and not inside.all():
            raise SamplingError(
                f"the wall's edge cuts {100 * (1 - inside.mean()):.1f} % of the pupil, which polar "
                "nodes cannot follow; use nodes='grid'"
            )
        amplitude = np.where(inside, amplitude, 0.0)

    e1, e2, _ = scene.camera.frame
    mirrored = o * (1.0, 1.0, -1.0)
    kink = _unit(centre - rays.points[0]) - _unit(centre - mirrored)
    tilt = (float(kink @ e1), float(kink @ e2)) if not scene.wall.is_flat else (0.0, 0.0)
    aberration = aberration - tilt[0] * flat[1:, 0] - tilt[1] * flat[1:, 1]
    result = Wavefront(
        u=u,
        v=v,
        aberration=aberration.reshape(u.shape),
        amplitude=amplitude.reshape(u.shape),
        weights=weights,
        wavelength=wavelength,
        image_distance=pupil.image_distance,
        pupil_radius=pupil.radius,
        layout=layout,
        removed=Removed(
            piston=float(rays.excess[0]), tilt=(tilt[0] / zoom, tilt[1] / zoom), defocus=0.0
        ),
    )
    return _best_focus(result) if reference == "best_focus" else result


def _unit(a: Array) -> Array:
    return np.asarray(a / np.linalg.norm(a))


def _check_wave_grade(wall: Wall, wavelength: float) -> None:
    if isinstance(wall, MeshWall) and wall.fit_residual > wavelength / 20:
        raise NotWaveGradeError(
            f"wall.mesh follows a smooth surface to {1e9 * wall.fit_residual:.3g} nm only, limit "
            f"{1e9 * wavelength / 20:.3g} nm (lambda/20); give a finer or smoother mesh"
        )


def _defocus(scene: Scene, o: Array, nodes: Array) -> Array:
    """Path excess of the mirrored point over the point in focus along the same chief ray, m."""
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    line = o * (1.0, 1.0, -1.0) - centre
    depth = float(line @ axis)
    if depth <= 0:
        raise SceneError("the mirrored object point is behind the camera; aim it at the wall")
    distance = float(np.linalg.norm(line))
    in_focus = distance * scene.focus_distance / depth
    if in_focus == distance:
        return np.zeros(len(nodes))
    e1, e2, _ = scene.camera.frame
    toward = nodes @ np.array([line @ e1, line @ e2]) / distance
    square = np.sum(nodes**2, axis=1)

    def over(a: float) -> Array:
        """|a D - q| - a without cancellation."""
        change = square - 2 * a * toward
        return np.asarray(change / (np.sqrt(a * a + change) + a))

    # the lens has the path from the in-focus point as its reference
    return over(distance) - over(in_focus)


def _best_focus(wave: Wavefront) -> Wavefront:
    """Take the least-squares piston, tilt and defocus out of an aberration."""
    weights = np.sqrt(wave.weights * wave.amplitude**2).ravel()
    u, v = wave.u.ravel(), wave.v.ravel()
    r = wave.pupil_radius
    basis = np.stack([np.ones(u.size), u / r, v / r, (u * u + v * v) / (2 * r * r)], axis=1)
    fit, *_ = np.linalg.lstsq(
        basis * weights[:, None], wave.aberration.ravel() * weights, rcond=None
    )
    return replace(
        wave,
        aberration=wave.aberration - (basis @ fit).reshape(wave.u.shape),
        removed=Removed(
            piston=wave.removed.piston + float(fit[0]),
            tilt=(
                wave.removed.tilt[0] + float(fit[1]) / r,
                wave.removed.tilt[1] + float(fit[2]) / r,
            ),
            defocus=wave.removed.defocus + float(fit[3]) / r**2,
        ),
    )
