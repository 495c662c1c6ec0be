"""Rough walls: mean against drawn patterns, ring by ring: python benchmarks/rough_walls.py.

One wall a row: seconds of the mean and of a pattern; the largest
departure of the patterns' average from the mean over eight rings of equal light, as a share of the
ring and against the limit max(2 %, family-wise chance of 0.1 %); that chance for the
worst known ring; and how the error falls with the number of patterns.

Figures go to benchmarks/results/rough_walls.json too.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
from scipy import stats

from nlosoptics import psf

WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = 2 * WAVELENGTH  # lambda N
BATCH = 16
RINGS = 8
C45 = math.cos(math.pi / 4)
#: Object 1 m and lens 0.8 m from the wall, straight on and at 45 degrees.
VIEWS = {
    0: {"footprint": 1 / 1.8, "cos_sum": 2.0},
    45: {"footprint": np.diag([1 / (1.8 * C45), 1 / 1.8]), "cos_sum": 2 * C45},
}
DISTANCES = {0: 0.8 / 1.8, 45: np.diag([0.8 / (1.8 * C45**2), 0.8 / 1.8])}
#: Rayleigh parameter; correlation length at normal incidence, m; pupil samples; window, samples of
#: half a lambda N.
WALLS = (
    (0.3, 2e-3, 96, 48),
    (1.0, 2e-3, 96, 48),
    (3.0, 2e-3, 96, 72),
    (10.0, 4e-3, 112, 100),
)


def setting(angle, s, length, samples, shape):
    """Wave, roughness and options of one wall; askew the footprint is wider by 1/cos."""
    view = VIEWS[angle]
    height = s * WAVELENGTH / (2 * math.pi * view["cos_sum"])
    stretch = 1.0 if angle == 0 else 1 / C45
    wave = psf.Wavefront.from_zernike({}, nodes="grid", samples=samples, **SYSTEM)
    kwargs = {"pitch": UNIT / 2, "shape": shape, **view}
    return wave, psf.Roughness(height, length * stretch), kwargs


class Rings:
    """Rings about the axis that hold equal light, together all within the window's circle."""

    def __init__(self, mean):
        radius = np.hypot(mean.y[:, None], mean.x).ravel()
        inside = radius <= mean.x.max()
        order = np.argsort(radius[inside], kind="stable")
        light = np.cumsum(mean.intensity.ravel()[inside][order])
        shares = np.arange(1, RINGS) / RINGS * light[-1]
        edges = np.unique(radius[inside][order][np.searchsorted(light, shares)])
        self.ring = np.searchsorted(edges, radius, side="left")
        self.ring[~inside] = edges.size + 1
        self.lit = np.arange(edges.size + 1)
        self.mean = self.of(mean.intensity)
        self.pixels = np.bincount(self.ring)[self.lit]

    def of(self, intensity):
        return np.bincount(self.ring, intensity.ravel())[self.lit]

    def chance(self, batches):
        """Departure of the batches' average that one run in a thousand passes in any ring."""
        n = len(batches)
        quantile = stats.t.isf(0.5e-3 / len(self.lit), n - 1)
        return quantile * batches.std(axis=0, ddof=1) / math.sqrt(n)


def drawn_row(angle, s, length, samples, shape, count):
    """Figures of one wall of which all is drawn."""
    wave, roughness, kwargs = setting(angle, s, length, samples, shape)
    start = time.perf_counter()
    mean = psf.mean_point_spread(wave, roughness, tol=0.02, **kwargs)
    middle = time.perf_counter()
    drawn = [
        psf.sample_point_spread(
            wave,
            roughness,
            seed=i,
            independent_patterns=BATCH,
            effective_distance=DISTANCES[angle],
            **kwargs,
        ).intensity
        for i in range(count // BATCH)
    ]
    seconds = (time.perf_counter() - middle) / (count // BATCH * BATCH)
    rings = Rings(mean)
    batches = np.stack([rings.of(p) for p in drawn])
    chance = rings.chance(batches)
    off = np.abs(batches.mean(axis=0) - rings.mean)
    counts = [n for n in (1, 4, 16) if n <= len(drawn) // 4]
    errors = []
    for n in counts:
        groups = np.stack(drawn[: len(drawn) // n * n]).reshape(-1, n, *mean.shape).mean(axis=1)
        errors.append(math.sqrt(np.mean((groups - mean.intensity) ** 2)))
    return {
        "angle": angle,
        "s": s,
        "length_mm": 1e3 * roughness.correlation_length,
        "patterns": len(drawn) * BATCH,
        "rings": len(rings.lit),
        "mean_ms": 1e3 * (middle - start),
        "one_ms": 1e3 * seconds,
        "estimate": mean.error_estimate,
        "worst_percent": float(100 * (off / rings.mean).max()),
        "worst_of_limit": float((off / np.maximum(0.02 * rings.mean, chance)).max()),
        "chance_percent": float(100 * (chance / rings.mean).max()),
        "slope": float(np.polyfit(np.log(counts), np.log(errors), 1)[0]),
    }


def show(row, header):
    """One line of a table, and its head before the first."""
    if header:
        print("  ".join(row))
    print("  ".join(f"{value:{len(name)}.3g}" for name, value in row.items()), flush=True)
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patterns", type=int, default=2048)
    parser.add_argument(
        "--results", type=Path, default=Path(__file__).parent / "results" / "rough_walls.json"
    )
    options = parser.parse_args()
    count = options.patterns
    if count < 256:
        parser.error(f"--patterns = {count}; at least 256 are needed for the slope")
    drawn = []
    for angle in VIEWS:
        for wall in WALLS:
            drawn.append(show(drawn_row(angle, *wall, count), not drawn))
    options.results.parent.mkdir(parents=True, exist_ok=True)
    options.results.write_text(json.dumps({"drawn": drawn}, indent=1) + "\n")


if __name__ == "__main__":
    main()
