"""How often `feasibility` tells beforehand what a fit with a known point spread will do.

python benchmarks/inverse/feasibility.py [--scenes 30] [--tune] [--jobs 2] [--json FILE]

Each scene is drawn at random: slope of the wall's mirror-like lobe, exposure, read noise, distance
and size of the object, picture, pixels and stop of the camera, speckle. `simulate` makes the image
and reconstructs it by `tv_deconvolve`; the fit has succeeded where it correlates with the truth by
more than 0.9. A line of JSON is added for each finished scene, and those in the file are not done
again. `--tune` takes other scenes, on which the rule was set.
"""

from __future__ import annotations

import argparse
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
GOOD = 0.9


def drawn_scene(index, *, tune=False):
    """Scene number ``index`` of the set, and what was drawn for it."""
    from nlosoptics.scene import Lambert, PlanarObject, Scene, SpecularMicrofacet, SumMaterial

    rng = np.random.default_rng([7 if tune else 3, index])

    def between(low, high):
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    drawn = {
        "object": str(rng.choice(OBJECTS)),
        "slope_rms": float(rng.choice([0.0, between(2e-3, 0.06), between(5e-3, 0.04)])),
        "exposure": between(5e-4, 100e-3),
        "read_noise": between(1.0, 10.0),
        "distance": float(rng.uniform(0.6, 1.5)),
        "size": float(rng.uniform(0.25, 0.7)),
        "pixels": int(rng.choice([64, 128])),
        "stop_diameter": between(5e-3, 25e-3),
        "patterns": int(rng.choice([1, 100])),
    }
    base = Scene.load(ROOT / "examples" / "scenes" / "letter_flat.toml").resized(drawn["pixels"])
    z = drawn["distance"]
    camera = replace(
        base.camera,
        **{name: drawn[name] for name in ("exposure", "read_noise", "stop_diameter")},
    )
    hidden = PlanarObject(
        ROOT / "examples" / "objects" / f"{drawn['object']}.png",
        drawn["size"],
        position=(0.54433 * z, 0.0, z),
        material=base.hidden.material,
    )
    material = SumMaterial(Lambert(0.75), SpecularMicrofacet(0.05, drawn["slope_rms"]))
    laser = replace(base.laser, independent_patterns=drawn["patterns"])
    scene = replace(base, camera=camera, hidden=hidden, wall_material=material, laser=laser)
    return scene, drawn


def compared(task):
    """Prediction and outcome of one scene, as a line of JSON."""
    import nlosoptics as nlos
    from nlosoptics import inverse
    from nlosoptics.limits import feasibility

    index, tune = task
    scene, drawn = drawn_scene(index, tune=tune)
    started = time.perf_counter()
    told = feasibility(scene)
    asked = time.perf_counter() - started
    result = nlos.simulate(scene, 1e-2, seed=index, reconstruct=True)
    found = result.reconstruction
    correlation = inverse.registered_correlation(found, result.image.ideal)
    return {
        "scene": index,
        "tune": tune,
        "drawn": drawn,
        "predicted": told.recoverable,
        "score": told.score,
        "verdict": told.verdict,
        "correlation": correlation,
        "status": found.status,
        "feasibility_seconds": asked,
        "seconds": time.perf_counter() - started,
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


def summary(lines):
    """Counts of right and wrong predictions."""
    right = sum(line["predicted"] == (line["correlation"] > GOOD) for line in lines)
    done = sum(line["correlation"] > GOOD for line in lines)
    return f"{right} of {len(lines)} predicted, {done} of them can be done"


def main():
    """Run the scenes that the file lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--tune", action="store_true", help="the scenes that the rule was set on")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, default=RESULTS, help="file of finished scenes")
    options = parser.parse_args()
    finished = {line["scene"] for line in read_lines(options.json) if line["tune"] == options.tune}
    tasks = [(i, options.tune) for i in range(options.scenes) if i not in finished]
    options.json.parent.mkdir(parents=True, exist_ok=True)
    with options.json.open("a") as file, ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(compared, tasks):
            file.write(json.dumps(line) + "\n")
            file.flush()
    lines = [line for line in read_lines(options.json) if line["tune"] == options.tune]
    lines = sorted(lines, key=lambda line: line["scene"])[: options.scenes]
    for line in lines:
        right = line["predicted"] == (line["correlation"] > GOOD)
        print(
            f"{line['scene']:3d} {'   ' if right else '!! '}{line['score']:.3f} "
            f"{line['correlation']:.3f} {line['status']:16s} {line['verdict'][:90]}"
        )
    print(summary(lines))


if __name__ == "__main__":
    main()
