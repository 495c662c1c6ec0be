"""Kernels of a first run, compiled by a second process while the run works.

The process begins with the kernels that the run needs last, and the run finds them in numba's
cache. What the process has not reached, the run compiles itself.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from .processes import can_help, forked

#: Kernels, ``module:name``, and the types of their arguments, in the order in which a run of a
#: letter seen by a flat wall needs them. ``python tests/cli/first_run.py`` prints them.
KERNELS: Final = Path(__file__).with_name("first_run.json")
#: What the process yields to the run and its figures, if there are too few cores for all of them.
NICE: Final = 10


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Compile the kernels of a run in another process until the block ends.

    There is no such process where the system cannot fork or has one core, nor once `mark_done` was
    called, which also happens when the block ends without an error.
    """
    if not can_help() or _mark().exists():
        yield
        return
    import numba  # noqa: F401  (once for both processes)

    process = forked(_compile)
    try:
        yield
    finally:
        process.kill()
        process.join()
    mark_done()


def mark_done() -> None:
    """Note that the kernels of a first run are compiled, for this version and processor."""
    with suppress(OSError):
        _mark().touch()


def _mark() -> Path:
    from .._cost_model import kept_at

    return kept_at().with_suffix(".compiled")


def _compile() -> None:
    """Compile all kernels, the last one first. What fails is left to the run, which tells it."""
    os.nice(NICE)
    from numba import types

    # looked up by name below
    from ..inverse.known import _splitting_kernels  # noqa: F401
    from ..kernels import brdf  # noqa: F401
    from ..psf.transform import _antialiased_kernels, _transform_kernels  # noqa: F401
    from ..psf.wave import _wave_kernels  # noqa: F401

    named = {**vars(types), "bool": types.boolean}
    for kernel, arguments in reversed(json.loads(KERNELS.read_text())):
        module, _, name = kernel.partition(":")
        compiled = getattr(sys.modules[module], name)
        compiled.compile(tuple(eval(text, named) for text in arguments))
