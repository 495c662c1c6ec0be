"""Point spreads on pixels much wider than an Airy unit: fine near the rays, a tail model beyond."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..._checks import in_range, positive
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from ..window.window import peak_pixel, ray_reach, shape_of
from .models import Model, wide_pixel_error
from .point_spread import PointSpread, detilted_point_spread

Array = NDArray[np.float64]
#: Distances from a point to the sides of a rectangle: (down, up), (left, right).
Sides = tuple[tuple[float, float], tuple[float, float]]

#: Pixel side, Airy units, from which this method is tried, and largest side of the fine parts.
WIDE, FINE = 8.0, 2.0
#: Relative error of the tail model far from the rays; measured 3e-4.
MODEL = 0.01
#: Least distance from the rays to the tail, Airy units.
LEAST = 20.0
#: Largest side of the fine square relative to the window's for which the method is used.
WORTH = 0.5


def wide_point_spread(
    wave: Wavefront, *, pitch: float, shape: int | tuple[int, int], tol: float
) -> PointSpread:
    """Compute a point spread function on pixels much wider than the Airy disc, quickly.

    Diffraction is computed only near the rays of geometrical optics. Far from the rays the
    intensity follows a simple law.

    Parameters
    ----------
    wave : Wavefront
        Wave in the exit pupil.
    pitch : float
        Pixel side, m.
    shape : int or (int, int)
        Number of pixels (ny, nx); one number means a square.
    tol : float
        Largest permitted error of any pixel relative to the brightest pixel, above 0, at most 1.

    Returns
    -------
    PointSpread
        Energy in each pixel (ny, nx); the whole image plane has the energy 1 (normalisation
        "unit-sum").

    Raises
    ------
    SceneError
        If ``pitch``, ``shape`` or ``tol`` is out of range.
    SamplingError
        If the wave is sampled too coarsely for ``tol``, or the window is too narrow for the rays.
    MemoryLimitError
        If the pixels would not fit into memory.

    See Also
    --------
    point_spread : For pixels of any width, with other options.

    Notes
    -----
    The fast way is taken for waves of the layout "polar" on pixels at least 8 lambda N wide, with
    the wavelength lambda and the F-number N, if it reaches ``tol`` and saves time. It samples a
    square around the points at which the rays arrive. The energy outside this square is
    distributed as ``1/r^3``, with r the distance from the centre, as diffraction at a sharp rim
    does. In all other cases the result is that of `point_spread` with ``pixel_integrated=True`` and
    ``model="scalar"``.
    """
    pitch, shape = positive("pitch", pitch, unit="m"), shape_of(shape)
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    return detilted_wide_spread(split(wave), pitch, shape, tol)


def detilted_wide_spread(
    residual: Residual,
    pitch: float,
    shape: tuple[int, int],
    tol: float,
    model: Model = "scalar",
) -> PointSpread:
    """Compute `wide_point_spread` for a wave already split into piston, tilt and residual.

    ``model`` is that of `point_spread`. Tails are added in the scalar model only.
    """
    whole = partial(
        detilted_point_spread, residual, pitch=pitch, shape=shape, pixel_integrated=True, tol=tol
    )
    inner = inner_parts(residual, pitch, shape, tol)
    if inner is None or model == "high-aperture":
        return whole(model=model)
    n, parts = inner
    unit, reach = residual.airy_unit, ray_reach(residual)
    fine = detilted_point_spread(
        residual, pitch=pitch / parts, shape=n, pixel_integrated=True, tol=tol / 30
    )
    missing = max(1.0 - fine.enclosed_energy, 0.0)
    half = n * pitch / parts / 2
    intensity = binned(fine.intensity, parts, shape)
    intensity += missing * tail_pixels(shape, ((half / pitch,) * 2,) * 2)
    peak = float(intensity.max())
    # Errors of the parts^2 samples of a pixel have both signs; their sum grows as parts.
    error = fine.error_estimate * min(parts, n) * float(fine.intensity.max())
    error = (error + missing * _model_error(reach / half)) / peak
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
) -> tuple[int, int] | None:
    """Return the side of the fine square in parts, and the parts per pixel side.

    None if the method does not apply or would not be faster.
    """
    unit = residual.airy_unit
    if residual.wavefront.layout != "polar" or pitch < WIDE * unit:
        return None
    reach = ray_reach(residual) / unit
    half = _inner_half(reach, tol / 2 * peak_pixel(residual, pitch)) * unit
    if 2 * half > WORTH * pitch * min(shape):
        return None
    parts = math.ceil(pitch / (FINE * unit)) | 1
    return 2 * math.ceil(half * parts / pitch) + 1, parts


def _inner_half(reach: float, tol: float) -> float:
    """Return the half side of the fine square for a tail error below ``tol``, Airy units."""
    # the energy beyond a half side is 2/(pi^2 half) of the total
    share = 2 / math.pi**2 / tol
    return max(reach + LEAST, share * 2 * MODEL, math.cbrt(2 * share * reach**2))


def _model_error(reach: float) -> float:
    """Bound the relative error of the tail; ``reach`` is that of the rays over the half side."""
    return min(1.0, MODEL + reach**2)


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
