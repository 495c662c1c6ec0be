"""Conversion of quantities with units, such as ``"632.8 nm"``, to SI floats and back.

Decimal arithmetic converts ``"632.8 nm"`` to the float nearest to 6.328e-07. The usual units are
looked up in a table. Others, such as ``"3 kg m^2/s^3"``, are read by pint, whose import takes
longer than reading a scene.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING, Any

from ..parts._quantities import Kind

if TYPE_CHECKING:
    import pint


_PREFIXES = {"": "1", "k": "1e3", "c": "1e-2", "m": "1e-3", "µ": "1e-6", "μ": "1e-6", "u": "1e-6"}
_PREFIXES |= {"n": "1e-9", "p": "1e-12"}
#: Kind and value in SI units by the text of a unit.
_USUAL: dict[str, tuple[Kind, Decimal]] = {
    "in": (Kind.LENGTH, Decimal("0.0254")),
    "1/m": (Kind.CURVATURE, Decimal(1)),
}
_USUAL["deg"] = _USUAL["°"] = (
    Kind.ANGLE,
    Decimal("3.14159265358979323846264338327950288") / 180,
)
for _prefix, _value in _PREFIXES.items():
    for _unit, _kind in (
        ("m", Kind.LENGTH),
        ("s", Kind.TIME),
        ("W", Kind.POWER),
        ("rad", Kind.ANGLE),
        ("Hz", Kind.RATE),
    ):
        _USUAL[_prefix + _unit] = (_kind, Decimal(_value))
    _USUAL[f"/{_prefix}s"] = _USUAL[f"1/{_prefix}s"] = (Kind.RATE, 1 / Decimal(_value))

# reading pint's own definitions takes 0.2 s; these suffice for scene files and take 5 ms
_DEFINITIONS = """
kilo- = 1e3 = k-
centi- = 1e-2 = c-
milli- = 1e-3 = m-
micro- = 1e-6 = µ- = μ- = u-
nano- = 1e-9 = n-
pico- = 1e-12 = p-
meter = [length] = m = metre
inch = 0.0254 * meter = in
second = [time] = s = sec
kilogram = [mass] = kg
radian = [] = rad
degree = 3.14159265358979323846264338327950288 / 180 * radian = deg = °
arcminute = degree / 60 = arcmin
arcsecond = degree / 3600 = arcsec
steradian = [solid_angle] = sr
watt = kilogram * meter ** 2 / second ** 3 = W
hertz = 1 / second = Hz
"""
_NUMBER_AND_UNIT = re.compile(
    r"\s*([+-]?(?:nan|inf(?:inity)?|(?:\d[\d_]*\.?\d*|\.\d+)(?:e[+-]?\d+)?))\s*(.*?)\s*",
    re.IGNORECASE,
)


@cache
def _registry() -> pint.UnitRegistry[Any]:
    """Return the registry of the units above, built at the first call."""
    import pint

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry(None, non_int_type=Decimal)
    for line in _DEFINITIONS.strip().splitlines():
        registry.define(line)
    return registry


def _kind_of(quantity: Any) -> str:
    """Return the name of a quantity's dimension, for messages."""
    for kind in Kind:
        if quantity.is_compatible_with(kind.unit):
            return kind.title
    return "something else"


def measured(text: object) -> tuple[float, Kind] | None:
    """Return the value in SI units of a text with a unit, and its dimension; else None."""
    match = _NUMBER_AND_UNIT.fullmatch(text) if isinstance(text, str) else None
    if match is not None and math.isfinite(float(match[1])):
        usual = _usual(*match.groups())
        if usual is not None:
            return usual
    for kind in Kind:
        with suppress(ValueError):
            return parse(text, kind), kind
    return None


def parse(text: object, kind: Kind) -> float:
    """Return the value in SI units of a text such as "2 mrad", for a dimension ``kind``."""
    write = f'; write for example "{kind.example}"'
    match = _NUMBER_AND_UNIT.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        if isinstance(text, (int, float)) and not isinstance(text, bool):
            raise ValueError(f"has no unit, must be {kind.title}{write}")
        raise ValueError(f"is not {kind.title}{write}")
    number, unit = match.groups()
    if unit == "":
        raise ValueError(f"has no unit, must be {kind.title}{write}")
    if not math.isfinite(float(number)):
        raise ValueError("is not finite")
    usual = _usual(number, unit)
    if usual is not None:
        if usual[1] != kind:
            raise ValueError(f"is {usual[1].title}, must be {kind.title}{write}")
        return usual[0]
    registry = _registry()  # outside of `try`: a pint that does not load is no unknown unit
    try:
        # a leading slash marks a rate, such as "0.1 / s"
        quantity = registry.Quantity(Decimal(number), f"1{unit}" if unit[0] == "/" else unit)
    except Exception:  # the parser of pint raises arbitrary exception types
        raise ValueError(f"has the unknown unit {unit!r}, must be {kind.title}{write}") from None
    if not quantity.is_compatible_with(kind.unit):
        raise ValueError(f"is {_kind_of(quantity)}, must be {kind.title}{write}")
    return float(quantity.to(kind.unit).magnitude)


def _usual(number: str, unit: str) -> tuple[float, Kind] | None:
    """Return the value in SI units of a finite number with a usual unit, and its dimension."""
    known = _USUAL.get(re.sub(r"^/\s+", "/", unit))
    return None if known is None else (float(Decimal(number) * known[1]), known[0])


def written(value: float, kind: Kind) -> str:
    """Return ``value`` as text in SI units that `parse` converts back to the same float."""
    return f"{float(value)!r} {kind.unit}"
