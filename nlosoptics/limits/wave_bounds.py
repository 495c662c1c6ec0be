"""How well an image can tell the wall's wave: Fisher information and Cramer-Rao bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..psf import Wavefront, fit_zernike
from ..psf.wave.zernikes import zernike
from .modulation import Picture

Array = NDArray[np.float64]

#: Noll indices whose bounds are told: focus to trefoil and spherical aberration.
MODES = (4, 5, 6, 7, 8, 9, 10, 11)
#: Known extra focus of a second frame, waves rms.
DEFOCUS = 0.5
RADII, ANGLES = 20, 12  # of the frequencies summed
NODES = 14  # along each side of the overlap of two pupils
FITTED = 28  # Zernike terms that stand for the scene's own wave
#: Information below this part of the largest is rounding, no information.
RANK = 1e-10


def wave_bounds(
    picture: Picture,
    wave: Wavefront,
    *,
    scale: float,
    pitch: float,
    blur: float = 0.0,
    modes: Sequence[int] = MODES,
    defocus: Sequence[float] = (0.0,),
) -> dict[int, float]:
    """Cramer-Rao bounds of the wave's Zernike coefficients with the object known.

    Parameters
    ----------
    picture : Picture
        Object's power and noise of every frame.
    wave : Wavefront
        Of the scene, about which the information is taken.
    scale : float
        Metres on the object per metre on the detector.
    pitch : float
        Image pixel, m.
    blur : float
        Of the wall's lobe on the object, m rms.
    modes : sequence of int
        Noll indices from 4 on.
    defocus : sequence of float
        Known extra focus (Noll 4) of each frame, waves rms.

    Returns
    -------
    dict of int to float
        Least standard deviation of any unbiased estimate, waves rms; infinity where the image
        does not change with the coefficient to first order, as with the focus of a wave in focus.

    Notes
    -----
    Of an image mu(c) in white noise of variance V the information is ``F_ij = sum dmu/dc_i
    dmu/dc_j/V`` [1]_, summed over frequencies by Parseval's theorem with the object's mean power at
    each. The derivative of the transfer function at separation s is that of the pupil's overlap,
    ``i k <(Z(p + s/2) - Z(p - s/2)) exp(i k (W(p + s/2) - W(p - s/2)))>``. Tilts of every frame and
    its gain are unknown besides. An object that is unknown too only raises the bounds.

    References
    ----------
    .. [1] Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, sec. 3.9.
    """
    radius = wave.pupil_radius
    # image frequency of a pupil separation s is s/(lambda |d_i|)
    per_separation = 1.0 / (wave.wavelength * abs(wave.image_distance))
    cut = min(2.0 * radius * per_separation, 0.5 / pitch)
    nodes, weights = np.polynomial.legendre.leggauss(RADII)
    frequencies = cut * (nodes + 1.0) / 2.0
    angles = math.pi * (np.arange(ANGLES) + 0.5) / ANGLES  # the other half is its conjugate
    power = _radial_power(picture, frequencies / scale)
    lobe = np.exp(-2.0 * (math.pi * blur * frequencies / scale) ** 2)
    # samples of the half plane of the spectrum per area of frequencies, each counted twice
    density = _density(picture) / scale**2
    area = frequencies * (cut / 2.0 * weights) * (math.pi / ANGLES) * density * 2.0
    coefficients = fit_zernike(wave, FITTED)
    separations = frequencies / per_separation / radius
    steps, overlap = _steps(separations, angles, {*coefficients, *modes, 2, 3})
    along, across = (frequencies[:, None] * f(angles) * pitch for f in (np.cos, np.sin))
    passed = lobe[:, None] * np.sinc(along) * np.sinc(across)
    phase = sum(c * steps[j] for j, c in coefficients.items()) * (2 * math.pi / wave.wavelength)
    weight = area * power / (picture.noise.variance * math.prod(picture.grid))
    information = np.zeros((len(modes), len(modes)))
    for extra in defocus:
        turned = overlap * np.exp(1j * (phase + 2 * math.pi * extra * steps[4]))
        moved = [2j * math.pi * (steps[j] * turned).sum(axis=-1) for j in (*modes, 2, 3)]
        derivatives = np.stack([*moved, turned.sum(axis=-1)], axis=-1) * passed[..., None]
        full = np.einsum("i,ijk,ijl->kl", weight, derivatives.conj(), derivatives).real
        information += _reduced(full, len(modes))
    return dict(zip(modes, _bounds(information), strict=True))


def _steps(
    separations: Array, angles: Array, indices: Iterable[int]
) -> tuple[dict[int, Array], Array]:
    """Differences of Zernike polynomials across each separation, and weights of the nodes.

    ``separations`` in radii of the pupil, below 2; arrays (radii, angles, nodes).
    """
    nodes = [[_overlap(s, angle) for angle in angles] for s in separations]
    x, y, weights = (np.array([[node[k] for node in row] for row in nodes]) for k in range(3))
    dx, dy = (separations[:, None, None] / 2 * f(angles)[:, None] for f in (np.cos, np.sin))
    ends = [(np.hypot(x + s * dx, y + s * dy), np.arctan2(y + s * dy, x + s * dx)) for s in (1, -1)]
    return {j: zernike(j, *ends[0]) - zernike(j, *ends[1]) for j in indices}, weights


def _overlap(separation: float, angle: float) -> tuple[Array, Array, Array]:
    """Nodes in the area common to two unit discs, relative to its middle, and weights over pi."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    top = math.sqrt(max(1.0 - separation**2 / 4.0, 0.0))
    # sines take the root at the tips out of the integrand
    v = top * np.sin(math.pi / 2 * nodes)
    dv = top * math.pi / 2 * np.cos(math.pi / 2 * nodes) * weights
    half = np.sqrt(np.maximum(1.0 - v**2, 0.0)) - separation / 2
    along = half[:, None] * nodes
    area = (dv * half)[:, None] * weights / math.pi
    across = np.broadcast_to(v[:, None], along.shape)
    c, s = math.cos(angle), math.sin(angle)
    return (c * along - s * across).ravel(), (s * along + c * across).ravel(), area.ravel()


def _reduced(full: Array, count: int) -> Array:
    """Information on the first ``count`` parameters with the others unknown (Schur complement)."""
    kept, cross, others = full[:count, :count], full[:count, count:], full[count:, count:]
    return kept - cross @ np.linalg.pinv(others, rcond=RANK, hermitian=True) @ cross.T


def _bounds(information: Array) -> list[float]:
    """Root of the inverse's diagonal; infinity along what carries no information."""
    values, vectors = np.linalg.eigh(information)
    told = values > RANK * max(float(values[-1]), 0.0)
    if float(values[-1]) <= 0.0:
        return [math.inf] * len(information)
    blind = (vectors[:, ~told] ** 2).sum(axis=1) > 1e-6
    variance = (vectors[:, told] ** 2 / values[told]).sum(axis=1)
    return [math.inf if b else math.sqrt(v) for b, v in zip(blind, variance, strict=True)]


def _radial_power(picture: Picture, frequencies: Array) -> Array:
    order = np.argsort(picture.frequency, axis=None)
    return np.interp(frequencies, picture.frequency.ravel()[order], picture.power.ravel()[order])


def _density(picture: Picture) -> float:
    """Samples of the whole spectrum per (cycle/m)^2 on the object."""
    steps = picture.frequency[1, 0] * picture.frequency[0, 1]
    return 1.0 / float(steps)
