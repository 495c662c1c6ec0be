"""Intensity of a focused wave anywhere in space, as a direct sum of spherical waves."""

from __future__ import annotations

import numpy as np


def spherical_waves(wave, points, *, counts=(48, 192)):
    """Intensity at points (n, 3), m, and the fraction of the energy per m^2 where it is 1.

    The first Rayleigh-Sommerfeld integral without its near-field term (Goodman, Introduction to
    Fourier Optics, 3rd ed., sec. 3.5) over the reference sphere, on which the pupil coordinates
    lie, for a pupil of the layout "polar" or "cells". It is 1 at the ideal focus.
    """
    wave = wave.resampled(*counts)
    d, k = wave.image_distance, 2 * np.pi / wave.wavelength
    u, v, path, amplitude, area = (
        part.ravel() for part in (wave.u, wave.v, wave.aberration, wave.amplitude, wave.weights)
    )
    # depth of the sphere about the focus, from the pupil's centre, without cancellation
    cosine = np.sqrt(1 - (u * u + v * v) / d**2)
    w = (u * u + v * v) / d / (1 + cosine)
    # the amplitude squared is the power per area of (u, v), of which the sphere has more by 1/cos
    size = amplitude * area / np.sqrt(cosine)
    field = np.empty(len(points), dtype=np.complex128)
    for i, (x, y, z) in enumerate(points):
        a, b, e = x - u, y - v, z - w
        r = np.sqrt(a * a + b * b + e * e)
        longer = (x * (x - 2 * u) + y * (y - 2 * v) + (z - d) * (e + d - w)) / (r + abs(d))
        slant = np.abs(e * (d - w) - a * u - b * v) / (r * abs(d))
        field[i] = np.sum(size * slant / r * np.exp(1j * k * (path + np.sign(d) * longer)))
    peak = np.sum(size) / abs(d)
    density = (peak / wave.wavelength) ** 2 / np.sum(amplitude**2 * area)
    return np.abs(field / peak) ** 2, density
