"""Simple polygons: checks, and their division into patches with straight sides."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from ..._vectors import Array
from ...errors import SceneError
from .curves import Curve, cross

#: Opposite sides of a patch, at s = 0 and at s = 1; the first may be a point.
Sides = tuple[Curve, Curve]

#: Largest number of corners of a polygon.
MOST_CORNERS: Final = 1000
#: Least sine of a patch's corner angle; sharper patches are avoided by another division.
SHARP: Final = 0.05


def simple_polygon(vertices: ArrayLike, what: str = "vertices") -> Array:
    """Check a polygon's corners and return them in counterclockwise order, (n, 2), m."""
    try:
        corners = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{what} are not numbers; give corners (n, 2) in m") from None
    if corners.ndim != 2 or corners.shape[1] != 2 or not 3 <= len(corners) <= MOST_CORNERS:
        raise SceneError(
            f"{what} have shape {corners.shape}; give 3 to {MOST_CORNERS} corners, (n, 2) in m"
        )
    if not np.isfinite(corners).all():
        worst = int(np.argmin(np.isfinite(corners).all(axis=1)))
        raise SceneError(f"{what}[{worst}] = {corners[worst].tolist()} m; give finite corners")
    after = np.roll(corners, -1, axis=0)
    size = float(np.ptp(corners, axis=0).max())
    short = np.hypot(*(after - corners).T) <= 1e-12 * size
    if size == 0 or short.any():
        worst = int(np.argmax(short))
        raise SceneError(
            f"{what}[{worst}] = {corners[worst].tolist()} m is repeated; remove the duplicate"
        )
    far = corners[int(np.argmax(np.hypot(*(corners - corners[0]).T)))] - corners[0]
    if np.abs(cross(far, corners - corners[0])).max() <= 1e-12 * size**2:
        raise SceneError(f"{what} lie on a line and enclose no area; move a corner off it")
    pair = _crossing(corners, after)
    if pair is not None:
        raise SceneError(
            f"{what}: the sides that start at corners {pair[0]} and {pair[1]} meet; give the "
            "corners in order, of a polygon that does not cross itself"
        )
    area = float(np.sum(cross(corners - corners[0], after - corners[0]))) / 2
    return corners if area > 0 else corners[::-1].copy()


def convex_polygon(vertices: ArrayLike, what: str = "vertices") -> Array:
    """Check a convex polygon's corners and return them in counterclockwise order, (n, 2), m.

    Raises `SceneError` as `simple_polygon`, and if a corner is turned inward.
    """
    corners = simple_polygon(vertices, what)
    along = np.roll(corners, -1, axis=0) - corners
    turn = cross(np.roll(along, 1, axis=0), along)
    if turn.min() < -1e-12 * np.ptp(corners, axis=0).max() ** 2:
        # Report coordinates: the index may have changed when the order was reversed.
        worst = corners[int(np.argmin(turn))].tolist()
        raise SceneError(f"{what}: the corner {worst} m is turned inward; give a convex polygon")
    return corners


def _crossing(a: Array, b: Array) -> tuple[int, int] | None:
    """Find two sides, from corners a to corners b (n, 2), that meet other than at a shared corner.

    Returns the indices of their first corners, or None if the polygon is simple.
    """
    n = len(a)
    along = b - a
    # Signed distance, times length, of each corner from each side's line, (n, n).
    first = cross(along[:, None], a[None] - a[:, None])
    second = np.roll(first, -1, axis=1)
    # Corners within rounding error of a line count as on it.
    slack = 1e-12 * np.hypot(*along.T)[:, None] * np.ptp(a, axis=0).max()
    first, second = (np.where(np.abs(d) <= slack, 0.0, d) for d in (first, second))
    apart = np.sign(first) * np.sign(second) > 0
    meets = ~apart & ~apart.T
    both = (first == 0) & (second == 0)
    if np.any(both):
        # Collinear sides meet if their intervals along the line overlap.
        square = np.sum(along**2, axis=1)[:, None]
        p = np.sum((a[None] - a[:, None]) * along[:, None], axis=2) / square
        q = np.roll(p, -1, axis=1)
        beside = (np.minimum(p, q) > 1 - 1e-12) | (np.maximum(p, q) < 1e-12)
        meets &= ~(both & beside)
    index = np.arange(n)
    meets[index, index] = False
    following = (index + 1) % n
    # Neighbours share a corner; they overlap only if they are collinear and fold back.
    meets[index, following] = meets[following, index] = False
    back = (np.abs(cross(along, along[following])) <= slack[:, 0]) & (
        np.sum(along * along[following], axis=1) < 0
    )
    meets[index, following] |= back
    if not meets.any():
        return None
    i, j = np.unravel_index(int(np.argmax(meets)), meets.shape)
    return int(i), int(j)


