"""The plan of a run: stages that a scene needs or does not, with seconds, memory and errors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .. import _cost_model
from .._checks import SHARE, Budget, available_memory, fits_memory, in_range, positive, within
from .._html import Column, table
from ..errors import SamplingError, SceneError
from ..imaging.image_fields import expected_counts, picture_frame
from ..imaging.images import BYTES_PER_PIXEL as IMAGE_BYTES
from ..imaging.objects import object_patches
from ..imaging.radiometry import background_work, laser_spot
from ..imaging.shadows import SHADOW_BYTES, check_beam
from ..psf.pupil.exit_pupil import ExitPupil, exit_pupil
from ..psf.pupil.obstruction import check_cone
from ..psf.pupil.paraxial import change_over_object
from ..psf.pupil.scene_optics import PointOptics, SceneOptics
from ..psf.walls.field import picture_point
from ..psf.walls.scene_costs import Cost, grid_samples, point_cost
from ..psf.walls.scene_psf import point_window
from ..psf.window.error_bounds import rounded_up
from ..raytrace import ray_plan
from ..raytrace.intersection.meshes import threads
from ..scene import MeshWall, PlanarObject, Scene
from .refusals import check_cones, check_laser, check_sight, wave_refusal

FIELD = "field of point spreads"  # the name of that stage
MOST_NODES = 27  # along each side of a field of point spreads
MOST_SECONDS = 900.0  # of a run where nobody says
LARGEST_TOL = 0.1
DIFFUSE_BYTES = 6e7  # of light from a block of patches to the wall
HELD = 6e7  # bytes of what Python loads on the way
AIMING = {"flat": 2e-6, "": 7e-6, "callable": 2e-5}  # s a node
GRID_SECONDS = 0.9  # of a point spread whose cone the wall's edge cuts, with its wave
PIXELS = "read fewer pixels or bin more (camera.pixels, camera.binning)"
LARGER = "use a larger tol, wider pixels or a smaller stop"


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step of a plan.

    Parameters
    ----------
    name : str
    runs : bool
        Whether `simulate` carries it out.
    reason : str
        Why it runs, or why not.
    seconds : float
        Predicted run time on one core once compiled; 0 when skipped.
    error : str
        Predicted error, with its meaning.
    memory : float
        Predicted bytes at its peak, of what it allocates itself.
    """

    name: str
    runs: bool
    reason: str
    seconds: float = 0.0
    error: str = ""
    memory: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The stages of a simulation.

    Parameters
    ----------
    stages : tuple of Stage
        Those that run, in order.
    skipped : tuple of Stage
        Those that do not, each with its reason.
    tol : float
        Wanted error of point spreads, max |dI|/max I, and of the image by their field; the other
        stages state their own.
    waves : float
        Peak-to-valley aberration of the object's centre left after tilt, waves; NaN without a wave.
    exit_pupil : ExitPupil
        Exit pupil of the scene, which `simulate` goes on with.
    budget : Budget
        What the run may take.
    """

    stages: tuple[Stage, ...]
    skipped: tuple[Stage, ...]
    tol: float
    waves: float
    exit_pupil: ExitPupil = field(compare=False, repr=False)
    budget: Budget = field(compare=False)

    @property
    def layout(self) -> Literal["polar", "grid"]:
        """Layout of the pupil nodes: a grid where the wall's edge cuts the cone of light."""
        return self.exit_pupil.layout

    @property
    def memory(self) -> float:
        """Predicted rise of the process's memory at the peak of the run, bytes."""
        return HELD + max((stage.memory for stage in self.stages), default=0.0)

    @property
    def seconds(self) -> float:
        """Predicted run time, s, once compiled."""
        return sum(stage.seconds for stage in self.stages)

    def runs(self, name: str) -> bool:
        """Whether the stage of that name runs."""
        return any(stage.name == name for stage in self.stages)

    def __str__(self) -> str:
        """Table of all stages."""
        rows = [("stage", "", "seconds", "error", "why")]
        for s in self.stages:
            rows.append((s.name, "runs", f"{s.seconds:.2f}", s.error, s.reason))
        for s in self.skipped:
            rows.append((s.name, "skipped", "", "", s.reason))
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False))
            + "  "
            + row[4]
            for row in rows
        ]
        return "\n".join(line.rstrip() for line in lines)

    def _repr_html_(self) -> str:
        """Table of all stages."""
        runs = [(s.name, f"{s.seconds:.2f}", s.error, s.reason) for s in self.stages]
        skipped = [(s.name, "skipped", "", s.reason) for s in self.skipped]
        return table(
            f"Plan: {self.seconds:.2g} s predicted, to {self.tol:g} of the peak",
            [Column(head) for head in ("stage", "seconds", "error", "why")],
            [*runs, *skipped],
            styled=True,
        )


