"""Evaluation of blocks of points in worker processes.

Nothing numerical is imported at the top, so that `prepare` sets the number of threads first.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from multiprocessing.util import Finalize
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from .design.study import Study

DONE, FAILED, LOST = 1, 2, 3  # codes of a figure's status; 0 is pending
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Studies of this process by their key.
_studies: dict[str, tuple[Study, dict[str, Any]]] = {}
_one_block = threading.Lock()  # a dask worker may have several threads, which share the stages


class Block(NamedTuple):
    """Points that are computed and stored together.

    ``row`` is the first row in the store, ``deltas`` and ``ids`` describe the points, ``figures``
    names the figures to compute.
    """

    row: int
    deltas: tuple[Mapping[str, Any], ...]
    ids: tuple[str, ...]
    figures: tuple[str, ...]


class Answers(NamedTuple):
    """Results of a block: lists of rows, each with one entry for every figure of the block."""

    values: list[list[float]]
    errors: list[list[float]]
    statuses: list[list[int]]
    messages: list[list[str]]
    seconds: list[float]


def prepare(key: str, packed: bytes, *, own_process: bool = True) -> None:
    """Unpickle the study once in this process.

    Parameters
    ----------
    key : str
        Key under which `evaluate` finds the study.
    packed : bytes
        Pickled study.
    own_process : bool
        Whether this process only computes points: one thread, and Ctrl-C is left to the client.
    """
    if own_process:
        import signal

        signal.signal(signal.SIGINT, signal.SIG_IGN)
        os.environ |= dict.fromkeys(THREADS, "1")
        # a worker has nothing to tidy up, and the end of an interpreter with numba takes 0.3 s
        Finalize(None, os._exit, (0,), exitpriority=-1)
    import pickle

    from .design.point import stage_caches

    if own_process:  # what most points use loads while the client makes the store
        import nlosoptics.psf.metrics.psf_metrics
        import nlosoptics.psf.walls.scene_psf  # noqa: F401

    _studies[key] = pickle.loads(packed), stage_caches()


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
    answers = Answers([], [], [], [], [])
    figures = [study.figure(name) for name in block.figures]
    with _one_block:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        for delta, name in zip(block.deltas, block.ids, strict=True):
            start = time.perf_counter()
            rows = _point(study, figures, delta, point_seed(name), caches)
            values, errors, statuses, messages = zip(*rows, strict=True)
            answers.values.append(list(values))
            answers.errors.append(list(errors))
            answers.statuses.append(list(statuses))
            answers.messages.append(list(messages))
            answers.seconds.append(time.perf_counter() - start)
        numba.set_num_threads(threads)
    return answers


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
    found = []
    for figure in figures:
        point.warnings.clear()
        try:
            value, error_of_value = figure.value(point, study.folder)
        except Exception as error:
            found.append(_failed(error))
        else:
            found.append((value, error_of_value, DONE, "; ".join(point.warnings)))
    return found


def _failed(error: Exception) -> tuple[float, float, int, str]:
    """Return the entries of a figure that raised an exception."""
    text = " ".join(str(error).split())
    return float("nan"), float("nan"), FAILED, f"{type(error).__name__}: {text}"


def lost(block: Block) -> Answers:
    """Return the answers of a block whose worker ended twice."""
    n, m = len(block.ids), len(block.figures)
    nan = [[float("nan")] * m for _ in range(n)]
    told = [["the worker process ended twice at this point"] * m for _ in range(n)]
    return Answers(nan, nan, [[LOST] * m for _ in range(n)], told, [float("nan")] * n)
