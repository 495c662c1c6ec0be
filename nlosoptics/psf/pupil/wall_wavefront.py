"""Wave aberration of the relay wall used as a mirror, by ray aiming."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import expect, numbers, one_of, vector, whole
from ..._vectors import Array
from ...errors import NotWaveGradeError, SamplingError, SceneError
from ...scene import MeshWall, Scene, Wall
from ..aperture.aperture import Aperture
from ..wave.detilted import Residual, split
from ..wave.removed import Removed
from ..wave.sampling import Sampling, nodes_of
from ..wave.wavefront import Layout, Wavefront
from .aiming import AimedRays, aim, point_of, pupil_points
from .exit_pupil import ExitPupil, exit_pupil
from .obstruction import hides

#: Grid cells per side for ``nodes="auto"``. More cells reduce the error of a cut rim; 512 take
#: about 0.3 s.
AUTO_GRID_SAMPLES = 512


def _checked_nodes(nodes: ArrayLike) -> Array:
    """Return finite nodes (n, 2), m."""
    points = numbers("nodes", nodes)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SceneError(f"nodes have shape {points.shape}; give (n, 2), u and v in m")
    if not np.isfinite(points).all():
        raise SceneError("nodes hold NaN or infinity; give finite pupil coordinates in m")
    return points


def wall_aberration(
    wall: Wall,
    object_point: ArrayLike,
    pupil_centre: ArrayLike,
    pupil_aim: ArrayLike,
    nodes: ArrayLike,
) -> Array:
    """Compute the wave aberration of a wall that acts as a mirror, without a scene or a lens.

    A flat wall is a perfect mirror; a curved wall adds the aberration W.

    Parameters
    ----------
    wall : Wall
        Relay wall.
    object_point : array_like, (3,)
        Object point in front of the wall, in world coordinates, m.
    pupil_centre : array_like, (3,)
        Centre of the pupil plane, in front of the wall, in world coordinates, m.
    pupil_aim : array_like, (3,)
        Any point on the axis of the pupil other than its centre, such as a wall point, in world
        coordinates, m. The normal n of the pupil plane points from ``pupil_centre`` to it.
    nodes : array_like, (n, 2)
        Points (u, v) of the pupil plane, m, along the unit vectors ``e1`` parallel to Y x n and
        ``e2 = n x e1``. Y is (0, 1, 0), or (1, 0, 0) if n is parallel to (0, 1, 0).

    Returns
    -------
    ndarray, (n,)
        Aberration W at these points, m, positive for a longer path; 0 at (u, v) = (0, 0). The
        reference is the spherical wave from the mirror image of the object point. The mirror is the
        plane z = 0, which is the mean plane of the wall.

    Raises
    ------
    CausticError
        If several rays or none reach a point, so that W has no single value.
    NotWaveGradeError
        If the wall is a mesh that does not follow one smooth surface.

    See Also
    --------
    wavefront : Wave aberration of a scene.

    Notes
    -----
    ``W(p) = D(p) - D(0)`` with ``D(p) = |O - H| + |H - p| - |O' - p|``. Here p is the pupil point,
    O the object point, O' its mirror image in the plane z = 0, and H the wall point at which the
    ray from O to p is reflected (Fermat's principle). Lengths are subtracted in a form without
    cancellation, so that W is accurate to about 1e-17 m.

    Examples
    --------
    A convex wall adds a longer path, 1140 nm at 10 mm from the pupil's centre:

    >>> from nlosoptics import psf, scene
    >>> w = psf.wall_aberration(
    ...     scene.ConvexWall(20.0),
    ...     object_point=(0.3, 0.0, 1.0),
    ...     pupil_centre=(-0.3, 0.0, 1.0),
    ...     pupil_aim=(0.0, 0.0, 0.0),
    ...     nodes=[(0.0, 0.0), (0.0, 0.01)],
    ... )
    >>> print((1e9 * w).round(1))
    [   0.  1140.3]
    """
    centre = np.array(vector("pupil_centre", pupil_centre))
    axis = np.array(vector("pupil_aim", pupil_aim)) - centre
    if not axis.any():
        raise SceneError("pupil_aim equals pupil_centre; aim at a point of the wall")
    axis /= np.linalg.norm(axis)
    expect("wall", wall, "Wall")
    with_centre = np.concatenate([np.zeros((1, 2)), _checked_nodes(nodes)])
    rays = aim(wall, object_point, pupil_points(centre, axis, with_centre), axis)
    return np.asarray(rays.excess[1:] - rays.excess[0])


def wavefront(
    scene: Scene,
    object_point: ArrayLike | None = None,
    nodes: str | ArrayLike = "auto",
    *,
    samples: int | tuple[int, int] | None = None,
) -> Wavefront:
    """Compute the wave that light from one object point, reflected by the wall, forms in the pupil.

    Rays are aimed from the object point via the wall at sample points of the exit pupil.

    Parameters
    ----------
    scene : Scene
        Scene with the wall, the camera and the hidden object.
    object_point : array_like, (3,), optional
        Object point in world coordinates, m. Default: the hidden object's reference point, that is
        the centre of a planar object or the centroid of a mesh.
    nodes : {"auto", "polar", "cells", "grid"} or array_like (n, 2)
        Arrangement of the pupil's sample points:

        - "auto": "polar", or "grid" if the wall's edge cuts off a part of the cone of light.
        - "polar": rings, for a pupil with the round rim of the lens.
        - "cells": patches that also follow the edge of a flat wall.
        - "grid": square grid, for any wall.
        - Array of coordinates (u, v) in the exit pupil, m, for the layout "scattered". Each point
          represents an equal part of the pupil's area; points outside the pupil have the area 0.
    samples : int or (int, int), optional
        Number of sample points; not allowed with coordinates. "polar": rings, with four times as
        many points on each, or (rings, points per ring), default (24, 96). "cells": points along
        the two directions of a patch, default (24, 24). "grid": squares per side, default 256, or
        512 if "auto" selects the grid.

    Returns
    -------
    Wavefront
        Wave with pupil coordinates (u, v) parallel to the image's x and y. If the wall is the stop,
        the pupil radius is that of a circle around the whole pupil, the image of the wall.

    Raises
    ------
    CausticError
        If the aberration has no single value: several rays or none reach a pupil point.
    NotWaveGradeError
        If a mesh wall is not accurate enough for waves.
    SamplingError
        If the wall's edge cuts the cone and ``nodes`` is "polar", or "cells" for a curved wall.
    SceneError
        If occluders block a part of the cone of light. If they block the whole cone, no error is
        raised, and the wave is the one without occluders.

    See Also
    --------
    scene_point_spread : Wave and point spread of a scene in one call.

    Notes
    -----
    The reference is the spherical wave from the mirror image of the object point. The mirror is the
    plane z = 0, which is the mean plane of the wall. A camera that is not focused on this image
    adds defocus. The path length and the direction of the chief ray, which goes to the centre of
    the lens, are subtracted (piston and tilt) and reported in ``removed``.

    The amplitude is 1/sqrt(J), with J the factor by which the cross-section of a thin bundle of
    rays grows, relative to that of the chief ray. Squares of a grid that the wall's edge crosses
    are weighted by the fraction inside.

    Examples
    --------
    A flat wall is a perfect mirror, and the camera of this scene is focused on the object:

    >>> from nlosoptics import Scene, psf
    >>> wave = psf.wavefront(Scene.load("examples/scenes/letter_flat.toml"))
    >>> print(wave.layout, wave.u.shape, f"{1e9 * psf.rms_aberration(wave):.1f} nm")
    polar (24, 96) 0.0 nm
    """
    scene = expect("scene", scene, "Scene")
    o = point_of(scene, object_point)
    return aimed_wave(scene, exit_pupil(scene), o, nodes, samples).wave


@dataclass(frozen=True, eq=False)
class AimedWave:
    """Wave from an object point by the wall, with the rays that it was computed from."""

    wave: Wavefront  # Wave in the exit pupil
    rays: AimedRays  # The chief ray, followed by one ray for each node inside the lens
    on_lens: Array  # (1 + n, 3); Points at which these rays meet the lens, world frame, m
    # Whether each node of the wave lies inside the lens, in the shape of the nodes.
    in_lens: NDArray[np.bool_]
    hidden: bool  # Whether the occluders cut all rays
    # Outline of a pupil that the edge of a flat wall cuts. A grid wave does not contain it, since
    # its cells follow the edge only to their own size.
    outline: Aperture | None

    @cached_property
    def residual(self) -> Residual:
        """The wave with piston and tilt separated."""
        return split(self.wave)


def aimed_wave(
    scene: Scene,
    pupil: ExitPupil,
    o: Array,
    nodes: str | ArrayLike = "auto",
    samples: int | tuple[int, int] | None = None,
) -> AimedWave:
    """Return the wave and its rays from an object point, for a known exit pupil."""
    if isinstance(nodes, str) and nodes == "auto":
        if pupil.layout == "polar":
            # The edge may cut this point's rays although it does not cut the reference point's
            # rays on a flat wall, which the exit pupil is computed from.
            with suppress(SamplingError):
                return aimed_wave(scene, pupil, o, "polar", samples)
        return aimed_wave(
            scene, pupil, o, "grid", AUTO_GRID_SAMPLES if samples is None else samples
        )
    check_wave_grade(scene.wall, scene.laser.wavelength)
    # Ratio of exit pupil to lens; negative if the pupil is inverted because it is beyond the image.
    zoom = pupil.image_distance / scene.image_distance
    radius = _reach(scene, pupil, o) * abs(zoom)
    aperture = None
    if isinstance(nodes, str) and nodes == "cells":
        aperture = _aperture(scene, o, radius, zoom)
    layout, u, v, weights = _pupil_nodes(nodes, samples, radius, aperture)
    if layout == "polar" and pupil.stop == "wall":
        raise SamplingError(
            "the wall is the stop and its outline is a rectangle, which polar nodes cannot follow; "
            "use nodes='cells', or nodes='grid' for a curved wall"
        )
    lit = weights > 0
    on_lens = np.stack([u[lit], v[lit]], axis=1) / zoom
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    with_centre = np.concatenate([np.zeros((1, 2)), on_lens])
    lens = pupil_points(centre, axis, with_centre)
    rays = aim(scene.wall, o, lens, axis)
    hidden = hides(scene, o, rays.points, lens)
    tilt = _chief_tilt(scene, o, rays.points[0])
    aberration, amplitude = np.zeros(u.shape), np.zeros(u.shape)
    aberration[lit] = rays.excess[1:] - rays.excess[0] + _defocus(scene, o, on_lens)
    aberration[lit] -= on_lens @ np.array(tilt)
    amplitude[lit] = np.sqrt(rays.spreading[1:] / rays.spreading[0])
    whole = float(weights.sum())
    if aperture is None:  # cells already follow the edge
        weights = weights * _share_on_wall(scene.wall, rays.points[1:], lit, layout)
    if not weights.any():
        raise SceneError(
            f"light from object_point = {tuple(o.tolist())} m is reflected to the lens by no part "
            f"of the wall, wall.size = {scene.wall.size} m; enlarge the wall, or move object or "
            "camera"
        )
    outline = aperture
    if scene.wall.is_flat and weights.sum() < whole:
        with suppress(SamplingError):  # raised if the edge has no closed image
            outline = _aperture(scene, o, radius, zoom)
    wave = Wavefront(
        u=u,
        v=v,
        aberration=aberration,
        amplitude=amplitude,
        weights=weights,
        wavelength=scene.laser.wavelength,
        image_distance=pupil.image_distance,
        pupil_radius=radius,
        layout=layout,
        aperture=aperture,
        removed=Removed(piston=float(rays.excess[0]), tilt=(tilt[0] / zoom, tilt[1] / zoom)),
    )
    return AimedWave(wave, rays, lens, lit, hidden, outline)


def _reach(scene: Scene, pupil: ExitPupil, o: Array) -> float:
    """Radius of the circle on the lens that contains all light from O by the wall, m."""
    lens_radius = scene.camera.stop_diameter / 2
    if pupil.stop == "lens" or scene.wall.size is None:
        return lens_radius
    # The corners of a curved wall are imaged slightly farther out.
    return min(lens_radius, 1.1 * float(np.linalg.norm(_corners(scene, o)[0], axis=1).max()))


def _corners(scene: Scene, o: Array) -> tuple[Array, Array]:
    """Project a flat wall's corners from the mirrored object point onto the plane of the lens.

    Returns the projected corners (4, 2), m along the camera's axes, in order, and the parameters
    (4,) of the lens plane on the lines from the mirrored O (0) by the corner (1). A negative
    parameter means that the line leads away from the lens.
    """
    half_x, half_y = (side / 2 for side in scene.wall.size or (math.inf, math.inf))
    corners = np.array([[1, 1, 0.0], [-1, 1, 0.0], [-1, -1, 0.0], [1, -1, 0.0]])
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    mirrored = np.array([o[0], o[1], -o[2]])
    lines = corners * (half_x, half_y, 1.0) - mirrored
    share = (centre - mirrored) @ axis / (lines @ axis)
    e1, e2, _ = scene.camera.frame
    on_lens = (mirrored + share[:, None] * lines - centre) @ np.stack([e1, e2], axis=1)
    return on_lens, share


def _aperture(scene: Scene, o: Array, radius: float, zoom: float) -> Aperture:
    """Return the part of the exit pupil that light from O by a flat wall reaches."""
    disc = ((0.0, 0.0), min(radius, abs(zoom) * scene.camera.stop_diameter / 2))
    if scene.wall.size is None:
        return Aperture.discs([disc])
    if not scene.wall.is_flat:
        raise SamplingError(
            "nodes = 'cells' needs a flat wall with an edge, and this one is curved; use "
            "nodes='grid', or 'polar' if the wall holds the whole cone"
        )
    corners, share = _corners(scene, o)
    if share.min() <= 0:
        raise SamplingError(
            "light by a corner of the wall never meets the plane of the lens, so that the wall's "
            "edge has no closed image there; use nodes='grid'"
        )
    return Aperture.discs([disc], within=corners * zoom)


def _pupil_nodes(
    nodes: str | ArrayLike,
    samples: int | tuple[int, int] | None,
    radius: float,
    aperture: Aperture | None,
) -> tuple[Layout, Array, Array, Array]:
    """Return layout, coordinates u and v, m, and areas, m^2, of the requested pupil nodes."""
    if not isinstance(nodes, str):
        points = _checked_nodes(nodes)
        if samples is not None:
            raise SceneError(f"samples = {samples} with nodes given as an array; leave it out")
        u, v = points[:, 0].copy(), points[:, 1].copy()
        area = math.pi * radius**2 / len(u)
        return "scattered", u, v, np.where(np.hypot(u, v) <= radius * (1 + 1e-9), area, 0.0)
    one_of("nodes", nodes, ("auto", "polar", "cells", "grid"))
    layout = nodes_of(nodes, aperture, 0.0, samples)
    if samples is None:
        samples = {"grid": 256}.get(layout, 24)
    counts = samples if isinstance(samples, tuple) else whole("samples", samples)
    found = Sampling(layout, None, radius, 0.0, aperture).nodes(counts)
    return layout, found.u, found.v, found.weights


def _share_on_wall(wall: Wall, hits: Array, lit: NDArray[np.bool_], layout: Layout) -> Array:
    """Fraction of each node's area that receives light by the wall, in the shape of ``lit``."""
    share = np.zeros(lit.shape)
    share[lit] = wall.contains(hits[:, 0], hits[:, 1])
    if layout == "polar" and not share.all():
        raise SamplingError(
            f"the wall's edge cuts {100 * (1 - share.mean()):.1f} % of the pupil, which polar "
            "nodes cannot follow; use nodes='cells', or nodes='grid' for a curved wall"
        )
    if layout == "grid" and wall.size is not None:
        index = np.cumsum(lit).reshape(lit.shape) - 1
        middle = lit.shape[0] // 2
        here, right, above = (
            hits[index[middle + i, middle + j]] for i, j in ((0, 0), (0, 1), (1, 0))
        )
        share[lit] = 1.0
        for i, side in enumerate(wall.size):
            # Width of a cell's footprint across the edge, taken at the pupil's centre.
            step = abs(right[i] - here[i]) + abs(above[i] - here[i])
            share[lit] *= np.clip(0.5 + (side / 2 - abs(hits[:, i])) / step, 0.0, 1.0)
    return share


def _chief_tilt(scene: Scene, o: Array, hit: Array) -> tuple[float, float]:
    """Slopes of W at the lens centre: change of the chief ray's direction by the wall's shape."""
    if scene.wall.is_flat:
        return 0.0, 0.0
    centre = np.array(scene.camera.position)
    kink = _unit(centre - hit) - _unit(centre - o * (1.0, 1.0, -1.0))
    e1, e2, _ = scene.camera.frame
    return float(kink @ e1), float(kink @ e2)


def _unit(a: Array) -> Array:
    """Vector of length 1 along a."""
    return np.asarray(a / np.linalg.norm(a))


def check_wave_grade(wall: Wall, wavelength: float) -> None:
    """Raise `NotWaveGradeError` for a mesh wall that is not accurate to lambda/20."""
    if isinstance(wall, MeshWall) and not wall.wave_grade(wavelength):
        raise NotWaveGradeError(
            f"wall.mesh deviates from a smooth surface by {1e9 * wall.fit_residual:.3g} nm, limit "
            f"{1e9 * wavelength / 20:.3g} nm (lambda/20); give a finer or smoother mesh"
        )


def _defocus(scene: Scene, o: Array, nodes: Array) -> Array:
    """Defocus at lens nodes (n, 2), m: path from the mirrored point minus that from the focus.

    Both points lie on the chief ray, and both paths are relative to it. Returns (n,), m.
    """
    centre, axis = np.array(scene.camera.position), scene.camera.axis
    line = o * (1.0, 1.0, -1.0) - centre
    depth = float(line @ axis)
    if depth <= 0:
        raise SceneError(
            "the mirrored object point is behind the camera; aim the camera at the wall"
        )
    distance = float(np.linalg.norm(line))
    in_focus = distance * scene.focus_distance / depth
    if in_focus == distance:
        return np.zeros(len(nodes))
    e1, e2, _ = scene.camera.frame
    toward = nodes @ np.array([line @ e1, line @ e2]) / distance
    square = np.sum(nodes**2, axis=1)

    def over(a: float) -> Array:
        """Return |a D - q| - a without cancellation, D the chief direction, q a lens node."""
        change = square - 2 * a * toward
        return np.asarray(change / (np.sqrt(a * a + change) + a))

    # The lens images the in-focus point perfectly, so the path from it is the reference.
    return over(distance) - over(in_focus)
