"""PCIN as published, from random angles and one image: correlation, status, seconds.

python benchmarks/inverse/wu2024.py [--walls 6] [--rms 0.25 0.5 1] [--objects F arrow ...]
    [--size 64] [--json FILE] [--jobs 2]

Data by the simulator (cases.py). Each object is seen by each wall. With --json, one line for each
finished case, and those already there are not run again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from pathlib import Path

import numpy as np
import torch


def pupil(data, size):
    from cases import MODES

    from nlosoptics.inverse import PupilPSF

    return PupilPSF.from_zernike(MODES, shape=size, pixel_integrated=True, **data.pupil)


def row(data, found, name, wall, rms, options):
    """One line of the table."""
    from nlosoptics.inverse import registered_correlation

    return {
        "object": name,
        "wall": wall,
        "rms": rms,
        "start": "cold",
        "size": options.size,
        "image": round(registered_correlation(data.images[0], data.truth), 4),
        "correlation": round(registered_correlation(found, data.truth), 4),
        "like_image": round(registered_correlation(found, data.images[0]), 4),
        "status": found.status,
        "score": round(found.score, 4),
        "strehl": round(found.physical_parameters["strehl"], 4),
        "wave_rms": round(float(np.linalg.norm(found.physical_parameters["coefficients"])), 4),
        "iterations": int(found.physical_parameters["iterations"]),
        "seconds": round(found.seconds, 1),
    }


def one_case(job):
    """One object seen by one wall."""
    name, wall, rms, options = job
    from cases import case

    from nlosoptics.inverse import Measurement, wu2024_fit

    data = case(name, wall, rms_waves=rms, size=options.size, noise=options.noise)
    measured = Measurement(data.images, noise_sigma=float(data.noise_sigma[0]))
    found = wu2024_fit(
        measured,
        pupil(data, options.size),
        max_iterations=options.iterations,
        seed=wall,
        base=options.base,
    )
    return row(data, found, name, wall, rms, options)


def keep(line, path):
    """Print a line and add it to a file, if there is one."""
    text = json.dumps(line)
    print(text, flush=True)
    if path:
        with path.open("a") as file:
            file.write(text + "\n")


def main():
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--walls", type=int, default=6)
    parser.add_argument("--first-wall", type=int, default=100)
    parser.add_argument("--rms", type=float, nargs="+", default=[0.25, 0.5, 1.0])
    parser.add_argument("--objects", nargs="+", default=["F", "arrow", "hanzi_zhong"])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--base", type=int, default=8)
    parser.add_argument("--iterations", type=int, default=4000)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    done = set()
    if options.json and options.json.exists():
        lines = map(json.loads, options.json.read_text().splitlines())
        done = {(line["object"], line["wall"], line["rms"]) for line in lines}
    walls = range(options.first_wall, options.first_wall + options.walls)
    keys = [(name, wall, rms) for rms in options.rms for wall in walls for name in options.objects]
    jobs = [(*key, options) for key in keys if key not in done]
    fresh = multiprocessing.get_context("spawn")
    with fresh.Pool(options.jobs, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for line in pool.imap_unordered(one_case, jobs):
            keep(line, options.json)


if __name__ == "__main__":
    main()
