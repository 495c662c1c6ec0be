"""Fixtures shared by every test."""

from __future__ import annotations

import gc
import math
import os
import re
import signal
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from .chromium import page

__all__ = ["page"]

ROOT = Path(__file__).parents[1]
# Workers share the cores: libraries compute on one thread each. Compiled code may have two, for the
# tests that compare thread counts; must be said before numpy, numba and torch are imported.
os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
os.environ["NUMBA_NUM_THREADS"] = "2"
# The search for garbage looks at all collected tests each time. It took two fifths of the time of
# the collection. The commands of the package have the same threshold.
gc.set_threshold(200_000)

FENCE = re.compile(r"^```([\w-]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def pytest_collection_finish() -> None:
    """Exempt tests and libraries from the search for garbage, because they stay until the end."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> None:
    """Compiled code runs on one thread, but where a test asks for more by `on_threads`."""
    import numba

    numba.set_num_threads(1)


@pytest.fixture
def on_threads() -> Callable[[int, Callable[[], Any]], Any]:
    """``on_threads(count, call)``: what a call gives on so many threads of compiled code."""
    import numba

    def run(count: int, call: Callable[[], Any]) -> Any:
        numba.set_num_threads(count)
        try:
            return call()
        finally:
            numba.set_num_threads(1)

    return run


class _Limit(float):
    """A limit that keeps what is compared with it."""

    def __init__(self, _: float) -> None:
        self.seen: list[float] = []

    def __lt__(self, need: float) -> bool:
        self.seen.append(float(need))
        return float(self) < need


@pytest.fixture
def memory_of() -> Callable[[Callable[[], Any]], tuple[float, float]]:
    """``memory_of(call)``: the most memory that a call takes, and that it says to need, bytes.

    The first is that of Python and numpy, without that of compiled libraries.
    """
    from nlosoptics._checks import Budget, within

    def measured(call: Callable[[], Any]) -> tuple[float, float]:
        call()  # imports, compiles, and fills caches
        limit = _Limit(math.inf)
        tracemalloc.start()
        try:
            with within(Budget(memory=limit, seconds=math.inf)):
                call()
            return tracemalloc.get_traced_memory()[1], max(limit.seen, default=0.0)
        finally:
            tracemalloc.stop()

    return measured


@pytest.fixture(scope="session")
def root() -> Path:
    """Folder of the checkout, which holds the README, the examples and the package."""
    return ROOT


@pytest.fixture(scope="session")
def examples(root: Path) -> Path:
    """Folder of the example scenes and their pictures."""
    return root / "examples"


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the larger recorded data, named by NLOSOPTICS_DATA."""
    folder = os.environ.get("NLOSOPTICS_DATA")
    if not folder:
        pytest.skip("NLOSOPTICS_DATA names no data folder")
    if not Path(folder).is_dir():
        pytest.fail(f"NLOSOPTICS_DATA = {folder} is not a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def code_blocks() -> Callable[[Path, str], list[str]]:
    """The code blocks of a Markdown page in one language, in their order."""

    def found(page: Path, language: str) -> list[str]:
        return [code for name, code in FENCE.findall(page.read_text()) if name == language]

    return found


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also where the shell that starts the tests ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def flat_scene():
    """Wu 2024's distances: object 1 m from wall and camera, a letter-sized bright square."""
    import numpy as np

    from nlosoptics.scene import Camera, FlatWall, Laser, PlanarObject, Scene

    x = 0.3798
    picture = np.zeros((32, 32))
    picture[6:26, 8:24] = 1.0
    hit = 0.8 / 1.8
    return Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.6, 0.3, 1.1)),
        FlatWall(),
        PlanarObject(picture, 0.3, position=(x, 0.0, 1.0)),
        Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(-0.6 + (x + 0.6) * hit, 0.0, 0.0),
            focal_length=0.0506415,
            stop_diameter=0.025,
            pixels=(4096, 4096),
            binning=64,
        ),
    )
