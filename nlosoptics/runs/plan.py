"""Plan of a run: the stages that a scene needs, with predicted time, memory and error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from .. import _cost_model
from .._checks import (
    SHARE,
    Budget,
    available_memory,
    counted,
    fits_memory,
    in_range,
    positive,
    within,
)
from .._html import Column, table
from ..errors import SamplingError, SceneError
from ..imaging.image_fields import COUNTS, expected_counts, interpolation_errors, picture_frame
from ..imaging.images import BYTES_PER_PIXEL as IMAGE_BYTES
from ..imaging.objects import object_patches
from ..imaging.radiometry import background_work, laser_spot
from ..imaging.shadows import SHADOW_BYTES, check_beam
from ..psf.pupil.exit_pupil import ExitPupil, exit_pupil
from ..psf.pupil.obstruction import check_cone
from ..psf.pupil.paraxial import change_over_object
from ..psf.pupil.scene_optics import PointOptics, SceneOptics
from ..psf.walls.field import picture_point
from ..psf.walls.rough_wall import rough_choice, roughness_view
from ..psf.walls.scene_costs import Cost, grid_samples, point_cost
from ..psf.walls.scene_psf import point_window
from ..psf.window.error_bounds import rounded_up
from ..raytrace import ray_plan
from ..raytrace.intersection.meshes import threads
from ..scene import MeshWall, PlanarObject, Scene
from .refusals import check_cones, check_laser, check_sight, wave_refusal

FIELD = "field of point spreads"  # name of the stage
MEAN = "mean point spread"  # name of the stage
MOST_NODES = 27  # most nodes along each side of a field of point spreads
MOST_SECONDS = 900.0  # default of max_seconds, s
LARGEST_TOL = 0.1
CHECKS = 6  # object points at which a field of patterns is compared with patterns computed there
# Shift of a speckle pattern, in pupil diameters, at which the correlation of its intensity is one
# half, and the largest one between the points of a field of patterns.
HALF_CORRELATED, STEP = 0.231, 0.12
DIFFUSE_BYTES = 6e7  # bytes for the diffuse transport from one block of patches to the wall
HELD = 6e7  # bytes of the modules that a run imports
AIMING = {"flat": 2e-6, "": 7e-6, "callable": 2e-5}  # s per pupil node, by kind of wall
GRID_SECONDS = 0.9  # s for a wave and its point spread where the wall's edge cuts the cone
PIXELS = "read fewer pixels or bin more (camera.pixels, camera.binning)"
LARGER = "use a larger tol, wider pixels or a smaller stop"


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step of a plan.

    Parameters
    ----------
    name : str
        Name of the stage, for example ``"point spread"``.
    runs : bool
        Whether `simulate` carries it out.
    reason : str
        Why it runs or is skipped.
    seconds : float
        Predicted run time on one core, s, without compilation; 0 if skipped.
    error : str
        Predicted error and the quantity that it refers to.
    memory : float
        Predicted peak of the memory that the stage itself allocates, bytes.
    """

    name: str
    runs: bool
    reason: str
    seconds: float = 0.0
    error: str = ""
    memory: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Stages of a simulation, made by `plan`.

    Parameters
    ----------
    stages : tuple of Stage
        Stages that run, in order.
    skipped : tuple of Stage
        Stages that do not run, each with its reason.
    tol : float
        Error tolerance of the point spreads, max |dI|/max I, and of the image that a field of
        point spreads gives, rms over rms. The other stages state their own errors.
    waves : float
        Peak-to-valley aberration at the object's centre with tilt removed, waves; NaN if the wave
        is undefined.
    exit_pupil : ExitPupil
        Exit pupil of the scene, reused by `simulate`.
    budget : Budget
        Limits of memory and time for the run.
    pattern_nodes : int
        Object points along each side of the picture at which the speckle pattern of a rough wall is
        computed for the image. 0 if the image needs no pattern, or uses the mean over walls.
    """

    stages: tuple[Stage, ...]
    skipped: tuple[Stage, ...]
    tol: float
    waves: float
    exit_pupil: ExitPupil = field(compare=False, repr=False)
    budget: Budget = field(compare=False)
    pattern_nodes: int = 0

    @property
    def layout(self) -> Literal["polar", "grid"]:
        """Layout of the pupil nodes: ``"grid"`` where the wall's edge cuts the cone of light."""
        return self.exit_pupil.layout

    @property
    def memory(self) -> float:
        """Predicted peak increase of the process's memory during the run, bytes."""
        return HELD + max((stage.memory for stage in self.stages), default=0.0)

    @property
    def seconds(self) -> float:
        """Predicted run time on one core without compilation, s."""
        return sum(stage.seconds for stage in self.stages)

    def runs(self, name: str) -> bool:
        """Return whether the stage called ``name`` runs."""
        return any(stage.name == name for stage in self.stages)

    def __str__(self) -> str:
        """Return a table of all stages as text."""
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
        """Return a table of all stages as HTML."""
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
    """Predict which stages `simulate` runs or skips for a scene, with time, memory and error.

    Parameters
    ----------
    scene : Scene
        Scene to simulate.
    tol : float, default 1e-3
        Error tolerance of the point spreads, max |dI|/max I, and of the image that a field of
        point spreads gives, rms over rms; 1e-12 to 0.1.
    reconstruct : bool, default False
        Whether to include the reconstruction with known point spread.
    memory : float, optional
        Limit for the memory of the whole run, bytes; by default three quarters of the free memory.
    max_seconds : float, default 900
        Limit for the predicted run time on one core, s.

    Returns
    -------
    Plan
        Stages that run and stages that are skipped, with the reasons.

    Raises
    ------
    SceneError
        If the laser misses the wall, the camera cannot see the object in the wall, an occluder
        cuts the laser beam or part of the cone of light from the object's reference point, or an
        argument is out of range.
    CausticError
        If the wave aberration is not single-valued at the object's centre, corners or edges.
    SamplingError
        If ``tol`` cannot be reached, or the predicted time exceeds ``max_seconds``. The message
        states the time that is needed.
    MemoryLimitError
        If a stage would need more than ``memory``.

    See Also
    --------
    simulate : Run the plan.

    Notes
    -----
    The waves from the object's centre, corners and edges are computed, which takes some
    milliseconds each. Windows and sampling then follow from the same functions as in the run.

    Examples
    --------
    >>> from nlosoptics import Scene, plan
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> planned = plan(scene, tol=1e-2)
    >>> [stage.name for stage in planned.stages]
    ['exit pupil', 'wave aberration', 'point spread', 'image']
    >>> next(stage.reason for stage in planned.skipped if stage.name == "reconstruction")
    'not requested; torch is not loaded'
    """
    return looked_at(scene, tol, reconstruct, memory, max_seconds)[0]


