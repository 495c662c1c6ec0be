"""Inverse sensitivity: the change of each value at which a figure has lost a stated amount."""

from __future__ import annotations

import math

from ..design.file import InverseSensitivity
from .problem import Ask, Point, Problem


def bisect(problem: Problem, ask: Ask, table: InverseSensitivity) -> str:
    """Halve the interval between a kept and a lost figure, for all values and both sides at once.

    Parameters
    ----------
    problem : Problem
        Values, each with the scene's own as its start.
    ask : callable
        Returns the outcomes of points.
    table : InverseSensitivity
        Figure, loss and precision. A point at which the figure fails counts as lost.
    """
    nominal = ask([{}])[0].values[0]
    if not math.isfinite(nominal):
        return "the figure of the nominal scene failed"
    limit = nominal + table.loss
    sides = [
        (v.address, v.start, end) for v in problem.variables for end in (0.0, 1.0) if v.start != end
    ]

    def kept(points: list[Point]) -> list[bool]:
        return [one.values[0] <= limit for one in ask(points)]

    at_end = kept([{address: end} for address, _, end in sides])
    open_sides = [side for side, good in zip(sides, at_end, strict=True) if not good]
    for _ in range(math.ceil(-math.log2(table.precision))):
        middles = [(start + end) / 2 for _, start, end in open_sides]
        points: list[Point] = [
            {side[0]: middle} for side, middle in zip(open_sides, middles, strict=True)
        ]
        open_sides = [
            (address, middle, end) if good else (address, start, middle)
            for (address, start, end), middle, good in zip(
                open_sides, middles, kept(points), strict=True
            )
        ]
    return "all values are bracketed"
