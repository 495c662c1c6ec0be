"""Decorator of all compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def njit(
    function: Callable[..., Any] | None = None, /, *, cache: bool = True, **options: Any
) -> Any:
    """Compile a function as `numba.njit` does, by default with numba's cache on the disk."""
    return numba.njit(function, cache=cache, **options)
