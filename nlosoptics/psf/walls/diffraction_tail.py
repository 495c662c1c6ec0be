"""Extend point spread functions beyond their window by a model of the diffraction tail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..._checks import expect, fits_memory, in_range
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ..rough.mean import RoughPointSpread
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import Sides, tail_pixels
from ..window.window import middle
from .field import PointSpreadField
from .hybrid import HybridPointSpread


def widened(
    point_spreads: PointSpread | PointSpreadField, *, tol: float, shape: tuple[int, int]
) -> PointSpread | PointSpreadField:
    """Enlarge point spreads by a model of their tails, until almost all energy lies inside.

    Far from its centre, a point spread falls as ``1/r^3`` because of diffraction at the rim of the
    pupil, with r the distance from the centre. This law replaces a computation of the outer pixels.

    Parameters
    ----------
    point_spreads : PointSpread or PointSpreadField
        Point spreads with the normalisation "unit-sum": energy per pixel, 1 in the whole plane.
    tol : float
        Fraction of the energy that may lie outside the enlarged point spread; above 0, at most 1.
    shape : (int, int)
        Pixels (ny, nx) of the image to be formed. The enlarged point spread has at most
        ``2*max(shape) - 1`` pixels per side, because the image needs no more. Even more energy than
        ``tol`` may then lie outside.

    Returns
    -------
    PointSpread or PointSpreadField
        Point spreads on a square of more pixels. Values inside the old one are unchanged. The
        missing energy is distributed over the plane outside it as ``1/r^3``, and the part of this
        tail inside the new square is added. The input is returned if it is large enough.

    Raises
    ------
    SceneError
        If ``tol`` is out of range. If a point spread that contains light scattered by a rough wall
        is too small: the law does not hold for this light.
    SamplingError
        If a point spread is too small and its normalisation is not "unit-sum".

    See Also
    --------
    scene_point_spread : Wave and PSF of a scene.
    nlosoptics.imaging.form_image : Image in electrons, with noise.
    """
    point_spreads = expect("point_spreads", point_spreads, "PointSpread", "PointSpreadField")
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    if isinstance(point_spreads, PointSpreadField):
        spread = point_spreads.mean()
    else:
        spread = point_spreads.intensity
    side, missing = max(spread.shape), 1.0 - float(spread.sum())
    wide = min(math.ceil(side * max(missing, 0.0) / tol), 2 * max(shape) - 1) | 1
    if wide <= side:
        return point_spreads
    fits_memory(
        f"a window of {wide} x {wide} pixels",
        40.0 * wide**2,
        "use a larger tol, or an image of fewer pixels",
    )
    if isinstance(point_spreads, PointSpreadField):
        return field_with_tail(point_spreads, wide)
    return with_tail(point_spreads, wide)


def with_tail(point_spread: PointSpread, side: int) -> PointSpread:
    """Enlarge a point spread function to more pixels by a model of its outer part.

    Far outside the rays, a sharp rim yields ``lambda N/(pi^3 r^3)`` per area, averaged over the
    rings and for any aberration [1]_. Here the factor follows from the missing energy, so that the
    total is 1.

    .. [1] Born and Wolf, Principles of Optics, 7th ed., sec. 8.5.2.
    """
    if isinstance(point_spread, (RoughPointSpread, HybridPointSpread)):
        raise SceneError(
            f"point_spread is a {type(point_spread).__name__}, whose scattered light outside the "
            f"window has no 1/r^3 tail; compute it with shape = {side}"
        )
    if point_spread.normalisation != "unit-sum":
        raise SamplingError(
            f"point_spread.normalisation = {point_spread.normalisation!r}, from which the missing "
            "energy is not known; compute it with normalisation='unit-sum'"
        )
    missing = max(1.0 - float(point_spread.intensity.sum()), 0.0)
    intensity = _padded(point_spread.intensity, side)
    intensity += missing * tail_pixels((side, side), _sides(point_spread.shape))
    return replace(point_spread, intensity=intensity, enclosed_energy=float(intensity.sum()))


def field_with_tail(field: PointSpreadField, side: int) -> PointSpreadField:
    """Enlarge all point spreads of a field to ``side`` pixels by a model of their outer part.

    The result has one more mode, the tail.
    """
    shape = field.modes.shape[1], field.modes.shape[2]
    sums = field.modes.sum(axis=(1, 2))
    missing = np.maximum(1.0 - np.tensordot(sums, field.weights, 1), 0.0)
    modes = [_padded(mode, side) for mode in field.modes]
    return replace(
        field,
        modes=np.stack([*modes, tail_pixels((side, side), _sides(shape))]),
        weights=np.concatenate([field.weights, missing[None]]),
    )


def _sides(shape: tuple[int, int]) -> Sides:
    """Return the distances of a window's sides from its middle pixel, in pixels."""
    below, left = ((n // 2 + 0.5, n - n // 2 - 0.5) for n in shape)
    return below, left


def _padded(intensity: Array, side: int) -> Array:
    """Return an intensity at the centre of a square window, with 0 around it."""
    wide = np.zeros((side, side))
    wide[middle(wide.shape, intensity.shape)] = intensity
    return wide
