"""Slope of a wall's material."""

from __future__ import annotations

import math

import numpy as np

from ...errors import SceneError
from ...kernels.codes import LAMBERT, WARD_1992, WARD_BOUNDED, WARD_DUER
from ...scene import Scene


def material_slope(scene: Scene) -> float:
    """Return the slope rms per axis, rad, of the wall's strongest lobe that has a slope."""
    lobes = scene.wall_material.lobe_table()
    rough = lobes[(lobes[:, 0] != LAMBERT) & (lobes[:, 2] > 0)]
    if not len(rough):
        raise SceneError(
            "scene.wall_material has no lobe with a slope; use a material such as Ward, OrenNayar "
            "or SpecularMicrofacet with slope_rms above 0"
        )
    kind, _, width = rough[np.argmax(rough[:, 1]), :3]
    # a Ward lobe stores alpha = sqrt(2) slope_rms
    alpha = kind in (WARD_1992, WARD_DUER, WARD_BOUNDED)
    return float(width / math.sqrt(2.0) if alpha else width)
