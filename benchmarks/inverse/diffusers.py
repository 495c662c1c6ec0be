"""Objects behind diffusers from the image's autocorrelation: object x wall x size x method.

python benchmarks/inverse/diffusers.py [--pixels 512] [--boxes 48 96] [--walls 3]
    [--objects FILE.png ...] [--noise 0.01] [--json FILE]

The wall has a phase of its own for every cell of the pupil, lambda N is 2 pixels, and its speckle
fills the frame. Pictures of so many pixels a side lie in the middle of it. The point spread is
sampled twice a pixel and on a wider pupil lattice than the frame's; pixels are sums, and the light
that leaves the frame is lost. With --json each finished case is a line, not computed again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from known_psf import OBJECTS
from scipy import fft, signal

FINE = 2  # samples per pixel
METHODS = ("alternating", "hio", "raar")


def point_spread(pixels, seed):
    """Speckle at FINE samples a pixel, 1.25 frames wide."""
    samples = int(1.25 * pixels) * FINE
    axis = (np.arange(samples) - samples // 2) / (samples / (4 * FINE))
    pupil = np.where(np.hypot(axis[:, None], axis) <= 1.0, 1.0 + 0j, 0.0)
    pupil *= np.exp(2j * np.pi * np.random.default_rng(seed).random(pupil.shape))
    intensity = np.abs(fft.fftshift(fft.fft2(fft.ifftshift(pupil)))) ** 2
    return intensity / intensity.sum()


def picture(path, box, pixels):
    """A grey picture of box pixels a side in the middle of the frame, FINE samples a pixel."""
    from PIL import Image

    side = box * FINE
    with Image.open(path) as opened:
        grey = np.asarray(opened.convert("L").resize((side, side)), dtype=np.float64) / 255.0
    return np.pad(grey, (pixels * FINE - side) // 2)


def binned(fine):
    """Means over pixels."""
    side = len(fine) // FINE
    return fine.reshape(side, FINE, side, FINE).mean(axis=(1, 3))


def main():
    """Print the table."""
    from nlosoptics import inverse

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=512)
    parser.add_argument("--boxes", type=int, nargs="+", default=[48, 96])
    parser.add_argument("--walls", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.01, help="sigma over the maximum")
    parser.add_argument("--objects", nargs="+", type=Path, default=OBJECTS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    done = {}
    if options.json and options.json.exists():
        lines = map(json.loads, options.json.read_text().splitlines())
        done = {line["case"]: line for line in lines}
    for seed in range(options.walls):
        spread = point_spread(options.pixels, seed)
        for box in options.boxes:
            for path in options.objects:
                name = f"{path.stem} {box} of {options.pixels}, wall {seed}, {options.noise:g}"
                row = done.get(name)
                if row is None:
                    fine = picture(path, box, options.pixels)
                    clean = binned(signal.fftconvolve(fine, spread, mode="same"))
                    noise = np.random.default_rng([seed, box]).normal(size=clean.shape)
                    image = clean + options.noise * clean.max() * noise
                    row, truth = {"case": name}, binned(fine)
                    for method in METHODS:
                        found = inverse.phase_retrieval(image, method=method)
                        row[method] = {
                            "correlation": inverse.registered_correlation(found, truth, flip=True),
                            "halves": found.score,
                            "seconds": found.seconds,
                        }
                    if options.json:
                        with options.json.open("a") as file:
                            file.write(json.dumps(row) + "\n")
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
