"""Overhead of a design study, and its throughput on up to 1,000 simulated workers.

python benchmarks/studies.py [--memory FOLDER] [--json FILE]
python benchmarks/studies.py --fast [--json FILE]

Row "measured": one real worker process computes the modulation at 60 cycles/m over random focus
distances. `client` is the CPU time of the client for each point, `point` the time of the worker.

Rows "simulated": the client, its store and the messages are real, the workers are not. A worker
takes a block, unpickles it, waits for as long as the plan predicts for its points, and pickles
numbers. `share` is the achieved throughput over that of workers that never wait, `blocks` the
blocks that are written in a second, and `busy` the client's CPU time over the time passed. Times on
the wall depend on what else the machine does; `client` is CPU time. `--memory` names a folder in
memory, which takes the disk away.

With `--fast`: yields of `examples/studies/tolerance_yield.toml` by the fast tier and by plain Monte
Carlo. Row "cost" has CPU seconds, and the seconds on the wall of the whole study as a command. In
the other rows, `full` and `fast` are shares of the same draws that meet a limit, `disagree` is the
number of draws that meet it by one tier alone, and `value`, `low` and `high` are the answer of the
fast study with its 95 % interval.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import json
import pickle
import resource
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import uuid
from concurrent.futures import Executor, Future
from pathlib import Path
from subprocess import DEVNULL

import numpy as np

from nlosoptics.study import Results, Study, fraction_within, plan_study, run_study, running
from nlosoptics.study.fast import fast_values
from nlosoptics.study.worker import Answers

STUDIES = Path(__file__).parents[1] / "examples" / "studies"
SCENE = str(Path(__file__).parents[1] / "examples" / "scenes" / "letter_flat.toml")
ROUNDS = 2  # blocks for each simulated worker
MOST_POINTS = 18_000
QUANTILES = 0.05, 0.2, 0.5  # of the figures, near which limits are set
SLOW = 300, 10.0  # workers of the last row, and how many seconds their blocks take


def made(count):
    """A study of random focus distances."""
    return Study.from_tables(
        {
            "scene": SCENE,
            "figures": [{"figure": "mtf", "frequency": 60.0}],
            "set": {"camera.binning": 16},
            "draws": {
                "count": count,
                "method": "random",
                "of": {"camera.focus_distance": {"from": "1.8 m", "to": "2.3 m"}},
            },
        }
    )


class Waiting(Executor):
    """Executor whose workers wait instead of computing; one thread keeps the time of all."""

    def __init__(self, workers, seconds):
        self._free = [0.0] * workers
        self._seconds = seconds
        self._due, self._order = [], itertools.count()
        self._more, self._ended = threading.Condition(), False
        self._timer = threading.Thread(target=self._keep_time, daemon=True)
        self._timer.start()

    def submit(self, function, /, key, block):
        block = pickle.loads(pickle.dumps((function, key, block)))[-1]
        future = Future()
        n = len(block.ids)
        answers = Answers(
            [[0.5]] * n, [[float("nan")]] * n, [[1]] * n, [[""]] * n, [self._seconds] * n
        )
        with self._more:
            begun = max(heapq.heappop(self._free), time.perf_counter())
            end = begun + n * self._seconds
            heapq.heappush(self._free, end)
            heapq.heappush(self._due, (end, next(self._order), future, pickle.dumps(answers)))
            self._more.notify()
        return future

    def _keep_time(self):
        while True:
            with self._more:
                if self._ended and not self._due:
                    return
                wait = self._due[0][0] - time.perf_counter() if self._due else None
                if wait is None or wait > 0.0:
                    self._more.wait(wait)
                    continue
                _, _, future, packed = heapq.heappop(self._due)
            future.set_result(pickle.loads(packed))

    def shutdown(self, wait=True, *, cancel_futures=False):
        with self._more:
            self._ended = True
            self._more.notify()
        self._timer.join()


class Simulated:
    """Engine with waiting workers."""

    def __init__(self, workers, seconds):
        self.key, self.workers, self._seconds = uuid.uuid4().hex, workers, seconds

    def start(self):
        return Waiting(self.workers, self._seconds)

    def close(self):
        pass


class Clock:
    """Progress callback that keeps the times of the first and the last block."""

    def __init__(self):
        self.begun = self.ended = None

    def __call__(self, text, share):
        now = time.perf_counter(), time.process_time()
        self.begun, self.ended = self.begun or now, now

    def passed(self):
        """Seconds on the wall and of CPU between them."""
        return tuple(end - begin for begin, end in zip(self.begun, self.ended, strict=True))


def measured(count):
    """A row for one real worker."""
    study, clock = made(count), Clock()
    with tempfile.TemporaryDirectory() as folder:
        results = run_study(study, f"{folder}/s.zarr", workers=1, progress=clock)
    return {
        "workers": 1,
        "kind": "measured",
        "points": count,
        "block": plan_study(study).block,
        "client": clock.passed()[1] / count,
        "point": float(results.dataset["seconds"].median()),
    }


def simulated(workers, store, folder, slow=1.0):
    """A row for some waiting workers, whose points take ``slow`` times as long as planned."""
    plan = plan_study(made(1000))
    seconds = slow * plan.seconds / plan.points
    count = min(ROUNDS * workers * plan.block, MOST_POINTS)
    study, clock = made(count), Clock()
    original = running._engine
    running._engine = lambda *given, **options: Simulated(workers, seconds)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            results = run_study(study, f"{place}/s.zarr", workers=workers, progress=clock)
            assert results.counts["done"] == count
    finally:
        running._engine = original
    wall, cpu = clock.passed()
    block = plan_study(study).block
    return {
        "workers": workers,
        "kind": f"simulated, store {store}",
        "points": count,
        "block": block,
        "client": cpu / count,
        "point": seconds,
        "throughput": count / wall,
        "share": count * seconds / workers / wall,
        "blocks": count / block / wall,
        "busy": cpu / wall,
    }


def fast_rows(count):
    """Rows of the fast tier against ``count`` draws in full."""
    tables = tomllib.loads((STUDIES / "tolerance_yield.toml").read_text())
    fast = Study.from_tables(tables, STUDIES)
    plain = {"count": count, "of": tables["draws"]["of"]}  # the first of the same Sobol draws
    full = Study.from_tables(tables | {"draws": plain}, STUDIES)
    cost = {"kind": "cost", "draws": len(fast), "checked": len(fast.in_full)}
    with tempfile.TemporaryDirectory() as folder:
        begun = _cpu()
        monte_carlo = run_study(full, f"{folder}/full.zarr")
        cost["in full, of a draw"] = (_cpu() - begun) / count
        fast_values(fast, fast.figures[:1])  # compiles
        begun = _cpu()
        fast_values(fast, fast.figures)
        cost["fast, of all draws"] = _cpu() - begun
        begun, started = _cpu(), time.perf_counter()
        program = Path(sys.executable).with_name("nlosoptics")
        command = [program, "study", STUDIES / "tolerance_yield.toml"]
        subprocess.run([*command, "--out", f"{folder}/fast.zarr"], check=True, stdout=DEVNULL)
        cost["whole study"] = _cpu() - begun
        cost["whole study, wall"] = time.perf_counter() - started
        checked = Results.load(f"{folder}/fast.zarr")
    yield cost
    for name in ("strehl", "mtf"):
        exact = monte_carlo.values(name)
        same = checked.values(name)[:count]
        for limit in np.quantile(exact, QUANTILES).round(2).tolist():
            found = fraction_within(checked, name, at_least=limit)
            yield {
                "kind": name,
                "limit": limit,
                "draws": count,
                "full": float((exact >= limit).mean()),
                "fast": float((same >= limit).mean()),
                "disagree": int(((exact >= limit) != (same >= limit)).sum()),
                "rms": float(np.sqrt(np.mean((exact - same) ** 2))),
                "value": found.value,
                "low": found.low,
                "high": found.high,
                "gained": found.gained,
                "lost": found.lost,
            }


def cpu_seconds():
    """CPU seconds of this process, and of its ended children."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return [one.ru_utime + one.ru_stime for one in used]


def _cpu():
    """CPU seconds of both."""
    return sum(cpu_seconds())


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--memory", type=Path, help="folder in memory, such as /dev/shm")
    parser.add_argument("--workers", type=int, nargs="+", default=[10, 30, 100, 1000])
    parser.add_argument("--points", type=int, default=200, help="of the measured row")
    parser.add_argument("--fast", action="store_true", help="rows of the fast tier alone")
    parser.add_argument("--draws", type=int, default=2048, help="in full, against the fast tier")
    options = parser.parse_args()
    rows = []

    def add(row):
        rows.append(row)
        print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()}, flush=True)

    stores = [("on disk", None)]
    if options.memory:
        stores.append(("in memory", options.memory))
    if options.fast:
        stores = []
        for row in fast_rows(options.draws):
            add(row)
    else:
        add(measured(options.points))
    for store, folder in stores:
        for workers in options.workers:
            add(simulated(workers, store, folder))
        add(simulated(SLOW[0], store, folder, slow=SLOW[1]))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
