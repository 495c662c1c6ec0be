"""Results on record, by which an edit that changes a number is seen.

A record is no truth: other tests tell whether a number is right. It holds what these cannot bound
from both sides, such as stated errors, numbers of nodes, and predicted time and memory. A test
passes its result to the fixture ``on_record``. After a change that is meant,
``pytest FILE -n0 --record new`` writes the file's new numbers, whose difference is read like code.
Some numbers depend on the rounding of a machine: errors near 0, and rays that just meet an edge.
``-n0 --record common`` on another machine, or with NUMBA_CPU_NAME=generic and a new
NUMBA_CACHE_DIR, strikes out the numbers that differ there. They are compared nowhere from then on.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nlosoptics.errors import NlosError
from nlosoptics.scene import Scene

#: Largest difference, relative to a number or to the sum of an array's magnitudes.
TOLERANCE = 1e-6
#: Value of a number that depends on the machine.
ANY = "any"
#: What a clock has measured, but for classes that predict it.
TIMES, PREDICTED = ("seconds", "timings"), ("Cost", "Candidate", "RoughChoice")


def digest(value: Any, name: str = "") -> dict[str, Any]:
    """Return the numbers of a result by name; of an array, its shape and three sums of it."""
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    if value is None or isinstance(value, bool | str):
        return {name: value}
    if isinstance(value, int | float | np.number):
        return {name: _short(value) if math.isfinite(value) else str(value)}
    if isinstance(value, complex | np.complexfloating):
        return digest([value.real, value.imag], name)
    if isinstance(value, BaseException):
        return {name: f"{type(value).__name__}: {value}"}
    if isinstance(value, Scene):
        return {}
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {key: value[key] for key in value.dtype.names}
    if isinstance(value, np.ndarray):
        return {name: _sums(value)} if value.dtype.kind in "biufc" else {}
    times = () if type(value).__name__ in PREDICTED else TIMES
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        value = value._asdict()
    elif isinstance(value, list | tuple):
        value = dict(enumerate(value))
    if not isinstance(value, Mapping):
        return {}
    held = {key: one for key, one in value.items() if key not in times}
    parts = [digest(one, f"{name}.{key}".strip(".")) for key, one in held.items()]
    return {key: one for part in parts for key, one in part.items()}


def _sums(array: np.ndarray) -> list[float]:
    """Return the shape, then two weighted sums and the sum of magnitudes."""
    values = np.concatenate([array.real.ravel(), array.imag.ravel()]).astype(float)
    values = np.nan_to_num(values, nan=-7.0, posinf=11.0, neginf=-13.0)
    phase = 2.4 * np.arange(values.size) + 1.0
    sums = (values @ np.cos(phase), values @ np.sin(phase), np.abs(values).sum())
    return [*map(float, array.shape), *map(_short, sums)]


def _short(value: float) -> float:
    return float(f"{value:.9g}")


def differing(found: Mapping[str, Any], known: Mapping[str, Any], tolerance: float) -> list[str]:
    """Return a line for each number that is not the one on record."""
    names = [*dict.fromkeys([*known, *found])]
    pairs = [(name, found.get(name, "nothing"), known.get(name, "nothing")) for name in names]
    wrong = [(name, *pair) for name, *pair in pairs if not _same(*pair, tolerance)]
    return [f"{name}: {new}, on record {old}" for name, new, old in wrong]


def _same(new: Any, old: Any, tolerance: float) -> bool:
    if old == ANY:
        return True
    if isinstance(new, list) and isinstance(old, list):
        near = len(new) == len(old) and new[:-3] == old[:-3]
        return near and np.allclose(new[-3:], old[-3:], rtol=0, atol=tolerance * old[-1])
    if isinstance(new, float) and isinstance(old, float):
        return math.isclose(new, old, rel_tol=tolerance, abs_tol=1e-14)
    return bool(new == old)


def clear_caches() -> None:
    """Clear the caches of the package's functions, so that a record holds all that is stated."""
    for module in [*sys.modules.values()]:
        if module.__name__.startswith("nlosoptics"):
            for value in [*vars(module).values()]:
                if callable(getattr(value, "cache_clear", None)):
                    value.cache_clear()


def check(
    file: Path,
    name: str,
    result: Any,
    need: Sequence[float],
    *,
    tolerance: float,
    record: str | None,
) -> None:
    """Compare a test's result, and the memory that it states to need, with those on record.

    Each stated number of bytes must be on record; a cache may keep some from being stated.

    Parameters
    ----------
    file : Path
        File of the record.
    name : str
        Name of the test.
    result : object
        Anything that `digest` takes.
    need : sequence of float
        Stated memory, bytes.
    tolerance : float
        Largest relative difference, see `TOLERANCE`.
    record : {"new", "common"} or None
        Whether numbers are written: new ones, or strokes for those that differ.
    """
    known = json.loads(file.read_text()) if file.is_file() else {}
    before = dict(known.get(name, {}))
    held = {*before.pop("bytes", "").split()}
    found, stated = digest(result), {f"{one:.6g}" for one in need}
    if record is None:
        wrong = differing(found, before, tolerance)
        wrong += [f"bytes: {one} is not on record" for one in stated - held]
        assert not wrong, "\n".join(wrong[:10])
        return
    struck = {key for key, old in before.items() if old == ANY}
    if record == "common":
        stated |= held
        for key in before.keys() | found.keys():
            if not _same(found.get(key, "nothing"), before.get(key, "nothing"), tolerance):
                struck.add(key)
    row = found | dict.fromkeys(struck, ANY) | {"bytes": " ".join(sorted(stated, key=float))}
    rows = {**known, name: row}
    lines = [f"{json.dumps(key)}: {json.dumps(rows[key])}" for key in sorted(rows)]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def attempt(call: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Return what a call gives, or the package's own error that it raises."""
    try:
        return call(*args, **options)
    except NlosError as error:
        return error
