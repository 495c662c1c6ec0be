"""Surfaces of a scene that rays can hit, and the tests that a tracer can skip."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, expect
from ...kernels.codes import BECKMANN
from ...scene import CallableWall, ConcaveWall, ConvexWall, Laser, PlanarObject, Scene
from ..intersection.intersections import Hits as WallHits
from ..intersection.intersections import compiled_wall, intersect
from ..intersection.meshes import blocked, first_triangles, intersect_mesh
from ..intersection.prepared_meshes import (
    Chart,
    PreparedMesh,
    ball_around,
    chart_splits,
    cumulative,
    prepared_mesh,
)
from .chains import mirror_chains

if TYPE_CHECKING:
    from ._surround_kernels import World


Array = NDArray[np.float64]
Hits = tuple[Array, NDArray[np.int16], Array, Array, Array]
# Shares of the rays leaving the wall that are aimed at the object: first for the laser spot and
# points seen from the lens, second for other points. The second row is for walls that see
# themselves, or occluders that reflect light, which need more of the other rays. Binary fractions
# split Sobol points exactly.
AIMED: Final = ((0.75, 0.75), (0.5, 0.25))


@dataclass(frozen=True, kw_only=True)
class RayPlan:
    """Tests and methods that tracing a scene needs; printing the plan gives the reasons.

    `ray_plan` computes the plan from the scene. Tests that cannot change the result are skipped.

    Parameters
    ----------
    wall_hits : {"closed form", "march", "python", "triangles"}
        How hits on the wall are found: in closed form; by steps along the ray in compiled code, or
        in Python for a `nlosoptics.scene.CallableWall`; or as those on other triangles.
    embree : bool
        Whether the scene has triangles that rays can meet: those of wall, hidden mesh or occluders.
        The library Embree finds hits on large meshes, own code those on small ones.
    wall_to_wall : bool
        Whether light from one point of the wall can meet the wall again.
    wall_shadows : bool
        Whether the wall can block the line between two of its points, or between the wall and a
        point in the room.
    glossy : bool
        Whether a material of the scene has a glossy part (a microfacet or Ward lobe). Its light is
        then sampled in three ways instead of one; see the notes of `trace`.
    chains : bool
        Whether the tracer solves the law of reflection for paths with several mirror-like
        reflections in a row (at wall and object). Random rays hardly find such paths.
    unreached : tuple of str
        Kinds of paths that no sampling method aims at, so that rays find them only rarely; each
        with the reason. If there are any, `trace` refuses the option ``tol``, because its error
        estimate may not include their light.

    See Also
    --------
    ray_plan : Intersection tests that a scene requires.
    """

    wall_hits: str
    embree: bool
    wall_to_wall: bool
    wall_shadows: bool
    glossy: bool
    chains: bool = False
    unreached: tuple[str, ...] = ()

    def __str__(self) -> str:
        hits, lobe = "object and occluders hold none", "whose reflection points can be solved for"
        rows = (
            ("wall hits", True, self.wall_hits, ""),
            ("triangles", self.embree, "float64 computes the hits", hits),
            (
                "wall to wall",
                self.wall_to_wall,
                "light from the wall may meet it again",
                "no part of the wall sees another",
            ),
            (
                "wall shadows",
                self.wall_shadows,
                "crests or the rim may block light",
                "the wall, or the room in front of it, is convex",
            ),
            ("three strategies", self.glossy, "a lobe is glossy", "all lobes are wide"),
            ("mirror chains", self.chains, "points are solved for", f"no mirror-like lobe {lobe}"),
        )
        lines = [
            f"{name:16s}  {'runs' if runs else 'skipped':7s}  {why if runs else why_not}"
            for name, runs, why, why_not in rows
        ]
        return "\n".join(lines + [f"{'unreached':16s}  {'':7s}  {why}" for why in self.unreached])


def ray_plan(scene: Scene) -> RayPlan:
    """Return which intersection tests the tracing of a scene needs, and which can be skipped.

    Parameters
    ----------
    scene : Scene
        Scene to trace.

    Returns
    -------
    RayPlan
        Tests and methods that `trace` uses for this scene; printing the plan shows the reasons.

    See Also
    --------
    trace : Light from the laser to the detector.
    nlosoptics.plan : Predict stages, time and error.

    Notes
    -----
    A flat or convex wall cannot illuminate itself. A concave sphere or cylinder can. It blocks no
    line between two points in the space that it encloses, but its rim may block lines to points
    outside. Walls of other shapes can both illuminate themselves and block lines.

    ``embree`` in the plan says whether rays are tested against triangles. It is named after the
    library Embree, which does so for large meshes.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> plan = raytrace.ray_plan(scene)
    >>> plan.wall_hits, plan.embree, plan.wall_to_wall
    ('closed form', False, False)
    """
    scene = expect("scene", scene, "Scene")
    scene = scene.with_relief()
    wall = scene.wall
    convex = wall.is_flat or isinstance(wall, ConvexWall)
    closed = wall.is_flat or isinstance(wall, ConvexWall | ConcaveWall)
    beside = isinstance(wall, ConcaveWall) and not _within_hollow(wall, scene)
    how = "python" if isinstance(wall, CallableWall) else "closed form" if closed else "march"
    how = how if wall.has_height else "triangles"
    materials = (scene.wall_material, scene.hidden.material, *scene.room_materials)
    lobes = np.concatenate([material.lobe_table() for material in materials])
    chains = mirror_chains(scene, wall_to_wall=not convex)
    return RayPlan(
        wall_hits=how,
        embree=bool(scene.occluders)
        or not (isinstance(scene.hidden, PlanarObject) and wall.has_height),
        wall_to_wall=not convex,
        wall_shadows=(beside or not closed) and wall.has_height,
        glossy=bool((lobes[:, 0] >= BECKMANN).any()),
        chains=chains.surfaces > 0,
        unreached=tuple(text for _, text in chains.unreached),
    )


def _within_hollow(wall: ConcaveWall, scene: Scene) -> bool:
    """Return whether all that sends light lies inside the convex room of a concave wall."""
    hidden, camera = scene.hidden, scene.camera
    thing = hidden.corners if isinstance(hidden, PlanarObject) else hidden.surface.vertices
    things = [np.asarray(thing, dtype=np.float64)]
    things += [mesh.vertices for mesh, material in scene.occluder_surfaces if not material.is_black]
    points = np.concatenate([[camera.position], *things])
    margin = np.zeros(len(points))
    margin[0] = camera.stop_diameter / 2
    if wall.shape == "sphere":
        across = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    else:
        across = np.abs(points[:, 0 if wall.axis == "y" else 1])
    below = np.maximum(wall.radius - points[:, 2] + margin, 0.0)
    return bool(((across + margin) ** 2 + below**2 < wall.radius**2).all())


class Surroundings:
    """Intersection and occlusion tests of blocks of rays with all surfaces of a scene."""

    def __init__(self, scene: Scene, *, analog: bool = False, chained: bool = True) -> None:
        self.plan = ray_plan(scene)
        self.chains = mirror_chains(scene, wall_to_wall=self.plan.wall_to_wall)
        self.world = _world(
            scene, self.plan, self.chains.surfaces * (chained and not analog), analog
        )
        self._wall = scene.wall
        self._walls: Any = None
        self.chain_wall: Any = (None, None, np.full(2, math.inf), 0.0)
        if self.plan.wall_hits not in ("python", "triangles"):
            self._walls = compiled_wall(scene.wall, math.inf)
            terms, tables, _, box, _, rim = self._walls
            self.chain_wall = terms, tables, box, rim
        self._mesh = _triangles(scene)
        if self._mesh is not None:
            self._gap = 1e-9 * max(self._mesh.reach, 1e-3)

    def first_hits(
        self,
        origins: Array,
        directions: Array,
        live: NDArray[np.bool_],
        on_wall: NDArray[np.bool_],
        counts: Counter[str],
    ) -> Hits:
        """Return distance, kind of surface, normal and brightness of the first hits of rays.

        Rays that are not ``live`` get no hit, and ``on_wall`` marks rays that start on the wall.
        The result has distances (n,), m, infinite without a hit; kinds (n,) as in
        `_surround_kernels`; unit normals (n, 3); the brightness of a planar object (n,); and the
        density, 1/m^2, with which rays aimed from the laser spot meet the object at the hit (n,).
        ``counts`` is updated.
        """
        from . import _surround_kernels as kernels

        n = len(origins)
        distance, kind = np.full(n, math.inf), np.full(n, kernels.NOTHING, dtype=np.int16)
        normal, scale, lit = np.zeros((n, 3)), np.ones(n), np.zeros(n)
        ends = (distance, kind, normal, scale, lit)
        # rays that leave a wall which cannot see itself need no wall test
        asking = live
        if on_wall.any():
            leaving = live & on_wall
            if self.plan.wall_to_wall:
                counts["wall to wall"] += int(leaving.sum())
            else:
                asking = live & ~leaving
        asked = int(asking.sum()) if self._wall.has_height else 0
        counts["wall"] += asked
        if asked and self._walls is not None:
            kernels.wall_hits(*self._walls, origins, directions, asking, distance, kind, normal)
        elif asked:
            self._python_hits(origins, directions, asking, distance, kind, normal)
        world = self.world
        kernels.plate_and_lens(
            world.plate, world.picture, world.camera, world.norm, origins, directions, live, *ends
        )
        if self._mesh is not None:
            rows = np.flatnonzero(live)
            counts["mesh"] += len(rows)
            away, triangle = first_triangles(
                self._mesh.facets, origins[rows], directions[rows], min_distance=self._gap
            )
            normals = self._mesh.normals
            kernels.mesh_hits(self.world, rows, triangle, away, normals, directions, *ends)
        return ends

    def _python_hits(
        self,
        origins: Array,
        directions: Array,
        asking: NDArray[np.bool_],
        distance: Array,
        kind: NDArray[np.int16],
        normal: Array,
    ) -> None:
        """Fill in the hits on a wall of Python functions for the rays ``asking``."""
        from . import _surround_kernels as kernels

        rows = np.flatnonzero(asking)
        hits = intersect(self._wall, origins[rows], directions[rows])
        met, lost = rows[hits.hit], rows[hits.status == WallHits.UNRESOLVED]
        distance[met], normal[met] = hits.distance[hits.hit], hits.normals[hits.hit]
        kind[met], kind[lost], distance[lost] = kernels.WALL, kernels.LOST, 0.0

    def settle(self, points: Array, on_wall: NDArray[np.bool_]) -> None:
        """Move points (n, 3), where ``on_wall`` is set, exactly onto the wall.

        On a wall that sees itself, rays that start slightly behind it would miss it.
        """
        from . import _surround_kernels as kernels

        if self._walls is not None:
            kernels.settle(*self._walls[:2], points, on_wall)
        elif on_wall.any() and self._wall.has_height:
            points[on_wall, 2] = self._wall.derivatives(*points[on_wall, :2].T)[:, 0]

    def clear(
        self,
        starts: Array,
        ends: Array,
        on_wall: NDArray[np.bool_],
        value: Array,
        counts: Counter[str],
    ) -> None:
        """Set the ``value`` (n,) of blocked lines from ``starts`` to ``ends`` (n, 3), m, to zero.

        ``on_wall`` marks lines that start on the wall. ``counts`` is updated.
        """
        from . import _surround_kernels as kernels

        kernels.clear(self.world.plate, self.world.camera, starts, ends, value)
        if not (self.plan.wall_shadows or self._mesh is not None):
            return
        rows = np.flatnonzero(value > 0.0)
        # start at the end that is on the wall, since rays hit the wall from its front only, and
        # those that start on a mesh are slow
        turned = ~on_wall[rows, None]
        near = np.where(turned, ends[rows], starts[rows])
        lines = np.where(turned, starts[rows], ends[rows]) - near
        if len(rows) and self._mesh is not None:
            counts["shadow"] += len(rows)
            free = ~blocked(self._mesh.facets, near, lines)
            value[rows[~free]] = 0.0
            rows, near, lines = rows[free], near[free], lines[free]
        if len(rows) and self.plan.wall_shadows:
            counts["wall shadow"] += len(rows)
            value[rows[self._behind_wall(near, lines)]] = 0.0

    def _behind_wall(self, starts: Array, lines: Array) -> NDArray[np.bool_]:
        """Return whether the wall blocks lines (n, 3) from starts (n, 3); ends may lie on it."""
        from . import _surround_kernels as kernels

        length = np.sqrt((lines * lines).sum(axis=1))
        lines = lines / length[:, None]
        if self._walls is None:
            hits = intersect(self._wall, starts, lines)
            near = hits.hit & (np.nan_to_num(hits.distance) < length * (1.0 - 1e-9))
            return np.asarray(near | (hits.status == WallHits.UNRESOLVED))
        distance, kind = np.full(len(length), math.inf), np.full(len(length), -1, dtype=np.int16)
        live = np.ones(len(length), dtype=bool)
        kernels.wall_hits(*self._walls, starts, lines, live, distance, kind, np.zeros_like(starts))
        return np.asarray(distance < length * (1.0 - 1e-9))


def _triangles(scene: Scene) -> PreparedMesh | None:
    """Return all triangles as one mesh: of the hidden object, the occluders, and the wall."""
    meshes = [] if isinstance(scene.hidden, PlanarObject) else [scene.hidden.surface]
    if scene.occluding_mesh is not None:
        meshes.append(scene.occluding_mesh)
    if scene.wall.true_triangles is not None:
        meshes.append(scene.wall.true_triangles)
    return prepared_mesh(*meshes) if meshes else None


def _room(scene: Scene) -> tuple[Array, NDArray[np.int16]]:
    """Return `World.room` and `World.kinds` of the occluders and the wall's triangles."""
    from ._surround_kernels import OCCLUDER, ROOM, WALL

    tables: list[Array] = []
    kinds = [np.zeros(0, dtype=np.int16)]
    for mesh, material in scene.occluder_surfaces:
        kind = OCCLUDER
        if not material.is_black:
            kind = ROOM + len(tables)
            tables.append(material.lobe_table())
        kinds.append(np.full(len(mesh.faces), kind, dtype=np.int16))
    if (triangles := scene.wall.true_triangles) is not None:
        kinds.append(np.full(len(triangles.faces), WALL, dtype=np.int16))
    room = np.zeros((len(tables), max((len(table) for table in tables), default=1), 7))
    for lobes, table in zip(room, tables, strict=True):
        lobes[: len(table)] = table
    return room, np.concatenate(kinds)