def straight_sides(corners: Array, centre: Array) -> list[Sides]:
    """Divide a simple counterclockwise polygon into patches with straight sides.

    A triangle or a convex quadrangle is one patch. Otherwise, if every side is visible from
    ``centre``, the patches form a fan about it: quadrangles of two neighbouring triangles if all of
    them are convex, else triangles. If some side is not visible, ears are cut off.
    """
    n = len(corners)
    if n == 4 and _is_quadrangle(*corners):
        a, b, c, d = corners
        return [(Curve.line(a, d), Curve.line(b, c))]
    if n == 3:
        return [(Curve.point(corners[0]), Curve.line(corners[1], corners[2]))]
    after = np.roll(corners, -1, axis=0)
    if sees_all(corners, centre):
        if n % 2 == 0:
            quads = [
                (centre, corners[i], corners[i + 1], corners[(i + 2) % n]) for i in range(0, n, 2)
            ]
            if all(_is_quadrangle(*q) for q in quads):
                return [(Curve.line(a, d), Curve.line(b, c)) for a, b, c, d in quads]
        return [
            (Curve.point(centre), Curve.line(a, b)) for a, b in zip(corners, after, strict=True)
        ]
    return [(Curve.point(a), Curve.line(b, c)) for a, b, c in _ears(corners)]


def sees_all(corners: Array, centre: Array, least: float = SHARP) -> bool:
    """Whether every side of a counterclockwise polygon is visible from a point inside.

    ``least`` is the least distance of a side's line, relative to that of the farthest corner.
    """
    from_here = corners - centre
    after = np.roll(from_here, -1, axis=0)
    swept = cross(from_here, after)
    side = np.hypot(*(after - from_here).T)
    far = float(np.hypot(*from_here.T).max())
    return bool(np.all(swept > least * far * side))


def _is_quadrangle(*corners: Array) -> bool:
    """Whether four corners in order form a convex quadrangle without nearly flat corners."""
    q = np.stack(corners)
    along = np.roll(q, -1, axis=0) - q
    length = np.hypot(*along.T)
    turn = cross(along, np.roll(along, -1, axis=0)) / (length * np.roll(length, -1))
    return bool(np.all(turn > SHARP))


def _ears(corners: Array) -> list[tuple[Array, Array, Array]]:
    """Divide a simple polygon into triangles by cutting off ears, the best shaped first."""
    left = [c for c in corners]
    found = []
    while len(left) > 3:
        q = np.stack(left)
        before, after = np.roll(q, 1, axis=0), np.roll(q, -1, axis=0)
        swept = cross(q - before, after - q)
        size = sum(
            np.sum((p - r) ** 2, axis=1) for p, r in ((q, before), (after, q), (before, after))
        )
        for i in np.argsort(-swept / size, kind="stable"):
            if not _holds_none(q, before[i], q[i], after[i]):
                continue
            if swept[i] > 0:
                found.append((before[i], q[i], after[i]))
            left.pop(int(i))
            break
        else:  # every simple polygon has an ear, but rounding can hide it
            raise SceneError(
                "vertices cannot be divided into triangles to rounding accuracy; remove corners "
                "that nearly coincide"
            )
    found.append((left[0], left[1], left[2]))
    return found


def _holds_none(q: Array, a: Array, b: Array, c: Array) -> bool:
    """Whether a triangle is counterclockwise, with no other corner in it or on its boundary."""
    swept = cross(b - a, c - a)
    scale = 1e-12 * float(np.ptp(q, axis=0).max()) ** 2
    if swept < -scale:
        return False
    own = np.zeros(len(q), dtype=bool)
    for p in (a, b, c):
        own |= np.all(q == p, axis=1)
    in_it = (
        (cross(b - a, q - a) >= -scale)
        & (cross(c - b, q - b) >= -scale)
        & (cross(a - c, q - c) >= -scale)
    )
    if swept <= scale:  # the corner is collinear with its neighbours
        return True
    return not bool(np.any(in_it & ~own))