def plan(
    scene: Scene,
    tol: float = 1e-3,
    *,
    reconstruct: bool = False,
    memory: float | None = None,
    max_seconds: float = MOST_SECONDS,
) -> Plan:
    """Say what a scene needs, what it does not, and why.

    Parameters
    ----------
    scene : Scene
    tol : float, default 1e-3
        Wanted error of point spreads, max |dI|/max I, and of the image by their field, rms over
        rms; 1e-12 to 0.1.
    reconstruct : bool, default False
        Whether the known-PSF reconstruction is wanted.
    memory : float, optional
        Bytes that the whole run may take; three quarters of what is free by default.
    max_seconds : float, default 900
        Predicted seconds on one core that the whole run may take.

    Returns
    -------
    Plan

    Raises
    ------
    SceneError
        If the laser misses the wall, the camera cannot see the object by the wall, an occluder
        cuts the beam or a part of the cone of light from the object's reference point, or an
        argument is out of range.
    CausticError
        If the wall has no single wave at the object's centre, corners or edges.
    SamplingError
        If ``tol`` is out of reach or takes longer than ``max_seconds``: with what it would take.
    MemoryLimitError
        If a stage would take more than ``memory``.

    Notes
    -----
    The waves from the object's centre, corners and edges are aimed, some milliseconds each; windows
    and sampling follow from them by the functions that the run itself uses.
    """
    return looked_at(scene, tol, reconstruct, memory, max_seconds)[0]


def looked_at(
    scene: Scene,
    tol: float,
    reconstruct: bool,
    memory: float | None,
    max_seconds: float,
) -> tuple[Plan, SceneOptics]:
    """`plan`, and the optics that it looked at, for the run to go on with."""
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    in_range("tol", tol, 1e-12, LARGEST_TOL)
    memory = SHARE * available_memory() if memory is None else positive("memory", memory, unit="B")
    budget = Budget(memory, positive("max_seconds", max_seconds, unit="s"))
    with within(budget):
        return _plan(scene, tol, reconstruct, budget)


def _plan(scene: Scene, tol: float, reconstruct: bool, budget: Budget) -> tuple[Plan, SceneOptics]:
    image = _image_stage(scene)
    ny, nx = scene.camera.shape
    fits_memory(
        f"an image of {nx} x {ny} pixels", HELD + image.memory, f"{PIXELS}, or give more memory"
    )
    check_laser(scene)
    pupil = exit_pupil(scene)
    check_sight(scene, pupil)
    optics, refusal = SceneOptics(scene, pupil), wave_refusal(scene)
    stages = [
        _mesh_stage(scene),
        Stage(
            name="exit pupil",
            runs=True,
            reason=f"the {pupil.stop} limits: radius {1e3 * pupil.radius:.3g} mm, "
            f"F/{pupil.f_number:.3g}",
            seconds=0.001,
            error="exact for a thin lens",
        ),
    ]
    waves = math.nan
    if refusal:
        runs = ("wave aberration", "point spread", FIELD, "shadow rays", "image", "reconstruction")
        stages += [_skipped(name, refusal) for name in runs]
        stages += _left_out(scene)
    else:
        scene.check_in_front()
        spot = laser_spot(scene)
        if scene.occluding_mesh is not None:
            check_beam(scene, scene.occluding_mesh, spot)
        look = _Look.at(optics, tol)
        heights = look.seen.first.residual.heights
        waves = (heights.high - heights.low) / scene.laser.wavelength
        stages += [
            *_wave_stages(scene, pupil, look, waves),
            _point_spread_stage(scene, pupil, look, tol),
            _field_stage(scene, pupil, look, tol),
            *_left_out(scene),
            _shadow_stage(scene),
            image,
            _reconstruction_stage(scene, reconstruct),
        ]
    found = Plan(
        stages=tuple(s for s in stages if s.runs),
        skipped=tuple(s for s in stages if not s.runs),
        tol=tol,
        waves=waves,
        exit_pupil=pupil,
        budget=budget,
    )
    _check_budget(found)
    return found, optics


