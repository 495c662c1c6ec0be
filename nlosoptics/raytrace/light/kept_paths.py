"""Single light paths in the form in which a trace keeps them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._vectors import dot
from ...kernels import brdf
from ...kernels.codes import BECKMANN
from ..fans.paths import NO_SURFACE, ON_OBJECT, ON_OCCLUDER, ON_WALL
from . import _light_kernels as kernels
from . import _surround_kernels as surround

Array = NDArray[np.float64]
#: Points (m), surfaces and lobes, then lengths (m), powers (W), reflections and status of paths.
Kept = tuple[
    Array, NDArray[np.int8], NDArray[np.int8], Array, Array, NDArray[np.int32], NDArray[np.int8]
]


def kept_paths(
    world: surround.World, most: int, sources: Array, vertices: list[Array], ends: Array
) -> tuple[Array, NDArray[np.int8], NDArray[np.int8]]:
    """Return points, surfaces and lobes (n, most + 2) of paths with the same number of reflections.

    Shorter paths repeat their last point. ``sources`` and ``ends`` (n, 3) are first and last
    points, m, and ``vertices`` the reflecting vertices in the order of the light.
    """
    corners = [sources, *(vertex[:, kernels.P] for vertex in vertices), ends]
    points = np.stack([*corners, *[ends] * (most + 2 - len(corners))], axis=1)
    surfaces = np.full(points.shape[:2], NO_SURFACE, dtype=np.int8)
    lobes = np.full_like(surfaces, -1)
    for j, vertex in enumerate(vertices):
        ways = [corners[i] - corners[j + 1] for i in (j, j + 2)]
        come, go = (way / np.maximum(np.sqrt(dot(way, way)), 1e-300)[:, None] for way in ways)
        for kind, surface, table in (
            (surround.WALL, ON_WALL, world.wall),
            (surround.OBJECT, ON_OBJECT, world.thing),
            *((surround.ROOM + k, ON_OCCLUDER, lobes) for k, lobes in enumerate(world.room)),
        ):
            rows = vertex[:, kernels.SURFACE] == kind
            surfaces[rows, j + 1] = surface
            lobes[rows, j + 1] = _strongest(table, come[rows], go[rows], vertex[rows, kernels.N])
    return points, surfaces, lobes


def _strongest(table: Array, come: Array, go: Array, normals: Array) -> NDArray[np.int8]:
    """Return the row of a table of lobes that reflects most of the light of each path, (n,)."""
    evaluate: Any = brdf.evaluate  # untyped
    cosines = dot(come, normals), dot(go, normals), dot(come, go)
    off = go + come - 2.0 * cosines[0][:, None] * normals
    # rounding leaves less, and any other lobe comes as close once in 10^12 reflections
    mirrored = dot(off, off) < 1e-12
    values = np.empty((len(table), len(come)))
    for j in range(len(table)):
        smooth = table[j, 0] >= BECKMANN and table[j, 2] == 0.0
        evaluate(table[j : j + 1], *cosines, values[j])
        if smooth:
            # a smooth mirror has no finite value; all light in its exact direction is its own
            values[j, mirrored] = np.inf if table[j, 1] * table[j, 3] > 0.0 else 0.0
    return np.asarray(values.argmax(axis=0), dtype=np.int8)
