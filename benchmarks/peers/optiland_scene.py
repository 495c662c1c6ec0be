"""Wu's scene in Optiland's non-sequential tracer: flux, detections and seconds, JSON on stdout.

Started by traces.py in the peers' interpreter, with the scene as JSON on standard input. Optiland
scatters light forward and counts what arrives: it connects nothing to lens or letter, so with the
scene's lens hardly a ray in ten million is detected. Its best here: the lit spot as a source, which
saves the first reflection, the letter as three rectangles instead of triangles, no path records.
A perfect thin lens it does not have, so a database of the rays through the aperture stands for it.
"""

from __future__ import annotations

import json
import math
import sys
import time
from importlib.metadata import version

import numpy as np
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import (
    ExtendedSourceConfig,
    FinitePlaneGeometry,
    LambertianBSDF,
    NSQScene,
    RayDatabaseConfig,
    ReflectiveComponent,
    Spectrum,
)

MM = 1000.0


def rectangle(centre, size, albedo):
    """A Lambertian rectangle parallel to the wall."""
    x, y, z = (MM * c for c in centre)
    return ReflectiveComponent(
        CoordinateSystem(x, y, z),
        FinitePlaneGeometry(width=MM * size[0], height=MM * size[1]),
        reflectance=1.0,
        bsdf=LambertianBSDF(albedo),
    )


def load(job, stop):
    """The scene with a lens of diameter ``stop``, m."""
    given, scene = job["scene"], NSQScene()
    camera = given["camera"]
    scene.add_component("wall", rectangle((0, 0, 0), given["wall"], given["wall_albedo"]))
    for i, stroke in enumerate(given["strokes"]):
        scene.add_component(f"stroke {i}", rectangle(**stroke, albedo=given["letter_albedo"]))
    x, y, z = (MM * c for c in given["spot"])
    source = ExtendedSourceConfig(
        spectrum=Spectrum.monochromatic(0.6328),
        total_flux=given["spot_power"],
        aperture_radius=MM * math.sqrt(given["spot_area"] / math.pi),
        half_angle_deg=90.0,  # Lambertian
    )
    scene.add_source("spot", CoordinateSystem(x, y, z + 1e-3), source)
    axis = camera_axis(camera)
    x, y, z = (MM * c for c in camera["position"])
    place = CoordinateSystem(x, y, z, ry=math.atan2(axis[0], axis[2]))
    scene.add_detector("lens", place, RayDatabaseConfig(width=MM * stop, height=MM * stop))
    return scene


def camera_axis(camera):
    """Unit vector along the axis, which lies in the plane y = 0."""
    axis = np.subtract(camera["aim"], camera["position"])
    return axis / math.sqrt(axis @ axis)


def detected(rays, camera, stop, source_power):
    """Powers, W, of the rays that met the letter and fall on the detector.

    A thin lens images the plane in focus, so a ray arrives where its point there is imaged.
    """
    axis = camera_axis(camera)
    frame = np.stack([np.cross((0.0, 1.0, 0.0), axis), (0.0, 1.0, 0.0), axis])
    start = (np.stack([rays.x, rays.y, rays.z], -1) / MM - camera["position"]) @ frame.T
    back = -np.stack([rays.L, rays.M, rays.N], -1) @ frame.T
    focus = camera["focus_distance"]
    in_focus = start[:, :2] + back[:, :2] * ((focus - start[:, 2]) / back[:, 2])[:, None]
    half = camera["sensor"] / 2 * focus / camera["image_distance"]
    arrived = (abs(in_focus) < half).all(axis=1) & (back[:, 2] > 0)
    arrived &= (start[:, :2] ** 2).sum(axis=1) < stop**2 / 4  # the database is a square
    met = rays.flux < 0.9 * source_power  # straight from the spot they have lost nothing
    return rays.flux[arrived & met] * camera["transmission"]


def main():
    """Trace with each lens."""
    job, rows = json.load(sys.stdin), []
    for stop in job["stops"]:
        scene = load(job, stop)
        scene.trace(num_rays=1000, max_depth=job["reflections"], seed=1)
        best, powers = math.inf, []
        for seed in range(job["seeds"]):
            scene = load(job, stop)
            start = time.perf_counter()
            result = scene.trace(
                num_rays=job["n_rays"], max_depth=job["reflections"], seed=100 + seed
            )
            best = min(best, time.perf_counter() - start)
            each = job["scene"]["spot_power"] / job["n_rays"]
            powers.append(detected(result.detectors["lens"], job["scene"]["camera"], stop, each))
        rows.append(
            {
                "stop": stop,
                "n_rays": job["n_rays"],
                "seconds": best,
                "flux": float(np.concatenate(powers).sum() / job["seeds"]),
                "detections": sum(len(power) for power in powers),
            }
        )
    json.dump({"version": version("optiland"), "rows": rows}, sys.stdout)


if __name__ == "__main__":
    main()
