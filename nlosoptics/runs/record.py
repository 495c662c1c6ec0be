"""Parts of the record of a run: arrays, hash of the scene, versions, memory."""

from __future__ import annotations

import datetime
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from .._whole_files import RECORD

if TYPE_CHECKING:
    from ..scene import Scene

#: Name of the HTML page that ``nlosoptics report`` writes into a run's folder.
PAGE = "report.html"
#: Packages whose versions can change the numbers of a run.
DECIDING = ("numpy", "scipy", "numba", "ducc0", "torch", "trimesh", "pillow")


def write_record(record: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write ``result.json``, with the program and the folder's files; return its contents."""
    program = {"program": "nlosoptics", "status": "done", "finished": now(), "versions": versions()}
    files = sorted({*(path.name for path in folder.iterdir()), RECORD})
    record = program | record | {"files": files}
    (folder / RECORD).write_bytes(record_text(record))
    return record


def record_text(record: dict[str, Any]) -> bytes:
    """Return the text of ``result.json``."""
    return (json.dumps(record, indent=2, allow_nan=False) + "\n").encode()


def arrays(noun: Any) -> dict[str, Any]:
    """Return the entries of a dataclass or mapping that an ``.npz`` file can hold without pickle.

    Nested entries are joined to flat names by underscores.
    """
    from dataclasses import fields, is_dataclass

    import numpy as np

    entries = (
        {entry.name: getattr(noun, entry.name) for entry in fields(noun)}
        if is_dataclass(noun)
        else noun
    )
    found: dict[str, Any] = {}
    for name, value in entries.items():
        if is_dataclass(value) or isinstance(value, Mapping):
            found |= {f"{name}_{key}": inner for key, inner in arrays(value).items()}
        elif not (array := np.asarray(value)).dtype.hasobject:
            found[name] = array
    return found


def scene_hash(scene: Scene) -> str:
    """SHA-256 of the scene file's text and the contents of all files that it refers to."""
    import hashlib

    from ..scene.file.scene_file import scene_files

    digest = hashlib.sha256()
    for name, content in scene_files(scene).items():
        digest.update(f"{name} {len(content)} ".encode())
        digest.update(content)
    return digest.hexdigest()


def now() -> str:
    """Return the current UTC date and time in ISO 8601 format, to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def versions() -> dict[str, str]:
    """Return the versions of Python, nlosoptics and the packages in `DECIDING`."""
    import importlib.metadata  # slow to load

    found = {"python": ".".join(map(str, sys.version_info[:3])), "nlosoptics": __version__}
    for name in DECIDING:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def peak_memory() -> float | None:
    """Return the peak resident memory of this process, bytes; None if the system lacks it."""
    try:
        import resource
    except ModuleNotFoundError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts bytes, Linux KiB
    return float(peak) if sys.platform == "darwin" else 1024.0 * peak
