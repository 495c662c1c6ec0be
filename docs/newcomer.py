"""Walk a newcomer's ways in and print the seconds of each step: ``python docs/newcomer.py``.

An empty folder has only the built wheel, in a new environment. Each way is a few commands: a first
picture, a photograph, a design study, an analysis, and time-resolved light. The first run compiles.
``--installed`` uses this Python's environment as it is. Ends with exit status 1 if a step failed or
the first picture took more than a minute, and prints the output of what failed.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: A photograph as a telephone stores it: colours, 8 bits, sRGB, JPEG, out of focus by 3 pixels.
PHOTOGRAPH = """
import numpy as np
from PIL import Image
from scipy.signal import fftconvolve

rng, view = np.random.default_rng(1), np.full((240, 320, 3), 0.3)
for _ in range(60):
    y, x, high, wide = rng.integers(0, (240, 320, 60, 60))
    view[y : y + high + 6, x : x + wide + 6] = rng.uniform(0.05, 0.9, 3)
disc = np.hypot(*(np.indices((7, 7)) - 3)) <= 3
light = np.stack([fftconvolve(view[..., k], disc / disc.sum(), "same") for k in range(3)], -1)
light = (light + rng.normal(0, 0.005, light.shape)).clip(0, 1)
code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
Image.fromarray(np.rint(255 * code).astype(np.uint8)).save("phone.jpg", quality=92)
"""

#: Three axes: 3 x 3 x 2 points.
STUDY = """
scene = "room.toml"
figures = ["spot_rms", "predicted_correlation"]
set = { "camera.binning" = 64 }
[axes]
"camera.f_number" = [2, 4, 8]
"wall.radius" = ["3 m", "5 m", "10 m"]
"laser.power" = ["1 mW", "5 mW"]
"""

#: The same sweep in Python, with its map.
SWEEP = """
import nlosoptics as nlos
from nlosoptics import study, views

scene = nlos.Scene.load("design/room.toml").with_values({"camera.binning": 64})
axes = {"camera.f_number": [2, 4, 8], "wall.radius": [3, 5, 10], "laser.power": ["1 mW", "5 mW"]}
views.save(views.study_map(study.sweep(scene, axes, ["spot_rms"]), "spot_rms"), "sweep.png")
"""

WAYS = {
    "first picture": ("nlosoptics new room.toml", "nlosoptics run room.toml --size 64"),
    "example by name": ("nlosoptics plan corner", "nlosoptics report room"),
    "photograph": ("nlosoptics deblur phone.jpg --disc 3 --gamma srgb",),
    "unknown object": (
        "nlosoptics new mine.toml --kind photo",
        "nlosoptics reconstruct photo.png --scene mine.toml --out mine",
    ),
    "design": (
        "nlosoptics new design/room.toml --kind design",
        "nlosoptics analyse design/room.toml",
        "cp study.toml design/sweep.toml",
        "nlosoptics study design/sweep.toml --workers 0 --picture spot_rms",
        "nlosoptics study plot sweep.zarr spot_rms --x camera.f_number --y wall.radius "
        "--at 'laser.power=5 mW' --out map.png",
        "python sweep.py",
    ),
    "shadows": ("nlosoptics new matt.toml --kind shadows", "nlosoptics run matt.toml"),
    "time-resolved": (
        "nlosoptics new time.toml --kind transient",
        "nlosoptics transient time.toml --tol 0.02 --out time.hdf5",
        "nlosoptics image time.hdf5 --out time",
    ),
}


class Walk:
    """Steps in one folder, with their seconds."""

    def __init__(self, folder: Path, environment: Path | None) -> None:
        self.folder, self.failed, self.total = folder, False, 0.0
        self._variables = os.environ | {"NUMBA_CACHE_DIR": str(folder / "numba")}
        if environment is not None:
            path = f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}"
            self._variables |= {"PATH": path, "VIRTUAL_ENV": str(environment)}
            self._variables.pop("PYTHONPATH", None)  # what is installed is tried, nothing else

    def __call__(self, step: str, command: str) -> None:
        """Run a shell command in the folder and print its seconds."""
        start, before = time.perf_counter(), os.times()
        done = subprocess.run(
            ["/bin/bash", "-c", command],
            cwd=self.folder,
            env=self._variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        seconds, after = time.perf_counter() - start, os.times()
        self.total += seconds
        cpu = sum(after[2:4]) - sum(before[2:4])  # of children, user and system
        print(f"{seconds:7.1f} s, CPU {cpu:5.1f} s  {step}: {command}", flush=True)
        if done.returncode:
            self.failed = True
            print(f"failed with {done.returncode}:\n{done.stdout[-3000:]}", flush=True)


def walked(work: Path, installed: bool) -> bool:
    """Walk all ways in an empty folder; return whether all went well."""
    folder = work / "empty"
    (folder / "design").mkdir(parents=True)
    (folder / "study.toml").write_text(STUDY)
    (folder / "sweep.py").write_text(SWEEP)
    (folder / "photograph.py").write_text(PHOTOGRAPH)
    walk = Walk(folder, None if installed else work / "env")
    if installed:
        program = "import sys; from nlosoptics.cli import main; main()"
        tool = folder / "nlosoptics"
        tool.write_text(f"#!/bin/sh\nexec {shlex.quote(sys.executable)} -c '{program}' \"$@\"\n")
        tool.chmod(0o755)
        python = Path(sys.executable).parent  # for the steps in Python
        walk._variables["PATH"] = os.pathsep.join([str(folder), str(python), os.environ["PATH"]])
    else:
        walk("environment", f"{shlex.quote(sys.executable)} -m venv {work / 'env'}")
        walk("wheel", f"pip wheel -q --no-deps --wheel-dir {work} {shlex.quote(str(ROOT))}")
        limits = shlex.quote(str(ROOT / "constraints.txt"))
        walk("installation", f'pip install -q -c {limits} "$(echo {work}/nlosoptics-*.whl)[all]"')
    walk("a photograph", "python photograph.py")
    for name, commands in WAYS.items():
        before = walk.total
        for command in commands:
            walk(name, command)
        print(f"{walk.total - before:7.1f} s {name:>14s}, in all", flush=True)
        walk.failed |= name == "first picture" and walk.total - before > 60.0
    return not walk.failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--installed", action="store_true", help="Use this Python's environment.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        passed = walked(Path(work), options.installed)
    sys.exit(not passed)
