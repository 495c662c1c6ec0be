"""Seconds and true error of what runs at a tolerance: fields of point spreads, and traced light.

python benchmarks/tolerances.py [--json FILE]

Each stage runs at tol = 1e-2 and 1e-4. The error of a field is that of the picture's image, rms
over rms, against twice as many nodes at a tenth of the smaller tol; that of a trace is against a
run with other random numbers to half of the smaller tol, whose own standard error is told.
`estimate` is what the stage says of itself. Times are of one run, all cores, kernels compiled.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import nlosoptics as nlos
from nlosoptics import imaging, psf, raytrace
from nlosoptics.imaging.image_fields import picture_frame
from nlosoptics.scene import ConcaveWall, Lambert

TOLS = (1e-2, 1e-4)
SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def scenes():
    """Scenes whose point spread changes over the picture, a little and much."""
    flat = nlos.Scene.load(SCENES / "letter_flat.toml")
    small = replace(flat, camera=replace(flat.camera, stop_diameter=4e-3))
    return {
        "field, flat wall": small,
        "field, hollow wall of 2.5 m": replace(small, wall=ConcaveWall(2.5)),
    }


def field_rows(name, scene):
    """A row for each tolerance."""
    picture = picture_frame(scene)

    def image(field):
        wide = psf.widened(field, tol=TOLS[-1] / 4, shape=picture.shape)
        return imaging.ForwardModel(wide, shape=picture.shape).forward(picture)

    imaging.image_field(scene, tol=0.1)  # compiles
    found = []
    for tol in TOLS:
        start = time.perf_counter()
        field, estimate = imaging.image_field(scene, tol=tol)
        found.append((tol, time.perf_counter() - start, estimate, field))
    nodes = 2 * round(found[-1][-1].weights[0].size ** 0.5)
    exact = image(psf.point_spread_field(scene, nodes, tol=TOLS[-1] / 10, checks=0))
    return [
        {
            "stage": name,
            "tol": tol,
            "seconds": seconds,
            "estimate": estimate,
            "error": float(np.sqrt(np.mean((image(field) - exact) ** 2) / np.mean(exact**2))),
            "work": f"{field.weights[0].size} point spreads in {len(field.modes)} modes",
        }
        for tol, seconds, estimate, field in found
    ]


def trace_rows(name, scene):
    """A row for each tolerance."""
    raytrace.trace(scene, n_rays=1024)
    exact = raytrace.trace(scene, tol=TOLS[-1] / 2, seed=1)
    doubt = exact.standard_error / exact.flux
    rows = []
    for tol in TOLS:
        found = raytrace.trace(scene, tol=tol, seed=0)
        rows.append(
            {
                "stage": name,
                "tol": tol,
                "seconds": found.seconds,
                "estimate": found.standard_error / found.flux,
                "error": abs(found.flux / exact.flux - 1),
                "work": f"{found.n_rays} rays, reference known to {doubt:.1g}",
            }
        )
    return rows


def main():
    """Print the table, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    print(f"{'stage':30s} {'tol':>7s} {'seconds':>8s} {'estimate':>9s} {'error':>8s}  work")
    rows = []
    jobs = [(field_rows, *item) for item in scenes().items()]
    for wall in ("flat", "concave"):
        scene = nlos.Scene.load(SCENES / f"letter_{wall}.toml")
        matt = replace(scene, wall_material=Lambert(0.7))
        jobs.append((trace_rows, f"trace, matt {wall} wall", matt))
    for run, name, scene in jobs:
        part = run(name, scene)
        for row in part:
            print(
                f"{row['stage']:30s} {row['tol']:7.0e} {row['seconds']:8.2f} "
                f"{row['estimate']:9.1e} {row['error']:8.1e}  {row['work']}",
                flush=True,
            )
        print(f"{name:30s} {part[-1]['seconds'] / part[0]['seconds']:.0f} times as long")
        rows += part
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
