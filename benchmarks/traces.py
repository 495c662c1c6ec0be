"""Traces of Wu's scene: seconds against error, beside Mitsuba 3 and Optiland.

python benchmarks/traces.py [--peers-python PATH] [--seeds 16] [--json FILE]
python benchmarks/traces.py --growth         seconds, error and memory against the rays
python benchmarks/wu_scene.py                the flux by quadrature, which errors are held against

The flux is that of light which went from the laser's spot over the letter and the wall to the
detector. Its error is the standard deviation over independent seeds, relative; seconds are the
least of these runs, without compiling, and for the peers without loading the scene. All run on two
threads but Optiland, whose arrays keep one core busy. Peers run in an environment of their own, see
requirements-peers.txt; how their scenes are built, and why that is their best, is said in
peers/mitsuba_scene.py and peers/optiland_scene.py. trimesh's and embreex's rays are held against
ours in intersections.py.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import wu_scene

from nlosoptics import raytrace

HERE = Path(__file__).parent
THREADS = 2
GOALS = (1e-2, 1e-3)  # relative errors to which seconds are given
WIDE = 0.8  # m, a lens into which Optiland's rays find their way often enough to check the flux
FLUX = wu_scene.flux()
TRUTH = {reflections: FLUX[3] + FLUX[5] * (reflections == 5) for reflections in (3, 5)}


def our_runs(n_rays, seeds, reflections, sampler):
    """Fluxes and seconds of our tracer, with several seeds."""
    scene, fluxes, seconds = wu_scene.scene(), [], []
    for seed in range(-1, seeds):  # the first compiles
        start = time.perf_counter()
        paths = raytrace.trace(
            scene, n_rays=n_rays, max_bounces=reflections, sampler=sampler, seed=seed % 2**32
        )
        seconds.append(time.perf_counter() - start)
        fluxes.append(paths.flux)
    return {
        "name": f"nlosoptics, {sampler}",
        "reflections": reflections,
        "n_rays": n_rays,
        "flux": fluxes[1:],
        "seconds": seconds[1:],
    }


def peer(python, name, job):
    """What a peer's script says of a job, or None, with a line that says why."""
    if python is None:
        return None
    if not Path(python).is_file():
        print(f"{name} did not run: there is no {python}")
        return None
    run = subprocess.run(
        [python, HERE / "peers" / f"{name}_scene.py"],
        input=json.dumps({"scene": wu_scene.description(), **job}),
        capture_output=True,
        text=True,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        check=False,
    )
    if run.returncode:
        lines = run.stderr.strip().splitlines() or [f"exit status {run.returncode}"]
        print(f"{name} did not run: {lines[-1]}")
        return None
    return json.loads(run.stdout)


def with_errors(row):
    """The row with its errors against the truth."""
    truth, flux = TRUTH[row["reflections"]], np.array(row["flux"])
    return {
        **row,
        "seconds": min(row["seconds"]),
        "flux": float(flux.mean()),
        "relative_error": float(flux.std(ddof=1) / truth),
        "bias": float(flux.mean() / truth - 1),
        "bias_error": float(flux.std(ddof=1) / truth / math.sqrt(len(flux))),
    }


def slope(x, y):
    """Exponent and factor of the power law that fits best."""
    exponent, offset = np.polyfit(np.log(x), np.log(y), 1)
    return float(exponent), math.exp(offset)


def seconds_to(goal, rows):
    """Seconds to a relative error: rays by the fitted law, seconds by what these rays took.

    The law is 1/sqrt(n), but for low-discrepancy samplers, whose exponent is fitted: our Sobol
    points and those of Mitsuba's paths. Fewer rays than were run are taken to cost what the fewest
    did.
    """
    n, error, seconds = (
        np.array([row[key] for row in rows]) for key in ("n_rays", "relative_error", "seconds")
    )
    exponent, factor = -0.5, math.exp(np.log(error * np.sqrt(n)).mean())
    if rows[0]["name"] in ("nlosoptics, sobol", "Mitsuba, path"):
        exponent, factor = slope(n, error)
    needed = (goal / factor) ** (1 / exponent)
    return float(np.interp(needed, n, seconds) * max(1.0, needed / n[-1]))


def optiland_row(found):
    """Seconds to each goal by detections that will take, from the truth and its rays a second."""
    narrow, wide = found["rows"]
    spot = wu_scene.description()["spot_power"]
    weight = spot * wu_scene.LETTER_ALBEDO * wu_scene.WALL_ALBEDO * wu_scene.TRANSMISSION
    share = TRUTH[3] / weight  # of rays that are detected
    rate = narrow["n_rays"] / narrow["seconds"]
    expected = wu_scene.flux(stop=WIDE, letter=4, field=36, rings=4, wall=16)[3]
    return {
        "name": "Optiland, extrapolated",
        "version": found["version"],
        "reflections": 3,
        "rays_per_second": rate,
        "detected_share": share,
        "seconds_to": {goal: 1 / (goal**2 * share * rate) for goal in GOALS},
        "wide_lens_bias": wide["flux"] / expected - 1,
        "wide_lens_error": 1 / math.sqrt(wide["detections"]),
    }


