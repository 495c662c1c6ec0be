"""Result of a simulation, and reading and writing its folder."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import path_of, reason
from .._html import Figures, Shown
from .._nouns import Noun
from .._whole_files import RECORD, check_folder, sweep, whole_folder
from .._xarray import Labelled, Labels, variable
from ..errors import SceneError
from ..imaging.objects import resampled
from ..psf.pupil.exit_pupil import ExitPupil
from ..scene import PlanarObject, Scene
from .plan import Plan
from .record import peak_memory, scene_hash, write_record

if TYPE_CHECKING:
    from ..imaging import SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import PointSpread, PointSpreadField, PupilField, Wavefront


@dataclass(frozen=True, eq=False, kw_only=True)
class Result(Noun, Shown, Labelled):
    """All results of a simulation, from the function `simulate`.

    Parameters
    ----------
    scene : Scene
        Scene that was simulated.
    plan : Plan
        Stages that were run, with their predicted times and errors.
    exit_pupil : ExitPupil or None
        Exit pupil of the system of lens and wall. This and the next two are None for a wall without
        a mirror-like lobe, which forms no image.
    wavefront : Wavefront or None
        Wave aberration for the object's reference point, ``scene.object_point``.
    point_spread : PointSpread or None
        Point spread function (PSF) of the same point.
    field : PointSpreadField or None
        PSFs of points over the whole object; None if a single PSF is accurate enough.
    image : SpeckleImage
        Camera image, with the signal, the other contributions of light and the noise.
    pupil_field : PupilField or None
        Complex field in the exit pupil for the same point, if the wall is rough and diffraction
        between wall and pupil was computed; otherwise None.
    burst : ndarray, (images, ny, nx), or None
        Readings of all exposures of ``scene.burst``, electrons, read-only; ``image`` is the first.
        All other parts of the result are those of the first exposure. None without a burst.
    reconstruction : Reconstruction or None
        Reconstructed object; None if not requested or not possible. It has the pixels of the image,
        or, from the shadows on a wall without a mirror-like lobe, cells of the hidden plane, with
        row 0 on top as in the picture.
    errors : dict of str to float
        Estimated relative errors: ``point spread``, max |dI|/max I, with I the intensity;
        ``field of point spreads``, rms error of the image over its rms value.
    timings : dict of str to float
        Run time of each stage, s.
    seed : int
        Seed of the random numbers.

    See Also
    --------
    simulate : Run a scene's plan.
    load_result : Read a saved result.
    nlosoptics.views.overview : One figure of a whole run.
    nlosoptics.report.page : HTML report of a run.
    """

    scene: Scene
    plan: Plan
    exit_pupil: ExitPupil | None
    wavefront: Wavefront | None
    point_spread: PointSpread | None
    field: PointSpreadField | None
    image: SpeckleImage
    reconstruction: Reconstruction | None
    errors: dict[str, float]
    timings: dict[str, float]
    seed: int
    pupil_field: PupilField | None = None
    burst: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if self.burst is not None:
            self.burst.flags.writeable = False

    def _figures(self) -> Figures:
        """Return the key figures of the run, for display in notebooks."""
        image, wave, fit = self.image, self.wavefront, self.reconstruction
        peak, full = float(image.electrons.max()), 100 * image.saturated_fraction
        figures = {
            "scene": f"{type(self.scene.wall).__name__}, {type(self.scene.hidden).__name__}",
            "wave": "none" if wave is None else wave._figures().rows["aberration"],
            "image": f"{peak:.3g} electrons at most, {full:.2g} % of the pixels saturated",
            "reconstruction": "none" if fit is None else f"{fit.status}, score {fit.score:.3g}",
            "run": f"{sum(self.timings.values()):.2g} s, seed {self.seed}",
        }
        return Figures("Result", figures, "Overview of a simulation: room, image, reconstruction")

    def _labels(self) -> Labels:
        """Return the image, the exposures of a burst and a reconstruction on the same pixels."""
        arrays, axes, values = self.image._labels()
        more = {}
        if self.burst is not None:
            more["burst"] = variable(["exposure", "y", "x"], self.burst, "electrons", "exposures")
        fit = self.reconstruction
        if fit is not None and fit.object.shape == self.image.electrons.shape:
            more["object"] = variable("yx", np.asarray(fit.object), "1", "reconstructed object")
        return Labels({**arrays, **more}, axes, values)

    def save(self, folder: str | Path) -> None:
        """Save the result to a folder, from which `load_result` restores it bit for bit.

        The folder holds ``result.json`` (key figures and all values that are not arrays), one
        ``.npz`` file per stage, and ``scene.toml`` with the files that it refers to.
        ``nlosoptics run`` writes the same folder and adds pictures. If an error occurs, no partial
        folder remains.

        Parameters
        ----------
        folder : str or Path
            Output folder. Its parent must exist. An earlier result in the folder is replaced.

        Raises
        ------
        SceneError
            If the folder contains files that nlosoptics did not write, if it cannot be written,
            or if a scene file cannot express the scene, for example a `CallableWall`.

        See Also
        --------
        load_result : Read the folder.
        """
        target = path_of("folder", folder)
        check_folder(target)
        try:
            with whole_folder(target) as new:
                write_record(write_result(self, new), new)
        except OSError as error:
            raise SceneError(
                f"{target} cannot be written ({error.strerror}); choose another place"
            ) from None


def load_result(folder: str | Path) -> Result:
    """Load a result that `Result.save` or ``nlosoptics run`` wrote.

    Parameters
    ----------
    folder : str or Path
        Folder of the result.

    Returns
    -------
    Result
        The same values as the saved result, bit for bit. Its scene refers to the files in the
        folder.

    Raises
    ------
    SceneError
        If the folder has no result in the format of this version, or a file is missing, damaged
        or was changed.

    See Also
    --------
    simulate : Run a scene's plan.
    Result : All results of a simulation.
    nlosoptics.report.page : HTML report of a run.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import Scene, load_result, simulate
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> result = simulate(scene, tol=1e-2)
    >>> with TemporaryDirectory() as place:
    ...     result.save(f"{place}/letter")
    ...     loaded = load_result(f"{place}/letter")
    >>> bool((loaded.image.electrons == result.image.electrons).all())
    True
    """
    from . import result_files

    place = path_of("folder", folder)
    path = place / RECORD
    remedy = "name a folder that Result.save or nlosoptics run wrote"
    if not place.exists():
        sweep(place)  # a killed writer may have moved it aside
    if not place.is_dir():
        raise SceneError(f"{place} is {'no folder' if place.exists() else 'missing'}; {remedy}")
    try:
        record = json.loads(path.read_bytes())
    except OSError:
        raise SceneError(f"{place} holds no {RECORD} that can be read; {remedy}") from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path} is damaged ({reason(error)}); {result_files.REMEDY}") from None
    known = result_files.FORMAT
    written = record.get("format") if isinstance(record, dict) else None
    if written is None:
        raise SceneError(f"{path} contains no result in format {known}; {remedy}")
    if written != known:
        raise SceneError(
            f"{path} is in format {written}, must be {known}; read it with the nlosoptics that "
            f"wrote it, or {result_files.REMEDY}"
        )
    scene = Scene.load(place / "scene.toml")
    if scene_hash(scene) != record.get("scene_sha256"):
        raise SceneError(
            f"{place}: scene.toml or a file that it refers to was changed after the result was "
            f"written; {result_files.REMEDY}"
        )
    nouns = result_files.read(record.get("result"), place)
    missing = {entry.name for entry in fields(Result)} ^ {"scene", *nouns}
    if missing:
        raise SceneError(
            f"{path}: the entry {min(missing)} is missing or unknown; {result_files.REMEDY}"
        )
    for key, kind in (("command", str), ("figures", dict), ("seconds", dict), ("versions", dict)):
        value = record.get(key, "run" if key == "command" else {})
        other = value != "run" if key == "command" else False
        if key == "seconds" and isinstance(value, dict):
            other = not all(isinstance(took, int | float) for took in value.values())
        if other or not isinstance(value, kind):
            raise SceneError(f"{path}: {key} = {str(value)[:40]!r} is wrong; {result_files.REMEDY}")
    result = Result(scene=scene, **nouns)
    names = ("electrons", "expected", "signal", "ideal", "background", "noise_sigma")
    image = [getattr(result.image, name) for name in names]
    others = [] if result.point_spread is None else [result.point_spread.intensity]
    others += [] if result.reconstruction is None else [result.reconstruction.object]
    if any(values.shape != scene.camera.shape for values in image) or not all(
        values.size and np.isfinite(values).all() for values in (*image, *others)
    ):
        raise SceneError(
            f"{place}: arrays of image, point spread or reconstruction are not finite or not of "
            f"the camera's {scene.camera.shape} pixels; {result_files.REMEDY}"
        )
    return result


def write_result(result: Result, folder: Path) -> dict[str, Any]:
    """Write the scene and arrays of a result and return its record for `write_record`."""
    from ..scene.file.scene_file import scene_files
    from .result_files import FORMAT, written

    for name, content in scene_files(result.scene).items():
        (folder / name).write_bytes(content)
    nouns = {entry.name: getattr(result, entry.name) for entry in fields(result)}
    del nouns["scene"]
    return _account(result) | {"format": FORMAT, "result": written(nouns, folder)}


def _account(result: Result) -> dict[str, Any]:
    """Contents of ``result.json``: figures, plan, times, versions."""
    return {
        "command": "run",
        "figures": _finite(_figures(result)),
        "seed": result.seed,
        "tol": result.plan.tol,
        "scene_sha256": scene_hash(result.scene),
        "seconds": dict(result.timings),
        "plan": {
            "stages": [asdict(stage) for stage in result.plan.stages],
            "skipped": [asdict(stage) for stage in result.plan.skipped],
        },
    }


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the figures without infinities and NaN, which JSON cannot express."""
    return {
        name: _finite(value) if isinstance(value, dict) else value
        for name, value in figures.items()
        if not isinstance(value, float) or math.isfinite(value)
    }


