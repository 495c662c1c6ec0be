"""Operators of a matt wall for all light of a scene."""

from __future__ import annotations

from typing import Any

from ..scene import Material, PlanarObject, Scene
from .wall_transport import WallTransport


def picture_cells(scene: Scene, material: Material, texels: tuple[int, ...]) -> tuple[int, int]:
    """Return the cells for `WallTransport.sums`: the texels, or fewer that hold several of them."""
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
