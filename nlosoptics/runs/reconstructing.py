"""Reconstruction from camera images of a known scene, as ``nlosoptics reconstruct`` does it.

Call `prepared` with the image files, then `reconstructed`, or `carry_out` to write a folder. The
latter saves the state during the fit, so that an interrupted fit can be resumed.
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

from .._checks import counted
from .._progress import Progress
from .._random import checked_seed
from .._whole_files import RECORD, whole_folder
from ..errors import SamplingError, SceneError
from ..imaging import CameraImage, ForwardModel, camera_image
from ..psf import PointSpreadField, SceneOptics
from ..scene import Scene
from .noise import camera_noise
from .plan import plan
from .record import arrays, now, scene_hash, versions
from .simulate import image_model, image_spreads
from .veil import fitted_veil

if TYPE_CHECKING:
    from ..inverse import CnnBaseline, Reconstruction
    from ..inverse.data.checkpoints import Snapshot

Array = NDArray[np.float64]

#: Methods that take the point spread from the scene, and their functions in `inverse`.
KNOWN = {
    "tv": "tv_deconvolve",
    "wiener": "wiener",
    "inverse_filter": "inverse_filter",
    "richardson_lucy": "richardson_lucy",
    "deep_image_prior": "deep_image_prior",
    "phase_retrieval": "phase_retrieval",
}
#: Those that need a single point spread.
SINGLE = ("inverse_filter", "phase_retrieval")
#: Recipes of `inverse.pcin`, which fit the wall's wave as well as the object.
BLIND = ("evidence", "wu2024")
CNN = "cnn"
METHODS = (*KNOWN, CNN, *BLIND)
#: Noll indices of the wave modes that a blind method fits: radial orders 2 to 5.
MODES = tuple(range(4, 22))
#: Parameters with more values than this are saved in the arrays, not in ``result.json``.
MOST_VALUES = 200
CHECKPOINT, PREVIEW = "checkpoint.npz", "preview.png"
STATE = (CHECKPOINT, PREVIEW)
FILES = ("object.npy", "object.png", "reconstruction.npz")
KEPT_EVERY = 5.0  # s between two saved states
LEAST_WITHIN = 0.5  # least fraction of the point spread's energy inside the image frame


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Checked inputs of one reconstruction, made by `prepared`.

    Parameters
    ----------
    scene : Scene
        Scene in which the images were taken.
    images : tuple of CameraImage
        One image, or several for the methods "evidence" and "wu2024", which also fit the wall.
    method : str
        Name of the solver: "tv", "wiener", "inverse_filter", "richardson_lucy", "deep_image_prior",
        "phase_retrieval", "cnn", "evidence" or "wu2024".
    defocus : tuple of float
        Known additional defocus of each image, waves rms; empty if the wall is known.
    network : inverse.CnnBaseline or None
        Trained network of the method "cnn".
    iterations : int or None
        Maximum number of iterations; None for the method's default.
    seed : int
        Seed of the random numbers.
    tol : float
        Error tolerance of the point spread function, max |dI|/max I, with I the intensity.
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
        """Return a hash of method, images and options; a saved state must have the same one."""
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
    """Read camera images and check them against the scene and the method.

    Parameters
    ----------
    scene : Scene
        Scene in which the images were taken.
    paths : sequence of Path
        Image files. Most methods average them as exposures of the same scene. The methods
        "evidence" and "wu2024", which also fit the wall, need the ``defocus`` of each file.
    method : str
        Name of the solver, see `Task`.
    dark, flat : Path, optional
        Files of the dark frame and the flat field, see `imaging.camera_image`.
    full : float, optional
        Count at which a pixel is saturated; by default the largest of the file's type.
    defocus : sequence of float
        Known additional defocus of each image, waves rms; for "evidence" and "wu2024" only.
    network : Path, optional
        File of the trained network; required by the method "cnn", invalid otherwise.
    iterations : int, optional
        Maximum number of iterations; by default the method's own.
    seed : int
        Seed of the random numbers, 0 to 2^64 - 1.
    tol : float
        Error tolerance of the point spread function, max |dI|/max I, with I the intensity.

    Returns
    -------
    Task
        Input of `reconstructed` and `carry_out`.

    Raises
    ------
    SceneError
        If an image cannot be used, the wall has no mirror-like lobe, or an option does not fit
        the method.
    SamplingError
        If image sizes differ or do not fit the scene's camera.
    """
    checked_seed(seed)
    if method not in METHODS:
        raise SceneError(f"method = {method!r} is unknown, must be one of {', '.join(METHODS)}")
    if scene.wall_material.specular_reflectance == 0.0:
        raise SceneError(
            "the scene's wall has no mirror-like lobe (wall.material), and a diffuse wall forms "
            "no image; nlosoptics feasibility shows what can be recovered"
        )
    blind = method in BLIND
    if defocus and not blind:
        raise SceneError(
            f"defocus is given, but {method} takes the point spread from the scene; leave it out"
        )
    if defocus and len(defocus) != len(paths):
        raise SceneError(
            f"defocus has {counted(len(defocus), 'value')} for {counted(len(paths), 'image')}; "
            "give one for each"
        )
    if blind and not defocus and len(paths) > 1:
        raise SceneError(
            f"{len(paths)} images without defocus, but {method} needs the known defocus of each; "
            "give it, for example 0 and 0.5 waves rms, or average images of the same focus to one"
        )
    if iterations is not None and method in (CNN, "inverse_filter"):
        raise SceneError(f"iterations is given, but {method} does not iterate; leave it out")
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
    """Load the trained network if the method is "cnn"; reject one for any other method."""
    if path is None and method == CNN:
        raise SceneError("cnn needs a trained network; name a file written by nlosoptics train")
    if path is not None and method != CNN:
        raise SceneError(f"network is given, but {method} uses none; leave it out")
    if path is None:
        return None
    from ..inverse import CnnBaseline

    return CnnBaseline.load(path)


def reconstructed(
    task: Task,
    *,
    model: ForwardModel | None = None,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Run a reconstruction and return the solver's result.

    Parameters
    ----------
    task : Task
        Inputs, from `prepared`.
    model : ForwardModel, optional
        Result of `known_model`; computed if omitted. "evidence" and "wu2024" do not use it.
    start : mapping, optional
        Saved state of the solver, from which the fit resumes; see `inverse.Stop`.
    progress : callable(str, float), optional
        Function that is called with a text and the completed fraction, 0 to 1. It may end the fit
        and save its state, see `inverse.Stop`.

    Returns
    -------
    Reconstruction
        Object, status, score and fitted parameters.
    """
    from .. import inverse

    if task.method in BLIND:
        return _blind(task, start, progress)
    network = task.network
    solver = getattr(inverse, KNOWN[task.method]) if network is None else network.reconstruct
    (image,) = task.images
    model = model or known_model(task.scene, tol=task.tol, mean=task.method in SINGLE)
    noise = camera_noise(task.scene, image, model)
    veil = None
    if task.method != "phase_retrieval":  # which has no use for it
        veil = fitted_veil(task.scene, image.values, model, noise_sigma=noise)
    full = image.saturated if image.saturated.any() else None  # None: its level is searched for
    measured = inverse.Measurement(
        image.values, noise_sigma=noise, saturated=full, background_shape=veil
    )
    offered = _taken(solver, task.method, _always(task, start, progress))
    found: Reconstruction = solver(measured, model, **offered)
    return found


