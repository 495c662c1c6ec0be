"""What a scene needs, what it does not and why, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ._checks import fits_memory, in_range
from ._html import Column, table
from .errors import NotWaveGradeError, SamplingError, SceneError
from .psf.aberration import check_wave_grade
from .psf.estimates import rounded_up
from .psf.obstruction import check_cone
from .psf.paraxial import change_over_object
from .psf.pupils import ExitPupil, exit_pupil
from .psf.scene_psf import MOST_SAMPLES
from .raytrace import ray_plan
from .scene import (
    ConvexWall,
    MeshWall,
    PlanarObject,
    Scene,
)

FIELD = "field of point spreads"  # the name of that stage
BYTES_PER_PIXEL = 400  # of an image through the whole run, measured
MOST_NODES = 27  # along each side of a field of point spreads
MOST_SECONDS = 900  # of a field
LARGEST_TOL = 0.1


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
    """

    name: str
    runs: bool
    reason: str
    seconds: float = 0.0
    error: str = ""


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
        Estimated peak-to-valley aberration left after tilt, waves.
    exit_pupil : ExitPupil
        Exit pupil of the scene, which `simulate` goes on with.
    """

    stages: tuple[Stage, ...]
    skipped: tuple[Stage, ...]
    tol: float
    waves: float
    exit_pupil: ExitPupil = field(compare=False, repr=False)

    @property
    def layout(self) -> Literal["polar", "grid"]:
        """Layout of the pupil nodes: a grid where the wall's edge cuts the cone of light."""
        return self.exit_pupil.layout

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


