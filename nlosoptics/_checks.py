"""Checks shared by every constructor: value, limit, place and remedy in one line."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from .errors import MemoryLimitError, SceneError

Vector = tuple[float, float, float]

T = TypeVar("T")
R = TypeVar("R")
#: Share of the free memory that may be taken where nobody says.
SHARE = 0.75
#: Seconds for which a reading of the free memory holds; each costs as much as a small transform.
FRESH = 0.25


def real(name: str, value: Any) -> float:
    """Return ``value`` as a finite float, or raise `SceneError` naming ``name``."""
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    try:
        if isinstance(value, (str, bytes, bytearray, bool)) or kind not in "iuf":
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise SceneError(f"{name} = {value!r} is not a number; give a float in SI units") from None
    except OverflowError:
        raise SceneError(f"{name} is beyond the range of a float; give a smaller number") from None
    if not math.isfinite(number):
        raise SceneError(f"{name} = {number} is not finite; give a finite number in SI units")
    return number


def in_range(
    name: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    open_low: bool = False,
    unit: str = "",
    remedy: str = "",
) -> float:
    """Return ``value`` as a float within [low, high], or (low, high] when ``open_low``."""
    number = real(name, value)
    if number < low or number > high or (open_low and number == low):
        unit = f" {unit}" if unit else ""
        if math.isinf(high):
            limit = f"{'above' if open_low else 'at least'} {low:g}{unit}"
        else:
            limit = f"{'above' if open_low else 'from'} {low:g} to {high:g}{unit}"
        hint = f"; {remedy}" if remedy else ""
        raise SceneError(f"{name} = {number:g}{unit} is out of range, must be {limit}{hint}")
    return number


def positive(name: str, value: Any, *, unit: str = "", remedy: str = "") -> float:
    """Return ``value`` as a finite float above zero."""
    return in_range(name, value, 0.0, open_low=True, unit=unit, remedy=remedy)


def whole(name: str, value: Any, low: int = 1, high: int | None = None) -> int:
    """Return ``value`` as an int from ``low`` to ``high``; booleans and fractions are refused."""
    # an int may hold more digits than a float
    if not isinstance(value, Integral) and not real(name, value).is_integer():
        raise SceneError(f"{name} = {value!r} is not a whole number")
    if isinstance(value, bool):
        raise SceneError(f"{name} = {value!r} is not a whole number")
    number = int(value)
    if number < low or (high is not None and number > high):
        limit = f"at least {low}" if high is None else f"from {low} to {high}"
        # Python refuses to write out ints of thousands of digits
        shown = number if number.bit_length() < 128 else f"an int of {number.bit_length()} bits"
        raise SceneError(f"{name} = {shown} is out of range, must be {limit}")
    return number


def one_of(name: str, value: Any, choices: Iterable[str]) -> str:
    """Return ``value`` when it is among ``choices``."""
    choices = tuple(choices)
    if value not in choices:
        raise SceneError(f"{name} = {value!r} is unknown, must be one of {', '.join(choices)}")
    return str(value)


def path_of(name: str, value: Any) -> Path:
    """Return ``value`` as a path, or raise `SceneError` naming ``name``."""
    if isinstance(value, (str, os.PathLike)):
        path = Path(value)
        if "\0" not in str(path):
            return path
    raise SceneError(f"{name} = {value!r} is no path of a file or folder; give a str or a Path")


def vector(name: str, value: Any) -> Vector:
    """Return three finite floats."""
    if is_single(value) or not (isinstance(value, Sequence) or hasattr(value, "__array__")):
        raise SceneError(f"{name} = {value!r} is not a vector; give three numbers in m")
    if len(value) != 3:
        raise SceneError(f"{name} has {len(value)} components; give three, x, y and z in m")
    x, y, z = (real(f"{name}[{axis}]", v) for axis, v in zip("xyz", value, strict=True))
    return (x, y, z)


def is_single(value: Any) -> bool:
    """Whether ``value`` is one number, be it of Python or of numpy."""
    return isinstance(value, Real) or getattr(value, "ndim", None) == 0


def pair(name: str, value: Any, *, unit: str = "m") -> tuple[float, float]:
    """Return (x, y) extents above zero; one number stands for both."""
    if is_single(value):
        value = (value, value)
    if not isinstance(value, Sequence) and not hasattr(value, "__array__"):
        raise SceneError(f"{name} = {value!r} is not a size; give one number or two")
    if len(value) != 2:
        raise SceneError(f"{name} has {len(value)} components; give one number or (x, y)")
    x, y = (positive(f"{name}[{axis}]", v, unit=unit) for axis, v in zip("xy", value, strict=True))
    return (x, y)


def available_memory() -> float:
    """Bytes that can still be allocated; infinity where the system does not say."""
    return _memory_at(int(time.monotonic() / FRESH))


@lru_cache(maxsize=1)
def _memory_at(moment: int) -> float:
    """Return the free memory, read at most once in `FRESH` seconds."""
    try:
        with Path("/proc/meminfo").open() as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return float(line.split()[1]) * 1024
    except OSError:
        pass
    return math.inf


@dataclass(frozen=True)
class Budget:
    """Limits of one run.

    Parameters
    ----------
    memory : float
        Bytes.
    seconds : float
        Of one core.
    """

    memory: float
    seconds: float


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextmanager
def within(budget: Budget) -> Iterator[None]:
    """Hold what is done to a budget, in this thread and in what `carried` takes to others."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


def carried(function: Callable[[T], R]) -> Callable[[T], R]:
    """The function held to the present budget in whichever thread it runs."""
    budget = _budget.get()
    if budget is None:
        return function

    def run(value: T) -> R:
        with within(budget):
            return function(value)

    return run


def memory_limit() -> float:
    """Bytes that may be taken: the present budget's, or else `SHARE` of what is free."""
    budget = _budget.get()
    return SHARE * available_memory() if budget is None else budget.memory


def seconds_limit(without: float) -> float:
    """Seconds that may be taken: the present budget's, or ``without`` one."""
    budget = _budget.get()
    return without if budget is None else budget.seconds


def fits_memory(what: str, n_bytes: float, remedy: str) -> None:
    """Raise `MemoryLimitError` before an allocation that the budget or the machine cannot hold."""
    limit = memory_limit()
    if n_bytes > limit:
        raise MemoryLimitError(
            f"{what} needs {n_bytes / 2**30:.3g} GiB, limit {limit / 2**30:.3g} GiB; {remedy}"
        )
