"""Known-PSF reconstruction: object x wall x method, correlation with the truth and seconds.

python benchmarks/inverse/known_psf.py [--noise 0.01 0.05] [--seeds 3] [--pixels 128]
    [--objects FILE.png ...] [--methods NAME ...] [--json FILE]

The data do not come from the model that is inverted: object and point spread are sampled four
times finer than the pixels, convolved linearly, summed over the pixels, and the point spread
window is twice the frame. The solver sees the pixels and a pixel-integrated kernel.

Beside ours are scikit-image's Richardson-Lucy and Wiener filter, each with the number of
iterations or the balance, of those tried, that comes nearest to the truth, which no user could
know; seconds are those of that one setting. With --json each finished case is a line of the file,
and cases that it holds are not computed again.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from math import factorial
from pathlib import Path

import numpy as np
from scipy import fft, ndimage, signal

FINE = 4  # samples per pixel
PIXELS = 128
#: Named one by one, so that a new example does not change the cases of a seed.
NAMES = ("F", "R", "T", "cartoon_smile", "hanzi_zhong")
OBJECTS = [Path(__file__).parents[2] / "examples" / "objects" / f"{name}.png" for name in NAMES]


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


def fine_point_spread(wall, seed, pixels=PIXELS):
    """Point spread at FINE samples per pixel, lambda N = 2 pixels, two frames wide."""
    samples = 2 * pixels * FINE
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
    """Image of a picture of FINE samples a pixel, with noise relative to its maximum."""
    centre = point_spread.shape[0] // 2
    side = len(fine_object)
    light = signal.fftconvolve(fine_object, point_spread)
    light = light[centre : centre + side, centre : centre + side]
    cells = (side // FINE, FINE, side // FINE, FINE)
    clean = light.reshape(cells).mean(axis=(1, 3))
    sigma = noise * clean.max()
    return Measured(
        clean + sigma * np.random.default_rng(seed).normal(size=clean.shape),
        pixel_kernel(point_spread),
        fine_object.reshape(cells).mean(axis=(1, 3)),
        sigma,
    )


def picture(path, pixels=PIXELS):
    """A grey picture, FINE samples a pixel, 0 to 1."""
    from PIL import Image

    with Image.open(path) as opened:
        grey = opened.convert("L").resize((pixels * FINE, pixels * FINE))
        return np.asarray(grey, dtype=np.float64) / 255.0


def ours(solver):
    """Correlation and seconds of one of our solvers."""

    def run(data):
        from nlosoptics import imaging, inverse

        model = imaging.ForwardModel(data.kernel, shape=data.image.shape)
        image = inverse.Measurement(data.image, noise_sigma=data.noise_sigma)
        found = getattr(inverse, solver)(image, model)
        return inverse.registered_correlation(found, data.truth), found.seconds

    return run


def best_of(data, settings, restore):
    """Correlation and seconds of the setting that comes nearest to the truth."""
    from nlosoptics import inverse

    # theirs expect a range of one, and clip or divide by what is near zero
    image = data.image / data.image.max()
    tried = []
    for setting in settings:
        started = time.perf_counter()
        found = restore(image, setting)
        seconds = time.perf_counter() - started
        tried.append((inverse.registered_correlation(found, data.truth), seconds))
    return max(tried)


def their_richardson_lucy(data):
    """scikit-image's, on the image without its negative pixels."""
    from skimage import restoration

    kernel = cropped(data.kernel, 2 * data.image.shape[0] - 1)

    def restore(image, iterations):
        return restoration.richardson_lucy(
            image.clip(0.0), kernel, num_iter=iterations, clip=False, filter_epsilon=1e-6
        )

    return best_of(data, (10, 20, 40, 80, 160, 320), restore)


def their_wiener(data):
    """scikit-image's, periodic, with its Laplacian."""
    from skimage import restoration

    kernel = cropped(data.kernel, data.image.shape[0])

    def restore(image, balance):
        return restoration.wiener(image, kernel, balance, clip=False)

    return best_of(data, 10.0 ** np.arange(-5.0, 1.1, 0.5), restore)


def cropped(kernel, side):
    """The middle of a kernel, with an odd number of rows and columns."""
    middle, arm = kernel.shape[0] // 2, min((side - 1) // 2, (kernel.shape[0] - 1) // 2)
    return kernel[middle - arm : middle + arm + 1, middle - arm : middle + arm + 1]


METHODS = {
    "inverse_filter": ours("inverse_filter"),
    "wiener": ours("wiener"),
    "richardson_lucy": ours("richardson_lucy"),
    "tv_deconvolve": ours("tv_deconvolve"),
    "skimage_lucy": their_richardson_lucy,
    "skimage_wiener": their_wiener,
}


def solved(path, wall, seed, noise, options):
    """One row of the table."""
    from nlosoptics import inverse

    point_spread = fine_point_spread(wall, seed, options.pixels)
    data = measured(picture(path, options.pixels), point_spread, noise=noise, seed=seed)
    row = {"image": inverse.registered_correlation(data.image, data.truth)}
    for method in options.methods:
        correlation, seconds = METHODS[method](data)
        row[method] = {"correlation": correlation, "seconds": seconds}
    return row


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--noise", type=float, nargs="+", default=[0.01, 0.05], help="sigma over the maximum"
    )
    parser.add_argument("--seeds", type=int, default=3, help="walls of each kind")
    parser.add_argument("--pixels", type=int, default=PIXELS, help="along each side")
    parser.add_argument("--objects", nargs="+", type=Path, default=OBJECTS)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", type=Path, help="finished cases, a line each")
    options = parser.parse_args()
    done = {}
    if options.json and options.json.exists():
        done = {
            line["case"]: line for line in map(json.loads, options.json.read_text().splitlines())
        }
    print(f"{'case':34s} {'image':>6s} " + " ".join(f"{m:>15s}     s" for m in options.methods))
    for noise in options.noise:
        for wall in ("smooth", "speckle"):
            for seed in range(options.seeds):
                for path in options.objects:
                    name = f"{path.stem} {wall} {seed} {noise:g} {options.pixels}"
                    row = done.get(name)
                    if row is None:
                        row = {"case": name, **solved(path, wall, seed, noise, options)}
                        if options.json:
                            with options.json.open("a") as file:
                                file.write(json.dumps(row) + "\n")
                    found = {m: row[m] for m in options.methods if m in row}
                    text = (f"{f['correlation']:15.4f} {f['seconds']:5.2f}" for f in found.values())
                    print(f"{name:34s} {row['image']:6.3f} " + " ".join(text), flush=True)


if __name__ == "__main__":
    main()
