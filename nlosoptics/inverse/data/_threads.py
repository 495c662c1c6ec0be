"""Torch's threads and gradients during a solve."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def single_thread() -> Iterator[None]:
    """Run torch on one thread within a ``with`` block.

    Images of 512 x 512 gain nothing from a second thread, and on a busy machine OpenMP's spinning
    barriers make each transform tens of times slower (0.5 s became 38 s). One thread also gives the
    same bits on every machine.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def gradients() -> Iterator[None]:
    """Record gradients within a ``with`` block, even if the caller has disabled them."""
    with torch.inference_mode(False), torch.enable_grad():
        yield
