"""What the functions of a room return on the way to a result.

A result hides much of what led to it: costs that were compared, bounds that were not reached,
counts of nodes of a method that lost. A test puts them on record, so that an edit that changes one
is seen.
"""

from __future__ import annotations

import inspect
import math
import sys
import zlib
from collections.abc import Callable, Mapping, Sized
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import nlosoptics

from . import records

PACKAGE = str(Path(nlosoptics.__file__).parent)
#: Below this, in SI units or as a share, a number may be a rounding error.
LEAST = 1e-11
#: Records compare sums, to which each number contributes its logarithm.
NEAR = 1e-5


def steps(call: Callable[[], Any], *folders: str) -> dict[str, Any]:
    """Return numbers that stand for all that functions return during a call, by their names.

    Parameters
    ----------
    call : callable
        It may end with an error of the package.
    *folders : str
        Folders of the package whose functions are seen, such as ``psf/wave``.
    """
    found: dict[str, list[float]] = {}
    starts = tuple(f"{PACKAGE}/{folder}/" for folder in folders)

    def returned(frame: FrameType, event: str, value: Any) -> None:
        code = frame.f_code
        # neither a class nor a compiled kernel
        named = code.co_name[0] != "<" and code.co_flags & inspect.CO_OPTIMIZED
        if event == "return" and named and code.co_filename.startswith(starts):
            name = f"{Path(code.co_filename).stem}.{code.co_qualname}"
            sys.setprofile(None)
            found.setdefault(name, []).extend(_logarithms(value))
            sys.setprofile(returned)

    records.clear_caches()
    sys.setprofile(returned)
    try:
        records.attempt(call)
    finally:
        sys.setprofile(None)
    return {name: np.array(values) for name, values in sorted(found.items())}


def _logarithms(value: Any) -> list[float]:
    """Return logarithms of a value's numbers: a word is one, and so is an array's size.

    Arrays count by their size alone, since some are returned to be filled.
    """
    if isinstance(value, str):
        value = zlib.crc32(value.encode())
    if isinstance(value, Sized) and hasattr(value, "shape"):
        value = math.prod(value.shape)
    if value is None or isinstance(value, bool | int | float | np.number):
        return [float(np.arcsinh(float(value or 0.0) / LEAST))]
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name, None) for one in fields(value)}
    if isinstance(value, Mapping):
        value = [one for name, one in value.items() if name not in records.TIMES]
    if not isinstance(value, list | tuple):
        return []
    return [number for one in value for number in _logarithms(one)]
