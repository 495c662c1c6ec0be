"""Reconstruction of a camera's own pictures, with the scene known: what the command does.

The solvers are those of `inverse`, by a short name. While one works, its state is kept in a folder,
so that a fit that was ended can go on.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._random import checked_seed
from .errors import SamplingError, SceneError
from .imaging import CameraImage, ForwardModel, camera_image, image_field
from .limits.modulation import scene_point_spread
from .planning import FIELD, MOST_NODES, plan
from .records import arrays, scene_hash, versions
from .scene import Scene
from .simulation import veil_shape

if TYPE_CHECKING:
    from .inverse import Reconstruction
    from .inverse.callbacks import Snapshot

Array = NDArray[np.float64]

#: Names of methods, the function of `inverse` each means, and the recipe of `pcin`.
METHODS: dict[str, tuple[str, str | None]] = {
    "tv": ("tv_deconvolve", None),
    "wiener": ("wiener", None),
    "inverse": ("inverse_filter", None),
    "richardson-lucy": ("richardson_lucy", None),
    "image-prior": ("deep_image_prior", None),
    "staged": ("pcin", "staged"),
    "evidence": ("pcin", "evidence"),
    "wu2024": ("pcin", "wu2024"),
}
CHECKPOINT, PREVIEW = "checkpoint.npz", "preview.png"
FILES = ("object.npy", "object.png", "reconstruction.npz")
KEPT_EVERY = 5.0  # s between two states kept
LEAST_WITHIN = 0.5  # share of a point spread's light that an image must hold


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A reconstruction that is ready to run.

    Parameters
    ----------
    scene : Scene
    images : tuple of CameraImage
        One, or frames of different known focus.
    method : str
        One of `methods`.
    defocus : tuple of float
        Known extra focus of each frame, waves rms; empty where the method takes none.
    seed : int
    tol : float
        Wanted error of the point spread, as of `plan`.
    """

    scene: Scene
    images: tuple[CameraImage, ...]
    method: str
    defocus: tuple[float, ...] = ()
    seed: int = 0
    tol: float = 1e-3

    def identity(self) -> str:
        """What a kept state must share with the task that goes on from it."""
        digest = hashlib.sha256(self.method.encode())
        for image in self.images:
            digest.update(image.values.tobytes() + image.masked.tobytes())
        digest.update(repr((self.defocus, self.seed)).encode())
        return digest.hexdigest()


def methods() -> tuple[str, ...]:
    """Names of the methods that `inverse` has; loads torch."""
    from . import inverse

    return tuple(name for name, (function, _) in METHODS.items() if hasattr(inverse, function))


def prepared(
    scene: Scene,
    paths: Sequence[Path],
    *,
    method: str = "tv",
    dark: Path | None = None,
    flat: Path | None = None,
    full: float | None = None,
    defocus: Sequence[float] = (),
    seed: int = 0,
    tol: float = 1e-3,
) -> Task:
    """Read and check pictures against the scene and the method.

    Parameters
    ----------
    scene : Scene
    paths : sequence of Path
        Picture files; exposures of one scene are averaged, unless ``defocus`` tells them apart.
    method : str
        One of `methods`.
    dark, flat, full
        As of `imaging.camera_image`.
    defocus : sequence of float
        Known extra focus of each picture, waves rms, for methods that fit the wall's wave too.
    seed : int
    tol : float

    Returns
    -------
    Task

    Raises
    ------
    SceneError, SamplingError
        If a picture, the scene or an option does not fit.
    """
    checked_seed(seed)
    known = methods()
    if method not in known:
        raise SceneError(f"method = {method!r} is unknown, must be one of {', '.join(known)}")
    if scene.wall_material.specular_reflectance == 0.0:
        raise SceneError(
            "the scene's wall has no mirror-like lobe (wall.material), and a diffuse wall passes "
            "no picture; nlosoptics feasibility tells what it does pass"
        )
    blind = METHODS[method][1] is not None
    if defocus and not blind:
        raise SceneError(
            f"defocus is given, and {method} takes the point spread from the scene; leave it out"
        )
    if defocus and len(defocus) != len(paths):
        raise SceneError(
            f"defocus has {len(defocus)} values for {len(paths)} pictures; give one for each"
        )
    groups: list[Sequence[Path]] = [[path] for path in paths] if blind else [paths]
    images = tuple(
        camera_image(group, shape=scene.camera.shape, dark=dark, flat=flat, full=full)
        for group in groups
    )
    return Task(
        scene=scene,
        images=images,
        method=method,
        defocus=tuple(defocus),
        seed=seed,
        tol=tol,
    )


