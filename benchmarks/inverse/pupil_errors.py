"""Errors of the pupil layer in float32 against float64, and in float64 against `psf.point_spread`.

python benchmarks/inverse/pupil_errors.py [--sizes 64 128 256 512] [--waves 0.1 0.5]

Zernike modes 4 to 36 drawn at random with the given rms wave. Printed are max |dI|/max I of point
spreads, max |dg|/max |g| of the gradient of their product with noise, and max |dI|/max I in double
precision against the same cells in `psf.point_spread(method="fft")`.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
import torch
from pupil_layer import DISTANCE, PITCH, WAVELENGTH, pupil_psf

from nlosoptics import psf
from nlosoptics.errors import SamplingError


def errors(size, waves):
    """One row of relative errors."""
    generator = torch.Generator().manual_seed(0)
    leaves = torch.randn(33, dtype=torch.float64, generator=generator)
    leaves *= waves / leaves.norm()
    probe = torch.randn(size, size, dtype=torch.float64, generator=generator)
    spreads, gradients = [], []
    for dtype in (torch.float64, torch.float32):
        module = pupil_psf(size, dtype=dtype)
        start = leaves.clone().to(dtype).requires_grad_()
        spread = module(start)
        (spread * probe.to(dtype)).sum().backward()
        spreads.append(spread.detach().double())
        gradients.append(start.grad.double())
    row = {"size": size, "rms_waves": waves}
    for name, (exact, single) in (("spread", spreads), ("gradient", gradients)):
        row[f"{name}_float32"] = float((single - exact).abs().max() / exact.abs().max())
    row["against_psf"] = against_psf(size, leaves)
    return row


def against_psf(size, leaves):
    """Relative difference of double precision from the package's transform of the same cells.

    None where that refuses the window, which loses more than 1 % of the rays.
    """
    module = pupil_psf(size, dtype=torch.float64)
    cell = module.optics.pupil_pitch[0]
    v, u = np.meshgrid(module.optics.v, module.optics.u, indexing="ij")
    wave = psf.Wavefront(
        u=u,
        v=v,
        aberration=module.aberration(leaves).numpy(),
        amplitude=np.ones_like(u),
        weights=module.optics.share * cell**2,
        wavelength=WAVELENGTH,
        image_distance=DISTANCE,
        pupil_radius=module.optics.pupil_radius,
        layout="grid",
    )
    try:
        expected = psf.point_spread(
            wave, method="fft", pitch=PITCH, shape=size, normalisation="ideal-peak"
        ).intensity
    except SamplingError:
        return None
    found = module(leaves).detach().numpy()
    found = found * (expected.sum() / found.sum())
    return float(np.abs(found - expected).max() / expected.max())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--waves", type=float, nargs="+", default=[0.1, 0.5])
    options = parser.parse_args()
    torch.set_num_threads(1)
    for size in options.sizes:
        for waves in options.waves:
            print(json.dumps(errors(size, waves)))


if __name__ == "__main__":
    main()
