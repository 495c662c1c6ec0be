"""Known-PSF reconstruction: object x wall x method, correlation with the truth and seconds.

python benchmarks/known_psf.py [--noise 0.01] [--seeds 3] [--objects FILE.png ...]

The data do not come from the model that is inverted: object and point spread are sampled four
times finer than the pixels, convolved linearly, summed over the pixels, and the point spread
window is twice the frame. The solver sees the pixels and a pixel-integrated kernel.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from math import factorial
from pathlib import Path

import numpy as np
from scipy import fft, ndimage, signal

FINE = 4  # samples per pixel
PIXELS = 128
OBJECTS = Path(__file__).parents[1] / "examples" / "objects"


@dataclass(frozen=True)
class Measured:
    """A noisy image with what made it."""

    image: np.ndarray
    kernel: np.ndarray
    truth: np.ndarray
    noise_sigma: float


def zernike(n, m, rho, theta):
    """Zernike polynomial, unnormalised; m < 0 is the sine."""
    order = abs(m)
    radial = sum(
        (-1) ** k
        * factorial(n - k)
        / (factorial(k) * factorial((n + order) // 2 - k) * factorial((n - order) // 2 - k))
        * rho ** (n - 2 * k)
        for k in range((n - order) // 2 + 1)
    )
    return radial * (np.cos(order * theta) if m >= 0 else np.sin(order * theta))


def wall_aberration(wall, u, v, rng):
    """Waves over the unit disc: 18 Zernike modes of 0.5 wave rms, or a 12 x 12 grid of 1 wave."""
    if wall == "smooth":
        rho, theta = np.hypot(u, v), np.arctan2(v, u)
        modes = [(n, m) for n in range(2, 6) for m in range(-n, n + 1, 2)]
        aberration = sum(rng.normal() * zernike(n, m, rho, theta) for n, m in modes)
    else:
        nodes = rng.normal(size=(12, 12))
        aberration = ndimage.map_coordinates(nodes, [(v + 1) * 5.5, (u + 1) * 5.5], order=3)
    plane = np.stack([np.ones_like(u), u, v], axis=1)
    aberration = aberration - plane @ np.linalg.lstsq(plane, aberration, rcond=None)[0]
    return aberration * {"smooth": 0.5, "speckle": 1.0}[wall] / aberration.std()


def fine_point_spread(wall, seed):
    """Point spread at FINE samples per pixel, lambda N = 2 pixels, two frames wide."""
    samples = 2 * PIXELS * FINE
    axis = (np.arange(samples) - samples // 2) / (samples / (4 * FINE))
    u, v = np.meshgrid(axis, axis)
    inside = np.hypot(u, v) <= 1.0
    pupil = np.zeros((samples, samples), complex)
    aberration = wall_aberration(wall, u[inside], v[inside], np.random.default_rng(seed))
    pupil[inside] = np.exp(2j * np.pi * aberration)
    intensity = np.abs(fft.fftshift(fft.fft2(fft.ifftshift(pupil)))) ** 2
    return intensity / intensity.sum()


def pixel_kernel(fine):
    """The fine point spread integrated over pixels, at whole pixels from its centre."""
    window = np.array([0.5] + [1.0] * (FINE - 1) + [0.5])
    for axis in (0, 1):
        fine = ndimage.convolve1d(fine, window, axis=axis, mode="wrap")
    start = fine.shape[0] // 2 % FINE
    return fine[start::FINE, start::FINE]


def measured(fine_object, point_spread, *, noise=0.01, seed=0):
    """Image of a picture of PIXELS * FINE samples, with noise relative to its maximum."""
    centre = point_spread.shape[0] // 2
    side = PIXELS * FINE
    light = signal.fftconvolve(fine_object, point_spread)
    light = light[centre : centre + side, centre : centre + side]
    cells = (PIXELS, FINE, PIXELS, FINE)
    clean = light.reshape(cells).mean(axis=(1, 3))
    sigma = noise * clean.max()
    return Measured(
        clean + sigma * np.random.default_rng(seed).normal(size=clean.shape),
        pixel_kernel(point_spread),
        fine_object.reshape(cells).mean(axis=(1, 3)),
        sigma,
    )


def picture(path):
    """A 512 x 512 grey picture, 0 to 1."""
    from PIL import Image

    with Image.open(path) as opened:
        grey = opened.convert("L").resize((PIXELS * FINE, PIXELS * FINE))
        return np.asarray(grey, dtype=np.float64) / 255.0


def main():
    """Print the table."""
    from nlosoptics import imaging, inverse

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=0.01, help="sigma over the image's maximum")
    parser.add_argument("--seeds", type=int, default=3, help="walls of each kind")
    parser.add_argument("--objects", nargs="+", type=Path, default=sorted(OBJECTS.glob("*.png")))
    options = parser.parse_args()
    print(f"{'object':16s} {'wall':8s} seed {'image':>7s}", end="")
    print("".join(f" {method:>14s}      s" for method in ("wiener", "tv_deconvolve")))
    for wall in ("smooth", "speckle"):
        for seed in range(options.seeds):
            point_spread = fine_point_spread(wall, seed)
            for path in options.objects:
                data = measured(picture(path), point_spread, noise=options.noise, seed=seed)
                model = imaging.ForwardModel(data.kernel, shape=data.image.shape)
                raw = inverse.registered_correlation(data.image, data.truth)
                print(f"{path.stem:16s} {wall:8s} {seed:4d} {raw:7.4f}", end="")
                for solver in (inverse.wiener, inverse.tv_deconvolve):
                    found = solver(data.image, model, noise_sigma=data.noise_sigma)
                    score = inverse.registered_correlation(found, data.truth)
                    print(f" {score:14.4f} {found.seconds:6.2f}", end="")
                print(flush=True)


if __name__ == "__main__":
    main()
