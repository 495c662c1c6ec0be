"""Run of a study: which points are open, in which blocks, and their results into the store."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import path_of, whole
from .._progress import Progress
from ..errors import SceneError
from ..runs.record import versions
from .design.point import point_spread_key
from .design.study import Study, differing_steps
from .engine import Cluster, Engine, InProcess, Processes, computed
from .planning import plan_study
from .results import Results, about_study, study_of
from .store import Store, only_writer, reading
from .worker import DONE, FAILED, LOST, Block


def run_study(
    study: Study,
    path: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    again: bool = False,
    progress: Progress | None = None,
    interrupted: Callable[[], bool] | None = None,
) -> Results:
    """Compute all points that a store does not have yet, and return the results.

    Parameters
    ----------
    study : Study
        Study to run.
    path : str or Path
        Folder of the store. An existing store of this study is resumed. If the study has more
        values, draws or figures than the store, the store is extended.
    workers : int, optional
        Processes on this machine, by default one for each core; 0 computes in this process. A
        script that starts processes needs ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://host:8786", whose workers replace ``workers``.
    again : bool, default False
        Whether to compute blocks with failed or lost points again, for example after a function of
        yours was corrected.
    progress : callable(str, float), optional
        Called with a text and the completed fraction, 0 to 1.
    interrupted : callable, optional
        Function without arguments, called between blocks. If it returns True, the study ends after
        the blocks that are being computed.

    Returns
    -------
    Results
        Results; incomplete if interrupted. Points that fail are part of it, with a message.

    Raises
    ------
    SceneError
        If the store belongs to another base scene or design, cannot be written, or is in use.

    See Also
    --------
    plan_study : Predict points, shared stages, time and size.
    Results : Results of a study.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics.study import Study, run_study
    >>> study = Study.from_tables(
    ...     {
    ...         "scene": "examples/scenes/letter_flat.toml",
    ...         "figures": ["aberration_rms"],
    ...         "axes": {"camera.focus_distance": ["2 m", "1.9 m"]},
    ...     }
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     results = run_study(study, folder + "/focus.zarr", workers=0)
    >>> results.dataset["aberration_rms"].values.round(3)
    array([0.429, 1.367])
    """
    path = path_of("path", path)
    tell, stop = progress or (lambda text, share: None), interrupted or (lambda: False)
    count = os.cpu_count() or 1 if workers is None else whole("workers", workers, 0)
    with only_writer(path):
        with reading(path):
            store = prepared(study, path)
            blocks = open_blocks(study, store, again)
        total = sum(len(block.ids) for block in blocks)
        if total:
            engine = _engine(study, min(count, len(blocks)) if count else 0, scheduler)
            try:
                _fill(store, engine, blocks, total, tell, stop)
            finally:
                engine.close()
    return Results.load(path)


def _engine(study: Study, workers: int, scheduler: str | None) -> Engine:
    if scheduler is not None:
        return Cluster(study, scheduler)
    return Processes(study, workers) if workers else InProcess(study)


def _fill(
    store: Store,
    engine: Engine,
    blocks: list[Block],
    total: int,
    progress: Progress,
    interrupted: Callable[[], bool],
) -> None:
    """Compute blocks and write them as they are finished."""
    start, done = time.perf_counter(), 0
    progress(f"0 of {total} points", 0.0)
    for block, answers in computed(engine, iter(blocks), interrupted):
        store.write(block, answers)
        done += len(block.ids)
        rate = done / (time.perf_counter() - start)
        left = (total - done) / rate
        progress(f"{done} of {total} points, {rate:.3g}/s, {left:.0f} s left", done / total)


def prepared(study: Study, path: Path) -> Store:
    """Open or create the store of a study, with a row for every point.

    Raises
    ------
    SceneError
        If the store belongs to another base scene or design. The message names the difference.
    """
    store = Store.open(path, write=True)
    about: dict[str, Any] = about_study(study) | {"versions": versions()}
    if store is None:
        block = plan_study(study).block
        store = Store.create(path, block=block, about=about, files=study.base.files)
        kept = study
    else:
        kept = study_of(store)
        _check_same(study, kept, path)
        store.add_files(study.base.files)
    names = {figure.name for figure in study.figures}
    figures = (*(f for f in kept.figures if f.name not in names), *study.figures)
    known = set(store.ids())
    store.add([study.ids[i] for i in _order(study) if study.ids[i] not in known], figures)
    store.set_about(about | {"figures": about_study(study, figures)["figures"]})
    return store


def _check_same(study: Study, kept: Study, path: Path) -> None:
    """Raise `SceneError` if a study does not continue the one of a store."""
    differences = study.base.differences(kept.base)
    for name in ("tol", "seed"):
        if getattr(study, name) != getattr(kept, name):
            differences.append(f"{name} = {getattr(study, name)} instead of {getattr(kept, name)}")
    for new in study.figures:
        for old in kept.figures:
            if new.name == old.name and (new.source, new.options) != (old.source, old.options):
                differences.append(
                    f"figure {new.name} is {new.source} {new.options} instead of {old.source} "
                    f"{old.options}"
                )
    if not differences and set(kept.ids) - set(study.ids):
        differences = list(differing_steps(study, kept))
    if differences:
        more = f" (and {len(differences) - 1} more)" if len(differences) > 1 else ""
        raise SceneError(
            f"{path} has the results of another study: {differences[0]}{more}; restore that, or "
            "name another folder"
        )


def _order(study: Study) -> list[int]:
    """Return the points in the order of computation: those with the same point spread together."""
    groups: dict[str, list[int]] = {}
    for index in range(len(study)):
        groups.setdefault(point_spread_key(study.delta(index)), []).append(index)
    return [index for group in groups.values() for index in group]


def open_blocks(study: Study, store: Store, again: bool) -> list[Block]:
    """Return the blocks of a store that lack figures, with these figures.

    With ``again`` they include blocks in which a figure failed or was lost.
    """
    index = {name: i for i, name in enumerate(study.ids)}
    ids = store.ids()
    finished = [DONE] if again else [DONE, FAILED, LOST]
    lacking = {figure.name: ~np.isin(store.statuses(figure), finished) for figure in study.figures}

    def blocks() -> Iterator[Block]:
        for first in range(0, len(ids), store.block):
            rows = range(first, min(first + store.block, len(ids)))
            used = [row for row in rows if ids[row] in index]
            # points of a block are at its start; other rows are empty
            missing = tuple(
                name for name, open_rows in lacking.items() if any(open_rows[row] for row in used)
            )
            if missing:
                deltas = tuple(study.delta(index[ids[row]]) for row in used)
                yield Block(first, deltas, tuple(ids[row] for row in used), missing)

    return list(blocks())
