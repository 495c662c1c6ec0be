"""Search as its methods see it: coordinates of points in, objectives and margins out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..design.file import Constraint, Objective, Optimise, Within
from ..design.variables import Variable

Array = NDArray[np.float64]
#: Coordinates by address; addresses that are absent keep the scene's own value.
Point = Mapping[str, float]
FEASIBLE = 1e-6  # part of a limit by which a constraint may be missed, as solvers end on limits
WORSE = 1e100  # above all objectives


class Outcome(NamedTuple):
    """Result of one point of a search.

    ``values`` are the objectives, the smaller the better, NaN where a figure failed. ``margins``
    are the distances from the constraints' limits as parts of the limits, negative where a
    constraint is not met.
    """

    values: tuple[float, ...]
    margins: tuple[float, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether a figure failed, for example because the scene was refused."""
        return not all(map(math.isfinite, (*self.values, *self.margins)))

    @property
    def feasible(self) -> bool:
        """Whether all figures are known and all constraints are met."""
        return not self.failed and all(margin >= -FEASIBLE for margin in self.margins)

    @property
    def ranks(self) -> tuple[float, ...]:
        """Objectives for methods that only compare: what is infeasible comes after all else.

        Infeasible points are ordered by the sum of their violations, and failed ones come last.
        """
        if self.failed:
            return (math.inf,) * len(self.values)
        if self.feasible:
            return self.values
        violation = sum(max(0.0, -margin) for margin in self.margins)
        return (WORSE * (1.0 + violation),) * len(self.values)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Variables, objectives and length of a search.

    Parameters
    ----------
    variables : tuple of Variable
        Values to choose.
    objectives : int
        Number of objectives.
    evaluations : int
        Largest number of points.
    population : int
        Points that are chosen together.
    seed : int
        Seed of random choices.
    """

    variables: tuple[Variable, ...]
    objectives: int
    evaluations: int
    population: int
    seed: int

    @property
    def start(self) -> Array:
        """Coordinates of the first point, (n,)."""
        return np.array([variable.start for variable in self.variables])

    def point(self, coordinates: Sequence[float] | Array) -> Point:
        """Return coordinates by address."""
        addresses = (variable.address for variable in self.variables)
        return dict(zip(addresses, map(float, coordinates), strict=True))

    def rounded(self, coordinates: Array) -> Array:
        """Return coordinates (..., n) of the values that a scene gets, which have ten digits."""
        found = [
            variable.coordinate(variable.value(one))
            for row in coordinates.reshape(-1, len(self.variables))
            for variable, one in zip(self.variables, row, strict=True)
        ]
        return np.array(found, dtype=np.float64).reshape(coordinates.shape)


#: Returns the outcomes of points, which are computed together.
Ask = Callable[[Sequence[Point]], list[Outcome]]


def population(table: Optimise) -> int:
    """Return how many points a method chooses together: its default if the table gives none."""
    defaults = {"differential-evolution": max(5, 10 * len(table.variables)), "nsga-ii": 20}
    return table.population or defaults.get(table.method, 1)


def outcome(table: Optimise, figures: Mapping[str, Array]) -> Outcome:
    """Return objectives and margins of one trial."""
    return Outcome(
        tuple(_objective(one, figures[one.figure]) for one in table.objectives),
        tuple(_margin(one, figures[one.figure]) for one in table.constraints),
    )


def _objective(objective: Objective, values: Array) -> float:
    if objective.at_least is not None or objective.at_most is not None:
        return -float((_margins(objective, values) >= 0.0).mean())
    cost = values if objective.goal == "minimise" else -values
    return float(cost.max() if objective.over == "worst" else cost.mean())


def _margin(constraint: Constraint, values: Array) -> float:
    """Return the margin that the required share of points has; -inf if too many failed."""
    margins = np.sort(_margins(constraint, values))
    needed = math.ceil(constraint.share * len(margins) - FEASIBLE)
    return float(margins[len(margins) - max(1, needed)])


def _margins(limits: Within, values: Array) -> Array:
    """Return the distances from the nearer limit as parts of it, (points,)."""
    margins = np.full(len(values), np.inf)
    for limit, sign in ((limits.at_least, 1.0), (limits.at_most, -1.0)):
        if limit is not None:
            margins = np.minimum(margins, sign * (values - limit) / (abs(limit) or 1.0))
    return np.where(np.isnan(values), -np.inf, margins)
