"""Cramer-Rao bounds for the wall's wave from the Fisher information of an image."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..psf import Wavefront, fit_zernike
from ..psf.aperture.quadrature_nodes import gauss_legendre
from ..psf.wave.zernikes import zernike
from .modulation import Picture

Array = NDArray[np.float64]

#: Eigenvalues of the information below this fraction of the largest are rounding errors.
RANK = 1e-10


def wave_bounds(
    picture: Picture,
    wave: Wavefront,
    *,
    scale: float,
    pitch: float,
    blur: float = 0.0,
    modes: Sequence[int] = (4, 5, 6, 7, 8, 9, 10, 11),  # defocus to trefoil, and spherical
    defocus: Sequence[float] = (0.0,),
) -> list[dict[int, float]]:
    """Return Cramer-Rao bounds for the wave's Zernike coefficients when the object is known.

    Notes
    -----
    For an image mu(c) in white noise of variance V the Fisher information is ``F_ij = sum dmu/dc_i
    dmu/dc_j/V`` [1]_. The sum runs over frequencies (Parseval's theorem), with the object's mean
    power at each. The transfer function at pupil separation s has the derivative
    ``i k <(Z(p + s/2) - Z(p - s/2)) exp(i k (W(p + s/2) - W(p - s/2)))>``, averaged over the
    overlap of the pupils. Tilts and gain of each frame are treated as unknown too. If the object
    is unknown as well, the bounds can only be larger.

    References
    ----------
    .. [1] Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, sec. 3.9.
    """
    radius = wave.pupil_radius
    # image frequency of a pupil separation s is s/(lambda |d_i|)
    per_separation = 1.0 / (wave.wavelength * abs(wave.image_distance))
    cut = min(2.0 * radius * per_separation, 0.5 / pitch)
    shares, weights = gauss_legendre(20)
    frequencies = cut * shares
    angles = math.pi * (np.arange(12) + 0.5) / 12  # half plane; the rest is conjugate
    power = _radial_power(picture, frequencies / scale)
    lobe = np.exp(-2.0 * (math.pi * blur * frequencies / scale) ** 2)
    # spectrum samples per unit frequency area; the factor 2 accounts for the other half plane
    density = _density(picture) / scale**2
    area = frequencies * (cut * weights) * (math.pi / len(angles)) * density * 2.0
    coefficients = {
        j: c for j, c in fit_zernike(wave, 28).items() if abs(c) > 1e-4 * wave.wavelength
    }
    separations = frequencies / per_separation / radius
    x, y, overlap = (part[:, None] for part in _overlaps(separations))
    # ends of pairs of pupil points, (radii, angles, nodes), at each separation
    half = separations[:, None, None] / 2
    ends = [
        (np.hypot(x + s * half, y), np.arctan2(y, x + s * half) + angles[:, None]) for s in (1, -1)
    ]
    steps = {
        j: zernike(j, *ends[0]) - zernike(j, *ends[1]) for j in {*coefficients, *modes, 2, 3, 4}
    }
    along, across = (frequencies[:, None] * f(angles) * pitch for f in (np.cos, np.sin))
    passed = lobe[:, None] * np.sinc(along) * np.sinc(across)
    phase = sum(c * steps[j] for j, c in coefficients.items()) * (2 * math.pi / wave.wavelength)
    weight = area * power / (picture.noise.variance * math.prod(picture.grid))
    moved = np.stack(np.broadcast_arrays(*(steps[j] for j in (*modes, 2, 3))))
    information, bounds = np.zeros((len(modes), len(modes))), []
    for extra in defocus:
        light = overlap * np.exp(1j * (phase + 2 * math.pi * extra * steps[4]))
        light = np.broadcast_to(light, moved.shape[1:])  # defocus alone is equal at all angles
        # a shift of the phase by a coefficient multiplies the sum's terms by i times its step
        changes = 2j * math.pi * np.einsum("kran,ran->kra", moved, light)
        derivatives = np.concatenate([changes, [light.sum(axis=-1)]])
        derivatives *= passed
        full = np.einsum("r,kra,lra->kl", weight, derivatives.conj(), derivatives).real
        information += _reduced(full, len(modes))
        bounds.append(dict(zip(modes, _bounds(information), strict=True)))
    return bounds


def _overlaps(separations: Array) -> tuple[Array, Array, Array]:
    """Return quadrature nodes in the overlaps of two unit discs, and their weights over pi.

    The discs are separated along x, by ``separations`` (radii,). Nodes (radii, nodes) are relative
    to the centre of the overlap.
    """
    shares, weights = gauss_legendre(14)
    nodes, weights = 2.0 * shares - 1.0, 2.0 * weights
    top = np.sqrt(np.maximum(1.0 - separations**2 / 4.0, 0.0))[:, None]
    # the substitution v = sin removes the square-root singularity at the tips
    v = top * np.sin(math.pi / 2 * nodes)
    dv = top * math.pi / 2 * np.cos(math.pi / 2 * nodes) * weights
    half = np.sqrt(np.maximum(1.0 - v**2, 0.0)) - separations[:, None] / 2
    along = half[..., None] * nodes
    area = (dv * half)[..., None] * weights / math.pi
    shape = (len(separations), -1)
    across = np.broadcast_to(v[..., None], along.shape)
    return along.reshape(shape), across.reshape(shape), area.reshape(shape)


def _reduced(full: Array, count: int) -> Array:
    """Return the Fisher information on the first ``count`` parameters if all others are unknown.

    It is the Schur complement of the others in the full information matrix.
    """
    kept, cross, others = full[:count, :count], full[:count, count:], full[count:, count:]
    return kept - cross @ np.linalg.pinv(others, rcond=RANK, hermitian=True) @ cross.T


def _bounds(information: Array) -> list[float]:
    """Square roots of the inverse's diagonal; infinity for parameters without information."""
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
    """Return the number of samples of the full spectrum per unit of frequency area, m^2.

    Frequencies are those on the object, cycles/m.
    """
    steps = picture.frequency[1, 0] * picture.frequency[0, 1]
    return 1.0 / float(steps)
