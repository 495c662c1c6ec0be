"""Compensators: values that are adjusted at a point for the best figure, such as the focus."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use

from .file import Limits
from .point import StudyPoint
from .variables import delta_of, variable

PRECISION = 1e-4  # of a compensator's value, relative to its range


def adjusted(
    point: StudyPoint, variables: Mapping[str, Mapping[str, Any]], cost: Callable[[StudyPoint], Any]
) -> StudyPoint:
    """Return the best of the points that a search tries; the given one is among them.

    One value is searched between its limits by Brent's method. Several values start at those of
    the point and follow the simplex of Nelder and Mead.
    """
    chosen = tuple(
        variable(address, address, Limits(**limits), point.value(address), point.base)
        for address, limits in variables.items()
    )
    best = (math.inf, point)

    def tried(there: StudyPoint) -> float:
        nonlocal best
        try:
            value = float(cost(there))
        except Exception:  # a function of the user's may raise any
            return math.inf
        if value < best[0]:
            best = (value, there)
        return value

    def at(coordinates: Any) -> float:
        values = dict(zip((v.address for v in chosen), np.atleast_1d(coordinates), strict=True))
        return tried(point.changed(delta_of(chosen, values)))

    tried(point)
    if len(chosen) == 1:
        scipy.optimize.minimize_scalar(
            at, bounds=(0.0, 1.0), method="bounded", options={"xatol": PRECISION}
        )
        return best[1]
    start = np.array([v.start for v in chosen])
    inward = np.where(start <= 0.5, 0.1, -0.1)
    scipy.optimize.minimize(
        at,
        start,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * len(chosen),
        options={
            "initial_simplex": start + np.vstack([np.zeros(len(chosen)), np.diag(inward)]),
            "xatol": PRECISION,
            "fatol": math.inf,
            "maxfev": 200,
        },
    )
    return best[1]
