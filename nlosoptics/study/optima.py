"""Answers of searches: the best trials, Pareto fronts, and inverse sensitivities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, expect, whole
from .._nouns import Noun
from ..errors import SceneError
from .design.figures import Figure
from .design.file import Objective
from .design.values import label
from .results import Results
from .search.methods import search_table, searched_figures
from .search.problem import Outcome, outcome

if TYPE_CHECKING:
    from ..scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Optimum(Noun):
    """Trials of an optimisation and the best of them, as returned by `optimum`.

    A trial is one set of values of the optimisation's variables. An objective is a figure of merit
    that is minimised or maximised.

    Parameters
    ----------
    results : Results
        Results of the study.
    labels : tuple of str
        Name and unit of each objective.
    goals : tuple of str
        "minimise" or "maximise", for each objective.
    objectives : ndarray, (trials, objectives)
        Values of the objectives in all trials; NaN where the computation failed. The unit is that
        of the figure of merit. For an objective with limits, the value is instead the yield,
        without unit: the fraction of the trial's points (its random draws and steps along axes)
        that lie within the limits.
    feasible : ndarray of bool, (trials,)
        Whether all figures of merit could be computed and all constraints are met.
    failed : ndarray of bool, (trials,)
        Whether a figure of merit could not be computed, for example because the scene is invalid.
    front : tuple of int
        Numbers of the best trials, counted from 0 (the Pareto front). A feasible trial belongs to
        the front if no other one is at least as good in all objectives and better in one. With a
        single objective this is the best trial. The front is sorted by the first objective, and of
        equal trials only one is listed. Empty if no trial is feasible.

    See Also
    --------
    optimum : Best trials of an optimisation.
    nlosoptics.views.search : Picture of the trials.
    """

    results: Results
    labels: tuple[str, ...]
    goals: tuple[str, ...]
    objectives: NDArray[np.float64]
    feasible: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    front: tuple[int, ...]

    @property
    def best(self) -> int:
        """Number of the best trial, counted from 0, for a study with a single objective.

        Raises
        ------
        SceneError
            If no trial is feasible, or there are several objectives.
        """
        if len(self.labels) > 1:
            raise SceneError(
                f"there are {len(self.labels)} objectives, so that no trial is the best; choose "
                "one of front"
            )
        if not self.front:
            raise SceneError(f"{self.results.path}: {self._none_feasible()}")
        return self.front[0]

    def values(self, trial: int | None = None) -> dict[str, Any]:
        """Return the values of the variables in a trial.

        The keys of the dict are addresses (table and key of the scene file), such as
        "camera.f_number". The values are written as in a scene file.

        Parameters
        ----------
        trial : int, optional
            Number of the trial; `best` by default.
        """
        trials = self.results.study.dimensions[0].deltas
        chosen = self.best if trial is None else whole("trial", trial, 0, len(trials) - 1)
        return dict(trials[chosen])

    def scene(self, trial: int | None = None) -> Scene:
        """Return the scene of a trial.

        Values that random draws or axes of the study change have their nominal values.

        Parameters
        ----------
        trial : int, optional
            Number of the trial; `best` by default.
        """
        return self.results.study.base.scene(self.values(trial))

    def __str__(self) -> str:
        """Return how many trials are feasible, and the best ones with their values."""
        n, met, failed = len(self.feasible), int(self.feasible.sum()), int(self.failed.sum())
        state = self.results.dataset.attrs["search"]
        head = f"search: {state}; {counted(n, 'trial')}, {met} feasible, {failed} failed"
        if not self.front:
            return f"{head}\n{self._none_feasible()}"
        return "\n".join([head, *(self._line(trial) for trial in self.front)])

    def _line(self, trial: int) -> str:
        found = [
            f"{label.partition(' (')[0]} {value:.6g}"
            for label, value in zip(self.labels, self.objectives[trial], strict=True)
        ]
        values = [f"{address} = {label(value)}" for address, value in self.values(trial).items()]
        return f"trial {trial}: {', '.join(found)}: {', '.join(values)}"

    def _none_feasible(self) -> str:
        why = self.results.failures()
        told = f"; {max(why, key=lambda text: why[text])}" if why else ""
        return f"no trial is feasible{told}; widen the limits or loosen the constraints"


def optimum(results: Results, *, incomplete: bool = False) -> Optimum:
    """Return the best trials of an optimisation: one, or the Pareto front of several objectives.

    A trial is one set of values of the optimisation's variables. It is feasible if all its figures
    of merit could be computed and all constraints of the study are met. Only feasible trials can be
    the best.

    Parameters
    ----------
    results : Results
        Results of a study with the table ``optimise``.
    incomplete : bool
        Whether to accept an optimisation that has not ended. A trial whose computation is not
        complete then counts as not feasible.

    Returns
    -------
    Optimum
        All trials with the values of their objectives, and the numbers of the best ones: one trial,
        or those of the Pareto front if there are several objectives.

    Raises
    ------
    SceneError
        If the study has no such table, or has not ended.

    See Also
    --------
    run_study : Run a study, or continue it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics.study import Study, optimum, run_study
    >>> study = Study.from_tables(
    ...     {
    ...         "scene": "examples/scenes/letter_flat.toml",
    ...         "figures": ["aberration_rms"],
    ...         "optimise": {
    ...             "method": "cobyqa",
    ...             "evaluations": 40,
    ...             "objectives": [{"figure": "aberration_rms", "goal": "minimise"}],
    ...             "variables": {"camera.focus_distance": {"from": "1.5 m", "to": "3 m"}},
    ...         },
    ...     }
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     found = optimum(run_study(study, folder + "/focus.zarr", workers=0))
    >>> round(found.scene().camera.focus_distance, 3)
    2.049
    """
    results = expect("results", results, "Results")
    table = search_table(results.study)
    outcomes = _outcomes(results, incomplete)
    signs = np.array([1.0 if one.goal == "minimise" else -1.0 for one in table.objectives])
    values = np.array([one.values for one in outcomes]).reshape(-1, len(table.objectives))
    feasible = np.array([one.feasible for one in outcomes], dtype=bool)
    study = results.study
    several = len(study.dimensions) > 1
    return Optimum(
        results=results,
        labels=tuple(_label(one, study.figure(one.figure), several) for one in table.objectives),
        goals=tuple(one.goal for one in table.objectives),
        objectives=signs * values + 0.0,  # -0.0 becomes 0.0
        feasible=feasible,
        failed=np.array([one.failed for one in outcomes], dtype=bool),
        front=_front(values, feasible),
    )


def _outcomes(results: Results, incomplete: bool) -> list[Outcome]:
    """Return the outcome of each trial."""
    study = results.study
    trials = len(study.dimensions[0].deltas)
    columns = {
        name: results.values(name, incomplete=incomplete).reshape(trials, -1)
        for name in searched_figures(study)
    }
    pending = (results.dataset["status"].values == "pending").reshape(trials, -1).any(axis=1)
    outcomes = []
    for trial in range(trials):
        rows = {name: column[trial] for name, column in columns.items()}
        if pending[trial]:
            rows = {name: np.full_like(row, np.nan) for name, row in rows.items()}
        outcomes.append(outcome(search_table(study), rows))
    return outcomes


def _front(values: NDArray[np.float64], feasible: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the feasible rows, (n, objectives), that no other dominates, each value once."""
    rows = np.flatnonzero(feasible)
    rows = rows[np.lexsort((rows, *values[rows].T[::-1]))]
    kept: list[int] = []
    for row in rows:  # sorted, so that only rows before it may dominate it
        if not any((values[other] <= values[row]).all() for other in kept):
            kept.append(int(row))
    return tuple(kept)


def _label(objective: Objective, figure: Figure, several: bool) -> str:
    """Return the name of an objective with its unit; ``several`` points may make a trial."""
    limits = [f"at least {objective.at_least:g}"] if objective.at_least is not None else []
    limits += [f"at most {objective.at_most:g}"] if objective.at_most is not None else []
    if limits:
        return f"share of {figure.name} {' and '.join(limits)}"
    over = f"{objective.over} " if several and figure.source != "value" else ""
    return f"{over}{figure.name}" + (f" ({figure.unit})" if figure.unit else "")