def lit_patches(scene: Scene, chart: Chart) -> Array:
    """Return the densities, (p,), 1/m^2, with which the laser spot aims rays at patches of a mesh.

    All but an eighth of the rays are drawn in proportion to the light of a point at the
    laser spot that a patch would send to the point of the wall on the optical axis, both matt and
    nothing in between.
    """
    camera, laser = scene.camera, scene.laser
    weights = np.ones(len(chart.areas))
    for end, toward in ((laser.position, laser.aim), (camera.position, camera.aim)):
        away = _met(scene, end, toward) - chart.centres
        square = (away * away).sum(axis=1)
        # no nearer than the patch is wide
        facing = np.maximum((chart.normals * away).sum(axis=1), 0.0) * np.abs(away[:, 2])
        weights *= facing / (square + chart.areas) ** 2
    weights /= np.where(chart.areas > 0.0, chart.areas, 1.0)
    uniform = chart.areas / chart.area
    total = float(weights.sum())
    # an eighth is spread evenly, so that shadows and glossy lobes cost little elsewhere
    share = 0.875 * weights / total + 0.125 * uniform if total > 0.0 else uniform
    return np.asarray(share / np.where(chart.areas > 0.0, chart.areas, 1.0))


def _met(scene: Scene, start: Vector, toward: Vector) -> Array:
    """Return the point of the wall that a ray through two points meets, or else the second one."""
    beam = np.subtract(toward, start)
    if (triangles := scene.wall.true_triangles) is not None:
        hits: Any = intersect_mesh(triangles, start, beam)
    else:
        hits = intersect(scene.wall, start, beam)
    return hits.points if hits.hit else np.array(toward, dtype=np.float64)


