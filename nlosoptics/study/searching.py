"""Run of a search: its method asks for points, which are computed once and kept in the store."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .._progress import Progress
from ..errors import SceneError
from .blocks import open_blocks, order
from .design.study import Study
from .design.values import label
from .design.variables import delta_of
from .engine import Engine
from .planning import plan_study
from .search.methods import search, search_table, searched_figures
from .search.problem import Outcome, Point, outcome
from .store import Store


class _Ended(Exception):
    """Search stopped from within, because of its length or an interruption."""


class Trials:
    """Trials of a search: a replay of those in the store, then new ones.

    Parameters
    ----------
    study : Study
        Study with the trials of its store.
    store : Store
        Store with a row for each of their points.
    engine : Engine
        Engine that computes blocks.
    progress : callable
        Called with a text and the completed fraction, 0 to 1.
    interrupted : callable
        Asked between blocks whether to end.

    Notes
    -----
    Methods keep no state of their own in the store. A resumed search begins anew, gets the stored
    figures of its first trials, and so repeats its choices up to the first new one.
    """

    def __init__(
        self,
        study: Study,
        store: Store,
        engine: Engine,
        progress: Progress,
        interrupted: Callable[[], bool],
    ) -> None:
        self._study, self._store, self._engine = study, store, engine
        self._block = plan_study(study).block
        self._progress, self._interrupted = progress, interrupted
        self._stored = [json.dumps(delta) for delta in study.dimensions[0].deltas]
        self._outcomes: dict[str, Outcome] = {}  # by the JSON of their values, in order
        self._rows = {name: row for row, name in enumerate(store.ids)}
        self._most = search_table(study).evaluations
        self._start, self._new = time.perf_counter(), 0

    def run(self) -> None:
        """Search until the method ends or is interrupted."""
        self._progress("search", 0.0)
        try:
            self._compute(self._study)
            why = search(self._study, self._ask)
        except _Ended as ended:
            why = str(ended)
        if why:
            self._store.set_ended(why)

    def _ask(self, points: Sequence[Point]) -> list[Outcome]:
        """Return the outcomes of points, of which new ones are computed together."""
        deltas = [delta_of(self._study.variables, point) for point in points]
        keys = [json.dumps(delta) for delta in deltas]
        new = {k: d for k, d in zip(keys, deltas, strict=True) if k not in self._outcomes}
        allowed = dict(list(new.items())[: self._most - len(self._outcomes)])
        if allowed:
            self._add(allowed)
        if len(allowed) < len(new):
            raise _Ended(f"{self._most} evaluations")
        return [self._outcomes[key] for key in keys]

    def _add(self, new: Mapping[str, Mapping[str, Any]]) -> None:
        """Compute the outcomes of trials, by the JSON of their values, unless they are stored."""
        first = len(self._outcomes)
        for (key, delta), stored in zip(new.items(), self._stored[first:], strict=False):
            if key != stored:
                known = ", ".join(f"{a} = {label(v)}" for a, v in json.loads(stored).items())
                here = ", ".join(f"{a} = {label(v)}" for a, v in delta.items())
                raise SceneError(
                    f"{self._store.path}: the search would choose {here}, but the store has "
                    f"{known}; another version or machine wrote it, use that or another folder"
                )
        study = self._study.with_trials(new.values())
        fresh = [new[key] for key in list(new)[max(0, len(self._stored) - first) :]]
        if fresh:
            if self._interrupted():
                raise _Ended("")
            if self._store.ended:  # the search has become longer
                self._store.set_ended("")
            self._store.add_trials(fresh)
            self._compute(self._study.with_trials(fresh))
        names = searched_figures(study)
        values = self._store.column("value", names)
        size = len(study) // len(new)
        for i, key in enumerate(new):
            rows = [self._rows[name] for name in study.ids[i * size : (i + 1) * size]]
            figures = dict(zip(names, values[rows].T, strict=True))
            self._outcomes[key] = outcome(search_table(study), figures)
        if fresh:
            self._tell(len(fresh))

    def _compute(self, study: Study) -> None:
        """Compute what the store lacks of the points of some trials."""
        names = [study.ids[i] for i in order(study) if study.ids[i] not in self._rows]
        self._rows |= {name: len(self._rows) + i for i, name in enumerate(names)}
        self._store.add(names)
        blocks = open_blocks(study, self._store, self._block)
        for block, answers in self._engine.compute(iter(blocks), self._interrupted):
            self._store.write(block, answers)
        if open_blocks(study, self._store, self._block):
            raise _Ended("")

    def _tell(self, new: int) -> None:
        self._new += new
        done = len(self._outcomes)
        rate = self._new / (time.perf_counter() - self._start)
        feasible = sum(outcome.feasible for outcome in self._outcomes.values())
        text = f"{done} of {self._most} trials, {feasible} feasible, {rate:.3g}/s"
        self._progress(text, min(1.0, done / self._most))
