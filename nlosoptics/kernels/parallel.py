"""Compiled loops over numba's threads, which run on one thread in a forked process.

GNU OpenMP, numba's usual pool of threads on Linux, cannot be used on both sides of a fork: numba
ends the child. The other pools are no way out, as TBB has to be installed and numba's own must not
be entered by two threads of Python at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from types import FunctionType
from typing import Any

from numba import njit

_forked = False


def _note_fork() -> None:
    global _forked
    _forked = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


class _Loop:
    """A function compiled for all threads, and for one where this process was forked."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.py_func = function
        self.threaded = njit(cache=True, parallel=True, **options)(function)
        # numba's cache goes by the name, and would take one for the other
        alone = FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__
        )
        alone.__qualname__ = f"{function.__qualname__}_alone"
        alone.__module__ = function.__module__
        self.alone = njit(cache=True, **options)(alone)

    def __call__(self, *arguments: Any) -> Any:
        return (self.alone if _forked else self.threaded)(*arguments)


def threaded(**options: Any) -> Callable[[Callable[..., Any]], _Loop]:
    """Compile a function whose ``prange`` runs on all threads, for Python to call.

    Parameters
    ----------
    **options
        Of `numba.njit`. The iterations must be independent and each thread's sums its own, so that
        the number of threads does not change a bit.
    """
    return lambda function: _Loop(function, options)
