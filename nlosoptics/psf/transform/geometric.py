"""Geometric point spread function: density of the rays in the image, without diffraction.

A ray through the pupil point p lands at ``d grad W``. The pupil is divided into small cells. Each
cell deposits its energy in a box around the landing point of its ray, as wide as the cell's image.
Where rays cross, boxes overlap, so that no division by the Jacobian is needed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..aperture.quadrature_nodes import gauss_legendre
from ..wave.cell_series import NEAREST
from ..wave.detilted import Residual
from ..window.window import Window

Array = NDArray[np.float64]

#: Width of the blur that models diffraction, in units of sqrt(lambda d^2 W'') and of lambda N.
FRESNEL, AIRY = 1.5, 2.0
#: Fraction of the peak pixel that diffraction at a focused rim may displace, per lambda N/pitch.
RIM: Final = 2.0
#: Factor from the change due to the blur to the error estimate.
SAFETY: Final = 2.0
#: Most rings of a polar mesh.
MOST_RADII: Final = 700


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
    for boxes in _boxes(residual, window, 1.0):
        _splat(boxes, residual, window, sharp)
    for boxes in _boxes(residual, window, 0.5):
        for part in boxes.spread():
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


def _boxes(residual: Residual, window: Window, share: float) -> Iterator[_Boxes]:
    """Yield the boxes of all rays; ``share`` scales the number of rays along each direction."""
    if residual.is_flat:
        return iter([_single_box(residual)])
    return (_cell_boxes if residual.wavefront.aperture else _polar_boxes)(residual, window, share)


def _single_box(residual: Residual) -> _Boxes:
    """Return the box of a wave without aberration, whose rays all land in one point."""
    none = np.zeros(1)
    return _Boxes(none, none, none, none, _blur(residual, none, none, none, 0.0), np.ones(1))


def ray_counts(residual: Residual, window: Window, share: float = 1.0) -> tuple[int, int]:
    """Return how many rings and spokes make neighbouring rays land a quarter pixel apart."""
    n_r = 4 * residual.rays.reach / window.pitch + 64
    n_r = max(residual.series.n_r, math.ceil(share * min(n_r, MOST_RADII)))
    return n_r, max(residual.series.n_theta, 4 * n_r)


def ray_count(residual: Residual, window: Window) -> float:
    """Return the number of rays of `density`."""
    if residual.wavefront.aperture is None:
        return math.prod(map(float, ray_counts(residual, window)))
    return len(residual.aberration) * float(patch_rays(residual, window)) ** 2


def _polar_boxes(residual: Residual, window: Window, share: float) -> Iterator[_Boxes]:
    """Yield the boxes of the cells of a fine polar mesh."""
    wave = residual.wavefront
    n_r, n_theta = ray_counts(residual, window, share)
    fits_memory(f"{n_r} x {n_theta} rays", 250.0 * n_r * n_theta, "use a wider pitch")
    rays = residual.traced(n_r, n_theta)
    fraction, weights = gauss_legendre(n_r)
    inner = wave.obscuration**2
    r = wave.pupil_radius * np.sqrt(inner + (1 - inner) * np.append(fraction, 1.0))
    # width of the rings in r
    edges = np.sqrt(inner + (1 - inner) * np.append(0.0, np.cumsum(weights)))
    ring, arc = (wave.pupil_radius * np.diff(edges))[:, None], 2 * math.pi / n_theta
    angle = arc * np.arange(n_theta)
    outward = np.stack([np.cos(angle), np.sin(angle)])
    around = r[:-1, None] * np.stack([-outward[1], outward[0]])[:, None]
    over_r = [np.gradient(a, r, axis=0)[:-1] for a in (rays.x, rays.y)]
    over_angle = [
        (np.roll(a, -1, axis=1) - np.roll(a, 1, axis=1))[:-1] / (2 * arc) for a in (rays.x, rays.y)
    ]
    doubt = residual.series.truncation() * residual.series.n_r / wave.pupil_radius
    places = rays.x[:-1], rays.y[:-1], rays.energy[:-1]
    yield _mesh_boxes(residual, places, (over_r, over_angle), (outward, around), (ring, arc), doubt)


def _cell_boxes(residual: Residual, window: Window, share: float) -> Iterator[_Boxes]:
    """Yield the boxes of the cells of a fine mesh on every patch of an aperture."""
    aperture = residual.aperture
    n = patch_rays(residual, window, share)
    n_patches = len(residual.aberration)
    fits_memory(f"{n_patches} x {n} x {n} rays", 400.0 * n_patches * n * n, "use a wider pitch")
    rays = residual.traced(n_patches, n, n)
    fraction, weights = gauss_legendre(n)
    s, t = np.concatenate([[NEAREST], fraction, [1.0]]), np.concatenate([[0.0], fraction, [1.0]])
    inner = np.s_[:, 1:-1, 1:-1]
    pupil = [np.moveaxis(a[inner], -1, 0) for a in aperture.map(s, t)[1:]]
    over_s, over_t = (
        [np.gradient(a, at, axis=axis)[inner] for a in (rays.x, rays.y)]
        for axis, at in ((1, s), (2, t))
    )
    most, least = max(residual.aberration.shape[1:]), min(aperture.patch_size)
    doubt = residual.series.truncation() * most / least
    places = rays.x[inner], rays.y[inner], rays.energy[inner]
    yield _mesh_boxes(residual, places, (over_s, over_t), pupil, (weights[:, None], weights), doubt)


def _mesh_boxes(
    residual: Residual,
    places: Sequence[Array],
    over: Sequence[Sequence[Array]],
    pupil: Sequence[Array],
    sides: Sequence[Array | float],
    doubt: float,
) -> _Boxes:
    """Return the boxes of the cells of a mesh with coordinates s and t.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    places : (x, y, energy)
        Landing points, m, and energies of the rays.
    over : ((dx/ds, dy/ds), (dx/dt, dy/dt))
        Derivatives of the landing points.
    pupil : (along_s, along_t)
        Derivatives (2, ...) of the pupil point (u, v).
    sides : (ds, dt)
        Sides of the cells.
    doubt : float
        Error of a slope, rad.
    """
    (x_s, y_s), (x_t, y_t) = over
    (u_s, v_s), (u_t, v_t) = pupil
    d = residual.wavefront.image_distance
    scale = d * (u_s * v_t - v_s * u_t)
    uu, uv, vv = (x_s * v_t - x_t * v_s, x_t * u_s - x_s * u_t, y_t * u_s - y_s * u_t)
    uu, uv, vv = ((bend / scale).ravel() for bend in (uu, uv, vv))
    x, y, energy = (part.ravel() for part in places)
    width_x, width_y = (
        np.hypot(a * sides[0], b * sides[1]).ravel() for a, b in ((x_s, x_t), (y_s, y_t))
    )
    return _Boxes(x, y, width_x, width_y, _blur(residual, uu, uv, vv, abs(d) * doubt), energy)


def patch_rays(residual: Residual, window: Window, share: float = 1.0) -> int:
    """Return how many rays per side of a patch make neighbours land a quarter pixel apart."""
    n_patches, *own = residual.aberration.shape
    n = 4 * residual.rays.reach / window.pitch + 64
    wanted = math.ceil(share * min(n, 2 * MOST_RADII / math.sqrt(n_patches)))
    return int(max(*own, wanted))


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
