"""Whether the intervals of traced fluxes hold, over many seeds and ten scenes.

python benchmarks/trace_coverage.py [--seeds N] [--json FILE.jsonl]

For each scene: the share of runs whose flux lies within 1 and 1.96 standard errors of a run with
many rays, the same for the number of reflections that does worst, and the share of runs that call
the flux uncertain. FILE holds one line per scene, and scenes that it holds are not run again. Takes
about 3 minutes of one core.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from nlosoptics.raytrace import trace
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
    WavyWall,
)

FINE = 1 << 18  # rays of the run that the others are compared with


def room(wall, wall_material, material, stop):
    """Laser, wall, a plate at an angle, and a camera that looks at the wall."""
    return Scene(
        Laser(wavelength=633e-9, power=2.0, beam_diameter=0.003, position=(-0.1, 0.8, 0.9)),
        wall,
        PlanarObject(np.ones((1, 1)), 0.6, position=(0.35, -0.05, 0.5), yaw=0.3, material=material),
        Camera(
            position=(-0.45, 0.0, 0.6),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=stop,
            focus_distance=0.9,
            transmission=0.9,
            pixel_pitch=1e-3,
            pixels=(120, 120),
            binning=1,
        ),
        wall_material=wall_material,
    )


def glossy(slope, albedo=0.4, reflectance=0.4):
    """Paint and a mirror-like lobe."""
    return SumMaterial(Lambert(albedo), SpecularMicrofacet(reflectance, slope))


def scenes():
    """Name, scene, largest number of reflections and number of rays of each case."""
    size = (2.0, 2.0)
    flat, convex = FlatWall(size=size), ConvexWall(2.0, size=size)
    paint, card, mirror = Lambert(0.7), Lambert(0.8), SpecularMicrofacet(0.9, 0.0)
    ward = SumMaterial(Lambert(0.4), Ward(0.4, 0.03))
    return [
        ("matt", room(flat, paint, card, 0.0125), 5, 1024),
        ("mirror on mirror", room(flat, glossy(0.0), mirror, 0.0125), 5, 1024),
        ("mirror on mirror, wide stop", room(flat, glossy(0.0), mirror, 0.4), 5, 1024),
        ("mirror on convex mirror", room(convex, glossy(0.0), mirror, 0.0125), 5, 1024),
        (
            "mirror on hollow mirror",
            room(ConcaveWall(5.0, size=size), glossy(0.0), mirror, 0.0125),
            3,
            1024,
        ),
        ("lobes of 1e-4 rad", room(flat, glossy(1e-4), glossy(1e-4), 0.0125), 5, 1024),
        ("lobes of 0.01 rad", room(flat, ward, glossy(0.01), 0.05), 5, 1024),
        ("lobes of 0.05 rad", room(convex, glossy(0.05), glossy(0.05), 0.05), 5, 1024),
        ("deep wave", room(WavyWall(0.1, 0.4, size=size), paint, card, 0.05), 5, 4096),
        ("hollow", room(ConcaveWall(1.5, size=size), paint, card, 0.05), 7, 4096),
    ]


def coverage(values, errors, truth, truth_error):
    """Shares of the values within 1 and 1.96 of their standard errors from the truth."""
    off = np.abs(values - truth) / np.hypot(np.maximum(errors, 1e-300), truth_error)
    return float(np.mean(off < 1.0)), float(np.mean(off < 1.96))


def measured(name, scene, most, n_rays, seeds):
    """Row of one scene."""
    start = time.process_time()
    fine = trace(scene, n_rays=FINE, max_bounces=most, seed=10**6)
    runs = [trace(scene, n_rays=n_rays, max_bounces=most, seed=1000 + k) for k in range(seeds)]
    flux = np.array([run.flux for run in runs])
    error = np.array([run.standard_error for run in runs])
    within = coverage(flux, error, fine.flux, fine.standard_error)
    by_bounce = {}
    for k in range(1, most + 1):
        if fine.by_bounce[k] > 0.0:
            values = np.array([run.by_bounce[k] for run in runs])
            errors = np.array([run.by_bounce_error[k] for run in runs])
            by_bounce[k] = coverage(values, errors, fine.by_bounce[k], fine.by_bounce_error[k])
    worst = min(by_bounce, key=lambda k: by_bounce[k][1])
    return {
        "scene": name,
        "n_rays": n_rays,
        "relative_error": float(np.median(error) / fine.flux),
        "within_68": within[0],
        "within_95": within[1],
        "worst_bounce": worst,
        "worst_68": by_bounce[worst][0],
        "worst_95": by_bounce[worst][1],
        "worst_uncertain": float(np.mean([f"bounce {worst}" in run.uncertain for run in runs])),
        "flux_uncertain": float(np.mean(["flux" in run.uncertain for run in runs])),
        "cpu_seconds": time.process_time() - start,
    }


def main():
    """Print the table, and write it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=300)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    held = {}
    if options.json and options.json.exists():
        rows = map(json.loads, options.json.read_text().splitlines())
        held = {row["scene"]: row for row in rows}
    for case in scenes():
        row = held.get(case[0]) or measured(*case, options.seeds)
        if options.json and case[0] not in held:
            with options.json.open("a") as file:
                file.write(json.dumps(row) + "\n")
        print(row, flush=True)


if __name__ == "__main__":
    main()
