"""Seconds and error of each transform at 256 x 256 samples: python benchmarks/psf_transforms.py.

Errors are max |dI|/max I against quadrature at full precision; the Airy disc's are against the
closed form.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from functools import partial

import numpy as np
from scipy.special import j1

from nlosoptics import psf

WAVELENGTH = 632.8e-9
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = 2 * WAVELENGTH
WAVES = {
    "no aberration": {},
    "0.1 wave rms coma": {8: 0.1},
    "1 wave rms astigmatism": {6: 1.0},
    "3 waves rms defocus": {4: 3.0},
}


def timed(run, repeats):
    """Result and least seconds of a few runs, the first one as warm-up."""
    result, best = run(), np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        result = run()
        best = min(best, time.perf_counter() - start)
    return result, best


def airy(spread):
    v = np.pi * np.hypot(spread.y[:, None], spread.x) / UNIT
    v[v == 0] = 1e-9
    return (2 * j1(v) / v) ** 2


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    heading = (
        f"{'wave':24} {'nodes':6} {'asked':11} {'ran':11} {'ms':>8} {'error':>9} {'estimate':>9}"
    )
    print(heading)
    for name, waves in WAVES.items():
        coefficients = {j: w * WAVELENGTH for j, w in waves.items()}
        polar = psf.Wavefront.from_zernike(coefficients, **SYSTEM)
        # Half a lambda N for the spot of 3 waves, 0.1 else: +-64 and +-12.8 lambda N.
        kwargs = {"pitch": UNIT / (2 if waves.get(4) else 10), "shape": 256, "model": "scalar"}
        exact = psf.point_spread(polar, method="quadrature", **kwargs).intensity
        if not waves:
            exact = airy(psf.point_spread(polar, **kwargs)) * exact.max()
        grid = psf.Wavefront.from_zernike(coefficients, nodes="grid", samples=512, **SYSTEM)
        jobs = [(polar, m) for m in ("auto", "airy", "quadrature", "fft", "mdft")]
        for wave, method in [*jobs, (grid, "mdft")]:
            if method == "airy" and waves:
                continue
            spread, seconds = timed(
                partial(psf.point_spread, wave, method=method, **kwargs), repeats
            )
            error = np.abs(spread.intensity - exact).max() / exact.max()
            print(
                f"{name:24} {wave.layout:6} {method:11} {spread.method:11} {1e3 * seconds:8.2f} "
                f"{error:9.1e} {spread.error_estimate:9.1e}"
            )
    print("\npixels of 72 um at F/2 (57 lambda N), window_shape(tol=1e-3), one run")
    for waves in ({}, {4: 0.02}, {4: 6.0}, {6: 12.0}, {4: 17.0}, {4: 35.0}):
        coefficients = {j: w * WAVELENGTH for j, w in waves.items()}
        wave = psf.Wavefront.from_zernike(coefficients, **SYSTEM)
        n = psf.window_shape(wave, pitch=72e-6)
        spread, seconds = timed(
            partial(psf.point_spread, wave, pitch=72e-6, shape=n, pixel_integrated=True), 1
        )
        print(
            f"{waves!s:24} {n:3} x {n:3} {spread.method:11} {1e3 * seconds:8.1f} ms, estimate "
            f"{spread.error_estimate:.1e}"
        )


if __name__ == "__main__":
    main()
