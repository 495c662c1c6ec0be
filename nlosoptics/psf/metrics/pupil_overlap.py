"""Optical transfer function of a wave on a pupil of any outline: the overlap of shifted pupils.

The overlap is cut into strips along the shift. Within a strip the same curves bound the pupil, so
that its parts have smooth ends, and Gauss-Legendre nodes converge spectrally.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ...errors import SamplingError
from ..aperture.aperture import Aperture
from ..aperture.curves import Curve, abscissa, cross, monotone_parts
from ..aperture.quadrature_nodes import gauss_legendre
from ..wave.cell_series import CellSpectrum
from ..wave.detilted import Residual
from ..wave.polar_series import PolarSpectrum, legendre, values_at

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Largest difference of the results of two successive numbers of nodes.
CONVERGED = 1e-10
#: Largest such difference with which a result is returned.
ACCEPTED = 1e-6
#: Numbers of nodes added to those of the phase, in this order until the result has converged.
MORE = (4, 6, 9, 14, 24, 40, 64)
#: Samples of the distance of two curves in a strip, between which it changes its sign once.
LOOKS = 17
#: Width of a strip or part, relative to the pupil, below which it is left out.
SLIVER = 1e-13
#: Steps of bisection to an interval of rounding error, and of Newton's method from a good start.
HALVINGS, NEWTON = 50, 5


class _Piece(NamedTuple):
    """Piece of an outline along which the coordinate across the shift only rises or only falls."""

    cell: int
    curve: Curve
    low: float
    high: float


def transfer(residual: Residual, frequency: float, azimuth: float) -> complex:
    """Return the optical transfer function at one frequency, 1 at frequency 0.

    Parameters
    ----------
    residual : Residual
        Polar wave or wave on cells.
    frequency : float
        Cycles per m in the image, along the azimuth.
    azimuth : float
        Direction, rad from x toward y.

    Raises
    ------
    SamplingError
        If the overlap has not converged to `ACCEPTED` with the most nodes.

    Notes
    -----
    ``H(f) = sum P(q - s/2) P*(q + s/2) / sum |P|^2`` with ``s = lambda d f`` [1]_.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 6.3.
    """
    wave = residual.wavefront
    shift = wave.wavelength * wave.image_distance * frequency
    if shift == 0:
        return 1.0 + 0.0j
    outline = wave.aperture or Aperture.round(wave.pupil_radius, wave.obscuration)
    pieces = [
        _Piece(k, piece, *sorted(piece.at([0.0, 1.0])[:, 1].tolist()))
        for k, cell in enumerate(outline.cells)
        for curve in cell.outline
        for piece in monotone_parts(curve.turned(azimuth))
    ]
    size = 2 * outline.bounding_radius
    pieces = [piece for piece in pieces if piece.high - piece.low > SLIVER * size]
    strips = list(_strips(pieces, shift, SLIVER * size))
    steep = 2 * residual.wavenumber * residual.rays.slope
    before, found, change = 0.0j, 0.0j, math.inf
    for more in MORE:
        found = _summed(residual, strips, shift, azimuth, steep, more)
        change = abs(found - before)
        if change < CONVERGED:
            break
        before = found
    if change > ACCEPTED:
        raise SamplingError(
            f"the transfer function at {frequency:.4g} /m changes by {change:.2g} with more nodes, "
            f"limit {ACCEPTED:g}; use psf.point_spread and its transfer function"
        )
    along = residual.shift[0] * math.cos(azimuth) + residual.shift[1] * math.sin(azimuth)
    return complex(found * np.exp(-2j * math.pi * frequency * along))


def round_overlap(residual: Residual, frequency: float, azimuth: float) -> float:
    """Return the modulus of the transfer function of a polar wave without obscuration.

    ``frequency`` is at least 0, cycles per m. One set of nodes covers the whole overlap, so that
    this is faster than `transfer`.
    """
    wave = residual.wavefront
    if wave.wavelength * abs(wave.image_distance) * frequency >= 2 * wave.pupil_radius:
        return 0.0
    v = 2 * residual.wavenumber * residual.rays.slope * wave.pupil_radius
    place = frequency * np.array([[math.cos(azimuth), math.sin(azimuth)]])
    phase, weight = overlap_nodes(residual, place, math.ceil(0.6 * v) + 32)
    return abs(complex(np.sum(weight * np.exp(1j * phase))))


def overlap_nodes(residual: Residual, frequencies: Array, n: int) -> tuple[Array, Array]:
    """Return phase differences and weights at nodes of the overlaps of two shifted round pupils.

    At each frequency ``sum(weight * exp(1j * phase))`` is the transfer function without the image
    shift that is due to the wave's tilt.

    Parameters
    ----------
    residual : Residual
        Polar wave without obscuration.
    frequencies : ndarray, (m, 2)
        Cycles per m in the image along x and y, below the cutoff.
    n : int
        Gauss-Legendre nodes along the shift, and as many across.

    Returns
    -------
    phase, weight : ndarray, (m, n, n)
        Phase difference, rad, and area times both amplitudes over the energy of the pupil.
    """
    wave = residual.wavefront
    a = wave.pupil_radius
    step = wave.wavelength * wave.image_distance * frequencies[:, :, None, None]
    shift = np.hypot(step[:, 0], step[:, 1])
    azimuth = np.arctan2(step[:, 1], step[:, 0])
    series, amplitude = residual.polar_series
    fraction, share = gauss_legendre(n)
    # Across: y = a sin t; along: half width a cos t - shift/2. Both are smooth up to the tips.
    widest = np.arccos(shift / (2 * a))
    t = widest * (2 * fraction[:, None] - 1)
    half = a * np.cos(t) - shift / 2
    along, across = half * (2 * fraction - 1), a * np.sin(t)
    weight = 2 * widest * share[:, None] * a * np.cos(t) * 2 * half * share
    c, s = np.cos(azimuth), np.sin(azimuth)
    sides = np.stack([along - shift / 2, along + shift / 2])
    u, v = c * sides - s * across, s * sides + c * across
    path, size = values_at(series, amplitude, u, v, 1e-13)
    phase = residual.wavenumber * (path[0] - path[1])
    if size is None:
        return phase, weight / (math.pi * a**2)
    return phase, weight * size[0] * size[1] / float(np.sum(wave.amplitude**2 * wave.weights))


class _Part(NamedTuple):
    """Part of the overlap between two curves, each with its shift; the cells of both pupils."""

    low: float
    high: float
    left: tuple[Curve, float]
    right: tuple[Curve, float]
    cells: tuple[int, int]


def _strips(pieces: list[_Piece], shift: float, least: float) -> Iterable[_Part]:
    """Yield the parts of the overlap, strip by strip across the shift, m."""
    levels = np.unique([end for piece in pieces for end in (piece.low, piece.high)])
    for bottom, top in zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True):
        if top - bottom <= least:
            continue
        middle = (bottom + top) / 2
        held = [piece for piece in pieces if piece.low < middle < piece.high]
        cuts = [bottom, *sorted(_crossings(held, shift, bottom, top)), top]
        for low, high in itertools.pairwise(cuts):
            if high - low > least:
                yield from _parts(held, shift, low, high, least)


def _crossings(held: list[_Piece], shift: float, bottom: float, top: float) -> list[float]:
    """Return the levels at which curves of both shifted pupils cross in a strip."""
    angle = math.pi * np.linspace(0.0, 1.0, LOOKS)
    level = (bottom + top) / 2 - (top - bottom) / 2 * np.cos(angle)
    places = np.array([abscissa(piece.curve, level) for piece in held])
    found: list[float] = []
    for i, one in enumerate(held):
        gaps = places[i] + shift - places
        signs = np.sign(gaps)
        for j, k in np.argwhere(signs[:, :-1] != signs[:, 1:]).tolist():
            other, low, high = held[j], float(level[k]), float(level[k + 1])
            first, last = float(gaps[j, k]), float(gaps[j, k + 1])
            if first * last == 0 or not (one.curve.is_arc or other.curve.is_arc):
                found.append(low + (high - low) * first / (first - last))
                continue
            for _ in range(HALVINGS):
                middle = np.array([(low + high) / 2])
                gap = abscissa(one.curve, middle) + shift - abscissa(other.curve, middle)
                if float(gap[0]) * first > 0:
                    low = float(middle[0])
                else:
                    high = float(middle[0])
            found.append((low + high) / 2)
    return found


def _parts(
    held: list[_Piece], shift: float, low: float, high: float, least: float
) -> Iterable[_Part]:
    """Yield the parts of the overlap in a strip where the order of all curves is fixed."""
    middle = np.array([(low + high) / 2])
    places = np.array([float(abscissa(piece.curve, middle)[0]) for piece in held])
    order = np.argsort(places)
    # Cells do not overlap, so that curves of one cell follow each other in pairs.
    spans: list[tuple[int, int]] = []
    opened: dict[int, int] = {}
    for k in order.tolist():
        start = opened.pop(held[k].cell, None)
        if start is None:
            opened[held[k].cell] = k
        else:
            spans.append((start, k))
    for a, b in spans:
        for c, d in spans:
            left = (a, shift / 2) if places[a] + shift > places[c] else (c, -shift / 2)
            right = (b, shift / 2) if places[b] + shift < places[d] else (d, -shift / 2)
            if places[right[0]] + right[1] - places[left[0]] - left[1] > least:
                sides = tuple((held[k].curve, by) for k, by in (left, right))
                yield _Part(low, high, sides[0], sides[1], (held[a].cell, held[c].cell))


def _summed(
    residual: Residual,
    parts: list[_Part],
    shift: float,
    azimuth: float,
    steep: float,
    more: int,
) -> complex:
    """Return the overlap of the parts, relative to that without shift.

    ``steep`` is the largest slope of the phase difference, rad/m; ``more`` nodes are added to
    those that it needs.
    """
    gathered: list[Array] = []
    for part in parts:
        n = math.ceil(0.4 * steep * (part.high - part.low)) + more
        fraction, share = gauss_legendre(n)
        middle, half = (part.low + part.high) / 2, (part.high - part.low) / 2
        place, bend = 2 * fraction - 1, np.full(n, 2.0)
        if part.left[0].is_arc or part.right[0].is_arc:
            # with a sine of the level, roots at both ends of an arc become smooth
            turn = math.pi * (fraction - 0.5)
            place, bend = np.sin(turn), math.pi * np.cos(turn)
        level = middle + half * place
        left, right = (abscissa(curve, level) + by for curve, by in (part.left, part.right))
        wide = right - left
        m = math.ceil(0.25 * steep * float(wide.max())) + more
        inner, weight = gauss_legendre(m)
        along = left[:, None] + wide[:, None] * inner
        area = (half * bend * share * wide)[:, None] * weight
        across = np.broadcast_to(level[:, None], along.shape)
        owners = (np.full(along.size, float(cell)) for cell in part.cells)
        gathered.append(np.stack([along.ravel(), across.ravel(), area.ravel(), *owners]))
    if not gathered:
        return 0.0j
    fits_memory(
        "the overlap of two pupils",
        300.0 * sum(nodes.shape[1] for nodes in gathered),
        "use psf.point_spread and its transfer function",
    )
    along, across, area, *owners_of = np.concatenate(gathered, axis=1)
    c, s = math.cos(azimuth), math.sin(azimuth)
    product = area.astype(np.complex128)
    for owner, by in zip(owners_of, (-shift / 2, shift / 2), strict=True):
        u, v = c * (along + by) - s * across, s * (along + by) + c * across
        for cell in np.unique(owner):
            mine = owner == cell
            pupil = _pupil(residual, int(cell), u[mine], v[mine])
            product[mine] *= pupil if by == -shift / 2 else np.conj(pupil)
    return complex(np.sum(product)) / _energy(residual)


def _energy(residual: Residual) -> float:
    """Return the integral of the squared amplitude, m^2."""
    wave = residual.wavefront
    if residual.is_uniform:
        return float(wave.amplitude.flat[0] ** 2 * wave.weights.sum())
    shape = (*wave.u.shape[:-2], *(2 * n for n in wave.u.shape[-2:]))
    amplitude = residual.amplitude_series.at_nodes(*shape)
    return float(np.sum(amplitude**2 * wave.nodes(*shape)[2]))


def _pupil(residual: Residual, cell: int, u: Array, v: Array) -> ComplexArray:
    """Return A exp(ikW) without tilt at points (n,) of one cell, m."""
    flat = not residual.aberration.any()
    amplitude = np.full(u.shape, residual.wavefront.amplitude.flat[0])
    if flat and residual.is_uniform:
        return amplitude.astype(np.complex128)
    wanted = [] if flat else [residual.series]
    if not residual.is_uniform:
        wanted.append(residual.amplitude_series)
    values = series_at(wanted, cell, u, v)
    if not residual.is_uniform:
        amplitude = values.pop()
    return amplitude * (1.0 if flat else np.exp(1j * residual.wavenumber * values[0]))


def series_at(
    many: list[PolarSpectrum | CellSpectrum], cell: int, u: Array, v: Array
) -> list[Array]:
    """Return the values of series at points (n,) of one cell of their pupil, m."""
    first = many[0]
    if isinstance(first, PolarSpectrum):
        return [one.at(u, v, 1e-13) for one in many if isinstance(one, PolarSpectrum)]
    values = [np.full(u.shape, np.nan) for _ in many]
    patches = np.flatnonzero(first.aperture.owners == cell)
    pairs = first.aperture.cells[cell].sides
    left = np.arange(u.size)
    for patch, (a, b) in zip(patches.tolist(), pairs, strict=True):
        inside, s, t = _located(a, b, np.stack([u[left], v[left]], axis=1))
        for out, one in zip(values, many, strict=True):
            table = one.coefficients[patch]
            along_s, along_t = (legendre(n, x) for n, x in zip(table.shape, (s, t), strict=True))
            half = np.einsum("km,kn->mn", table, along_s)
            out[left[inside]] = np.einsum("mn,mn->n", half, along_t)
        left = left[~inside]
    if left.size:
        raise SamplingError(
            f"{left.size} points of cell {cell} lie in none of its patches, the first at u = "
            f"{u[left[0]]:.4g} m, v = {v[left[0]]:.4g} m; give sides whose lines do not cross"
        )
    return values


def _located(a: Curve, b: Curve, points: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return which points (n, 2) lie in the patch between two sides, and their s and t.

    A point lies on the line between the sides' points at t where ``(p - A) x (B - A) = 0``.
    """

    def turn(t: Array, at: Array) -> tuple[Array, Array, Array]:
        """Cross product at t (n,) for points (n, 2), and both vectors."""
        base = a.at(t)
        side, away = b.at(t) - base, at - base
        return cross(away, side), away, side

    n, s, t = len(points), np.full(len(points), np.nan), np.full(len(points), np.nan)
    # between straight sides the product is a parabola in t
    steps = np.linspace(0.0, 1.0, LOOKS // 2 + 1 if a.is_arc or b.is_arc else 2)
    heights = [turn(np.full(n, level), points)[0] for level in steps.tolist()]
    for k, (below, above) in enumerate(itertools.pairwise(heights)):
        tried = np.flatnonzero(np.isnan(s) & (below * above <= 0))
        if not tried.size:
            continue
        at, first, last = points[tried], below[tried], above[tried]
        span = np.where(first == last, 1.0, first - last)
        place = steps[k] + (steps[k + 1] - steps[k]) * first / span
        for _ in range(NEWTON):
            height, away, side = turn(place, at)
            slope = cross(away, b.rate(place) - a.rate(place)) - cross(a.rate(place), side)
            step = height / np.where(slope == 0, 1.0, slope)
            place = np.clip(place - step, steps[k], steps[k + 1])
        _, away, side = turn(place, at)
        share = np.sum(away * side, axis=1) / np.maximum(np.sum(side**2, axis=1), 1e-300)
        good = (share > -1e-9) & (share < 1 + 1e-9)
        s[tried[good]], t[tried[good]] = share[good], place[good]
    found = ~np.isnan(s)
    return found, s[found], t[found]
