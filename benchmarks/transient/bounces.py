"""Four and five bounces in a corridor: seconds to 1 % error per bin, beside mitransient.

python benchmarks/transient/bounces.py [--size 32] [--peer-python PATH] [--json FILE]

A letter Z stands in a corridor of 2 x 2 x 3 m before a wall of 2 m; the laser's spot is at the
middle, bins are 1 cm wide up to 8 m. Both programs draw two captures of independent seeds; the
relative L1 error of one at a sensor is what they differ by, summed over the bins, over the root of
2 and the light. Errors fall as the root of the samples, here checked for both by a second number of
them, so that the seconds to 1 % are those of a run times (error/1 %)^2. The median and the largest
over the sensors are given. Seconds are those of the processor here, of the clock for mitransient.
Totals are compared, too. mitransient follows paths along the lobes: aiming at hidden geometry
counts the letter twice, see peers/mitransient_scene.py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

from nlosoptics import transient
from nlosoptics.scene import Lambert
from nlosoptics.transient.rendering.multiple_bounces import multiple_bounces
from nlosoptics.transient.rendering.surfaces import hidden_surfaces

PEERS = Path(__file__).parents[1] / "peers"
ORDERS = (4, 5)
BINS, WIDTH = 800, 0.01
GOAL = 0.01
LASER = (-0.5, 0.0, 0.25)
#: Radiosity per area of the spot over G: a source of 100 W/sr at LASER.
PEER_SCALE = 100.0 * 0.25 / (0.5**2 + 0.25**2) ** 1.5


def quad(a, b, c, d):
    """Two triangles."""
    return [[a, b, c], [a, c, d]]


def surfaces():
    """Triangles and albedos by name, fronts into the corridor."""
    low, high = -1.0, 1.0
    letter = [
        quad((-0.35, 0.24, 1), (-0.35, 0.4, 1), (0.35, 0.4, 1), (0.35, 0.24, 1)),
        quad((-0.35, -0.4, 1), (-0.35, -0.24, 1), (0.35, -0.24, 1), (0.35, -0.4, 1)),
        quad((-0.35, -0.24, 1), (0.158, 0.24, 1), (0.35, 0.24, 1), (-0.158, -0.24, 1)),
    ]
    triangles = {
        "letter": [t for part in letter for t in part],
        "floor": quad((low, low, 0), (low, low, 3), (high, low, 3), (high, low, 0)),
        "ceiling": quad((low, high, 0), (high, high, 0), (high, high, 3), (low, high, 3)),
        "left": quad((low, low, 0), (low, high, 0), (low, high, 3), (low, low, 3)),
        "right": quad((high, low, 0), (high, low, 3), (high, high, 3), (high, high, 0)),
        "back": quad((low, low, 3), (low, high, 3), (high, high, 3), (high, low, 3)),
    }
    return triangles, {name: 0.8 if name == "letter" else 0.6 for name in triangles}


def ours(size, n_rays):
    """Two captures (bins, sensors) by order, and the seconds of each."""
    triangles, albedos = surfaces()
    things = []
    for name, corners in triangles.items():
        points = np.asarray(corners, dtype=np.float64).reshape(-1, 3)
        faces = np.arange(len(points)).reshape(-1, 3)
        things.append((trimesh.Trimesh(points, faces, process=False), Lambert(albedos[name])))
    hidden = hidden_surfaces(things)
    captures, seconds = [], []
    for seed in (2, 0, 1):  # the first compiles
        start = time.process_time()
        found = multiple_bounces(
            hidden,
            [0.0, 0.0, 0.0],
            transient.wall_grid(2.0, size),
            wall_size=(2.0, 2.0),
            delta_t=WIDTH,
            n_bins=BINS,
            orders=ORDERS,
            tol=None,
            n_rays=n_rays if seed < 2 else 1 << 14,
            seed=seed,
        )
        seconds.append(time.process_time() - start)
        captures.append(found.by_bounce)
    return {n: [c[n].reshape(BINS, -1) for c in captures[1:]] for n in ORDERS}, seconds[1:]


def theirs(python, size, samples, order):
    """Two captures (bins, sensors) of mitransient in our unit, and the seconds of each; or None."""
    triangles, albedos = surfaces()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "light.npz"
        job = {
            "triangles": triangles,
            "albedos": albedos,
            "half_side": 1.0,
            "laser": LASER,
            "target": (0.0, 0.0, 0.0),
            "size": size,
            "bins": BINS,
            "bin_width": WIDTH,
            "start": 0.0,
            "bounces": order,
            "samples": samples,
            "seeds": 2,
            "aimed": False,
            "out": str(out),
        }
        run = subprocess.run(
            [python, PEERS / "mitransient_scene.py"],
            input=json.dumps(job),
            capture_output=True,
            text=True,
            env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
            check=False,
        )
        if run.returncode:
            lines = run.stderr.strip().splitlines() or [f"exit status {run.returncode}"]
            print(f"mitransient did not run: {lines[-1]}")
            return None
        light = np.load(out)["light"].astype(np.float64) / PEER_SCALE
    captures = [np.moveaxis(c, -1, 0).reshape(BINS, -1) for c in light]
    return captures, json.loads(run.stdout.strip().splitlines()[-1])["seconds"]


def row(name, size, order, samples, captures, seconds):
    """Errors of two captures, and the seconds to the goal."""
    first, second = captures
    light = 0.5 * (first + second).sum(axis=0)
    errors = np.abs(first - second).sum(axis=0) / np.sqrt(2.0) / light
    least = min(seconds)
    return {
        "name": name,
        "size": size,
        "bounces": order,
        "samples": samples,
        "seconds": least,
        "total": float(light.mean()),
        "l1_median": float(np.median(errors)),
        "l1_max": float(errors.max()),
        "seconds_to_goal_median": least * (float(np.median(errors)) / GOAL) ** 2,
        "seconds_to_goal_max": least * (float(errors.max()) / GOAL) ** 2,
    }


def main():
    """Print a line for each program, number of bounces and number of samples."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=32, help="sensors along each side")
    parser.add_argument("--rays", type=int, nargs="*", default=[1 << 20, 1 << 22])
    parser.add_argument("--samples", type=int, nargs="*", default=[1000, 4000])
    parser.add_argument("--peer-python")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []

    def tell(line):
        rows.append(line)
        print(json.dumps(line), flush=True)

    for n_rays in options.rays:
        captures, seconds = ours(options.size, n_rays)
        for order in ORDERS:
            tell(row("nlosoptics", options.size, order, n_rays, captures[order], seconds))
    for samples in options.samples if options.peer_python else ():
        for order in ORDERS:
            found = theirs(options.peer_python, options.size, samples, order)
            if found is not None:
                tell(row("mitransient", options.size, order, samples, *found))
    if options.json:
        options.json.write_text("".join(json.dumps(line) + "\n" for line in rows))


if __name__ == "__main__":
    sys.exit(main())