def _check_budget(found: Plan) -> None:
    """Refuse a plan that passes its budget, naming the stage that takes the most."""
    if not found.stages:
        return
    most = max(found.stages, key=lambda s: s.memory)
    remedy = PIXELS if most.name in ("image", "shadow rays") else LARGER
    fits_memory(f"the stage '{most.name}'", HELD + most.memory, f"{remedy}, or give more memory")
    limit = found.budget.seconds
    if found.seconds > limit:
        longest = max(found.stages, key=lambda s: s.seconds)
        remedy = "leave the reconstruction out" if longest.name == "reconstruction" else LARGER
        raise SamplingError(
            f"the run would take about {found.seconds:.3g} s, {longest.seconds:.3g} s of them for "
            f"'{longest.name}' ({longest.reason}), limit max_seconds = {limit:g}; {remedy}, or "
            f"max_seconds = {rounded_up(found.seconds)}"
        )


@dataclass(frozen=True, eq=False)
class _Look:
    """The wave of the object's centre, and the windows that its point spreads take.

    Parameters
    ----------
    seen : PointOptics
        Of the object's reference point.
    others : tuple of PointOptics
        Of the picture's corners and edges, where its field may be wanted.
    side, field_side : int
        Pixels of the window at the centre, and of one that holds those of the whole picture.
    samples : tuple of int
        Cells across the grids that are tried in turn; empty of polar nodes.
    """

    seen: PointOptics
    others: tuple[PointOptics, ...]
    side: int
    field_side: int
    samples: tuple[int, ...]

    @classmethod
    def at(cls, optics: SceneOptics, tol: float) -> _Look:
        """Aim the waves; raises what the run would raise for want of a wave."""
        scene, seen = optics.scene, optics.reference
        pitch = scene.camera.image_pitch
        side = point_window(seen, pitch, tol)
        if seen.first.wave.layout == "grid":
            samples = grid_samples(seen.first.residual, pitch, side, tol)
            return cls(seen, (), side, side, samples)
        others: tuple[PointOptics, ...] = ()
        if isinstance(scene.hidden, PlanarObject) and scene.wall_material.mirror_lobes:
            places = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
            others = tuple(optics.at(picture_point(scene.hidden, x, y)) for x, y in places)
        sides = (point_window(one, pitch, tol / 2) for one in others)
        return cls(seen, others, side, max(sides, default=side), ())

    @property
    def change(self) -> tuple[float, float]:
        """About how much the picture's image errs with one point spread, and the waves' swing, rad.

        The first is rms over rms. Measured on random scenes, to a factor of about three: what the
        waves' differences do, less where pixels are wide, and what those of the lobes' blur do
        where it shows in the pixels.
        """
        scene, first = self.seen.scene, self.seen.first.residual
        unit, pitch = first.airy_unit, scene.camera.image_pitch
        own = self.seen.first.wave
        rough = max(lobe.slope_rms for lobe in scene.wall_material.mirror_lobes)
        swing = turned = 0.0
        for one in self.others:
            found = one.first.wave
            if found.layout == own.layout:
                other = one.first.residual.aberration - first.aberration
                swing = max(swing, first.wavenumber * float(np.ptp(other)))
            if rough > 0:
                turns = [v.cos_sum * v.footprint for v in (self.seen.view, one.view)]
                off = float(np.linalg.norm(turns[1] - turns[0]) / np.linalg.norm(turns[0]))
                turned = max(turned, off)
        blurred = 1.0 + first.rays.reach / unit
        waves = 2e-3 * swing * min(blurred, 4.0) / max(1.0, pitch / (4 * unit))
        if rough > 0:
            turn = self.seen.view.cos_sum * float(np.linalg.norm(self.seen.view.footprint, 2))
            halo = rough * turn * abs(own.image_distance) / pitch
            waves += 0.2 * turned * min(1.0, (halo / 2) ** 4)
        return min(0.3, waves), swing

    @property
    def cut(self) -> float:
        """Share of the points whose cone of light the wall's edge cuts."""
        grids = [one.first.wave.layout == "grid" for one in self.others]
        return sum(grids) / len(grids) if grids else 0.0


