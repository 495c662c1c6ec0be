"""What the peers' scripts of psf_peers.py share: the job, the timing, the answer.

A script gives builders. A builder takes a case, its orders (n, m) and a count of pupil samples,
sets up what coefficients do not change (aperture, polynomials, grids) and returns a function from
coefficients to the image's intensity. ``first`` is the set-up and one image together, ``seconds``
an image with the set-up kept, and what a library keeps by itself, least of several.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

ENOUGH = 1.0  # s of runs after which no more are timed


def timed(make, repeats):
    """Image, least seconds with the set-up kept, and seconds of set-up and one image."""
    start = time.perf_counter()
    image_of = make()
    image = image_of()
    first = time.perf_counter() - start
    best = np.inf
    begin = time.perf_counter()
    for _ in range(repeats):
        start = time.perf_counter()
        image = image_of()
        best = min(best, time.perf_counter() - start)
        if time.perf_counter() - begin > ENOUGH:
            break
    return image, best, first


def answer(name, builders, note=None):
    """Run the job on standard input; images as .npy files, JSON on standard output.

    ``note`` is a line that readers of the table should know.
    """
    job, rows = json.load(sys.stdin), []
    for case in job["cases"]:
        orders = [tuple(order) for order in case["orders"]]
        for label, (build, counts) in builders.items():
            for n in counts(case, job["samples"]):
                image, seconds, first = timed(
                    lambda build=build, case=case, orders=orders, n=n: build(case, orders, n),
                    job["repeats"],
                )
                path = Path(job["folder"]) / f"{name}-{len(rows)}.npy"
                np.save(path, image)
                rows.append(
                    {
                        "case": case["name"],
                        "name": f"{name}, {label}",
                        "samples": n,
                        "seconds": seconds,
                        "first": first,
                        "image": str(path),
                    }
                )
    json.dump({"version": version(name.lower()), "note": note, "rows": rows}, sys.stdout)


def grids(case, samples):
    """Pupil samples a side."""
    return samples


def once(case, samples):
    """A closed form, which there is without aberration."""
    return [] if case["orders"] else [0]
