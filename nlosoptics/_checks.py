"""Argument checks, whose messages give value, limit, place and remedy, and run budgets."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import MemoryLimitError, SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Vector = tuple[float, float, float]

T = TypeVar("T")
R = TypeVar("R")
#: Default memory limit as a fraction of the free memory.
SHARE = 0.75
#: Largest component of a vector: sums of squares do not overflow.
MOST = 1e150
#: Largest value of an image, and 1 over the smallest: sums of fourth powers stay in range.
_MOST_SQUARABLE = 1e60


def reason(error: Exception) -> str:
    """Return kind and text of another library's exception, printable and short, for one line."""
    text = "".join(c if c.isprintable() else " " for c in re.sub(r" <_io.*?>", "", str(error)))
    return f"{type(error).__name__}: {' '.join(text.split())[:120]}".removesuffix(": ")


#: How the arguments of public functions are made.
_MAKERS = {
    "Scene": "Scene.load(path)",
    "Wavefront": "psf.wavefront(scene)",
    "PointSpread": "psf.scene_point_spread(scene).point_spread",
    "TransientCapture": "transient.TransientCapture.load(path)",
    "VolumeImage": "transient.phasor_image(capture, wl_mean=...)",
    "Study": "study.Study.load(path)",
    "Volume": "transient.Volume.facing(points, (near, far, step))",
    "Results": "study.run_study(study, path)",
    "Result": "simulate(scene)",
    "Feasibility": "limits.feasibility(scene)",
    "SpotDiagram": "psf.spot_diagram(scene)",
    "ThroughFocus": "psf.through_focus(scene, shifts)",
    "SpeckleImage": "simulate(scene).image",
    "TracedImage": "raytrace.trace_image(scene)",
    "RayPaths": "raytrace.trace(scene)",
    "DepthMap": "transient.depth_map(image)",
    "Advice": "transient.advise(capture)",
    "Optimum": "study.optimum(results)",
    "Shadows": "imaging.cast_shadows(scene)",
    "Roughness": "psf.Roughness(height_rms=50e-9, correlation_length=2e-3)",
    "ScenePointSpread": "psf.scene_point_spread(scene)",
    "Reconstruction": "simulate(scene, reconstruct=True).reconstruction",
    "Wall": "scene.FlatWall()",
    "Trimesh": "trimesh.load_mesh(path)",
    "Sensitivity": "study.sensitivities(results, figure)",
    "Fraction": "study.fraction_within(results, figure, at_most=limit)",
}


#: Attributes with which results hold such arguments.
_PARTS = {
    "Scene": "scene",
    "Wavefront": "wavefront",
    "PointSpread": "point_spread",
    "SpeckleImage": "image",
    "Reconstruction": "reconstruction",
}


def expect(name: str, value: Any, *kinds: str, having: str = "") -> Any:
    """Return ``value`` if it is of one of the classes of these names, or the part of it that is.

    Classes are named, so that no module must be imported for a check. A result is taken for its
    wavefront, for example, and anything for itself that has the attribute ``having``. Raises
    `SceneError` for all else.
    """
    if having and hasattr(value, having):
        return value
    parts = (getattr(value, _PARTS[kind], None) for kind in kinds if kind in _PARTS)
    for one in (value, *parts):
        if {kind.__name__ for kind in type(one).__mro__}.intersection(kinds):
            return one
    makers = [_MAKERS[kind] for kind in kinds if kind in _MAKERS][:1]
    such = "".join(f", such as {maker}" for maker in makers)
    raise SceneError(f"{name} is a {type(value).__name__}; give a {' or '.join(kinds)}{such}")


def each(name: str, values: Any, kind: str) -> list[Any]:
    """Return a sequence as a list if all are of the class of this name, or raise `SceneError`."""
    if isinstance(values, (str, bytes, Mapping)) or not isinstance(values, Iterable):
        raise SceneError(f"{name} is a {type(values).__name__}; give a list of {kind}")
    return [expect(f"{name}[{i}]", value, kind) for i, value in enumerate(values)]


def mapping(name: str, value: Any, such: str) -> Mapping[Any, Any]:
    """Return ``value`` if it is a mapping, otherwise raise `SceneError`; ``such`` is an example."""
    if not isinstance(value, Mapping):
        raise SceneError(f"{name} is a {type(value).__name__}, must be a mapping; give {such}")
    return value


def numbers(name: str, value: Any) -> NDArray[np.float64]:
    """Return ``value`` as an array of float64, or raise `SceneError` naming ``name``."""
    import numpy as np

    try:
        if value is None or np.iscomplexobj(value):  # numpy takes it for NaN, or its real part
            raise TypeError
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(
            f"{name} = {shown(value)} is no array of numbers; give floats in rows of equal length"
        ) from None


def shown(value: Any) -> str:
    """Return the representation of a value in one line of at most 80 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:50]} ... {text[-20:]}"


def real(name: str, value: Any) -> float:
    """Return ``value`` as a finite float, or raise `SceneError` naming ``name``."""
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    try:
        if isinstance(value, (str, bytes, bytearray, bool)) or kind not in "iuf":
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise SceneError(
            f"{name} = {shown(value)} is not a number; give a float in SI units"
        ) from None
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


def squarable(name: str, largest: float) -> None:
    """Raise `SceneError` if squares and sums of values up to ``largest`` leave a float's range."""
    if largest > _MOST_SQUARABLE or 0.0 < largest < 1.0 / _MOST_SQUARABLE:
        raise SceneError(
            f"{name} has values up to {largest:.3g}, must be {1.0 / _MOST_SQUARABLE:g} to "
            f"{_MOST_SQUARABLE:g}; multiply all of them by a constant"
        )


