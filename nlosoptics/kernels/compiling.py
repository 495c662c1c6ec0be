"""Decorator for kernels that loads them from numba's cache without preparing a compilation.

Before numba looks into its cache it imports all that a compilation may need: its implementations
of Python and numpy, and with them scipy.linalg. This takes longer than loading all kernels of a
run. Compiled kernels need none of it, and a compilation imports it by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numba
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime.nrt import rtsys


class _Cache(NullCache):
    """Cache of one kernel, which opens numba's own cache when it is first needed.

    It is never needed for a kernel that only other kernels call: their object code contains it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _own(self) -> Any:
        return FunctionCache(self._function)

    @property
    def cache_path(self) -> Any:
        """Folder of the files."""
        return self._own.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for a signature, or None."""
        own = self._own
        if not hasattr(own, "_load_overload"):  # another version of numba
            return own.load_overload(sig, target_context)
        rtsys.initialize(target_context)  # kernels call its functions to allocate arrays
        with own._guard_against_spurious_io_errors():
            return own._load_overload(sig, target_context)

    def save_overload(self, sig: Any, cres: Any) -> None:
        """Write a compiled kernel to the cache."""
        self._own.save_overload(sig, cres)

    def flush(self) -> None:
        """Remove the kernel's signatures from the cache."""
        self._own.flush()


def njit(
    function: Callable[..., Any] | None = None, /, *, cache: bool = False, **options: Any
) -> Any:
    """Compile a function as `numba.njit` does.

    Parameters
    ----------
    function : callable, optional
        Function to compile. Without it, a decorator is returned.
    cache : bool
        Whether to keep the compiled function in numba's cache.
    **options
        Further options of `numba.njit`.
    """
    if function is None:
        return lambda given: njit(given, cache=cache, **options)
    compiled = numba.njit(function, **options)
    if cache and hasattr(compiled, "_cache"):  # NUMBA_DISABLE_JIT leaves the function as it is
        compiled._cache = _Cache(function)
    return compiled