def compare(options):
    """Print and return the rows of everyone."""
    rows = [
        our_runs(n_rays, options.seeds, reflections, sampler)
        for sampler in ("sobol", "philox")
        for reflections in (3, 5)
        for n_rays in (2**10, 2**12, 2**14, 2**16, 2**18)
    ]
    python = options.peers_python
    if python is None:
        print("no --peers-python PATH: nlosoptics alone")
    job = {
        "threads": THREADS,
        "reflections": [3, 5],
        "samples": [4, 16, 64, 256, 1024],
        "seeds": options.seeds,
    }
    mitsuba = peer(python, "mitsuba", job)
    if mitsuba:
        print(f"Mitsuba {mitsuba['version']} {mitsuba['variant']}")
        rows += [{**row, "name": f"Mitsuba, {row['name']}"} for row in mitsuba["rows"]]
    rows = [with_errors(row) for row in rows]
    print(
        f"{'by':24s} {'bounces':>7s} {'rays':>8s} {'ms':>9s} {'error':>9s} {'mean/truth - 1':>21s}"
    )
    for row in rows:
        print(
            f"{row['name']:24s} {row['reflections']:7d} {row['n_rays']:8d} "
            f"{1e3 * row['seconds']:9.2f} {row['relative_error']:9.1e} "
            f"{row['bias']:+10.1e} +- {row['bias_error']:.0e}"
        )
    stops = [wu_scene.STOP, WIDE]
    job = {"n_rays": options.optiland_rays, "reflections": 3, "seeds": 2, "stops": stops}
    optiland = peer(python, "optiland", job)
    extrapolated = [optiland_row(optiland)] if optiland else []
    print("\nseconds to a relative error")
    for name, reflections, part in series(rows):
        seconds = [f"{seconds_to(goal, part):.2g} s to {100 * goal:g} %" for goal in GOALS]
        print(f"{name:24s} {reflections:7d} bounces: {', '.join(seconds)}")
    for row in extrapolated:
        seconds = [f"{row['seconds_to'][goal]:.2g} s to {100 * goal:g} %" for goal in GOALS]
        print(
            f"{row['name']:24s} {3:7d} bounces: {', '.join(seconds)} (Optiland {row['version']}: "
            f"{row['rays_per_second']:.2g} rays/s, {row['detected_share']:.1e} of them detected; "
            f"with a lens of {WIDE} m {row['wide_lens_bias']:+.1%} +- {row['wide_lens_error']:.1%} "
            "from the truth)"
        )
    return rows, extrapolated


def series(rows):
    """Name, reflections and rows of each curve."""
    for key in dict.fromkeys((row["name"], row["reflections"]) for row in rows):
        yield *key, [row for row in rows if (row["name"], row["reflections"]) == key]


def peak_memory(n_rays):
    """Peak memory, MiB, of a process that traces so many rays."""
    run = subprocess.run(
        [sys.executable, __file__, "--peak", str(n_rays)],
        capture_output=True,
        text=True,
        check=True,
    )
    return float(run.stdout)


def print_peak(n_rays):
    """Trace and print the peak memory of this process, MiB."""
    import resource

    raytrace.trace(wu_scene.scene(), n_rays=n_rays, max_bounces=3)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(peak / (2**20 if sys.platform == "darwin" else 2**10))  # bytes there, KiB on Linux


def growth(options):
    """Print and return how seconds, errors and memory grow with the rays."""
    counts, rows = [2**k for k in (12, 14, 16, 18, 20)], []
    for sampler in ("sobol", "philox"):
        part = [with_errors(our_runs(n, options.seeds, 3, sampler)) for n in counts]
        rows += part
        errors, seconds = ([row[key] for row in part] for key in ("relative_error", "seconds"))
        for n, error, time_taken in zip(counts, errors, seconds, strict=True):
            print(f"{sampler:8s} {n:9d} rays {time_taken:8.3f} s, error {error:.1e}")
        print(
            f"{sampler:8s} seconds ~ rays^{slope(counts, seconds)[0]:.2f}, "
            f"error ~ rays^{slope(counts, errors)[0]:.2f}"
        )
    for n in counts:
        peak = peak_memory(n)
        print(f"{n:9d} rays: peak {peak:.0f} MiB")
        rows.append({"name": "peak memory", "n_rays": n, "MiB": peak})
    return rows


def main():
    """Print the table, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers-python", metavar="PATH", help="interpreter that has the peers")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--optiland-rays", type=int, default=1_000_000)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--peak", type=int, metavar="RAYS", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = str(THREADS)  # read when the first trace begins
    if options.peak:
        print_peak(options.peak)
        return
    print(f"truth: {TRUTH[3]:.7e} W by 3 reflections, {TRUTH[5]:.7e} W by up to 5")
    if options.growth:
        rows = growth(options)
    else:
        measured, extrapolated = compare(options)
        rows = measured + extrapolated
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
