"""Scenes whose flux nlosoptics and Mitsuba 3 trace side by side, and their description for Mitsuba.

All keep laser, camera and letter of `wu_scene` but for what their name says.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import trimesh
import wu_scene

from nlosoptics import raytrace
from nlosoptics.scene import ConvexWall, FlatWall, Lambert, MeshObject, SpecularMicrofacet

REFLECTIONS = 3  # wall, object, wall
TEXELS = 512  # of the projector's picture, along each side


def scenes():
    """The scenes by name."""
    letter = wu_scene.scene()
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.15)
    screen = trimesh.creation.box((0.2, 0.2, 0.01)).apply_translation((0.22, 0.0, 0.45))
    return {
        "letter before a flat matt wall": letter,
        "letter before a convex matt wall": replace(letter, wall=ConvexWall(2.0, size=2.8)),
        "letter before a flat GGX wall": replace(
            letter,
            wall=FlatWall(size=wu_scene.WALL),
            wall_material=SpecularMicrofacet(0.7, 0.2, distribution="ggx"),
        ),
        "ball of 1280 triangles behind an occluder": replace(
            letter,
            hidden=MeshObject(mesh=ball, position=(0.45, 0.0, 0.9), material=Lambert(0.8)),
            occluders=(screen,),
        ),
    }


def description(scene):
    """A scene in numbers for JSON, m and W; the lit spot stands for the laser.

    The spot is given as a Lambertian disc (unless the wall is glossy) and as the picture of a
    projector that lights the rectangle around the hidden object, with the spot's radiant intensity.
    """
    laser, camera, wall = scene.laser, scene.camera, scene.wall
    along = np.subtract(laser.aim, laser.position)
    along /= math.sqrt(along @ along)
    hit = raytrace.intersect(wall, laser.position, along)
    cosine = -float(hit.normals @ along)
    ((_, strength, slope, *_),) = scene.wall_material.lobe_table()
    matt = isinstance(scene.wall_material, Lambert)
    solid = scene.hidden.surface
    black = [
        occluder.surface if hasattr(occluder, "surface") else occluder
        for occluder in scene.occluders
    ]
    return {
        "meshes": [
            {"vertices": m.vertices.tolist(), "faces": m.faces.tolist(), "albedo": albedo}
            for m, albedo in [(solid, scene.hidden.material.rho), *((m, 0.0) for m in black)]
        ],
        "wall": {"size": wall.size} if wall.is_flat else {"radius": wall.radius},
        "wall_albedo": strength,
        "wall_alpha": None if matt else math.sqrt(2) * slope,
        "spot": {
            "position": hit.points.tolist(),
            "normal": hit.normals.tolist(),
            "area": math.pi / 4 * laser.beam_diameter**2 / cosine,
            "power": strength * laser.power,
        },
        "projector": projector(scene, hit.points, hit.normals, -along),
        "camera": {
            "position": camera.position,
            "aim": camera.aim,
            "sensor": wu_scene.SENSOR,
            "image_distance": scene.image_distance,
            "focus_distance": scene.focus_distance,
            "stop_diameter": camera.stop_diameter,
            "transmission": camera.transmission,
        },
    }


def projector(scene, spot, normal, incident):
    """Picture of a projector at the spot that looks along z, and its half width at 1 m.

    A picture of value v sends out pi v/cos^3 W/sr in Mitsuba; rows go up and columns along x.
    """
    seen = (np.asarray(scene.hidden.surface.vertices) - spot)[:, :2]
    seen = seen / (np.asarray(scene.hidden.surface.vertices)[:, 2:] - spot[2])
    half = 1.02 * float(abs(seen).max())
    centres = (np.arange(TEXELS) + 0.5) * (2 * half / TEXELS) - half
    margin = 4 * half / TEXELS
    right, up = np.meshgrid(centres, centres)
    inside = np.ones(right.shape, bool)
    for i, across in enumerate((right, up)):
        inside &= (across > seen[:, i].min() - margin) & (across < seen[:, i].max() + margin)
    length = np.sqrt(1 + right**2 + up**2)
    exitant = np.stack([right, up, np.ones(right.shape)], axis=-1) / length[..., None]
    intensity = scene.laser.power * scene.wall_material.evaluate(incident, exitant, normal)
    intensity *= np.maximum(exitant @ normal, 0.0)
    return {"half": half, "picture": (inside * intensity / length**3 / math.pi).tolist()}
