"""Whole commands from start to exit: wall and CPU seconds, peak memory, seconds of each stage.

python benchmarks/whole_run.py [--against CHECKOUT] [--repeats N] [--cases NAME ...] [--json FILE]

Each case is a process of its own. "warm" finds every compiled kernel in numba's cache; "cold"
starts with an empty cache. Python's own bytecode is compiled beforehand, as pip does when it
installs. With ``--against`` the same cases run from another checkout of this repository, in turn
with those of this one, so that both see the same load. Figures are medians over the repeats; cold
runs are made once. "outside" is the wall time that ``result.json`` does not list. Where a stage
compiles kernels, its seconds in the cold run minus those in the warm one are the price of
compilation.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parents[1]
COMMAND = (sys.executable, "-c", "from nlosoptics.cli import main; main()")
FEASIBILITY = """
import json, time
from nlosoptics import Scene, limits
scene = Scene.load("examples/scenes/letter_flat.toml")
def seconds(clock):
    start = clock()
    limits.feasibility(scene)
    return clock() - start
seconds(time.perf_counter)
wall, cpu = (sorted(seconds(clock) for _ in range(9))[4]
             for clock in (time.perf_counter, time.process_time))
print(json.dumps({"wall": wall, "cpu": cpu}))
"""
FLAT, WAVY, CORNER = (
    f"examples/scenes/{name}.toml" for name in ("letter_flat", "letter_wavy", "corner")
)
CASES = {
    "run letter_flat 512, cold": ("run", FLAT),  # first: the others use the cache that it fills
    "run letter_flat 512, warm": ("run", FLAT),
    "run letter_flat 128, warm": ("run", FLAT, "--size", "128"),
    "run letter_wavy 512, warm": ("run", WAVY),
    "run corner, warm": ("run", CORNER),
    "plan letter_flat, warm": ("plan", FLAT),
    "help": ("--help",),
    "limits.feasibility": (),
}


def surroundings(checkout, cache):
    """Return the environment of a process that imports a checkout."""
    found = {**os.environ, "PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(cache)}
    found.pop("PYTHONDONTWRITEBYTECODE", None)
    return found


def measured(words, checkout, cache, out):
    """Run one command; return wall and CPU seconds, peak memory and the stages of its record."""
    environment = surroundings(checkout, cache)
    written = ["--out", str(out)] if words[0] == "run" else []
    start = time.perf_counter()
    process = subprocess.Popen(
        [*COMMAND, *words, *written],
        cwd=checkout,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    told = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(words)} in {checkout} failed: {told.decode()}")
    row = {"wall": wall, "cpu": used.ru_utime + used.ru_stime, "peak_mib": used.ru_maxrss / 1024}
    if written:
        stages = json.loads((out / "result.json").read_text())["seconds"]
        row["stages"] = {**stages, "outside": wall - stages["total"]}
    return row


def feasibility(checkout, cache):
    """Return seconds of one warm call, without the process around it."""
    environment = surroundings(checkout, cache)
    found = subprocess.run(
        [sys.executable, "-c", FEASIBILITY],
        cwd=checkout,
        env=environment,
        capture_output=True,
        check=True,
    )
    return json.loads(found.stdout)


def middle(rows):
    """Return the medians of rows of the same case, stage by stage."""
    found = {key: median(row[key] for row in rows) for key in rows[0] if key != "stages"}
    if "stages" in rows[0]:
        names = rows[0]["stages"]
        found["stages"] = {name: median(row["stages"][name] for row in rows) for name in names}
    return found


def case_rows(name, checkouts, caches, repeats):
    """Measure one case in all checkouts in turn; return a row for each checkout."""
    words, cold = CASES[name], name.endswith("cold")
    found = {label: [] for label in checkouts}
    for number in range(1 if cold else repeats + 1):
        for label, checkout in checkouts.items():
            with TemporaryDirectory() as folder:
                cache, out = caches[label], Path(folder, "out")
                if cold and cache.exists():
                    cache = Path(folder, "cache")
                if words:
                    one = measured(words, checkout, cache, out)
                else:
                    one = feasibility(checkout, cache)
            if cold or number:  # the first warm run fills the cache
                found[label].append(one)
    return [{"case": name, "checkout": label, **middle(rows)} for label, rows in found.items()]


def main():
    """Print the table, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, metavar="CHECKOUT")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    checkouts = {"this": HERE}
    if options.against is not None:
        checkouts["other"] = options.against.resolve()
    rows = []
    for checkout in checkouts.values():
        compileall.compile_dir(checkout / "nlosoptics", quiet=1)
    with TemporaryDirectory() as folder:
        caches = {label: Path(folder, label) for label in checkouts}
        print(f"{'case':28s} {'checkout':8s} {'wall s':>8s} {'CPU s':>8s} {'MiB':>6s}")
        for name in options.cases:
            for row in case_rows(name, checkouts, caches, options.repeats):
                peak = f"{row['peak_mib']:6.0f}" if "peak_mib" in row else 6 * " "
                print(
                    f"{name:28s} {row['checkout']:8s} {row['wall']:8.3f} {row['cpu']:8.3f} {peak}",
                    flush=True,
                )
                for stage, seconds in row.get("stages", {}).items():
                    print(f"    {stage:30s} {seconds:8.3f}")
                rows.append(row)
            first, *others = rows[-len(checkouts) :]
            for other in others:
                ratios = first["wall"] / other["wall"], first["cpu"] / other["cpu"]
                print(f"    this / other: {ratios[0]:.2f} of the wall, {ratios[1]:.2f} of the CPU")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
