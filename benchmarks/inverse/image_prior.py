"""Deep image prior with the point spread known: correlation and seconds, case by case.

python benchmarks/inverse/image_prior.py [--noise 0.01 0.05] [--seeds 3] [--guides tv noise]
    [--iterations N] [--json FILE]

Data of benchmarks/known_psf.py, 128 x 128, which the inverted model did not make. With --json, one
line for each finished case, and those already there are not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from known_psf import OBJECTS, fine_point_spread, measured, picture


def main():
    """Print a line for each case."""
    from nlosoptics import imaging, inverse

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--objects", nargs="+", default=["F", "hanzi_zhong", "cartoon_smile"])
    parser.add_argument("--walls", nargs="+", default=["smooth", "speckle"])
    parser.add_argument("--guides", nargs="+", default=["tv"])
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    done = set()
    if options.json and options.json.exists():
        lines = map(json.loads, options.json.read_text().splitlines())
        done = {(x["object"], x["wall"], x["seed"], x["noise"], x["guide"]) for x in lines}
    for wall in options.walls:
        for seed in range(options.seeds):
            point_spread = fine_point_spread(wall, seed)
            for name in options.objects:
                for noise in options.noise:
                    for guide in options.guides:
                        if (name, wall, seed, noise, guide) in done:
                            continue
                        grey = picture(OBJECTS / f"{name}.png")
                        data = measured(grey, point_spread, noise=noise, seed=seed)
                        model = imaging.ForwardModel(data.kernel, shape=data.image.shape)
                        image = inverse.Measurement(data.image, noise_sigma=data.noise_sigma)
                        start = inverse.tv_deconvolve(image, model)
                        found = inverse.deep_image_prior(
                            image, model, guide=guide, max_iterations=options.iterations
                        )
                        line = json.dumps(
                            {
                                "object": name,
                                "wall": wall,
                                "seed": seed,
                                "noise": noise,
                                "guide": guide,
                                "image": correlation(data.image, data),
                                "tv_deconvolve": correlation(start, data),
                                "deep_image_prior": correlation(found, data),
                                "status": found.status,
                                "score": round(found.score, 3),
                                "iterations": int(found.physical_parameters["iterations"]),
                                "seconds": round(found.seconds, 2),
                            }
                        )
                        print(line, flush=True)
                        if options.json:
                            with options.json.open("a") as file:
                                file.write(line + "\n")


def correlation(found, data):
    """Registered correlation with the truth, four digits."""
    from nlosoptics import inverse

    return round(inverse.registered_correlation(found, data.truth), 4)


if __name__ == "__main__":
    main()
