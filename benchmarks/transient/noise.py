"""Pictures of noisy captures with all settings chosen from them: phasor field and inverse.

python benchmarks/transient/noise.py [--shapes H,T] [--photons 10,3,1] [--seeds 10] [--data DIR]
    [--empty 50] [--methods phasor,inverse] [--json FILE]

Matt shapes before a wall of 1 m with 64 x 64 confocal points, in bins of 1 cm; photons in the
brightest bin, and a background of 0.2 of it. The overlap (intersection over union) is that of the
cells with a depth and of the shape. The error of depth is the median over these cells. Cover is the
share of the 95 % intervals of depth that hold the truth. --empty counts rooms with background and
direct light alone that are said to be empty. --data is the folder of measured captures (see
measured.py): thinned to two halves, the depths of one are judged by the intervals of both.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from nlosoptics import transient
from nlosoptics.scene import Lambert

WALL = transient.wall_grid(1.0, 64)
CHARTS = {"dot_chart_40cm": 0.40, "resolution_chart_65cm": 0.65}  # m
BIN = 4e-12 * 299_792_458.0  # m of path, of the measured captures


def box(x, y, width, height, z=0.7, tilt=0.0):
    """A plate of 1 mm, turned about y by ``tilt`` degrees."""
    turned = trimesh.transformations.rotation_matrix(np.deg2rad(tilt), (0.0, 1.0, 0.0))
    plate = trimesh.creation.box((width, height, 1e-3)).apply_transform(turned)
    return plate.apply_translation((x, y, z))


def disc(x, y, radius, z=0.7):
    """A disc of 1 mm."""
    return trimesh.creation.cylinder(radius, 1e-3, sections=32).apply_translation((x, y, z))


SHAPES = {
    "F": [box(-0.12, 0, 0.09, 0.44), box(0.045, 0.175, 0.24, 0.09), box(0.02, 0, 0.19, 0.09)],
    "H": [box(-0.16, 0, 0.08, 0.42), box(0.16, 0, 0.08, 0.42), box(0, 0, 0.24, 0.08)],
    "T": [box(0, 0.15, 0.4, 0.08), box(0, -0.05, 0.08, 0.32)],
    "small disc": [disc(0.1, -0.12, 0.05)],
    "disc": [disc(-0.15, 0.1, 0.09, 0.6)],
    "two plates": [box(-0.17, 0.05, 0.18, 0.3, 0.6), box(0.15, -0.05, 0.2, 0.24, 0.8)],
    "slanted plate": [box(0, 0, 0.35, 0.25, 0.7, 30.0)],
}


def rendered(name):
    """Noise-free capture, brightest bin 1, and true depths."""
    scan = transient.Scan(
        laser_points=WALL,
        sensor_points=WALL,
        pairing="confocal",
        t_start=1.1,
        delta_t=0.01,
        n_bins=200,
    )
    shape = SHAPES[name]
    light = transient.render([(m, Lambert(0.8)) for m in shape], scan, max_bounces=3, tol=2e-2)
    truth = transient.true_depths(shape, transient.Volume(WALL[0, :, 0], WALL[:, 0, 1], [0.7]))
    clean = replace(light, H=light.H / light.H.max(), by_bounce={}, standard_error=None)
    return clean, truth


def noisy(clean, photons, seed):
    """Photons of a capture, and of a background of 0.2."""
    rng = np.random.default_rng(seed)
    return replace(clean, H=rng.poisson(photons * (clean.H + 0.2)).astype(float))


def pictures(capture, methods):
    """Yield method, depths, their standard errors and processor seconds."""
    begun = time.process_time()
    advice = transient.advise(capture)
    spent = time.process_time() - begun
    if "phasor" in methods:
        errors = None if advice.depths is None else advice.depths.standard_error
        yield "phasor", None if advice.depths is None else advice.depths.depth, errors, spent
    if "inverse" in methods:
        begun, depth = time.process_time(), None
        if advice.image is not None:
            image = transient.inverse_image(capture, advice=advice)
            depth = transient.depth_map(image, threshold=image.details["threshold"]).depth
        yield "inverse", depth, None, spent + time.process_time() - begun


def figures(depth, errors, truth):
    """Overlap, error of depth in m, and share of intervals that hold the truth."""
    if depth is None:
        return 0.0, np.nan, np.nan
    off, seen = np.abs(depth - truth), np.isfinite(depth)
    both = np.isfinite(off)
    overlap = both.sum() / (seen | np.isfinite(truth)).sum()
    if not both.any():
        return float(overlap), np.nan, np.nan
    held = np.nan if errors is None else np.mean(off[both] < 1.96 * errors[both])
    return float(overlap), float(np.median(off[both])), float(held)


def shape_rows(options):
    """One row for each shape, number of photons and method."""
    for name in options.shapes.split(","):
        clean, truth = rendered(name)
        for photons in map(float, options.photons.split(",")):
            found = {}
            for seed in range(options.seeds):
                for method, depth, errors, spent in pictures(
                    noisy(clean, photons, seed), options.methods
                ):
                    found.setdefault(method, []).append((*figures(depth, errors, truth), spent))
            for method, each in found.items():
                overlap, off, held, spent = np.nanmean(each, axis=0)
                row = {"shape": name, "photons": photons, "method": method, "seeds": options.seeds}
                row |= {"iou": overlap, "iou_least": min(e[0] for e in each)}
                yield row | {"depth_error_m": off, "cover": held, "cpu": spent}


def empty_rows(count):
    """How many empty rooms are said to be empty."""
    times = 0.01 * (np.arange(300) + 0.5)[:, None, None]
    right = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        light = 1e4 * (seed % 2) * np.exp(-times / 0.1) + 0.1 * 4.0 ** (seed % 6)
        capture = transient.TransientCapture(
            H=rng.poisson(np.broadcast_to(light, (300, 64, 64))).astype(float),
            laser_points=WALL,
            sensor_points=WALL,
            delta_t=0.01,
            pairing="confocal",
        )
        right += transient.advise(capture).image is None
    yield {"shape": "empty room", "rooms": count, "said_empty": right}


def measured_rows(folder, methods):
    """Depths of measured charts, and cover of the intervals of two halves."""
    for name, nominal in CHARTS.items():
        path = folder / f"data_{name}.mat"
        capture = transient.TransientCapture.load(path, delta_t=BIN, t_start=-0.5 * BIN)
        counts = capture.H.astype(np.int64)
        for method, depth, _, spent in pictures(capture, methods):
            off = np.abs(depth[np.isfinite(depth)] - nominal)
            row = {"shape": name, "method": method, "depth_error_m": float(off.mean())}
            yield row | {"coverage": off.size / depth.size, "cpu": spent}
        half = np.random.default_rng(0).binomial(counts, 0.5)
        maps = [
            transient.advise(replace(capture, H=h.astype(float))).depths
            for h in (half, counts - half)
        ]
        off = maps[0].depth - maps[1].depth
        both = np.isfinite(off)
        error = np.hypot(maps[0].standard_error, maps[1].standard_error)
        row = {"shape": name, "method": "phasor, halves"}
        yield row | {"cover": float(np.mean(np.abs(off[both]) < 1.96 * error[both]))}


def main():
    """Measure, print, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", default=",".join(SHAPES))
    parser.add_argument("--photons", default="100,10,3,1")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--methods", default="phasor,inverse")
    parser.add_argument("--empty", type=int, default=0, metavar="ROOMS")
    parser.add_argument("--data", type=Path, metavar="DIR")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # far planes are darker at the rim
        for part in (
            shape_rows(options) if options.shapes else (),
            empty_rows(options.empty) if options.empty else (),
            measured_rows(options.data, options.methods) if options.data else (),
        ):
            for row in part:
                rows.append(row)
                print(json.dumps(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
