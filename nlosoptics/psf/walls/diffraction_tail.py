"""Light that diffraction sends beyond the window of a point spread."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, in_range, whole
from ...errors import SamplingError, SceneError
from ..rough.mean import RoughPointSpread
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import Sides, tail_pixels
from ..window.window import middle
from .field import PointSpreadField
from .hybrid import HybridPointSpread

Array = NDArray[np.float64]


def widened(
    point_spreads: PointSpread | PointSpreadField, *, tol: float, shape: tuple[int, int]
) -> PointSpread | PointSpreadField:
    """Point spreads in a window that holds all light but a share ``tol``, for an image.

    Parameters
    ----------
    point_spreads : PointSpread or PointSpreadField
    tol : float
        Above 0.
    shape : (int, int)
        Pixels of the image: a window of more than twice its longer side has no use.

    Returns
    -------
    PointSpread or PointSpreadField
        As of `with_tail` or `field_with_tail`.
    """
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    if isinstance(point_spreads, PointSpreadField):
        spread = point_spreads.mean()
    else:
        spread = point_spreads.intensity
    side, missing = max(spread.shape), 1.0 - float(spread.sum())
    wide = min(math.ceil(side * max(missing, 0.0) / tol), 2 * max(shape) - 1) | 1
    if wide <= side:
        return point_spreads
    if isinstance(point_spreads, PointSpreadField):
        return field_with_tail(point_spreads, wide)
    return with_tail(point_spreads, wide)


def with_tail(point_spread: PointSpread, side: int) -> PointSpread:
    """Point spread in a wider window, with the light that it sends beyond its own.

    Parameters
    ----------
    point_spread : PointSpread
        Energy per pixel, ``"unit-sum"``; of a wave alone, without parts that a wall scatters.
    side : int
        Pixels of the new window, no fewer than of the old.

    Returns
    -------
    PointSpread
        The same within the old window. Beyond it the light that is missing there from 1, spread as
        ``1/r^3``.

    Raises
    ------
    SceneError
        If the point spread has such parts, whose light beyond the window is no rim's.
    SamplingError
        If the window is narrower or values are not energies of the whole plane.
    MemoryLimitError
        If the window would not fit.

    Notes
    -----
    A sharp rim sends ``lambda N/(pi^3 r^3)`` per area a distance r, averaged over its rings and
    whatever the aberration, once r is far beyond its rays [1]_. The factor is not taken from there
    but from the missing light, so that the plane carries 1.

    References
    ----------
    .. [1] Born and Wolf, Principles of Optics, 7th ed., sec. 8.5.2.
    """
    if isinstance(point_spread, (RoughPointSpread, HybridPointSpread)):
        raise SceneError(
            f"point_spread is a {type(point_spread).__name__}, which lacks scattered light too; "
            f"compute it with shape = {side}"
        )
    if point_spread.normalisation != "unit-sum":
        raise SamplingError(
            f"point_spread.normalisation = {point_spread.normalisation!r}, whose missing light is "
            "not known; compute it with normalisation='unit-sum'"
        )
    side = _checked(side, point_spread.shape)
    missing = max(1.0 - float(point_spread.intensity.sum()), 0.0)
    intensity = _padded(point_spread.intensity, side)
    intensity += missing * tail_pixels((side, side), _sides(point_spread.shape))
    return replace(point_spread, intensity=intensity, enclosed_energy=float(intensity.sum()))


def field_with_tail(field: PointSpreadField, side: int) -> PointSpreadField:
    """The same of every point spread of a field: one more mode.

    Parameters
    ----------
    field : PointSpreadField
    side : int
        As of `with_tail`.

    Returns
    -------
    PointSpreadField
    """
    shape = field.modes.shape[1], field.modes.shape[2]
    side = _checked(side, shape)
    sums = field.modes.sum(axis=(1, 2))
    missing = np.maximum(1.0 - np.tensordot(sums, field.weights, 1), 0.0)
    modes = [_padded(mode, side) for mode in field.modes]
    return replace(
        field,
        modes=np.stack([*modes, tail_pixels((side, side), _sides(shape))]),
        weights=np.concatenate([field.weights, missing[None]]),
    )


def _sides(shape: tuple[int, int]) -> Sides:
    """Those of a window about its middle pixel."""
    below, left = ((n // 2 + 0.5, n - n // 2 - 0.5) for n in shape)
    return below, left


def _checked(side: int, shape: tuple[int, int]) -> int:
    side = whole("side", side)
    if side < max(shape):
        raise SamplingError(
            f"side = {side} is narrower than the point spread's {shape}; give a wider one"
        )
    fits_memory(f"a window of {side} x {side} pixels", 40.0 * side**2, "use a smaller side")
    return side


def _padded(intensity: Array, side: int) -> Array:
    wide = np.zeros((side, side))
    wide[middle(wide.shape, intensity.shape)] = intensity
    return wide
