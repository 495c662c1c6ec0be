"""Saving and loading result objects: arrays as ``.npz``, everything else as JSON, no pickle."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .. import imaging, inverse, psf
from .._checks import Budget, reason
from ..errors import NlosError, SceneError
from ..psf.aperture.cells import Cell
from ..psf.aperture.curves import Curve
from ..psf.wave.regime import Regime
from ..psf.wave.removed import Removed
from . import plan
from .record import arrays

#: Version of the tree that `written` makes. A reader accepts its own version only.
FORMAT: Final = 2
REMEDY: Final = "run the simulation again"
#: Classes that a tree may name; all others are rejected.
KNOWN: Final[Mapping[str, type]] = {
    known.__name__: known
    for known in (
        plan.Plan,
        plan.Stage,
        Budget,
        psf.ExitPupil,
        psf.Wavefront,
        Removed,
        psf.Aperture,
        Cell,
        Curve,
        psf.PointSpread,
        psf.RoughPointSpread,
        psf.HybridPointSpread,
        Regime,
        psf.PointSpreadField,
        psf.PupilField,
        imaging.SpeckleImage,
        inverse.Reconstruction,
    )
}


def written(nouns: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Write the arrays of several objects, and return all other values as a tree for JSON.

    The objects are dataclasses, mappings, arrays, numbers, text and None, nested freely. Each one
    with arrays gets a file ``<name>.npz``, whose entries have the names of the fields; those of
    nested fields are joined by ``_``. None, booleans, integers, text and finite floats are plain
    JSON values. Every other value is an object with a single key: ``float`` ("nan", "inf", "-inf"),
    ``scalar`` for numpy ([dtype, value]), ``array`` ([file, entry]), ``tuple`` and ``list``
    (items), ``mapping`` (pairs) and ``noun`` ([class, fields]).
    """
    tree: dict[str, Any] = {}
    for name, noun in nouns.items():
        held: dict[str, NDArray[Any]] = {}
        tree[name] = _node(noun, (name,), held)
        if held:
            plain = {} if isinstance(noun, np.ndarray) else arrays(noun)
            np.savez(folder / f"{name}.npz", **(plain | held))
    return tree


def _node(value: Any, place: tuple[str, ...], held: dict[str, NDArray[Any]]) -> Any:
    if isinstance(value, np.generic):  # kept apart from Python numbers to restore the dtype
        return {"scalar": [value.dtype.str, _node(value.item(), place, held)]}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        entry = "_".join(place[1:]) or place[0]
        held[entry] = value
        return {"array": [place[0], entry]}
    if type(value) in (tuple, list):
        items = [_node(item, (*place, str(i)), held) for i, item in enumerate(value)]
        return {type(value).__name__: items}
    if isinstance(value, Mapping):
        return {
            "mapping": [[key, _node(item, (*place, str(key)), held)] for key, item in value.items()]
        }
    name = type(value).__name__
    if is_dataclass(value) and (name in KNOWN or name == "Reconstruction"):
        parts = {
            entry.name: _node(getattr(value, entry.name), (*place, entry.name), held)
            for entry in fields(value)
            if entry.init
        }
        return {"noun": [name, parts]}
    raise SceneError(
        f"{'.'.join(place)} is of type {name}, which a result folder cannot store; leave it out"
    )


def read(tree: Any, folder: Path) -> dict[str, Any]:
    """Restore the objects of a tree by their constructors, which check the values."""
    files: dict[str, Mapping[str, NDArray[Any]]] = {}

    def restored(node: dict[str, Any]) -> Any:
        if len(node) != 1:  # fields of a noun
            return node
        ((kind, content),) = node.items()
        if kind == "float":
            return {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}[content]
        if kind == "scalar":
            return np.dtype(content[0]).type(content[1])
        if kind == "array":
            file, entry = content
            if file not in files:
                files[file] = _entries(folder, str(file))
            array = files[file][entry]
            array.flags.writeable = False
            return array
        if kind in ("tuple", "list"):
            return tuple(content) if kind == "tuple" else content
        if kind == "mapping":
            return dict(content)
        return KNOWN[content[0]](**content[1]) if kind == "noun" else node

    try:
        return dict(json.loads(json.dumps(tree), object_hook=restored))
    except (NlosError, KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        if isinstance(error, _Damaged):
            raise SceneError(str(error)) from None
        raise SceneError(
            f"{folder}: the saved result cannot be read ({reason(error)}); {REMEDY}"
        ) from None


class _Damaged(SceneError):
    """An array file is missing or cannot be read."""


def _entries(folder: Path, name: str) -> Mapping[str, NDArray[Any]]:
    path = folder / f"{Path(name).name}.npz"
    try:
        with path.open("rb") as held, np.load(held, allow_pickle=False) as file:
            return {entry: file[entry] for entry in file.files}
    except FileNotFoundError:
        raise _Damaged(f"{path} is missing; put it back, or {REMEDY}") from None
    except Exception as error:  # numpy lets through what its parsers and zipfile raise
        raise _Damaged(f"{path} is damaged ({reason(error)}); {REMEDY}") from None
