"""Traces of four scenes: processor time against error, and Mitsuba 3.

python benchmarks/traces.py --peers-python PATH [--seeds 32] [--json FILE]
python benchmarks/wu_scene.py                the letter's flux by quadrature

The flux is that of light which went from the laser's spot over the object and the wall to the
detector, with three reflections. Its error is the standard deviation over independent seeds,
relative to the flux. Both programs run on one thread, in turns seed by seed, and their time is the
median processor time of a run, without compiling, and for the peers without loading the scene. The
mean fluxes of both must agree within three standard errors over many more runs, or nothing is
written. Peers run in an environment of their own, see requirements-peers.txt; how their scenes are
built, and why that is their best, is said in peers/mitsuba_scene.py.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import traced_scenes
import wu_scene

from nlosoptics import raytrace

HERE = Path(__file__).parent
THREADS = 1
GOALS = (1e-2, 1e-3)  # relative errors to which seconds are given
MOST_APART = 3.0  # standard errors between the fluxes of two programs
RAYS = tuple(2**k for k in range(7, 17))
SAMPLES = (4, 16, 64, 256)  # a pixel of Mitsuba's film
OURS = "nlosoptics"
# runs of Mitsuba that its fluxes are checked by, and their first seed
CHECKS, FIRST_CHECK = 60, 1000
FLUX = wu_scene.flux()


def our_run(scene, n_rays, seed):
    """Flux and processor time of one trace."""
    start = time.process_time()
    paths = raytrace.trace(scene, n_rays=n_rays, max_bounces=traced_scenes.REFLECTIONS, seed=seed)
    return paths.flux, time.process_time() - start


class Mitsuba:
    """Mitsuba in a process of its own that answers jobs."""

    def __init__(self, python):
        self.process = subprocess.Popen(
            [python, HERE / "peers" / "mitsuba_scene.py"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        )

    def answer(self, **job):
        """What the process says of a job."""
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"Mitsuba ended with {self.process.wait()}; its message is above")
        return json.loads(line)

    def close(self):
        """End the process."""
        self.process.stdin.close()
        self.process.wait()


def side_by_side(name, scene, mitsuba, seeds):
    """Rows of each program, way and number of rays, whose runs took turns."""
    head = mitsuba.answer(
        scene=traced_scenes.description(scene),
        threads=THREADS,
        reflections=traced_scenes.REFLECTIONS,
    )
    runs = {(OURS, n_rays): [] for n_rays in RAYS}
    runs |= {(way, samples): [] for way in head["ways"] for samples in SAMPLES}
    for seed in range(-1, seeds):  # the first compiles
        for (way, amount), found in runs.items():
            if way == OURS:
                flux, seconds = our_run(scene, amount, seed % 2**32)
                run = {"flux": flux, "seconds": seconds, "n_rays": amount}
            else:
                run = mitsuba.answer(way=way, samples=amount, seed=seed % 2**20)
            if seed >= 0:
                found.append(run)
    return [
        with_errors(
            {
                "scene": name,
                "name": way if way == OURS else f"Mitsuba {head['version']}, {way}",
                "n_rays": found[0]["n_rays"],
                "flux": [run["flux"] for run in found],
                "seconds": [run["seconds"] for run in found],
            }
        )
        for (way, _), found in runs.items()
    ]


def with_errors(row):
    """The row with mean flux, relative error, and median seconds."""
    flux = np.array(row["flux"])
    mean = float(flux.mean())
    return {
        **row,
        "seconds": float(np.median(row["seconds"])),
        "flux": mean,
        "flux_error": float(flux.std(ddof=1) / math.sqrt(len(flux))),
        "relative_error": float(flux.std(ddof=1) / abs(mean)),
    }


def slope(x, y):
    """Exponent and factor of the power law that fits best."""
    exponent, offset = np.polyfit(np.log(x), np.log(y), 1)
    return float(exponent), math.exp(offset)


def seconds_to(goal, rows):
    """Seconds to a relative error, by the power law between rays and error.

    The law is 1/sqrt(n) for independent samples, and fitted for the low-discrepancy points of ours
    and of Mitsuba's paths. Seconds are those that so many rays took, those of the fewest rays below
    and in proportion to the rays beyond the most.
    """
    n, error, seconds = (
        np.array([row[key] for row in rows]) for key in ("n_rays", "relative_error", "seconds")
    )
    exponent, factor = -0.5, math.exp(np.log(error * np.sqrt(n)).mean())
    if not rows[0]["name"].endswith("ptracer, aimed"):
        exponent, factor = slope(n, error)
    needed = (goal / factor) ** (1 / exponent)
    return float(np.interp(needed, n, seconds) * max(1.0, needed / n[-1]))


def check_fluxes(ways, mitsuba):
    """Mean flux of many more of Mitsuba's runs by name, with its standard error."""
    found = {}
    for name, way in ways.items():
        flux = [
            mitsuba.answer(way=way, samples=SAMPLES[-1], seed=FIRST_CHECK + k)["flux"]
            for k in range(CHECKS)
        ]
        found[name] = float(np.mean(flux)), float(np.std(flux, ddof=1) / math.sqrt(CHECKS))
    return found


