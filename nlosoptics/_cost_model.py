"""Speed of this machine, measured once and cached, for predictions of run time.

The constants in `psf.transform.costs` and in the plan are seconds on one core of a reference
machine. Transforms are selected by the unscaled constants, so that results do not depend on the
machine. The times that a plan reports are scaled by three probes measured on this machine.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Final

from . import __version__
from ._whole_files import write_whole
from .errors import SceneError

#: Run time of the probes on the reference machine, s.
REFERENCE: Final = {"calls": 1.7e-3, "arrays": 7.6e-3, "transforms": 2.3e-3}
#: Plausible range of a factor; outside it another process disturbed the measurement.
BELIEVED: Final = (0.1, 10.0)
REPEATS: Final = 5


def seconds(calls: float = 0.0, arrays: float = 0.0, transforms: float = 0.0) -> float:
    """Convert seconds on the reference machine to seconds on this machine.

    Parameters
    ----------
    calls : float
        Time spent in Python and on small arrays, s.
    arrays : float
        Time spent in long loops over arrays, s.
    transforms : float
        Time spent in Fourier transforms and their kernels, s.

    Returns
    -------
    float
        Predicted total on this machine, s.
    """
    here = factors()
    return calls * here["calls"] + arrays * here["arrays"] + transforms * here["transforms"]


@lru_cache(maxsize=1)
def factors() -> dict[str, float]:
    """Return run time on this machine over that on the reference machine for each kind of work.

    The factors are measured on first use, in about 0.1 s, and saved to a file. If no file can be
    written, all factors are 1.
    """
    path = kept_at()
    try:
        found = json.loads(path.read_text())
        kept = {name: float(found[name]) for name in REFERENCE}
        if all(BELIEVED[0] <= factor <= BELIEVED[1] for factor in kept.values()):
            return kept
    except (OSError, ValueError, KeyError, TypeError):
        pass
    measured = {}
    for name, probe in _probes().items():
        low, high = BELIEVED
        measured[name] = min(max(_least(probe) / REFERENCE[name], low), high)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole({path: json.dumps(measured).encode()})
    except (OSError, SceneError):
        # without a file each process would measure, and so predict, different times
        return dict.fromkeys(REFERENCE, 1.0)
    return measured


def kept_at() -> Path:
    """Path of the saved factors, next to the compiled kernels, for this version and processor."""
    folder = os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__"
    processor = platform.processor() + platform.machine() + str(os.cpu_count())
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor += next((line for line in lines if line.startswith("model name")), "")
    except OSError:
        pass
    key = hashlib.sha256(f"{processor}{REFERENCE}".encode()).hexdigest()[:12]
    return Path(folder) / f"machine-{__version__}-{key}.json"


def _least(probe: Callable[[], object]) -> float:
    """Return the least processor time of several runs of a probe, s."""
    probe()  # the first call may load modules
    found = []
    for _ in range(REPEATS):
        start = time.thread_time()
        probe()
        found.append(time.thread_time() - start)
    return min(found)


def _probes() -> dict[str, Callable[[], object]]:
    """Return one function of a few milliseconds for each kind of work, to be timed."""
    import ducc0
    import numpy as np

    short, long = np.linspace(0.1, 1.0, 8), np.linspace(0.1, 1.0, 1 << 19)
    square = np.ones((512, 512), dtype=np.complex128)

    def calls() -> None:
        for _ in range(1000):
            np.sqrt(short * short + 1.0)

    def transforms() -> None:
        ducc0.fft.c2c(square, nthreads=1)

    return {
        "calls": calls,
        "arrays": lambda: np.exp(long) * np.sqrt(long),
        "transforms": transforms,
    }
