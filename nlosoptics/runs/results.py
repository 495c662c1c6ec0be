"""The result of a simulation, and the folder that holds it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._checks import path_of
from .._nouns import Noun
from .._whole_files import RECORD, check_folder, whole_folder
from ..errors import SceneError
from ..psf.pupil.exit_pupil import ExitPupil
from ..scene import Scene
from .plan import Plan
from .record import now, peak_memory, scene_hash, versions

if TYPE_CHECKING:
    from ..imaging import SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import PointSpread, PointSpreadField, Wavefront


@dataclass(frozen=True, eq=False, kw_only=True)
class Result(Noun):
    """All that a simulation computed.

    Parameters
    ----------
    scene : Scene
    plan : Plan
    exit_pupil : ExitPupil
    wavefront : Wavefront
    point_spread : PointSpread
        Of the object's reference point.
    field : PointSpreadField or None
        Over the object, where one point spread does not stand for all of it.
    image : SpeckleImage
    reconstruction : Reconstruction or None
        None unless it was asked for.
    errors : dict of str to float
        Estimated errors, relative: of ``point spread``, max |dI|/max I; of ``field of point
        spreads``, rms of the image.
    timings : dict of str to float
        Seconds of each stage that ran.
    seed : int
    """

    scene: Scene
    plan: Plan
    exit_pupil: ExitPupil
    wavefront: Wavefront
    point_spread: PointSpread
    field: PointSpreadField | None
    image: SpeckleImage
    reconstruction: Reconstruction | None
    errors: dict[str, float]
    timings: dict[str, float]
    seed: int

    def save(self, folder: str | Path) -> None:
        """Write a folder that `load_result` reads back bit for bit and ``report`` shows.

        It is the one that ``nlosoptics run`` writes, without its pictures: ``result.json`` (the
        figures, and all that is no array), one ``.npz`` of each stage, and ``scene.toml`` with the
        files that it names. It appears complete or not at all.

        Parameters
        ----------
        folder : str or Path
            Its parent must exist. One that holds another result is replaced.

        Raises
        ------
        SceneError
            If the folder holds what is not of this package or cannot be written, or if the scene
            has no form in a file, as with a `CallableWall`.
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
    """Read what `Result.save` or ``nlosoptics run`` wrote.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Result
        Of the same bits. Its scene names the files of the folder.

    Raises
    ------
    SceneError
        If the folder holds no result of this version's format, or a file is missing or damaged.
    """
    from . import result_files

    place = path_of("folder", folder)
    path = place / RECORD
    remedy = "name a folder that Result.save or nlosoptics run wrote"
    if not place.is_dir():
        raise SceneError(f"{place} is {'no folder' if place.exists() else 'missing'}; {remedy}")
    try:
        record = json.loads(path.read_bytes())
    except OSError:
        raise SceneError(f"{place} holds no {RECORD} that can be read; {remedy}") from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path} is damaged ({error}); {result_files.REMEDY}") from None
    known = result_files.FORMAT
    written = record.get("format") if isinstance(record, dict) else None
    if written is None:
        raise SceneError(f"{path} tells of no result in format {known}; {remedy}")
    if written != known:
        raise SceneError(
            f"{path} is in format {written}, must be {known}; read it with the nlosoptics that "
            f"wrote it, or {result_files.REMEDY}"
        )
    scene = Scene.load(place / "scene.toml")
    if scene_hash(scene) != record.get("scene_sha256"):
        raise SceneError(
            f"{place}: scene.toml or a file that it names was changed since the result was "
            f"written; {result_files.REMEDY}"
        )
    nouns = result_files.read(record.get("result"), place)
    missing = {entry.name for entry in fields(Result)} ^ {"scene", *nouns}
    if missing:
        raise SceneError(f"{path} lacks or does not know {min(missing)}; {result_files.REMEDY}")
    return Result(scene=scene, **nouns)


def write_result(result: Result, folder: Path) -> dict[str, Any]:
    """Write the scene and the arrays of a result; return its record, see `write_record`."""
    from ..scene.file.scene_file import scene_files
    from .result_files import FORMAT, written

    for name, content in scene_files(result.scene).items():
        (folder / name).write_bytes(content)
    nouns = {entry.name: getattr(result, entry.name) for entry in fields(result)}
    del nouns["scene"]
    return _account(result) | {"format": FORMAT, "result": written(nouns, folder)}


def write_record(record: dict[str, Any], folder: Path) -> None:
    """Write ``result.json``, which also names every file of its folder."""
    files = sorted([*(path.name for path in folder.iterdir()), RECORD])
    text = json.dumps(record | {"files": files}, indent=2, allow_nan=False)
    (folder / RECORD).write_text(text + "\n")


def _account(result: Result) -> dict[str, Any]:
    """Machine-readable account of a run: the contents of result.json."""
    return {
        "program": "nlosoptics",
        "command": "run",
        "status": "done",
        "finished": now(),
        "figures": _finite(_figures(result)),
        "seed": result.seed,
        "tol": result.plan.tol,
        "scene_sha256": scene_hash(result.scene),
        "seconds": dict(result.timings),
        "plan": {
            "stages": [asdict(stage) for stage in result.plan.stages],
            "skipped": [asdict(stage) for stage in result.plan.skipped],
        },
        "versions": versions(),
    }


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures without those that JSON has no number for, infinity and NaN."""
    return {
        name: _finite(value) if isinstance(value, dict) else value
        for name, value in figures.items()
        if not isinstance(value, float) or math.isfinite(value)
    }


def _figures(result: Result) -> dict[str, Any]:
    """Numbers that sum up a run, SI units."""
    from .. import psf

    pupil, wave, spread, image = (
        result.exit_pupil,
        result.wavefront,
        result.point_spread,
        result.image,
    )
    rms = psf.rms_aberration(wave)
    found: dict[str, Any] = {
        "exit_pupil_radius": pupil.radius,
        "image_distance": pupil.image_distance,
        "f_number": pupil.f_number,
        "stop": pupil.stop,
        "vignetting": pupil.vignetting,
        "aberration_rms": rms,
        "aberration_rms_waves": rms / wave.wavelength,
        "point_spread_method": spread.method,
        "point_spread_error": spread.error_estimate,
        "point_spread_reason": spread.reason,
        "point_spread_regime": {
            **asdict(spread.regime),
            "coherent_fraction": spread.regime.coherent_fraction,
        },
        "wavelength": spread.wavelength,
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
    if result.reconstruction is not None:
        from ..inverse import registered_correlation

        found["reconstruction_status"] = result.reconstruction.status
        found["reconstruction_score"] = result.reconstruction.score
        if image.ideal.any():
            correlation = registered_correlation(result.reconstruction, image.ideal)
            found["correlation_with_truth"] = correlation
    found["peak_memory_bytes"] = peak_memory()
    return found
