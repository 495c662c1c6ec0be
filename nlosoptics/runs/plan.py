"""Plan of a run: the stages that a scene needs, with predicted time, memory and error."""

from __future__ import annotations

import itertools
import math
import shutil
import textwrap
from dataclasses import dataclass, field
from typing import Literal

from .._checks import (
    SHARE,
    Budget,
    available_memory,
    fits_memory,
    in_range,
    lasting,
    positive,
    within,
)
from .._html import Column, table
from ..errors import SamplingError, SceneError
from ..imaging.radiometry import check_beam, laser_spot, lit_spot
from ..psf.pupil.exit_pupil import ExitPupil, exit_pupil
from ..psf.pupil.scene_optics import SceneOptics
from ..psf.window.error_bounds import rounded_up
from ..scene import Scene
from .patterns import Pattern, burst_stages, image_spread_stages, mean_optics, own_pattern
from .refusals import check_laser, check_sight, check_wave
from .stages import (
    FIELD,
    Look,
    Stage,
    image_stage,
    is_matt,
    left_out,
    mesh_stage,
    point_spread_stage,
    reconstruction_stage,
    shadow_stage,
    skipped,
    wave_stages,
)

__all__ = ["FIELD", "Plan", "Stage", "looked_at", "plan"]

MOST_SECONDS = 900.0  # default of max_seconds, s
HELD = 1.3e8  # bytes of modules and compiled kernels that a run loads
PIXELS = "read fewer pixels or bin more (camera.pixels, camera.binning)"
LARGER = "use a larger tol, wider pixels or a smaller stop"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Stages of a simulation with predicted time, memory and error, from the function `plan`.

    ``print`` shows them as a table.

    Parameters
    ----------
    stages : tuple of Stage
        Steps that the simulation runs, in order. Each has ``name``, ``reason``, ``seconds``
        (predicted run time, s), ``error`` (predicted error, a text) and ``memory`` (bytes).
    skipped : tuple of Stage
        Steps that do not run, each with its reason.
    tol : float
        Error tolerance of the point spread functions (PSFs), max |dI|/max I, with I the intensity.
        If the PSF varies over the object, ``tol`` also limits the error of the image (rms error
        over rms value). Other stages state their own errors.
    waves : float
        Peak-to-valley wave aberration at the object's centre with tilt removed, waves; NaN for a
        wall without a mirror-like lobe.
    exit_pupil : ExitPupil or None
        Exit pupil of the scene, reused by `simulate`; None for a wall without a mirror-like lobe,
        which forms no image.
    budget : Budget
        Limits of memory and time of the run.
    pattern_nodes : int
        For a rough wall with ``realisation="pattern"``, whose PSF is a speckle pattern that changes
        over the object: the PSF is computed at n x n object points, with n = ``pattern_nodes``. The
        value is 0 if more than 27 x 27 points or half of ``max_seconds`` would be needed, if the
        object is a mesh, or if the wall's edge cuts the cone of light. The camera image is then
        computed with the mean PSF of many walls of the same statistics. For all other walls the
        value is 0 as well.

    See Also
    --------
    plan : Predict stages, time and error.
    simulate : Run a scene's plan.
    """

    stages: tuple[Stage, ...]
    skipped: tuple[Stage, ...]
    tol: float
    waves: float
    exit_pupil: ExitPupil | None = field(compare=False, repr=False)
    budget: Budget = field(compare=False)
    pattern_nodes: int = 0

    @property
    def layout(self) -> Literal["polar", "grid"]:
        """Sampling of the pupil: "grid" if the wall's edge cuts the cone of light, else "polar"."""
        return "polar" if self.exit_pupil is None else self.exit_pupil.layout

    @property
    def memory(self) -> float:
        """Predicted peak increase of the process's memory during the run, bytes."""
        return HELD + max((stage.memory for stage in self.stages), default=0.0)

    @property
    def seconds(self) -> float:
        """Predicted run time on one core of a machine of 2024, without compilation, s."""
        return sum(stage.seconds for stage in self.stages)

    def runs(self, name: str) -> bool:
        """Return whether the run includes the stage with the given ``name``, such as "image"."""
        return any(stage.name == name for stage in self.stages)

    def __str__(self) -> str:
        """Return a table of all stages as text, wrapped to the width of a terminal."""
        rows = [("stage", "seconds", "error", "why"), *self._rows]
        wide = shutil.get_terminal_size((10_000, 24)).columns  # files keep their lines
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        widths[2] = min(widths[2], max(16, wide // 4))
        widths[3] = min(widths[3], max(24, wide - sum(widths[:3]) - 6))
        lines = []
        for row in rows:
            cells = [textwrap.wrap(*cell) for cell in zip(row, widths, strict=True)]
            for parts in itertools.zip_longest(*cells, fillvalue=""):
                lines.append("  ".join(map(str.ljust, parts, widths)).rstrip())
        return "\n".join(lines)

    @property
    def _rows(self) -> list[tuple[str, str, str, str]]:
        runs = [(s.name, f"{s.seconds:.2f}", s.error, s.reason) for s in self.stages]
        return [*runs, *((s.name, "skipped", "", s.reason) for s in self.skipped)]

    def _repr_html_(self) -> str:
        """Return a table of all stages as HTML."""
        return table(
            f"Plan: {lasting(self.seconds)} predicted, to {self.tol:g} of the peak",
            [Column(head) for head in ("stage", "seconds", "error", "why")],
            self._rows,
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
        Error tolerance of the point spread functions (PSFs), max |dI|/max I, with I the intensity,
        1e-12 to 0.1. If the PSF varies over the object, ``tol`` also limits the error of the image
        (rms error over rms value).
    reconstruct : bool, default False
        Whether to include the reconstruction of the object, with known PSF.
    memory : float, optional
        Limit for the memory of the whole run, bytes; by default three quarters of the free memory.
    max_seconds : float, default 900
        Limit for the predicted run time on one core, s. A longer run is refused.

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
    NotWaveGradeError
        If a mesh wall is too coarse for waves (`MeshWall.wave_grade`).
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
    milliseconds each. Sizes and sampling of the PSFs are then determined by the same functions as
    in the run.

    Examples
    --------
    >>> from nlosoptics import Scene, plan
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> planned = plan(scene, tol=1e-2)
    >>> [stage.name for stage in planned.stages]
    ['exit pupil', 'wave aberration', 'point spread', 'image']
    >>> next(stage.reason for stage in planned.skipped if stage.name == "reconstruction")
    'not requested'
    """
    return looked_at(scene, tol, reconstruct, memory, max_seconds)[0]


def looked_at(
    scene: Scene,
    tol: float,
    reconstruct: bool,
    memory: float | None,
    max_seconds: float,
) -> tuple[Plan, SceneOptics | None]:
    """Return the result of `plan` with the waves it computed, if any, for reuse by the run."""
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    in_range("tol", tol, 1e-12, 0.1)
    memory = SHARE * available_memory() if memory is None else positive("memory", memory, unit="B")
    budget = Budget(memory, positive("max_seconds", max_seconds, unit="s"))
    with within(budget):
        return _plan(scene, tol, reconstruct, budget)


def _matt_plan(scene: Scene, tol: float, reconstruct: bool, budget: Budget) -> Plan:
    """Return the plan for a wall without a mirror-like lobe, which needs no wave."""
    scene.check_in_front()
    spot = lit_spot(scene)
    if scene.occluding_mesh is not None and spot is not None:
        check_beam(scene, scene.occluding_mesh, spot)
    reason = "the wall has no mirror-like lobe and forms no image"
    stages = [
        *(skipped(name, reason) for name in ("exit pupil", "wave aberration", "point spread")),
        shadow_stage(scene),
        image_stage(scene),
        reconstruction_stage(scene, reconstruct),
    ]
    result = Plan(
        stages=tuple(s for s in stages if s.runs),
        skipped=tuple(s for s in stages if not s.runs),
        tol=tol,
        waves=math.nan,
        exit_pupil=None,
        budget=budget,
    )
    _check_budget(result)
    return result


def _plan(
    scene: Scene, tol: float, reconstruct: bool, budget: Budget
) -> tuple[Plan, SceneOptics | None]:
    image = image_stage(scene)
    ny, nx = scene.camera.shape
    fits_memory(
        f"an image of {nx} x {ny} pixels", HELD + image.memory, f"{PIXELS}, or give more memory"
    )
    scene.check_black_occluders()
    if scene.laser.power > 0.0:
        check_laser(scene)
    if is_matt(scene):
        return _matt_plan(scene, tol, reconstruct, budget), None
    scene.check_laser_light()
    pupil = exit_pupil(scene)
    check_sight(scene, pupil)
    optics = SceneOptics(scene, pupil)
    stages = [
        mesh_stage(scene),
        Stage(
            name="exit pupil",
            runs=True,
            reason=f"the {pupil.stop} limits: radius {1e3 * pupil.radius:.3g} mm, "
            f"F/{pupil.f_number:.3g}",
            seconds=0.001,
            error="exact for a thin lens",
        ),
    ]
    check_wave(scene)
    scene.check_in_front()
    spot = laser_spot(scene)
    if scene.occluding_mesh is not None:
        check_beam(scene, scene.occluding_mesh, spot)
    look = Look.at(optics, tol)
    pattern = Pattern.at(look, tol, budget.seconds) if own_pattern(scene) else None
    # over a large picture the image uses the mean over walls, whose field may vary as well
    imaged = look
    if pattern is not None and not pattern.nodes:
        imaged = Look.at(mean_optics(optics), tol)
    heights = look.seen.first.residual.heights
    waves = (heights.high - heights.low) / scene.laser.wavelength
    shadows = shadow_stage(scene)
    stages += [
        *wave_stages(scene, pupil, look, waves),
        point_spread_stage(scene, pupil, look, tol),
        *image_spread_stages(pupil, look, imaged, pattern, tol),
        *left_out(scene),
        shadows,
        image,
        *burst_stages(scene, look, pattern, tol, shadows.seconds + image.seconds),
        reconstruction_stage(scene, reconstruct, pattern.nodes if pattern is not None else 0),
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
            f"the run would take about {lasting(found.seconds)}, {lasting(longest.seconds)} for "
            f"'{longest.name}' ({longest.reason}), limit max_seconds = {limit:g}; {remedy}, or "
            f"max_seconds = {rounded_up(found.seconds)}"
        )
