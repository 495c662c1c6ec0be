"""Curves that bound a pupil: points, areas, grid crossings and point-in-outline tests."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._nouns import Noun
from ..._vectors import Array
from .quadrature_nodes import gauss_legendre

#: Longest arc after `Curve.parts`, rad: a few Gauss-Legendre nodes integrate it to rounding error.
LONGEST = math.pi / 2 * (1 + 1e-12)


@dataclass(frozen=True, eq=False)
class Curve(Noun):
    """Line segment, elliptic arc or point; leading dimensions hold several curves.

    Points are ``base + step t + cosine cos(a) + sine sin(a)`` with ``a = phase + turn t``,
    0 <= t <= 1.
    """

    base: Array  # Start of a segment or centre of an arc, (..., 2), m
    step: Array  # Vector from start to end of a segment, (..., 2), m; 0 for an arc
    # Half axes of an arc, (..., 2), m; 0 for a segment.
    cosine: Array
    sine: Array
    # Start angle and signed angular length of an arc, (...), rad; 0 for a segment.
    phase: Array
    turn: Array

    @classmethod
    def line(cls, start: ArrayLike, end: ArrayLike) -> Curve:
        """Return the line segment from one point to another."""
        a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        zero = np.zeros_like(a)
        return cls(a, b - a, zero, zero, zero[..., 0], zero[..., 0])

    @classmethod
    def point(cls, place: ArrayLike) -> Curve:
        """Return a point as a curve of length 0."""
        return cls.line(place, place)

    @classmethod
    def arc(
        cls, centre: ArrayLike, cosine: ArrayLike, sine: ArrayLike, low: float, high: float
    ) -> Curve:
        """Return the elliptic arc of given centre and half axes ``cosine`` and ``sine``.

        Points are ``centre + cosine cos(a) + sine sin(a)``, with the angle a from ``low`` to
        ``high``, rad.
        """
        base, c, s = (np.asarray(a, dtype=np.float64) for a in (centre, cosine, sine))
        return cls(base, np.zeros(2), c, s, np.asarray(low), np.asarray(high - low))

    @classmethod
    def circle(cls, centre: ArrayLike, radius: float, low: float, high: float) -> Curve:
        """Return a circular arc from angle ``low`` to angle ``high``, rad."""
        return cls.arc(centre, (radius, 0.0), (0.0, radius), low, high)

    @classmethod
    def stack(cls, curves: Sequence[Curve]) -> Curve:
        """Return single curves as one curve with a leading dimension."""
        names = ("base", "step", "cosine", "sine", "phase", "turn")
        return cls(*(np.stack([np.asarray(getattr(c, n)) for c in curves]) for n in names))

    @property
    def is_arc(self) -> bool:
        """Whether a single curve is an arc."""
        return bool(self.turn != 0)

    def at(self, t: ArrayLike) -> Array:
        """Return the points at parameters t, (..., len(t), 2), m."""
        t = np.asarray(t, dtype=np.float64)[:, None]
        if not (self.cosine.any() or self.sine.any()):
            return np.asarray(self.base[..., None, :] + self.step[..., None, :] * t)
        angle = self.phase[..., None, None] + self.turn[..., None, None] * t
        bent = self.cosine[..., None, :] * np.cos(angle) + self.sine[..., None, :] * np.sin(angle)
        return np.asarray(self.base[..., None, :] + self.step[..., None, :] * t + bent)

    def rate(self, t: ArrayLike) -> Array:
        """Return the derivatives with respect to t, (..., len(t), 2), m."""
        t = np.asarray(t, dtype=np.float64)[:, None]
        turn = self.turn[..., None, None]
        if not (self.cosine.any() or self.sine.any()):
            return np.asarray(self.step[..., None, :] + np.zeros_like(t))
        angle = self.phase[..., None, None] + turn * t
        bent = self.sine[..., None, :] * np.cos(angle) - self.cosine[..., None, :] * np.sin(angle)
        return np.asarray(self.step[..., None, :] + turn * bent)

    def part(self, low: float, high: float) -> Curve:
        """Return the part from t = low to t = high, reversed if low > high."""
        return Curve(
            self.base + self.step * low,
            self.step * (high - low),
            self.cosine,
            self.sine,
            self.phase + self.turn * low,
            self.turn * (high - low),
        )

    def parts(self) -> list[Curve]:
        """Return a single curve in pieces of equal angle, each at most `LONGEST`."""
        count = max(1, math.ceil(abs(float(self.turn)) / LONGEST))
        return [self.part(i / count, (i + 1) / count) for i in range(count)]

    def scaled(self, factor: float, about: ArrayLike) -> Curve:
        """Return the curve scaled about a point."""
        centre = np.asarray(about, dtype=np.float64)
        return Curve(
            centre + (self.base - centre) * factor,
            self.step * factor,
            self.cosine * factor,
            self.sine * factor,
            self.phase,
            self.turn,
        )

    def moved(self, by: ArrayLike) -> Curve:
        """Return the curve shifted by a vector, m."""
        step = np.asarray(by, dtype=np.float64)
        return Curve(self.base + step, self.step, self.cosine, self.sine, self.phase, self.turn)

    def meets(self, level: float | Array, axis: int) -> Array:
        """Return all t in (0, 1), unsorted, where a coordinate of a single curve is ``level``."""
        level = np.asarray(level, dtype=np.float64)
        base, step = float(self.base[axis]), float(self.step[axis])
        if not self.is_arc:
            t = (level - base) / step if step != 0 else np.empty(0)
        else:
            size = math.hypot(self.cosine[axis], self.sine[axis])
            if size == 0:
                return np.empty(0)
            top = math.atan2(self.sine[axis], self.cosine[axis])
            ratio = (level - base) / size
            side = np.arccos(ratio[np.abs(ratio) <= 1])
            return self._turned_by(np.concatenate([top + side, top - side]) - float(self.phase))
        return np.asarray(t[(t > 0) & (t < 1)])

    def turning_points(self, axis: int) -> Array:
        """Return all t in (0, 1) at which a coordinate of a single arc has an extremum."""
        top = math.atan2(self.sine[axis], self.cosine[axis]) - float(self.phase)
        return self._turned_by(top + np.array([0.0, math.pi]))

    def _turned_by(self, angles: Array) -> Array:
        """Return the t in (0, 1) at angles, rad, from the start of a single arc."""
        turn = float(self.turn)
        t = np.mod(angles * math.copysign(1.0, turn), 2 * math.pi) / abs(turn)
        return np.asarray(t[(t > 0) & (t < 1)])


def cross(a: Array, b: Array) -> Array:
    """Cross product ``a_x b_y - a_y b_x`` of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def moments(outline: Iterable[Curve]) -> tuple[float, float, float]:
    """Area, m^2, and first moments in u and v, m^3, inside closed curves.

    Counterclockwise loops count positive, clockwise loops (holes) negative.
    """
    pieces = Curve.stack(list(outline))
    t, w = gauss_legendre(20)
    p, d = pieces.at(t), pieces.rate(t)
    about = p.reshape(-1, 2).mean(axis=0)  # a nearby origin keeps cancellation small
    p = p - about
    swept = cross(p, d) * w
    area = float(np.sum(swept)) / 2
    x, y = (float(np.sum(swept * p[..., i])) / 3 + area * about[i] for i in (0, 1))
    return area, x, y


