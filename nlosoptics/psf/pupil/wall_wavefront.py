"""Wave aberration of the relay wall used as a mirror, by aiming."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import one_of, real, vector
from ...errors import CausticError, NotWaveGradeError, SamplingError, SceneError
from ...scene import MeshWall, Scene, Wall
from ..aperture.aperture import Aperture
from ..aperture.quadrature_nodes import grid_nodes, polar_nodes
from ..wave.detilted import Residual, split
from ..wave.fits import fitted_terms
from ..wave.wavefront import Layout, Removed, Wavefront
from .aiming import AimedRays, aim, pupil_points, stationary_points
from .exit_pupil import ExitPupil, exit_pupil
from .obstruction import hides

Array = NDArray[np.float64]
POLAR_SAMPLES = (24, 96)
CELL_SAMPLES = (24, 24)
GRID_SAMPLES = 256
AUTO_GRID_SAMPLES = 512  # the error of a cut rim falls with the cells, and 512 take 0.3 s


def _check_nodes(nodes: Array) -> None:
    if nodes.ndim != 2 or nodes.shape[1] != 2:
        raise SceneError(f"nodes have shape {nodes.shape}; give (n, 2), u and v in m")
    if not np.isfinite(nodes).all():
        raise SceneError("nodes hold NaN or infinity; give finite pupil coordinates in m")


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
    rays = aim(wall, object_point, pupil_points(centre, axis, with_centre), axis)
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
    from . import _aiming_kernels

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
            x, y, status = next(stationary_points(wall, o, p, start, side))
            if status != _aiming_kernels.FOUND:
                raise CausticError(
                    f"no stationary path from {source!r} by the wall to {target!r}; "
                    "give wall_point, or other points"
                )
    else:
        x, y = (real("wall_point", c) for c in np.asarray(wall_point, dtype=np.float64)[:2])
    height = float(wall.height(x, y))
    side = 1.0 if p[2] >= height else -1.0
    hit = np.array([x, y, height])
    return float(_aiming_kernels.path_difference(o, hit, p, side, reference))


def wavefront(
    scene: Scene,
    object_point: ArrayLike | None = None,
    nodes: str | ArrayLike = "auto",
    *,
    samples: int | tuple[int, int] | None = None,
    reference: str = "mirror_image",
) -> Wavefront:
    """Wave at the exit pupil from one object point by the relay wall.

    Parameters
    ----------
    scene : Scene
    object_point : array_like, (3,), optional
        World, m; by default the hidden object's reference point.
    nodes : {"auto", "polar", "cells", "grid"} or array_like (n, 2)
        Pupil nodes; an array holds (u, v) in the exit pupil, m. Polar nodes know a round rim. Cells
        follow the edge of a flat wall that cuts the cone of light, a grid that of any wall.
        ``auto`` takes polar nodes, or a grid where the wall's edge cuts the cone or is the stop.
    samples : int or (int, int), optional
        Polar: radii, with four times as many angles, or (radii, angles), default (24, 96). Cells:
        nodes of each patch along both sides, default (24, 24). Grid: cells per side, default 256.
        Auto: those of the layout that it takes, default (24, 96) or 512.
    reference : {"mirror_image", "best_focus"}
        Remove the chief ray's piston and tilt, which shift the image exactly; or fit and remove
        defocus as well. ``removed`` reports them.

    Returns
    -------
    Wavefront
        In exit-pupil coordinates, parallel to the image's axes. Where the wall is the stop, its
        pupil radius is that of the circle about the wall's outline.

    Raises
    ------
    CausticError, NotWaveGradeError
        Where W is undefined or the wall is not known well enough.
    SamplingError
        If the wall's edge cuts the cone and polar nodes are asked for, or cells where the wall is
        curved.
    SceneError
        If occluders cut a part of the cone; cut as a whole, it keeps its wave, and the image its
        shadow.

    Notes
    -----
    The amplitude follows the spreading of ray tubes, 1/sqrt(J), from the van Vleck determinant of
    the path. A camera focused elsewhere than on the mirrored object adds its defocus. Cells of a
    grid that the wall's edge cuts count with the part that lies inside.
    """
    one_of("reference", reference, ("mirror_image", "best_focus"))
    if object_point is None:
        o = scene.object_point
    else:
        o = np.array(vector("object_point", object_point))
    wave = aimed_wave(scene, exit_pupil(scene), o, nodes, samples).wave
    return _best_focus(wave) if reference == "best_focus" else wave


@dataclass(frozen=True, eq=False)
class AimedWave:
    """Wave of an object point by the wall, with the rays that it was computed from.

    Parameters
    ----------
    wave : Wavefront
    rays : AimedRays
        The chief ray first, then one ray for each node that lies in the lens.
    on_lens : ndarray, (1 + n, 3)
        Where these rays meet the lens, world, m.
    in_lens : ndarray of bool
        Which of the wave's nodes lie in the lens, with the shape of the nodes.
    hidden : bool
        Whether the occluders cut all of the rays.
    outline : Aperture or None
        Outline of the pupil that a flat wall's edge cuts. It is no part of a grid wave, whose cells
        follow it to their own size only.
    """

    wave: Wavefront
    rays: AimedRays
    on_lens: Array
    in_lens: NDArray[np.bool_]
    hidden: bool
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
    """Wave from an object point by the wall, at the nodes of a known exit pupil.

    Parameters
    ----------
    scene : Scene
    pupil : ExitPupil
        Exit pupil of the scene.
    o : ndarray, (3,)
        Object point, world, m.
    nodes, samples
        Pupil nodes, see `wavefront`.

    Returns
    -------
    AimedWave
    """
    if isinstance(nodes, str) and nodes == "auto":
        if pupil.layout == "polar":
            # an edge may cut the rays of this point, or of a curved wall, and not the exit pupil's
            with suppress(SamplingError):
                return aimed_wave(scene, pupil, o, "polar", samples)
        return aimed_wave(
            scene, pupil, o, "grid", AUTO_GRID_SAMPLES if samples is None else samples
        )
    check_wave_grade(scene.wall, scene.laser.wavelength)
    # the lens is the exit pupil, or the cone from the image through it, inverted if behind
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
    weights = weights * _share_on_wall(scene.wall, rays.points[1:], lit, layout)
    if not weights.any():
        raise SceneError(
            f"object_point = {tuple(o.tolist())} m is mirrored to the lens by no part of the wall, "
            f"wall.size = {scene.wall.size} m; enlarge the wall, or move object or camera"
        )
    outline = aperture
    if layout == "grid" and scene.wall.is_flat and weights.sum() < whole:
        with suppress(SamplingError):  # an edge that has no closed image
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
    """Radius of the circle on the lens that holds all light from O by the wall, m."""
    lens_radius = scene.camera.stop_diameter / 2
    if pupil.stop == "lens" or scene.wall.size is None:
        return lens_radius
    # curved walls send their corners a little elsewhere
    return min(lens_radius, 1.1 * float(np.linalg.norm(_corners(scene, o)[0], axis=1).max()))


def _corners(scene: Scene, o: Array) -> tuple[Array, Array]:
    """Where light from O by a flat wall's corners meets the lens's plane, and how far along.

    Corners (4, 2), m along the camera's axes, in turn; and the shares (4,) of the straight line
    from the mirrored O by each corner, 1 at the corner, below 0 where it leads away from the lens.
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
    """The lens as far as light from O by a flat wall reaches it, in the exit pupil."""
    disc = ((0.0, 0.0), min(radius, abs(zoom) * scene.camera.stop_diameter / 2))
    if scene.wall.size is None:
        return Aperture.discs([disc])
    if not scene.wall.is_flat:
        raise SamplingError(
            "nodes = 'cells' follow the edge of a flat wall, and this one is curved; use "
            "nodes='grid', or 'polar' where the wall holds the whole cone"
        )
    corners, share = _corners(scene, o)
    if share.min() <= 0:
        raise SamplingError(
            "light by a corner of the wall never meets the lens's plane, so the edge has no closed "
            "image there; use nodes='grid'"
        )
    return Aperture.discs([disc], within=corners * zoom)


