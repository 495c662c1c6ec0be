"""A scene in Mitsuba 3: flux and processor time of single renderings, asked for line by line.

Started by traces.py in the peers' interpreter. Each line of the standard input is a JSON job, each
answered by a line on the standard output: {"scene": ...} loads a scene, and {"way", "samples",
"seed"} renders it. The lit spot is an emitter of its own, so that emitter sampling finds it; the
film is small, for the total alone counts. The ways are those that Mitsuba has for such a scene:

- path: from the camera; connects object and spot, but must find the object by chance;
- ptracer, aimed: from a projector in the spot that lights no more than a rectangle about the
  object; connects wall and camera.

A glossy spot is a projector for both, since Mitsuba's surfaces emit as Lambert's or along their
normal alone.
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
#: Integrator and sampler. The low-discrepancy sampler is the fastest for paths and gives wrong
#: fluxes, by a quarter, with the light tracer.
WAYS = {"path": ("path", "ldsampler"), "ptracer, aimed": ("ptracer", "independent")}
LIFT = 1e-5  # m, of the emitter over the wall, which float32 resolves


def mesh(name, vertices, faces, material):
    """A mesh of flat triangles that reflect from their front alone."""
    properties = mi.Properties()
    properties["bsdf"] = material
    shape = mi.Mesh(name, len(vertices), len(faces), props=properties)
    values = mi.traverse(shape)
    values["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    values["faces"] = np.ravel(faces).astype(np.uint32)
    values.update()
    return shape


def uniform(value):
    """A spectrum of one value."""
    return {"type": "uniform", "value": value}


def diffuse(albedo):
    """A Lambertian material, one-sided."""
    return mi.load_dict({"type": "diffuse", "reflectance": uniform(albedo)})


def wall(scene):
    """The relay wall: a rectangle, or a sphere that lies behind the plane z = 0."""
    material = diffuse(scene["wall_albedo"])
    if scene["wall_alpha"] is not None:
        material = mi.load_dict(
            {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha": scene["wall_alpha"],
                "specular_reflectance": uniform(scene["wall_albedo"]),
            }
        )
    if "radius" in scene["wall"]:
        radius = scene["wall"]["radius"]
        return {"type": "sphere", "center": [0, 0, -radius], "radius": radius, "bsdf": material}
    x, y = (np.array(scene["wall"]["size"]) / 2).tolist()
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    return mesh("wall", corners, [(0, 1, 2), (0, 2, 3)], material)


def disc(scene):
    """The lit spot as a Lambertian disc of its area."""
    spot = scene["spot"]
    position, normal = np.array(spot["position"]), np.array(spot["normal"])
    start = position + LIFT * normal
    radius = math.sqrt(spot["area"] / math.pi)
    radiance = spot["power"] / (math.pi * spot["area"])
    return {
        "type": "disk",
        "to_world": T().look_at(start.tolist(), (start + normal).tolist(), [0, 1, 0]).scale(radius),
        "emitter": {"type": "area", "radiance": uniform(radiance)},
    }


def projector(scene):
    """The lit spot as a projector along z; Mitsuba sends out pi times what its picture says."""
    x, y, z = scene["spot"]["position"]
    picture = np.array(scene["projector"]["picture"])
    # pictures have their first row on top, and the projector's left is +x
    bitmap = mi.Bitmap(picture[::-1, ::-1, None].astype(np.float32))
    return {
        "type": "projector",
        "irradiance": {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"},
        "fov": math.degrees(2 * math.atan(scene["projector"]["half"])),
        "to_world": T().look_at([x, y, z + LIFT], [x, y, z + 1], [0, 1, 0]),
    }


def load(scene, way):
    """The Mitsuba scene of a way, and the extent (m^2 sr) by which pixels add up to a flux."""
    camera = scene["camera"]
    distance, half = camera["image_distance"], camera["sensor"] / 2
    centres = (np.arange(FILM) + 0.5) * (2 * half / FILM) - half
    square = centres[:, None] ** 2 + centres**2 + distance**2
    pixel = (2 * half / FILM) ** 2
    # radiance to power: lens area x pixel area x cos^4/d^2
    lens = math.pi / 4 * camera["stop_diameter"] ** 2
    extent = lens * pixel * distance**2 / square**2 * camera["transmission"]
    is_disc = way == "path" and scene["wall_alpha"] is None
    shapes = {
        f"mesh{i}": mesh(f"mesh{i}", part["vertices"], part["faces"], diffuse(part["albedo"]))
        for i, part in enumerate(scene["meshes"])
    }
    loaded = mi.load_dict(
        {
            "type": "scene",
            "wall": wall(scene),
            **shapes,
            "emitter": disc(scene) if is_disc else projector(scene),
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
                "sampler": {"type": WAYS[way][1]},
            },
        }
    )
    return loaded, extent


def render(scene, extent, integrator, samples, seed):
    """Flux, W, and processor time, s, of one rendering of ``samples`` a pixel."""
    start = time.process_time()
    image = mi.render(scene, integrator=integrator, spp=samples, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    seconds = time.process_time() - start
    return float((np.array(image)[..., 0].astype(np.float64) * extent).sum()), seconds


def main():
    """Answer jobs until the input ends."""
    loaded = {}
    for line in sys.stdin:
        job = json.loads(line)
        if "scene" in job:
            dr.set_thread_count(job["threads"])
            loaded = {way: load(job["scene"], way) for way in WAYS}
            integrators = {
                way: mi.load_dict({"type": kind, "max_depth": job["reflections"]})
                for way, (kind, _) in WAYS.items()
            }
            answer = {"version": mi.__version__, "variant": mi.variant(), "ways": list(WAYS)}
        else:
            way = job["way"]
            flux, seconds = render(*loaded[way], integrators[way], job["samples"], job["seed"])
            answer = {"flux": flux, "seconds": seconds, "n_rays": job["samples"] * FILM**2}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
