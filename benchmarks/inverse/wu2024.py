"""One image, by the published PCIN and by the evidence; a line a case.

python benchmarks/inverse/wu2024.py [--recipes wu2024] [--walls 6] [--rms 0.25 0.5 1]
    [--objects F arrow ...] [--folder PICTURES] [--size 64] [--json FILE] [--jobs 2]
python benchmarks/inverse/wu2024.py --changes none alternate=1 network_input=noise --rms 0.5

Data by the simulator (cases.py). Each object is seen by each wall. --folder holds objects as PNG
files, such as those of outside_objects.py. --changes names options of wu2024_fit, one change a
run. With --json, one line for each finished case, and those already there are not run again.
"""

from __future__ import annotations

import argparse
import ast
import json
import multiprocessing
import time
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

#: What tells one case from another.
KEY = ("recipe", "change", "object", "wall", "rms", "size", "limit")


def pupil(data, size):
    """Point spread with free coefficients, for a case."""
    from cases import MODES

    from nlosoptics.inverse import PupilPSF

    return PupilPSF.from_zernike(MODES, shape=size, pixel_integrated=True, **data.pupil)


def changed(change):
    """Options of a change, such as alternate=1 or network_input=noise."""
    if change == "none":
        return {}
    name, value = change.split("=")
    return {name: value if value.isalpha() else ast.literal_eval(value)}


@lru_cache(maxsize=64)
def images(name, wall, rms, size, noise):
    """Data of a case, made once for all recipes and changes."""
    from cases import case

    return case(name, wall, rms_waves=rms, size=size, noise=noise)


def one_case(job):
    """One object seen by one wall, by one method."""
    key, folder, noise = job
    from nlosoptics.inverse import Measurement, pcin, registered_correlation

    name = str(folder / f"{key['object']}.png") if folder else key["object"]
    data = images(name, key["wall"], key["rms"], key["size"], noise)
    before = time.process_time()
    found = pcin(
        Measurement(data.images, noise_sigma=float(data.noise_sigma[0])),
        pupil(data, key["size"]),
        recipe=key["recipe"],
        max_iterations=key["limit"],
        seed=key["wall"],
        **changed(key["change"]),
    )
    return key | {
        "image": round(registered_correlation(data.images[0], data.truth), 4),
        "correlation": round(registered_correlation(found, data.truth), 4),
        "like_image": round(registered_correlation(found, data.images[0]), 4),
        "status": found.status,
        "score": round(found.score, 4),
        "wave_rms": round(float(np.linalg.norm(found.physical_parameters["coefficients"])), 4),
        "iterations": len(found.history["objective"]),
        "seconds": round(found.seconds, 1),
        "cpu_seconds": round(time.process_time() - before, 1),
    }


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
    parser.add_argument("--recipes", nargs="+", default=["wu2024"])
    parser.add_argument("--changes", nargs="+", default=["none"])
    parser.add_argument("--walls", type=int, default=6)
    parser.add_argument("--first-wall", type=int, default=100)
    parser.add_argument("--rms", type=float, nargs="+", default=[0.25, 0.5, 1.0])
    parser.add_argument("--objects", nargs="+", default=["F", "arrow", "hanzi_zhong"])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--iterations", type=int, help="default: that of the recipe")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    done = set()
    if options.json and options.json.exists():
        lines = map(json.loads, options.json.read_text().splitlines())
        done = {tuple(line.get(name) for name in KEY) for line in lines}
    walls = range(options.first_wall, options.first_wall + options.walls)
    values = [
        (recipe, change, name, wall, rms, options.size, options.iterations)
        for recipe in options.recipes
        for change in options.changes
        for rms in options.rms
        for wall in walls
        for name in options.objects
    ]
    jobs = [
        (dict(zip(KEY, some, strict=True)), options.folder, options.noise)
        for some in values
        if some not in done
    ]
    fresh = multiprocessing.get_context("spawn")
    with fresh.Pool(options.jobs, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for line in pool.imap_unordered(one_case, jobs):
            keep(line, options.json)


if __name__ == "__main__":
    main()