def _pupil_nodes(
    nodes: str | ArrayLike,
    samples: int | tuple[int, int] | None,
    radius: float,
    aperture: Aperture | None,
) -> tuple[Layout, Array, Array, Array]:
    """Layout, coordinates and areas of the pupil nodes asked for."""
    if not isinstance(nodes, str):
        points = np.asarray(nodes, dtype=np.float64)
        _check_nodes(points)
        if samples is not None:
            raise SceneError(f"samples = {samples} with nodes given as an array; leave it out")
        u, v = points[:, 0].copy(), points[:, 1].copy()
        area = math.pi * radius**2 / len(u)
        return "scattered", u, v, np.where(np.hypot(u, v) <= radius * (1 + 1e-9), area, 0.0)
    one_of("nodes", nodes, ("auto", "polar", "cells", "grid"))
    if isinstance(samples, tuple) and len(samples) != 2:
        raise SceneError(f"samples = {samples}; give one whole number or two")
    if aperture is not None:
        samples = CELL_SAMPLES if samples is None else samples
        n_s, n_t = samples if isinstance(samples, tuple) else (samples, samples)
        return "cells", *aperture.nodes(n_s, n_t)
    if nodes == "grid":
        if isinstance(samples, tuple):
            raise SceneError(f"samples = {samples}; a grid is square, give one whole number")
        return "grid", *grid_nodes(radius, GRID_SAMPLES if samples is None else samples)
    if samples is None:
        samples = POLAR_SAMPLES
    n_r, n_theta = samples if isinstance(samples, tuple) else (samples, 4 * samples)
    return "polar", *polar_nodes(radius, n_r, n_theta)


