"""Time and memory of the pupil layer: wave to point spread to image, forward and backward.

python benchmarks/inverse/pupil_layer.py [--sizes 64 128 256 512] [--device cpu] [--repeats 40]

One thread, float32, a pupil at Nyquist's limit, Zernike modes 4 to 36. "layer" is the point spread
and its gradient by the coefficients; "image" the squared misfit of an image in a circular frame,
with gradients by coefficients and object. The least of all repeats is printed, since a busy machine
only adds; memory is what the process grew by at its peak, a size in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import time

WAVELENGTH = 632.8e-9
DISTANCE = 0.06
PITCH = 5e-6


def pupil_psf(size, device="cpu", dtype=None):
    """Zernike layer whose pupil just keeps Nyquist's limit."""
    import torch

    from nlosoptics.inverse import PupilPSF

    return PupilPSF.from_zernike(
        range(4, 37),
        wavelength=WAVELENGTH,
        pupil_radius=WAVELENGTH * DISTANCE / (4 * PITCH),
        image_distance=DISTANCE,
        pitch=PITCH,
        shape=size,
        device=device,
        dtype=torch.float32 if dtype is None else dtype,
    )


def measure(size, device, repeats):
    """Milliseconds and MiB of one size."""
    import torch

    torch.set_num_threads(1)
    module = pupil_psf(size, device)
    generator = torch.Generator().manual_seed(0)
    probe = torch.randn(size, size, generator=generator).to(device)
    picture = torch.rand(size, size, generator=generator).to(device).requires_grad_()
    start = peak(device)

    def layer():
        module.zero_grad()
        (module() * probe).sum().backward()

    def image():
        module.zero_grad()
        picture.grad = None
        (module.image(picture, boundary="circular") - probe).square().sum().backward()

    row = {"size": size, "device": device}
    row["layer_ms"] = least(layer, device, repeats)
    row["image_ms"] = least(image, device, repeats)
    row["peak_mib"] = round(peak(device) - start, 1)
    return row


def least(call, device, repeats):
    """Least milliseconds of a call."""
    import torch

    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        if device != "cpu":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    return round(1e3 * min(seconds), 2)


def peak(device):
    """Largest memory so far, MiB."""
    import torch

    if device != "cpu":
        return torch.cuda.max_memory_allocated() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=40)
    options = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    for size in options.sizes:
        with context.Pool(1) as pool:
            print(json.dumps(pool.apply(measure, (size, options.device, options.repeats))))


if __name__ == "__main__":
    main()