def reconstructed(
    task: Task,
    *,
    model: ForwardModel | None = None,
    start: Mapping[str, Any] | None = None,
    progress: Any = None,
) -> Reconstruction:
    """Run a task.

    Parameters
    ----------
    task : Task
    model : ForwardModel, optional
        By `known_model`, lest it be made again.
    start : mapping, optional
        A solver's state to go on from; see `inverse.callbacks`.
    progress : callable, optional
        As of the solvers; may raise `inverse.Stop` and may have a method ``look``.

    Returns
    -------
    Reconstruction
    """
    from . import inverse

    function, recipe = METHODS[task.method]
    solver = getattr(inverse, function)
    found: Reconstruction
    if recipe is not None:
        found = _blind(task, solver, recipe, start, progress)
        return found
    (image,) = task.images
    model = model or known_model(task.scene, tol=task.tol)
    veil = veil_shape(task.scene)
    sigma = inverse.estimate_noise(image.values)
    offered = {
        "noise_sigma": image.noise(sigma) if sigma > 0.0 else None,
        "background_shape": veil if veil.any() else None,
        "seed": task.seed,
        "start": start,
        "progress": progress,
    }
    found = solver(image.values, model, **_taken(solver, task.method, offered))
    return found


def _blind(
    task: Task, solver: Any, recipe: str, start: Mapping[str, Any] | None, progress: Any
) -> Reconstruction:
    """Fit of object and wave, from frames of known extra focus."""
    from . import inverse

    frames = np.stack([image.values for image in task.images])
    if any(image.masked.any() for image in task.images):
        raise SceneError(
            f"{task.method} takes no masked pixels, and some are full; expose shorter, or use tv"
        )
    waves = np.array(task.defocus or [0.0] * len(frames))
    offered = {
        "defocus": waves * task.scene.laser.wavelength,
        "recipe": recipe,
        "seed": task.seed,
        "start": start,
        "progress": progress,
    }
    # by name, as the solver is: without torch's part there is neither
    pupil = getattr(inverse, "PupilPSF").from_scene(task.scene)  # noqa: B009
    found: Reconstruction = solver(frames, pupil, **_taken(solver, task.method, offered))
    return found


def _taken(solver: Any, method: str, offered: dict[str, Any]) -> dict[str, Any]:
    """Of the options offered, those of the solver's own signature."""
    known = inspect.signature(solver).parameters
    if offered.get("start") is not None and "start" not in known:
        raise SceneError(f"{method} cannot go on from a kept state; run it without --resume")
    return {name: value for name, value in offered.items() if name in known}


