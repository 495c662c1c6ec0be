"""Pictures from shadows on a matt wall, in many scenes with all the noise of a camera.

    python benchmarks/inverse/shadows.py [KIND ...] [--first 0] [--scenes 5] [--pixels 64]

Laser and camera are those of the study, 5 mW and 40 ms, and the wall is matt. Each scene has
another object and other places of its discs of 12 cm. The light is computed for 41 x 41 cells and
fitted on 24 x 24. Scenes of even numbers show letters, those of odd numbers other drawings. Kinds:

one, three      discs at known places
ambient         three discs, and ambient light of ten times the signal that varies over the wall
empty           one disc, ambient light, and no object
unknown         one disc, its place known to 5 cm; then a fit past the true place, for comparison
size, oval      one disc, fitted with a radius 5 % too small, or with a circle for an oval
gains           three discs, and unknown gains of the pixels that differ by 1 % rms
stripes         three discs, and ambient light with two waves across the wall, 1 % of the signal
random          one to three discs of any size, other objects and exposures of 0.2 to 100 ms, with
                the forecast by `feasibility`

Each line has the correlation of the object with the truth, also after registration, and that of the
resolved object, which the fit expects in the next column; past the known place; as forecast; the
error of the place, mm; CPU seconds of fit and operators; and the status, of the search too.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

from nlosoptics import Scene, inverse
from nlosoptics.imaging import WallTransport
from nlosoptics.imaging.detector import read_out
from nlosoptics.imaging.images import light_levels
from nlosoptics.limits import feasibility
from nlosoptics.scene import Lambert, PlanarObject

sys.path.insert(0, str(Path(__file__).parent))
from feasibility import KINDS, drawn_picture

SCENE = Path(__file__).parents[2] / "examples" / "scenes" / "letter_flat.toml"
FINE, CELLS = 41, 24  # cells of data and fit
SEARCHES = (16, 12), (32, 16)  # pixels and cells of the coarse and of the finer search
RADIUS, REACH = 0.06, 0.05  # of a disc and of the search, m
OFFSETS = ((0.0, 0.0, 0.0), (0.16, -0.1, -0.05), (-0.08, 0.15, 0.05))  # of up to three discs, m


def picture(index, rng):
    """Letter or drawing, (FINE CELLS, FINE CELLS), so that both grids divide it."""
    side = FINE * CELLS
    if index % 2:
        drawn = drawn_picture(str(rng.choice(KINDS[1:])), rng)
        image = Image.fromarray(np.uint8(255 * drawn)).resize((side, side))
    else:
        image = Image.new("L", (side, side))
        font = ImageFont.load_default(0.75 * side)
        letter = chr(65 + int(rng.integers(26)))
        ImageDraw.Draw(image).text((side / 2, side / 2), letter, 255, font, "mm")
    return np.asarray(image) / 255.0


def cells(values, count):
    """Means over count x count cells."""
    part = len(values) // count
    return values.reshape(count, part, count, part).mean((1, 3))


def disc(at, scale=(1.0, 1.0)):
    """Disc parallel to the wall, of a radius along x and y relative to RADIUS."""
    mesh = trimesh.creation.cylinder(RADIUS, 1e-3, sections=48)
    return mesh.apply_scale((*scale, 1.0)).apply_translation(at)


def scene_of(index, kind, pixels):
    """Scene, its picture, the place of its first disc, and the generator."""
    rng = np.random.default_rng([44, index])
    base = Scene.load(SCENE).resized(pixels)
    truth, size, exposure = picture(index, rng), 0.7, base.camera.exposure
    distance, radii = 1.0, np.ones(len(OFFSETS))
    spread = 0.05
    count = 3 if kind in ("three", "ambient", "gains", "stripes") else 1
    if kind == "random":
        count, spread = int(rng.integers(1, 4)), 0.1
        size, distance = rng.uniform(0.4, 1.0), rng.uniform(0.7, 1.3)
        exposure, radii = 10.0 ** rng.uniform(-3.7, -1.0), rng.uniform(0.3, 2.0, 3)
    position = distance * np.array(base.hidden.position)
    middle = 0.5 * position + rng.uniform(-spread, spread, 3)
    scale = np.array([1.025, 0.975]) if kind == "oval" else np.ones(2)
    scene = replace(
        base,
        hidden=PlanarObject(
            cells(truth, FINE), size, position=position, material=base.hidden.material
        ),
        camera=replace(base.camera, focus_distance=0.911, exposure=exposure),  # focus on the wall
        wall_material=Lambert(0.8),
        occluders=tuple(
            disc(middle + offset, radius * scale)
            for offset, radius in zip(OFFSETS[:count], radii, strict=False)
        ),
    )
    return scene, truth, middle, rng


def recorded(scene, light, seed, room=0.0):
    """Electrons in each pixel, with all noise, for the light of the object and of the room."""
    levels = light_levels(replace(scene, occluders=()))
    dark = levels.dark + room  # without speckle
    return read_out(scene.camera, light, dark, freedom=levels.freedom, seed=seed)[0]


def case(index, kind, pixels=64):
    """Fit one scene; returns the figures of its line."""
    scene, truth, middle, rng = scene_of(index, kind, pixels)
    shape = scene.camera.shape
    y, x = (np.mgrid[: shape[0], : shape[1]] + 0.5) / shape[0] * 2.0 - 1.0
    light = WallTransport(scene, cells=(FINE, FINE)).forward(cells(truth, FINE))
    seen_by_camera, signal = light > 0.0, light.mean()  # not hidden by the field stop
    tilt = rng.uniform(-0.3, 0.3, 5)
    room = 1.0 + tilt[0] * x + tilt[1] * y + tilt[2] * x * y + tilt[3] * x**2 + tilt[4] * y**2
    room = signal * room * {"ambient": 10.0, "empty": 1.0}.get(kind, 0.0)
    if kind == "empty":
        light = 0.0 * light
    elif kind == "gains":
        light = light * (1.0 + 0.01 * rng.standard_normal(shape))
    elif kind == "stripes":
        light = light + 0.01 * signal * (1.0 + np.cos(4.0 * np.pi * x))
    image = np.where(seen_by_camera, recorded(scene, light, index, room), np.nan)
    seen, started = cells(truth, CELLS), time.process_time()
    if kind in ("size", "oval"):
        scale = (0.95, 0.95) if kind == "size" else (1.0, 1.0)
        scene = replace(scene, occluders=(disc(middle, scale),))
    operator = WallTransport(scene, cells=(CELLS, CELLS))
    error, known = math.nan, None
    if kind == "unknown":
        known = inverse.shadow_fit(image, operator)
        started = time.process_time()
        coarse, finer = (WallTransport(scene, cells=(c, c), pixels=(n, n)) for n, c in SEARCHES)
        start = rng.standard_normal(3)
        start *= REACH * rng.random() ** (1.0 / 3.0) / np.linalg.norm(start)
        search = inverse.occluder_fit(
            image,
            lambda shift: coarse.moved(0, shift),
            finer=lambda shift: finer.moved(0, shift),
            start=start,
            reach=REACH,
        )
        place = search.physical_parameters["place"]
        error = 1e3 * float(np.linalg.norm(place))
        operator = operator.moved(0, place)
    fit = inverse.shadow_fit(image, operator)
    seconds = time.process_time() - started
    estimates = fit.physical_parameters
    result = {
        "raw": 0.0,
        "registered": 0.0,
        "resolved": 0.0,
        "expected": estimates["expected_correlation"],
        "known": math.nan,
        "forecast": math.nan,
        "mm off": error,
        "seconds": seconds,
        "status": fit.status,
    }
    if fit.object.any():
        result["raw"] = correlation(fit.object, seen)
        result["registered"] = float(inverse.registered_correlation(fit.object, seen))
        result["resolved"] = correlation(estimates["resolved_object"], seen)
    if known is not None:
        result["known"] = float(inverse.registered_correlation(known.object, seen))
        result["status"] = f"{search.status} {fit.status}"
    if kind == "random":
        result["forecast"] = feasibility(scene).relay_score
    return result


def correlation(first, second):
    """Correlation of two pictures."""
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def main():
    """Print a line for each scene and, for each kind, medians and counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", default=["one", "three"])
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--scenes", type=int, default=5, help="scenes of each kind")
    parser.add_argument("--pixels", type=int, default=64, help="image pixels along a side")
    parser.add_argument("--json", type=Path, help="file to which a line per scene is added")
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.scenes)
    for kind in options.kinds:
        lines = []
        for index in numbers:
            lines.append(case(index, kind, options.pixels))
            figures = [f"{k} {v:.3g}" for k, v in lines[-1].items() if k != "status" and v == v]
            print(kind, index, ", ".join(figures), lines[-1]["status"], flush=True)
            if options.json:
                with options.json.open("a") as file:
                    file.write(json.dumps({"kind": kind, "scene": index} | lines[-1]) + "\n")
        median = {k: np.median([line[k] for line in lines]) for k in ("raw", "registered")}
        ended = [line for line in lines if set(line["status"].split()) == {"converged"}]
        low = sum(line["registered"] < 0.8 for line in ended)
        near = sum(abs(line["forecast"] - line["raw"]) < 0.07 for line in lines)
        right = sum((line["forecast"] >= 0.9) == (line["raw"] >= 0.9) for line in lines)
        print(
            f"{kind}: {len(lines)} scenes, medians {median['raw']:.3f}, registered "
            f"{median['registered']:.3f}; {len(ended)} converged, {low} of them below 0.8"
            + (f"; {near} forecasts within 0.07, {right} verdicts right" * (kind == "random"))
        )


if __name__ == "__main__":
    main()