def _blind(
    task: Task, start: Mapping[str, Any] | None, progress: Progress | None
) -> Reconstruction:
    """Fit object and wave together to frames with known defocus."""
    from .. import inverse

    scene = task.scene
    offered = _always(task, start, progress)
    masked = np.stack([image.masked for image in task.images])
    if masked.any() and task.method == "wu2024":
        raise SceneError(
            f"{np.count_nonzero(masked)} pixels are saturated or dead, and wu2024 cannot mask "
            "pixels; use evidence or tv"
        )
    pupil = inverse.PupilPSF.from_scene(
        scene,
        MODES,
        pitch=scene.camera.image_pitch,
        shape=scene.camera.shape,
        pixel_integrated=True,
    )
    if task.defocus:
        offered["defocus"] = np.array(task.defocus) * scene.laser.wavelength
    measured = inverse.Measurement(np.stack([image.values for image in task.images]), masked=masked)
    return inverse.pcin(measured, pupil, recipe=task.method, **offered)


def _always(
    task: Task, start: Mapping[str, Any] | None, progress: Progress | None
) -> dict[str, Any]:
    """Options common to all methods."""
    offered: dict[str, Any] = {"seed": task.seed, "start": start, "progress": progress}
    if task.iterations is not None:
        offered["max_iterations"] = task.iterations
    return offered


def _taken(solver: Any, method: str, offered: dict[str, Any]) -> dict[str, Any]:
    """Select those options that the solver's signature accepts."""
    known = inspect.signature(solver).parameters
    if offered.get("start") is not None and "start" not in known:
        raise SceneError(f"{method} cannot resume from a saved state; run it without --resume")
    return {name: value for name, value in offered.items() if name in known}


