"""Freed memory that is kept for later arrays."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

# 20 arrays of 1 MB at a time; the system provides a page at a time of new memory
FAULTS = """
import resource
import numpy as np
from nlosoptics._freed_memory import keep_freed_memory
{}
def work():
    for array in [np.empty(2**17) for _ in range(20)]:
        array[:] = 1.0
work()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(call: str) -> int:
    found = subprocess.run(
        [sys.executable, "-c", FAULTS.format(call)], capture_output=True, text=True, check=True
    )
    return int(found.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other libraries differ")
def test_memory_of_freed_arrays_is_used_again() -> None:
    assert faults("keep_freed_memory()") < 0.1 * faults("")