def _skipped(name: str, reason: str) -> Stage:
    return Stage(name=name, runs=False, reason=reason)


def _mesh_stage(scene: Scene) -> Stage:
    if not isinstance(scene.wall, MeshWall):
        return _skipped("mesh surface", "the wall is analytic")
    return Stage(
        name="mesh surface",
        runs=True,
        reason="a smooth bicubic surface through the mesh, which the plan has fitted",
        seconds=0.001,
        error=f"{1e9 * scene.wall.fit_residual:.2g} nm; "
        f"the triangles {1e9 * scene.wall.mesh_error:.2g} nm",
    )


def _wave_stages(scene: Scene, pupil: ExitPupil, look: _Look, waves: float) -> Iterator[Stage]:
    flat = scene.wall.is_flat
    if flat:
        yield _skipped("aiming", "flat wall: hits in closed form")
    reason = "zero but for focus" if flat else f"rays aimed by Newton; {waves:.2g} waves"
    nodes = float(look.seen.first.wave.u.size)
    if look.samples:
        cut = "the wall's outline is the stop"
        if pupil.stop == "lens":
            cut = f"the wall's edge cuts {100 * pupil.vignetting:.2g} % of the cone"
        reason += f"; on a grid, because {cut}"
        nodes = float(sum(n**2 for n in look.samples))
    yield Stage(
        name="wave aberration",
        runs=True,
        reason=reason,
        seconds=(1 + len(look.others)) * _aiming_seconds(scene, nodes),
        error="the mesh surface's" if isinstance(scene.wall, MeshWall) else "1e-9 wave",
        memory=400.0 * max((*look.samples, 48)) ** 2,
    )


def _aiming_seconds(scene: Scene, nodes: float) -> float:
    """Predicted seconds of aiming a wave at ``nodes`` pupil nodes."""
    kind = "flat" if scene.wall.is_flat else "" if scene.wall.is_compiled else "callable"
    return _cost_model.seconds(calls=2e-3, arrays=AIMING[kind] * nodes)


def _spread_cost(scene: Scene, look: _Look, side: int, tol: float) -> Cost:
    """Predicted cost of one point spread, including the coarser grids that are tried before."""
    pitch, shape = scene.camera.image_pitch, (side, side)
    found = [point_cost(look.seen, pitch, shape, tol, cells=n) for n in look.samples or (0,)]
    seconds = _cost_model.seconds(transforms=sum(c.seconds for c in found))
    return Cost(seconds, found[-1].n_bytes)


def _point_spread_stage(scene: Scene, pupil: ExitPupil, look: _Look, tol: float) -> Stage:
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    slope = max((lobe.slope_rms for lobe in scene.wall_material.mirror_lobes), default=0.0)
    blur = f", blurred by the lobe's slopes of {slope:g} rad" if slope > 0 else ""
    cost = _spread_cost(scene, look, look.side, tol)
    return Stage(
        name="point spread",
        runs=True,
        reason=f"at the object's centre, {look.side} x {look.side} pixels; a pixel is "
        f"{pitch / core:.3g} lambda N wide{blur}",
        seconds=cost.seconds,
        error=f"{tol:g} of the peak",
        memory=cost.n_bytes,
    )


