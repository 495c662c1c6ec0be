"""Operators of a matt wall for all light of a scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene import Material, PlanarObject, Scene
from .geometry import chief_rays, wall_visibility
from .objects import plate
from .penumbra import in_bands
from .wall_transport import FINE, WallTransport

Array = NDArray[np.float64]


def picture_cells(scene: Scene, material: Material, texels: tuple[int, ...]) -> tuple[int, int]:
    """Return the cells for `picture_sums`: the texels, or fewer that hold several of them."""
    needed = WallTransport(scene, cells=(1, 1), material=material)._parts
    rows, columns = (
        next((n for n in range(need, count) if count % n == 0), count)
        for need, count in zip(needed, texels, strict=True)
    )
    return rows, columns


def lit_transports(scene: Scene, **options: Any) -> list[tuple[WallTransport, float]]:
    """Return the operator of each kind of light in a scene, and the brightness of a white cell."""
    hidden, sources = scene.hidden, []
    if scene.laser.power > 0.0:
        sources.append((WallTransport(scene, source="laser", **options), 1.0))
    if isinstance(hidden, PlanarObject) and hidden.luminous is not None:
        lobe = hidden.luminous_lobe
        one = WallTransport(scene, source="luminous", lobe=lobe, **options)
        sources.append((one, hidden.luminous))
    if scene.ambient_irradiance > 0.0:
        one = WallTransport(scene, source="ambient", **options)
        sources.append((one, scene.ambient_irradiance))
    return sources


def picture_sums(transport: WallTransport, picture: Array, x: Array, y: Array) -> Array:
    """Return the electrons (2, n) of some pixels past shadows on plane and wall, and without.

    ``picture`` has a whole number of texels in each cell, or of cells' samples in each texel.
    ``x`` and ``y`` (n,) are centres of pixels on the detector, m. Here, nothing is between wall
    and lens.
    """
    from . import _sum_kernels

    shape = transport._samples_of_plane[0]
    for axis, count in enumerate(shape):
        picture = np.repeat(picture, max(1, count // picture.shape[axis]), axis=axis)
    finer = picture.shape[0] // shape[0], picture.shape[1] // shape[1]
    blocks = picture.reshape(len(picture), shape[1], -1)
    right = blocks[..., ::-1].cumsum(axis=-1)[..., ::-1].reshape(picture.shape)
    radiance, *others = transport._radiance
    mean = radiance / math.prod(finer), *others
    rays = chief_rays(transport.scene, x[None], y[None])
    nodes = transport._traced(x[None], y[None], wall_visibility(transport.scene, rays))
    arguments = transport._arguments(nodes, transport._edges.still(), finer)[:-1]
    out = np.empty((len(x), 2))
    # within small pixels, light without shadows is uniform
    wide = (transport._step * FINE / plate(transport.scene)[0][2]) ** 2 > 5.0
    right = np.ascontiguousarray(right)
    in_bands(_sum_kernels.fill_sums, *arguments, mean, right, wide, out)
    return out.T
