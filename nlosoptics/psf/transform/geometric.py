"""Geometric point spread function: density of the rays in the image, without diffraction.

A ray through the pupil point p lands at ``d grad W``. The pupil is divided into small cells. Each
cell deposits its energy in a box around the landing point of its ray, as wide as the cell's image.
Where rays cross, boxes overlap, so that no division by the Jacobian is needed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..._checks import fits_memory
from ..._vectors import Array
from ..wave.detilted import Residual
from ..window.window import Window

#: Width of the blur that models diffraction, in units of sqrt(lambda d^2 W'') and of lambda N.
FRESNEL, AIRY = 1.5, 2.0
#: Fraction of the peak pixel that diffraction at a focused rim may displace, per lambda N/pitch.
RIM: Final = 2.0
#: Factor from the change due to the blur to the error estimate.
SAFETY: Final = 2.0
#: Most rings of a mesh on a disc.
MOST_RINGS: Final = 700


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Image boxes of the pupil cells.

    Parameters
    ----------
    x, y, width_x, width_y : ndarray, (n,)
        Centres, counted from the tilt's shift, and widths, m.
    blur : ndarray, (2, 2, n)
        Widths of the diffraction blur, m, as two vectors along its principal axes; the second
        index is x or y.
    energy : ndarray, (n,)
        Energy in each box, sum 1.
    """

    x: Array
    y: Array
    width_x: Array
    width_y: Array
    blur: Array
    energy: Array

    def spread(self) -> Iterator[_Boxes]:
        """Yield nine copies of the boxes, each of a ninth of the energy, shifted over the blur."""
        part_x, part_y = np.hypot(*self.blur[:, 0]) / 3, np.hypot(*self.blur[:, 1]) / 3
        width_x, width_y = np.hypot(self.width_x, part_x), np.hypot(self.width_y, part_y)
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                step_x, step_y = (a * self.blur[0] + b * self.blur[1]) / 3
                yield _Boxes(
                    self.x + step_x,
                    self.y + step_y,
                    width_x,
                    width_y,
                    self.blur,
                    self.energy / 9,
                )


def least_error(residual: Residual, pitch: float) -> float:
    """Return a lower bound of the error that `density` estimates, without tracing rays."""
    return RIM * residual.airy_unit / pitch


def density(residual: Residual, window: Window) -> tuple[Array, float]:
    """Return the fraction of the ray energy in each pixel, and its error against wave optics.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    window : Window
        Pixels.

    Returns
    -------
    energy : ndarray, (ny, nx)
        Sum 1 if the window holds every ray.
    error : float
        Upper bound of the error relative to the peak: `SAFETY` times the change due to a blur of
        the width of diffraction, plus `least_error` for diffraction at the pupil's rim.

    Notes
    -----
    Diffraction spreads a shadow edge or a caustic of a wave of curvature W'' over about
    ``sqrt(lambda d^2 W'')``, and any edge over about lambda N. Where diffraction from a rim
    focuses, as at the centre of a symmetric spot, it contributes up to about ``lambda N/pitch``
    to a pixel.
    """
    sharp, soft = np.zeros(window.shape), np.zeros(window.shape)
    # The blurred image has half as many rays per side, so the change includes their discreteness.
    _splat(_boxes(residual, window, 1.0), residual, window, sharp)
    for part in _boxes(residual, window, 0.5).spread():
        _splat(part, residual, window, soft)
    change = float(np.abs(sharp - soft).max() / sharp.max())
    return sharp, SAFETY * change + least_error(residual, window.pitch)


def _splat(boxes: _Boxes, residual: Residual, window: Window, out: Array) -> None:
    """Add boxes to the pixels ``out`` (ny, nx) of a window, displaced by the tilt's shift."""
    from . import _transform_kernels

    pitch = window.pitch
    left = window.first[0] - pitch / 2 - residual.shift[0]
    low = window.first[1] - pitch / 2 - residual.shift[1]
    _transform_kernels.splat(
        (boxes.x - left) / pitch,
        (boxes.y - low) / pitch,
        boxes.width_x / pitch,
        boxes.width_y / pitch,
        boxes.energy,
        out,
    )


def ray_counts(residual: Residual, window: Window, share: float = 1.0) -> tuple[int, ...]:
    """Return the shape of a mesh on which neighbouring rays land a quarter pixel apart.

    ``share`` scales the number of rays along each direction.
    """
    n = 4 * residual.rays.reach / window.pitch + 64
    counts = residual.series.mesh(math.ceil(share * n), round(share * MOST_RINGS))
    return tuple(map(max, counts, residual.aberration.shape))


def _boxes(residual: Residual, window: Window, share: float) -> _Boxes:
    """Return the boxes of the cells of a fine mesh; ``share`` is that of `ray_counts`."""
    if residual.is_flat:  # all rays land in one point
        none = np.zeros(1)
        return _Boxes(none, none, none, none, _blur(residual, none, none, none, 0.0), np.ones(1))
    counts, series = ray_counts(residual, window, share), residual.series
    n_rays = math.prod(counts)
    fits_memory(f"{n_rays} rays", 400.0 * n_rays, "use a wider pitch")
    rays, mesh = residual.traced(*counts), series.points(*counts)
    # Derivatives along both coordinates s and t of the mesh.
    (u_s, v_s, x_s, y_s), (u_t, v_t, x_t, y_t) = (
        [np.gradient(a, at, axis=axis)[series.inner] for a in (mesh.u, mesh.v, rays.x, rays.y)]
        for axis, at in ((-2, mesh.s), (-1, mesh.t))
    )
    d = residual.wavefront.image_distance
    scale = d * (u_s * v_t - v_s * u_t)
    uu, uv, vv = (x_s * v_t - x_t * v_s, x_t * u_s - x_s * u_t, y_t * u_s - y_s * u_t)
    uu, uv, vv = ((bend / scale).ravel() for bend in (uu, uv, vv))
    x, y, energy = (part[series.inner].ravel() for part in (rays.x, rays.y, rays.energy))
    width_x, width_y = (
        np.hypot(a * mesh.along_s, b * mesh.along_t).ravel() for a, b in ((x_s, x_t), (y_s, y_t))
    )
    # error of a slope, rad
    doubt = series.truncation() * residual.aberration.shape[-2] / min(series.sides)
    return _Boxes(x, y, width_x, width_y, _blur(residual, uu, uv, vv, abs(d) * doubt), energy)


def _blur(residual: Residual, uu: Array, uv: Array, vv: Array, doubt: Array | float) -> Array:
    """Return the widths (2, 2, n), m, of the blur by diffraction and by uncertain slopes.

    The blur's axes are those of the wave's curvature (uu, uv, vv), 1/m. ``doubt`` is the error of
    a landing point due to the error of the slopes, m.
    """
    wave = residual.wavefront
    middle, half = (uu + vv) / 2, np.hypot((uu - vv) / 2, uv)
    angle = np.arctan2(2 * uv, uu - vv) / 2
    axes = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
    floor = (AIRY * residual.airy_unit) ** 2 + np.square(4 * np.asarray(doubt))
    fresnel = FRESNEL**2 * wave.wavelength * wave.image_distance**2
    return np.stack(
        [
            np.sqrt(fresnel * np.abs(bend) + floor) * axis
            for bend, axis in zip((middle + half, middle - half), axes, strict=True)
        ]
    )
