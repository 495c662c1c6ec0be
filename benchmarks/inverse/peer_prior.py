"""Untrained networks with the point spread known: ours beside deepinv's, on our operator.

PEER/bin/python benchmarks/inverse/peer_prior.py [--noise 0.01 0.05] [--iterations 250 1000 2500]
    [--channels 32 128] [--objects F ...] [--walls smooth speckle] [--json FILE]

Needs an interpreter with deepinv and this package. Data of known_psf.py, 128 x 128. deepinv's
`DeepImagePrior` with its `ConvDecoder` runs at its default rate for each number of iterations, on
the image over its maximum; ours with the same image, and `seconds` of both start with the image.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from known_psf import OBJECTS, fine_point_spread, measured, picture


def loaded():
    """deepinv; where torchvision is built for another torch, with stand-ins for two operators."""
    import torch

    probe = [sys.executable, "-c", "import torchvision"]
    run = subprocess.run(probe, capture_output=True, text=True, check=False)
    library = None
    if "torchvision::nms does not exist" in run.stderr:
        library = torch.library.Library("torchvision", "DEF")
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    import deepinv

    return deepinv, library


def theirs(deepinv, data, model, iterations, channels):
    """Correlation and seconds of deepinv's prior."""
    import torch

    from nlosoptics import inverse
    from nlosoptics.inverse.data.deepinv import NlosPhysics

    started = time.perf_counter()
    torch.manual_seed(0)
    size = data.image.shape
    network = deepinv.models.ConvDecoder(img_size=(1, *size), channels=channels)
    prior = deepinv.models.DeepImagePrior(network, img_size=[channels, 4, 4], iterations=iterations)
    image = torch.from_numpy(data.image / data.image.max()).float()[None, None]
    found = prior(image, NlosPhysics(model)).detach()[0, 0].double().numpy()
    seconds = time.perf_counter() - started
    return inverse.registered_correlation(found, data.truth), seconds


def main():
    """Print a line for each case and setting."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05])
    parser.add_argument("--iterations", type=int, nargs="+", default=[250, 1000, 2500])
    parser.add_argument("--channels", type=int, nargs="+", default=[32, 128])
    parser.add_argument("--objects", nargs="+", default=["F", "hanzi_zhong"])
    parser.add_argument("--walls", nargs="+", default=["smooth", "speckle"])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    deepinv, _library = loaded()
    import torch

    from nlosoptics import imaging, inverse

    torch.set_num_threads(1)  # as ours takes
    for wall in options.walls:
        for name in options.objects:
            for noise in options.noise:
                grey = picture(OBJECTS / f"{name}.png")
                data = measured(grey, fine_point_spread(wall, 0), noise=noise, seed=0)
                model = imaging.ForwardModel(data.kernel, shape=data.image.shape)
                found = inverse.deep_image_prior(
                    inverse.Measurement(data.image, noise_sigma=data.noise_sigma), model
                )
                rows = [("ours", inverse.registered_correlation(found, data.truth), found.seconds)]
                for channels in options.channels:
                    for count in options.iterations:
                        label = f"deepinv {channels} channels {count}"
                        rows.append((label, *theirs(deepinv, data, model, count, channels)))
                for label, correlation, seconds in rows:
                    line = {"wall": wall, "object": name, "noise": noise, "method": label}
                    line |= {"correlation": round(correlation, 4), "seconds": round(seconds, 2)}
                    print(json.dumps(line), flush=True)
                    if options.json:
                        with options.json.open("a") as file:
                            file.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
