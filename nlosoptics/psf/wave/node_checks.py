"""Checks that the sample points of a wave are those of its layout."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._vectors import Array
from ..._xarray import Labels, variable
from ...errors import SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import pupil_points


def grid_pitch(u: Array) -> float:
    """Return the spacing, m, of a grid of coordinates u (n, n)."""
    # Next to the axis, where u is 0, the difference is exact.
    axis = u.shape[1] // 2
    return float(u[0, axis] - u[0, axis - 1])


def check_aperture(name: str, layout: str, aperture: Aperture | None, obscuration: float) -> None:
    """Raise `SceneError` if an aperture is missing, or contradicts the layout or obscuration.

    ``name`` is that of the layout's argument, for the message.
    """
    if aperture is None and layout == "cells":
        raise SceneError(
            f"{name} = '{layout}' without an aperture; give one or use 'polar', 'grid'"
        )
    if aperture is not None and layout not in ("cells", "grid"):
        raise SceneError(f"{name} = '{layout}' cannot follow an aperture; use 'cells' or 'grid'")
    if aperture is not None and obscuration != 0:
        raise SceneError(
            f"obscuration = {obscuration:g} with an aperture, limit 0; make the obscuration part "
            "of the aperture"
        )


def check_nodes(
    layout: str, u: Array, v: Array, radius: float, obscuration: float, aperture: Aperture | None
) -> None:
    """Raise `SceneError` if the coordinates u and v, m, are not those of the layout.

    ``radius`` is the pupil radius, m.
    """
    if layout == "scattered":
        return
    if layout == "grid":
        rows, columns = u.shape
        if rows != columns or rows < 2:
            raise SceneError(f"a grid wavefront has shape {u.shape}; give a square grid")
        axis = (np.arange(rows) - rows // 2) * grid_pitch(u)
        right_v, right_u = np.meshgrid(axis, axis, indexing="ij")
        remedy = "use (arange(n) - n//2) * pitch, rows along v"
    else:
        if aperture is not None and len(aperture.owners) != len(u):
            raise SceneError(
                f"wavefront.u has shape {u.shape}; the aperture's {len(aperture.owners)} patches "
                f"need {(len(aperture.owners), *u.shape[1:])}"
            )
        right_u, right_v, _ = pupil_points(radius, obscuration, aperture, u.shape)
        remedy = f"take them from {'psf.polar_nodes' if aperture is None else 'aperture.nodes'}"
    error = max(float(np.abs(u - right_u).max()), float(np.abs(v - right_v).max()))
    if not error <= 1e-9 * radius:
        raise SceneError(
            f"wavefront.u, v are {error:.3g} m off the nodes of layout '{layout}', limit "
            f"{1e-9 * radius:.1g} m; {remedy}"
        )


def wave_labels(wave: Any) -> Labels:
    """Return the contents of a wave's dataset."""
    names = {
        "polar": ("ring", "angle"),
        "cells": ("patch", "s", "t"),
        "grid": ("row", "column"),
        "scattered": ("node",),
    }[wave.layout]
    arrays = {
        "aberration": variable(names, wave.aberration, "m", "wave aberration"),
        "amplitude": variable(names, wave.amplitude, "1", "amplitude"),
        "weights": variable(names, wave.weights, "m^2", "pupil area of the sample"),
    }
    axes = {n: variable(names, getattr(wave, n), "m", f"pupil coordinate {n}") for n in "uv"}
    told = ("wavelength", "image_distance", "pupil_radius", "obscuration", "layout")
    return Labels(arrays, axes, {name: getattr(wave, name) for name in told})
