"""Charts at known depths, measured by a real confocal setup: depth errors and seconds by method.

python benchmarks/transient/measured.py --data DIR [--peer-python PATH] [--json FILE]

DIR holds `data_dot_chart_40cm.mat` and `data_resolution_chart_65cm.mat` of the confocal captures
published with O'Toole et al., Nature 555, 338 (2018), which are not part of this repository. Their
names say the charts' distance from the wall. Four bins become one, the first 600 (direct light and
the detector's tail) are cut, and what is left is blurred by about the detector's pulse. Depths are
looked for within 15 cm of the name's, all methods on the same voxels. The error is the mean over
the columns that the best threshold of confidence leaves, at least a tenth of all, because the
charts' own outlines are not published. Seconds are the least of --repeats runs, compiled before,
on these voxels and on all that the bins reach, which y-tal makes; for the latter, the processor's
seconds a run as well, which other work on the machine hardly changes.
y-tal's f-k migration runs in an environment of its own on the same bins, unblurred and with zeros
instead of the cut, as it wants them; blurred as ours too.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from nlosoptics import transient

HERE = Path(__file__).parent
BIN = 4e-12 * 299_792_458.0  # m of path
CHARTS = {"dot_chart_40cm": 0.40, "resolution_chart_65cm": 0.65}  # m
BINS = 4  # that become one
CUT = 600  # bins of direct light
PULSE = 9e-3  # m of path, 30 ps: standard deviation, as a detector's 70 ps half width has
WINDOW = 0.15  # m about the nominal depth
LEAST = 0.1  # share of the columns that a threshold must leave

METHODS = {
    "fk_migration": lambda c, v: transient.fk_migration(c, v, target="retroreflective"),
    "fk_migration, light": lambda c, v: transient.fk_migration(
        c, v, target="retroreflective", amplitude="light"
    ),
    "lct": lambda c, v: transient.lct(c, v, target="retroreflective", snr=0.1),
    "backprojection": lambda c, v: transient.backprojection(
        c, v, filter="laplacian", width=6e-3, falloff="retroreflective"
    ),
}


def capture(path):
    """The file's histograms, [y, x]; the direct light is left in.

    Bin 0 is the one in which the direct light peaks, so that its middle is time 0.
    """
    return transient.TransientCapture.load(path, delta_t=BIN, t_start=-0.5 * BIN)


def blurred(capture):
    """The capture, blurred by its pulse over time and by one point over the wall."""
    sigma = (PULSE / capture.delta_t, 1.0, 1.0)
    return replace(capture, H=gaussian_filter(capture.H, sigma, mode="nearest"))


def figures(image, nominal):
    """Errors of a picture against a plane at the nominal depth."""
    truth = np.full(image.volume.shape[1:], nominal)
    error = transient.depth_error(image, truth, min_coverage=LEAST)
    bright = transient.depth_map(image, threshold=0.5)
    return {
        "median_m": nominal + error.median,
        "mae_m": error.mae,
        "threshold": error.threshold,
        "coverage": error.coverage,
        "mae_at_half_m": float(np.nanmean(np.abs(bright.depth - nominal))),
        "coverage_at_half": bright.coverage,
    }


def our_rows(name, nominal, path, repeats):
    """One row per method."""
    coarse = transient.downsampled(capture(path), bins=BINS)
    cut = transient.gated(coarse, start=CUT / BINS * coarse.delta_t)
    ready = blurred(cut)
    x, y = coarse.sensor_points[0, :, 0], coarse.sensor_points[:, 0, 1]
    pitch = 0.5 * coarse.delta_t
    volume = transient.Volume(x, y, np.arange(nominal - WINDOW, nominal + WINDOW, pitch))
    full = transient.Volume(x, y, pitch * (np.arange(coarse.n_bins) + 0.5))
    rows = []
    for method, image_of in METHODS.items():
        n = 1 if method == "backprojection" else repeats
        images = [image_of(ready, volume) for _ in range(n + 1)]
        row = {"chart": name, "method": method, "seconds": min(i.seconds for i in images[1:])}
        if method != "backprojection":  # the peer's voxels are all that the bins reach
            start = time.process_time()
            whole = [image_of(ready, full).seconds for _ in range(n)]
            row |= {"seconds_full": min(whole), "cpu": (time.process_time() - start) / n}
        rows.append(row | figures(images[-1], nominal))
    return rows


def peer_rows(name, nominal, path, python, repeats):
    """Rows of y-tal's f-k migration, off the same bins and off ours as blurred."""
    coarse = transient.downsampled(capture(path), bins=BINS)
    first = CUT // BINS
    cut = transient.gated(coarse, start=first * coarse.delta_t)
    rows = []
    for label, kept in (("", cut), (", blurred", blurred(cut))):
        light = np.zeros_like(coarse.H)
        light[-kept.n_bins :] = kept.H
        with tempfile.TemporaryDirectory() as folder:
            job, answer = Path(folder, "job.npz"), Path(folder, "answer.npz")
            np.savez(job, H=light, points=coarse.sensor_points, delta_t=coarse.delta_t)
            command = [python, str(HERE / "ytal_migration.py"), str(job), str(answer), str(repeats)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                return [{"chart": name, "method": "y-tal", "failed": done.stderr[-300:]}]
            with np.load(answer) as found:
                values, seconds = found["image"], float(found["seconds"])
                cpu = float(found["cpu"])
                version = str(found["version"])
        depths = 0.5 * coarse.delta_t * np.arange(coarse.n_bins)
        kept_depths = np.abs(depths - nominal) <= WINDOW
        volume = transient.Volume(
            coarse.sensor_points[0, :, 0], coarse.sensor_points[:, 0, 1], depths[kept_depths]
        )
        image = transient.VolumeImage(
            intensity=values[kept_depths], volume=volume, method=f"y-tal {version} f-k{label}"
        )
        row = {"chart": name, "method": image.method, "seconds": seconds}
        row |= {"seconds_full": seconds, "cpu": cpu}
        rows.append(row | figures(image, nominal))
    return rows


def main():
    """Measure, print a table, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--peer-python")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = []
    for name, nominal in CHARTS.items():
        path = given.data / f"data_{name}.mat"
        if not path.exists():
            sys.exit(f"{path} is not there; --data is the folder with the published captures")
        rows += our_rows(name, nominal, path, given.repeats)
        if given.peer_python:
            rows += peer_rows(name, nominal, path, given.peer_python, given.repeats)
    print(text := json.dumps(rows, indent=1))
    if given.json:
        given.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
