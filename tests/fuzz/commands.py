"""Commands that write files: their inputs, two command lines each, and what they write.

The first command line gives the old result, the second the new one that replaces it.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .readers import ROOT

#: Entries of a record that differ between two runs with equal results.
PASSING = ("seconds", "finished", "peak_memory_bytes", "timings", "resumed")
#: Contents by the path relative to a folder.
Contents = Mapping[str, bytes]
SCENE = ("scenes/letter_flat.toml", "--size", "32")
STATE = ("checkpoint.npz", "preview.png")
STUDY = """
scene = "scenes/letter_flat.toml"
figures = ["aberration_rms", "spot_rms"]
[axes]
"camera.focus_distance" = [VALUES]
"""


class Command(NamedTuple):
    """A writing command.

    ``make`` writes the inputs into the working folder. ``old`` and ``new`` are command lines that
    write ``target``. ``state`` names files that let a killed command go on, and that change before
    the result does. ``parts`` reads a target that grows, and returns its finished parts.
    ``program`` is Python code that runs a command line.
    """

    target: str
    old: tuple[str, ...]
    new: tuple[str, ...]
    make: Callable[[Path], None]
    state: tuple[str, ...] = ()
    parts: Callable[[Path], Mapping[Any, Any]] | None = None
    program: str = "from nlosoptics.cli import main; main()"


def _scenes(folder: Path) -> None:
    for name in ("scenes", "objects", "walls"):
        shutil.copytree(ROOT / "examples" / name, folder / name)


def _exposure(folder: Path) -> None:
    """Write a scene and an exposure that it gives."""
    import nlosoptics as nlos

    _scenes(folder)
    scene = nlos.Scene.load(folder / SCENE[0]).resized(32)
    np.save(folder / "letter.npy", nlos.simulate(scene, tol=1e-2, seed=3).image.electrons)


def _result(folder: Path) -> None:
    """Write a folder as ``nlosoptics run`` does."""
    import nlosoptics as nlos

    scene = nlos.Scene.load(ROOT / "examples" / SCENE[0]).resized(32)
    nlos.simulate(scene, tol=1e-2).save(folder / "run")


def _captured(folder: Path) -> None:
    """Write a capture of one bright voxel's echo."""
    from nlosoptics.transient import TransientCapture, wall_grid

    grid = wall_grid(1.0, 6)
    path = 2.0 * np.linalg.norm(grid - np.array([0.1, 0.0, 0.5]), axis=-1)
    bins = 0.9 + 0.02 * (np.arange(40)[:, None, None] + 0.5)
    TransientCapture(
        H=np.exp(-(((bins - path) / 0.02) ** 2)),
        laser_points=grid,
        sensor_points=grid,
        t_start=0.9,
        delta_t=0.02,
        pairing="confocal",
    ).save(folder / "echo.hdf5")


def _studies(folder: Path) -> None:
    _scenes(folder)
    few = '"1.9 m", "2 m"'
    for name, values in (("few", few), ("many", f'"1.8 m", {few}, "2.1 m"')):
        (folder / f"{name}.toml").write_text(STUDY.replace("VALUES", values))


def contents(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files of a folder, and of empty folders, by relative path."""
    return {
        str(path.relative_to(folder)): b"" if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if not path.is_dir() or not any(path.iterdir())
    }


def of_target(found: Contents, target: str) -> dict[str, bytes]:
    """Return what belongs to a target, which is a file or a folder."""
    return {name: held for name, held in found.items() if (name + "/").startswith(target + "/")}


def lasting(found: Contents) -> dict[str, Any]:
    """Return contents in a form that is equal for two runs with equal results."""
    told: dict[str, Any] = {}
    for name, held in found.items():
        if name.endswith(".json") and b'"program": "nlosoptics"' in held:
            told[name] = _without_times(json.loads(held))
        elif name.endswith(".npz"):
            with np.load(io.BytesIO(held)) as file:
                told[name] = {
                    key: (str(file[key].dtype), file[key].shape, file[key].tobytes())
                    for key in file.files
                    if not key.startswith(PASSING)
                }
        elif name.endswith(".hdf5"):
            told[name] = _datasets(held)
        else:
            told[name] = hashlib.sha256(held).hexdigest()
    return told


def _without_times(record: Any) -> Any:
    if isinstance(record, dict):
        return {key: _without_times(v) for key, v in record.items() if key not in PASSING}
    return [_without_times(value) for value in record] if isinstance(record, list) else record


def _datasets(held: bytes) -> dict[str, Any]:
    """Return the values of an HDF5 file, without the times in its description."""
    import h5py

    told: dict[str, Any] = {}

    def visit(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            value = node[()]
            if name == "scene_info":
                told[name] = _without_times(json.loads(value))
            else:
                told[name] = repr(value) if isinstance(value, h5py.Empty) else np.asarray(value)
                told[name] = getattr(told[name], "tobytes", lambda: told[name])()
        told[f"{name} attributes"] = {key: np.asarray(v).tobytes() for key, v in node.attrs.items()}

    with h5py.File(io.BytesIO(held), "r") as file:
        file.visititems(visit)
    return told


def points(store: Path) -> dict[tuple[float, ...], tuple[float, ...]]:
    """Return the figures of the finished points of a study, by their values."""
    from nlosoptics.study import Results

    results = Results.load(store)
    data = results.dataset
    table = data.drop_vars("seconds").to_dataframe().reset_index()
    done = table[table["status"] == "done"]
    axes = [str(name) for name in data.dims]
    figures = [figure.name for figure in results.study.figures]
    return {
        tuple(map(float, where)): tuple(map(float, told))
        for where, told in zip(done[axes].values, done[figures].values, strict=True)
    }


_RUN = ("run", *SCENE, "--tol", "1e-2", "--memory", "4", "--out", "result", "--seed")
_FIT = ("reconstruct", "letter.npy", "--scene", *SCENE, "--tol", "1e-2", "--out", "result")
_LIGHT = ("transient", "scenes/transient_letter.toml", "--out", "light.hdf5")
_LIGHT += ("--set", "transient.count=4", "--photons", "5e3", "--tol", "0.05", "--seed")
_PLANES = ("image", "echo.hdf5", "--near", "0.4", "--far", "0.6", "--step", "0.1")
_PLANES += ("--out", "result", "--wl-mean")
COMMANDS = {
    "run": Command("result", (*_RUN, "1"), (*_RUN, "2"), _scenes),
    "reconstruct": Command("result", (*_FIT, "--iterations", "20"), _FIT, _exposure, STATE),
    "transient": Command("light.hdf5", (*_LIGHT, "1"), (*_LIGHT, "2"), _scenes),
    "image": Command("result", (*_PLANES, "0.3"), (*_PLANES, "0.2"), _captured),
    "report": Command("run/report.html", ("report", "run"), ("report", "run", "--no-3d"), _result),
    "study": Command(
        "store",
        ("study", "few.toml", "--out", "store", "--workers", "0"),
        ("study", "many.toml", "--out", "store", "--workers", "0"),
        _studies,
        parts=points,
    ),
}
