"""Preparation of the workers of a dask cluster, including those that join later."""

from __future__ import annotations

from typing import Any

from distributed import WorkerPlugin

from .worker import forget, prepare


class Preparation(WorkerPlugin):
    """Plugin that gives every worker the study, once."""

    idempotent = True

    def __init__(self, key: str, packed: bytes) -> None:
        self.key, self.packed = key, packed

    def setup(self, worker: Any) -> None:
        """Unpickle the study on a worker."""
        prepare(self.key, self.packed, own_process=False)

    def teardown(self, worker: Any) -> None:
        """Release the study."""
        forget(self.key)
