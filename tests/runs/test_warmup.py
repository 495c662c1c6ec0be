"""Kernels compiled beforehand."""

from __future__ import annotations

from numba.core import event

from nlosoptics import simulate
from nlosoptics.runs.warmup import warm_up


class Compilations(event.Listener):
    """Names of the functions that numba compiles while this listens."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event) -> None:
        self.names.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event) -> None:
        pass


def test_a_warmed_up_run_compiles_nothing(flat_scene) -> None:
    told = []
    warm_up(progress=lambda text, fraction: told.append((text, fraction)))
    assert told == [("scene 1 of 2", 0.0), ("scene 2 of 2", 0.5)]
    with event.install_listener("numba:compile", Compilations()) as compiled:
        simulate(flat_scene, seed=0)
    assert compiled.names == []
