"""Traces of four scenes: processor time against error, beside Mitsuba 3 and Optiland.

python benchmarks/traces.py [--peers-python PATH] [--seeds 32] [--json FILE]
python benchmarks/traces.py --optiland       Optiland's time for the letter, extrapolated
python benchmarks/traces.py --growth         seconds, error and memory against the rays
python benchmarks/wu_scene.py                the letter's flux by quadrature

The flux is that of light which went from the laser's spot over the object and the wall to the
detector, with three reflections. Its error is the standard deviation over independent seeds,
relative to the flux. Both programs run on one thread, in turns seed by seed, and their time is the
median processor time of a run, without compiling, and for the peers without loading the scene. The
mean fluxes of both must agree within three standard errors over many more runs, or nothing is
written. Peers run in an environment of their own, see requirements-peers.txt; how their scenes are
built, and why that is their best, is said in peers/mitsuba_scene.py and peers/optiland_scene.py.
trimesh's and embreex's rays are held against ours in intersections.py.
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
CHECKS, FIRST_CHECK = (
    60,
    1000,
)  # runs of Mitsuba that its fluxes are checked by, and their first seed
WIDE = 0.8  # m, a lens into which Optiland's rays find their way often enough to check the flux
FLUX = wu_scene.flux()


def our_run(scene, n_rays, seed, sampler="sobol"):
    """Flux and processor time of one trace."""
    start = time.process_time()
    paths = raytrace.trace(
        scene, n_rays=n_rays, max_bounces=traced_scenes.REFLECTIONS, sampler=sampler, seed=seed
    )
    return paths.flux, time.process_time() - start


def environment():
    """The environment of a peer's process, which must not see our packages."""
    return {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}


class Mitsuba:
    """Mitsuba in a process of its own that answers jobs."""

    def __init__(self, python):
        self.process = subprocess.Popen(
            [python, HERE / "peers" / "mitsuba_scene.py"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment(),
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
    head = {}
    runs = {(OURS, n_rays): [] for n_rays in RAYS}
    if mitsuba is not None:
        head = mitsuba.answer(
            scene=traced_scenes.description(scene),
            threads=THREADS,
            reflections=traced_scenes.REFLECTIONS,
        )
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
    if not rows[0]["name"].endswith(("ptracer, aimed", "philox")):
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
    least = [
        min((t[k] for key, t in times.items() if key != OURS), default=math.nan) for k in (0, 1)
    ]
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


def optiland(options):
    """Seconds to each goal by detections that will take, from the truth and its rays a second."""
    stops = [wu_scene.STOP, WIDE]
    job = {"n_rays": options.optiland_rays, "reflections": 3, "seeds": 2, "stops": stops}
    run = subprocess.run(
        [options.peers_python, HERE / "peers" / "optiland_scene.py"],
        input=json.dumps({"scene": wu_scene.description(), **job}),
        stdout=subprocess.PIPE,
        text=True,
        env=environment(),
        check=True,
    )
    found = json.loads(run.stdout)
    narrow, wide = found["rows"]
    spot = wu_scene.description()["spot_power"]
    weight = spot * wu_scene.LETTER_ALBEDO * wu_scene.WALL_ALBEDO * wu_scene.TRANSMISSION
    share = FLUX[3] / weight  # of rays that are detected
    rate = narrow["n_rays"] / narrow["seconds"]
    expected = wu_scene.flux(stop=WIDE, letter=4, field=36, rings=4, wall=16)[3]
    for goal in GOALS:
        print(f"{found['version']}: {1 / (goal**2 * share * rate):.2g} s to {100 * goal:g} %")
    bias, error = wide["flux"] / expected - 1, 1 / math.sqrt(wide["detections"])
    print(f"with a lens of {WIDE} m {bias:+.1%} +- {error:.1%} from the truth")


def compare(options):
    """Print and return the rows of both programs, and those of the summaries."""
    if options.peers_python is None:
        print("no --peers-python PATH: nlosoptics alone")
    mitsuba = None if options.peers_python is None else Mitsuba(options.peers_python)
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
        for key, times in found["seconds_to"].items():
            print(
                f"{key:30s} "
                + ", ".join(
                    f"{t:.2g} s to {100 * goal:g} %" for goal, t in zip(GOALS, times, strict=True)
                )
            )
        print(f"flux {found['flux']:.6e} +- {found['flux_error']:.1e} W")
        for key, apart in found["standard_errors_apart"].items():
            print(f"{key}: {found['peer_flux'][key]:.6e} W, {apart:+.1f} standard errors off")
        if mitsuba is not None:
            print("Mitsuba's least time over ours:", ", ".join(f"{r:.3g}" for r in found["ratios"]))
        rows += part
        summaries.append(found)
    if mitsuba is not None:
        mitsuba.close()
    letter = summaries[0]
    print(
        f"\nletter by quadrature: {FLUX[3]:.7e} W, ours is "
        f"{(letter['flux'] - FLUX[3]) / letter['flux_error']:+.1f} standard errors off"
    )
    return rows, summaries


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
    counts, rows, scene = [2**k for k in (12, 14, 16, 18, 20)], [], wu_scene.scene()
    for sampler in ("sobol", "philox"):
        part = []
        for n in counts:
            runs = [our_run(scene, n, seed, sampler) for seed in range(options.seeds)]
            flux, seconds = zip(*runs, strict=True)
            part.append(
                with_errors({"name": sampler, "n_rays": n, "flux": flux, "seconds": seconds})
            )
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
    parser.add_argument("--seeds", type=int, default=32)
    parser.add_argument("--optiland", action="store_true", help="its seconds for the letter, alone")
    parser.add_argument("--optiland-rays", type=int, default=1_000_000)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--peak", type=int, metavar="RAYS", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = str(THREADS)  # read when the first trace begins
    if options.peak:
        print_peak(options.peak)
        return
    if options.growth:
        growth(options)
        return
    if options.optiland:
        optiland(options)
        return
    rows, summaries = compare(options)
    if options.json:
        apart = [abs(a) for s in summaries for a in s["standard_errors_apart"].values()]
        if not apart or max(apart) > MOST_APART:
            raise SystemExit(f"{options.json} was not written: the fluxes do not agree")
        options.json.write_text(json.dumps({"scenes": summaries, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
