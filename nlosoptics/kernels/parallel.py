"""Parallel compiled loops that fall back to one thread in a forked process.

On Linux numba usually runs its threads with GNU OpenMP, which cannot be used both before and after
a fork: numba terminates the child process. The other threading layers do not help. TBB must be
installed separately, and numba's own layer must not be entered by two Python threads at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from types import FunctionType
from typing import Any

from .compiling import njit

_forked = False


def _note_fork() -> None:
    """Record in a forked child that numba's threads must not be used."""
    global _forked
    _forked = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


class _Loop:
    """Function that is compiled twice: for all threads, and for one thread in a forked process."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.py_func = function
        self.threaded = njit(cache=True, parallel=True, **options)(function)
        # numba's cache is keyed by the qualified name, so the second version needs another name
        alone = FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__
        )
        alone.__qualname__ = f"{function.__qualname__}_alone"
        alone.__module__ = function.__module__
        self.alone = njit(cache=True, **options)(alone)

    def __call__(self, *arguments: Any) -> Any:
        return (self.alone if _forked else self.threaded)(*arguments)


def threaded(**options: Any) -> Callable[[Callable[..., Any]], _Loop]:
    """Return a decorator that compiles a function whose ``prange`` loops run on all threads.

    The iterations must be independent, and sums must not be shared between them: the result is then
    bitwise identical for any number of threads. Options are those of `numba.njit`.
    """
    return lambda function: _Loop(function, options)
