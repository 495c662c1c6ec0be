"""Values of scene files in one form, so that equal values have equal text."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ...scene.file import units
from ...scene.file.units import written

#: Value and dimension of a text; those of draws are read several times.
measured = lru_cache(1 << 16)(units.measured)


def canonical(value: Any) -> Any:
    """Return a value of a scene file with every quantity in SI units: "2 mm" becomes "0.002 m".

    Lists are converted element by element; other values are returned as they are.
    """
    if isinstance(value, list | tuple):
        return [canonical(inner) for inner in value]
    found = measured(value) if isinstance(value, str) else None
    return value if found is None else written(*found)


def number(value: Any) -> tuple[float, str] | None:
    """Return a value as a number with its SI unit, which may be empty; None if it is no number."""
    if isinstance(value, str):
        found = measured(value)
        return None if found is None else (found[0], found[1].unit)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), ""
    return None


def with_unit(value: float, unit: str) -> Any:
    """Return a number and its SI unit as a scene file holds it."""
    return f"{float(value)!r} {unit}" if unit else float(value)


def label(value: Any) -> str:
    """Return a value as short text for labels, such as "3 mW"."""
    if isinstance(value, list | tuple):
        return "[" + ", ".join(label(inner) for inner in value) + "]"
    found = number(value)
    if found is None:
        return str(value)
    size, unit = found
    if unit in ("m", "s", "W", "rad") and size != 0.0:
        for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
            if abs(size) >= 0.9995 * factor:
                return f"{size / factor:.6g} {prefix}{unit}"
    return f"{size:.6g} {unit}".rstrip()