def looked_at(
    scene: Scene,
    tol: float,
    reconstruct: bool,
    memory: float | None,
    max_seconds: float,
) -> tuple[Plan, SceneOptics]:
    """Return the result of `plan` together with the waves it computed, for reuse by the run."""
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
    waves, pattern = math.nan, None
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
        pattern = _Pattern.at(look, tol, budget.seconds) if own_pattern(scene) else None
        # over a large picture the image uses the mean over walls, whose field may vary as well
        imaged = look
        if pattern is not None and not pattern.nodes:
            imaged = _Look.at(mean_optics(optics), tol)
        heights = look.seen.first.residual.heights
        waves = (heights.high - heights.low) / scene.laser.wavelength
        stages += [
            *_wave_stages(scene, pupil, look, waves),
            _point_spread_stage(scene, pupil, look, tol),
            *_image_spread_stages(pupil, look, imaged, pattern, tol),
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
        pattern_nodes=pattern.nodes if pattern is not None else 0,
    )
    _check_budget(found)
    return found, optics


def _check_budget(found: Plan) -> None:
    """Raise if a plan exceeds its budget; the message names the most expensive stage."""
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
    """Waves at a few object points and the window sizes of their point spreads.

    Parameters
    ----------
    seen : PointOptics
        Wave and geometry at the object's reference point.
    others : tuple of PointOptics
        Waves and geometry at the picture's corners and edge centres; empty if no field of point
        spreads can be needed.
    side, field_side : int
        Side of the point spread's window at the centre, and of the largest window over the whole
        picture, pixels.
    samples : tuple of int
        Cells across the pupil grids that are tried in turn; empty for polar nodes.
    """

    seen: PointOptics
    others: tuple[PointOptics, ...]
    side: int
    field_side: int
    samples: tuple[int, ...]

    @classmethod
    def at(cls, optics: SceneOptics, tol: float) -> _Look:
        """Compute the waves; raises the same errors as the run if a wave is undefined."""
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
        """Estimated image error with a single point spread (rms over rms), and wave change, rad.

        The wave change is the largest peak-to-valley difference between the waves at the picture's
        corners and edges and the wave at its centre, less where pixels are wide. The error
        estimate was fitted to random scenes and is good to a factor of about three. Its terms are
        the wave change and the change of the lobe's blur if that is larger than a pixel.
        """
        scene, first = self.seen.scene, self.seen.first.residual
        unit, pitch = first.airy_unit, scene.camera.image_pitch
        own = self.seen.first.wave
        rough = max(scene.mirror_slopes)
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
        # a pixel n lambda N wide resolves phase differences across about 1/n of the pupil
        swing /= max(1.0, pitch / (4 * unit))
        waves = 2e-3 * swing * min(blurred, 4.0)
        if rough > 0:
            turn = self.seen.view.cos_sum * float(np.linalg.norm(self.seen.view.footprint, 2))
            halo = rough * turn * abs(own.image_distance) / pitch
            waves += 0.2 * turned * min(1.0, (halo / 2) ** 4)
        return min(0.3, waves), swing

    @property
    def cut(self) -> float:
        """Fraction of the corner and edge points whose cone of light the wall's edge cuts."""
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
        reason="smooth bicubic surface through the mesh, fitted during planning",
        seconds=0.001,
        error=f"{1e9 * scene.wall.fit_residual:.2g} nm; "
        f"the triangles {1e9 * scene.wall.mesh_error:.2g} nm",
    )


