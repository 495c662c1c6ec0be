"""Kernels compiled beforehand."""

from __future__ import annotations

import pytest
from numba.core import event

from nlosoptics import plan, raytrace, simulate
from nlosoptics.runs import warmup


class Compilations(event.Listener):
    """Names of the functions that numba compiles while this listens."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event) -> None:
        self.names.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event) -> None:
        pass


@pytest.mark.thorough
def test_a_warmed_up_run_and_its_report_compile_nothing(flat_scene) -> None:
    told = []
    scenes = warmup._letters()[:2]
    warmup.warm_up(scenes, progress=lambda text, fraction: told.append((text, fraction)))
    assert told == [("scene 1 of 2", 0.0), ("scene 2 of 2", 0.5)]
    with event.install_listener("numba:compile", Compilations()) as compiled:
        simulate(flat_scene, seed=0)
        raytrace.trace(flat_scene, n_rays=64, keep_paths=True)
    assert compiled.names == []


def test_the_scenes_cover_walls_with_kernels_of_their_own() -> None:
    scenes = warmup._letters()
    walls = {type(scene.wall).__name__ for scene in scenes}
    assert walls == {"FlatWall", "WavyWall", "ConcaveWall", "MeshWall"}
    assert any(scene.occluders for scene in scenes)
    assert any(scene.wall_roughness is not None for scene in scenes)
    for scene in scenes:
        planned = plan(scene)
        assert planned.runs("image")