def laser_row(laser: Laser) -> Array:
    """Return a laser as an array for the kernels, `World.laser`."""
    axis = np.subtract(laser.aim, laser.position)
    axis = axis / math.sqrt(float((axis * axis).sum()))
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= math.sqrt(float((across * across).sum()))
    sides = (axis, across, np.cross(axis, across))
    return np.concatenate([laser.position, *sides, [laser.beam_diameter / 2, laser.power]])


def _world(scene: Scene, plan: RayPlan, chains: int, analog: bool) -> World:
    """Return the data of a scene as arrays for the kernels; ``chains`` is `World.chains`."""
    from ._surround_kernels import World

    camera, hidden = scene.camera, scene.hidden
    thing = hidden if isinstance(hidden, PlanarObject) else prepared_mesh(hidden.surface)
    ny, nx = camera.shape
    half = 0.5 * camera.image_pitch * np.array([nx, ny])
    stop, area, baffle = -1.0, 4.0 * float(half.prod()), 0.0
    if camera.field_stop is not None:
        stop = math.cos(camera.field_stop / 2)
        # sample the disc that the baffle leaves of the detector plane if it is smaller
        slope = math.tan(camera.field_stop / 2) if stop > 0.1 else math.inf
        if math.pi * (slope * scene.image_distance) ** 2 < area:
            area, baffle = math.pi * (slope * scene.image_distance) ** 2, slope
    baffle *= scene.focus_distance
    optics = (camera.stop_diameter / 2, scene.focus_distance, scene.image_distance)
    rest = (stop, camera.transmission, area, baffle)
    picture, rows, columns = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0))
    plate, lit, none = np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64)
    chart = Chart(np.zeros((0, 9)), lit, none, lit, none.astype(np.int32), lit, lit, lit)
    room, kinds = _room(scene)
    if isinstance(thing, PlanarObject):
        picture = np.array(thing.reflectance)
        plate = np.concatenate([thing.position, thing.axes.ravel(), np.divide(thing.size, 2)])
        rows, columns = cumulative(picture.sum(axis=1)), cumulative(picture)
        total = float(picture.mean()) * thing.size[0] * thing.size[1]
        ball = ball_around(thing.corners)
    else:
        chart, total, ball = thing.chart, thing.chart.area, thing.ball
        lit = lit_patches(scene, chart)
    return World(
        wall=scene.wall_material.lobe_table(),
        thing=scene.hidden.material.lobe_table(),
        room=room,
        kinds=kinds,
        plate=plate,
        picture=picture,
        rows=rows,
        columns=columns,
        triangles=chart.triangles,
        areas=chart.shares,
        firsts=chart.firsts,
        splits=chart.splits,
        patches=chart.patches,
        lit_splits=chart_splits(lit * chart.areas),
        lit=lit,
        norm=1.0 / total if total > 0.0 else 0.0,
        aimed=np.array(
            AIMED[plan.wall_to_wall or len(room) > 0] if total > 0.0 and not analog else (0.0, 0.0)
        ),
        glossy=plan.glossy,
        chains=chains,
        ball=ball,
        camera=np.concatenate([camera.position, camera.frame.ravel(), optics, half, rest]),
        laser=laser_row(scene.laser),
    )
