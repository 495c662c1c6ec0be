"""Polarised reflection by Stokes parameters, after Fresnel.

Stokes parameters (I, Q, U, V) of light in the direction d refer to a unit vector e perpendicular to
it. With the field components E1 along e and E2 along e x d, they are I = |E1|^2 + |E2|^2,
Q = |E1|^2 - |E2|^2, U = 2 Re(E1 E2*) and V = 2 Im(E1 E2*).
"""

from __future__ import annotations

import cmath
import math

from .compiling import njit


@njit(cache=True)
def fresnel(n, k, cosine):
    """Return the Mueller matrix of a plane surface, its rows a b 0 0, b a 0 0, 0 0 c -d, 0 0 d c.

    The result is (a, b, c, d); a is the reflectance for unpolarised light. Stokes parameters refer
    to the normal of the plane of incidence. ``n`` and ``k`` are the refractive index n + ik, and
    ``cosine`` is that of the angle of incidence. Born and Wolf, Principles of Optics, sec. 1.5.
    """
    square = complex(n, k) ** 2
    inside = cmath.sqrt(square - (1.0 - cosine * cosine))
    across = (cosine - inside) / (cosine + inside)
    along = (square * cosine - inside) / (square * cosine + inside)
    s, p = abs(across) ** 2, abs(along) ** 2
    mixed = across * along.conjugate()
    return 0.5 * (s + p), 0.5 * (s - p), mixed.real, mixed.imag


@njit(cache=True)
def cross(a, b):
    """Return the vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def perpendicular(a, d, other):
    """Return the unit vector along the part of a perpendicular to the unit vector d.

    It is ``other`` if a is parallel to d.
    """
    along = a[0] * d[0] + a[1] * d[1] + a[2] * d[2]
    x, y, z = a[0] - along * d[0], a[1] - along * d[1], a[2] - along * d[2]
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size) if size > 1e-12 else other


@njit(cache=True)
def turned(stokes, d, old, new):
    """Return Stokes parameters of light in the direction d for another reference vector."""
    second = cross(old, d)
    cosine = new[0] * old[0] + new[1] * old[1] + new[2] * old[2]
    sine = new[0] * second[0] + new[1] * second[1] + new[2] * second[2]
    double, twice = cosine * cosine - sine * sine, 2.0 * sine * cosine
    i, q, u, v = stokes
    return i, double * q + twice * u, double * u - twice * q, v
