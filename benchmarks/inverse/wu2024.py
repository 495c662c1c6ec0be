"""PCIN as published, from random angles and one image: correlation, status, seconds.

python benchmarks/inverse/wu2024.py [--walls 6] [--rms 0.25 0.5 1] [--objects F arrow ...]
    [--size 64] [--json FILE] [--jobs 2]
python benchmarks/inverse/wu2024.py --scene examples/scenes/letter_rough.toml [--size 512]

Data by the simulator (cases.py). Each object is seen by each wall. With --json, one line for each
finished case, and those already there are not run again.

--scene: a scene with a wall of facets, its image made by the simulator. The exit angles of the
facets that the lens sees are fitted, from random ones as strong as the wall's blur. For comparison,
total variation with the wall's point spread.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

SCENE_TOL = 1e-2  # of the image of a scene, whose noise is 3 % and more


def pupil(data, size):
    from cases import MODES

    from nlosoptics.inverse import PupilPSF

    return PupilPSF.from_zernike(MODES, shape=size, pixel_integrated=True, **data.pupil)


def row(data, found, name, wall, rms, options):
    """One line of the table."""
    from nlosoptics.inverse import registered_correlation

    return {
        "object": name,
        "wall": wall,
        "rms": rms,
        "start": "cold",
        "size": options.size,
        "image": round(registered_correlation(data.images[0], data.truth), 4),
        "correlation": round(registered_correlation(found, data.truth), 4),
        "like_image": round(registered_correlation(found, data.images[0]), 4),
        "status": found.status,
        "score": round(found.score, 4),
        "strehl": round(found.physical_parameters["strehl"], 4),
        "wave_rms": round(float(np.linalg.norm(found.physical_parameters["coefficients"])), 4),
        "iterations": int(found.physical_parameters["iterations"]),
        "seconds": round(found.seconds, 1),
    }


def one_case(job):
    """One object seen by one wall."""
    name, wall, rms, options = job
    from cases import case

    from nlosoptics.inverse import Measurement, wu2024_fit

    data = case(name, wall, rms_waves=rms, size=options.size, noise=options.noise)
    measured = Measurement(data.images, noise_sigma=float(data.noise_sigma[0]))
    found = wu2024_fit(
        measured,
        pupil(data, options.size),
        max_iterations=options.iterations,
        seed=wall,
        base=options.base,
    )
    return row(data, found, name, wall, rms, options)


def keep(line, path):
    """Print a line and add it to a file, if there is one."""
    text = json.dumps(line)
    print(text, flush=True)
    if path:
        with path.open("a") as file:
            file.write(text + "\n")


def of_scene(options):
    """One line: the scene's image by the simulator, fitted with the facets of its wall."""
    from nlosoptics import Scene, inverse, psf, reconstructing, simulate
    from nlosoptics.runs.veil import veil_shape

    scene = Scene.load(options.scene)
    camera = scene.camera
    size = options.size * camera.binning
    scene = replace(scene, camera=replace(camera, pixels=(size, size)))
    taken = simulate(scene, SCENE_TOL, seed=options.first_wall).image
    image, truth = taken.electrons, taken.ideal
    sigma = float(np.sqrt(image.mean() + (camera.read_noise * camera.binning) ** 2))
    model, veil = reconstructing.known_model(scene, tol=SCENE_TOL), veil_shape(scene)
    pupil = psf.exit_pupil(scene)
    seen = psf.SceneOptics(scene, pupil).reference.view
    # the facets are equilateral triangles; squares of the same area, as seen from the pupil
    side = scene.wall_roughness.heights.cell * (3**0.25 / 2)
    side /= np.sqrt(abs(np.linalg.det(seen.footprint)))
    count = 2 * int(np.ceil(pupil.radius / side)) + 1
    facets = inverse.FacetPSF(
        np.zeros((count, count, 2)),
        angle_pitch=side,
        pupil_radius=pupil.radius,
        image_distance=pupil.image_distance,
        pitch=scene.camera.image_pitch,
        shape=options.size,
        wavelength=scene.laser.wavelength,
    )
    spread = model.kernel / model.kernel.sum()
    x = np.arange(spread.shape[1]) - spread.shape[1] // 2
    blur = float(np.sqrt(spread.sum(axis=0) @ x**2))
    measured = inverse.Measurement(image, noise_sigma=sigma, background_shape=veil)
    found = inverse.wu2024_fit(
        measured, facets, start_rms=blur, seed=options.first_wall,
        base=options.base, max_iterations=options.iterations,
    )  # fmt: skip
    best = inverse.tv_deconvolve(measured, model)
    return {
        "scene": options.scene.stem,
        "seed": options.first_wall,
        "blur": round(blur, 2),
        "facets": count,
        "size": options.size,
        "image": round(inverse.registered_correlation(image, truth), 4),
        "correlation": round(inverse.registered_correlation(found, truth), 4),
        "known_wall": round(inverse.registered_correlation(best, truth), 4),
        "like_image": round(inverse.registered_correlation(found, image), 4),
        "status": found.status,
        "score": round(found.score, 4),
        "iterations": int(found.physical_parameters["iterations"]),
        "seconds": round(found.seconds, 1),
    }


def main():
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--walls", type=int, default=6)
    parser.add_argument("--first-wall", type=int, default=100)
    parser.add_argument("--rms", type=float, nargs="+", default=[0.25, 0.5, 1.0])
    parser.add_argument("--objects", nargs="+", default=["F", "arrow", "hanzi_zhong"])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--base", type=int, default=8)
    parser.add_argument("--iterations", type=int, default=4000)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--scene", type=Path)
    options = parser.parse_args()
    if options.scene:
        torch.set_num_threads(1)
        keep(of_scene(options), options.json)
        return
    done = set()
    if options.json and options.json.exists():
        lines = map(json.loads, options.json.read_text().splitlines())
        done = {(line["object"], line["wall"], line["rms"]) for line in lines}
    walls = range(options.first_wall, options.first_wall + options.walls)
    keys = [(name, wall, rms) for rms in options.rms for wall in walls for name in options.objects]
    jobs = [(*key, options) for key in keys if key not in done]
    fresh = multiprocessing.get_context("spawn")
    with fresh.Pool(options.jobs, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for line in pool.imap_unordered(one_case, jobs):
            keep(line, options.json)


if __name__ == "__main__":
    main()
