"""Point spreads on pixels much wider than an Airy unit: fine near the rays, a tail model beyond."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from ..._vectors import Array
from ..wave.detilted import Residual
from ..window.window import peak_pixel, ray_reach
from .models import Model, wide_pixel_error
from .point_spread import PointSpread, point_spread

#: Distances from a point to the sides of a rectangle: (down, up), (left, right).
Sides = tuple[tuple[float, float], tuple[float, float]]

#: Relative error of the tail model far from the rays; measured 3e-4.
MODEL = 0.01


def detilted_wide_spread(
    residual: Residual,
    pitch: float,
    shape: tuple[int, int],
    tol: float,
    model: Model = "scalar",
) -> PointSpread:
    """Compute a point spread on pixels, quickly if they are much wider than the Airy disc.

    For waves of discs and rings on pixels at least 8 Airy units wide, a square around the points
    at which the rays arrive is sampled. The energy outside is distributed as ``1/r^3``, with r the
    distance from the centre, as diffraction at a sharp rim does. In all other cases the result is
    that of `point_spread` with ``pixel_integrated=True``.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    pitch : float
        Pixel side, m.
    shape : (int, int)
        Pixels (ny, nx).
    tol : float
        Largest permitted error of any pixel relative to the brightest pixel.
    model : {"scalar", "auto", "high-aperture"}
        As for `point_spread`. Tails are added in the scalar model only.
    """
    whole = partial(
        point_spread, residual, pitch=pitch, shape=shape, pixel_integrated=True, tol=tol
    )
    inner = inner_parts(residual, pitch, shape, tol)
    if inner is None or model == "high-aperture":
        return whole(model=model)
    n, parts, finer = inner
    unit, reach = residual.airy_unit, ray_reach(residual)
    fine = point_spread(
        residual,
        pitch=pitch / parts,
        shape=n,
        pixel_integrated=True,
        tol=finer,
        model="scalar",
    )
    missing = max(1.0 - fine.enclosed_energy, 0.0)
    half = n * pitch / parts / 2
    intensity = binned(fine.intensity, parts, shape)
    intensity += missing * tail_pixels(shape, ((half / pitch,) * 2,) * 2)
    peak = float(intensity.max())
    error = fine.error_estimate * min(parts, n) * float(fine.intensity.max())
    error = (error + missing * min(1.0, MODEL + (reach / half) ** 2)) / peak
    omitted = wide_pixel_error(residual, peak)
    if error > tol or (model == "auto" and omitted > tol):
        return whole(model=model)
    return replace(
        fine,
        intensity=intensity,
        pitch=pitch,
        method=f"{fine.method} + tail",
        error_estimate=error,
        enclosed_energy=float(intensity.sum()),
        regime=replace(fine.regime, pixel=pitch / unit),
        model_error=omitted,
        reason=f"{n} x {n} parts of pixels hold the rays, a tail the rest; {fine.reason}",
    )


def inner_parts(
    residual: Residual, pitch: float, shape: tuple[int, int], tol: float
) -> tuple[int, int, float] | None:
    """Return the side of the fine square in parts, the parts per pixel side, and their tolerance.

    None if the method does not apply or would not be faster.
    """
    unit = residual.airy_unit
    if not residual.is_round or pitch < 8 * unit:
        return None
    reach = ray_reach(residual) / unit
    # the energy beyond a half side h, Airy units, is 2/(pi^2 h) of the total
    share = 4 / math.pi**2 / (tol * peak_pixel(residual, pitch))
    half = max(reach + 20, share * 2 * MODEL, math.cbrt(2 * share * reach**2)) * unit
    if 4 * half > pitch * min(shape):  # no gain
        return None
    parts = math.ceil(pitch / (2 * unit)) | 1
    n = 2 * math.ceil(half * parts / pitch) + 1
    # Errors of the parts^2 samples of a pixel have both signs; their sum grows as parts. The tail
    # takes a quarter of tol.
    return n, parts, tol / max(30, 1.5 * min(parts, n))


def binned(fine: Array, parts: int, shape: tuple[int, int]) -> Array:
    """Sum fine samples over pixels of ``parts`` x ``parts`` and crop to ``shape``.

    Both grids have the same centre. Samples outside the shape are dropped.
    """
    n = len(fine)
    # odd number of whole pixels that hold the fine samples
    count = 2 * math.ceil(max((n - parts) / 2, 0) / parts) + 1
    margin = (count * parts - n) // 2
    # No padding of the fine samples to whole pixels, which may be much wider than all of them.
    starts = np.maximum(np.arange(count) * parts - margin, 0)
    wide = np.add.reduceat(np.add.reduceat(fine, starts, axis=0), starts, axis=1)
    found = np.zeros(shape)
    target, source = [], []
    for size in shape:
        low, high = min(size // 2, count // 2), min((size - 1) // 2, count // 2)
        target.append(slice(size // 2 - low, size // 2 + high + 1))
        source.append(slice(count // 2 - low, count // 2 + high + 1))
    found[tuple(target)] = wide[tuple(source)]
    return found


def tail_pixels(shape: tuple[int, int], sides: Sides) -> Array:
    """Integrate a tail ``1/r^3`` outside a rectangle over the pixels of a window.

    The tail is 0 inside the rectangle, and its total over the plane is 1.

    Parameters
    ----------
    shape : (int, int)
        Pixels (ny, nx).
    sides : ((float, float), (float, float))
        Distances of the rectangle's sides from the window's middle pixel, in pixels: down and up,
        left and right.

    Returns
    -------
    ndarray, (ny, nx)
    """
    # integral over a quadrant outside the rectangle of sides a and b: sqrt(a^2 + b^2)/(a b)
    total = sum(math.hypot(a, b) / (a * b) for a in sides[0] for b in sides[1])
    y, x = (np.arange(n + 1) - n // 2 - 0.5 for n in shape)
    b, a = (np.where(v < 0, *pair) for v, pair in zip((y, x), sides, strict=True))
    corners = _in_quadrant(np.abs(x), np.abs(y)[:, None], a, b[:, None])
    corners *= np.sign(x) * np.sign(y)[:, None]
    return np.asarray(np.diff(np.diff(corners, axis=0), axis=1)) / total


def _in_quadrant(x: Array, y: Array, a: Array, b: Array) -> Array:
    """Integrate ``1/r^3`` over the rectangle (0..x, 0..y) outside the rectangle (0..a, 0..b)."""
    far_x, far_y = np.maximum(x, a), np.maximum(y, b)
    both = np.hypot(a, b) / (a * b) - np.hypot(far_x, far_y) / (far_x * far_y)
    strip = np.where(x < a, _strip(x, b) - _strip(x, far_y), _strip(y, a) - _strip(y, far_x))
    return np.where((x >= a) & (y >= b), both, np.where((x < a) & (y < b), 0.0, strip))


def _strip(width: Array, start: Array) -> Array:
    """Integrate ``1/r^3`` over 0..width along one axis and start..infinity along the other."""
    # written as width/(start (hypot + start)) to avoid cancellation
    return np.asarray(width / (start * (np.hypot(width, start) + start)))
