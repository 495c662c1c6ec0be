"""Detector model: speckle, photon noise, dark current, readout noise and digitisation."""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from .._checks import positive
from .._random import generator
from ..scene import Camera

Array = NDArray[np.float64]

SPECKLE, PHOTONS, READOUT, BRIGHT_PHOTONS = 201, 202, 203, 204  # streams of the random generator
BRIGHT = 1e15  # mean electrons above which counts are drawn from a normal law (skewness < 1e-7)


def speckles_per_pixel(pixel: float, wavelength: float, f_number: float) -> float:
    """Number M of speckles averaged by a square pixel behind a circular pupil.

    Returns M, at least 1. Integrated polarised speckle has the contrast 1/sqrt(M).

    Notes
    -----
    1/M is the mean of |mu|^2 over all pairs of points in the pixel [1]_, with mu = 2 J1(v)/v and
    v = pi r/(wavelength f_number) at separation r. The average over directions has a closed form,
    so that a single integral over the separation s = r/pixel remains. The directional weight is
    the integral of (1 - s cos)(1 - s sin) over a quarter turn; for s > 1 only angles at which both
    factors are positive count.

    References
    ----------
    .. [1] Goodman, Speckle Phenomena in Optics, 2nd ed., sec. 4.4.
    """
    ratio = positive("pixel", pixel) / positive("wavelength", wavelength)
    ratio /= positive("f_number", f_number)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    total = 0.0
    for low, high in ((0.0, 1.0), (1.0, math.sqrt(2.0))):
        # |mu|^2 oscillates with period wavelength*f_number, and its tail falls as r^-3
        panels = np.unique(
            np.concatenate(
                [
                    np.linspace(low, high, 17),
                    np.linspace(low, min(high, low + 64 / ratio), 65),
                    np.linspace(low, high, 2 + math.ceil(min(ratio, 4096.0))),
                ]
            )
        )
        half = np.diff(panels)[:, None] / 2
        s = panels[:-1, None] + half * (1.0 + nodes)
        v = np.pi * ratio * s
        coherence = (2.0 * scipy.special.j1(v) / v) ** 2
        total += float((4.0 * half * weights * coherence * _quarter_turn(s) * s).sum())
    return 1.0 / total


def _quarter_turn(s: Array) -> Array:
    first = np.arccos(1.0 / np.maximum(s, 1.0))
    last = np.pi / 2 - first
    edge = np.sin(last) - np.sin(first) - np.cos(last) + np.cos(first)
    return np.asarray(last - first - s * edge + s**2 / 2 * (np.sin(last) ** 2 - np.sin(first) ** 2))


def noise_variance(
    camera: Camera, light: Array, dark: float | Array, freedom: float | None
) -> Array:
    """Expected noise variance of image pixels, electrons^2, if no pixel is saturated.

    It is the sum of shot noise (light and dark current), speckle, and binning^2 times the variances
    of the readout (read_noise^2) and of the digitisation (step^2/12).
    """
    step = camera.full_well / 2**camera.bit_depth
    native = camera.binning**2
    variance = light + dark + native * (camera.read_noise**2 + step**2 / 12)
    if freedom is not None:
        variance = variance + light**2 / freedom
    return np.asarray(variance)


def full_reading(camera: Camera) -> float:
    """Return the reading, electrons, from which on an image pixel of a camera may be full.

    A full pixel reads its full well with the noise of readout and digitisation. The result is three
    times their rms value below the full well, but at least half of it, and at most the converter's
    largest value.
    """
    native = camera.binning**2
    step: float = camera.full_well / 2**camera.bit_depth
    spread = math.sqrt(native * (camera.read_noise**2 + step**2 / 12))
    capacity = native * camera.full_well
    return capacity - max(min(3.0 * spread, 0.5 * capacity), native * step)


def _counts(mean: Array, seed: int) -> Array:
    """Draw Poisson-distributed electron counts for any mean."""
    found = generator(seed, PHOTONS).poisson(np.minimum(mean, BRIGHT)).astype(np.float64)
    if (mean > BRIGHT).any():  # numpy cannot draw Poisson counts beyond int64
        normal = generator(seed, BRIGHT_PHOTONS).standard_normal(mean.shape)
        found = np.where(mean > BRIGHT, mean + np.sqrt(mean) * normal, found)
    return found


def read_out(
    camera: Camera,
    light: Array,
    dark: float | Array,
    *,
    freedom: float | None = None,
    seed: int = 0,
) -> tuple[Array, float]:
    """Simulate one exposure of the detector with all noise.

    Speckle multiplies the light by a gamma variate of mean 1 and variance 1/freedom, drawn
    independently for each image pixel. The correlation between pixels smaller than a speckle is
    neglected. Light is taken as uniform over the native pixels of an image pixel, so that they
    saturate together. Each native pixel is read out and digitised separately before the values
    are summed, so that readout and digitisation variances add binning^2 times.
    """
    if freedom is not None:
        light = light * generator(seed, SPECKLE).gamma(freedom, 1.0 / freedom, light.shape)
    charge = _counts(light + dark, seed)
    native = camera.binning**2
    capacity = camera.full_well * native
    full = charge >= capacity
    charge = np.minimum(charge, capacity)
    step = camera.full_well / 2**camera.bit_depth
    # readout noise, and digitisation errors of all native pixels but one; rounding adds the last
    spread = math.sqrt(native * camera.read_noise**2 + (native - 1) * step**2 / 12)
    charge += spread * generator(seed, READOUT).standard_normal(light.shape)
    levels = native * (2**camera.bit_depth - 1)
    counts = np.minimum(np.rint(charge / step), levels)
    return counts * step, float(full.mean())
