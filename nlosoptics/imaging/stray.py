"""Light that reaches the detector straight from the laser's spot: its image and veiling glare."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..scene import Scene
from .geometry import pixel_edges
from .radiometry import LaserSpot

Array = NDArray[np.float64]


def spot_image(scene: Scene, spot: LaserSpot) -> Array:
    """Shares of the spot's light through the lens that fall on each pixel.

    The image is the spot's disc blurred by the disc that defocus makes of a point; their
    convolution depends on the area common to two circles. The spot's outline, an ellipse seen
    obliquely, is taken as the circle of the same area. Diffraction is left out.

    Parameters
    ----------
    scene : Scene
    spot : LaserSpot

    Returns
    -------
    ndarray, (ny, nx)
        Sums to the share that falls on the detector, at most 1.
    """
    camera = scene.camera
    shares = np.zeros(camera.shape)
    offset = spot.point - np.array(camera.position)
    u, v, depth = (float((offset * axis).sum()) for axis in camera.frame)
    if depth <= 0.0:
        return shares
    distance = scene.image_distance
    centre = (-distance * u / depth, -distance * v / depth)
    # distance/(image distance of the spot) - 1, by the thin-lens equation
    defocus = distance * (1.0 / camera.focal_length - 1.0 / depth) - 1.0
    blur = camera.stop_diameter / 2 * abs(defocus)
    range_sq = float((offset * offset).sum())
    facing = max(-float((offset * spot.normal).sum()) / math.sqrt(range_sq), 0.0)
    # area of the image: solid angle from the lens times distance^2/cos^3 of the chief ray
    cosine = depth / math.sqrt(range_sq)
    area = spot.area * facing / range_sq * distance**2 / cosine**3
    pitch = camera.image_pitch
    disc = max(math.sqrt(area / math.pi), pitch / 8)  # smaller ones fall within a pixel anyway
    reach = blur + disc
    fine = max(1, math.ceil(16 * pitch / reach))
    pixels, offsets = [], []
    for edges, middle in zip(pixel_edges(camera), centre, strict=True):
        # all pixels that the disc covers, those beyond the detector included
        first = math.floor((middle - reach - edges[0]) / pitch)
        last = math.ceil((middle + reach - edges[0]) / pitch)
        pixels.append(np.arange(first, last))
        parts = np.arange(first * fine, last * fine) + 0.5
        offsets.append(edges[0] + parts * (pitch / fine) - middle)
    light = common_area(np.sqrt(offsets[0] ** 2 + offsets[1][:, None] ** 2), blur, disc)
    light = light.reshape(len(pixels[1]), fine, len(pixels[0]), fine).sum(axis=(1, 3))
    light /= light.sum()
    kept = [
        (p >= 0) & (p < n) for p, n in zip(pixels, (camera.shape[1], camera.shape[0]), strict=True)
    ]
    shares[np.ix_(pixels[1][kept[1]], pixels[0][kept[0]])] = light[np.ix_(kept[1], kept[0])]
    return shares


def common_area(distance: Array, a: float, b: float) -> Array:
    """Area common to two circles of radii ``a`` and ``b`` at centre ``distance``, m^2."""
    small, large = min(a, b), max(a, b)
    r = np.clip(distance, large - small, large + small)
    if small == 0.0:  # a point: only whether it lies inside
        return (distance <= large).astype(np.float64)
    r = np.maximum(r, 1e-12 * large)
    first, second = (
        np.arccos(np.clip((r**2 + p**2 - q**2) / (2 * r * p), -1.0, 1.0))
        for p, q in ((small, large), (large, small))
    )
    # Heron's formula for the kite of the two centres and the two crossings
    kite = (large + small - r) * (r + small - large) * (r - small + large) * (r + small + large)
    return np.asarray(small**2 * first + large**2 * second - np.sqrt(np.maximum(kite, 0.0)) / 2)
