"""Computation of blocks by any executor of `concurrent.futures`."""

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
from typing import Any, Protocol

from ..errors import MissingExtraError, SceneError
from .design.study import Study
from .worker import Answers, Block, evaluate, forget, lost, prepare

WINDOW = 3  # blocks in flight per worker


class Engine(Protocol):
    """Source of executors that know the study under `key`."""

    key: str
    workers: int

    def start(self) -> Executor:
        """Return an executor whose workers are prepared."""

    def close(self) -> None:
        """Release the study."""


def _packed(study: Study) -> bytes:
    """Pickle what workers need of a study; the values of its points come with the blocks."""
    return pickle.dumps(replace(study, dimensions=()))


class _Here(Executor):
    """Executor that computes in this process, at once."""

    def submit(self, function: Callable[..., Any], /, *given: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*given, **options))
        except Exception as error:
            future.set_exception(error)
        return future


class InProcess:
    """Engine that computes in this process, without workers."""

    workers = 1

    def __init__(self, study: Study) -> None:
        self.key = uuid.uuid4().hex
        self._packed = _packed(study)

    def start(self) -> Executor:
        """Return the executor."""
        prepare(self.key, self._packed, own_process=False)
        return _Here()

    def close(self) -> None:
        """Release the study."""
        forget(self.key)


class Processes:
    """Engine of spawned processes on this machine, with one thread each.

    With ``ahead`` they start at once, otherwise with the first blocks.
    """

    def __init__(self, study: Study, workers: int, *, ahead: bool = False) -> None:
        self.key, self.workers = uuid.uuid4().hex, workers
        self._packed = _packed(study)
        self._waiting = self._pool() if ahead else None
        if self._waiting:
            for _ in range(workers):
                self._waiting.submit(os.getpid)  # starts a process

    def start(self) -> Executor:
        """Return a pool."""
        pool, self._waiting = self._waiting or self._pool(), None
        return pool

    def _pool(self) -> Executor:
        return ProcessPoolExecutor(
            self.workers,
            multiprocessing.get_context("spawn"),
            initializer=prepare,
            initargs=(self.key, self._packed),
        )

    def close(self) -> None:
        """End processes that no block has asked for; others end with their pool."""
        if self._waiting:
            self._waiting.shutdown()


class Cluster:
    """Engine of the workers of a dask scheduler."""

    def __init__(self, study: Study, address: str) -> None:
        try:
            import distributed
        except ModuleNotFoundError:
            raise MissingExtraError(
                "dask.distributed is not installed; run pip install 'nlosoptics[study]'"
            ) from None
        client: Any = distributed.Client  # without annotations
        self.key = uuid.uuid4().hex
        try:
            self._client = client(address, timeout=10)
        except (OSError, ValueError) as error:
            raise SceneError(
                f"scheduler {address!r} does not answer ({error}); give the address that dask "
                "scheduler prints, such as tcp://host:8786"
            ) from None
        from .dask_plugin import Preparation

        self._client.register_plugin(Preparation(self.key, _packed(study)), name=self.key)
        threads: dict[str, int] = self._client.nthreads()
        if not threads:
            raise SceneError(f"scheduler {address!r} has no workers; start some with dask worker")
        self.workers = sum(threads.values())

    def start(self) -> Executor:
        """Return an executor on the cluster."""
        executor: Executor = self._client.get_executor(pure=False, retries=0)
        return executor

    def close(self) -> None:
        """Leave the cluster."""
        with suppress(Exception):  # the scheduler may be gone
            self._client.unregister_worker_plugin(self.key)
        self._client.close()


def quieten() -> None:
    """Keep dask's log of lost connections off stderr, where the command line tells it in a line."""
    import distributed  # sets up its log

    for handler in logging.getLogger(distributed.__name__).handlers:
        handler.setLevel(logging.CRITICAL)


def computed(
    engine: Engine, blocks: Iterator[Block | None], interrupted: Callable[[], bool]
) -> Iterator[tuple[Block, Answers]]:
    """Yield blocks with their answers as they are finished.

    Parameters
    ----------
    engine : Engine
        Engine that knows the study.
    blocks : iterator of Block
        Blocks, taken as workers become free. None says that further blocks wait for results.
    interrupted : callable
        Whether to end after the blocks in flight.

    Notes
    -----
    If a worker process ends, all blocks in flight are repeated one at a time, since any of them
    may be the cause. A block whose worker ends again is halved until the point is found that ends
    its worker; this point has the status `LOST`.
    """
    flying: dict[Future[Answers], Block] = {}
    executor = engine.start()
    try:
        while True:
            while len(flying) < WINDOW * engine.workers and not interrupted():
                block = next(blocks, None)
                if block is None:
                    break
                flying[_submitted(executor, engine.key, block)] = block
            if not flying:
                return
            done, _ = wait(flying, timeout=0.2, return_when=FIRST_COMPLETED)
            ended = []
            for future in sorted(done, key=lambda future: flying[future].row):
                block = flying.pop(future)
                try:
                    answers = future.result()
                except Exception as error:
                    if not _worker_ended(error):
                        raise
                    ended.append(block)
                else:
                    yield block, answers
            if ended:
                ended += flying.values()
                flying.clear()
                executor.shutdown()
                for block in sorted(ended, key=lambda block: block.row):
                    yield block, _alone(engine, block)
                executor = engine.start()
    finally:
        for future in flying:
            future.cancel()
        executor.shutdown()


def _submitted(executor: Executor, key: str, block: Block) -> Future[Answers]:
    """Return the future of a block; it has failed if a worker of the executor has ended."""
    try:
        return executor.submit(evaluate, key, block)
    except Exception as error:
        if not _worker_ended(error):
            raise
        future: Future[Answers] = Future()
        future.set_exception(error)
        return future


def _alone(engine: Engine, block: Block) -> Answers:
    """Return the answers of a block computed with no other block in flight."""
    executor = engine.start()
    try:
        return executor.submit(evaluate, engine.key, block).result()
    except Exception as error:
        if not _worker_ended(error):
            raise
    finally:
        executor.shutdown()
    n = len(block.ids)
    if n == 1:
        return lost(block)
    parts = [
        _alone(engine, block._replace(deltas=block.deltas[one:other], ids=block.ids[one:other]))
        for one, other in ((0, n // 2), (n // 2, n))
    ]
    return Answers(*(one + other for one, other in zip(*parts, strict=True)))


def _worker_ended(error: Exception) -> bool:
    """Whether an exception says that a worker process ended, by the names of both engines."""
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"BrokenExecutor", "KilledWorker"})
