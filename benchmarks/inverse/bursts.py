"""Bursts behind rough walls: correlation with the truth for each object, wall and number of images.

python benchmarks/inverse/bursts.py [--images 16 32] [--first 0] [--walls 5] [--objects letter ...]
    [--turned 16] [--json FILE]

The scenes are those of examples/pcin_study at its scale "rough" (flat wall with facets), simulated
with pixels half as wide and the camera's noise; each image has a wall of its own. The numbers of
the fit were chosen on the letter at wall 0 and on drawings that are not among these objects. A
smaller burst is the first part of the largest one. With --turned N the first N images are fitted
once more, the second half of them turned by a quarter: an object that does not keep still. With
--json each fit is added to the file as a line. Simulation takes 5 CPU s an image, a fit 10.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from nlosoptics import inverse, psf

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "pcin_study"))
from pcin_data import exposure_of, study_scene

SIDE, MILLISECONDS = 128, 40


def burst(name, wall, count):
    """Images (K, H, W) of an object through parts of a wall, and the truth (H, W)."""
    places = [("rough", name, "flat", SIDE, 1000 * (wall + 1) + k) for k in range(count)]
    shots = [exposure_of(place, MILLISECONDS, wall) for place in places]
    return np.stack([shot.image for shot in shots]), shots[0].truth


def lens(name):
    """Point spread of the scene's lens by a smooth wall, at the image's pixels."""
    scene = study_scene(("rough", name, "flat", SIDE, 0), MILLISECONDS * 1e-3)
    wave = psf.wavefront(replace(scene, wall_roughness=None))
    return psf.point_spread(wave, pitch=scene.camera.image_pitch, shape=SIDE, pixel_integrated=True)


def solved(images, spread, truth, **case):
    """Fit a burst; print and return one row of the table."""
    began = time.process_time()
    answer = inverse.burst_fit(images, spread)
    row = case | {
        "images": len(images),
        "correlation": round(inverse.registered_correlation(answer, truth), 4),
        "status": answer.status,
        "agreement": round(answer.score, 4),
        "cpu_seconds": round(time.process_time() - began, 2),
    }
    print(json.dumps(row), flush=True)
    return row


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, nargs="+", default=[16, 32])
    parser.add_argument("--first", type=int, default=0, help="number of the first wall")
    parser.add_argument("--walls", type=int, default=5)
    parser.add_argument("--objects", nargs="+", default=["letter", "cartoon", "hanzi"])
    parser.add_argument("--turned", type=int, default=0, help="images of an object that turns")
    parser.add_argument("--json", type=Path, help="a line for each fit is added")
    options = parser.parse_args()
    for name in options.objects:
        rows, spread = [], lens(name)
        for wall in range(options.first, options.first + options.walls):
            images, truth = burst(name, wall, max(options.images))
            case = {"object": name, "wall": wall}
            found = [solved(images[:count], spread, truth, **case) for count in options.images]
            rows += found
            if options.turned:
                half = options.turned // 2
                turned = [*images[:half], *np.rot90(images[half : 2 * half], axes=(1, 2))]
                found.append(solved(np.stack(turned), spread, truth, **case, turned=True))
            if options.json:
                with options.json.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in found)
        for count in options.images:
            values = [row["correlation"] for row in rows if row["images"] == count]
            print(
                f"{name:8s} {count} images: median {np.median(values):.3f}, {min(values):.3f} least"
            )


if __name__ == "__main__":
    main()
