"""The detector: speckle, photon noise, dark current, readout and the converter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._checks import positive
from .._random import generator
from ..scene import Camera

Array = NDArray[np.float64]

SPECKLE, PHOTONS, READOUT, BRIGHT_PHOTONS = 201, 202, 203, 204  # streams of the random generator
BRIGHT = 1e15  # electrons above which counts are drawn as normal: skewed by less than 1e-7


def speckles_per_pixel(pixel: float, wavelength: float, f_number: float) -> float:
    """Number M of speckles that a square pixel averages, for a round pupil.

    Parameters
    ----------
    pixel : float
        Side, m.
    wavelength : float
        m.
    f_number : float
        Working F-number.

    Returns
    -------
    float
        At least 1; the contrast of integrated, polarised speckle is 1/sqrt(M).

    Notes
    -----
    1/M is the mean of |mu|^2 over pairs of points of the pixel [1]_, mu = 2 J1(v)/v,
    v = pi r/(wavelength f_number). The mean over directions is a closed form, so that one integral
    over the separation is left: with s = r/pixel, the integral of (1 - s cos)(1 - s sin) over the
    quarter turn (for s > 1, the part of it in which both are positive).

    References
    ----------
    .. [1] Goodman, Speckle Phenomena in Optics, 2nd ed., sec. 4.4.
    """
    ratio = positive("pixel", pixel) / positive("wavelength", wavelength)
    ratio /= positive("f_number", f_number)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    total = 0.0
    for low, high in ((0.0, 1.0), (1.0, math.sqrt(2.0))):
        # |mu|^2 oscillates once per wavelength*f_number; its tail falls as the cube
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
        coherence = (2.0 * special.j1(v) / v) ** 2
        total += float((4.0 * half * weights * coherence * _quarter_turn(s) * s).sum())
    return 1.0 / total


def _quarter_turn(s: Array) -> Array:
    first = np.arccos(1.0 / np.maximum(s, 1.0))
    last = np.pi / 2 - first
    edge = np.sin(last) - np.sin(first) - np.cos(last) + np.cos(first)
    return np.asarray(last - first - s * edge + s**2 / 2 * (np.sin(last) ** 2 - np.sin(first) ** 2))


def noise_variance(camera: Camera, light: Array, dark: float, freedom: float | None) -> Array:
    """Expected variance of image pixels, electrons^2, while no pixel is full.

    Parameters
    ----------
    camera : Camera
    light : ndarray
        Expected photoelectrons.
    dark : float
        Expected dark electrons of an image pixel.
    freedom : float or None
        Degrees of freedom of the speckle, 1/contrast^2; None for none.

    Returns
    -------
    ndarray
        Photon and dark noise, speckle, and binning^2 times that of the readout (read_noise^2) and
        of the converter (step^2/12).
    """
    step = camera.full_well / 2**camera.bit_depth
    native = camera.binning**2
    variance = light + dark + native * (camera.read_noise**2 + step**2 / 12)
    if freedom is not None:
        variance = variance + light**2 / freedom
    return np.asarray(variance)


def _counts(mean: Array, seed: int) -> Array:
    """Numbers of electrons that are drawn for their means: Poisson's, whatever the mean."""
    found = generator(seed, PHOTONS).poisson(np.minimum(mean, BRIGHT)).astype(np.float64)
    if (mean > BRIGHT).any():  # whole numbers of this size are no longer told apart
        normal = generator(seed, BRIGHT_PHOTONS).standard_normal(mean.shape)
        found = np.where(mean > BRIGHT, mean + np.sqrt(mean) * normal, found)
    return found


def read_out(
    camera: Camera, light: Array, dark: float, *, freedom: float | None = None, seed: int = 0
) -> tuple[Array, float]:
    """One exposure of the detector.

    Parameters
    ----------
    camera : Camera
    light : ndarray, (ny, nx)
        Expected photoelectrons of every image pixel.
    dark : float
        Expected dark electrons of an image pixel.
    freedom : float or None
        Degrees of freedom of the speckle; None for light that shows none.
    seed : int

    Returns
    -------
    electrons : ndarray, (ny, nx)
        Multiples of the converter's step, its offset taken off, so that dark pixels can read
        below zero.
    saturated : float
        Share of image pixels that are full.

    Notes
    -----
    Speckle multiplies the light by a gamma variate of mean 1 and variance 1/freedom, drawn for
    each image pixel on its own: pixels smaller than a speckle are in truth correlated. Light
    counts as even over the native pixels of one image pixel, so all of them fill up together.
    Every native pixel is read and converted alone and the values are added: the step applies to
    each, and so do the errors, binning^2 times in variance.
    """
    if freedom is not None:
        light = light * generator(seed, SPECKLE).gamma(freedom, 1.0 / freedom, light.shape)
    charge = _counts(light + dark, seed)
    native = camera.binning**2
    capacity = camera.full_well * native
    full = charge >= capacity
    charge = np.minimum(charge, capacity)
    step = camera.full_well / 2**camera.bit_depth
    # of the native converters' errors, all but the last rounding
    spread = math.sqrt(native * camera.read_noise**2 + (native - 1) * step**2 / 12)
    charge += spread * generator(seed, READOUT).standard_normal(light.shape)
    levels = native * (2**camera.bit_depth - 1)
    counts = np.minimum(np.rint(charge / step), levels)
    return counts * step, float(full.mean())
