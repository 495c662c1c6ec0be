"""Special functions without scipy.special, whose import takes a sixth of a second.

Errors are at most 1.5e-15 for Bessel functions, and relative 2e-14 (a + x + 1) for the incomplete
gamma function.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Taylor series of J0 are tabulated at this many points per radian, up to FAR rad; beyond, Hankel's
#: expansion is used. Both series are cut where their terms are below 1e-17.
STEPS, FAR = 8, 25
TERMS, HANKEL_TERMS = 10, 18
NODES = 80  # of the trapezoidal rule for Bessel's integral, whose error is J_80(FAR), 1e-30
MOST_PARTS = 1_000_000  # of the incomplete gamma function's expansions


def erfc(x: Array) -> Array:
    """Return the complementary error function of each element."""
    return np.array([math.erfc(value) for value in x.ravel()]).reshape(x.shape)


def bessel_j0(x: Array) -> Array:
    """Return the Bessel function J0 of non-negative arguments."""
    return _bessel(x, 0)


def bessel_j1(x: Array) -> Array:
    """Return the Bessel function J1 of non-negative arguments."""
    return _bessel(x, 1)


def _bessel(x: Array, order: int) -> Array:
    """Return J0 or J1 = -J0' from tabulated series, or for large arguments by Hankel's expansion.

    The latter is Abramowitz & Stegun 9.2.5, 9.2.9 and 9.2.10.
    """
    found, near = np.empty_like(x), x < FAR
    index = np.rint(STEPS * x[near]).astype(np.intp)
    beside = x[near] - index / STEPS
    found[near] = polynomial.polyval(beside, _series(order)[:, index], tensor=False)
    inverse = 1.0 / x[~near]
    even, odd = (polynomial.polyval(inverse**2, part) for part in _hankel(order))
    phase = x[~near] - (0.25 + 0.5 * order) * math.pi
    wave = even * np.cos(phase) - odd * inverse * np.sin(phase)
    found[~near] = np.sqrt(2.0 / math.pi * inverse) * wave
    return found


@cache
def _series(order: int) -> Array:
    """Return the Taylor coefficients (terms, points) of J0 or J1 at the points k/STEPS.

    Bessel's integral gives J0 and J1 there, and the equation v f'' + f' + v f = 0 all further
    derivatives of J0.
    """
    v = np.arange(STEPS * FAR + 1) / STEPS
    sines = np.sin(2.0 * math.pi * (np.arange(NODES) + 0.5) / NODES)
    phase = np.outer(v, sines)
    terms = np.zeros((TERMS + 1, v.size))
    terms[0], terms[1] = np.cos(phase).mean(axis=1), -(np.sin(phase) * sines).mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for n in range(TERMS - 1):
            rest = (n + 1) ** 2 * terms[n + 1] + v * terms[n] + (terms[n - 1] if n else 0.0)
            terms[n + 2] = -rest / (v * (n + 1) * (n + 2))
    terms[:, 0] = 0.0
    terms[::2, 0] = [(-0.25) ** k / math.factorial(k) ** 2 for k in range(TERMS // 2 + 1)]
    return terms if order == 0 else -terms[1:] * np.arange(1, TERMS + 1)[:, None]


@cache
def _hankel(order: int) -> tuple[Array, Array]:
    """Return the coefficients of Hankel's expansion, of even and of odd powers of 1/x."""
    terms = [1.0]
    for k in range(1, HANKEL_TERMS):
        terms.append(terms[-1] * (4 * order**2 - (2 * k - 1) ** 2) / (8 * k))
    signs = (-1.0) ** np.arange(HANKEL_TERMS // 2)
    return np.array(signs * terms[::2]), np.array(signs * terms[1::2])


def upper_gamma_share(a: float, x: float) -> float:
    """Return the regularised upper incomplete gamma function Q(a, x), for a > 0 and x >= 0.

    Its power series below x = a + 1, else its continued fraction (DLMF 8.7.1 and 8.9.2).
    """
    if x == 0.0:
        return 1.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        for k in range(1, MOST_PARTS):
            term *= x / (a + k)
            total += term
            if term < 1e-17 * total:
                break
        return max(1.0 - scale * total, 0.0)
    # Steed's evaluation: the sum of differences of successive convergents
    below = x + 1.0 - a
    ratio = step = total = 1.0 / below
    for k in range(1, MOST_PARTS):
        part = -k * (k - a)
        below += 2.0
        ratio = 1.0 / (part * ratio + below)
        step *= below * ratio - 1.0
        total += step
        if abs(step) < 1e-16 * abs(total):
            break
    return scale * total
