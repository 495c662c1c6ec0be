"""What a scene needs, before anything is computed; and the run that does exactly that."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ._checks import fits_memory, in_range, whole
from .errors import SamplingError, SceneError
from .psf.pupils import ExitPupil, exit_pupil
from .scene import (
    ConcaveWall,
    MeshWall,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    WavyWall,
)

if TYPE_CHECKING:
    from .imaging import SpeckleImage
    from .inverse import Reconstruction
    from .psf import PointSpread, Wavefront

Progress = Callable[[str, float], None]
BYTES_PER_PIXEL = 400  # of an image through the whole run, measured
MOST_SAMPLES = 8192  # across a point spread at Nyquist's pitch: 10 s and 2 GiB


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
        Wanted error: of the point spread max |dI|/max I, of the image the relative rms of expected
        electrons.
    waves : float
        Estimated peak-to-valley aberration left after tilt, waves.
    """

    stages: tuple[Stage, ...]
    skipped: tuple[Stage, ...]
    tol: float
    waves: float

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


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """What a simulation found.

    Parameters
    ----------
    scene : Scene
    plan : Plan
    exit_pupil : ExitPupil
    wavefront : Wavefront
    point_spread : PointSpread
    image : SpeckleImage
    reconstruction : Reconstruction or None
        None unless it was asked for.
    timings : dict of str to float
        Seconds of each stage that ran.
    seed : int
    """

    scene: Scene
    plan: Plan
    exit_pupil: ExitPupil
    wavefront: Wavefront
    point_spread: PointSpread
    image: SpeckleImage
    reconstruction: Reconstruction | None
    timings: dict[str, float]
    seed: int


def plan(scene: Scene, tol: float = 1e-3, *, reconstruct: bool = False) -> Plan:
    """Say what a scene needs, what it does not, and why.

    Parameters
    ----------
    scene : Scene
    tol : float, default 1e-3
        Wanted error, 1e-12 to 0.1.
    reconstruct : bool, default False
        Whether the known-PSF reconstruction is wanted.

    Returns
    -------
    Plan

    Raises
    ------
    SceneError
        If the camera cannot see the object by the wall, or ``tol`` is out of range.
    MemoryLimitError
        If the image would not fit in memory.
    """
    in_range("tol", tol, 1e-12, 0.1)
    camera = scene.camera
    ny, nx = camera.shape
    fits_memory(
        f"an image of {nx} x {ny} pixels",
        BYTES_PER_PIXEL * nx * ny,
        "read fewer pixels or bin more",
    )
    _check_laser(scene)
    pupil = exit_pupil(scene)
    waves = _estimated_waves(scene, pupil)
    stages: list[Stage] = []
    skipped: list[Stage] = []

    def add(name: str, runs: bool, reason: str, seconds: float = 0.0, error: str = "") -> None:
        stage = Stage(
            name=name,
            runs=runs,
            reason=reason,
            seconds=seconds if runs else 0.0,
            error=error if runs else "",
        )
        (stages if runs else skipped).append(stage)

    mesh = isinstance(scene.wall, MeshWall)
    add(
        "mesh surface",
        mesh,
        "a smooth bicubic surface through the mesh" if mesh else "the wall is analytic",
        0.5,
        f"{1e9 * scene.wall.fit_residual:.2g} nm" if isinstance(scene.wall, MeshWall) else "",
    )
    add(
        "exit pupil",
        True,
        f"the {pupil.stop} limits: radius {1e3 * pupil.radius:.3g} mm, F/{pupil.f_number:.3g}",
        0.001,
        "exact for a thin lens",
    )
    flat = scene.wall.is_flat
    if flat:
        add("aiming", False, "flat wall: hits in closed form")
    add(
        "wave aberration",
        True,
        "zero but for focus" if flat else f"rays aimed by Newton; about {waves:.2g} waves",
        0.005 if flat else 0.02,
        "the mesh surface's" if mesh else "1e-9 wave",
    )
    core = scene.laser.wavelength * pupil.f_number
    add(
        "point spread",
        True,
        f"one at the object's centre; a pixel is {camera.image_pitch / core:.3g} lambda N wide",
        _point_spread_seconds(scene, pupil, waves),
        f"{tol:g} of the peak",
    )
    add(
        "field of point spreads",
        False,
        "flat wall: the same everywhere but for focus"
        if flat
        else "one point spread stands for the whole object; positions follow the exact chief rays",
    )
    slope = _lobe_slope(scene)
    add(
        "rough wall",
        False,
        "the mirror-like lobe is smooth"
        if slope == 0
        else f"the lobe's slope of {slope:g} rad is taken as smooth; diffuse light is background",
    )
    hollow = _sees_itself(scene)
    add(
        "interreflection",
        False,
        "light from wall to wall is left out: a hollow wall adds a little background"
        if hollow
        else "no part of the wall sees another",
    )
    add("shadow rays", False, "no occluders")
    specular = scene.wall_material.specular_reflectance
    add(
        "image",
        True,
        f"{nx} x {ny} pixels by reverse chief rays"
        + ("" if specular > 0 else "; no mirror-like lobe, so background only"),
        0.1 + 3e-6 * nx * ny,
        "1e-3 of the background",
    )
    if not reconstruct:
        add("reconstruction", False, "not asked for; torch is not loaded")
    elif specular == 0:
        add("reconstruction", False, "a diffuse wall without a mirror-like lobe passes no picture")
    else:
        add(
            "reconstruction",
            True,
            "total variation with the point spread known",
            1.5 + 1.2e-5 * nx * ny,
            "status and score are reported",
        )
    return Plan(stages=tuple(stages), skipped=tuple(skipped), tol=tol, waves=waves)


