"""What a run's folder holds, checked when it is read."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import SceneError
from ..scene import Scene

RECORD = "result.json"


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class Stage(_Model):
    """A stage of a plan, as `runs.plan.Stage`."""

    name: str
    reason: str
    seconds: float = 0.0
    error: str = ""


class Stages(_Model):
    """A plan: what ran, and what did not."""

    stages: tuple[Stage, ...] = ()
    skipped: tuple[Stage, ...] = ()


class Figures(_Model):
    """Numbers that sum up a run, SI units; those that its command does not tell are None."""

    exit_pupil_radius: float | None = None
    f_number: float | None = None
    stop: str | None = None
    vignetting: float | None = None
    wavelength: float | None = None
    aberration_rms: float | None = None
    aberration_rms_waves: float | None = None
    point_spread_method: str | None = None
    point_spread_error: float | None = None
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
    iterations: int | None = None
    physical_parameters: dict[str, Any] = Field(default_factory=dict)
    correlation_with_truth: float | None = None
    brightest_voxel: tuple[float, float, float] | None = None
    volume_shape: tuple[int, ...] = ()
    capture_shape: tuple[int, ...] = ()
    peak_memory_bytes: float | None = None


class Record(_Model):
    """The contents of ``result.json``."""

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
    """A run's folder.

    Parameters
    ----------
    path : Path
    record : Record
    """

    path: Path
    record: Record

    @classmethod
    def read(cls, path: Path) -> Folder:
        """Read the record of a folder.

        Raises
        ------
        SceneError
            If it is none that ``run``, ``reconstruct`` or ``phasor`` wrote.
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
                f"{path / RECORD} is none that nlosoptics {_version()} writes: {place}: "
                f"{first['msg']}; {remedy}"
            ) from None

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.path.resolve().name

    def picture(self, name: str) -> bytes | None:
        """A PNG of the folder; None where there is none."""
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        data = path.read_bytes()
        if not data.startswith(b"\x89PNG\r\n\x1a\n"):
            raise SceneError(f"{path} is no PNG; make the run again")
        return data

    def text(self, name: str) -> str | None:
        """A text of the folder; None where there is none."""
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        return path.read_text(encoding="utf-8", errors="replace")

    def arrays(self, name: str, *wanted: str) -> Mapping[str, NDArray[Any]] | None:
        """Arrays of an ``.npz`` of the folder; None where there is none.

        Raises
        ------
        SceneError
            If it cannot be read, or lacks one.
        """
        path = self.path / name
        if name not in self.record.files or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                return {key: file[key] for key in wanted}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise SceneError(
                f"{path} cannot be read ({type(error).__name__}: {error}); make the run again"
            ) from None

    def scene(self) -> Scene | None:
        """The scene of the run; None where the folder has none.

        Raises
        ------
        SceneError
            If it cannot be read, as where a picture that it names is gone.
        """
        if self.text("scene.toml") is None:
            return None
        return Scene.load(self.path / "scene.toml")


def _version() -> str:
    from .. import __version__

    return __version__
