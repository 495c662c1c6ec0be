"""Evaluation of blocks of points in worker processes.

Nothing numerical is imported at the top, so that `prepare` sets the number of threads first.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import threading
import time
from collections.abc import Mapping
from multiprocessing.util import Finalize
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from .design.study import Study

DONE, FAILED, LOST = 1, 2, 3  # codes of a figure's status; 0 is pending
#: Studies of this process by their key, with the results that their points share.
_studies: dict[str, tuple[Study, dict[str, Any]]] = {}
_one_block = threading.Lock()  # a dask worker may have several threads, which share the stages


class Block(NamedTuple):
    """Points that are computed together.

    ``rows`` are their places in the store, ``deltas`` and ``ids`` describe them, and ``figures``
    names the figures to compute.
    """

    rows: tuple[int, ...]
    deltas: tuple[Mapping[str, Any], ...]
    ids: tuple[str, ...]
    figures: tuple[str, ...]


class Answers(NamedTuple):
    """Results of a block: arrays (points, figures), and seconds (points,)."""

    values: Any
    errors: Any
    statuses: Any
    messages: Any
    seconds: Any


def prepare(key: str, packed: bytes, *, own_process: bool = True) -> None:
    """Unpickle the study once in this process."""
    if own_process:
        import signal

        signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=_end_with_parent, daemon=True).start()
        for name in ("NUMBA", "OMP", "OPENBLAS", "MKL"):
            os.environ[f"{name}_NUM_THREADS"] = "1"
        # a worker has nothing to tidy up, and the end of an interpreter with numba takes 0.3 s
        Finalize(None, os._exit, (0,), exitpriority=-1)
    from .design.point import stage_caches

    if own_process:  # what most points use loads while the client makes the store
        import nlosoptics.psf.metrics.psf_metrics
        import nlosoptics.psf.walls.scene_psf  # noqa: F401

    _studies[key] = pickle.loads(packed), stage_caches()


def _end_with_parent() -> None:
    """End this process when its parent has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def forget(key: str) -> None:
    """Release a study that `prepare` kept."""
    _studies.pop(key, None)


def evaluate(key: str, block: Block) -> Answers:
    """Compute the figures of the points of a block.

    A figure that cannot be computed is NaN, with status `FAILED` and a message.
    """
    import numba

    from .design.study import point_seed

    study, caches = _studies[key]
    figures = [study.figure(name) for name in block.figures]
    points, seconds = [], []
    with _one_block:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        for delta, name in zip(block.deltas, block.ids, strict=True):
            start = time.perf_counter()
            points.append(_point(study, figures, delta, point_seed(name), caches))
            seconds.append(time.perf_counter() - start)
        numba.set_num_threads(threads)
    return _answers(points, seconds)


def _answers(points: list[Any], seconds: list[float]) -> Answers:
    """Return lists of a tuple for each point and figure as arrays."""
    import numpy as np

    table = np.array(points, dtype=object)  # (points, figures, 4)
    return Answers(
        values=table[..., 0].astype(np.float64),
        errors=table[..., 1].astype(np.float64),
        statuses=table[..., 2].astype(np.int8),
        messages=table[..., 3],
        seconds=np.array(seconds),
    )


def _point(
    study: Study, figures: list[Any], delta: Mapping[str, Any], seed: int, caches: dict[str, Any]
) -> list[tuple[float, float, int, str]]:
    """Return value, error, status and message of every figure of a point."""
    from .design.point import StudyPoint

    point = StudyPoint(study.base, delta, seed, study.tol, caches)
    try:
        _ = point.scene  # refused values fail whether or not a stage is shared
    except Exception as error:
        return [_failed(error)] * len(figures)
    rows = []
    for figure in figures:
        point.warnings.clear()
        try:
            value, error_of_value = figure.value(point, study.folder)
        except (Exception, SystemExit) as error:  # an own function may call sys.exit
            rows.append(_failed(error))
        else:
            rows.append((value, error_of_value, DONE, "; ".join(point.warnings)))
    return rows


def _failed(error: BaseException) -> tuple[float, float, int, str]:
    """Return the entries of a figure that raised an exception."""
    text = " ".join(str(error).split())
    return float("nan"), float("nan"), FAILED, f"{type(error).__name__}: {text}"


def lost(block: Block) -> Answers:
    """Return the answers of a block whose worker ended twice."""
    nan = float("nan")
    row = (nan, nan, LOST, "the worker process ended twice at this point")
    return _answers([[row] * len(block.figures)] * len(block.ids), [nan] * len(block.ids))
