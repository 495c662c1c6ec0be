"""Whether connected traces agree with the plain walk of light, over random scenes.

python benchmarks/random_traces.py [--first 0] [--count 200] [--rays 4096] [--json FILE.jsonl]

Each scene has a random wall, random materials, a picture or a mesh, often an occluder, and a lens
so wide that the plain walk (``analog``, with a hundred times the rays) meets it often enough. A
line per scene holds the difference of the fluxes in standard errors of both; where the walk
detected nothing it is 0. Scenes that FILE holds are not run again. About ten minutes of one core.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
import trimesh

from nlosoptics.raytrace import trace
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    WavyWall,
)

MORE = 100  # rays of the plain walk to one of the trace
MOST_BOUNCES = 4


def material(draw):
    """A matt, glossy or mixed material."""
    kind = draw.integers(5)
    matt = Lambert(draw.uniform(0.3, 0.9))
    distribution = ("beckmann", "ggx")[draw.integers(2)]
    gloss = SpecularMicrofacet(
        draw.uniform(0.1, 0.5), draw.uniform(0.05, 0.5), distribution=distribution
    )
    if kind == 0:
        return OrenNayar(draw.uniform(0.3, 0.9), draw.uniform(0.1, 0.6))
    if kind == 1:
        return SpecularMicrofacet(0.9, draw.uniform(0.15, 0.6), distribution=distribution)
    return matt if kind < 4 else SumMaterial(Lambert(0.4), gloss)


def wall(draw):
    """A flat, convex, hollow or wavy wall."""
    size = draw.uniform(1.6, 2.4)
    return (
        FlatWall(size=size),
        ConvexWall(draw.uniform(2.0, 6.0), size=size),
        ConcaveWall(draw.uniform(2.5, 6.0), size=size),
        WavyWall(draw.uniform(0.005, 0.04), draw.uniform(0.3, 0.8), size=size),
    )[draw.integers(4)]


def hidden(draw):
    """A picture or a mesh that faces the wall."""
    place = (draw.uniform(0.15, 0.5), draw.uniform(-0.2, 0.2), draw.uniform(0.6, 0.9))
    turn = {name: draw.uniform(-0.5, 0.5) for name in ("yaw", "pitch", "roll")}
    kind = draw.integers(4)
    if kind == 0:
        picture = draw.uniform(0.0, 1.0, (4, 5))
        return PlanarObject(picture, 0.5, position=place, material=material(draw), **turn)
    mesh = (
        trimesh.creation.icosphere(subdivisions=int(draw.integers(1, 4)), radius=0.25),
        trimesh.creation.box(draw.uniform(0.1, 0.5, 3)),
        trimesh.creation.torus(0.2, 0.08, 24, 12),
    )[kind - 1]
    return MeshObject(mesh=mesh, position=place, material=material(draw), **turn)


def scene(number):
    """The random scene of a number."""
    draw = np.random.default_rng([23, number])
    screen = trimesh.creation.box((*draw.uniform(0.05, 0.3, 2), 0.01))
    screen.apply_translation((draw.uniform(-0.2, 0.3), draw.uniform(-0.2, 0.2), 0.35))
    return Scene(
        Laser(
            wavelength=633e-9,
            power=1.0,
            beam_diameter=draw.uniform(1e-3, 0.02),
            position=(draw.uniform(-0.1, 0.1), 0.7, 1.3),
            aim=(draw.uniform(-0.3, 0.6), draw.uniform(-0.3, 0.4), 0.0),
        ),
        wall(draw),
        hidden(draw),
        Camera(
            position=(-0.5, draw.uniform(-0.2, 0.2), draw.uniform(0.7, 1.0)),
            aim=(draw.uniform(-0.2, 0.2), 0.0, 0.0),
            focal_length=0.3,
            stop_diameter=draw.uniform(0.2, 0.35),
            focus_distance=1.0,
            pixel_pitch=5e-3,
            pixels=(80, 80),
            binning=1,
        ),
        occluders=(screen,) if draw.integers(2) else (),
        wall_material=material(draw),
    )


def compared(number, n_rays):
    """Row of one scene."""
    given = scene(number)
    ours = trace(given, n_rays=n_rays, max_bounces=MOST_BOUNCES, seed=number)
    walk = trace(
        given, n_rays=MORE * n_rays, max_bounces=MOST_BOUNCES, seed=number + 10**6, analog=True
    )

    def off(a, b, a_error, b_error):
        # a walk that detected nothing states no error, and says nothing
        return (a - b) / math.hypot(a_error, b_error) if b > 0.0 else 0.0

    return {
        "number": number,
        "wall": type(given.wall).__name__,
        "hidden": type(given.hidden).__name__,
        "occluders": len(given.occluders),
        "flux": ours.flux,
        "relative_error": ours.standard_error / ours.flux if ours.flux else None,
        "walk_relative_error": walk.standard_error / walk.flux if walk.flux else None,
        "off": off(ours.flux, walk.flux, ours.standard_error, walk.standard_error),
    }


def main():
    """Run what is missing, and sum up."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--rays", type=int, default=4096)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    held = {}
    if options.json and options.json.exists():
        rows = map(json.loads, options.json.read_text().splitlines())
        held = {row["number"]: row for row in rows}
    for number in range(options.first, options.first + options.count):
        if number not in held:
            held[number] = compared(number, options.rays)
            if options.json:
                with options.json.open("a") as file:
                    file.write(json.dumps(held[number]) + "\n")
    lit = [row for row in held.values() if row["walk_relative_error"] is not None]
    offs = np.array([row["off"] for row in lit])
    print(f"{len(held)} scenes, {len(held) - len(lit)} without any light in the plain walk")
    print(f"largest difference {abs(offs).max():.2f} standard errors, rms {offs.std():.2f}")


if __name__ == "__main__":
    main()
