"""Seconds and errors of the wall's transport matrix, past three discs.

    python benchmarks/wall_transport.py [--largest 64]

CPU seconds to build the matrix, to apply it and its adjoint, and to differentiate by a pose, for
growing numbers of pixels and cells; the rank of its factors; and the error that the choice of wall
points in a pixel leaves, against 20 times as many.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
import trimesh

DISCS = ((-0.1, 0.05, 0.5), (0.08, -0.06, 0.45), (-0.02, 0.12, 0.6))


def disc(radius, at, corners=64):
    """Disc parallel to the wall as a fan of triangles."""
    angles = 2 * math.pi * np.arange(corners) / corners
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles], axis=1)
    faces = [[corners, i, (i + 1) % corners] for i in range(corners)]
    return trimesh.Trimesh(np.vstack([rim, np.zeros(3)]) + at, faces, process=False)


def scene():
    """Plane of 0.7 m, 1 m before a matt wall, three discs of 12 cm between."""
    from nlosoptics.scene import Camera, FlatWall, Lambert, Laser, PlanarObject, Scene

    return Scene(
        Laser(wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.31, 0.0, 1.159)),
        FlatWall(),
        PlanarObject(np.ones((8, 8)), 0.7, position=(0.0, 0.0, 1.0), material=Lambert(0.8)),
        Camera(
            position=(-0.6, 0.0, 0.8),
            aim=(-0.3, 0.0, 0.0),
            focal_length=0.0506,
            stop_diameter=0.0253,
            binning=16,
            exposure=40e-3,
        ),
        wall_material=Lambert(0.8),
        occluders=tuple(disc(0.06, np.array(at)) for at in DISCS),
    )


def seconds(call):
    """CPU seconds of a call and its result."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def main():
    """Print one line for each size, and growth exponents from the last two."""
    from nlosoptics.imaging import WallTransport

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--largest", type=int, default=64, help="pixels along a side")
    options = parser.parse_args()
    shaded, rng = scene(), np.random.default_rng(0)
    first = WallTransport(shaded, cells=(4, 4), pixels=(4, 4))
    first.pose_derivative(np.ones((4, 4)))  # compiles
    first.forward(np.ones((4, 4)))
    rows, side = [], 8
    while side <= options.largest:
        pixels, cells = (side, side), (3 * side // 4, 3 * side // 4)
        transport = WallTransport(shaded, cells=cells, pixels=pixels)
        f, y = rng.random(cells), rng.random(pixels)
        build, _ = seconds(lambda t=transport: t.matrix)
        apply, _ = seconds(lambda t=transport, f=f: t.forward(f))
        back, _ = seconds(lambda t=transport, y=y: t.adjoint(y))
        pose, _ = seconds(lambda t=transport, f=f: t.pose_derivative(f))
        rows.append((side * side * cells[0] ** 2, build, apply, pose))
        print(
            f"{side} x {side} pixels, {cells[0]} x {cells[0]} cells: build {build:.3g} s, apply "
            f"{1e3 * apply:.3g} ms, adjoint {1e3 * back:.3g} ms, derivative {pose:.3g} s",
            flush=True,
        )
        side *= 2
    growth = [math.log(b / a) for a, b in zip(rows[-2], rows[-1], strict=True)]
    shares = ", ".join(f"{g / growth[0]:.2f}" for g in growth[1:])
    print(f"growth exponents in elements: {shares} (build, apply, derivative)")
    spent, (left, _) = seconds(lambda: transport.factors(1e-3))
    print(f"factors to 1e-3: rank {left.shape[1]} of {min(transport.shape)}, {spent:.3g} s")
    small = WallTransport(shaded, cells=(24, 24), pixels=(32, 32))
    fine = WallTransport(shaded, cells=(24, 24), pixels=(32, 32), samples=256)
    letter = np.kron(rng.random((8, 8)) > 0.5, np.ones((3, 3)))
    entry = np.sqrt(np.mean((small.matrix - fine.matrix) ** 2)) / fine.matrix.max()
    exact = fine.forward(letter)
    image = np.sqrt(np.mean((small.forward(letter) - exact) ** 2)) / exact.mean()
    print(f"32 x 32 to 24 x 24: {entry:.2g} of the largest element rms, {image:.2g} of an image")


if __name__ == "__main__":
    main()
