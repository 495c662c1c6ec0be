"""Two workers against one and against a plain loop; what a study adds to points of little work.

python benchmarks/study_workers.py [--points N] [--loop N] [--light N] [--repeats N] [--json FILE]

Row "heavy": Wu's scene with random focus distances, Strehl ratio and modulation at 60 cycles/m from
a point spread of each. `one` and `two` are seconds on the wall of a study with one and two workers,
medians of `--repeats` runs in turn, `ratios` those of each pair of runs. `loop` are the seconds of
`simulate` called for the first `--loop` points, scaled to all points. All start without the point
spreads of the others.

Row "light": laser powers and exposures, whose Strehl ratio comes from one point spread.

In both rows, with one worker: `client` and `worker` are CPU seconds for each point, of the client
from the first to the last block, of the worker with its start; `share` is the client's share of
both, `block` the number of points that a worker computes at a time, and `grown` the growth of the
client's memory while the second half of the points is computed, MiB.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import statistics
import tempfile
import time
from pathlib import Path

import nlosoptics as nlos
from nlosoptics.study import Study, plan_study, run_study

SCENE = str(Path(__file__).parents[1] / "examples" / "scenes" / "letter_flat.toml")
FIGURES = ["strehl", {"figure": "mtf", "frequency": 60.0}]
FOCUS = {"camera.focus_distance": {"from": "1.8 m", "to": "2.3 m"}}


class Watch:
    """Progress callback that keeps times, and the client's memory over the second half."""

    begun = ended = half = None

    def passed(self):
        """Seconds on the wall and of CPU from the first to the last block."""
        return tuple(end - begin for begin, end in zip(self.begun, self.ended, strict=True))

    def __call__(self, text, share):
        now = time.perf_counter(), time.process_time()
        self.begun, self.ended = self.begun or now, now
        if share >= 0.5:
            self.last = _resident()
            self.half = self.half or self.last


def cpu_seconds():
    """CPU seconds of this process, and of its ended children."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return [one.ru_utime + one.ru_stime for one in used]


def with_one_worker(kind, study, store):
    """The row of a study with one worker, and its results."""
    watch, block, before = Watch(), plan_study(study).block, cpu_seconds()
    begun = time.perf_counter()
    results = run_study(study, store, workers=1, progress=watch)
    one = time.perf_counter() - begun
    points = results.counts["done"]
    assert points == len(study)
    client, worker = (watch.ended - watch.begun) / points, (cpu_seconds() - before) / points
    row = {"kind": kind, "points": points, "one": one, "client": client, "worker": worker}
    grown = (watch.last - watch.half) / 2**20
    return row | {"share": client / (client + worker), "block": block, "grown": grown}, results


def heavy(points, looped, repeats):
    """Row of points with a point spread each; also with two workers, and in a plain loop."""
    draws = {"count": points, "method": "random", "of": FOCUS}
    study = Study.from_tables({"scene": SCENE, "figures": FIGURES, "draws": draws})
    with tempfile.TemporaryDirectory() as folder:
        pairs = []
        for number in range(repeats):
            row, results = with_one_worker("heavy", study, f"{folder}/one{number}.zarr")
            begun = time.perf_counter()
            again = run_study(study, f"{folder}/two{number}.zarr", workers=2)
            pairs.append((row["one"], time.perf_counter() - begun))
            assert again.counts["done"] == points
        row["one"], row["two"] = map(statistics.median, zip(*pairs, strict=True))
        row["ratios"] = [round(one / two, 3) for one, two in pairs]
        scenes = [results.scene(i) for i in range(looped)]
    nlos.simulate(scenes[0])  # imports
    begun = time.perf_counter()
    for scene in scenes:
        nlos.simulate(scene)
    row["loop"] = (time.perf_counter() - begun) / looped * points
    ratios = {f"{name} / two": row[name] / row["two"] for name in ("one", "loop")}
    return row | {"loop points": looped} | ratios


def light(points):
    """Row of points that share their point spread."""
    side = math.isqrt(points)
    axes = {
        "laser.power": {"from": "1 mW", "to": "50 mW", "count": side},
        "camera.exposure": {"from": "1 ms", "to": "50 ms", "count": side},
    }
    study = Study.from_tables({"scene": SCENE, "figures": ["strehl"], "axes": axes})
    with tempfile.TemporaryDirectory() as folder:
        return with_one_worker("light", study, f"{folder}/light.zarr")[0]


def _resident():
    """Resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--loop", type=int, default=30, help="points of the plain loop")
    parser.add_argument("--light", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=3, help="pairs of runs of the row heavy")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for row in (light(options.light), heavy(options.points, options.loop, options.repeats)):
        rows.append(row)
        print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