def _field_stage(scene: Scene, pupil: ExitPupil, look: _Look, tol: float) -> Stage:
    """Whether point spreads at several object points are needed, and about how many."""
    if not isinstance(scene.hidden, PlanarObject):
        return _skipped(FIELD, "one point spread stands for the mesh; positions are exact")
    if not scene.wall_material.mirror_lobes:
        return _skipped(FIELD, "a wall without a mirror-like lobe shows no picture")
    if look.samples:
        return _skipped(
            FIELD, "one point spread on a grid stands for the object; positions are exact"
        )
    change = change_over_object(scene, pupil)
    if change <= tol:
        return _skipped(
            FIELD, f"one point spread stands for the object: changes of it stay below {change:.1g}"
        )
    error, swing = look.change
    # in the middle of what the estimate's doubt of a factor of three allows
    ends = [expected_counts(doubt * error, swing, tol) for doubt in (1 / 3, 1.0, 3.0)]
    spreads = math.prod(float(sum(n**2 for n in counts)) for counts in ends) ** (1 / 3)
    waves = spreads + sum(min(n**2, 5) for n in ends[1])
    counts = ends[-1]
    check_cones(scene, counts)
    one = _spread_cost(scene, look, look.field_side, tol / 2)
    each = one.seconds + look.cut * _cost_model.seconds(transforms=GRID_SECONDS)
    aimed = _aiming_seconds(scene, look.seen.first.wave.u.size)
    held = 40.0 * counts[-1] ** 2 * look.field_side**2
    compared = 80.0 * counts[-1] * picture_frame(scene).size  # images by the modes
    return Stage(
        name=FIELD,
        runs=True,
        reason=f"point spreads change over the object; about {ends[1][-1]} x {ends[1][-1]} of "
        f"them, {look.field_side} x {look.field_side} pixels",
        seconds=spreads * each + waves * aimed + 5e-10 * held * counts[-1] ** 2,
        error=f"{tol:g} of the image, rms",
        memory=held + compared + one.n_bytes * threads(),
    )


def _left_out(scene: Scene) -> Iterator[Stage]:
    """Yield the effects that `simulate` does not compute for this scene."""
    yield _skipped(
        "interreflection",
        "light from wall to wall is left out of the image; raytrace.trace tells how much it is"
        if ray_plan(scene).wall_to_wall
        else "no part of the wall sees another",
    )
    if not ray_plan(scene).embree:
        yield _skipped("embree", "no triangles: the object is a picture and nothing is in the way")


def _shadow_stage(scene: Scene) -> Stage:
    if not scene.occluders:
        return _skipped("shadow rays", "no occluders")
    count = len(scene.occluders)
    reason = f"{count} occluder{'s' if count > 1 else ''} between spot, object, wall and lens"
    if check_cone(scene):
        reason += "; the object's reference point is hidden"
    ny, nx = scene.camera.shape
    return Stage(
        name="shadow rays",
        runs=True,
        reason=reason,
        seconds=_cost_model.seconds(arrays=0.5 + 1e-5 * nx * ny),
        error="some hundredths in a shadow's edge",
        memory=SHADOW_BYTES * nx * ny,
    )


def _image_stage(scene: Scene) -> Stage:
    ny, nx = scene.camera.shape
    reason = f"{nx} x {ny} pixels by reverse chief rays"
    if scene.wall_material.specular_reflectance == 0:
        reason += "; no mirror-like lobe, so background only"
    return Stage(
        name="image",
        runs=True,
        reason=reason,
        seconds=_image_seconds(scene),
        error="1e-3 of the background",
        memory=IMAGE_BYTES * nx * ny + DIFFUSE_BYTES,
    )


def _image_seconds(scene: Scene) -> float:
    """Predicted seconds of `form_image`: diffuse light from every object patch, and the pixels."""
    pixels = float(math.prod(scene.camera.shape))
    pairs, groups = background_work(scene, object_patches(scene.hidden))
    if scene.wall.is_flat:
        return _cost_model.seconds(calls=0.018, arrays=4e-7 * pairs + 1.2e-6 * pixels)
    arrays = 2.2e-7 * pairs + 4.2e-7 * groups * pixels + 1.6e-6 * pixels
    return _cost_model.seconds(calls=0.02 + 5e-4 * groups, arrays=arrays)


def _reconstruction_stage(scene: Scene, wanted: bool) -> Stage:
    if not wanted:
        return _skipped("reconstruction", "not asked for; torch is not loaded")
    if scene.wall_material.specular_reflectance == 0:
        return _skipped(
            "reconstruction", "a diffuse wall without a mirror-like lobe passes no picture"
        )
    ny, nx = scene.camera.shape
    return Stage(
        name="reconstruction",
        runs=True,
        reason="total variation with pose and point spread known",
        seconds=_cost_model.seconds(transforms=1.3 + 3e-6 * nx * ny),
        memory=2000.0 * nx * ny,
        error="status and score are reported",
    )
