"""Compilation of kernels before they are needed, by runs whose results are dropped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._progress import Progress
from ..scene import (
    Camera,
    ConcaveWall,
    FacetWall,
    FlatWall,
    Laser,
    MeshWall,
    Occluder,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    WallRoughness,
    WavyWall,
)
from .simulate import simulate


def warm_up(scenes: Sequence[Scene] = (), progress: Progress | None = None) -> None:
    """Compile the kernels that runs and reports of some scenes use, so that they are only loaded.

    numba keeps them in its cache, which ``NUMBA_CACHE_DIR`` can move. By default the scenes show a
    letter by walls of all kinds that have kernels of their own: flat, wavy, curved and behind an
    occluder, a mesh, and rough. ``progress`` is called with the scene and the completed fraction.
    """
    from .. import raytrace

    scenes = scenes or _letters()
    for number, scene in enumerate(scenes):
        if progress is not None:
            progress(f"scene {number + 1} of {len(scenes)}", number / len(scenes))
        simulate(scene, reconstruct=True)
        raytrace.trace(scene, n_rays=64, keep_paths=True)


def _letters() -> tuple[Scene, ...]:
    """Return a bright bar seen by walls of all kinds, with the distances of Wu et al. (2024)."""
    import trimesh

    picture = np.zeros((32, 32))
    picture[8:24, 12:20] = 1.0
    flat = Scene(
        laser=Laser(
            wavelength=632.8e-9,
            power=5e-3,
            beam_diameter=3e-3,
            position=(0.95, 0.0, 1.16),
            aim=(0.64, 0.0, 0.0),
        ),
        wall=FlatWall(),
        wall_material=SumMaterial((OrenNayar(0.75, 0.3), SpecularMicrofacet(0.05, 0.0))),
        hidden=PlanarObject(picture, 0.7, position=(0.544, 0.0, 1.0)),
        camera=Camera(
            position=(-0.435, 0.0, 0.8),
            aim=(0.0, 0.0, 0.0),
            focal_length=18.432e-3 / math.tan(math.radians(20.0)),
            stop_diameter=25e-3,
        ),
    )
    plate = trimesh.creation.box((0.28, 0.28, 0.005))
    mesh = ConcaveWall(5.0, size=(1.4, 1.0)).to_mesh(max_sag_error=1e-5)
    return (
        flat,
        replace(flat, wall=WavyWall(1e-4, 0.25, 1.0, direction=0.5)),
        replace(
            flat, wall=ConcaveWall(5.0), occluders=(Occluder(plate, position=(0.56, 0.17, 0.5)),)
        ),
        replace(flat, wall=MeshWall(mesh)),
        replace(flat, wall_roughness=WallRoughness(FacetWall(1e-3, 2e-3))),
    )