def known_model(scene: Scene, *, tol: float = 1e-3, mean: bool = False) -> ForwardModel:
    """Return the image model of a scene: convolution with its PSF, or with a field of PSFs.

    Parameters
    ----------
    scene : Scene
        Scene to model.
    tol : float
        Error tolerance of the PSF, max |dI|/max I, with I the intensity.
    mean : bool
        Whether to use the mean PSF over the object in any case, for solvers that need a single one.
        It is also used if the PSFs deviate from it by at most 5 % rms.

    Returns
    -------
    ForwardModel
        Image model of the shape of the camera image.

    Raises
    ------
    SamplingError
        If less than half of the energy of the point spread function (PSF) falls inside the image.
    NlosError
        If `plan` rejects the scene; see there.

    Examples
    --------
    >>> from nlosoptics import Scene, reconstructing
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> model = reconstructing.known_model(scene, tol=1e-2)
    >>> model.shape
    (32, 32)
    """
    todo = plan(scene, tol, reconstruct=True)
    spreads, _ = image_spreads(todo, SceneOptics(scene, todo.exit_pupil), anywhere=True)
    spread = spreads.mean() if isinstance(spreads, PointSpreadField) else spreads.intensity
    shape = scene.camera.shape
    middle = tuple(
        slice(max(0, n // 2 - m // 2), n // 2 - m // 2 + m)
        for n, m in zip(spread.shape, shape, strict=True)
    )
    within = float(spread[middle].sum())
    if within < LEAST_WITHIN:
        raise SamplingError(
            f"an image of {shape[1]} x {shape[0]} pixels holds {100 * within:.2g} % of the point "
            f"spread's energy, must be at least {100 * LEAST_WITHIN:g} %: the blur is larger than "
            "the image; read more pixels, or focus better"
        )
    return image_model(scene, spreads, mean=mean)


def carry_out(
    task: Task,
    folder: Path,
    *,
    resume: bool = False,
    progress: Progress | None = None,
    interrupted: Callable[[], bool] | None = None,
    command_line: str = "",
) -> dict[str, Any]:
    """Run a reconstruction and write the object, its picture and ``result.json`` to a folder.

    Parameters
    ----------
    task : Task
        Inputs, from `prepared`.
    folder : Path
        Output folder, created if missing.
    resume : bool
        Whether to resume the fit from the state saved in the folder.
    progress : callable(str, float), optional
        Function that is called with a text and the completed fraction, 0 to 1.
    interrupted : callable, optional
        Function without arguments that returns True once the fit is to end with its current state.
    command_line : str
        Command line as typed, for the record.

    Returns
    -------
    dict
        Contents of ``result.json``, with status "done" or "interrupted".
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
    }
    model = None
    if task.method not in BLIND:
        if progress is not None:
            progress("point spread", 0.0)
        model = known_model(task.scene, tol=task.tol, mean=task.method in SINGLE)
    if interrupted is not None and interrupted():
        raise KeyboardInterrupt
    with whole_folder(folder) as new:
        drafts = new.parent
        _announce(report, folder, drafts)
        keeper = Keeper(folder, drafts, identity, progress, interrupted)
        try:
            found = reconstructed(task, model=model, start=start, progress=keeper)
        except Stop:
            raise KeyboardInterrupt from None  # this solver ends without a result
        picture = np.asarray(found.object)
        np.save(new / "object.npy", picture)
        write_picture(new / "object.png", picture)
        np.savez(new / "reconstruction.npz", **arrays(found))
        gain = float(found.physical_parameters.get("gain", 1.0))
        keeper.finish(new, {"object": picture * gain})
        report["status"] = "interrupted" if keeper.stopped else "done"
        report["finished"] = now()
        report["figures"] = _figures(task, found)
        report["seconds"] = {"solver": found.seconds, "total": time.perf_counter() - started}
        report["files"] = sorted({*FILES, *STATE, RECORD})
        write_text(new / RECORD, report)
    return report


def _announce(report: Mapping[str, Any], folder: Path, drafts: Path) -> None:
    """Record that a folder gets a state: by a report, or in the list of files of an old result.

    The old result stays as it is until the new one is complete.
    """
    begun = drafts / "begun"
    begun.mkdir()
    try:
        old = json.loads((folder / RECORD).read_bytes())
        files = {*old["files"], *STATE, RECORD}
    except (OSError, ValueError, KeyError, TypeError):
        old, files = {"status": "running"}, {*STATE, RECORD}
    told = report if old.get("status") == "running" else old
    write_text(begun / RECORD, {**told, "files": sorted(files)})
    if folder.exists():
        (begun / RECORD).replace(folder / RECORD)
    else:
        begun.rename(folder)


def _figures(task: Task, found: Reconstruction) -> dict[str, Any]:
    """Key figures of a reconstruction for ``result.json``."""
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
        "reconstruction_reasons": list(found.reasons),
        "iterations": max(records, default=0),
        "physical_parameters": settled,
        "image_shape": list(task.images[0].values.shape),
        "saturated_fraction": max(image.saturated_fraction for image in task.images),
        "masked_fraction": max(float(image.masked.mean()) for image in task.images),
    }


def _plain(values: NDArray[Any]) -> Any:
    """Convert values for JSON; values that are not finite become null."""
    told: Any = values.tolist()
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return told
    return None if values.ndim == 0 else [_plain(np.asarray(value)) for value in told]


class Keeper:
    """Progress callback for solvers that saves state and preview every `KEPT_EVERY` seconds.

    Parameters
    ----------
    folder : Path
        Folder for the state and the preview.
    drafts : Path
        Folder on the same disk, in which both are written before they are put in place.
    identity : str
        Hash of the task and its scene, saved with the state.
    progress : callable(str, float), optional
        Receives the solver's text and the completed fraction.
    interrupted : callable, optional
        Returns True once the fit is to end.
    """

    def __init__(
        self,
        folder: Path,
        drafts: Path,
        identity: str,
        progress: Progress | None = None,
        interrupted: Callable[[], bool] | None = None,
    ) -> None:
        self._folder, self._drafts, self._identity = folder, drafts, identity
        self._progress, self._interrupted = progress, interrupted
        self._last = time.monotonic()
        self._state: Mapping[str, Array] | None = None
        self._unseen = 0  # reports since the last look
        self.stopped = False

    def __call__(self, text: str, fraction: float) -> None:
        """Forward the solver's progress, and end the fit if an interruption was requested."""
        from ..inverse import Stop

        if self._progress is not None:
            self._progress(text, fraction)
        # two calls without `look` in between: this solver offers no state, so stop without one
        self._unseen += 1
        if self._unseen > 1 and self._interrupted is not None and self._interrupted():
            raise Stop

    def look(self, snapshot: Snapshot) -> None:
        """Save the state if `KEPT_EVERY` seconds have passed or the fit is to end."""
        from ..inverse import Stop

        self._unseen = 0
        ends = self._interrupted is not None and self._interrupted()
        if ends or time.monotonic() - self._last >= KEPT_EVERY:
            self._state = snapshot()
            self._keep(self._drafts, self._state)
            for name in STATE:
                (self._drafts / name).replace(self._folder / name)
            self._last = time.monotonic()
        if ends:
            self.stopped = True
            raise Stop

    def finish(self, folder: Path, state: Mapping[str, Array]) -> None:
        """Save the final state to a folder: the last one of an interrupted fit, else ``state``."""
        self._keep(folder, self._state if self.stopped and self._state is not None else state)

    def _keep(self, folder: Path, state: Mapping[str, Array]) -> None:
        """Write state and preview to a folder."""
        held = {"identity": np.array(self._identity), **state}
        np.savez(folder / CHECKPOINT, **held)  # type: ignore[arg-type]
        write_picture(folder / PREVIEW, state["object"])


def kept_state(folder: Path, identity: str) -> dict[str, Array]:
    """Load the state that the same task saved in a folder.

    Raises
    ------
    SceneError
        If there is no readable state, or it was saved with another scene, image or option.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise SceneError(f"there is no {path} to resume from; run without --resume")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        found = str(state.pop("identity"))
    except Exception as error:  # numpy lets through what its parsers and zipfile raise
        raise SceneError(
            f"{path} cannot be read ({type(error).__name__}); run without --resume"
        ) from None
    if found != identity:
        raise SceneError(
            f"{path} was saved with another scene, image, method, defocus, seed, tolerance or "
            "number of iterations; use the same ones again, or run without --resume"
        )
    return state


def write_picture(path: Path, values: Array) -> None:
    """Write an object as an 8-bit PNG, scaled from 0 to its maximum.

    The wall's mirror reversal is undone, so that letters read.
    """
    from PIL import Image

    largest = float(values.max())
    grey = np.clip(values / largest if largest > 0.0 else values, 0.0, 1.0)
    Image.fromarray(np.rint(255.0 * grey[:, ::-1]).astype(np.uint8)).save(path, format="PNG")


def write_text(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report as JSON."""
    path.write_text(json.dumps(report, indent=2, allow_nan=False) + os.linesep)
