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
stripes         three discs, and ambient light with four waves across the wall, 1 % of the signal

Each line has the correlation of the object with the truth, also after registration, and that of the
resolved object, which the fit forecasts in the next column; the status; the error of the place, mm;
and CPU seconds of fit and operators.
"""

from __future__ import annotations

import argparse
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
FINE, CELLS, SEARCH = 41, 24, (32, 24)  # cells of data and fit; pixels and cells of the search
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
            cells(truth, CELLS), size, position=position, material=base.hidden.material
        ),
        camera=replace(base.camera, focus_distance=0.911, exposure=exposure),  # focus on the wall
        wall_material=Lambert(0.8),
        occluders=tuple(
            disc(middle + offset, radius * scale)
            for offset, radius in zip(OFFSETS[:count], radii, strict=False)
        ),
    )
    return scene, truth, middle, rng


def recorded(scene, light, seed):
    """Electrons in each pixel, with all noise, for the light of the object."""
    levels = light_levels(replace(scene, occluders=()))
    return read_out(scene.camera, light, levels.dark, freedom=levels.freedom, seed=seed)[0]


def case(index, kind, pixels=64):
    """Fit one scene; returns the figures of its line."""
    scene, truth, middle, rng = scene_of(index, kind, pixels)
    shape = scene.camera.shape
    y, x = (np.mgrid[: shape[0], : shape[1]] + 0.5) / shape[0] * 2.0 - 1.0
    light = WallTransport(scene, cells=(FINE, FINE)).forward(cells(truth, FINE))
    seen_by_camera, signal = light > 0.0, light.mean()  # not hidden by the field stop
    tilt = rng.uniform(-0.3, 0.3, 5)
    room = 1.0 + tilt[0] * x + tilt[1] * y + tilt[2] * x * y + tilt[3] * x**2 + tilt[4] * y**2
    if kind == "ambient":
        light = light + 10.0 * signal * room
    elif kind == "empty":
        light = signal * room
    elif kind == "gains":
        light = light * (1.0 + 0.01 * rng.standard_normal(shape))
    elif kind == "stripes":
        light = light + 0.01 * signal * (1.0 + np.cos(4.0 * np.pi * x))
    image = np.where(seen_by_camera, recorded(scene, light, index), np.nan)
    seen, started = cells(truth, CELLS), time.process_time()
    if kind in ("size", "oval"):
        scale = (0.95, 0.95) if kind == "size" else (1.0, 1.0)
        scene = replace(scene, occluders=(disc(middle, scale),))
    operator = WallTransport(scene, cells=(CELLS, CELLS))
    place, error, known = None, 0.0, None
    if kind == "unknown":
        known = inverse.shadow_fit(image, operator)
        started = time.process_time()
        coarse = WallTransport(scene, cells=(SEARCH[1],) * 2, pixels=(SEARCH[0],) * 2)
        start = rng.standard_normal(3)
        start *= REACH * rng.random() ** (1.0 / 3.0) / np.linalg.norm(start)
        search = inverse.occluder_fit(
            image, lambda shift: coarse.moved(0, shift), start=start, reach=REACH
        )
        place = search.physical_parameters["place"]
        error = 1e3 * float(np.linalg.norm(place))
        operator = operator.moved(0, place)
    fit = inverse.shadow_fit(image, operator)
    seconds = time.process_time() - started
    result = {
        "status": fit.status if place is None else f"{search.status}, {fit.status}",
        "expected": fit.physical_parameters["expected_correlation"],
        "error": error,
        "seconds": seconds,
        "reasons": fit.reasons,
        "ratio": fit.physical_parameters["noise_ratio"],
        "modes": fit.physical_parameters["modes"],
    }
    if fit.object.any():
        result["raw"] = float(np.corrcoef(fit.object.ravel(), seen.ravel())[0, 1])
        result["registered"] = float(inverse.registered_correlation(fit.object, seen))
        resolved = fit.physical_parameters["resolved_object"]
        result["resolved"] = float(np.corrcoef(resolved.ravel(), seen.ravel())[0, 1])
    if kind == "random":
        report = feasibility(scene)
        result["forecast"], result["recoverable"] = report.relay_score, report.recoverable
    if known is not None:
        result["known"] = float(inverse.registered_correlation(known.object, seen))
        cov = search.physical_parameters["place_covariance"]
        result["sd"] = 1e3 * np.sqrt(np.diag(cov))
        result["place"] = 1e3 * place
        result["evaluations"] = search.physical_parameters["evaluations"]
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("kinds", nargs="*", default=["one", "three"])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--pixels", type=int, default=64)
    o = parser.parse_args()
    for kind in o.kinds:
        for i in range(o.first, o.first + o.scenes):
            r = case(i, kind, o.pixels)
            print(kind, i, {k: (round(v, 3) if isinstance(v, float) else v) for k, v in r.items()}, flush=True)