def whole(name: str, value: Any, low: int = 1, high: int | None = None) -> int:
    """Return ``value`` as an int from ``low`` to ``high``; reject booleans and fractions."""
    wrong = isinstance(value, (str, bytes, bytearray, bool))
    # integers may have more digits than a float
    if wrong or (not isinstance(value, Integral) and not real(name, value).is_integer()):
        raise SceneError(f"{name} = {shown(value)} is not a whole number; give an integer")
    number = int(value)
    if number < low or (high is not None and number > high):
        limit = f"at least {low}" if high is None else f"from {low} to {high}"
        # Python does not convert ints of thousands of digits to text
        told = number if number.bit_length() < 128 else f"an int of {number.bit_length()} bits"
        raise SceneError(f"{name} = {told} is out of range, must be {limit}")
    return number


def whole_pair(name: str, value: Any, most: tuple[int, int] | None = None) -> tuple[int, int]:
    """Return rows and columns as two whole numbers, each at least 1 and at most the limit."""
    try:
        rows, columns = value
    except (TypeError, ValueError):
        raise SceneError(
            f"{name} = {shown(value)} is not (rows, columns); give two integers"
        ) from None
    high = most or (None, None)
    return whole(f"{name}[0]", rows, 1, high[0]), whole(f"{name}[1]", columns, 1, high[1])


def one_of(name: str, value: Any, choices: Iterable[str]) -> str:
    """Return ``value`` if it is one of ``choices``, otherwise raise `SceneError`."""
    choices = tuple(choices)
    if value not in choices:
        raise SceneError(f"{name} = {shown(value)} is unknown, must be one of {', '.join(choices)}")
    return str(value)


def path_of(name: str, value: Any) -> Path:
    """Return ``value`` as a path that the system takes, or raise `SceneError` naming ``name``."""
    if not isinstance(value, (str, os.PathLike)):
        raise SceneError(
            f"{name} = {shown(value)} is not the path of a file or folder; give a str or Path"
        )
    path = Path(value)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass  # told, with the right remedy, by the function that opens it
    except (OSError, ValueError) as error:  # too long, or with a null character
        raise SceneError(
            f"{name} = {str(path)[:60]!r} cannot be the path of a file or folder "
            f"({getattr(error, 'strerror', error)}); give another path"
        ) from None
    return path


def vector(name: str, value: Any) -> Vector:
    """Return ``value`` as three finite floats."""
    if is_single(value) or not (isinstance(value, Sequence) or hasattr(value, "__array__")):
        raise SceneError(f"{name} = {shown(value)} is not a vector; give three numbers in m")
    if len(value) != 3:
        raise SceneError(
            f"{name} has {counted(len(value), 'component')}; give three, x, y and z in m"
        )
    x, y, z = (
        in_range(f"{name}[{axis}]", v, -MOST, MOST) for axis, v in zip("xyz", value, strict=True)
    )
    return (x, y, z)


def is_single(value: Any) -> bool:
    """Return whether ``value`` is a single number, of Python or numpy."""
    return isinstance(value, Real) or getattr(value, "ndim", None) == 0


def pair(name: str, value: Any, *, unit: str = "m") -> tuple[float, float]:
    """Return (x, y) extents above zero; a single number is used for both."""
    if is_single(value):
        value = (value, value)
    if not isinstance(value, Sequence) and not hasattr(value, "__array__"):
        raise SceneError(f"{name} = {shown(value)} is not a size; give one number or two")
    if len(value) != 2:
        raise SceneError(
            f"{name} has {counted(len(value), 'component')}; give one number or (x, y)"
        )
    x, y = (positive(f"{name}[{axis}]", v, unit=unit) for axis, v in zip("xy", value, strict=True))
    return (x, y)


def available_memory() -> float:
    """Return the free memory, bytes; infinity if the system does not report it."""
    # cached for 0.25 s; reading it takes as long as a small transform
    return _memory_at(int(4.0 * time.monotonic()))


@lru_cache(maxsize=1)
def _memory_at(moment: int) -> float:
    """Return the free memory; a moment is asked for once."""
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
    """Limits of one run: memory, bytes, and predicted run time on one core, s."""

    memory: float
    seconds: float


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextmanager
def within(budget: Budget) -> Iterator[None]:
    """Apply a budget within a block, in this thread and in functions wrapped by `carried`."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


def carried(function: Callable[[T], R]) -> Callable[[T], R]:
    """Wrap a function so that the current budget also applies in another thread."""
    budget = _budget.get()
    if budget is None:
        return function

    def run(value: T) -> R:
        with within(budget):
            return function(value)

    return run


def memory_limit() -> float:
    """Return the current memory limit, bytes; without a budget, `SHARE` of the free memory."""
    budget = _budget.get()
    return SHARE * available_memory() if budget is None else budget.memory


def seconds_limit(without: float) -> float:
    """Return the current time limit, s; ``without`` if there is no budget."""
    budget = _budget.get()
    return without if budget is None else budget.seconds


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a count with its noun, such as "1 pair" or "2 pairs"; the plural may be given."""
    return f"{count} {noun if count == 1 else plural or f'{noun}s'}"


def lasting(seconds: float) -> str:
    """Return a time as text, such as "3.2 ms", "0.52 s", "17.3 min" or "2.5 h"."""
    for limit, size, unit in ((0.1, 1e-3, "ms"), (120, 1, "s"), (7200, 60, "min")):
        if seconds < limit:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 3600:.3g} h"


def fits_memory(what: str, n_bytes: float, remedy: str) -> None:
    """Raise `MemoryLimitError` before an allocation that exceeds the memory limit."""
    limit = memory_limit()
    if n_bytes > limit:
        raise MemoryLimitError(
            f"{what} needs {n_bytes / 2**30:.3g} GiB, limit {limit / 2**30:.3g} GiB; {remedy}"
        )
