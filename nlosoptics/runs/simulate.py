"""The run that does exactly what a plan says."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import within
from .._progress import Progress
from .._random import checked_seed
from ..errors import NotWaveGradeError
from ..scene import MeshWall, PlanarObject, Scene
from .plan import FIELD, MOST_NODES, MOST_SECONDS, Plan, looked_at
from .refusals import wave_refusal
from .results import Result

if TYPE_CHECKING:
    from ..imaging import SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import SceneOptics

Array = NDArray[np.float64]


def simulate(
    scene: Scene,
    tol: float = 1e-3,
    seed: int = 0,
    reconstruct: bool = False,
    *,
    memory: float | None = None,
    max_seconds: float = MOST_SECONDS,
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
    memory : float, optional
        Bytes that the whole run may take; three quarters of what is free by default.
    max_seconds : float, default 900
        Predicted seconds on one core that the whole run may take.
    progress : callable(str, float), optional
        Told the stage that begins and the fraction done.

    Returns
    -------
    Result

    Raises
    ------
    NlosError
        Of the kind that fits; see `plan`, `psf.scene_point_spread` and `imaging.form_image`.
    """
    seed = checked_seed(seed)
    return carried_out(*looked_at(scene, tol, reconstruct, memory, max_seconds), seed, progress)


def carried_out(
    todo: Plan, optics: SceneOptics, seed: int, progress: Progress | None = None
) -> Result:
    """Carry out a plan within its budget, starting from the waves that it aimed.

    Parameters
    ----------
    todo : Plan
        Plan of the scene.
    optics : SceneOptics
        Waves that the plan looked at, see `looked_at`.
    seed : int
        Seed of all random draws, checked.
    progress : callable(str, float), optional
        Called with the stage that begins and the fraction done.
    """
    with within(todo.budget):
        return _stages(todo, optics, seed, progress)


def _stages(todo: Plan, optics: SceneOptics, seed: int, progress: Progress | None) -> Result:
    """Run the stages of a plan in their order."""
    scene, tol = optics.scene, todo.tol
    if not todo.runs("wave aberration"):
        raise NotWaveGradeError(wave_refusal(scene))
    from .. import imaging, psf

    begun: dict[str, float] = {}  # start of each stage, s
    total = todo.seconds

    def tell(name: str, share: float) -> None:
        """Report a share of one stage."""
        if progress is not None:
            done = sum(s.seconds for s in todo.stages if s.name in begun and s.name != name)
            done += share * sum(s.seconds for s in todo.stages if s.name == name)
            progress(name, min(1.0, done / total))

    def begin(name: str, share: float = 0.0) -> None:
        """Start a stage, which ends the one before."""
        begun[name] = time.perf_counter()
        tell(name, share)

    if isinstance(scene.wall, MeshWall):
        begin("mesh surface")
        scene.wall.fit_residual  # noqa: B018  (fits and caches the surface)
    begin("exit pupil")
    found = psf.scene_point_spread(optics, tol, progress=begin)
    spread = found.point_spread
    errors = {"point spread": spread.error_estimate}
    field = None
    if todo.runs(FIELD):
        begin(FIELD)
        field, errors[FIELD] = imaging.image_field(
            optics,
            tol=tol,
            most_nodes=MOST_NODES,
            progress=lambda _, share: tell(FIELD, share),
        )
    shadows = None
    if todo.runs("shadow rays"):
        begin("shadow rays")
        shadows = imaging.cast_shadows(scene)
    begin("image")
    wide = psf.widened(field or spread, tol=tol / 4, shape=scene.camera.shape)
    image = imaging.form_image(scene, wide, seed=seed, shadows=shadows)
    reconstruction = None
    if todo.runs("reconstruction"):
        begin("reconstruction")
        reconstruction = _reconstruct(scene, image, field.mean() if field else spread.intensity)
    ends = [*list(begun.values())[1:], time.perf_counter()]
    if progress is not None:
        progress("done", 1.0)
    return Result(
        scene=scene,
        plan=todo,
        exit_pupil=found.exit_pupil,
        wavefront=found.wavefront,
        point_spread=spread,
        field=field,
        image=image,
        reconstruction=reconstruction,
        errors=errors,
        timings={name: end - begun[name] for name, end in zip(begun, ends, strict=True)},
        seed=seed,
    )


def _reconstruct(scene: Scene, image: SpeckleImage, spread: Array) -> Reconstruction:
    """Object from the reading, with pose, point spread and the veil's shape known."""
    from .. import inverse
    from ..imaging import ForwardModel

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
    from ..imaging import diffuse_background

    stand_in = None
    if isinstance(scene.hidden, PlanarObject):
        # a white plate for the unknown picture, by its four Gauss points
        stand_in = np.zeros((7, 7))
        stand_in[1::4, 1::4] = 1.0
        if scene.occluders:  # whose shadows need all of it
            stand_in = np.ones((7, 7))
    return diffuse_background(scene, stand_in)