def plan(scene: Scene, tol: float = 1e-3, *, reconstruct: bool = False) -> Plan:
    """Say what a scene needs, what it does not, and why.

    Parameters
    ----------
    scene : Scene
    tol : float, default 1e-3
        Wanted error of point spreads, max |dI|/max I, and of the image by their field, rms over
        rms; 1e-12 to 0.1.
    reconstruct : bool, default False
        Whether the known-PSF reconstruction is wanted.

    Returns
    -------
    Plan

    Raises
    ------
    SceneError
        If the laser misses the wall, the camera cannot see the object by the wall, an occluder
        cuts a part of the cone of light from the object's reference point, or ``tol`` is out of
        range.
    SamplingError
        If ``tol`` is out of reach: with what it would take.
    MemoryLimitError
        If the image would not fit in memory.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    in_range("tol", tol, 1e-12, LARGEST_TOL)
    ny, nx = scene.camera.shape
    fits_memory(
        f"an image of {nx} x {ny} pixels (camera.pixels, camera.binning)",
        BYTES_PER_PIXEL * nx * ny,
        "read fewer pixels or bin more",
    )
    _check_laser(scene)
    pupil = exit_pupil(scene)
    _check_sight(scene, pupil)
    waves = _estimated_waves(scene, pupil)
    refusal = wave_refusal(scene)
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
        *_wave_stages(scene, pupil, waves),
        _point_spread_stage(scene, pupil, waves, tol),
        _field_stage(scene, pupil, waves, tol),
        *_left_out(scene),
        _shadow_stage(scene, sampled=not refusal),
        _image_stage(scene),
        _reconstruction_stage(scene, reconstruct),
    ]
    if refusal:
        keep = ("mesh surface", "exit pupil")
        stages = [
            s if s.name in keep or not s.runs else Stage(name=s.name, runs=False, reason=refusal)
            for s in stages
        ]
    return Plan(
        stages=tuple(s for s in stages if s.runs),
        skipped=tuple(s for s in stages if not s.runs),
        tol=tol,
        waves=waves,
        exit_pupil=pupil,
    )


def _skipped(name: str, reason: str) -> Stage:
    return Stage(name=name, runs=False, reason=reason)


def _mesh_stage(scene: Scene) -> Stage:
    if not isinstance(scene.wall, MeshWall):
        return _skipped("mesh surface", "the wall is analytic")
    return Stage(
        name="mesh surface",
        runs=True,
        reason="a smooth bicubic surface through the mesh",
        seconds=0.5,
        error=f"{1e9 * scene.wall.fit_residual:.2g} nm; "
        f"the triangles {1e9 * scene.wall.mesh_error:.2g} nm",
    )


def _wave_stages(scene: Scene, pupil: ExitPupil, waves: float) -> Iterator[Stage]:
    flat = scene.wall.is_flat
    if flat:
        yield _skipped("aiming", "flat wall: hits in closed form")
    reason = "zero but for focus" if flat else f"rays aimed by Newton; about {waves:.2g} waves"
    if pupil.layout == "grid":
        cut = "the wall's outline is the stop"
        if pupil.stop == "lens":
            cut = f"the wall's edge cuts {100 * pupil.vignetting:.2g} % of the cone"
        reason += f"; on a grid, because {cut}"
    yield Stage(
        name="wave aberration",
        runs=True,
        reason=reason,
        seconds=(0.005 if flat else 0.02) if pupil.layout == "polar" else 0.5,
        error="the mesh surface's" if isinstance(scene.wall, MeshWall) else "1e-9 wave",
    )


def _point_spread_stage(scene: Scene, pupil: ExitPupil, waves: float, tol: float) -> Stage:
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    seconds = _spread_seconds(core, pitch, waves, tol)
    tail = 4 * _tail(core, pitch, tol) / core  # samples across at Nyquist's pitch
    if tail > MOST_SAMPLES:
        raise SamplingError(
            f"tol = {tol:g} takes a point spread of {tail:.0f} samples across, about "
            f"{seconds:.0f} s and {tail**2 * 64 / 2**30:.0f} GiB, limit {MOST_SAMPLES}; use tol = "
            f"{rounded_up(1.1 * tol * (tail / MOST_SAMPLES) ** 3)} or more, or wider pixels"
        )
    slope = max((lobe.slope_rms for lobe in scene.wall_material.mirror_lobes), default=0.0)
    blur = ""
    if slope > 0:
        seconds += 0.5
        blur = f", blurred by the lobe's slopes of {slope:g} rad"
    return Stage(
        name="point spread",
        runs=True,
        reason=f"at the object's centre; a pixel is {pitch / core:.3g} lambda N wide{blur}",
        seconds=seconds,
        error=f"{tol:g} of the peak",
    )


def _tail(core: float, pitch: float, tol: float) -> float:
    """Distance, m, at which a pixel of the diffraction tail has fallen to tol."""
    peak = min(1.0, math.pi / 4 * (pitch / core) ** 2)
    return math.cbrt(2 * core * pitch**2 / (math.pi**3 * tol * peak))


def _spread_seconds(core: float, pitch: float, waves: float, tol: float) -> float:
    reach = 4 * waves * core + _tail(core, pitch, tol)
    return 0.02 + 1.6e-7 * (4 * reach / core) ** 2


def _field_stage(scene: Scene, pupil: ExitPupil, waves: float, tol: float) -> Stage:
    """Whether point spreads at several object points are needed, and about how many."""
    if not isinstance(scene.hidden, PlanarObject):
        return _skipped(FIELD, "one point spread stands for the mesh; positions are exact")
    if not scene.wall_material.mirror_lobes:
        return _skipped(FIELD, "a wall without a mirror-like lobe shows no picture")
    if pupil.layout == "grid":
        return _skipped(
            FIELD, "one point spread on a grid stands for the object; positions are exact"
        )
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    change = change_over_object(scene, pupil)
    if change <= tol:
        return _skipped(
            FIELD, f"one point spread stands for the object: changes of it stay below {change:.1g}"
        )
    # measured: the image errs by about 0.06 of that over the nodes to this power
    power = 5.0 if scene.wall.is_flat else 2.2

    def cost(tol: float) -> tuple[int, float]:
        nodes = max(4, math.ceil((0.06 * change / tol) ** (1 / power)))
        return nodes, 1.2 * nodes**2 * (0.02 + _spread_seconds(core, pitch, waves, tol))

    def fits(nodes: int, seconds: float) -> bool:
        # a spot that is too wide to be sampled is refused by its wave, whose figures are exact
        quick = seconds <= MOST_SECONDS or 16 * waves > MOST_SAMPLES
        return nodes <= MOST_NODES and quick

    nodes, seconds = cost(tol)
    if not fits(nodes, seconds):
        steps = (tol * 1.25**k for k in range(120))
        least = next((t for t in steps if fits(*cost(t))), 1.0)
        remedy = (
            "stop the lens down"
            if least > LARGEST_TOL
            else f"use tol = {rounded_up(least)} or more"
        )
        raise SamplingError(
            f"tol = {tol:g} takes about {nodes} x {nodes} point spreads over the object, about "
            f"{seconds:.0f} s, limits {MOST_NODES} x {MOST_NODES} and {MOST_SECONDS} s; {remedy}"
        )
    return Stage(
        name=FIELD,
        runs=True,
        reason=f"point spreads change over the object; about {nodes} x {nodes} of them",
        seconds=seconds,
        error=f"{tol:g} of the image, rms",
    )


def _left_out(scene: Scene) -> Iterator[Stage]:
    """What this scene could ask for and is not computed."""
    yield _skipped(
        "interreflection",
        "light from wall to wall is left out of the image; raytrace.trace tells how much it is"
        if ray_plan(scene).wall_to_wall
        else "no part of the wall sees another",
    )
    if not ray_plan(scene).embree:
        yield _skipped("embree", "no triangles: the object is a picture and nothing is in the way")


def _shadow_stage(scene: Scene, *, sampled: bool) -> Stage:
    if not scene.occluders:
        return _skipped("shadow rays", "no occluders")
    count = len(scene.occluders)
    reason = f"{count} occluder{'s' if count > 1 else ''} between spot, object, wall and lens"
    if sampled and check_cone(scene):
        reason += "; the object's reference point is hidden"
    ny, nx = scene.camera.shape
    return Stage(
        name="shadow rays",
        runs=True,
        reason=reason,
        seconds=1.0 + 1e-5 * nx * ny,
        error="some hundredths in a shadow's edge",
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
        seconds=0.3 + 2e-6 * nx * ny,
        error="1e-3 of the background",
    )


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
        seconds=1.3 + 3e-6 * nx * ny,
        error="status and score are reported",
    )


def wave_refusal(scene: Scene) -> str:
    """Why waves cannot be computed for this wall; empty when they can."""
    try:
        check_wave_grade(scene.wall, scene.laser.wavelength)
    except NotWaveGradeError as refusal:
        return f"{refusal}; the geometric branch that could do without is not built"
    return ""


def _check_sight(scene: Scene, pupil: ExitPupil) -> None:
    """Refuse an object that the wall or the detector does not show, as far as a flat wall tells."""
    camera, position = scene.camera, tuple(float(c) for c in scene.object_point)
    if pupil.vignetting == 1.0:
        raise SceneError(
            f"hidden.position = {position} m is mirrored by no part of the wall, wall.size = "
            f"{scene.wall.size} m; enlarge the wall, or move object or camera"
        )
    line = scene.mirrored_object_point - np.array(camera.position)
    x, y, depth = (float(line @ axis) for axis in camera.frame)
    if depth <= 0:
        raise SceneError(
            f"camera.aim = {camera.aim} m looks away from the mirrored object; aim at the wall "
            "point where it appears"
        )
    # a curved wall may magnify
    extent = _half_extent(scene) * (1.0 if scene.wall.is_flat else 3.0)
    reach = np.array(camera.shape[::-1]) * camera.image_pitch / 2
    image = np.array([abs(x), abs(y)]) * scene.image_distance / depth
    outside = image - extent * scene.image_distance / depth - reach
    if outside.max() > 0:
        raise SceneError(
            f"hidden.position = {position} m is imaged at ({1e3 * image[0]:.3g}, "
            f"{1e3 * image[1]:.3g}) mm from the axis, off the detector of "
            f"+-({1e3 * reach[0]:.3g}, {1e3 * reach[1]:.3g}) mm; change camera.aim"
        )


def _check_laser(scene: Scene) -> None:
    x, y, _ = scene.laser.aim
    if not scene.wall.contains(x, y):
        raise SceneError(
            f"laser.aim = {scene.laser.aim} m is off the wall, wall.size = {scene.wall.size} m; "
            "aim inside its edges"
        )


def _half_extent(scene: Scene) -> float:
    """Largest distance of the object's parts from its reference point, m."""
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        return math.hypot(*hidden.size) / 2
    return float(np.linalg.norm(hidden.surface.vertices - scene.object_point, axis=1).max())


def _estimated_waves(scene: Scene, pupil: ExitPupil) -> float:
    """Second-order peak-to-valley estimate of the residual aberration, waves."""
    kappa = scene.wall.max_curvature
    position = np.array(scene.camera.position)
    d2 = -float(position[2] / scene.camera.axis[2])
    d1 = max(float(np.linalg.norm(scene.mirrored_object_point - position)) - d2, 1e-9)
    m, d_eff = d1 / (d1 + d2), d1 * d2 / (d1 + d2)
    sign = 1.0 if isinstance(scene.wall, ConvexWall) else -1.0
    curved = kappa * m**2 / max(abs(1 + sign * 2 * kappa * d_eff), 1e-3)
    depth = float((scene.mirrored_object_point - position) @ scene.camera.axis)
    focus = 0.5 * abs(1 / depth - 1 / scene.focus_distance) if depth > 0 else math.inf
    return float((curved + focus) * pupil.entrance_radius**2 / scene.laser.wavelength)