def _wave_stages(scene: Scene, pupil: ExitPupil, look: _Look, waves: float) -> Iterator[Stage]:
    flat = scene.wall.is_flat
    if flat:
        yield _skipped("aiming", "flat wall: hits in closed form")
    reason = "zero except defocus" if flat else f"rays aimed by Newton; {waves:.2g} waves"
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
    """Predicted cost of one point spread, including the coarser grids that are tried first."""
    pitch, shape = scene.camera.image_pitch, (side, side)
    found = [point_cost(look.seen, pitch, shape, tol, cells=n) for n in look.samples or (0,)]
    seconds = _cost_model.seconds(transforms=sum(c.seconds for c in found))
    return Cost(seconds, found[-1].n_bytes)


def _point_spread_stage(scene: Scene, pupil: ExitPupil, look: _Look, tol: float) -> Stage:
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    slope = max(scene.mirror_slopes, default=0.0)
    blur = f", blurred by the lobe's slopes of {slope:g} rad" if slope > 0 else ""
    if scene.wall_roughness is not None:
        blur = f"; {rough_choice(look.seen, pitch, (look.side, look.side), tol).reason}"
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


def own_pattern(scene: Scene) -> bool:
    """Return whether the wall has a roughness whose own speckle pattern is wanted."""
    rough = scene.wall_roughness
    return rough is not None and rough.realisation == "pattern"


def uses_mean(todo: Plan, scene: Scene) -> bool:
    """Return whether the image of a plan uses the mean over walls instead of this wall's pattern."""
    return own_pattern(scene) and todo.pattern_nodes == 0


def mean_optics(optics: SceneOptics) -> SceneOptics:
    """Return the optics of the same scene with the mean over all walls of its roughness."""
    rough = optics.scene.wall_roughness
    assert rough is not None
    scene = replace(optics.scene, wall_roughness=replace(rough, realisation="mean"))
    return SceneOptics(scene, optics.exit_pupil)


