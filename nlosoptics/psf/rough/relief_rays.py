"""Geometric point spread of a given rough wall: where its facets send the light."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from ..wave.polar_series import values_at
from ..wave.wavefront import Wavefront
from ..window.window import Window
from .relief import STEEPEST, ReliefView

Array = NDArray[np.float64]

#: Rays through the pupil, about; the error by their number is then some thousandths of the peak.
RAYS = 2**21


def ray_counts(view: ReliefView, radius: float, wavelength: float) -> tuple[int, Array]:
    """Return the rays per side of the lattice on the wall, and its half widths, (2,), m."""
    assert view.effective_distance is not None
    seen = np.linalg.norm(view.footprint, axis=1) * radius
    cosines = view.cos_sum(wavelength)
    throw = STEEPEST * cosines * view.roughness.slope_rms
    half = seen + throw * np.linalg.norm(view.effective_distance, axis=1)
    share = float(np.prod(seen / half))
    return math.isqrt(min(2**24, math.ceil(RAYS / share))), half


def neglected_diffraction(view: ReliefView, wave: Wavefront, pitch: float) -> float:
    """Return the error of rays without diffraction at the relief, relative to the peak.

    It is the spread of the light of one of its facets or bumps over the pixel's side ``pitch``, m.
    """
    across = float(np.linalg.norm(view.footprint, 2))
    spread = wave.wavelength * abs(wave.image_distance) * across / view.length
    return min(1.0, spread / pitch)


def ray_image(residual: Residual, view: ReliefView, window: Window) -> tuple[Array, float]:
    """Return the energy per pixel, relative to the smooth wall's energy, and the expected error.

    A ray of the wall point x with the slope s of the relief meets the pupil at
    ``p = M^-1 [x - (cos_i + cos_o) d_eff s]`` and the image at
    ``d_i [grad W(p) - (cos_i + cos_o) M^T s]``. The wall is lit evenly; diffraction is neglected.
    """
    assert view.effective_distance is not None
    wave, relief = residual.wavefront, view.roughness
    n, half = ray_counts(view, wave.pupil_radius, wave.wavelength)
    cosines = view.cos_sum(wave.wavelength)
    steps = (2 * np.arange(n) + 1) / n - 1
    ny, nx = window.shape
    counts = np.zeros(ny * nx)
    back = np.linalg.inv(view.footprint)
    slopes_of = _smooth_slopes(residual)
    for start in range(0, n, max(1, 2**20 // n)):
        rows = steps[start : start + max(1, 2**20 // n)]
        x, y = (a.ravel() for a in np.meshgrid(steps * half[0], rows * half[1]))
        points = np.stack([x, y], axis=1)
        world = view.origin + points @ view.axes
        found = relief.derivatives(world[:, 0], world[:, 1])
        slope = cosines * (found[:, 1:3] @ view.axes.T)
        p = (points - slope @ view.effective_distance) @ back.T
        radial = np.hypot(p[:, 0], p[:, 1]) / wave.pupil_radius
        lit = (radial <= 1) & (radial >= wave.obscuration)
        turn = slopes_of(p[lit]) - slope[lit] @ view.footprint
        landing = wave.image_distance * turn + np.array(residual.shift)
        column = np.floor((landing[:, 0] - window.first[0]) / window.pitch + 0.5).astype(np.int64)
        row = np.floor((landing[:, 1] - window.first[1]) / window.pitch + 0.5).astype(np.int64)
        seen = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
        counts += np.bincount(row[seen] * nx + column[seen], minlength=ny * nx)
    # energy of one ray: its area on the wall, seen from the pupil, over the pupil's area
    area = 4 * float(np.prod(half)) / n**2 * abs(float(np.linalg.det(back)))
    pupil = math.pi * wave.pupil_radius**2 * (1 - wave.obscuration**2)
    energy = counts.reshape(ny, nx) * area / pupil
    error = neglected_diffraction(view, wave, window.pitch)
    return energy, float(error + 1 / math.sqrt(max(counts.max(), 1.0)))


def _smooth_slopes(residual: Residual) -> Callable[[Array], Array]:
    """Return a function that gives the slopes (n, 2) of the smooth wave at pupil points (n, 2)."""
    if residual.is_flat:
        return np.zeros_like
    radius = residual.wavefront.pupil_radius
    axis = np.linspace(-1.0, 1.0, 257) * radius
    u, v = np.meshgrid(axis, axis)
    path, _ = values_at(residual.polar_series[0], None, u, v, 1e-12)
    tables: list[Array] = [np.asarray(part) for part in np.gradient(path, axis[1] - axis[0])]

    def at(points: Array) -> Array:
        from scipy import ndimage

        place = (points[:, ::-1].T / radius + 1) * (257 - 1) / 2
        dv, du = (ndimage.map_coordinates(t, place, order=1, mode="nearest") for t in tables)
        return np.stack([du, dv], axis=1)

    return at
