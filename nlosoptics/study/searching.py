"""Run of a search: its method asks for points, which are computed once and kept in the store."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from .._progress import Progress
from ..errors import SceneError
from .blocks import order
from .design.study import Study
from .design.values import label
from .design.variables import delta_of
from .engine import Engine, computed
from .gradients import Gradients
from .search.methods import dependences_of, most_trials, outcome_of, search, searched_figures
from .search.problem import Array, Outcome, Point
from .store import Store
from .worker import Answers, Block

SPARE = 64  # blocks for further points; all arrays grow at once, which takes as long as a trial


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
        Engine that computes blocks. It is closed at the end.
    progress : callable
        Called with a text and the completed fraction, 0 to 1.
    interrupted : callable
        Asked between blocks whether to end.

    Notes
    -----
    Methods keep no state of their own in the store. A resumed search begins anew, gets the kept
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
        self._progress, self._interrupted = progress, interrupted
        self._kept = [json.dumps(delta) for delta in study.dimensions[0].deltas]
        self._asked: dict[str, Outcome] = {}  # by the JSON of their values, in order
        self._figures: dict[str, dict[str, float]] = {}  # by point
        self._names = searched_figures(study)
        self._gradients = Gradients(study)
        self._slopes_of: dict[str, Array] = {}  # by the JSON of the values
        self._by: dict[str, dict[str, None]] = {"computed": {}, "by differences": {}}
        self._queue: deque[Block] = deque()
        self._free = range(0)  # rows of the store for further points
        self._stream = computed(engine, self._waiting(), interrupted)
        self._start, self._new = time.perf_counter(), 0

    def __enter__(self) -> Trials:
        """Return this object."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the workers."""
        close: Any = self._stream
        close.close()
        self._engine.close()

    def run(self, blocks: Sequence[Block]) -> None:
        """Compute open blocks of kept trials, and search until the method ends or is interrupted.

        Parameters
        ----------
        blocks : sequence of Block
            Blocks of kept trials that lack figures.
        """
        self._progress("search", 0.0)
        try:
            self._compute(blocks)
            self._recall()
            why = search(self._study, self._ask, self._slopes)
        except _Ended as ended:
            why = str(ended)
        if why:
            self._store.set_ended(why + self._about_gradients())

    def _ask(self, points: Sequence[Point]) -> list[Outcome]:
        """Return the outcomes of points, of which new ones are computed together."""
        deltas = [delta_of(self._study.variables, point) for point in points]
        keys = [json.dumps(delta) for delta in deltas]
        new = {k: d for k, d in zip(keys, deltas, strict=True) if k not in self._asked}
        most = most_trials(self._study)
        allowed = dict(list(new.items())[: most - len(self._asked)])
        if allowed:
            self._add(allowed)
        if len(allowed) < len(new):
            raise _Ended(f"{most} evaluations")
        return [self._asked[key] for key in keys]

    def _slopes(self, point: Point) -> Array:
        """Return the derivatives of objective and margins at a point that was asked for.

        Rows of figures without derivatives are NaN. Derivatives are computed here and are not
        stored, since a replay computes them again from the same values.
        """
        delta = delta_of(self._study.variables, point)
        key = json.dumps(delta)
        if key not in self._slopes_of:
            self._slopes_of[key] = self._derived(self._study.with_trials([delta]))
        return self._slopes_of[key]

    def _derived(self, study: Study) -> Array:
        """Return the derivatives of the objective and the margins of a trial, see `_slopes`."""
        points = [self._figures[name] for name in study.ids]
        rows = dependences_of(study, self._columns(points))
        found = np.zeros((len(rows), len(study.variables)))
        for i in range(len(study)):
            names = {name: None for name, slopes in rows if slopes[i] != 0.0}
            known = self._gradients.at(study.delta(i), names)
            for name in names:
                self._by["computed" if name in known else "by differences"][name] = None
            for row, (name, slopes) in zip(found, rows, strict=True):
                if slopes[i] != 0.0:
                    row += slopes[i] * known.get(name, np.full(len(row), np.nan))
        return found

    def _add(self, new: Mapping[str, Mapping[str, Any]]) -> None:
        first = len(self._asked)
        fresh = list(new)[max(0, len(self._kept) - first) :]
        for (key, delta), kept in zip(new.items(), self._kept[first:], strict=False):
            if key != kept:
                told = ", ".join(f"{a} = {label(v)}" for a, v in json.loads(kept).items())
                here = ", ".join(f"{a} = {label(v)}" for a, v in delta.items())
                raise SceneError(
                    f"{self._store.path}: the search would choose {here}, but the store has "
                    f"{told}; another version or machine wrote it, use that or another folder"
                )
        study = self._study.with_trials(new.values())
        if fresh:
            if self._interrupted():
                raise _Ended("")
            if self._store.ended:  # the search has become longer
                self._store.set_ended("")
            self._store.add_trials(max(first, len(self._kept)), [new[key] for key in fresh])
            self._compute(self._rows(self._study.with_trials(new[key] for key in fresh)))
        size = len(study) // len(new)
        for i, key in enumerate(new):
            points = [self._figures[name] for name in study.ids[i * size : (i + 1) * size]]
            self._asked[key] = outcome_of(study, self._columns(points))
        if fresh:
            self._tell(len(fresh))

    def _columns(self, points: Sequence[Mapping[str, float]]) -> dict[str, Array]:
        return {name: np.array([point[name] for point in points]) for name in self._names}

    def _about_gradients(self) -> str:
        """Return how the gradients were found; empty if the method uses none."""
        parts = [f"of {', '.join(names)} {how}" for how, names in self._by.items() if names]
        return f"; gradients {', '.join(parts)}" if parts else ""

    def _rows(self, study: Study) -> list[Block]:
        """Add rows for the points of a study to the store; return their blocks."""
        points, step = order(study), self._store.block
        names = [study.ids[i] for i in points]
        if len(self._free) < len(names):
            self._free = self._store.add(names, (), SPARE * step)
        else:
            self._store.place(self._free.start, names)
        first, used = self._free.start, -(-len(names) // step) * step
        self._free = self._free[used:]
        figures = tuple(figure.name for figure in study.figures)
        blocks = []
        for start in range(0, len(points), step):
            own = points[start : start + step]
            deltas = tuple(study.delta(i) for i in own)
            ids = tuple(study.ids[i] for i in own)
            blocks.append(Block(first + start, deltas, ids, figures))
        return blocks

    def _compute(self, blocks: Sequence[Block]) -> None:
        self._queue.extend(blocks)
        for _ in blocks:
            try:
                block, answers = next(self._stream)
            except StopIteration:
                raise _Ended("") from None
            self._store.write(block, answers)
            self._remember(block, answers)

    def _remember(self, block: Block, answers: Answers) -> None:
        for name, row in zip(block.ids, answers.values, strict=True):
            self._figures.setdefault(name, {}).update(zip(block.figures, row, strict=True))

    def _recall(self) -> None:
        """Read the figures of kept trials."""
        columns = {name: self._store.column(name) for name in self._names}
        for row, name in enumerate(self._store.ids()):
            if name:
                self._figures[name] = {
                    figure: float(column[row])
                    for figure, column in columns.items()
                    if column is not None
                }

    def _waiting(self) -> Iterator[Block | None]:
        while True:
            yield self._queue.popleft() if self._queue else None

    def _tell(self, new: int) -> None:
        self._new += new
        done, most = len(self._asked), most_trials(self._study)
        rate = self._new / (time.perf_counter() - self._start)
        feasible = sum(outcome.feasible for outcome in self._asked.values())
        told = f"{done} of {most} trials, {feasible} feasible, {rate:.3g}/s"
        self._progress(told, min(1.0, done / most))
