"""Modes that a wall's wide lobes pass, by `limits.relay` and by brute force.

    python benchmarks/relay_modes.py [--scenes 20] [--json FILE]

Each scene is drawn at random: wall with matt and wide mirror-like lobes, exposure, distance and
size of the object, and a disc, a rectangle, a ball or nothing in between. Brute force takes every
image pixel as a bin, 16 random paths per pixel, 9 points per cell and closed-form shadows, and
counts the singular values above 1 of the whole matrix. Scenes that the file holds are not done
again.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import trimesh
from scipy import constants

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "relay_modes.jsonl"
CELLS, PATHS, PARTS, ALBEDO, CONTRAST = 24, 16, 3, 0.35, 0.3
REFLECTANCE = 0.8  # of a white object
KINDS = ("disc", "rectangle", "ball", "none")


def disc(radius, at):
    """Disc parallel to the wall as a mesh of 64 triangles of the same area."""
    n = 64
    angles = 2 * math.pi * np.arange(n) / n
    rim = radius * math.sqrt(2 * math.pi / n / math.sin(2 * math.pi / n))
    corners = np.stack([rim * np.cos(angles), rim * np.sin(angles), 0 * angles], axis=1)
    faces = [[n, i, (i + 1) % n] for i in range(n)]
    return trimesh.Trimesh(np.vstack([corners, np.zeros(3)]) + at, faces, process=False)


def rectangle(half, at):
    """Rectangle parallel to the wall as two triangles."""
    a, b = half
    corners = np.array([[-a, -b, 0], [a, -b, 0], [a, b, 0], [-a, b, 0]]) + at
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def drawn_scene(index):
    """Scene number ``index`` and what was drawn for it."""
    from nlosoptics.scene import (
        Camera,
        FlatWall,
        Lambert,
        Laser,
        PlanarObject,
        Scene,
        SpecularMicrofacet,
        SumMaterial,
    )

    rng = np.random.default_rng([11, index])
    z, size = float(rng.uniform(0.6, 1.3)), float(rng.uniform(0.3, 0.7))
    kind = KINDS[index % len(KINDS)]
    at = np.array([*rng.uniform(-0.15, 0.15, 2), z * rng.uniform(0.3, 0.95)])
    extent = rng.uniform(0.02, 0.1, 2)
    slope = float(rng.uniform(0.06, 0.2)) if index % 3 == 0 else None
    exposure = float(np.exp(rng.uniform(math.log(10e-3), math.log(400e-3))))
    lobes = (Lambert(0.8),) + ((SpecularMicrofacet(0.05, slope),) if slope else ())
    meshes = {
        "disc": lambda: disc(extent[0], at),
        "rectangle": lambda: rectangle(extent, at),
        "ball": lambda: trimesh.creation.icosphere(4, extent[0]).apply_translation(at),
    }
    scene = Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.31, 0.0, 1.159)),
        FlatWall(),
        PlanarObject(
            np.full((8, 8), 0.35), size, position=(0.0, 0.0, z), material=Lambert(REFLECTANCE)
        ),
        Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(-0.3, 0.0, 0.0),
            focal_length=0.0506,
            stop_diameter=0.0253,
            binning=64,
            exposure=exposure,
        ),
        wall_material=SumMaterial(*lobes) if slope else lobes[0],
        occluders=(meshes[kind](),) if kind in meshes else (),
    )
    drawn = {"kind": kind, "distance": z, "size": size, "slope_rms": slope, "exposure": exposure}
    return scene, drawn | {"at": at.tolist(), "extent": extent.tolist()}


def blocked(drawn, start, end):
    """Whether the occluder's closed form cuts the lines between points (..., 3)."""
    at, extent = np.array(drawn["at"]), drawn["extent"]
    line = end - start
    if drawn["kind"] == "ball":
        offset = at - start
        t = np.clip((offset * line).sum(-1) / (line * line).sum(-1), 0.0, 1.0)
        return ((offset - t[..., None] * line) ** 2).sum(-1) < extent[0] ** 2
    t = (at[2] - start[..., 2]) / line[..., 2]
    dx, dy = (start[..., k] + t * line[..., k] - at[k] for k in (0, 1))
    within = (t > 0.0) & (t < 1.0)
    if drawn["kind"] == "disc":
        return within & (dx * dx + dy * dy < extent[0] ** 2)
    return within & (abs(dx) < extent[0]) & (abs(dy) < extent[1])


