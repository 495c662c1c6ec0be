"""Quantities in the tables of scene files, and the base class of the tables."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
)

from ..._checks import Vector as Triple
from ..._checks import counted
from .units import ANGLE, LENGTH, POWER, RATE, TIME, Kind, parse, written

Pair = tuple[float, float]


def _string(kind: Kind) -> dict[str, Any]:
    """Return the JSON schema of a quantity with its unit."""
    return {
        "type": "string",
        "pattern": r"^\s*[+-]?(\d[\d_]*\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[^\d\s].*$",
        "description": f"{kind.name} with its unit, such as {kind.example}",
    }


def _quantity(kind: Kind) -> Any:
    """Return the pydantic annotations of a quantity: validator, serializer and schema."""
    return (
        PlainValidator(lambda text: parse(text, kind)),
        PlainSerializer(lambda value: written(value, kind)),
        WithJsonSchema(_string(kind)),
    )


def _several(text: object, count: int) -> tuple[float, ...]:
    """Return a list of ``count`` lengths in m."""
    if not isinstance(text, list):
        raise ValueError("is not a list")
    if len(text) != count:
        raise ValueError(f"has {counted(len(text), 'component')}, must have {count}")
    return tuple(parse(component, LENGTH) for component in text)


def _parse_size(text: object) -> Any:
    """Return one length, or a pair of them, in m."""
    return _several(text, 2) if isinstance(text, list) else parse(text, LENGTH)


def _write_lengths(value: Any) -> Any:
    """Return one length, or a list of them, as text."""
    if isinstance(value, float):
        return written(value, LENGTH)
    return [written(component, LENGTH) for component in value]


def _array(count: int) -> dict[str, Any]:
    """Return the JSON schema of a list of ``count`` lengths."""
    return {"type": "array", "items": _string(LENGTH), "minItems": count, "maxItems": count}


LengthText = Annotated[float, *_quantity(LENGTH)]
TimeText = Annotated[float, *_quantity(TIME)]
RateText = Annotated[float, *_quantity(RATE)]
PowerText = Annotated[float, *_quantity(POWER)]
AngleText = Annotated[float, *_quantity(ANGLE)]
VectorText = Annotated[
    Triple,
    PlainValidator(lambda text: _several(text, 3)),
    PlainSerializer(_write_lengths),
    WithJsonSchema(_array(3)),
]
SizeText = Annotated[
    Pair | float,
    PlainValidator(_parse_size),
    PlainSerializer(_write_lengths),
    WithJsonSchema({"anyOf": [_string(LENGTH), _array(2)]}),
]


class Table(BaseModel):
    """Base class of tables: unknown keys are errors, and strings are not read as numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def key(description: str) -> Any:
    """Return an optional key with a description for editors."""
    return Field(None, description=description)
