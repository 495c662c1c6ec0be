"""Captures by mitransient 1.3.1: its seconds and light, JSON in, a file of arrays out.

Started by scripts of transient/ in the peers' interpreter. The job on standard input has
``triangles`` (name to a list of triangles, m) with ``albedos``, the wall's half side, the laser's
target, ``size``, ``bins``, ``bin_width``, ``start``, ``bounces`` (of paths, wall included),
``samples`` per point, ``seeds``, ``aimed`` and ``out``. ``aimed`` turns on the sampling of hidden
geometry: paths are then aimed at points of surfaces whether they are visible or not, and what is in
front of such a point takes the light as its own, so that an object before a back wall counts twice.
``wall_aimed``, if given, says whether the relay wall is aimed at as well.
"""

from __future__ import annotations

import json
import sys
import time

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
import mitransient as mitr  # noqa: E402  (needs the variant)

T = mi.ScalarTransform4f


def grey(albedo):
    """A Lambertian material, one-sided."""
    return {"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}}


def mesh(name, triangles, albedo):
    """Triangles as a shape."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(grey(albedo))
    corners = np.asarray(triangles, dtype=np.float32).reshape(-1, 3)
    shape = mi.Mesh(name, len(corners), len(corners) // 3, props=properties)
    values = mi.traverse(shape)
    values["vertex_positions"] = corners.ravel()
    values["faces"] = np.arange(len(corners), dtype=np.uint32)
    values.update()
    return shape


def scene(job):
    """The wall with its meter, the laser and the hidden surfaces."""
    size = job["size"]
    film = {
        "type": "transient_hdr_film",
        "width": size,
        "height": size,
        "temporal_bins": job["bins"],
        "bin_width_opl": job["bin_width"],
        "start_opl": job["start"],
        "rfilter": {"type": "box"},
    }
    meter = {
        "type": "nlos_capture_meter",
        "sampler": {"type": "independent"},
        "sensor_origin": [-0.5, 0.0, 0.25],
        "transient_film": film,
    }
    wall = {
        "type": "rectangle",
        "to_world": T().scale([job["half_side"], job["half_side"], 1.0]),
        "bsdf": grey(1.0),
        "sensor": meter,
    }
    laser = {
        "type": "projector",
        "irradiance": 100.0,
        "fov": 0.2,
        "to_world": T().look_at(origin=job["laser"], target=job["target"], up=[0, 1, 0]),
    }
    integrator = {
        "type": "transient_nlos_path",
        "nlos_laser_sampling": True,
        "nlos_hidden_geometry_sampling": bool(job["aimed"]),
        "nlos_hidden_geometry_sampling_includes_relay_wall": bool(
            job.get("wall_aimed", job["aimed"])
        ),
        "filter_bounces": job["bounces"] - 1,  # counted without the first
        "max_depth": -1,
        "temporal_filter": "box",
    }
    things = {
        name: mesh(name, triangles, job["albedos"][name])
        for name, triangles in job["triangles"].items()
    }
    whole = {"type": "scene", "integrator": integrator, "wall": wall, "laser": laser, **things}
    return mi.load_dict(whole)


def main():
    """Render with each seed; the first compiles and is not timed."""
    job = json.load(sys.stdin)
    loaded = scene(job)
    wall = next(shape for shape in loaded.shapes() if shape.is_sensor())
    mitr.nlos.focus_emitter_at_relay_wall_3dpoint(
        mi.Point3f(*job["target"]), wall, loaded.emitters()[0]
    )
    seconds, captures = [], []
    for seed in (-1, *range(job["seeds"])):
        start = time.perf_counter()
        _, light = mi.render(loaded, spp=job["samples"], seed=seed % 2**32)
        values = np.array(light)[..., 0]
        seconds.append(time.perf_counter() - start)
        captures.append(values)
    np.savez(job["out"], light=np.array(captures[1:]))
    print(json.dumps({"seconds": seconds[1:], "version": mitr.__version__}))


main()