def summary(name, rows, checks):
    """Seconds to each goal of both programs, their ratio, and how far the fluxes are apart.

    ``checks`` are those of `check_fluxes`; our flux is that of the runs with the most rays.
    """
    curves = dict(series(rows))
    times = {key: [seconds_to(goal, part) for goal in GOALS] for key, part in curves.items()}
    ours = max(curves[OURS], key=lambda row: row["n_rays"])
    least = [min(t[k] for key, t in times.items() if key != OURS) for k in (0, 1)]
    return {
        "scene": name,
        "goals": GOALS,
        "seconds_to": times,
        "ratios": [peer / our for peer, our in zip(least, times[OURS], strict=True)],
        "flux": ours["flux"],
        "flux_error": ours["flux_error"],
        "peer_flux": {key: flux for key, (flux, _) in checks.items()},
        "standard_errors_apart": {
            key: (flux - ours["flux"]) / math.hypot(error, ours["flux_error"])
            for key, (flux, error) in checks.items()
        },
    }


def series(rows):
    """Name and rows of each curve."""
    for key in dict.fromkeys(row["name"] for row in rows):
        yield key, [row for row in rows if row["name"] == key]


def compare(options):
    """Print and return the rows of both programs, and those of the summaries."""
    mitsuba = Mitsuba(options.peers_python)
    rows, summaries = [], []
    for name, scene in traced_scenes.scenes().items():
        part = side_by_side(name, scene, mitsuba, options.seeds)
        print(f"\n{name}\n{'by':30s} {'rays':>8s} {'CPU ms':>9s} {'error':>9s}")
        for row in part:
            print(
                f"{row['name']:30s} {row['n_rays']:8d} {1e3 * row['seconds']:9.2f} "
                f"{row['relative_error']:9.1e}"
            )
        ways = {row["name"]: row["name"].split(", ", 1)[1] for row in part if row["name"] != OURS}
        found = summary(name, part, check_fluxes(ways, mitsuba))
        print(json.dumps(found, indent=1))
        rows += part
        summaries.append(found)
    mitsuba.close()
    letter = summaries[0]
    print(
        f"\nletter by quadrature: {FLUX[3]:.7e} W, ours is "
        f"{(letter['flux'] - FLUX[3]) / letter['flux_error']:+.1f} standard errors off"
    )
    return rows, summaries


def main():
    """Print the table, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers-python", required=True, help="interpreter that has Mitsuba")
    parser.add_argument("--seeds", type=int, default=32)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = str(THREADS)  # read when the first trace begins
    rows, summaries = compare(options)
    if options.json:
        apart = [abs(a) for s in summaries for a in s["standard_errors_apart"].values()]
        if max(apart) > MOST_APART:
            raise SystemExit(f"{options.json} was not written: the fluxes do not agree")
        options.json.write_text(json.dumps({"scenes": summaries, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
