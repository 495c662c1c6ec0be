"""A hidden mesh in mitransient: captures and seconds at several sample counts.

Started by transient/rendering.py in the peers' interpreter, with the scene as JSON on standard
input: vertices, faces, albedo, points along a side of the wall, its side, bins, the laser's place
and target, sample counts and seeds. Writes the captures to the .npz file that the scene names, as
`H_<samples>` [y, x, t], and JSON lines of seconds on standard output. All of mitransient's own ways
to sample are on: laser sampling and hidden geometry sampling.
"""

from __future__ import annotations

import json
import sys
import time

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
import mitransient as mitr  # noqa: E402  (needs the variant)


def mesh(vertices, faces, albedo):
    """A Lambertian mesh."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": albedo}}
    )
    shape = mi.Mesh("hidden", len(vertices), len(faces), props=properties)
    values = mi.traverse(shape)
    values["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    values["faces"] = np.ravel(faces).astype(np.uint32)
    values.update()
    return shape


def build(scene):
    """The scene: relay wall with its sensor, laser and hidden mesh."""
    sensor = {
        "type": "nlos_capture_meter",
        "sampler": {"type": "independent", "sample_count": 1},
        "sensor_origin": scene["laser_origin"],
        "transient_film": {
            "type": "transient_hdr_film",
            "width": scene["count"],
            "height": scene["count"],
            "temporal_bins": scene["n_bins"],
            "bin_width_opl": scene["delta_t"],
            "start_opl": scene["t_start"],
            "rfilter": {"type": "box"},
        },
    }
    world = {
        "type": "scene",
        "integrator": {
            "type": "transient_nlos_path",
            "nlos_laser_sampling": True,
            "nlos_hidden_geometry_sampling": True,
            "nlos_hidden_geometry_sampling_includes_relay_wall": False,
            "temporal_filter": "box",
            "account_first_and_last_bounces": False,
            "filter_bounces": scene["filter_bounces"],
            "max_depth": -1,
        },
        "wall": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(scene["side"] / 2),
            "bsdf": {"type": "diffuse", "reflectance": 1.0},
            "sensor": sensor,
        },
        "laser": {
            "type": "projector",
            "irradiance": 100.0,
            "fov": 0.2,
            "to_world": mi.ScalarTransform4f().translate(scene["laser_origin"]),
        },
        "hidden": mesh(scene["vertices"], scene["faces"], scene["albedo"]),
    }
    loaded = mi.load_dict(world)
    mitr.nlos.focus_emitter_at_relay_wall_3dpoint(
        mi.Point3f(scene["laser_point"]), loaded.shapes()[_wall(loaded)], loaded.emitters()[0]
    )
    return loaded


def _wall(scene):
    return next(i for i, shape in enumerate(scene.shapes()) if shape.is_sensor())


def capture(scene, samples, seed):
    """[y, x, t] and the seconds it took."""
    start = time.perf_counter()
    _, found = mi.render(scene, spp=samples, seed=seed)
    values = np.array(found)
    return values.reshape(values.shape[:3]), time.perf_counter() - start


def main():
    """Render all that is asked for."""
    asked = json.load(sys.stdin)
    scene = build(asked)
    capture(scene, 16, 99)  # compiles
    captures = {}
    for samples in asked["samples"]:
        found, least = None, np.inf
        for seed in range(asked["repeats"]):
            found, seconds = capture(scene, samples, seed)
            least = min(least, seconds)
        captures[f"H_{samples}"] = found
        print(json.dumps({"samples": samples, "seconds": least}), flush=True)
    np.savez(asked["file"], **captures)


if __name__ == "__main__":
    main()
