"""Variables of a search: addresses with limits, ordered lists or alternatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import SceneError
from .base import Base
from .designs import listed, span
from .file import Limits
from .values import canonical, label, number, with_unit


@dataclass(frozen=True, kw_only=True)
class Variable:
    """Value of a scene that a search may change.

    Parameters
    ----------
    address : str
        Address of the value.
    low, high : float
        Limits of a continuous variable in its SI unit; first and last index of a list.
    unit : str
        SI unit, or empty.
    log : bool
        Whether coordinates are spaced logarithmically.
    values : tuple
        Values of a list; empty for a continuous variable.
    ordered : bool
        Whether the variable is continuous, or the list holds numbers in rising or falling order.
    start : float
        Coordinate of the scene's own value; of the middle, or the first of a list, if there is
        none within the limits.
    """

    address: str
    low: float
    high: float
    unit: str
    log: bool
    values: tuple[Any, ...]
    ordered: bool
    start: float

    @property
    def continuous(self) -> bool:
        """Whether coordinates are the numbers from 0 to 1, and not the indices of a list."""
        return not self.values

    def value(self, coordinate: float) -> Any:
        """Return the value at a coordinate, from 0 to 1 or an index, as a scene file holds it."""
        if self.values:
            return self.values[round(float(coordinate))]
        if self.log:
            found = self.low * (self.high / self.low) ** float(coordinate)
        else:
            found = self.low + float(coordinate) * (self.high - self.low)
        # ten digits, so that rounding of another machine rarely gives another point
        inner = min(max(float(f"{found:.10g}"), self.low), self.high)
        return canonical(with_unit(inner, self.unit))

    def coordinate(self, value: Any) -> float | None:
        """Return the coordinate of a value; None if it is not within the limits."""
        if self.values:
            return float(self.values.index(value)) if value in self.values else None
        found = number(value)
        if found is None or not self.low <= found[0] <= self.high:
            return None
        if self.log:
            return float(np.log(found[0] / self.low) / np.log(self.high / self.low))
        return (found[0] - self.low) / (self.high - self.low)


def variable(name: str, address: str, given: list[Any] | Limits, own: Any, base: Base) -> Variable:
    """Return a variable of a study file."""
    if isinstance(given, Limits):
        low, high, unit = span(name, given)
        values: tuple[Any, ...] = ()
        ordered = True
    else:
        values = tuple(base.packed({address: v})[address] for v in listed(name, given))
        found = [number(value) for value in values]
        steps = np.diff([one[0] for one in found if one is not None])
        ordered = None not in found and (bool((steps > 0).all()) or bool((steps < 0).all()))
        low, high, unit = 0.0, len(values) - 1.0, ""
        if len(values) < 2:
            raise SceneError(f"{name} = {label(values)} leaves no choice; give two values or more")
    made = Variable(
        address=address,
        low=low,
        high=high,
        unit=unit,
        log=isinstance(given, Limits) and given.spacing == "log",
        values=values,
        ordered=ordered,
        start=0.0 if values else 0.5,
    )
    start = None if own is None else made.coordinate(own)
    return made if start is None else replace(made, start=start)


def check_variable(variable: Variable, base: Base) -> None:
    """Raise `SceneError` if an address or the form of a value is wrong."""
    for value in variable.values or (variable.value(0.0), variable.value(1.0)):
        base.checked({variable.address: value})


def delta_of(variables: tuple[Variable, ...], point: Mapping[str, float]) -> dict[str, Any]:
    """Return values by address at the coordinates of a point."""
    return {v.address: v.value(point[v.address]) for v in variables if v.address in point}
