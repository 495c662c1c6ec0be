"""Derivatives of figures of merit along the variables of a search, without further trials."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..errors import NlosError
from ..psf import SceneOptics
from ..psf.pupil.scene_optics import PointOptics
from .design.fast import OF_WAVES, has_gradient
from .design.figures import Figure
from .design.point import NOT_IN_POINT_SPREAD, StudyPoint, stage_caches
from .design.study import Study
from .design.values import canonical, number, with_unit
from .design.variables import Variable
from .fast import FEW_NODES, MOST_NODES, resolving_nodes, unfit
from .fast_figures import fast_figure

Array = NDArray[np.float64]
#: Distance of neighbouring scenes, relative to the range of the variable. Derivatives err by 1e-7
#: of the largest one, and by up to 3e-8 (waves, Strehl ratio) because of rounding.
STEP: Final = 1e-5
#: Steps and their weights in a derivative of second order: inside, at the low and the high limit.
INSIDE: Final = ((-1, -0.5), (1, 0.5))
AT_LOW: Final = ((0, -1.5), (1, 2.0), (2, -0.5))
AT_HIGH: Final = ((0, 1.5), (-1, -2.0), (-2, 0.5))

Delta = Mapping[str, Any]


class _Unknown(Exception):
    """The figure has no derivative that follows from neighbouring waves."""


class Gradients:
    """Derivatives of figures at the points of a study along the coordinates of its variables.

    Parameters
    ----------
    study : Study
        Study with the table ``optimise``.

    Notes
    -----
    The wave at a point and those of two neighbours along each variable are traced. They give the
    Strehl ratio, the rms aberration and the ray spot with fixed quadrature nodes, so that these are
    smooth to rounding error and a difference over 1e-5 of the range is a derivative. No point
    spread is computed. Aiming takes about a fifth of the time of a wave with its figure, so that
    the explicit derivative of stationary paths, which needs one aimed wave only, would save little.
    """

    def __init__(self, study: Study) -> None:
        self._study = study

    def at(self, delta: Delta, names: Iterable[str]) -> dict[str, Array]:
        """Return the derivatives (variables,) of figures at a point, per unit of coordinate.

        Parameters
        ----------
        delta : mapping
            Values by address of the point.
        names : iterable of str
            Figures.

        Returns
        -------
        dict of str to (n,) ndarray
            Derivatives by figure. A figure is missing if they do not follow from waves next to the
            point.
        """
        waves: dict[str, PointOptics] = {}
        found = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the trial itself has told them
            for name in names:
                figure = self._study.figure(name)
                try:
                    if has_gradient(figure):
                        found[name] = self._gradient(figure, delta, waves)
                except (NlosError, _Unknown):
                    continue
        return found

    def _gradient(self, figure: Figure, delta: Delta, waves: dict[str, PointOptics]) -> Array:
        by_wave = figure.source in OF_WAVES
        deltas: list[Delta] = [delta]
        weights = []  # of the values at deltas, for each variable
        for variable in self._study.variables:
            own = {}
            if not (by_wave and variable.address.startswith(NOT_IN_POINT_SPREAD)):
                for there, weight in _neighbours(variable, delta):
                    own[len(deltas)] = weight / STEP
                    deltas.append(there)
            weights.append(own)
        values = (
            self._of_waves(figure, deltas, waves) if by_wave else self._of_scenes(figure, deltas)
        )
        return np.array([sum(w * values[i] for i, w in own.items()) for own in weights])

    def _of_scenes(self, figure: Figure, deltas: Sequence[Delta]) -> Array:
        study, caches = self._study, stage_caches()
        points = [StudyPoint(study.base, there, 0, study.tol, caches) for there in deltas]
        return np.array([figure.value(point, study.folder)[0] for point in points])

    def _of_waves(
        self, figure: Figure, deltas: Sequence[Delta], waves: dict[str, PointOptics]
    ) -> Array:
        seen = [self._wave(there, waves) for there in deltas]
        fast = fast_figure(figure.source, figure.options, seen)
        n = FEW_NODES
        if fast.uses_nodes:
            phase = fast.fields(seen[0], n)["phase"]
            n = resolving_nodes(2 * math.pi * float(np.ptp(phase, axis=(-2, -1)).max()))
        if n > MOST_NODES:
            raise _Unknown
        fields = [fast.fields(one, n) for one in seen]
        stacked = {name: np.stack([one[name] for one in fields]) for name in fields[0]}
        return fast.values(stacked)

    def _wave(self, delta: Delta, waves: dict[str, PointOptics]) -> PointOptics:
        key = repr(delta)
        if key not in waves:
            optics = SceneOptics(self._study.base.scene(delta))
            if unfit(optics):
                raise _Unknown
            waves[key] = optics.reference
        return waves[key]


def _neighbours(variable: Variable, delta: Delta) -> Iterable[tuple[Delta, float]]:
    """Yield points next to a point along a variable, within its limits, with their weights."""
    found = number(delta[variable.address])
    if found is None:
        raise _Unknown
    value, step = found[0], STEP * variable.rate(found[0])
    pattern: tuple[tuple[int, float], ...] = INSIDE
    if value - step < variable.low:
        pattern = AT_LOW
    elif value + step > variable.high:
        pattern = AT_HIGH
    for steps, weight in pattern:
        there = canonical(with_unit(value + steps * step, variable.unit))
        yield {**delta, variable.address: there}, weight
