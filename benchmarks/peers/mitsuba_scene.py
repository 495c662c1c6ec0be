"""Wu's scene in Mitsuba 3: flux and seconds of independent renderings, JSON on standard output.

Started by traces.py in the peers' interpreter, with the scene as JSON on standard input. The lit
spot is an emitter of its own, so that emitter sampling finds it; the film is small, for the total
alone counts. The integrators are those that Mitsuba has for such a scene:

- path: from the camera; connects letter and spot, but must find the letter by chance;
- ptracer: from the spot; connects wall and camera, but must find the letter by chance;
- ptracer, aimed: the same from a projector that lights no more than a rectangle about the letter.
"""

from __future__ import annotations

import json
import math
import sys
import time

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
T = mi.ScalarTransform4f

FILM = 64  # pixels along each side
#: Integrator, sampler and whether it is aimed. The low-discrepancy sampler is the fastest for paths
#: and gives wrong fluxes, by a quarter, with the light tracer.
WAYS = (
    ("path", "ldsampler", False),
    ("ptracer", "independent", False),
    ("ptracer, aimed", "independent", True),
)
LIFT = 1e-5  # m, of the emitter over the wall, which float32 resolves


def mesh(name, vertices, faces, albedo):
    """A Lambertian mesh that reflects from its front alone."""
    properties = mi.Properties()
    properties["bsdf"] = diffuse(albedo)
    shape = mi.Mesh(name, len(vertices), len(faces), props=properties)
    values = mi.traverse(shape)
    values["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    values["faces"] = np.ravel(faces).astype(np.uint32)
    values.update()
    return shape


def diffuse(albedo):
    """A Lambertian material, one-sided."""
    return mi.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}})


def spot(scene):
    """The lit spot as a Lambertian disc of its area."""
    x, y, z = scene["spot"]
    radius = math.sqrt(scene["spot_area"] / math.pi)
    radiance = scene["spot_power"] / (math.pi * scene["spot_area"])
    return {
        "type": "disk",
        "to_world": T().translate([x, y, z + LIFT]).scale(radius),
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": radiance}},
    }


def projector(scene, texels=512):
    """The lit spot as a projector upon the rectangle about the letter.

    A Lambertian source of power P gives (P/pi) cos^4 on a plane one metre off, and Mitsuba's
    projector sends out pi times what its picture says.
    """
    x, y, z = scene["spot"]
    seen = (np.array(scene["letter"]["vertices"]) - [x, y, z])[:, :2] / (
        np.array(scene["letter"]["vertices"])[:, 2:] - z
    )
    half = 1.02 * abs(seen).max()
    centres = (np.arange(texels) + 0.5) * (2 * half / texels) - half
    margin = 4 * half / texels
    right, up = np.meshgrid(centres, centres)
    inside = np.ones(right.shape, bool)
    for i, along in enumerate((right, up)):
        inside &= (along > seen[:, i].min() - margin) & (along < seen[:, i].max() + margin)
    values = inside / (1 + right**2 + up**2) ** 2 * scene["spot_power"] / math.pi**2
    # pictures have their first row on top, and the projector's left is +x
    picture = mi.Bitmap(values[::-1, ::-1, None].astype(np.float32))
    return {
        "type": "projector",
        "irradiance": {"type": "bitmap", "bitmap": picture, "raw": True, "wrap_mode": "clamp"},
        "fov": math.degrees(2 * math.atan(half)),
        "to_world": T().look_at([x, y, z + LIFT], [x, y, z + 1], [0, 1, 0]),
    }


def load(scene, sampler, aimed):
    """The Mitsuba scene, and the extent (m^2 sr) by which pixels add up to a flux."""
    camera = scene["camera"]
    distance, half = camera["image_distance"], camera["sensor"] / 2
    x, y = (np.array(scene["wall"]) / 2).tolist()
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    centres = (np.arange(FILM) + 0.5) * (2 * half / FILM) - half
    square = centres[:, None] ** 2 + centres**2 + distance**2
    pixel = (2 * half / FILM) ** 2
    # radiance to power: lens area x pixel area x cos^4/d^2
    lens = math.pi / 4 * camera["stop_diameter"] ** 2
    extent = lens * pixel * distance**2 / square**2 * camera["transmission"]
    loaded = mi.load_dict(
        {
            "type": "scene",
            "wall": mesh("wall", corners, [(0, 1, 2), (0, 2, 3)], scene["wall_albedo"]),
            "letter": mesh("letter", **scene["letter"], albedo=scene["letter_albedo"]),
            "emitter": projector(scene) if aimed else spot(scene),
            "sensor": {
                "type": "thinlens",
                "to_world": T().look_at(camera["position"], camera["aim"], [0, 1, 0]),
                "fov": math.degrees(2 * math.atan(half / distance)),
                "aperture_radius": camera["stop_diameter"] / 2,
                "focus_distance": camera["focus_distance"],
                "film": {
                    "type": "hdrfilm",
                    "width": FILM,
                    "height": FILM,
                    "pixel_format": "luminance",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": sampler},
            },
        }
    )
    return loaded, extent


def render(scene, extent, integrator, samples, seed):
    """Flux, W, and seconds of one rendering of ``samples`` a pixel."""
    start = time.perf_counter()
    image = mi.render(scene, integrator=integrator, spp=samples, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    seconds = time.perf_counter() - start
    return float((np.array(image)[..., 0].astype(np.float64) * extent).sum()), seconds


def main():
    """Render each integrator at each number of samples with several seeds."""
    job = json.load(sys.stdin)
    dr.set_thread_count(job["threads"])
    rows = []
    for name, sampler, aimed in WAYS:
        scene, extent = load(job["scene"], sampler, aimed)
        for reflections in job["reflections"]:
            integrator = mi.load_dict({"type": name.split(",")[0], "max_depth": reflections})
            for samples in job["samples"]:
                render(scene, extent, integrator, samples, seed=10**6)  # compiles
                runs = [
                    render(scene, extent, integrator, samples, seed) for seed in range(job["seeds"])
                ]
                fluxes, seconds = zip(*runs, strict=True)
                rows.append(
                    {
                        "name": name,
                        "reflections": reflections,
                        "n_rays": samples * FILM**2,
                        "flux": fluxes,
                        "seconds": seconds,
                    }
                )
    json.dump({"version": mi.__version__, "variant": mi.variant(), "rows": rows}, sys.stdout)


if __name__ == "__main__":
    main()
