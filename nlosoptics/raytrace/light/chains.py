"""Chains of mirror-like reflections between wall and object: which are traced, and which not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...kernels.codes import BUMPS, FACETS
from ...scene import ConvexWall, PlanarObject, Scene


@dataclass(frozen=True, kw_only=True)
class Chains:
    """Treatment of light that mirror-like lobes reflect several times in a row."""

    surfaces: int  # whose reflection points are solved for: 1 for the wall, plus 2 for the object
    both: bool  # whether both take part, so that chains have more than one reflection
    several: bool  # whether a chain may have several solutions
    steepest: float  # largest slope of the wall
    #: Paths that no sampling method aims at: the least number of reflections, and the reason.
    unreached: tuple[tuple[int, str], ...]


def mirror_chains(scene: Scene, *, wall_to_wall: bool) -> Chains:
    """Return which chains of mirror-like reflections are traced and which are left to chance."""
    wall, thing = bool(scene.wall_material.mirror_lobes), bool(scene.hidden.material.mirror_lobes)
    missing: list[tuple[int, str]] = []
    steepest = hills = 0.0
    if not scene.wall.has_height:
        if wall:
            text = (
                "light that mirror-like lobes of the wall reflect to the lens or to another mirror"
            )
            missing.append((2, f"{text}: the wall consists of triangles"))
        wall = False
    elif not scene.wall.is_flat:
        steepest, hills = _slopes(scene)
    if wall and wall_to_wall and _lens_elevation(scene) <= 3.0 * math.atan(steepest):
        text = (
            "light that the wall's mirror-like lobes reflect twice in a row: its slopes, up to "
            f"{steepest:.2g}, suffice to send such light to the lens"
        )
        missing.append((3 if _meets_object(scene, 0.0, mirrored=False) else 4, text))
    # chains of one reflection matter if the laser's glint on the wall reaches the object
    facets = 5.0 * max((x.slope_rms for x in scene.wall_material.mirror_lobes), default=0.0)
    spread = 2.0 * (math.atan(steepest) + facets)
    room = bool(scene.room_materials)
    wall = wall and (thing or room or _meets_object(scene, spread, mirrored=True))
    obstacle = _obstacle(scene, hills) if wall else ""
    if obstacle:
        path = "the object and then" if thing else "the wall, and after the object again"
        text = f"light that mirror-like lobes reflect at {path} at the wall: {obstacle}"
        missing.append((3, text))
    if thing and not isinstance(scene.hidden, PlanarObject):
        count = len(scene.hidden.surface.faces)
        if count > 128:  # of which a chain draws one at random
            text = "light that mirror-like lobes of the object reflect to the wall or the lens: it "
            missing.append((2, f"{text}has {count} triangles, limit 128"))
            thing = False
        elif not scene.hidden.surface.is_convex:
            text = "light that the object's mirror-like lobes reflect twice in a row: its mesh is "
            missing.append((3, f"{text}not convex"))
    wall = wall and not obstacle
    if any(material.mirror_lobes for material in scene.room_materials):
        text = "light that mirror-like lobes of occluders reflect to the lens or to another mirror"
        missing.append((2, text))
    return Chains(
        surfaces=int(wall) + 2 * int(thing),
        both=wall and thing,
        several=not (scene.wall.is_flat or isinstance(scene.wall, ConvexWall)),
        steepest=steepest,
        unreached=tuple(missing),
    )


def _obstacle(scene: Scene, hills: float) -> str:
    """Return why reflection points on the wall cannot be solved for, or an empty string."""
    if not scene.wall.is_compiled:
        return "the wall's height is a Python function"
    if scene.wall.is_flat:
        return ""
    terms = scene.wall.compiled()[0]
    if np.isin(terms[:, 0], (FACETS, BUMPS)).any():
        return "the wall has a rough relief"
    if hills > 100.0:
        return f"the wall has some {hills:.0f} hills and hollows, limit 100"
    return ""


def _slopes(scene: Scene) -> tuple[float, float]:
    """Return the largest slope of the wall, and its number of hills and hollows, on a grid."""
    n = 129  # points of the grid along a side
    size = scene.wall.size or (4.0, 4.0)
    x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s in size)
    # The values of a compiled wall are NaN beyond the rim of a sphere, and infinite on it.
    values = scene.wall.surface_values if scene.wall.is_compiled else scene.wall.derivatives
    slopes = values(*(a.ravel() for a in np.meshgrid(x, y)))[:, 1:3]
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    norms = np.hypot(slopes[:, 0], slopes[:, 1])
    signs = np.sign(slopes.reshape(n, n, 2))
    turns = [float((np.abs(np.diff(signs[..., k], axis=1 - k)) == 2.0).mean()) for k in (0, 1)]
    hills = (1.0 + turns[0] * (n - 1)) * (1.0 + turns[1] * (n - 1))
    return float(np.max(norms, initial=0.0, where=np.isfinite(norms))), hills


def _lens_elevation(scene: Scene) -> float:
    """Return the least elevation, rad, at which points of the wall see the lens; 0 if unbounded."""
    if scene.wall.size is None:
        return 0.0
    camera = scene.camera
    corner = np.abs(camera.position[:2]) + np.divide(scene.wall.size, 2)
    radius = camera.stop_diameter / 2
    return math.atan2(camera.position[2] - radius, float(np.hypot(*corner)) + radius)


def _meets_object(scene: Scene, spread: float, *, mirrored: bool) -> bool:
    """Return whether the laser beam may meet the object, directly or mirrored by the wall."""
    laser, hidden = scene.laser, scene.hidden
    start, aim = np.array(laser.position), np.array(laser.aim)
    beam = (aim - start) / np.linalg.norm(aim - start)
    if mirrored:
        start = start - beam * (start[2] / beam[2]) if beam[2] < 0.0 else aim
        beam = beam * (1.0, 1.0, -1.0)
    points = hidden.corners if isinstance(hidden, PlanarObject) else hidden.surface.vertices
    points = np.asarray(points, dtype=np.float64)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max()) + laser.beam_diameter
    away = centre - start
    distance = float(np.linalg.norm(away))
    if distance <= radius:
        return True
    angle = math.acos(float(np.clip(beam @ away / distance, -1.0, 1.0)))
    return angle <= math.asin(radius / distance) + spread
