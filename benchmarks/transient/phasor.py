"""Phasor fields of a flat letter: overlap with the letter against seconds, beside y-tal.

python benchmarks/transient/phasor.py [--peer-python PATH] [--json FILE]

The captures are `Z_single16_3b` and `Z_single32_3b` in the folder `peer_transient` of
NLOSOPTICS_DATA: a Z at 1 m before a wall of 2 m, one laser point, rendered by mitransient. All
methods see the same bins and voxels: planes on the sensors' grid at --planes depths from 0.6 to
1.4 m. The score is the intersection over union of the letter's outline at the voxels' middles and
of the brightest voxel along z where it is above a threshold, the best one. Seconds are those of a
call with all its set-up, the least of --repeats after one run to warm up; "next capture" is a call
that finds the transforms of the volume kept. y-tal runs in its own environment in each way that it
offers (ytal_phasor.py), and its fastest is compared. A third capture, of 64 x 64 points onto 64
planes with a wavelength of 4 pitches, is rendered here. Seconds are those of the processor here,
and those of the clock for y-tal.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from nlosoptics import transient
from nlosoptics.errors import ValidityWarning
from nlosoptics.scene import Lambert

HERE = Path(__file__).parent
SIDE, START, WIDTH = 2.0, 1.8, 0.01  # m: wall, first bin, bins
#: Corners of the letter's outline, m.
LETTER = np.array(
    [
        (-0.35, 0.24), (-0.35, 0.40), (0.35, 0.40), (0.35, 0.24), (-0.158, -0.24),
        (0.35, -0.24), (0.35, -0.40), (-0.35, -0.40), (-0.35, -0.24), (0.158, 0.24),
    ]
)  # fmt: skip


def main():
    """Compare, print, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peer-python", metavar="PATH", help="interpreter that has y-tal")
    parser.add_argument("--wl-mean", type=float, default=0.25, help="m")
    parser.add_argument("--planes", type=int, default=33)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    folder = os.environ.get("NLOSOPTICS_DATA")
    if not folder:
        parser.error("NLOSOPTICS_DATA names no data folder")
    rows = []
    for count in (16, 32):
        path = Path(folder) / "peer_transient" / f"Z_single{count}_3b.npz"
        light = np.moveaxis(np.load(path)["H"], -1, 0)
        found = ours(light, options) + peers(light, options)
        for row, picture in found:
            rows.append({"wall": count, **row, "iou": overlap(picture)})
            print("{wall:3d}  {method:44s} {seconds:8.4f} s  IoU {iou:.3f}".format(**rows[-1]))
    options.planes, options.wl_mean = 64, 4.0 * SIDE / 64
    for row, picture in ours(rendered(64), options):
        rows.append({"wall": 64, **row, "iou": overlap(picture)})
        print("{wall:3d}  {method:44s} {seconds:8.4f} s  IoU {iou:.3f}".format(**rows[-1]))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def rendered(count):
    """Bins (t, y, x) of the letter at 1 m, one laser point in the middle."""
    import trimesh

    faces = [[0, 1, 2], [0, 2, 3], [5, 6, 7], [5, 7, 8], [4, 3, 9], [4, 9, 8]]
    letter = trimesh.Trimesh(np.insert(LETTER, 2, 1.0, axis=1), faces, process=False)
    wall, bins = transient.wall_grid(SIDE, count), {"t_start": START, "delta_t": WIDTH}
    scan = transient.Scan(laser_points=(0.0, 0.0, 0.0), sensor_points=wall, n_bins=300, **bins)
    return transient.render([(letter, Lambert(0.8))], scan, max_bounces=3).H


def depths(options):
    """(nz,), m."""
    return np.linspace(0.6, 1.4, options.planes)


def ours(light, options):
    """Rows and maximum projections of every way here."""
    capture = transient.TransientCapture(
        H=light,
        laser_points=(0.0, 0.0, 0.0),
        sensor_points=transient.wall_grid(SIDE, light.shape[1]),
        delta_t=WIDTH,
        t_start=START,
    )
    volume = transient.Volume.before(SIDE, light.shape[1], depths(options))
    found = []
    other = transient.Volume.before(SIDE, light.shape[1], depths(options) + 1e-6)
    for method, tol in (("fft", 9e-6), ("fft", 1e-3), ("direct", 1e-3)):
        if method == "direct" and light.shape[1] > 32:
            continue
        spent = {"": [], ", next capture": []}
        for _ in range(options.repeats + 1):
            # another volume, so that no transforms are kept
            if method == "fft":
                form(capture, other, options, method, tol)
            for times in spent.values():
                start = time.process_time()
                image = form(capture, volume, options, method, tol)
                times.append(time.process_time() - start)
        for name, times in spent.items():
            if method == "direct" and name:
                continue
            row = {"method": f"nlosoptics {method} {image.details['dtype']}{name}"}
            row |= {"seconds": min(times[1:]), "n_waves": image.details["n_waves"]}
            found.append((row, image.projection()))
    return found


def form(capture, volume, options, method, tol):
    """Image of the capture; the bins end before the volume's corners."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        return transient.phasor_image(
            capture, volume, wl_mean=options.wl_mean, method=method, tol=tol
        )


def peers(light, options):
    """The same of y-tal."""
    if not options.peer_python:
        return []
    with tempfile.TemporaryDirectory() as folder:
        given, out = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(
            given,
            H=light,
            t_start=START,
            delta_t=WIDTH,
            side=SIDE,
            depths=depths(options),
            wl_mean=options.wl_mean,
            wl_sigma=options.wl_mean / np.sqrt(2.0),
            repeats=options.repeats,
        )
        script = HERE / "ytal_phasor.py"
        subprocess.run([options.peer_python, script, given, out], check=True)
        answer = dict(np.load(out))
    picture = (np.abs(answer["field"]) ** 2).max(axis=0)
    return [
        ({"method": f"y-tal {answer['version']} pf_dev, {name}", "seconds": float(spent)}, picture)
        for name, spent in zip(answer["names"], answer["seconds"], strict=True)
    ]


def overlap(picture):
    """Best intersection over union of a thresholded picture and the letter."""
    middles = (np.arange(len(picture)) + 0.5) * SIDE / len(picture) - 0.5 * SIDE
    truth = inside(LETTER, *np.meshgrid(middles, middles))
    scores = [
        np.sum(truth & (picture >= level)) / np.sum(truth | (picture >= level))
        for level in np.unique(picture)
    ]
    return float(max(scores))


def inside(outline, x, y):
    """Points within a polygon, by the crossings of a line to the right."""
    crossings = np.zeros(x.shape, dtype=int)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            crossings += ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return crossings % 2 == 1


if __name__ == "__main__":
    main()