def simulate(
    scene: Scene,
    tol: float = 1e-3,
    seed: int = 0,
    reconstruct: bool = False,
    *,
    progress: Progress | None = None,
) -> Result:
    """Run exactly what `plan` says.

    Parameters
    ----------
    scene : Scene
    tol : float, default 1e-3
        Wanted error, as for `plan`.
    seed : int, default 0
        Of all random draws, at least 0; the same seed gives the same bits.
    reconstruct : bool, default False
        Also reconstruct the object; loads torch.
    progress : callable(str, float), optional
        Told the stage that begins and the fraction done.

    Returns
    -------
    Result

    Raises
    ------
    NlosError
        Of the kind that fits; see `plan`, `psf.wavefront`, `psf.point_spread` and
        `imaging.form_image`.
    """
    seed = whole("seed", seed, 0)
    todo = plan(scene, tol, reconstruct=reconstruct)
    timings: dict[str, float] = {}
    total = todo.seconds

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress is not None:
            done = sum(s.seconds for s in todo.stages if s.name in timings)
            progress(name, min(1.0, done / total))
        start = time.perf_counter()
        yield
        timings[name] = time.perf_counter() - start

    from . import psf

    if isinstance(scene.wall, MeshWall):
        with stage("mesh surface"):
            scene.wall.fit_residual  # noqa: B018  (fits and caches the surface)
    with stage("exit pupil"):
        pupil = exit_pupil(scene)
    with stage("wave aberration"):
        try:
            wave = psf.wavefront(scene)
        except SamplingError:  # the wall's edge cuts the pupil
            wave = psf.wavefront(scene, nodes="grid", samples=512)
    with stage("point spread"):
        pitch = scene.camera.image_pitch
        shape = psf.window_shape(wave, pitch=pitch, tol=tol)
        _check_samples(shape, pitch, scene.laser.wavelength * wave.f_number / 2)
        spread = psf.point_spread(wave, pitch=pitch, shape=shape, pixel_integrated=True, tol=tol)
    from . import imaging

    with stage("image"):
        image = imaging.form_image(scene, spread, seed=seed)
    reconstruction = None
    if todo.runs("reconstruction"):
        with stage("reconstruction"):
            reconstruction = _reconstruct(scene, image, spread)
    if progress is not None:
        progress("done", 1.0)
    return Result(
        scene=scene,
        plan=todo,
        exit_pupil=pupil,
        wavefront=wave,
        point_spread=spread,
        image=image,
        reconstruction=reconstruction,
        timings=timings,
        seed=seed,
    )


