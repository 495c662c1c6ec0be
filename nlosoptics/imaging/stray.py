"""Image of the laser spot on the detector, formed by light straight from the spot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..scene import Scene
from .geometry import pixel_edges
from .radiometry import LaserSpot

Array = NDArray[np.float64]


def spot_image(scene: Scene, spot: LaserSpot) -> Array:
    """Fractions of the spot's light through the lens that fall on each pixel.

    The image is the spot's disc convolved with the disc of defocus, which amounts to the overlap
    area of two circles. The elliptic outline of the spot is replaced by a circle of the same area.
    Diffraction is neglected.

    Returns the fractions; their sum is the part that falls on the detector, at most 1.
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
    disc = max(math.sqrt(area / math.pi), pitch / 8)  # a smaller disc gives the same pixel values
    reach = blur + disc
    fine = max(1, math.ceil(16 * pitch / reach))
    seen, offsets, whole = [], [], True
    for edges, middle in zip(pixel_edges(camera), centre, strict=True):
        # pixels of the detector that the disc covers
        count = len(edges) - 1
        low, high = ((middle + side - edges[0]) / pitch for side in (-reach, reach))
        first = math.floor(min(max(low, 0.0), count))
        last = math.ceil(min(max(high, 0.0), count))
        if first >= last:
            return shares
        whole = whole and low >= 0.0 and high <= count
        seen.append(slice(first, last))
        parts = np.arange(first * fine, last * fine) + 0.5
        offsets.append(edges[0] + parts * (pitch / fine) - middle)
    # the integral of the common area over the plane is the product of both areas
    scale = (pitch / fine) ** 2 / (math.pi**2 * disc**2)
    scale /= blur**2 if blur > 0.0 else 1.0 / math.pi
    rows = max(1, (1 << 18) // max(1, fine * len(offsets[0])))
    for start in range(seen[1].start, seen[1].stop, rows):
        stop = min(start + rows, seen[1].stop)
        part = slice((start - seen[1].start) * fine, (stop - seen[1].start) * fine)
        light = common_area(np.hypot(offsets[0], offsets[1][part, None]), blur, disc)
        light = light.reshape(stop - start, fine, -1, fine).sum(axis=(1, 3))
        shares[start:stop, seen[0]] = scale * light
    # if the disc is entirely on the detector, its sum is known and removes the quadrature error
    return shares / float(shares.sum()) if whole else shares


def common_area(distance: Array, a: float, b: float) -> Array:
    """Return the overlap area, m^2, of circles of radii ``a`` and ``b`` whose centres are apart.

    ``distance`` is that of the centres, m.
    """
    small, large = min(a, b), max(a, b)
    r = np.clip(distance, large - small, large + small)
    if small == 0.0:  # a point: 1 inside the circle, 0 outside
        return (distance <= large).astype(np.float64)
    r = np.maximum(r, 1e-12 * large)
    first, second = (
        np.arccos(np.clip((r**2 + p**2 - q**2) / (2 * r * p), -1.0, 1.0))
        for p, q in ((small, large), (large, small))
    )
    # Heron's formula for the kite of the two centres and the two crossings
    kite = (large + small - r) * (r + small - large) * (r - small + large) * (r + small + large)
    return np.asarray(small**2 * first + large**2 * second - np.sqrt(np.maximum(kite, 0.0)) / 2)
