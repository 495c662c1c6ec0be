"""The run that does exactly what a plan says."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._progress import Progress
from ._random import checked_seed
from .errors import NotWaveGradeError, SamplingError
from .planning import FIELD, MOST_NODES, MOST_SAMPLES, Plan, plan, wave_refusal
from .psf.pupils import exit_pupil
from .results import Result
from .scene import MeshWall, PlanarObject, Scene

if TYPE_CHECKING:
    from .imaging import SpeckleImage
    from .inverse import Reconstruction
    from .psf import PointSpread, Wavefront

Array = NDArray[np.float64]
GRID_STEPS = (512, 1024, 2048)  # cells across a pupil that the wall's edge cuts


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
        Of all random draws, 0 to 2^64 - 1; the same seed gives the same bits.
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
    seed = checked_seed(seed)
    todo = plan(scene, tol, reconstruct=reconstruct)
    if not todo.runs("wave aberration"):
        raise NotWaveGradeError(wave_refusal(scene))
    timings: dict[str, float] = {}
    total = todo.seconds

    def within(name: str, share: float) -> None:
        """Tell of a share of one stage."""
        if progress is not None:
            done = sum(s.seconds for s in todo.stages if s.name in timings)
            done += share * sum(s.seconds for s in todo.stages if s.name == name)
            progress(name, min(1.0, done / total))

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        within(name, 0.0)
        start = time.perf_counter()
        yield
        timings[name] = timings.get(name, 0.0) + time.perf_counter() - start

    if isinstance(scene.wall, MeshWall):
        with stage("mesh surface"):
            scene.wall.fit_residual  # noqa: B018  (fits and caches the surface)
    with stage("exit pupil"):
        pupil = exit_pupil(scene)
    wave, spread = _wave_and_spread(scene, todo, stage)
    from . import imaging, psf

    errors = {"point spread": spread.error_estimate}
    field = None
    if todo.runs(FIELD):
        with stage(FIELD):
            field, errors[FIELD] = imaging.image_field(
                scene,
                tol=tol,
                most_nodes=MOST_NODES,
                progress=lambda _, share: within(FIELD, share),
            )
    shadows = None
    if todo.runs("shadow rays"):
        with stage("shadow rays"):
            shadows = imaging.cast_shadows(scene)
    with stage("image"):
        wide = psf.widened(field or spread, tol=tol / 4, shape=scene.camera.shape)
        image = imaging.form_image(scene, wide, seed=seed, shadows=shadows)
    reconstruction = None
    if todo.runs("reconstruction"):
        with stage("reconstruction"):
            reconstruction = _reconstruct(scene, image, field.mean() if field else spread.intensity)
    if progress is not None:
        progress("done", 1.0)
    return Result(
        scene=scene,
        plan=todo,
        exit_pupil=pupil,
        wavefront=wave,
        point_spread=spread,
        field=field,
        image=image,
        reconstruction=reconstruction,
        errors=errors,
        timings=timings,
        seed=seed,
    )


def _wave_and_spread(
    scene: Scene, todo: Plan, stage: Callable[[str], AbstractContextManager[None]]
) -> tuple[Wavefront, PointSpread]:
    """Wave and point spread; a grid is refined until it carries the wanted error."""
    from . import psf

    pitch = scene.camera.image_pitch
    steps = GRID_STEPS if todo.layout == "grid" else (None,)
    for samples in steps:
        with stage("wave aberration"):
            wave = psf.wavefront(scene, nodes=todo.layout, samples=samples)
        with stage("point spread"):
            shape = psf.window_shape(wave, pitch=pitch, tol=todo.tol)
            _check_samples(wave, shape, pitch, todo.tol)
            try:
                return wave, psf.lobe_point_spread(scene, wave, pitch=pitch, tol=todo.tol)
            except SamplingError:
                if samples == steps[-1]:
                    raise
    raise AssertionError("unreachable: the last step returns or raises")


def _reconstruct(scene: Scene, image: SpeckleImage, spread: Array) -> Reconstruction:
    """Object from the reading, with pose, point spread and the veil's shape known."""
    from . import inverse
    from .imaging import ForwardModel

    veil = veil_shape(scene)
    model = ForwardModel(spread, shape=image.electrons.shape)
    return inverse.tv_deconvolve(
        image.electrons,
        model,
        background=image.ledger["dark"] / image.electrons.size,
        background_shape=veil if veil.any() else None,
    )


def veil_shape(scene: Scene) -> Array:
    """Shape of the wall's diffuse light in the image, (ny, nx), as of an unknown picture."""
    from .imaging import diffuse_background

    stand_in = None
    if isinstance(scene.hidden, PlanarObject):
        # a white plate for the unknown picture, by its four Gauss points
        stand_in = np.zeros((7, 7))
        stand_in[1::4, 1::4] = 1.0
        if scene.occluders:  # whose shadows need all of it
            stand_in = np.ones((7, 7))
    return diffuse_background(scene, stand_in)


def _check_samples(wave: Wavefront, shape: int, pitch: float, tol: float) -> None:
    """Refuse a point spread whose window holds too many samples, saying why it does."""
    from . import psf

    nyquist = wave.wavelength * wave.f_number / 2
    needed = math.ceil(shape * pitch / nyquist)
    if needed <= MOST_SAMPLES:
        return
    message = (
        f"the point spread needs {shape} pixels, {needed} samples across, limit {MOST_SAMPLES}"
    )
    if psf.window_shape(wave, pitch=pitch, tol=1e-2) * pitch <= MOST_SAMPLES * nyquist:
        raise SamplingError(f"{message}: its tail above tol = {tol:g}; use a larger tol")
    # spot and sampling both grow with the stop
    down = math.ceil(13 * math.sqrt(needed / MOST_SAMPLES)) / 10
    raise SamplingError(
        f"{message}: the wall is near its caustic or far out of focus; stop the lens down "
        f"{down:g} times, use a flatter wall, or focus on its image"
    )
