"""Rough walls: mean against drawn patterns, ring by ring: python benchmarks/rough_walls.py.

Every row is one wall: seconds of the mean and of a pattern, the largest departure of the patterns'
average from the mean over rings of 2 lambda N that hold 2 % of the light or more, as a share of the
ring and against the limit max(2 %, family-wise chance of 0.1 %), the latter for the worst ring, and
how the error falls with the number of patterns.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import math
import time

import numpy as np
from scipy import stats

from nlosoptics import psf

WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = 2 * WAVELENGTH
RINGS = 10
C45 = math.cos(math.pi / 4)
#: Object 1 m and lens 0.8 m from the wall, straight on and at 45 degrees.
VIEWS = {
    0: {"footprint": 1 / 1.8, "cos_sum": 2.0},
    45: {"footprint": np.diag([1 / (1.8 * C45), 1 / 1.8]), "cos_sum": 2 * C45},
}
DISTANCES = {0: 0.8 / 1.8, 45: np.diag([0.8 / (1.8 * C45**2), 0.8 / 1.8])}
#: Angle, degrees; Rayleigh parameter; correlation length, m; pupil samples.
WALLS = (
    (0, 0.3, 2e-3, 96),
    (0, 1.0, 2e-3, 96),
    (0, 3.0, 4e-3, 96),
    (0, 10.0, 5e-3, 128),
    (45, 0.3, 3e-3, 96),
    (45, 1.0, 3e-3, 96),
    (45, 3.0, 6e-3, 96),
    (45, 10.0, 7e-3, 128),
)


def row(angle, s, length, samples, count):
    """Figures of one wall."""
    view = VIEWS[angle]
    height = s * WAVELENGTH / (2 * math.pi * view["cos_sum"])
    roughness = psf.Roughness(height, length)
    wave = psf.Wavefront.from_zernike({}, nodes="grid", samples=samples, **SYSTEM)
    kwargs = {"pitch": UNIT / 2, "shape": 48, **view}
    start = time.perf_counter()
    mean = psf.mean_point_spread(wave, roughness, tol=0.02, **kwargs)
    middle = time.perf_counter()
    drawn = np.stack(
        [
            psf.sample_point_spread(
                wave, roughness, seed=i, effective_distance=DISTANCES[angle], **kwargs
            ).intensity
            for i in range(count)
        ]
    )
    seconds = (time.perf_counter() - middle) / count
    ring = (np.hypot(mean.y[:, None], mean.x) / (2 * UNIT)).astype(int).ravel()
    sums = np.stack([np.bincount(ring, p.ravel())[:RINGS] for p in drawn])
    expected = np.bincount(ring, mean.intensity.ravel())[:RINGS]
    lit = expected > 0.02
    sums, expected = sums[:, lit], expected[lit]
    scatter = sums.std(axis=0, ddof=1) / math.sqrt(count)
    chance = stats.norm.isf(0.5e-3 / len(expected)) * scatter
    off = np.abs(sums.mean(axis=0) - expected)
    limit = np.maximum(0.02 * expected, chance)
    counts = [n for n in (1, 4, 16, 64) if n <= count // 8]
    errors = []
    for n in counts:
        groups = drawn[: count // n * n].reshape(-1, n, *mean.shape).mean(axis=1)
        errors.append(math.sqrt(np.mean((groups - mean.intensity) ** 2)))
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    return (
        f"{angle:5d} {s:5.1f} {1e3 * length:6.1f} {1e3 * (middle - start):8.0f} "
        f"{1e3 * seconds:8.1f} {mean.error_estimate:9.1e} {100 * (off / expected).max():8.2f} "
        f"{(off / limit).max():8.2f} {100 * (chance / expected).max():9.2f} {slope:7.3f}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patterns", type=int, default=2048)
    count = parser.parse_args().patterns
    if count < 64:
        parser.error(f"--patterns = {count}; at least 64 are needed for the slope")
    print(
        f"{'angle':>5} {'s':>5} {'l, mm':>6} {'mean, ms':>8} {'one, ms':>8} {'estimate':>9} "
        f"{'worst, %':>8} {'/limit':>8} {'chance, %':>9} {'slope':>7}"
    )
    for wall in WALLS:
        print(row(*wall, count))


if __name__ == "__main__":
    main()
