"""Computation of blocks by executors of `concurrent.futures`: here, by processes, by a cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from typing import Any

from ..errors import MissingExtraError, SceneError
from .design.study import Study
from .worker import Answers, Block, evaluate, forget, lost, prepare


class Engine:
    """Workers that know a study; this process itself if ``workers`` is 0.

    Parameters
    ----------
    study : Study
        Study; the values of its points come with the blocks.
    workers : int
        Number of spawned processes on this machine, with one thread each.
    """

    def __init__(self, study: Study, workers: int) -> None:
        self.key, self.workers = uuid.uuid4().hex, workers or 1
        self._packed = pickle.dumps(replace(study, dimensions=()))
        self._here = not workers
        self._executor = self._start()

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown(cancel_futures=True)
        forget(self.key)

    def _start(self) -> Executor:
        """Return an executor whose workers are prepared."""
        if self._here:
            prepare(self.key, self._packed, own_process=False)
            return _Here()
        pool = ProcessPoolExecutor(
            self.workers,
            multiprocessing.get_context("spawn"),
            initializer=prepare,
            initargs=(self.key, self._packed),
        )
        for _ in range(self.workers):
            pool.submit(os.getpid)  # starts a process, while the store is made
        return pool

    def _restart(self) -> None:
        """Replace an executor of which a process has ended."""
        self._executor.shutdown()
        self._executor = self._start()

    def _submit(self, block: Block) -> Future[Answers]:
        """Return the future of a block; it has failed if a worker of the executor has ended."""
        try:
            return self._executor.submit(evaluate, self.key, block)
        except Exception as error:
            future: Future[Answers] = Future()
            future.set_exception(error)
            return future

    def compute(
        self, blocks: Iterator[Block], interrupted: Callable[[], bool]
    ) -> Iterator[tuple[Block, Answers]]:
        """Yield blocks with their answers as they are finished.

        Notes
        -----
        If a worker process ends, the blocks in flight are repeated point by point, since any of
        them may be the cause. A point whose worker ends again has the status `LOST`.
        """
        flying: dict[Future[Answers], Block] = {}
        suspects: list[Block] = []
        while True:
            while not suspects and len(flying) < 3 * self.workers and not interrupted():
                block = next(blocks, None)
                if block is None:
                    break
                flying[self._submit(block)] = block
            if not flying:
                if not suspects:
                    return
                self._restart()
                for block in suspects:
                    yield from map(self._alone, _points(block))
                suspects = []
                continue
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                block = flying.pop(future)
                try:
                    answers = future.result()
                except Exception as error:
                    if not _worker_ended(error):
                        raise
                    suspects.append(block)
                else:
                    yield block, answers

    def _alone(self, point: Block) -> tuple[Block, Answers]:
        """Return a block of one point with its answers, computed with no other in flight."""
        try:
            return point, self._submit(point).result()
        except Exception as error:
            if not _worker_ended(error):
                raise
        self._restart()
        return point, lost(point)


def connected(address: str) -> Any:
    """Return a client of the dask scheduler at ``address``, which must have workers."""
    try:
        import distributed
    except ModuleNotFoundError:
        raise MissingExtraError(
            "dask.distributed is not installed; run pip install 'nlosoptics[study]'"
        ) from None
    client: Any = distributed.Client  # without annotations
    try:
        found = client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise SceneError(
            f"scheduler {address!r} does not answer ({error}); give the address that dask "
            "scheduler prints, such as tcp://host:8786"
        ) from None
    if not found.nthreads():
        found.close()
        raise SceneError(f"scheduler {address!r} has no workers; start some with dask worker")
    return found


class Cluster(Engine):
    """Workers of a dask scheduler at ``address``."""

    def __init__(self, study: Study, address: str) -> None:
        self.key = uuid.uuid4().hex
        self._client = connected(address)
        from .dask_plugin import Preparation

        packed = pickle.dumps(replace(study, dimensions=()))
        self._client.register_plugin(Preparation(self.key, packed), name=self.key)
        self.workers = sum(self._client.nthreads().values())
        self._executor = self._start()

    def _start(self) -> Executor:
        """Return an executor on the cluster."""
        executor: Executor = self._client.get_executor(pure=False, retries=0)
        return executor

    def __exit__(self, *_: object) -> None:
        """Leave the cluster."""
        with suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False)
            self._client.unregister_worker_plugin(self.key)
        self._client.close()


class _Here(Executor):
    """Executor that computes in this process, at once."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **options))
        except Exception as error:
            future.set_exception(error)
        return future


def quieten() -> None:
    """Keep dask's log of lost connections off stderr, where the command line tells it in a line."""
    import distributed  # sets up its log

    for handler in logging.getLogger(distributed.__name__).handlers:
        handler.setLevel(logging.CRITICAL)


def _points(block: Block) -> Iterator[Block]:
    """Yield the points of a block, each as a block."""
    for row, delta, name in zip(block.rows, block.deltas, block.ids, strict=True):
        yield Block((row,), (delta,), (name,), block.figures)


def _worker_ended(error: Exception) -> bool:
    """Whether an exception says that a worker process ended, by the names of both engines."""
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"BrokenExecutor", "KilledWorker"})
