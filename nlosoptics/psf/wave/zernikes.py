"""Zernike polynomials in Noll, OSA and Fringe ordering."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import numbers, one_of, real, whole
from ..._vectors import Array
from ...errors import SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import pupil_points
from ..aperture.quadrature_nodes import frozen

Ordering = Literal["noll", "osa", "fringe"]
ORDERINGS = ("noll", "osa", "fringe")


def zernike_order(index: int, ordering: Ordering = "noll") -> tuple[int, int]:
    """Return the radial degree n and the angular frequency m of the Zernike term with an index.

    Parameters
    ----------
    index : int
        Number of the term in the index scheme: from 1 for Noll, from 0 for OSA, 1 to 37 for Fringe.
    ordering : {"noll", "osa", "fringe"}
        Index scheme: Noll (JOSA 66, 207, 1976), OSA (also ANSI Z80.28), or Fringe (also University
        of Arizona), where term 37 is spherical aberration of degree 12.

    Returns
    -------
    n, m : int
        Radial degree, and angular frequency: the term varies as cos(m theta) for m >= 0 and as
        sin(-m theta) for m < 0.

    Raises
    ------
    SceneError
        If the index is out of range or the ordering unknown.

    See Also
    --------
    zernike : Zernike polynomial.

    Examples
    --------
    Coma is Noll term 8, primary spherical aberration Fringe term 9:

    >>> from nlosoptics import psf
    >>> psf.zernike_order(8), psf.zernike_order(9, "fringe")
    ((3, 1), (4, 0))
    """
    one_of("ordering", ordering, ORDERINGS)
    whole(f"{ordering} index", index, 0 if ordering == "osa" else 1)
    if ordering == "osa":
        n = (math.isqrt(8 * index + 1) - 1) // 2
        return n, 2 * index - n * (n + 2)
    if ordering == "noll":
        n = (math.isqrt(8 * index - 7) - 1) // 2
        place = index - n * (n + 1) // 2  # 1 .. n + 1
        m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place - 1) // 2) + 1
        return n, m if index % 2 == 0 else -m
    if index > 37:
        raise SceneError(f"fringe index = {index} is out of range, must be 1 to 37; use noll")
    if index == 37:
        return 12, 0
    half = math.isqrt(index - 1)  # (n + |m|)/2
    place = index - half**2 - 1
    m = half - place // 2
    return 2 * half - m, -m if place % 2 else m


def radial(n: int, m: int, rho: ArrayLike) -> Array:
    """Radial Zernike polynomial R_n^|m|, 1 at rho = 1.

    Evaluated as rho^m P_k^(0, m)(2 rho^2 - 1), k = (n - m)/2, by the Jacobi recurrence. It stays
    accurate where the textbook sum of factorials suffers from cancellation (from n = 30 on).
    """
    rho = numbers("rho", rho)
    m = abs(m)
    x = 2 * rho**2 - 1
    terms = [np.ones_like(x), ((m + 2) * x - m) / 2]
    for k in range(2, (n - m) // 2 + 1):
        # Abramowitz & Stegun 22.7.1 with alpha = 0, beta = m.
        s = 2 * k + m
        linear = (s - 1) * (s * (s - 2) * x - m**2)
        rest = 2 * (k - 1) * (k + m - 1) * s * terms[-2]
        terms.append((linear * terms[-1] - rest) / (2 * k * (k + m) * (s - 2)))
    return np.asarray(rho**m * terms[(n - m) // 2])


def zernike(index: int, rho: ArrayLike, theta: ArrayLike, *, ordering: Ordering = "noll") -> Array:
    """Return a Zernike polynomial at points of the unit disc.

    Parameters
    ----------
    index : int
        Number of the polynomial in the index scheme ``ordering``.
    rho, theta : array_like, (...)
        Radius divided by the pupil radius, and angle from the u axis toward the v axis, rad. Their
        shapes broadcast.
    ordering : {"noll", "osa", "fringe"}
        Index scheme, see `zernike_order`. It also sets the normalisation: Noll and OSA polynomials
        have rms 1 over the disc; Fringe polynomials have the amplitude 1 at the rim.

    Returns
    -------
    ndarray
        Values in the broadcast shape of rho and theta.

    Raises
    ------
    SceneError
        If the index is out of range or the ordering unknown.

    See Also
    --------
    zernike_order : Radial and azimuthal order of an index.
    fit_zernike : Zernike coefficients of a wave.

    Examples
    --------
    Noll term 4 is defocus, ``sqrt(3) (2 rho^2 - 1)``:

    >>> from nlosoptics import psf
    >>> print(psf.zernike(4, [0.0, 1.0], 0.0).round(4))
    [-1.7321  1.7321]
    """
    n, m = zernike_order(index, ordering)
    theta = numbers("theta", theta)
    value = radial(n, m, rho)
    if m != 0:
        value = value * (np.cos(m * theta) if m > 0 else np.sin(-m * theta))
    if ordering != "fringe":
        value = value * math.sqrt((n + 1) * (1 if m == 0 else 2))
    return np.asarray(value)


def zernike_basis(
    indices: Sequence[int], rho: ArrayLike, theta: ArrayLike, *, ordering: Ordering = "noll"
) -> Array:
    """Return several Zernike polynomials stacked, (len(indices), ...); arguments as `zernike`."""
    return np.stack([zernike(index, rho, theta, ordering=ordering) for index in indices])


@lru_cache(maxsize=16)
def kept_zernikes(
    indices: tuple[int, ...],
    ordering: Ordering,
    radius: float,
    obscuration: float,
    outline: Aperture | None,
    counts: tuple[int, ...],
) -> Array:
    """Zernike polynomials (n, *counts) at nodes of `pupil_points`, cached and read-only."""
    u, v, _ = pupil_points(radius, obscuration, outline, counts)
    rho, theta = np.hypot(u, v) / radius, np.arctan2(v, u)
    return frozen(zernike_basis(indices, rho, theta, ordering=ordering))


def zernike_sum(
    coefficients: Mapping[int, float], u: Array, v: Array, radius: float, ordering: Ordering
) -> Array:
    """Return a sum of Zernike polynomials of a disc of a given radius, m, at (u, v), m."""
    rho, theta = np.hypot(u, v) / radius, np.arctan2(v, u)
    total = np.zeros_like(u)
    for index, value in coefficients.items():
        height = real(f"coefficients[{index}]", value)
        total += height * zernike(index, rho, theta, ordering=ordering)
    return total
