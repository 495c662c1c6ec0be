"""Time of `psf.point_spreads` per wave, against single point spreads and against plain numpy.

python benchmarks/psf_batches.py [--rounds N] [--json FILE]

Random waves on one pupil, 256 x 256 samples at lambda N/4. All times are processor times of all
threads per wave, the least of some rounds, with the set-up of the call. Wall-clock times are
printed but not kept, since they depend on what else runs. Plain numpy multiplies sampled pupils by
matrices.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from nlosoptics import psf

SIDE = 256
COUNTS = {0.07: (1, 10, 100, 1000), 0.5: (100,)}  # numbers of waves, by their rms in waves
THREADS = (1, 2)
SINGLES = 8  # waves of the loops
PUPIL = {"wavelength": 500e-9, "pupil_radius": 5e-3, "image_distance": 0.1}
PITCH = 500e-9 * 0.1 / 10e-3 / 4
INDICES = range(4, 16)


def timed(run, rounds, waves):
    """Return the result of a call, and its least processor and wall-clock seconds per wave."""
    result, cpu, wall = run(), np.inf, np.inf
    for _ in range(rounds):
        start = time.process_time(), time.perf_counter()
        result = run()
        cpu = min(cpu, time.process_time() - start[0])
        wall = min(wall, time.perf_counter() - start[1])
    return result, cpu / waves, wall / waves


def sampled(nodes, samples=None):
    """Return a wave and its modes of 1 m rms on nodes of a layout."""
    modes = [
        psf.Wavefront.from_zernike({j: 1.0}, nodes=nodes, samples=samples, **PUPIL) for j in INDICES
    ]
    return modes[0], np.array([mode.aberration for mode in modes])


def numpy_loop(heights, samples):
    """Return a call: the matrix Fourier transform of a pupil on a grid, wave by wave."""
    wave, modes = sampled("grid", samples)
    paths = np.einsum("wk,kyx->wyx", heights, modes)
    area = wave.weights / wave.weights.sum()
    k = 2 * np.pi / PUPIL["wavelength"]
    x = PITCH * (np.arange(SIDE) - SIDE // 2)
    kernel = np.exp(-1j * k / PUPIL["image_distance"] * np.outer(x, wave.u[0]))

    def run():
        found = np.empty((len(paths), SIDE, SIDE))
        for path, out in zip(paths, found, strict=True):
            field = kernel @ (area * np.exp(1j * k * path)) @ kernel.T
            out[:] = field.real**2 + field.imag**2
        return found

    return run


def rows(rms, rounds):
    """Yield a row for each number of waves and each tolerance, on the threads of this process."""
    wave, modes = sampled("polar")
    scale = rms * PUPIL["wavelength"] / len(INDICES) ** 0.5
    heights = scale * np.random.default_rng(1).normal(size=(max(COUNTS[rms]), len(INDICES)))
    paths = np.einsum("wk,krt->wrt", heights, modes)
    options = {"pitch": PITCH, "shape": SIDE, "normalisation": "ideal-peak"}
    few = [replace(wave, aberration=path) for path in paths[:SINGLES]]

    def singles(tol, **more):
        return lambda: [
            psf.point_spread(one, tol=tol, model="scalar", **options, **more).intensity
            for one in few
        ]

    exact = np.array(singles(1e-12, method="quadrature")())
    peaks = exact.max(axis=(1, 2))

    def error(found):
        """Return the largest max |dI|/max I of the first waves."""
        some = np.asarray(found)[:SINGLES]
        off = np.abs(some - exact[: len(some)]).max(axis=(1, 2))
        return float((off / peaks[: len(some)]).max())

    for tol, samples in ((1e-3, 256), (1e-6, 1024)):
        found, loop, _ = timed(singles(tol), rounds, SINGLES)
        matrices, numpy_cpu, _ = timed(numpy_loop(heights[:SINGLES], samples), 1, SINGLES)
        for count in COUNTS[rms]:
            out = np.empty((count, SIDE, SIDE))

            def batch(tol=tol, count=count, out=out):
                return psf.point_spreads(wave, paths[:count], tol=tol, out=out, **options)

            spreads, cpu, wall = timed(batch, rounds, count)
            weights = np.ones_like(out)
            _, gradient_cpu, gradient_wall = timed(
                lambda spreads=spreads, weights=weights: spreads.aberration_gradient(weights),
                rounds,
                count,
            )
            yield {
                "rms": rms,
                "tol": tol,
                "waves": count,
                "cpu": cpu,
                "wall": wall,
                "gradient_cpu": gradient_cpu,
                "gradient_wall": gradient_wall,
                "error": error(spreads.intensity),
                "estimate": float(spreads.error_estimate.max()),
                "loop_cpu": loop,
                "loop_error": error(found),
                "numpy_cpu": numpy_cpu,
                "numpy_samples": samples,
                "numpy_error": error(matrices),
            }


def main():
    """Run both thread counts in processes of their own, print their rows and write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--here", type=int, help="threads of this process; prints rows as JSON")
    options = parser.parse_args()
    if options.here:
        for rms in COUNTS:
            for row in rows(rms, options.rounds):
                print(json.dumps({"threads": options.here, **row}), flush=True)
        return
    found = []
    for threads in THREADS:
        command = [sys.executable, __file__, "--rounds", str(options.rounds)]
        run = subprocess.run(
            [*command, "--here", str(threads)],
            env={**os.environ, "NUMBA_NUM_THREADS": str(threads)},
            check=True,
            capture_output=True,
            text=True,
        )
        for row in map(json.loads, run.stdout.splitlines()):
            wall, gradient_wall = (1e3 * row.pop(key) for key in ("wall", "gradient_wall"))
            found.append(row)
            print(
                f"{row['threads']} threads, {row['rms']} waves rms, tol {row['tol']:g}, "
                f"{row['waves']:4} waves: {1e3 * row['cpu']:.2f} ms CPU a wave ({wall:.2f} wall), "
                f"gradient {1e3 * row['gradient_cpu']:.2f} ({gradient_wall:.2f}); error "
                f"{row['error']:.1e}, estimate {row['estimate']:.1e}; point_spread "
                f"{1e3 * row['loop_cpu']:.1f} ms, error {row['loop_error']:.1e}; numpy on "
                f"{row['numpy_samples']} samples {1e3 * row['numpy_cpu']:.1f} ms, error "
                f"{row['numpy_error']:.1e}"
            )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
