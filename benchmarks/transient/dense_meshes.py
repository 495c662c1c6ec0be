"""Three bounces off a dragon of ever more triangles: seconds a pair of wall points, and error.

python benchmarks/transient/dense_meshes.py [--cells 0.05 0.025 0.0125] [--points 12] [--json FILE]

One sensor before N x N laser points, and N x N points that each are both; one thread. The dragon is
that of examples/phasor_study, in its corridor, of Lambert's reflectance. Errors are L1 over the
bins of each pair, in the mean, against a run with a thirtieth of the tolerance. Compiling is left
out.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "phasor_study"))
import phasor_scenes as scenes

from nlosoptics import transient

TOLERANCE = 0.01


def rendered(cell: float, points: int, pairing: str, tol: float) -> tuple[Any, float]:
    """A capture, and the seconds that it took."""
    wall = transient.wall_grid(scenes.SIDE, points)
    surfaces = scenes.surfaces("dragon", "lambert", cell=cell)
    start = time.perf_counter()
    capture = transient.render(
        surfaces,
        laser_points=wall,
        sensor_points=wall if pairing == "confocal" else np.zeros(3),
        pairing=pairing,
        t_start=1.0,
        delta_t=0.007,
        n_bins=1000,
        max_bounces=3,
        tol=tol,
        wall_size=scenes.ROOM[:2],
    )
    return capture, time.perf_counter() - start


def main() -> None:
    """Print a line for each mesh and pairing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=float, nargs="+", default=[0.05, 0.025, 0.0125], help="m")
    parser.add_argument("--points", type=int, default=12, help="on a side of the wall")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    numba.set_num_threads(1)
    lines = []
    for pairing in ("all", "confocal"):
        rendered(max(options.cells), 2, pairing, TOLERANCE)
        for cell in options.cells:
            found, seconds = rendered(cell, options.points, pairing, TOLERANCE)
            true, _ = rendered(cell, options.points, pairing, TOLERANCE / 30)
            wrong = np.abs(found.H - true.H).sum(axis=0) / true.H.sum(axis=0)
            count = sum(
                len(mesh.faces) for mesh, _ in scenes.surfaces("dragon", "lambert", cell=cell)
            )
            line = {
                "pairing": "one sensor" if pairing == "all" else pairing,
                "triangles": count,
                "pairs": options.points**2,
                "milliseconds_a_pair": 1e3 * seconds / options.points**2,
                "l1_mean": float(wrong.mean()),
            }
            print(json.dumps(line), flush=True)
            lines.append(json.dumps(line))
    if options.json:
        options.json.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
