"""How often `feasibility` tells beforehand what a fit with a known point spread will do.

python benchmarks/inverse/feasibility.py [--first 0] [--scenes 200] [--tune] [--occluders]
    [--jobs 2] [--json FILE]

Each scene is drawn at random: object, slope of the wall's mirror-like lobe, exposure, read noise,
distance and size of the object, stop of the camera, speckle. `simulate` makes an image of 64 x 64
pixels and reconstructs it by `tv_deconvolve`, and the result is correlated with the truth. This is
done again with other noise, since no forecast is nearer to two fits than they are to each other. A
line of JSON is added for each finished scene, and those in the file are not done again. `--tune`
takes other scenes, on which the constants of `limits.modulation` were fitted. `--occluders` puts a
disc, a rectangle or a ball into each scene, between the wall and the object, also into the light of
the image. They are drawn until `plan` accepts the scene, which refuses those that cut the laser's
beam, or hide a part of the lens from an object point whose point spread is computed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "feasibility.jsonl"
OBJECTS = ("F", "R", "T", "cartoon_smile", "hanzi_zhong")
KINDS = ("example", "strokes", "shapes", "dots", "grey")
GOOD = 0.9
SIDE = 128  # texels of a drawn picture
PIXELS = 64
TUNE, JUDGE = 7, 13  # first words of the seeds of the scenes
OTHER_NOISE = 10000  # added to the seed of a scene
TOL = 1e-2  # of the simulation
TRIES, THICKNESS = 100, 1e-3  # draws of an occluder; thickness of discs and rectangles, m


def drawn_picture(kind, rng):
    """Picture of a kind with its bright part about 80 % of the frame wide, (rows, columns)."""
    if kind == "example":
        return ROOT / "examples" / "objects" / f"{rng.choice(OBJECTS)}.png"
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE * 2 - 1
    picture = np.zeros((SIDE, SIDE))
    if kind == "strokes":
        corners = rng.uniform(-0.75, 0.75, (int(rng.integers(3, 8)), 2))
        half = rng.uniform(0.02, 0.12)
        for (x0, y0), (x1, y1) in itertools.pairwise(corners):
            dx, dy = x1 - x0, y1 - y0
            along = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0, 1)
            near = np.hypot(x - x0 - along * dx, y - y0 - along * dy) < half
            picture = np.maximum(picture, near)
    elif kind == "shapes":
        for _ in range(int(rng.integers(2, 6))):
            u, v = rng.uniform(-0.6, 0.6, 2)
            a, b, turn = *rng.uniform(0.08, 0.35, 2), rng.uniform(0, math.pi)
            s, t = (
                (x - u) * math.cos(turn) + (y - v) * math.sin(turn),
                (y - v) * math.cos(turn) - (x - u) * math.sin(turn),
            )
            inside = (
                (s / a) ** 2 + (t / b) ** 2 < 1
                if rng.random() < 0.5
                else ((abs(s) < a) & (abs(t) < b))
            )
            picture[inside] = rng.uniform(0.3, 1.0)
    elif kind == "dots":
        radius = rng.uniform(0.03, 0.1)
        for u, v in rng.uniform(-0.75, 0.75, (int(rng.integers(4, 20)), 2)):
            picture[np.hypot(x - u, y - v) < radius] = 1.0
    else:
        cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE))) * SIDE
        white = np.fft.fft2(rng.standard_normal((SIDE, SIDE)))
        smooth = np.fft.ifft2(white / (1 + cycles) ** rng.uniform(1.2, 2.0)).real
        smooth = (smooth - smooth.min()) / np.ptp(smooth)
        picture = np.where(np.maximum(abs(x), abs(y)) < 0.8, smooth, 0.0)
    return picture


def with_occluder(scene, rng):
    """Scene with an occluder that `simulate` accepts, and what was drawn for it."""
    import trimesh

    import nlosoptics as nlos
    from nlosoptics.errors import SceneError

    shapes = {
        "disc": lambda size: trimesh.creation.cylinder(size[0], THICKNESS),
        "rectangle": lambda size: trimesh.creation.box((*(2 * size), THICKNESS)),
        "ball": lambda size: trimesh.creation.icosphere(2, size[0]),
    }
    hidden = scene.hidden
    for tries in range(1, TRIES + 1):
        kind, size = str(rng.choice(list(shapes))), rng.uniform(0.02, 0.15, 2)
        on_wall = np.array([rng.uniform(-0.3, 0.9), rng.uniform(-0.3, 0.3), 0.0])
        on_object = (
            hidden.position + rng.uniform(-0.5, 0.5, 2) * np.array(hidden.size) @ hidden.axes[:2]
        )
        at = on_wall + rng.uniform(0.2, 0.95) * (on_object - on_wall)
        turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
        mesh = shapes[kind](size).apply_transform(turn)
        try:
            found = replace(scene, occluders=(mesh.apply_translation(at),))
            nlos.plan(found, TOL)
        except SceneError:
            continue
        drawn = {"occluder": kind, "extent": size.tolist(), "at": at.tolist(), "tries": tries}
        return found, drawn
    raise RuntimeError(f"no occluder of {TRIES} can be simulated")


def drawn_scene(index, *, tune=False, occluders=False):
    """Scene number ``index`` of the set, and what was drawn for it."""
    from nlosoptics.scene import Lambert, PlanarObject, Scene, SpecularMicrofacet, SumMaterial

    rng = np.random.default_rng([TUNE if tune else JUDGE, index])

    def between(low, high):
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    drawn = {
        "object": str(rng.choice(KINDS)),
        "slope_rms": float(rng.choice([0.0, between(2e-3, 0.08), between(5e-3, 0.04)])),
        "exposure": between(3e-5, 100e-3),
        "read_noise": between(1.0, 10.0),
        "distance": float(rng.uniform(0.6, 1.5)),
        "size": float(rng.uniform(0.4, 1.2)),
        "stop_diameter": between(5e-3, 25e-3),
        "patterns": int(rng.choice([1, 100])),
    }
    base = Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml").resized(PIXELS)
    z = drawn["distance"]
    camera = replace(
        base.camera, **{name: drawn[name] for name in ("exposure", "read_noise", "stop_diameter")}
    )
    hidden = PlanarObject(
        drawn_picture(drawn["object"], rng),
        drawn["size"],
        position=(0.54433 * z, 0.0, z),
        material=base.hidden.material,
    )
    material = SumMaterial(Lambert(0.75), SpecularMicrofacet(0.05, drawn["slope_rms"]))
    laser = replace(base.laser, independent_patterns=drawn["patterns"])
    scene = replace(base, camera=camera, hidden=hidden, wall_material=material, laser=laser)
    if occluders:
        scene, occluder = with_occluder(scene, rng)
        drawn |= occluder
    return scene, drawn


def compared(task):
    """Prediction and outcome of one scene, as a line of JSON."""
    import nlosoptics as nlos
    from nlosoptics import inverse
    from nlosoptics.limits import feasibility

    index, tune, occluders = task
    scene, drawn = drawn_scene(index, tune=tune, occluders=occluders)
    started = time.process_time()
    told = feasibility(scene)
    asked = time.process_time() - started
    result = nlos.simulate(scene, TOL, seed=index, reconstruct=True)
    found = result.reconstruction
    correlation = inverse.registered_correlation(found, result.image.ideal)
    seconds = time.process_time() - started
    again = nlos.simulate(scene, TOL, seed=index + OTHER_NOISE, reconstruct=True)
    return {
        "scene": index,
        "tune": tune,
        "occluders": occluders,
        "drawn": drawn,
        "predicted": told.recoverable,
        "score": told.score,
        "spread": told.score_spread,
        "verdict": told.verdict,
        "correlation": correlation,
        "correlation_again": inverse.registered_correlation(
            again.reconstruction, again.image.ideal
        ),
        "status": found.status,
        "feasibility_seconds": asked,
        "seconds": seconds,
    }


def read_lines(path):
    """Finished scenes in a file; a line cut off by an interruption is left out."""
    lines = []
    if path.is_file():
        for text in path.read_text().splitlines():
            try:
                lines.append(json.loads(text))
            except ValueError:
                continue
    return lines


def main():
    """Run the scenes that the file lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--scenes", type=int, default=200, help="number of scenes")
    parser.add_argument("--tune", action="store_true", help="the scenes that the rule was set on")
    parser.add_argument("--occluders", action="store_true", help="an occluder in each scene")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, default=RESULTS, help="file of finished scenes")
    options = parser.parse_args()
    asked = options.tune, options.occluders

    chosen = range(options.first, options.first + options.scenes)

    def finished():
        lines = [line for line in read_lines(options.json) if line["scene"] in chosen]
        return [line for line in lines if (line["tune"], line["occluders"]) == asked]

    done = {line["scene"] for line in finished()}
    tasks = [(i, *asked) for i in chosen if i not in done]
    options.json.parent.mkdir(parents=True, exist_ok=True)
    with options.json.open("a") as file, ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(compared, tasks):
            file.write(json.dumps(line) + "\n")
            file.flush()
    lines = sorted(finished(), key=lambda line: line["scene"])
    right = sum(line["predicted"] == (line["correlation"] > GOOD) for line in lines)
    print(f"{right} of {len(lines)} verdicts right")


if __name__ == "__main__":
    main()