def _reconstruct(scene: Scene, image: SpeckleImage, spread: PointSpread) -> Reconstruction:
    """Object from the reading alone: the veil's shape is known, its strength is not."""
    from . import inverse
    from .imaging import ForwardModel, diffuse_background

    stand_in = None
    if isinstance(scene.hidden, PlanarObject):
        # a white plate for the unknown picture, by its four Gauss points
        stand_in = np.zeros((7, 7))
        stand_in[1::4, 1::4] = 1.0
    veil = diffuse_background(scene, stand_in)
    model = ForwardModel(spread, shape=image.electrons.shape)
    return inverse.tv_deconvolve(
        image.electrons,
        model,
        noise_sigma=image.noise_sigma,
        background=image.ledger["dark"] / image.electrons.size,
        background_shape=veil if veil.any() else None,
    )


def _check_laser(scene: Scene) -> None:
    x, y, _ = scene.laser.aim
    if not scene.wall.contains(x, y):
        raise SceneError(
            f"laser.aim = {scene.laser.aim} m is off the wall, wall.size = {scene.wall.size} m; "
            "aim inside its edges"
        )


def _check_samples(shape: int, pitch: float, nyquist: float) -> None:
    needed = math.ceil(shape * pitch / nyquist)
    if needed > MOST_SAMPLES:
        raise SamplingError(
            f"the point spread covers {shape} pixels and needs {needed} samples across, limit "
            f"{MOST_SAMPLES}: the wall is near its caustic or far out of focus; stop the lens down "
            f"{math.sqrt(needed / MOST_SAMPLES):.2g} times, use a flatter wall, or focus closer"
        )


def _estimated_waves(scene: Scene, pupil: ExitPupil) -> float:
    """Second-order peak-to-valley estimate of the residual aberration, waves."""
    kappa = scene.wall.max_curvature
    position = np.array(scene.camera.position)
    d2 = -float(position[2] / scene.camera.axis[2])
    d1 = max(float(np.linalg.norm(scene.mirrored_object_point - position)) - d2, 1e-9)
    m, d_eff = d1 / (d1 + d2), d1 * d2 / (d1 + d2)
    sign = -1.0 if isinstance(scene.wall, ConcaveWall | WavyWall | SumWall | MeshWall) else 1.0
    curved = kappa * m**2 / max(abs(1 + sign * 2 * kappa * d_eff), 1e-3)
    depth = float((scene.mirrored_object_point - position) @ scene.camera.axis)
    focus = 0.5 * abs(1 / depth - 1 / scene.focus_distance) if depth > 0 else math.inf
    return float((curved + focus) * pupil.entrance_radius**2 / scene.laser.wavelength)


def _point_spread_seconds(scene: Scene, pupil: ExitPupil, waves: float) -> float:
    core = scene.laser.wavelength * pupil.f_number
    blur = 4 * waves * core  # radius of the geometric spot of a defocus
    side = 2 * (blur + 5 * max(scene.camera.image_pitch, core)) / (core / 2)
    return 0.01 + 3e-7 * side**2


def _lobe_slope(scene: Scene) -> float:
    """Largest slope rms among the wall's mirror-like lobes, rad."""
    material = scene.wall_material
    parts = material.parts if isinstance(material, SumMaterial) else (material,)
    slopes = [p.slope_rms for p in parts if isinstance(p, SpecularMicrofacet)]
    return max(slopes, default=0.0)


def _sees_itself(scene: Scene) -> bool:
    """Whether straight lines can join two points of the wall in front of it."""
    return isinstance(scene.wall, ConcaveWall | WavyWall | SumWall | MeshWall) and not (
        scene.wall.is_flat
    )