def brute_force(scene, drawn):
    """Number of singular values above 1."""
    camera, rng = scene.camera, np.random.default_rng(0)
    ny, nx = camera.shape
    e1, e2, axis = camera.frame
    lens, pitch, d = np.array(camera.position), camera.image_pitch, scene.image_distance
    side, z = scene.hidden.size[0] / CELLS, scene.hidden.position[2]

    def grid(count):
        across = ((np.arange(count) + 0.5) / count - 0.5) * side * CELLS
        x, y = np.meshgrid(across, across)
        return np.stack([x, y, np.full(x.shape, z)], axis=-1)

    row, column = np.divmod(np.arange(ny * nx), nx)
    centre = np.stack([column - (nx - 1) / 2, row - (ny - 1) / 2], axis=1) * pitch

    def rays(place):
        return d * axis - place[:, :1] * e1 - place[:, 1:] * e2

    def on_wall(start, direction):
        return start - direction * (start[..., 2:] / direction[..., 2:])

    middle = on_wall(lens, rays(centre))
    fine, free = grid(CELLS * PARTS), np.ones((ny * nx, CELLS * CELLS))
    spot = np.array([0.0, 0.0, 0.0])
    if drawn["kind"] != "none":
        lit = ~blocked(drawn, spot, fine)
        free[:] = 0.0
        for k in range(PATHS):
            # a stratified part of the pixel, and a lens point of a stratified area
            cell = np.stack([np.full(ny * nx, k % 4), np.full(ny * nx, k // 4)], axis=1)
            place = centre + ((cell + rng.random((ny * nx, 2))) / 4 - 0.5) * pitch
            radius = camera.stop_diameter / 2 * np.sqrt(((7 * k) % 16 + rng.random(ny * nx)) / 16)
            angle = rng.uniform(0, 2 * math.pi, ny * nx)
            through = lens + radius[:, None] * (
                np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
            )
            focus = lens + rays(place) * (scene.focus_distance / d)
            points = on_wall(through, focus - through)
            open_view = ~blocked(drawn, points, through)
            for start in range(0, ny * nx, 64):
                block = slice(start, start + 64)
                seen = lit & ~blocked(drawn, points[block, None, None], fine)
                parts = seen.reshape(-1, CELLS, PARTS, CELLS, PARTS).mean(axis=(2, 4))
                free[block] += parts.reshape(len(parts), -1) * open_view[block, None] / PATHS
    cells = grid(CELLS).reshape(-1, 3)
    back = cells - spot
    far = (back * back).sum(-1)
    cosine = z / np.sqrt(far)
    # power times f_r cos of the wall, cos/r^2 to the object, f_o of white
    normal = np.array([0.0, 0.0, 1.0])
    inward = np.array(scene.laser.position) / np.linalg.norm(scene.laser.position)
    leaving = scene.wall_material.evaluate(inward, back / np.sqrt(far)[:, None], normal)
    radiance = scene.laser.power * leaving * cosine * cosine / far
    radiance *= REFLECTANCE / math.pi
    toward = cells - middle[:, None]
    square = (toward * toward).sum(-1)
    toward /= np.sqrt(square)[..., None]
    view = lens - middle
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    lobe = scene.wall_material.evaluate(toward, view[:, None], normal)
    light = lobe * radiance * toward[..., 2] ** 2 * side**2 / square * free
    off_axis = d / np.sqrt(d * d + (centre**2).sum(-1))
    sine = 1.0 / math.sqrt(1.0 + (2 * d / camera.stop_diameter) ** 2)
    gain = math.pi * camera.transmission * sine**2 * off_axis**4 * pitch**2 * camera.exposure
    gain *= camera.quantum_efficiency * scene.laser.wavelength / (constants.h * constants.c)
    response = light * gain[:, None]
    step = camera.full_well / 2**camera.bit_depth
    variance = ALBEDO * response.sum(axis=1) + camera.binning**2 * (
        camera.read_noise**2 + step**2 / 12 + camera.dark_current * camera.exposure
    )
    values = np.linalg.svd(CONTRAST * response / np.sqrt(variance)[:, None], compute_uv=False)
    return int((values > 1.0).sum())


def compared(index):
    """Both counts of one scene, as a line of JSON."""
    from nlosoptics.limits.relay import count_modes, relay_light

    scene, drawn = drawn_scene(index)
    relay_light(scene, bins=6)
    started = time.process_time()
    found = count_modes(relay_light(scene).signal)
    seconds = time.process_time() - started
    expected = brute_force(scene, drawn)
    return {
        "scene": index,
        "kind": drawn["kind"],
        "drawn": drawn,
        "modes": found,
        "brute_force": expected,
        "cpu_seconds": seconds,
        "brute_force_cpu_seconds": time.process_time() - started - seconds,
    }


def main():
    """Compare all scenes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--json", type=Path, default=RESULTS, help="file of results")
    options = parser.parse_args()
    text = options.json.read_text() if options.json.is_file() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    for index in range(len(rows), options.scenes):
        row = compared(index)
        rows.append(row)
        print(row, flush=True)
        options.json.write_text("".join(json.dumps(row) + "\n" for row in rows))
    off = [abs(row["modes"] / max(row["brute_force"], 1) - 1.0) for row in rows]
    print(f"{sum(d <= 0.1 for d in off)} of {len(off)} within 10 %, largest {max(off):.0%}")


if __name__ == "__main__":
    main()
