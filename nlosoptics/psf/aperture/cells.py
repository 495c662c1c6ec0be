"""Connected parts of a pupil."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..._checks import in_range
from ..._nouns import Noun
from ..._vectors import Array
from ...errors import SceneError
from .curves import Curve, moments
from .polygons import Sides, sees_all, straight_sides

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Cell(Noun):
    """Connected part of a pupil, such as a ring or a mirror segment, over which the wave is smooth.

    Parameters
    ----------
    outline : tuple of Curve
        Lines and arcs that form closed loops: the outer edge counterclockwise, holes clockwise.
    sides : tuple of (Curve, Curve)
        Patches that together cover the cell. Each patch is given by two opposite curves A(t) and
        B(t), 0 <= t <= 1, and consists of the straight lines from A(t) to B(t).

    Attributes
    ----------
    area : float
        Area, m^2.
    centroid : (float, float)
        Centre of area, m.
    """

    outline: tuple[Curve, ...]
    sides: tuple[Sides, ...]
    area: float = field(init=False)
    centroid: Point = field(init=False)

    def __post_init__(self) -> None:
        area, x, y = moments(self.outline)
        object.__setattr__(self, "area", area)
        object.__setattr__(self, "centroid", (x / area, y / area))


def ring_cell(outer: Sequence[Curve], centre: Array, inner: float) -> Cell:
    """Cell between an outline and a similar one, ``inner`` times as large, about ``centre``."""
    if inner == 0:
        return Cell(tuple(outer), tuple((Curve.point(centre), c) for c in outer))
    holes = [c.scaled(inner, centre) for c in outer]
    outline = (*outer, *(c.part(1.0, 0.0) for c in holes))
    return Cell(outline, tuple(zip(holes, outer, strict=True)))


def polygon_cell(corners: Array, obscuration: float) -> Cell:
    """Cell of a simple counterclockwise polygon, with a similar hole if it is obscured."""
    outer = [Curve.line(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    area, x, y = moments(outer)
    centre = np.array([x / area, y / area])
    inner = in_range("obscuration", obscuration, 0.0, 0.99)
    if inner > 0:
        # Below 1e-9, rounding decides on which side of a line the centroid lies.
        if not sees_all(corners, centre, 1e-9):
            raise SceneError(
                f"obscuration = {inner:g} needs a polygon with every side visible from its "
                "centroid; give two polygons and their union"
            )
        return ring_cell(outer, centre, inner)
    return Cell(tuple(outer), tuple(straight_sides(corners, centre)))
