"""Two workers against one and against a plain loop; what a study adds to points of little work.

python benchmarks/study_workers.py [--points N] [--loop N] [--light N] [--json FILE]

Row "heavy": Wu's scene with random focus distances, Strehl ratio and modulation at 60 cycles/m from
a point spread of each. `one` and `two` are seconds on the wall of a study with one and two workers,
`loop` those of `simulate` called for the first `--loop` points, scaled to all points. All three
start without the point spreads of the others.

Row "light": laser powers and exposures, whose Strehl ratio comes from one point spread. `client`
and `worker` are CPU seconds for each point, `share` is the client's share of both, and `grown` is
the growth of the client's memory while the second half of the points is computed, MiB.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import tempfile
import time
from pathlib import Path

from studies import cpu_seconds

import nlosoptics as nlos
from nlosoptics.study import Study, run_study

SCENE = str(Path(__file__).parents[1] / "examples" / "scenes" / "letter_flat.toml")
FIGURES = ["strehl", {"figure": "mtf", "frequency": 60.0}]
FOCUS = {"camera.focus_distance": {"from": "1.8 m", "to": "2.3 m"}}


def heavy(points, looped):
    """Seconds of a study with one and two workers, and of a plain loop."""
    draws = {"count": points, "method": "random", "of": FOCUS}
    study = Study.from_tables({"scene": SCENE, "figures": FIGURES, "draws": draws})
    row = {"kind": "heavy", "points": points, "loop points": looped}
    with tempfile.TemporaryDirectory() as folder:
        for name, workers in (("one", 1), ("two", 2)):
            begun = time.perf_counter()
            results = run_study(study, f"{folder}/{name}.zarr", workers=workers)
            row[name] = time.perf_counter() - begun
            assert results.counts["done"] == points
        scenes = [results.scene(i) for i in range(looped)]
    nlos.simulate(scenes[0])  # imports
    begun = time.perf_counter()
    for scene in scenes:
        nlos.simulate(scene)
    row["loop"] = (time.perf_counter() - begun) / looped * points
    return row | {"one / two": row["one"] / row["two"], "loop / two": row["loop"] / row["two"]}


def light(points):
    """CPU time and memory of points that share their point spread."""
    side = math.isqrt(points)
    axes = {
        "laser.power": {"from": "1 mW", "to": "50 mW", "count": side},
        "camera.exposure": {"from": "1 ms", "to": "50 ms", "count": side},
    }
    study = Study.from_tables({"scene": SCENE, "figures": ["strehl"], "axes": axes})
    memory = {}

    def progress(text, share):
        if share >= 0.5:
            memory.setdefault("half", _resident())
            memory["end"] = _resident()

    with tempfile.TemporaryDirectory() as folder:
        begun = cpu_seconds()
        run_study(study, f"{folder}/light.zarr", workers=1, progress=progress)
        client, worker = (
            (after - before) / side**2 for before, after in zip(begun, cpu_seconds(), strict=True)
        )
    return {
        "kind": "light",
        "points": side**2,
        "client": client,
        "worker": worker,
        "share": client / (client + worker),
        "grown": (memory["end"] - memory["half"]) / 2**20,
    }


def _resident():
    """Resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--loop", type=int, default=30, help="points of the plain loop")
    parser.add_argument("--light", type=int, default=100_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for row in (light(options.light), heavy(options.points, options.loop)):
        rows.append(row)
        print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