@dataclass(frozen=True)
class _Pattern:
    """Change of a rough wall's speckle pattern over the picture.

    Parameters
    ----------
    nodes : int
        Object points along each side of the picture at which the pattern is computed; 0 if they
        would be too many.
    needed : int
        Points that would resolve its change.
    reach : float
        Distance on the object at which the pattern's correlation has fallen to one half, m.
    error : float
        Expected difference between the image by the mean and that of this wall, relative to the
        image.
    """

    nodes: int
    needed: int
    reach: float
    error: float

    @classmethod
    def at(cls, look: _Look, tol: float, seconds: float) -> _Pattern:
        """Compare the shift of the pattern in the pupil with the pupil's diameter."""
        seen, scene = look.seen, look.seen.scene
        rough, hidden = scene.wall_roughness, scene.hidden
        assert rough is not None
        if not isinstance(hidden, PlanarObject) or not look.others:
            return cls(0, 0, math.nan, math.nan)
        wave, view = seen.first.wave, seen.view
        back = np.linalg.inv(view.footprint) @ view.tangents
        shifts = [float(np.linalg.norm(back @ (one.view.point - view.point))) for one in look.others]
        far = [float(np.linalg.norm(one.object_point - seen.object_point)) for one in look.others]
        relative = max(shifts) / (2 * wave.pupil_radius)
        rate = max(s / d for s, d in zip(shifts, far, strict=True)) / (2 * wave.pupil_radius)
        reach = HALF_CORRELATED / rate
        needed = max(1, math.ceil(math.pi * relative / STEP))
        one = _spread_cost(scene, look, look.field_side, tol / 2)
        fits = needed <= MOST_NODES and (needed**2 + CHECKS) * one.seconds <= seconds / 2
        # light of few facets in a pixel fluctuates; the picture averages over patterns
        patch = math.pi * wave.pupil_radius**2 * abs(float(np.linalg.det(view.footprint)))
        facets = max(1.0, patch / (rough.heights.finest_period**2))
        halo = roughness_view(seen, pattern=False).halo(wave) / 3 + scene.camera.image_pitch / 2
        share = min(1.0, scene.camera.image_pitch**2 / (2 * math.pi * halo**2))
        spot = halo * scene.focus_distance / scene.image_distance
        averaged = 1.0 + math.pi * spot**2 / reach**2
        return cls(needed if fits else 0, needed, reach, 1 / math.sqrt(facets * share * averaged))


def _image_spread_stages(
    pupil: ExitPupil, look: _Look, imaged: _Look, pattern: _Pattern | None, tol: float
) -> Iterator[Stage]:
    """Yield the stages that compute the point spreads of the image."""
    scene = look.seen.scene
    if pattern is None:
        yield _field_stage(scene, pupil, look, tol)
        return
    if pattern.nodes == 1:
        yield _skipped(FIELD, "one pattern holds over the whole picture")
        return
    within = f"the wall's pattern holds within {1e3 * pattern.reach:.2g} mm of the object"
    if pattern.nodes:
        one = _spread_cost(scene, look, look.field_side, tol / 2)
        n = pattern.nodes
        yield Stage(
            name=FIELD,
            runs=True,
            reason=f"{within}; {n} x {n} patterns, {look.field_side} x {look.field_side} pixels",
            seconds=(n * n + CHECKS) * one.seconds,
            error="that of interpolated patterns is measured",
            memory=40.0 * n * n * look.field_side**2 + one.n_bytes * threads(),
        )
        return
    why = "the object is a mesh"
    if pattern.needed:
        why = f"{within}, so that {pattern.needed} x {pattern.needed} patterns would be needed"
    cost = _spread_cost(imaged.seen.scene, imaged, imaged.side, tol)
    yield Stage(
        name=MEAN,
        runs=True,
        reason=f"the image uses the mean over all walls of this roughness: {why}",
        seconds=cost.seconds,
        error=f"this wall's image differs by about {100 * pattern.error:.2g} %"
        if pattern.needed
        else "",
        memory=cost.n_bytes,
    )
    yield _field_stage(imaged.seen.scene, pupil, imaged, tol)


