"""Growth of processor time and memory with pixels and field points, as fitted exponents.

python benchmarks/growth.py [--rounds N] [--json FILE]

Every stage runs at four sizes, in turn, after one call that compiles and sets up. The seconds are
processor time of all threads, the least of the rounds; the memory is the peak of what numpy
allocates during a call. An exponent is the slope of a line fitted to the logarithms.
"""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from pathlib import Path

import numpy as np

from nlosoptics import Scene, imaging, inverse, psf

SCENES = Path(__file__).resolve().parents[1] / "examples" / "scenes"
SIDES = (128, 256, 512, 1024)  # pixels along each side of an image
NODES = (3, 5, 8, 13)  # field points along each side of the picture


def point_spread(side):
    """Return the call that computes a point spread of a wave, and its number of pixels."""
    wave = psf.Wavefront.from_zernike(
        {4: 60e-9, 7: 60e-9, 11: 60e-9},
        wavelength=500e-9,
        pupil_radius=5e-3,
        image_distance=0.1,
    )
    return lambda: psf.point_spread(wave, shape=side, tol=1e-6), side**2


def field(nodes):
    """Return the call that computes a field of point spreads, and its number of points."""
    scene = Scene.load(SCENES / "letter_wavy.toml").resized(128)
    return lambda: psf.point_spread_field(scene, nodes, checks=0), nodes**2


def image(name):
    """Return a case: the image of a scene without its point spread, against its pixels."""

    def made(side):
        scene = Scene.load(SCENES / name).resized(side)
        spread = psf.scene_point_spread(scene).point_spread
        return lambda: imaging.form_image(scene, spread), side**2

    return made


def reconstruction(side):
    """Return the call that reconstructs a noisy square by total variation, and its pixels."""
    truth = np.zeros((side, side))
    truth[side // 4 : -side // 4, side // 3 : -side // 3] = 1.0
    arm = np.exp(-(np.linspace(-3.0, 3.0, 2 * (side // 32) + 1) ** 2))
    kernel = np.outer(arm, arm) / arm.sum() ** 2
    model = imaging.ForwardModel(kernel, shape=truth.shape)
    noise = np.random.default_rng(0).normal(0.0, 0.02, truth.shape)
    seen = model.forward(truth) + noise
    return (
        lambda: inverse.tv_deconvolve(
            inverse.Measurement(seen, noise_sigma=0.02), model, max_iterations=40
        ),
        side**2,
    )


CASES = {
    "point spread": ("pixels", point_spread, SIDES),
    "field of point spreads": ("field points", field, NODES),
    "image, flat wall": ("pixels", image("letter_flat.toml"), SIDES),
    "image, wavy wall": ("pixels", image("letter_wavy.toml"), SIDES),
    "total variation, 40 steps": ("pixels", reconstruction, SIDES),
}


def peak(call):
    """Return the peak of the memory that numpy and Python allocate in a call, bytes."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def exponent(sizes, values):
    """Return the slope of log(values) against log(sizes), by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def measured(make, sizes, rounds):
    """Return numbers, seconds and bytes of a stage at several sizes."""
    calls, numbers = zip(*(make(size) for size in sizes), strict=True)
    for call in calls:
        call()
    seconds = np.full(len(calls), np.inf)
    for _ in range(rounds):
        for k, call in enumerate(calls):
            start = time.process_time()
            call()
            seconds[k] = min(seconds[k], time.process_time() - start)
    return list(numbers), seconds.tolist(), [peak(call) for call in calls]


def main():
    """Print the table, write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    for stage, (against, make, sizes) in CASES.items():
        numbers, seconds, memory = measured(make, sizes, options.rounds)
        rows.append(
            {
                "stage": stage,
                "against": against,
                "numbers": numbers,
                "seconds": seconds,
                "bytes": memory,
                "seconds_exponent": exponent(numbers, seconds),
                "bytes_exponent": exponent(numbers, memory),
            }
        )
        one = rows[-1]
        print(
            f"{stage:26s} {against:12s} {numbers[0]:8d} to {numbers[-1]:8d}: {seconds[0]:.3f} to "
            f"{seconds[-1]:.3f} s, n^{one['seconds_exponent']:.2f}; {memory[0] / 2**20:.1f} to "
            f"{memory[-1] / 2**20:.1f} MiB, n^{one['bytes_exponent']:.2f}",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
