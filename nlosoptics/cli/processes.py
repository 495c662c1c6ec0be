"""Processes that work beside a run."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable
from multiprocessing.context import ForkProcess
from typing import Any


def can_help() -> bool:
    """Return whether this system can fork processes, and has a core for them."""
    return sys.platform.startswith("linux") and (os.cpu_count() or 1) > 1


def forked(target: Callable[..., None], *arguments: Any) -> ForkProcess:
    """Start a function in another process, which ends with this one.

    It must take no lock that another thread may hold.
    """
    process = multiprocessing.get_context("fork").Process(target=_alone, args=(target, *arguments))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    return process


def _alone(target: Callable[..., None], *arguments: Any) -> None:
    """Run a function in a process that only its parent ends, and that fails without a word."""
    import ctypes

    on_death = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    ctypes.CDLL(None).prctl(on_death, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    warnings.simplefilter("ignore", DeprecationWarning)
    try:
        target(*arguments)
    except Exception:
        os._exit(1)
