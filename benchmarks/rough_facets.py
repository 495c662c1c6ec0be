"""Mean point spread of facet walls against the average over random walls, ring by ring.

Each line compares the closed form with the average over walls of different seeds, for one Rayleigh
parameter and angle of incidence: the largest deviation of a ring's mean, in standard errors. The
outer rings are lit by a few steep facets only, so that their means over 200 walls are skewed, and
one of the 64 rings deviates by more than 3 standard errors in every sixth run.

    python benchmarks/rough_facets.py [--walls 1000] [--first SEED] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from nlosoptics import psf
from nlosoptics.scene import FacetWall

WAVELENGTH = 632.8e-9
RINGS, WIDTH = 8, 4  # rings, and their width in samples


def rings(image: np.ndarray) -> np.ndarray:
    """Return the means of an image over `RINGS` rings about its centre."""
    y, x = np.indices(image.shape) - np.array(image.shape)[:, None, None] // 2
    index = (np.hypot(x, y) / WIDTH).astype(int)
    return (np.bincount(index.ravel(), image.ravel()) / np.bincount(index.ravel()))[:RINGS]


def compared(s: float, angle: float, walls: int, first: int) -> dict[str, float]:
    """Compare mean and average at a Rayleigh parameter, rad, and an angle of incidence, rad."""
    cosine, cell = np.cos(angle), 1e-3
    size = {"footprint": np.diag([0.5 / cosine, 0.5]), "cos_sum": 2 * cosine}
    distance = np.diag([0.5 / cosine**2, 0.5])
    slope = 2 * s * WAVELENGTH / (2 * np.pi * size["cos_sum"]) / cell
    wave = psf.Wavefront.from_zernike(
        {}, wavelength=WAVELENGTH, pupil_radius=4e-3, image_distance=0.2
    )
    # the window follows the halo, whose width is that of the slopes
    pitch = max(4e-6, 0.2 * slope / 8)
    options = {"shape": 2 * RINGS * WIDTH + 1, "pitch": pitch, "pixel_integrated": True}
    start = time.process_time()
    mean = rings(
        psf.mean_point_spread(wave, FacetWall(cell, slope), tol=3e-3, **options, **size).intensity
    )
    seconds = time.process_time() - start
    drawn = np.array(
        [
            rings(
                psf.sample_point_spread(
                    wave,
                    FacetWall(cell, slope, seed=seed),
                    effective_distance=distance,
                    **options,
                    **size,
                ).intensity
            )
            for seed in range(first, first + walls)
        ]
    )
    error = drawn.std(axis=0, ddof=1) / np.sqrt(walls)
    return {
        "s": s,
        "degrees": round(float(np.degrees(angle)), 1),
        "walls": walls,
        "first_seed": first,
        "largest_deviation": float(np.abs((drawn.mean(axis=0) - mean) / error).max()),
        "standard_error": float((error / mean).max()),
        "mean_cpu_seconds": seconds,
        "wall_cpu_seconds": (time.process_time() - start - seconds) / walls,
    }


def main() -> None:
    """Run all cases and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--walls", type=int, default=1000)
    parser.add_argument("--first", type=int, default=50_000, help="seed of the first wall")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    rows = []
    for angle in (0.0, np.pi / 4):
        for s in (0.3, 1.0, 3.0, 10.0):
            row = compared(s, angle, asked.walls, asked.first)
            rows.append(row)
            print(
                f"s = {s:4.1f}  {row['degrees']:4.0f} deg  largest deviation "
                f"{row['largest_deviation']:.2f} standard errors of up to "
                f"{100 * row['standard_error']:.1f} %  mean {row['mean_cpu_seconds']:.2f} s, "
                f"one wall {row['wall_cpu_seconds']:.3f} s",
                flush=True,
            )
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