def _share_on_wall(wall: Wall, hits: Array, lit: NDArray[np.bool_], layout: Layout) -> Array:
    """Part of every node's area whose light meets the wall."""
    if layout == "cells":
        return np.ones(lit.shape)  # they follow the edge
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
            # a cell's footprint across the edge, as at the pupil's centre
            step = abs(right[i] - here[i]) + abs(above[i] - here[i])
            share[lit] *= np.clip(0.5 + (side / 2 - abs(hits[:, i])) / step, 0.0, 1.0)
    return share


def _chief_tilt(scene: Scene, o: Array, hit: Array) -> tuple[float, float]:
    """Slopes of W over the lens at its centre: what the wall's bend adds to the chief direction."""
    if scene.wall.is_flat:
        return 0.0, 0.0
    centre = np.array(scene.camera.position)
    kink = _unit(centre - hit) - _unit(centre - o * (1.0, 1.0, -1.0))
    e1, e2, _ = scene.camera.frame
    return float(kink @ e1), float(kink @ e2)


def _unit(a: Array) -> Array:
    return np.asarray(a / np.linalg.norm(a))


def check_wave_grade(wall: Wall, wavelength: float) -> None:
    """Raise `NotWaveGradeError` for a mesh that is not known to lambda/20."""
    if isinstance(wall, MeshWall) and not wall.wave_grade(wavelength):
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
    r = wave.pupil_radius
    u, v = wave.u / r, wave.v / r
    terms = np.stack([np.ones_like(u), u, v, (u * u + v * v) / 2])
    fit = fitted_terms(wave.aberration, wave.amplitude * wave.weights, terms)
    return replace(
        wave,
        aberration=wave.aberration - np.tensordot(fit, terms, 1),
        removed=Removed(
            piston=wave.removed.piston + float(fit[0]),
            tilt=(
                wave.removed.tilt[0] + float(fit[1]) / r,
                wave.removed.tilt[1] + float(fit[2]) / r,
            ),
            defocus=wave.removed.defocus + float(fit[3]) / r**2,
        ),
    )
