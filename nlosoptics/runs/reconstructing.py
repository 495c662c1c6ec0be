"""Reconstruction from camera images of a known scene, as ``nlosoptics reconstruct`` does it.

Call `prepared` with the image files, then `reconstructed`, or `carry_out` to write a folder. The
latter saves the state during the fit, so that an interrupted fit can be resumed.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted
from .._progress import Progress
from .._random import checked_seed
from .._whole_files import RECORD, whole_folder, write_whole
from ..errors import SamplingError, SceneError
from ..imaging import CameraImage, ForwardModel, camera_image
from ..psf import PointSpreadField, SceneOptics, scene_point_spread
from ..scene import Scene
from .noise import camera_noise
from .patterns import BURST
from .plan import plan
from .record import arrays, now, record_text, scene_hash, versions, write_record
from .refusals import wall_pixels
from .simulate import image_model, image_spreads, shadow_operator
from .stages import is_matt
from .veil import fitted_veil

if TYPE_CHECKING:
    from ..inverse import Reconstruction
    from ..inverse.data.driver import Snapshot

__all__ = ["Task", "carry_out", "known_model", "prepared", "reconstructed"]

Array = NDArray[np.float64]

#: Methods that take the point spread from the scene, and their functions in `inverse`.
KNOWN = {
    "tv": "tv_deconvolve",
    "wiener": "wiener",
    "inverse_filter": "inverse_filter",
    "richardson_lucy": "richardson_lucy",
    "phase_retrieval": "phase_retrieval",
}
#: Those that need a single point spread.
SINGLE = ("inverse_filter", "phase_retrieval")
#: Recipes of `inverse.pcin`, which fit the wall's wave as well as the object.
BLIND = ("evidence", "wu2024")
SHADOWS = "shadows"  # of known occluders on a wall that forms no image
METHODS = (*KNOWN, *BLIND, BURST, SHADOWS)
MODES = tuple(range(4, 22))  # Noll indices that a blind method fits: radial orders 2 to 5
CHECKPOINT, PREVIEW = "checkpoint.npz", "preview.png"
KEPT_EVERY = 5.0  # s between two saved states


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Checked inputs of one reconstruction, made by `prepared`.

    Parameters
    ----------
    scene : Scene
        Scene in which the images were taken.
    images : tuple of CameraImage
        One image, or several for the methods "evidence" and "wu2024", which also fit the wall, and
        for "burst".
    method : str
        Name of the solver: "tv", "wiener", "inverse_filter", "richardson_lucy", "phase_retrieval",
        "evidence", "wu2024", "burst" or "shadows".
    defocus : tuple of float
        Known additional defocus of each image, waves rms; for "evidence" and "wu2024" only.
    iterations : int or None
        Maximum number of iterations; None for the method's default.
    seed : int
        Seed of the random numbers, 0 to 2^64 - 1.
    tol : float
        Error tolerance of the point spread function, max |dI|/max I, with I the intensity.
    """

    scene: Scene
    images: tuple[CameraImage, ...]
    method: str
    defocus: tuple[float, ...] = ()
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
    method: str | None = None,
    dark: Path | None = None,
    flat: Path | None = None,
    full: float | None = None,
    reading: Mapping[str, Any] | None = None,
    defocus: Sequence[float] = (),
    iterations: int | None = None,
    seed: int = 0,
    tol: float = 1e-3,
) -> Task:
    """Read camera images and check them against the scene and the method.

    Parameters
    ----------
    scene, defocus, iterations, seed, tol
        See `Task`.
    method : str, optional
        Name of the solver, see `Task`; by default "shadows" for a wall without a mirror-like lobe,
        and "tv" for all others.
    paths : sequence of Path
        Image files. Most methods average them as exposures of the same scene. The methods
        "evidence" and "wu2024", which also fit the wall, need the ``defocus`` of each file. For
        "burst" each file is an exposure through another part of the rough wall.
    dark, flat : Path, optional
        Files of the dark frame and the flat field, see `imaging.camera_image`.
    full : float, optional
        Count at which a pixel is saturated; by default the largest of the file's type.
    reading : mapping, optional
        Further options of `imaging.camera_image`, such as ``channel`` and ``corners``.

    Returns
    -------
    Task
        Input of `reconstructed` and `carry_out`.

    Raises
    ------
    SceneError
        If an image cannot be used, the method does not fit the wall, or an option the method.
    SamplingError
        If image sizes differ or do not fit the scene's camera.
    """
    checked_seed(seed)
    matt = is_matt(scene)
    method = method or (SHADOWS if matt else "tv")
    if method not in METHODS:
        raise SceneError(f"method = {method!r} is unknown, must be one of {', '.join(METHODS)}")
    if matt and (method != SHADOWS or not scene.occluders):
        raise SceneError(
            "the scene's wall has no mirror-like lobe (wall.material), and a diffuse wall forms "
            "no image; add an [[occluder]] for the method shadows; nlosoptics feasibility shows "
            "what can be recovered"
        )
    if method == SHADOWS and not matt:
        raise SceneError(
            "method = 'shadows' is for walls without a mirror-like lobe, and this one forms an "
            "image; use tv, or remove the lobe from wall.material"
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
    if iterations is not None and method == "inverse_filter":
        raise SceneError(f"iterations is given, but {method} does not iterate; leave it out")
    if method == BURST and scene.wall_roughness is None:
        raise SceneError(
            "method = 'burst' needs the statistics of the wall's speckle; add [wall.roughness], or "
            "use tv"
        )
    if method in KNOWN and scene.burst is not None and len(paths) > 1:
        raise SceneError(
            f"{len(paths)} exposures of a burst show different speckle, and {method} would average "
            "them; use the method burst, or remove [burst]"
        )
    options: dict[str, Any] = {"dark": dark, "flat": flat, "full": full, **(reading or {})}
    if options.get("channel") == "rgb":
        raise SceneError("channel = 'rgb' is three images, must be one; give a colour or 'grey'")
    apart = blind or method == BURST
    groups: list[Sequence[Path]] = [[path] for path in paths] if apart else [paths]
    return Task(
        scene=scene,
        images=tuple(camera_image(group, shape=scene.camera.shape, **options) for group in groups),
        method=method,
        defocus=tuple(defocus),
        iterations=iterations,
        seed=seed,
        tol=tol,
    )


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
        Result of `known_model`; computed if omitted. "evidence", "wu2024", "burst" and "shadows" do
        not use it.
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

    options: dict[str, Any] = {"seed": task.seed, "start": start, "progress": progress}
    if task.iterations is not None:
        options["max_iterations"] = task.iterations
    if task.method not in (*KNOWN, SHADOWS):
        return _several(task, options)
    (image,) = task.images
    if task.method == SHADOWS:
        light = np.where(image.masked | ~wall_pixels(task.scene), np.nan, image.values)
        options = _accepted(task, inverse.shadow_fit, options)
        return inverse.shadow_fit(light, shadow_operator(task.scene), **options)
    model = model or known_model(task.scene, tol=task.tol, mean=task.method in SINGLE)
    noise = camera_noise(task.scene, image, model)
    veil = None
    if task.method != "phase_retrieval":  # which has no use for it
        veil = fitted_veil(task.scene, image.values, model, noise_sigma=noise)
    saturated = image.saturated if image.saturated.any() else None  # None: its level is searched
    measured = inverse.Measurement(
        image.values, noise_sigma=noise, saturated=saturated, background_shape=veil
    )
    solver = getattr(inverse, KNOWN[task.method])
    result: Reconstruction = solver(measured, model, **_accepted(task, solver, options))
    return result


def _accepted(task: Task, solver: Callable[..., Any], options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that a solver has; raise if it cannot resume as asked."""
    accepted = inspect.signature(solver).parameters
    if options["start"] is not None and "start" not in accepted:
        raise SceneError(f"{task.method} cannot resume from a saved state; run without --resume")
    return {name: value for name, value in options.items() if name in accepted}


def _several(task: Task, options: dict[str, Any]) -> Reconstruction:
    """Fit object and wall to frames with known defocus, or to the exposures of a burst."""
    from .. import inverse

    scene = task.scene
    images = np.stack([image.values for image in task.images])
    masked = np.stack([image.masked for image in task.images])
    if masked.any() and task.method != "evidence":
        raise SceneError(
            f"{np.count_nonzero(masked)} pixels are saturated or dead, and {task.method} cannot "
            "mask pixels; use evidence or tv"
        )
    if task.method == BURST:
        options = _accepted(task, inverse.burst_fit, options)
        smooth = replace(scene, wall_roughness=None, burst=None)
        lens = scene_point_spread(smooth, task.tol, shape=16)  # whose extent is not used
        return inverse.burst_fit(images, lens.point_spread, **options)
    pupil = inverse.PupilPSF.from_scene(
        scene,
        MODES,
        pitch=scene.camera.image_pitch,
        shape=scene.camera.shape,
        pixel_integrated=True,
    )
    if task.defocus:
        options["defocus"] = np.array(task.defocus) * scene.laser.wavelength
    measured = inverse.Measurement(images, masked=masked)
    return inverse.pcin(measured, pupil, recipe=task.method, **options)


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
    within, least = float(spread[middle].sum()), 0.5
    if within < least:
        raise SamplingError(
            f"an image of {shape[1]} x {shape[0]} pixels holds {100 * within:.2g} % of the point "
            f"spread's energy, must be at least {100 * least:g} %: the blur is larger than "
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
    stop = interrupted or (lambda: False)
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
    if task.method in KNOWN:
        if progress is not None:
            progress("point spread", 0.0)
        model = known_model(task.scene, tol=task.tol, mean=task.method in SINGLE)
    if stop():
        raise KeyboardInterrupt
    keeper = Keeper(folder, identity, report, progress, stop)
    try:
        result = reconstructed(task, model=model, start=start, progress=keeper)
    except Stop:
        raise KeyboardInterrupt from None  # this solver ends without a result
    picture = np.asarray(result.object)
    # as an image of the camera, mirrored by the wall
    shown = picture[:, ::-1] if task.method == SHADOWS else picture
    report |= {
        "status": "interrupted" if keeper.stopped else "done",
        "finished": now(),
        "figures": _figures(task, result),
        "seconds": {"solver": result.seconds, "total": time.perf_counter() - started},
    }
    if not keeper.stopped:
        gain = float(result.physical_parameters.get("gain", 1.0))
        keeper.state = {"object": shown * gain}
    with whole_folder(folder) as new:
        np.save(new / "object.npy", picture)
        (new / "object.png").write_bytes(_png(shown))
        np.savez(new / "reconstruction.npz", **arrays(result))
        for name, content in keeper.files().items():
            (new / name).write_bytes(content)
        return write_record(report, new)


def _figures(task: Task, result: Reconstruction) -> dict[str, Any]:
    """Key figures of a reconstruction for ``result.json``."""
    return {
        "method": task.method,
        "reconstruction_status": result.status,
        "reconstruction_score": result.score,
        "reconstruction_reasons": list(result.reasons),
        "iterations": max((len(values) for values in result.history.values()), default=0),
        # larger ones are in the arrays
        "physical_parameters": {
            name: _finite(np.asarray(value))
            for name, value in result.physical_parameters.items()
            if np.size(value) <= 200
        },
        "image_shape": list(task.images[0].values.shape),
        "saturated_fraction": max(image.saturated_fraction for image in task.images),
        "masked_fraction": max(float(image.masked.mean()) for image in task.images),
    }


def _finite(values: NDArray[Any]) -> Any:
    """Convert values for JSON; values that are not finite become null."""
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        return None if values.ndim == 0 else [_finite(np.asarray(part)) for part in values]
    return values.tolist()


class Keeper:
    """Progress callback of solvers that saves the state of the fit every `KEPT_EVERY` seconds.

    ``report`` becomes the record of the folder, unless it holds an older result. That stays as it
    is until the fit has ended.
    """

    def __init__(
        self,
        folder: Path,
        identity: str,
        report: dict[str, Any],
        progress: Progress | None,
        stop: Callable[[], bool],
    ) -> None:
        self._folder, self._identity, self._report = folder, identity, report
        self._progress, self._stop = progress, stop
        self._last = time.monotonic()
        self.state: Mapping[str, Array] = {}
        self._unseen = 0  # reports since the last look
        self.stopped = False

    def __call__(self, text: str, fraction: float) -> None:
        """Forward the solver's progress, and end the fit if an interruption was requested."""
        from ..inverse import Stop

        if self._progress is not None:
            self._progress(text, fraction)
        # two calls without `look` in between: this solver offers no state, so stop without one
        self._unseen += 1
        if self._unseen > 1 and self._stop():
            raise Stop

    def look(self, snapshot: Snapshot) -> None:
        """Save the state if it is old or the fit is to end."""
        from ..inverse import Stop

        self._unseen = 0
        self.stopped = self._stop()
        if self.stopped or time.monotonic() - self._last >= KEPT_EVERY:
            self.state = snapshot()
            self._save()
            self._last = time.monotonic()
        if self.stopped:
            raise Stop

    def files(self) -> dict[str, bytes]:
        """Return the contents of the state and its preview, by file name."""
        stream = BytesIO()
        np.savez(stream, identity=np.array(self._identity), **self.state)  # type: ignore[arg-type]
        return {CHECKPOINT: stream.getvalue(), PREVIEW: _png(self.state["object"])}

    def _save(self) -> None:
        """Write the state to the folder, and list its files there first."""
        own = self._folder / RECORD
        try:
            record = json.loads(own.read_bytes())
            listed = {*record["files"], RECORD, CHECKPOINT, PREVIEW}
            record = self._report if record["status"] == "running" else record
        except (OSError, ValueError, KeyError, TypeError):
            record, listed = self._report, {RECORD, CHECKPOINT, PREVIEW}
        self._folder.mkdir(exist_ok=True)
        contents = {self._folder / name: content for name, content in self.files().items()}
        write_whole({own: record_text({**record, "files": sorted(listed)}), **contents})


def kept_state(folder: Path, identity: str) -> dict[str, Array]:
    """Load the state that the same task saved in a folder, or raise `SceneError`."""
    path = folder / CHECKPOINT
    if not path.is_file():
        raise SceneError(f"there is no {path} to resume from; run without --resume")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        saved = str(state.pop("identity"))
    except Exception as error:  # numpy lets through what its parsers and zipfile raise
        raise SceneError(
            f"{path} cannot be read ({type(error).__name__}); run without --resume"
        ) from None
    if saved != identity:
        raise SceneError(
            f"{path} was saved with another scene, image, method, defocus, seed, tolerance or "
            "number of iterations; use the same ones again, or run without --resume"
        )
    return state


def _png(values: Array) -> bytes:
    """Return an object as an 8-bit PNG, scaled from 0 to its maximum.

    The wall's mirror reversal is undone, so that letters read.
    """
    from PIL import Image

    largest, stream = float(values.max()), BytesIO()
    grey = np.clip(values / largest if largest > 0.0 else values, 0.0, 1.0)
    Image.fromarray(np.rint(255.0 * grey[:, ::-1]).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return __all__
