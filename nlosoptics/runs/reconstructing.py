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
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from .._progress import Progress
from .._random import checked_seed
from ..errors import SamplingError, SceneError
from ..imaging import CameraImage, ForwardModel, camera_image, image_field
from ..psf import SceneOptics, scene_point_spread
from ..scene import Scene
from .plan import FIELD, MOST_NODES, plan
from .record import PAGE, arrays, now, scene_hash, versions
from .simulate import veil_shape

if TYPE_CHECKING:
    from ..inverse import CnnBaseline, Reconstruction
    from ..inverse.data.checkpoints import Snapshot

Array = NDArray[np.float64]

#: Names of methods that take the point spread from the scene; the function of `inverse`.
KNOWN = {
    "tv": "tv_deconvolve",
    "wiener": "wiener",
    "inverse_filter": "inverse_filter",
    "richardson_lucy": "richardson_lucy",
    "deep_image_prior": "deep_image_prior",
    "phase_retrieval": "phase_retrieval",
}
#: Recipes of `inverse.pcin`, which fit the wall's wave too.
BLIND = ("staged", "evidence", "wu2024")
CNN = "cnn"
METHODS = (*KNOWN, CNN, *BLIND)
#: Noll modes of the wave that a blind method fits: n = 2..5.
MODES = tuple(range(4, 22))
#: More values of one figure than these are in the arrays alone.
MOST_VALUES = 200
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
        One of `METHODS`.
    defocus : tuple of float
        Known extra focus of each frame, waves rms; empty where the method takes none.
    network : inverse.CnnBaseline or None
        Of the method "cnn".
    iterations : int or None
        At most so many, or as many as the method takes by itself.
    seed : int
    tol : float
        Wanted error of the point spread, as of `plan`.
    """

    scene: Scene
    images: tuple[CameraImage, ...]
    method: str
    defocus: tuple[float, ...] = ()
    network: CnnBaseline | None = None
    iterations: int | None = None
    seed: int = 0
    tol: float = 1e-3

    def identity(self) -> str:
        """What a kept state must share with the task that goes on from it."""
        digest = hashlib.sha256(self.method.encode())
        for image in self.images:
            digest.update(image.values.tobytes() + image.masked.tobytes())
        digest.update(repr((self.defocus, self.seed, self.iterations, self.tol)).encode())
        return digest.hexdigest()


def prepared(
    scene: Scene,
    paths: Sequence[Path],
    *,
    method: str = "tv",
    dark: Path | None = None,
    flat: Path | None = None,
    full: float | None = None,
    defocus: Sequence[float] = (),
    network: Path | None = None,
    iterations: int | None = None,
    seed: int = 0,
    tol: float = 1e-3,
) -> Task:
    """Read and check pictures against the scene and the method.

    Parameters
    ----------
    scene : Scene
    paths : sequence of Path
        Picture files. Exposures of one scene are averaged, save by methods that fit the wall's
        wave too: to them each is an image of its own, told apart by ``defocus``.
    method : str
        One of `METHODS`.
    dark, flat, full
        As of `imaging.camera_image`.
    defocus : sequence of float
        Known extra focus of each picture, waves rms, for methods that fit the wall's wave too.
    network : Path, optional
        File of the network of the method "cnn".
    iterations : int, optional
        At most so many.
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
    if method not in METHODS:
        raise SceneError(f"method = {method!r} is unknown, must be one of {', '.join(METHODS)}")
    if scene.wall_material.specular_reflectance == 0.0:
        raise SceneError(
            "the scene's wall has no mirror-like lobe (wall.material), and a diffuse wall passes "
            "no picture; nlosoptics feasibility tells what it does pass"
        )
    blind = method in BLIND
    if defocus and not blind:
        raise SceneError(
            f"defocus is given, and {method} takes the point spread from the scene; leave it out"
        )
    if defocus and len(defocus) != len(paths):
        raise SceneError(
            f"defocus has {len(defocus)} values for {len(paths)} pictures; give one for each"
        )
    if iterations is not None and method in (CNN, "inverse_filter"):
        raise SceneError(f"iterations is given, and {method} has none; leave it out")
    loaded = _network(method, network)
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
        network=loaded,
        iterations=iterations,
        seed=seed,
        tol=tol,
    )


def _network(method: str, path: Path | None) -> CnnBaseline | None:
    """The trained network that a method needs."""
    from ..inverse import CnnBaseline

    if path is None and method == CNN:
        raise SceneError("cnn needs a trained network; name its file, made by nlosoptics train")
    if path is not None and method != CNN:
        raise SceneError(f"network is given, and {method} uses none; leave it out")
    return None if path is None else CnnBaseline.load(path)