def _field_stage(scene: Scene, pupil: ExitPupil, look: _Look, tol: float) -> Stage:
    """Decide whether point spreads at several object points are needed, and estimate how many."""
    if not isinstance(scene.hidden, PlanarObject):
        return _skipped(FIELD, "one point spread is used for the whole mesh; positions are exact")
    if not scene.wall_material.mirror_lobes:
        return _skipped(FIELD, "a wall without a mirror-like lobe forms no image")
    if look.samples:
        return _skipped(
            FIELD, "one point spread, on a grid, is used for the object; positions are exact"
        )
    change = change_over_object(scene, pupil)
    if change <= tol:
        return _skipped(
            FIELD, f"one point spread is enough: it changes over the object by {change:.1g} at most"
        )
    error, swing = look.change
    decay = interpolation_errors(scene)
    # the error estimate is uncertain by a factor of 3 either way; take the geometric mean
    found = [expected_counts(doubt * error, swing, tol, decay) for doubt in (1 / 3, 1.0, 3.0)]
    ends = [counts for counts, _ in found]
    # a fast change of phase may average out within wide pixels; that of the curvature does not
    left = expected_counts(error, 0.0, tol, decay)[1]
    if left > tol:
        wider = f"use tol = {1.1 * left:.2g}, or" if 1.1 * left < 0.1 else "use"
        raise SamplingError(
            f"the wall's shape changes too fast over the picture: with {COUNTS[-1]} x "
            f"{COUNTS[-1]} point spreads its image would still change by about {left:.2g} of its "
            f"rms, limit tol = {tol:g}; {wider} a smaller picture"
        )
    spreads = math.prod(float(sum(n**2 for n in counts)) for counts in ends) ** (1 / 3)
    waves = spreads + sum(min(n**2, 5) for n in ends[1])
    counts = ends[-1]
    check_cones(scene, counts)
    one = _spread_cost(scene, look, look.field_side, tol / 2)
    each = one.seconds + look.cut * _cost_model.seconds(transforms=GRID_SECONDS)
    aimed = _aiming_seconds(scene, look.seen.first.wave.u.size)
    held = 40.0 * counts[-1] ** 2 * look.field_side**2
    compared = 80.0 * counts[-1] * picture_frame(scene).size  # images computed from the modes
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
        "wall-to-wall light is not part of the image; raytrace.trace computes its amount"
        if ray_plan(scene).wall_to_wall
        else "no part of the wall sees another",
    )
    if not ray_plan(scene).embree:
        yield _skipped("embree", "no triangles: the object is a flat picture, without occluders")


def _shadow_stage(scene: Scene) -> Stage:
    if not scene.occluders:
        return _skipped("shadow rays", "no occluders")
    count = len(scene.occluders)
    reason = f"{counted(count, 'occluder')} between spot, object, wall and lens"
    if check_cone(scene):
        reason += "; the object's reference point is hidden"
    ny, nx = scene.camera.shape
    return Stage(
        name="shadow rays",
        runs=True,
        reason=reason,
        seconds=_cost_model.seconds(arrays=0.5 + 1e-5 * nx * ny),
        error="some hundredths at shadow edges",
        memory=SHADOW_BYTES * nx * ny,
    )


def _image_stage(scene: Scene) -> Stage:
    camera = scene.camera
    ny, nx = camera.shape
    reason = f"{nx} x {ny} pixels by reverse chief rays"
    if (n := camera.binning) > 1:
        across, up = camera.pixels
        reason += f"; each sums {n} x {n} of the sensor's {across} x {up} (camera.binning = {n})"
    if scene.wall_material.specular_reflectance == 0:
        reason += "; background only, because the wall has no mirror-like lobe"
    return Stage(
        name="image",
        runs=True,
        reason=reason,
        seconds=_image_seconds(scene),
        error="1e-3 of the background",
        memory=IMAGE_BYTES * nx * ny + DIFFUSE_BYTES,
    )


def _image_seconds(scene: Scene) -> float:
    """Predicted seconds of `form_image`: diffuse transport from the object patches, and pixels."""
    pixels = float(math.prod(scene.camera.shape))
    pairs, groups = background_work(scene, object_patches(scene.hidden))
    if scene.wall.is_flat:
        return _cost_model.seconds(calls=0.018, arrays=4e-7 * pairs + 1.2e-6 * pixels)
    arrays = 2.2e-7 * pairs + 4.2e-7 * groups * pixels + 1.6e-6 * pixels
    return _cost_model.seconds(calls=0.02 + 5e-4 * groups, arrays=arrays)


def _reconstruction_stage(scene: Scene, wanted: bool) -> Stage:
    if not wanted:
        return _skipped("reconstruction", "not requested; torch is not loaded")
    if scene.wall_material.specular_reflectance == 0:
        return _skipped(
            "reconstruction", "a diffuse wall without a mirror-like lobe forms no image"
        )
    ny, nx = scene.camera.shape
    return Stage(
        name="reconstruction",
        runs=True,
        reason="total-variation deconvolution with known pose and point spread",
        seconds=_cost_model.seconds(transforms=1.3 + 3e-6 * nx * ny),
        memory=2000.0 * nx * ny,
        error="status and score are reported",
    )
