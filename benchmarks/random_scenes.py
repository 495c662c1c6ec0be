"""Whether plans keep their word: random scenes planned and, where the plan accepts, simulated.

python benchmarks/random_scenes.py FILE [--first N] [--count N] [--most-seconds S] [--memory GIB]

Writes one JSON line a scene: even numbers at ordinary scales, odd ones wild. Scenes that FILE
holds are not run again. Every scene runs in a worker process of bounded memory, so that a crash
and a hang are told as what they are. Warnings are errors. Seconds are the process's own, of a
second run, whose kernels are compiled; memory is the rise of the resident peak.

python benchmarks/random_scenes.py FILE --summary
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import select
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "runs"))

PATIENCE = 8.0  # times the predicted seconds, and a constant, until a worker is ended
START = 60.0  # s, for imports and compilers


def resident(key):
    """Resident memory or its peak, bytes."""
    with Path("/proc/self/status").open() as lines:
        return next(1024.0 * float(line.split()[1]) for line in lines if line.startswith(key))


def not_finite(value, name="result"):
    """Names of float arrays within a noun that hold NaN or infinity."""
    import numpy as np

    if isinstance(value, np.ndarray) and value.dtype.kind in "fc":
        return [] if np.isfinite(value).all() else [name]
    if isinstance(value, float):
        return [] if math.isfinite(value) else [name]
    if not is_dataclass(value) or isinstance(value, type):
        return []
    parts = (f for f in fields(value) if f.name not in ("scene", "plan", "regime", "aperture"))
    return [n for f in parts for n in not_finite(getattr(value, f.name), f"{name}.{f.name}")]


def told(error, stage):
    """What an exception says."""
    from nlosoptics.errors import NlosError

    where = traceback.extract_tb(error.__traceback__)[-1]
    return {
        "outcome": f"{stage} refused" if isinstance(error, NlosError) else f"{stage} failed",
        "error": type(error).__name__,
        "message": str(error)[:400],
        "place": f"{Path(where.filename).name}:{where.lineno}",
    }


def run(number, most_seconds, memory):
    """One scene's row."""
    from random_scenes import random_case

    import nlosoptics as nlos
    from nlosoptics.errors import ValidityWarning

    row = {"number": number}
    try:
        case = random_case(number, wild=number % 2 == 1)
    except Exception as error:
        return row | told(error, "drawing")
    row |= case.drawn | {"tol": case.tol, "shape": list(case.scene.camera.shape)}
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("error")
        warnings.simplefilter("always", ValidityWarning)
        start = time.process_time()
        try:
            plan = nlos.plan(case.scene, case.tol, memory=memory)
        except Exception as error:
            return row | told(error, "plan") | {"plan_seconds": time.process_time() - start}
        start = time.process_time()
        nlos.plan(case.scene, case.tol, memory=memory)
        row["plan_seconds"] = time.process_time() - start
        row["predicted_total"] = plan.seconds
        row["memory"] = plan.memory
        if plan.seconds > most_seconds:
            return row | {"outcome": "too long to be run"}
        before = resident("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")
        try:
            start = time.process_time()
            result = nlos.simulate(case.scene, case.tol, seed=number, memory=memory)
            row["first"] = time.process_time() - start
            row["peak"] = resident("VmHWM") - before
            bad = not_finite(result)
            start = time.process_time()
            result = nlos.simulate(case.scene, case.tol, seed=number, memory=memory)
            row["warm"] = min(row["first"], time.process_time() - start)
        except Exception as error:
            return row | told(error, "simulate")
    spread = result.point_spread  # None for a matt wall
    row["method"], row["errors"] = spread and spread.method, result.errors
    return row | {"outcome": "NaN in " + ", ".join(bad) if bad else "done"}


def worker(most_seconds, memory):
    """Rows of the numbers that come by the standard input."""
    limit = int(memory + 6 * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for line in sys.stdin:
        print(json.dumps(run(int(line), most_seconds, memory)), flush=True)


class Worker:
    """A process that is started anew when it dies or is ended."""

    def __init__(self, options):
        self.options, self.process = options, None

    def row(self, number, most_seconds):
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, __file__, "-", "--worker", *self.options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        self.process.stdin.write(f"{number}\n")
        self.process.stdin.flush()
        patience = START + 2 * PATIENCE * most_seconds
        ready, _, _ = select.select([self.process.stdout], [], [], patience)
        line = self.process.stdout.readline() if ready else ""
        if line:
            return json.loads(line)
        if not ready:
            self.process.kill()
        code, self.process = self.process.wait(), None
        outcome = f"worker died with {code}" if ready else f"hung beyond {patience:g} s"
        return {"number": number, "outcome": outcome}


def rows_of(path):
    """Rows that a file holds, by number; the last one counts."""
    if not path.exists():
        return {}
    rows = (json.loads(line) for line in path.read_text().splitlines() if line.strip())
    return {row["number"]: row for row in rows}


def summary(rows):
    """Print counts of outcomes."""
    counts = Counter(r["outcome"] + (f" ({r['error']})" if "error" in r else "") for r in rows)
    for name, count in counts.most_common():
        print(f"{count:5d}  {name}")
    ratios = sorted(r["predicted_total"] / r["warm"] for r in rows if "warm" in r)
    if ratios:
        at = [ratios[int(q * (len(ratios) - 1))] for q in (0.02, 0.1, 0.5, 0.9, 0.98)]
        print("predicted/warm seconds at 2, 10, 50, 90, 98 %:", *(f"{r:.2f}" for r in at))
    over = sum(r["peak"] > max(r["memory"], 1) for r in rows if "peak" in r)
    print(f"memory above what was predicted: {over}")


def main():
    """Run what is missing, or sum up what there is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=10_000)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--most-seconds", type=float, default=20.0)
    parser.add_argument("--memory", type=float, default=3.0, help="GiB")
    parser.add_argument("--worker", action="store_true")
    parser.add_argument("--summary", action="store_true")
    args = parser.parse_args()
    if args.worker:
        return worker(args.most_seconds, args.memory * 2**30)
    done = rows_of(args.file)
    if args.summary:
        return summary(list(done.values()))
    options = ["--most-seconds", str(args.most_seconds), "--memory", str(args.memory)]
    one = Worker(options)
    with args.file.open("a") as out:
        for number in range(args.first, args.first + args.count):
            if number not in done:
                print(json.dumps(one.row(number, args.most_seconds)), file=out, flush=True)
    return summary(list(rows_of(args.file).values()))


if __name__ == "__main__":
    main()