def known_model(scene: Scene, *, tol: float = 1e-3) -> ForwardModel:
    """Image model of a scene by the point spread that stands for its object.

    Parameters
    ----------
    scene : Scene
    tol : float
        As of `plan`.

    Returns
    -------
    ForwardModel

    Raises
    ------
    SamplingError
        If the image holds less than half of the point spread's light.
    NlosError
        As of `plan`.
    """
    if plan(scene, tol, reconstruct=True).runs(FIELD):
        spread = image_field(scene, tol=tol, most_nodes=MOST_NODES)[0].mean()
    else:
        spread = scene_point_spread(scene, tol=tol)[1].intensity
    shape = scene.camera.shape
    middle = tuple(
        slice(max(0, n // 2 - m // 2), n // 2 - m // 2 + m)
        for n, m in zip(spread.shape, shape, strict=True)
    )
    within = float(spread[middle].sum())
    if within < LEAST_WITHIN:
        raise SamplingError(
            f"an image of {shape[1]} x {shape[0]} pixels holds {100 * within:.2g} % of the point "
            f"spread's light, limit {100 * LEAST_WITHIN:g} %: the blur is larger than the image; "
            "read more pixels, or focus better"
        )
    return ForwardModel(spread, shape=shape)


def carry_out(
    task: Task,
    folder: Path,
    *,
    resume: bool = False,
    progress: Callable[[str, float], None] | None = None,
    interrupted: Callable[[], bool] | None = None,
) -> dict[str, Any]:
    """Run a task and write its files into a folder, which is made where there is none.

    Parameters
    ----------
    task : Task
    folder : Path
    resume : bool
        Go on from the state that the folder keeps.
    progress : callable(str, float), optional
        Told what is at work and the fraction done.
    interrupted : callable, optional
        Whether the fit is to end with what it has.

    Returns
    -------
    dict
        The contents of ``result.json``; status "done" or "interrupted".
    """
    from .inverse import Stop

    started = time.perf_counter()
    identity = f"{scene_hash(task.scene)} {task.identity()}"
    start = kept_state(folder, identity) if resume else None
    report = {
        "program": "nlosoptics",
        "command": "reconstruct",
        "status": "running",
        "seed": task.seed,
        "tol": task.tol,
        "scene_sha256": scene_hash(task.scene),
        "resumed": resume,
        "versions": versions(),
        "files": ["result.json", CHECKPOINT, PREVIEW],
    }
    model = None
    if METHODS[task.method][1] is None:
        if progress is not None:
            progress("point spread", 0.0)
        model = known_model(task.scene, tol=task.tol)
    if interrupted is not None and interrupted():
        raise KeyboardInterrupt
    folder.mkdir(exist_ok=True)
    write_text(folder / "result.json", report)
    keeper = Keeper(folder, identity, progress, interrupted)
    try:
        found = reconstructed(task, model=model, start=start, progress=keeper)
    except Stop:
        raise KeyboardInterrupt from None  # by a solver that does not keep what it has
    _write_object(task, found, folder, keeper)
    report["status"] = "interrupted" if keeper.stopped else "done"
    report["figures"] = _figures(task, found)
    report["seconds"] = {"solver": found.seconds, "total": time.perf_counter() - started}
    report["files"] = sorted({*FILES, "result.json", CHECKPOINT, PREVIEW})
    write_text(folder / "result.json", report)
    return report


def _write_object(task: Task, found: Reconstruction, folder: Path, keeper: Keeper) -> None:
    """Write the object and what else was found; keep the last state."""
    picture = np.asarray(found.object)
    with (folder / ".object.npy").open("wb") as file:
        np.save(file, picture)
    (folder / ".object.npy").replace(folder / "object.npy")
    write_picture(folder / "object.png", picture)
    with (folder / ".reconstruction.npz").open("wb") as file:
        np.savez(file, **arrays(found))
    (folder / ".reconstruction.npz").replace(folder / "reconstruction.npz")
    keeper.finish({"object": picture * float(found.physical_parameters["gain"])})


def _figures(task: Task, found: Reconstruction) -> dict[str, Any]:
    """Numbers that sum up a reconstruction."""
    settled = {
        name: value if np.ndim(value) == 0 else np.asarray(value).tolist()
        for name, value in found.physical_parameters.items()
    }
    records = [len(record) for record in found.history.values()]
    return {
        "method": task.method,
        "reconstruction_status": found.status,
        "reconstruction_score": found.score,
        "iterations": max(records, default=0),
        "physical_parameters": settled,
        "image_shape": list(task.images[0].values.shape),
        "saturated_fraction": max(image.saturated_fraction for image in task.images),
        "masked_fraction": max(float(image.masked.mean()) for image in task.images),
    }


class Keeper:
    """A solver's callback that keeps its state and a preview in a folder, now and then.

    Parameters
    ----------
    folder : Path
    identity : str
        Of the task and its scene.
    progress : callable(str, float), optional
        Told the solver's text and the fraction done.
    interrupted : callable, optional
        Whether to end the fit.
    """

    def __init__(
        self,
        folder: Path,
        identity: str,
        progress: Callable[[str, float], None] | None = None,
        interrupted: Callable[[], bool] | None = None,
    ) -> None:
        self._folder, self._identity = folder, identity
        self._progress, self._interrupted = progress, interrupted
        self._last = time.monotonic()
        self._state: Mapping[str, Array] | None = None
        self._unseen = 0  # reports since the last look
        self.stopped = False

    def __call__(self, fraction: float, text: str) -> None:
        """Pass on where the solver stands, and end it where that was asked for."""
        from .inverse import Stop

        if self._progress is not None:
            self._progress(text, fraction)
        # a solver that shows no state can only be ended without one
        self._unseen += 1
        if self._unseen > 1 and self._interrupted is not None and self._interrupted():
            raise Stop

    def look(self, snapshot: Snapshot) -> None:
        """Keep the state if the last one is old enough, or the fit is to end."""
        from .inverse import Stop

        self._unseen = 0
        ends = self._interrupted is not None and self._interrupted()
        if ends or time.monotonic() - self._last >= KEPT_EVERY:
            self._state = snapshot()
            self._keep(self._state)
            self._last = time.monotonic()
        if ends:
            self.stopped = True
            raise Stop

    def finish(self, state: Mapping[str, Array]) -> None:
        """Keep the last state: that at which a fit was ended, or what it came to."""
        self._keep(self._state if self.stopped and self._state is not None else state)

    def _keep(self, state: Mapping[str, Array]) -> None:
        """Write state and preview, each file whole or not at all."""
        temporary = self._folder / f".{CHECKPOINT}"
        with temporary.open("wb") as file:
            np.savez(file, **{"identity": np.array(self._identity), **state})  # type: ignore[arg-type]
        temporary.replace(self._folder / CHECKPOINT)
        write_picture(self._folder / PREVIEW, state["object"])


def kept_state(folder: Path, identity: str) -> dict[str, Array]:
    """The state kept in a folder by the same task.

    Raises
    ------
    SceneError
        If there is none, it cannot be read, or scene, pictures or method were others.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise SceneError(f"there is no {path} to resume from; run without --resume")
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        found = str(state.pop("identity"))
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise SceneError(
            f"{path} cannot be read ({type(error).__name__}); run without --resume"
        ) from None
    if found != identity:
        raise SceneError(
            f"{path} is of another scene, picture, method or seed; run without --resume"
        )
    return state


def write_picture(path: Path, values: Array) -> None:
    """Write an object as an 8-bit picture, 0 to its largest value, whole or not at all."""
    from PIL import Image

    largest = float(values.max())
    grey = np.clip(values / largest if largest > 0.0 else values, 0.0, 1.0)
    temporary = path.with_name(f".{path.name}")
    Image.fromarray(np.rint(255.0 * grey).astype(np.uint8)).save(temporary, format="PNG")
    temporary.replace(path)


def write_text(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report as JSON, whole or not at all."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(report, indent=2, allow_nan=False) + os.linesep)
    temporary.replace(path)