def reconstructed(
    task: Task,
    *,
    model: ForwardModel | None = None,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Run a task.

    Parameters
    ----------
    task : Task
    model : ForwardModel, optional
        Result of `known_model`; computed if omitted.
    start : mapping, optional
        A solver's state to go on from; see `inverse.data.checkpoints`.
    progress : callable(str, float), optional
        As of the solvers; may raise `inverse.Stop` and may have a method ``look``.

    Returns
    -------
    Reconstruction
    """
    from .. import inverse

    if task.method in BLIND:
        return _blind(task, start, progress)
    solver = getattr(inverse, KNOWN[task.method]) if task.network is None else _trained(task)
    (image,) = task.images
    model = model or known_model(task.scene, tol=task.tol)
    veil = veil_shape(task.scene)
    sigma = inverse.estimate_noise(image.values)
    offered = {
        "noise_sigma": image.noise(sigma) if sigma > 0.0 else None,
        "background_shape": veil if veil.any() else None,
        **_always(task, start, progress),
    }
    found: Reconstruction = solver(image.values, model, **_taken(solver, task.method, offered))
    return found


def _trained(task: Task) -> Callable[..., Reconstruction]:
    assert task.network is not None  # `prepared` has seen to it
    return task.network.reconstruct


def _blind(
    task: Task, start: Mapping[str, Any] | None, progress: Progress | None
) -> Reconstruction:
    """Fit of object and wave, from frames of known extra focus."""
    from .. import inverse
    from ..inverse.wave.frames import padded_shape

    scene = task.scene
    frames = np.stack([image.values for image in task.images])
    if any(image.masked.any() for image in task.images):
        raise SceneError(
            f"{task.method} takes no masked pixels, and some are full; expose shorter, or use tv"
        )
    shape = scene.camera.shape
    if task.method != "wu2024":  # which has no room around its frame
        shape = padded_shape(shape)
    pupil = inverse.PupilPSF.from_scene(
        scene,
        MODES,
        pitch=scene.camera.image_pitch,
        shape=shape,
        pixel_integrated=True,
    )
    offered = _always(task, start, progress)
    if task.defocus:
        offered["defocus"] = np.array(task.defocus) * scene.laser.wavelength
    return inverse.pcin(frames, pupil, recipe=task.method, **offered)


def _always(
    task: Task, start: Mapping[str, Any] | None, progress: Progress | None
) -> dict[str, Any]:
    """Options that any method may take."""
    offered: dict[str, Any] = {"seed": task.seed, "start": start, "progress": progress}
    if task.iterations is not None:
        offered["max_iterations"] = task.iterations
    return offered


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
    todo = plan(scene, tol, reconstruct=True)
    optics = SceneOptics(scene, todo.exit_pupil)
    if todo.runs(FIELD):
        spread = image_field(optics, tol=tol, most_nodes=MOST_NODES)[0].mean()
    else:
        spread = scene_point_spread(optics, tol).point_spread.intensity
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
    progress: Progress | None = None,
    interrupted: Callable[[], bool] | None = None,
    command_line: str = "",
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
    command_line : str
        What was typed, for the record.

    Returns
    -------
    dict
        The contents of ``result.json``; status "done" or "interrupted".
    """
    from ..inverse import Stop

    started = time.perf_counter()
    identity = f"{scene_hash(task.scene)} {task.identity()}"
    start = kept_state(folder, identity) if resume else None
    report = {
        "program": "nlosoptics",
        "command": "reconstruct",
        "command_line": command_line,
        "status": "running",
        "seed": task.seed,
        "tol": task.tol,
        "scene_sha256": scene_hash(task.scene),
        "resumed": resume,
        "versions": versions(),
        "files": ["result.json", CHECKPOINT, PREVIEW],
    }
    model = None
    if task.method not in BLIND:
        if progress is not None:
            progress("point spread", 0.0)
        model = known_model(task.scene, tol=task.tol)
    if interrupted is not None and interrupted():
        raise KeyboardInterrupt
    folder.mkdir(exist_ok=True)
    (folder / PAGE).unlink(missing_ok=True)  # it tells of what was here before
    write_text(folder / "result.json", report)
    keeper = Keeper(folder, identity, progress, interrupted)
    try:
        found = reconstructed(task, model=model, start=start, progress=keeper)
    except Stop:
        raise KeyboardInterrupt from None  # by a solver that does not keep what it has
    _write_object(task, found, folder, keeper)
    report["status"] = "interrupted" if keeper.stopped else "done"
    report["finished"] = now()
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
    keeper.finish({"object": picture * float(found.physical_parameters.get("gain", 1.0))})


def _figures(task: Task, found: Reconstruction) -> dict[str, Any]:
    """Numbers that sum up a reconstruction."""
    settled = {
        name: _plain(np.asarray(value))
        for name, value in found.physical_parameters.items()
        if np.size(value) <= MOST_VALUES
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


def _plain(values: NDArray[Any]) -> Any:
    """Numbers for JSON, which has none for what a method does not tell: null."""
    told: Any = values.tolist()
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return told
    return None if values.ndim == 0 else [_plain(np.asarray(value)) for value in told]


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
        progress: Progress | None = None,
        interrupted: Callable[[], bool] | None = None,
    ) -> None:
        self._folder, self._identity = folder, identity
        self._progress, self._interrupted = progress, interrupted
        self._last = time.monotonic()
        self._state: Mapping[str, Array] | None = None
        self._unseen = 0  # reports since the last look
        self.stopped = False

    def __call__(self, text: str, fraction: float) -> None:
        """Pass on where the solver stands, and end it where that was asked for."""
        from ..inverse import Stop

        if self._progress is not None:
            self._progress(text, fraction)
        # a solver that shows no state can only be ended without one
        self._unseen += 1
        if self._unseen > 1 and self._interrupted is not None and self._interrupted():
            raise Stop

    def look(self, snapshot: Snapshot) -> None:
        """Keep the state if the last one is old enough, or the fit is to end."""
        from ..inverse import Stop

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
        If there is none, it cannot be read, or scene, pictures or options were others.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise SceneError(f"there is no {path} to resume from; run without --resume")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        found = str(state.pop("identity"))
    except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile) as error:
        raise SceneError(
            f"{path} cannot be read ({type(error).__name__}); run without --resume"
        ) from None
    if found != identity:
        raise SceneError(
            f"{path} is of another scene, picture, method, defocus, seed, tolerance or number of "
            "iterations; give those again, or run without --resume"
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
