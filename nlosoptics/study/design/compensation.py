"""Compensators: values that are adjusted at a point for the best figure, such as the focus."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use
from numpy.typing import NDArray

from .file import Limits
from .point import StudyPoint
from .variables import delta_of, variable

PRECISION = 1e-4  # of a compensator's value, relative to its range
FIRST_STEP = 0.1  # of the range
MOST = 200  # evaluations of one compensation


def adjusted(
    point: StudyPoint, variables: Mapping[str, Mapping[str, Any]], cost: Callable[[StudyPoint], Any]
) -> StudyPoint:
    """Return the best of the points that a local search tries; the given one is among them.

    Parameters
    ----------
    point : StudyPoint
        Point before compensation.
    variables : mapping
        Limits by address, as the table of a study file.
    cost : callable
        Number to minimise at a point; any exception says that it has no value there.

    Notes
    -----
    The simplex of Nelder and Mead needs no derivatives and serves one to three compensators.
    COBYQA would not do: scipy runs it in one place at a time, so that a search by COBYQA could not
    adjust its points.
    """
    chosen = tuple(
        variable(address, address, Limits(**limits), point.value(address), point.base)
        for address, limits in variables.items()
    )
    best = (math.inf, point)

    def tried(there: StudyPoint) -> float:
        nonlocal best
        try:
            found = float(cost(there))
        except Exception:  # a function of the user's may raise any
            return math.inf
        if found < best[0]:
            best = (found, there)
        return found

    def at(coordinates: NDArray[np.float64]) -> float:
        given = zip((one.address for one in chosen), coordinates, strict=True)
        return tried(point.changed(delta_of(chosen, dict(given))))

    tried(point)
    start = np.array([one.start for one in chosen])
    inward = np.where(start <= 0.5, FIRST_STEP, -FIRST_STEP)
    scipy.optimize.minimize(
        at,
        start,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * len(chosen),
        options={
            "initial_simplex": start + np.vstack([np.zeros(len(chosen)), np.diag(inward)]),
            "xatol": PRECISION,
            "fatol": math.inf,
            "maxfev": MOST,
        },
    )
    return best[1]
