"""Run of a study: its open blocks, or those that its search asks for, go into the store."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from .._checks import expect, lasting, path_of, whole
from .._progress import Progress
from ..errors import SceneError
from .blocks import open_blocks, prepared
from .design.study import Study
from .engine import Cluster, Engine, connected
from .planning import plan_study
from .results import Results, results_at
from .searching import Trials
from .store import only_writer, reading


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
    """Run or continue a study: compute the points that are missing, and return all results.

    A point is a variant of the study's scene, at which the figures of merit are computed. A study
    with the table ``optimise`` is a search: it chooses each point by the figures of merit of
    earlier points. All points are stored, and the same seed leads to the same choices. A search
    that was stopped therefore continues with the next point.

    Parameters
    ----------
    study : Study
        Study to run.
    path : str or Path
        Folder for the results, also called the store. If it has results of this study, the run
        continues from them. If values, draws or figures of merit were added to the study since,
        only what is missing is computed.
    workers : int, optional
        Number of processes on this machine, by default one for each core. With 0 no process is
        started, and the calling process computes. A script that starts processes must be protected
        by ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://host:8786". Its workers then compute, and
        ``workers`` is not used.
    again : bool, default False
        Whether to repeat points that failed or whose process ended, for example after you corrected
        your own figure of merit.
    progress : callable(str, float), optional
        Function that is called with a text and the completed fraction, 0 to 1.
    interrupted : callable, optional
        Function without arguments that is called between blocks of points. If it returns True, the
        study ends after the blocks that are being computed.

    Returns
    -------
    Results
        All results in the folder; incomplete if the run was interrupted. Points whose computation
        failed are included, with a message.

    Raises
    ------
    SceneError
        If the folder has results of another base scene, or of values and draws that are no
        extension of the stored ones, cannot be written, or is in use.

    See Also
    --------
    plan_study : Predict number of points, time and size.
    Results : Results of a study.

    Examples
    --------
    Wave aberration, in wavelengths rms, for two focus distances:

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
    study = expect("study", study, "Study")
    given = path_of("path", path)
    path = Path(os.path.realpath(given))  # zarr replaces no folder behind a link
    tell, stop = progress or (lambda text, share: None), interrupted or (lambda: False)
    count = os.cpu_count() or 1 if workers is None else whole("workers", workers, 0)
    if again and study.variables:
        raise SceneError(
            "again does not go with a search, whose points depend on those that failed; use "
            "another folder"
        )
    if scheduler is not None and not path.exists():
        connected(scheduler).close()  # before a store is made
    with only_writer(path):
        with reading(path):
            store, study = prepared(study, path)
            blocks = open_blocks(study, store, plan_study(study).block, again=again)
        if not (blocks or study.variables):
            return results_at(given, study)
        if scheduler is not None:
            engine: Engine = Cluster(study, scheduler)
        else:
            engine = Engine(study, count if study.variables else min(count, len(blocks)))
        with engine:
            if study.variables:
                Trials(study, store, engine, tell, stop).run()
                return results_at(given, study)
            start, done, total = time.perf_counter(), 0, sum(len(block.ids) for block in blocks)
            tell(f"0 of {total} points", 0.0)
            for block, answers in engine.compute(iter(blocks), stop):
                store.write(block, answers)
                done += len(block.ids)
                rate = done / (time.perf_counter() - start)
                left = (total - done) / rate
                tell(f"{done} of {total} points, {rate:.3g}/s, {lasting(left)} left", done / total)
    return results_at(given, study)