def lengths(pieces: Curve) -> Array:
    """Length of each of n stacked curves, (n,), m."""
    t, w = gauss_legendre(32)
    return np.asarray(np.sum(np.hypot(*np.moveaxis(pieces.rate(t), -1, 0)) * w, axis=-1))


def box(pieces: Iterable[Curve]) -> tuple[Array, Array]:
    """Lower and upper corner of the bounding box of curves, (2,) each, m."""
    points = []
    for piece in pieces:
        points.append(piece.at([0.0, 1.0]))
        if piece.is_arc:
            points += [piece.at(piece.turning_points(axis)) for axis in (0, 1)]
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def shares(outline: Iterable[Curve], x: Array, y: Array, pitch: float) -> Array:
    """Fraction of each grid square inside closed curves, (ny, nx).

    Squares have the side ``pitch`` and are centred at ``x`` (nx,) and ``y`` (ny,), m. By Green's
    theorem, each curve is cut where it passes from square to square. A piece that rises by dy
    removes its strip of height dy from everything to its right: the area to its right in its own
    square, and the full width in the squares further right. Falling pieces add it again.
    """
    ny, nx = len(y), len(x)
    own, passed = np.zeros(ny * nx), np.zeros(ny * (nx + 1))
    nodes, weights = gauss_legendre(8)
    corner = np.array([x[0] - pitch / 2, y[0] - pitch / 2])
    for curve in outline:
        piece = curve.moved(-corner).scaled(1 / pitch, (0.0, 0.0))
        low, high = box([piece])
        cuts = [np.array([0.0, 1.0])]
        for axis in (0, 1):
            lines = np.arange(math.floor(low[axis]), math.ceil(high[axis]) + 1, dtype=np.float64)
            cuts.append(piece.meets(lines, axis))
        t = np.unique(np.concatenate(cuts))
        step = np.diff(t)
        at = (t[:-1, None] + step[:, None] * nodes).ravel()
        place = piece.at(at).reshape(len(step), -1, 2)
        rise = piece.rate(at)[:, 1].reshape(len(step), -1) * weights * step[:, None]
        column, row = np.floor(piece.at(t[:-1] + step / 2)).astype(np.int64).T
        seen = (row >= 0) & (row < ny) & (column < nx)
        column, row, place, rise = column[seen], row[seen], place[seen], rise[seen]
        total = rise.sum(axis=1)
        right = np.sum((column[:, None] + 1 - place[..., 0]) * rise, axis=1)
        inside = column >= 0
        np.add.at(own, (row * nx + column)[inside], -right[inside])
        np.add.at(passed, row * (nx + 1) + np.maximum(column + 1, 0), -total)
    cover = np.cumsum(passed.reshape(ny, nx + 1), axis=1)[:, :nx]
    found = own.reshape(ny, nx) + cover
    # The contributions of many curves cancel only to rounding error in empty squares.
    return np.where(found < 1e-12, 0.0, np.minimum(found, 1.0))


