"""Contents of a run's folder, validated when read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .._checks import reason
from ..errors import SceneError
from ..scene import Scene

RECORD = "result.json"


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class Stage(_Model):
    """Stage of a plan, see `runs.plan.Stage`."""

    name: str
    reason: str
    seconds: float = 0.0
    error: str = ""


class Stages(_Model):
    """Stages of a plan that ran or were skipped."""

    stages: tuple[Stage, ...] = ()
    skipped: tuple[Stage, ...] = ()


class Figures(_Model):
    """Key figures of a run, SI units; None if its command does not report them."""

    exit_pupil_radius: float | None = None
    f_number: float | None = None
    stop: str | None = None
    vignetting: float | None = None
    wavelength: float | None = None
    aberration_rms: float | None = None
    aberration_rms_waves: float | None = None
    point_spread_method: str | None = None
    point_spread_error: float | None = None
    point_spread_model: str | None = None
    point_spread_model_error: float | None = None
    point_spread_reason: str | None = None
    point_spread_regime: dict[str, float | bool | None] = Field(default_factory=dict)
    errors: dict[str, float] = Field(default_factory=dict)
    field_nodes: int = 1
    field_modes: int = 1
    electrons_peak: float | None = None
    electrons_mean: float | None = None
    signal_electrons_peak: float | None = None
    noise_sigma_mean: float | None = None
    saturated_fraction: float | None = None
    masked_fraction: float | None = None
    electrons_in_total: dict[str, float] = Field(default_factory=dict)
    method: str | None = None
    reconstruction_status: str | None = None
    reconstruction_score: float | None = None
    reconstruction_reasons: tuple[str, ...] = ()
    iterations: int | None = None
    physical_parameters: dict[str, Any] = Field(default_factory=dict)
    correlation_with_truth: float | None = None
    brightest_voxel: tuple[float, float, float] | None = None
    volume_shape: tuple[int, ...] = ()
    capture_shape: tuple[int, ...] = ()
    peak_memory_bytes: float | None = None


class Record(_Model):
    """Contents of ``result.json``."""

    program: Literal["nlosoptics"]
    command: Literal["run", "reconstruct", "phasor"]
    status: str
    command_line: str = ""
    finished: str | None = None
    figures: Figures = Figures()
    seed: int | None = None
    tol: float | None = None
    scene_sha256: str | None = None
    capture_file: str | None = None
    capture_sha256: str | None = None
    camera: str | None = None
    wl_mean: float | None = None
    wl_sigma: float | None = None
    aperture: float | None = None
    notes: tuple[str, ...] = ()
    seconds: dict[str, float] = Field(default_factory=dict)
    plan: Stages = Stages()
    versions: dict[str, str] = Field(default_factory=dict)
    files: tuple[str, ...]


@dataclass(frozen=True)
class Folder:
    """Output folder of ``nlosoptics run``, ``reconstruct`` or ``phasor``, with access to its files.

    Make one with `read`.

    Parameters
    ----------
    path : Path
        Path of the folder.
    record : Record
        Contents of the file ``result.json`` in the folder.

    See Also
    --------
    page : HTML report of a run.
    nlosoptics.load_result : Read a saved result.
    """

    path: Path
    record: Record

    @classmethod
    def read(cls, path: Path) -> Folder:
        """Read and check the file ``result.json`` of a folder.

        Parameters
        ----------
        path : Path
            Folder written by ``nlosoptics run``, ``reconstruct`` or ``phasor``.

        Returns
        -------
        Folder
            Folder with the contents of this file.

        Raises
        ------
        SceneError
            If the folder is missing or was not written by one of these commands.
        """
        remedy = "name the output folder of nlosoptics run, reconstruct or phasor"
        if not path.is_dir():
            raise SceneError(f"{path} is {'no folder' if path.exists() else 'missing'}; {remedy}")
        try:
            text = (path / RECORD).read_bytes()
        except OSError:
            raise SceneError(f"{path} holds no {RECORD} that can be read; {remedy}") from None
        try:
            return cls(path, Record.model_validate_json(text))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(map(str, first["loc"])) or "its text"
            raise SceneError(
                f"{path / RECORD} does not have the form that nlosoptics {_version()} writes: "
                f"{place}: {first['msg']}; {remedy}"
            ) from None

    @property
    def name(self) -> str:
        """Name of the folder without its parents."""
        return self.path.resolve().name

    def picture(self, name: str) -> bytes | None:
        """Return the bytes of a PNG file in the folder; None if there is none.

        Parameters
        ----------
        name : str
            File name.

        Raises
        ------
        SceneError
            If the file is not a PNG.
        """
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        data = path.read_bytes()
        if not data.startswith(b"\x89PNG\r\n\x1a\n"):
            raise SceneError(f"{path} is no PNG file; run the command again")
        return data

    def text(self, name: str) -> str | None:
        """Return the text of a file in the folder; None if there is none.

        Parameters
        ----------
        name : str
            File name.
        """
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        return path.read_text(encoding="utf-8", errors="replace")

    def arrays(self, name: str, *wanted: str) -> Mapping[str, NDArray[Any]] | None:
        """Return arrays of an ``.npz`` file in the folder; None if there is no such file.

        Parameters
        ----------
        name : str
            File name.
        *wanted : str
            Names of the arrays to read; none are read without a name.

        Raises
        ------
        SceneError
            If the file cannot be read, or an array is missing.
        """
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                return {key: file[key] for key in wanted}
        except Exception as error:  # numpy lets through what its parsers and zipfile raise
            raise SceneError(
                f"{path} cannot be read ({reason(error)}); run the command again"
            ) from None

    def scene(self) -> Scene | None:
        """Return the scene of the run; None if the folder has none.

        Raises
        ------
        SceneError
            If it cannot be read, for example because a file that it refers to is missing.
        """
        if self.text("scene.toml") is None:
            return None
        return Scene.load(self.path / "scene.toml")


def _version() -> str:
    from .. import __version__

    return __version__
