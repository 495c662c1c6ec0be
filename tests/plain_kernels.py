"""Kernels as plain Python, which tests can call with a few numbers and without compiling them.

Compiled kernels cannot be looked into, and a kernel that only others call would be compiled for its
test alone. As plain Python it takes milliseconds, and every branch is within reach of small arrays.
"""

from __future__ import annotations

import functools
import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

#: Tolerance relative to the numbers on record, which have nine digits.
TIGHT = 1e-8


def numbers(
    *shape: int, low: float = -1.0, high: float = 1.0, seed: int = 0
) -> NDArray[np.float64]:
    """Return an array of uniformly distributed random numbers."""
    return np.random.default_rng([*shape, seed]).uniform(low, high, shape)


def complexes(*shape: int, seed: int = 0) -> NDArray[np.complex128]:
    """Return an array whose real and imaginary parts are `numbers`."""
    return numbers(*shape, seed=seed) + 1j * numbers(*shape, seed=seed + 1)


@functools.cache
def plain(name: str) -> ModuleType:
    """Return a module of kernels, and those that it imports, without compilation.

    They are copies, which the package itself does not see.
    """
    importlib.import_module(f"nlosoptics.{name}")  # what it imports must not see the copies
    before = {key: module for key, module in sys.modules.items() if _holds_kernels(key)}
    for key in before:
        del sys.modules[key]
    compiles = numba.config.DISABLE_JIT
    numba.config.DISABLE_JIT = 1
    try:
        return importlib.import_module(f"nlosoptics.{name}")
    finally:
        numba.config.DISABLE_JIT = compiles
        for key in [key for key in sys.modules if _holds_kernels(key)]:
            del sys.modules[key]
        sys.modules |= before
        for key, module in before.items():
            package, _, stem = key.rpartition(".")
            setattr(sys.modules[package], stem, module)


def _holds_kernels(name: str) -> bool:
    inside = name.startswith("nlosoptics.")
    return inside and (name.startswith("nlosoptics.kernels.") or name.endswith("_kernels"))


def after(kernel: Callable[..., Any], *given: Any) -> list[Any]:
    """Return what a kernel returns, and what the arrays that it was given then hold."""
    result = kernel(*given)
    return [result, [one for one in given if isinstance(one, np.ndarray)]]