def within(outline: Sequence[Curve], u: Array, v: Array) -> NDArray[np.bool_]:
    """Whether points lie inside closed curves: an odd number of curves lies to their right."""
    inside = np.zeros(np.broadcast(u, v).shape, dtype=bool)
    for curve in outline:
        for piece in monotone_parts(curve):
            y0, y1 = piece.at([0.0, 1.0])[:, 1]
            passes = (y0 <= v) != (y1 <= v)
            if not np.any(passes):
                continue
            inside ^= passes & (abscissa(piece, v) > u)
    return inside


def monotone_parts(curve: Curve) -> list[Curve]:
    """Pieces of a single curve along which v only rises or only falls."""
    if not curve.is_arc:
        return [curve]
    t = np.concatenate([[0.0], np.sort(curve.turning_points(1)), [1.0]])
    return [curve.part(a, b) for a, b in zip(t[:-1].tolist(), t[1:].tolist(), strict=True)]


def abscissa(piece: Curve, v: Array) -> Array:
    """Coordinate u at which a piece that is monotone in v reaches v."""
    if not piece.is_arc:
        return np.asarray(piece.base[0] + (v - piece.base[1]) / piece.step[1] * piece.step[0])
    size = math.hypot(piece.cosine[1], piece.sine[1])
    top = math.atan2(piece.sine[1], piece.cosine[1])
    # Index of the half turn between two extrema of v that contains the piece.
    half = math.floor((float(piece.phase) + float(piece.turn) / 2 - top) / math.pi)
    ratio = np.clip((v - piece.base[1]) / size * (-1) ** (half % 2), -1.0, 1.0)
    angle = top + half * math.pi + np.arccos(ratio)
    return np.asarray(
        piece.base[0] + piece.cosine[0] * np.cos(angle) + piece.sine[0] * np.sin(angle)
    )
