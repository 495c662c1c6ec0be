"""Decorator for kernels that keeps the times of loading and of compilation short.

Before numba looks into its cache it imports all that a compilation may need: its implementations
of Python and numpy, and with them scipy.linalg. This takes longer than loading all kernels of a
run. Compiled kernels need none of it, and a compilation imports it by itself.

Many kernels are called only by other kernels. numba gives each of them an entry for Python and one
for C, and compiles them again for every constant that they are called with. The decorator leaves
this out.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numba
from numba.core import types
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime.nrt import rtsys


class _Cache(NullCache):
    """Cache of one kernel, which opens numba's own cache when it is first needed.

    It is never needed for a kernel that only other kernels call: their object code contains it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @functools.cached_property
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
    function: Callable[..., Any] | None = None,
    /,
    *,
    cache: bool = False,
    shared: bool = False,
    **options: Any,
) -> Any:
    """Compile a function as `numba.njit` does.

    Parameters
    ----------
    function : callable, optional
        Function to compile. Without it, a decorator is returned.
    cache : bool
        Whether to keep the compiled function in numba's cache.
    shared : bool
        Whether other kernels call the version for Python, so that there is only one. It suits a
        kernel that both call in a first run.
    **options
        Further options of `numba.njit`.
    """
    if function is None:
        return lambda given: njit(given, cache=cache, shared=shared, **options)
    compiled = numba.njit(function, no_cfunc_wrapper=True, **options)
    # numba would read the metadata of all installed packages for extensions of its types
    compiled._compilation_chain_init_hook = _no_extensions
    if cache and hasattr(compiled, "_cache"):  # NUMBA_DISABLE_JIT leaves the function as it is
        compiled._cache = _Cache(function)
        if not shared and options.get("inline") != "always":
            _set_inner(compiled, function, options)
    return compiled


def _no_extensions() -> None:
    """Add nothing to the types of arguments: kernels take numbers and numpy's arrays."""


def _set_inner(compiled: Any, function: Callable[..., Any], options: dict[str, Any]) -> None:
    """Make other kernels call a version of a compiled function that Python cannot call."""

    @functools.cache
    def called() -> Any:
        inner = FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__
        )
        # numba's cache is keyed by the qualified name
        inner.__qualname__, inner.__module__ = f"{function.__qualname__}_inner", function.__module__
        made = numba.njit(inner, no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)
        made._cache = _Cache(inner)
        return made

    def get_call_template(given: Any, keywords: Any) -> Any:
        """Return the types of a call; a constant has the type of other numbers."""
        return called().get_call_template(tuple(map(types.unliteral, given)), keywords)

    compiled.get_call_template = get_call_template
    compiled.get_overload = lambda signature: called().get_overload(signature)
