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
FINE = 16384  # points a side of the pupil before they are averaged, at most 16 a sample


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


def transmission(pupil, x, y):
    """Fraction of each sample inside a pupil, averaged over points of it; x, y in pupil radii.

    A pupil has a hole of radius ``inner`` and ``vanes`` arms of a ``width``, the first along x, or
    ``polygons``, all convex and counterclockwise.
    """
    finer = max(4, min(16, FINE // len(x)))
    steps = (np.arange(finer) - (finer - 1) / 2) / finer * (x[1] - x[0])
    total = np.zeros((len(y), len(x)))
    for up in steps:
        for along in steps:
            u, v = x + along, (y + up)[:, None]
            total += (
                inside_polygons(pupil["polygons"], u, v)
                if "polygons" in pupil
                else (inside_vanes(pupil, u, v))
            )
    return total / finer**2


def inside_vanes(pupil, u, v):
    """Whether points are inside a ring with arms."""
    r = np.hypot(u, v)
    inside = (r < 1) & (r > pupil["inner"])
    for angle in 2 * np.pi * np.arange(pupil["vanes"]) / pupil["vanes"]:
        c, s = np.cos(angle), np.sin(angle)
        inside &= (c * u + s * v < 0) | (np.abs(c * v - s * u) > pupil["width"] / 2)
    return inside


def inside_polygons(polygons, u, v):
    """Number of polygons that hold each point."""
    held = np.zeros((len(v), len(u)))
    for corners in np.array(polygons):
        low, high = corners.min(axis=0), corners.max(axis=0)
        columns = slice(*np.searchsorted(u, [low[0], high[0]]))
        rows = slice(*np.searchsorted(v[:, 0], [low[1], high[1]]))
        part = np.ones_like(held[rows, columns], dtype=bool)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            step = b - a
            part &= step[0] * (v[rows] - a[1]) > step[1] * (u[columns] - a[0])
        held[rows, columns] += part
    return held


def grids(case, samples):
    """Pupil samples a side."""
    return samples


def once(case, samples):
    """A closed form, which there is without aberration."""
    return [] if case["orders"] or case["pupil"] else [0]
