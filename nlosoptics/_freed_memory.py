"""Freed memory, kept for the next arrays."""

from __future__ import annotations

from functools import cache

import numpy as np

#: Bytes of a block that is freed at once; glibc learns nothing from blocks above 32 MiB.
BLOCK = 2**25 - 2**16


@cache
def keep_freed_memory() -> None:
    """Let the C library keep the memory of freed arrays for later ones.

    The system clears new memory page by page, which takes longer than many operations on it. glibc
    returns arrays above 128 kB to the system as soon as they are freed, unless one that was larger
    has been freed before. Other libraries ignore this call.
    """
    np.empty(BLOCK, dtype=np.uint8)  # is not touched, and so takes no memory
