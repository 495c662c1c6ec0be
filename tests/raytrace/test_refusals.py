"""What tracers refuse, in one line that names value, limit and remedy; the last value passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics import raytrace
from nlosoptics._checks import Budget, within
from nlosoptics.errors import NlosError
from nlosoptics.raytrace.fans import footprints
from nlosoptics.raytrace.intersection.triangles import Facets
from nlosoptics.scene import FlatWall, Lambert, PlanarObject

from .light.draws import scene

SCENE = scene()
MATT = replace(scene(paint=Lambert(0.5), material=Lambert(0.5)), occluders=())
SHORT = {"n_rays": 64, "max_bounces": 3}


def in_memory(n_bytes, call):
    with within(Budget(memory=n_bytes, seconds=60.0)):
        return call()


def lens_at(height):
    """A round lens of 0.1 m that looks along x, its middle at a height above the wall."""
    camera = replace(SCENE.camera, position=(-1.0, 0.0, height), aim=(1e6, 0.0, 0.0))
    camera = replace(camera, stop_diameter=0.1)
    return footprints._mirror_box(FlatWall(size=1.0), np.array([0.4, 0.0, 0.7]), camera)


def mesh(bad):
    tent = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, bad]]
    return trimesh.Trimesh(tent, [[0, 1, 2], [0, 1, 3]], process=False)


PATHS = 64 * (3 + 4) * 26 * 3

TABLE = {
    "image of no scene": (
        lambda: raytrace.trace_image("scene.toml", wavelengths=[5e-7]),
        "scene is a str; give a Scene, such as Scene.load()",
    ),
    "no wavelengths": (
        lambda: raytrace.trace_image(SCENE, wavelengths=[]),
        "wavelengths is []; give a list of wavelengths in m",
    ),
    "wavelength of nothing": (
        lambda: raytrace.trace_image(SCENE, wavelengths=[5e-7, 0.0]),
        "wavelengths[1]: laser.wavelength = 0",
    ),
    "lens in the wall": (
        lambda: lens_at(0.0499),
        "m, behind the wall; use a smaller stop or move the camera into the room",
    ),
    "vertex without a number": (
        lambda: Facets(mesh(np.nan)),
        "the mesh has NaN or infinite vertices; repair it",
    ),
    "mesh of lines": (
        lambda: Facets(trimesh.Trimesh(np.eye(3), [[0, 0, 1]], process=False)),
        "the mesh has no triangle with an area; give a surface mesh",
    ),
    "paths to keep": (
        lambda: in_memory(PATHS - 1, lambda: raytrace.trace(SCENE, keep_paths=True, **SHORT)),
        "paths of 64 rays (n_rays) needs",
    ),
    "paths without an end": (
        lambda: raytrace.trace(MATT, keep_paths=True, tol=0.1),
        "paths without a limit (n_rays) needs",
    ),
    "cells of a map": (
        lambda: in_memory(
            8 * 32 * 24 - 1, lambda: raytrace.wall_irradiance(SCENE, shape=(4, 6), n_rays=64)
        ),
        "a map of 6 x 4 cells (shape) needs",
    ),
    "black picture": (
        lambda: raytrace.trace(replace(SCENE, hidden=black()), tol=0.1),
        "hidden.image is black, so no light can arrive; give an image with bright pixels",
    ),
}


def black():
    picture = PlanarObject(np.eye(2), 0.5, position=(0.3, 0.0, 0.5))
    picture.reflectance.setflags(write=True)
    picture.reflectance[:] = 0.0
    return picture


@pytest.mark.parametrize("name", TABLE)
def test_refused_in_one_line(name):
    call, words = TABLE[name]
    with pytest.raises(NlosError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