def _figures(result: Result) -> dict[str, Any]:
    """Key figures of a run, SI units."""
    from .. import psf

    image = result.image
    found: dict[str, Any] = {}
    pupil, wave, spread = result.exit_pupil, result.wavefront, result.point_spread
    if pupil is not None and wave is not None and spread is not None:
        rms = psf.rms_aberration(wave)
        found = {
            "exit_pupil_radius": pupil.radius,
            "image_distance": pupil.image_distance,
            "f_number": pupil.f_number,
            "stop": pupil.stop,
            "vignetting": pupil.vignetting,
            "aberration_rms": rms,
            "aberration_rms_waves": rms / wave.wavelength,
            "point_spread_method": spread.method,
            "point_spread_error": spread.error_estimate,
            "point_spread_model": spread.model,
            "point_spread_model_error": spread.model_error,
            "point_spread_reason": spread.reason,
            "point_spread_regime": {
                **asdict(spread.regime),
                "coherent_fraction": spread.regime.coherent_fraction,
            },
            "wavelength": spread.wavelength,
        }
    found |= {
        "errors": dict(result.errors),
        "field_nodes": 1 if result.field is None else result.field.weights[0].size,
        "field_modes": 1 if result.field is None else len(result.field.modes),
        "image_shape": list(image.electrons.shape),
        "electrons_peak": float(image.electrons.max()),
        "electrons_mean": float(image.electrons.mean()),
        "signal_electrons_peak": float(image.signal.max()),
        "noise_sigma_mean": float(image.noise_sigma.mean()),
        "saturated_fraction": image.saturated_fraction,
        "electrons_in_total": dict(image.ledger),
    }
    if result.burst is not None:
        found["burst_images"] = len(result.burst)
    if result.reconstruction is not None:
        from ..inverse import registered_correlation

        found["reconstruction_status"] = result.reconstruction.status
        found["reconstruction_score"] = result.reconstruction.score
        found["reconstruction_reasons"] = list(result.reconstruction.reasons)
        truth = ground_truth(result)
        if truth is not None:
            correlation = registered_correlation(result.reconstruction, truth)
            found["correlation_with_truth"] = correlation
    found["peak_memory_bytes"] = peak_memory()
    return found


def ground_truth(result: Result) -> NDArray[np.float64] | None:
    """Return what the reconstruction should show; None if that is dark or unknown.

    It is the image without blur and noise or, where the wall forms none, the picture on the cells
    of the reconstruction.
    """
    truth, hidden, fit = result.image.ideal, result.scene.hidden, result.reconstruction
    if result.point_spread is None and fit is not None and isinstance(hidden, PlanarObject):
        rows, columns = fit.object.shape
        truth = resampled(hidden.reflectance, (rows, columns))
    return truth if truth.any() else None
