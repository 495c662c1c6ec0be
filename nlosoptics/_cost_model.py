"""How fast this machine is, measured once and kept, for predictions of run time.

The constants of `psf.transform.costs` and of the plan are seconds on one core of the machine that
they were fitted on. Which transform runs is chosen by them as they are, so that a scene gives the
same bits everywhere; what a plan tells is scaled by how long three probes take here.
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

#: Seconds of the probes on the machine of the fits.
REFERENCE: Final = {"calls": 1.7e-3, "arrays": 7.6e-3, "transforms": 2.3e-3}
#: Within which a measured factor is believed; beyond, something else took the processor.
BELIEVED: Final = (0.1, 10.0)
REPEATS: Final = 5


def seconds(calls: float = 0.0, arrays: float = 0.0, transforms: float = 0.0) -> float:
    """Seconds here of what takes so many on the machine of the fits.

    Parameters
    ----------
    calls : float
        Of Python and small arrays.
    arrays : float
        Of long loops over arrays.
    transforms : float
        Of Fourier transforms and the kernels beside them.

    Returns
    -------
    float
    """
    here = factors()
    return calls * here["calls"] + arrays * here["arrays"] + transforms * here["transforms"]


@lru_cache(maxsize=1)
def factors() -> dict[str, float]:
    """How many times longer than on the machine of the fits each kind of work takes here.

    Measured at the first need, some 0.1 s, and kept in a file; 1 where no file can be kept.
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
        # another process would measure something else, and plan something else
        return dict.fromkeys(REFERENCE, 1.0)
    return measured


def kept_at() -> Path:
    """File of the factors, beside the compiled kernels, of this version on this processor."""
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
    """Least seconds of the processor that a probe takes."""
    probe()  # whatever its first call loads
    found = []
    for _ in range(REPEATS):
        start = time.thread_time()
        probe()
        found.append(time.thread_time() - start)
    return min(found)


def _probes() -> dict[str, Callable[[], object]]:
    """A few milliseconds of each kind of work."""
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
