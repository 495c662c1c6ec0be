"""Seconds and sizes of 3-D pictures, and frames per second of many paths.

    python benchmarks/views.py            prints, and writes results/views.json

The PNG is timed in processes of their own, imports included, its scene file read and its paths
traced; kernels are compiled beforehand. Frames are drawn off the screen, one degree apart.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "examples" / "scenes" / "letter_wavy.toml"
PATHS, SEGMENTS, FRAMES, RUNS = 500, 10_000, 20, 3
PROGRAM = """
import sys, time
start = time.perf_counter()
from nlosoptics import views
from nlosoptics.raytrace import trace
from nlosoptics.scene import Scene
scene = Scene.load(sys.argv[1])
paths = trace(scene, n_rays=512, keep_paths=True)
traced = time.perf_counter()
views.rendering_works()
tried = time.perf_counter()
views.save(views.ray_paths(paths, scene, most=int(sys.argv[3])), sys.argv[2])
print(traced - start, tried - traced, time.perf_counter() - tried)
"""


def png_seconds(folder: Path) -> dict[str, float]:
    """Best of the runs: the whole, and its parts."""
    runs = []
    for _ in range(RUNS):
        words = [sys.executable, "-c", PROGRAM, str(SCENE), str(folder / "room.png"), str(PATHS)]
        began = time.perf_counter()
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        runs.append((time.perf_counter() - began, *map(float, said.split())))
    names = ("process", "scene_and_paths", "trial_of_rendering", "picture_with_pyvista")
    return dict(zip(names, min(runs), strict=True))


def sizes(folder: Path) -> dict[str, float]:
    """Megabytes of the files, and seconds to write them."""
    from nlosoptics import views
    from nlosoptics.raytrace import trace
    from nlosoptics.scene import Scene

    scene = Scene.load(SCENE)
    plotter = views.ray_paths(trace(scene, n_rays=512, keep_paths=True), scene, most=PATHS)
    found = {}
    for suffix in ("html", "glb"):
        began = time.perf_counter()
        views.save(plotter, folder / f"room.{suffix}")
        found[f"{suffix}_seconds"] = time.perf_counter() - began
        found[f"{suffix}_megabytes"] = (folder / f"room.{suffix}").stat().st_size / 1e6
    return found


def frames() -> dict[str, Any]:
    """Frames per second of a room with so many legs of paths."""
    from nlosoptics import views
    from nlosoptics.raytrace import trace
    from nlosoptics.scene import Scene

    scene = Scene.load(SCENE)
    paths = trace(scene, n_rays=4096, keep_paths=True, max_bounces=3)
    plotter = views.ray_paths(paths, scene, most=math.ceil(SEGMENTS / 4))
    drawn = plotter.actors["ray paths"].mapper.dataset.n_cells
    plotter.screenshot(None, return_img=True)  # compiles the shaders
    seconds = []
    for _ in range(FRAMES):
        began = time.perf_counter()
        plotter.camera.azimuth += 1.0
        plotter.render()  # a screenshot alone would show the frame before
        plotter.render_window.WaitForCompletion()
        seconds.append(time.perf_counter() - began)
    return {
        "segments": drawn,
        "window": list(plotter.window_size),
        "frames_per_second": 1.0 / float(np.median(seconds)),
        "renderer": _renderer(plotter),
    }


def _renderer(plotter: Any) -> str:
    told = plotter.render_window.ReportCapabilities().splitlines()
    return next((line.split(":", 1)[1].strip() for line in told if "renderer string" in line), "")


def main() -> None:
    """Measure, print and write."""
    import matplotlib
    import pyvista
    import vtk

    with tempfile.TemporaryDirectory() as name:
        found = {
            "scene": SCENE.name,
            "paths": PATHS,
            "png_seconds": png_seconds(Path(name)),
            "files": sizes(Path(name)),
            "frames": frames(),
            "cores": os.cpu_count(),
            "load_average": os.getloadavg()[0],
            "versions": {
                "pyvista": pyvista.__version__,
                "vtk": vtk.vtkVersion().GetVTKVersion(),
                "matplotlib": matplotlib.__version__,
            },
        }
    print(json.dumps(found, indent=2))
    target = ROOT / "benchmarks" / "results" / "views.json"
    target.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
