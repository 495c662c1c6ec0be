"""Outlines of common pupils: sectors between vanes, hexagon lattices, intersecting discs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from ..._checks import counted, positive, real, shown
from ..._vectors import Array
from ...errors import SceneError
from .curves import Curve
from .polygons import Sides

#: Distance, relative to a radius, within which circles and sides touch rather than cross.
TOUCHING: Final = 1e-12


def place(name: str, value: Any) -> Array:
    """Check a point and return its two finite coordinates, (2,), m."""
    try:
        x, y = value
    except (TypeError, ValueError):
        raise SceneError(f"{name} = {shown(value)} is not a point; give (u, v) in m") from None
    return np.array([real(f"{name}[0]", x), real(f"{name}[1]", y)])


def ellipse_axes(a: float, b: float, angle: float) -> Array:
    """Half-axis vectors of an ellipse, (2, 2), m; the first, of length a, is at ``angle``."""
    positive("a", a, unit="m")
    positive("b", b, unit="m")
    c, s = math.cos(real("angle", angle)), math.sin(angle)
    return np.array([[a * c, a * s], [-b * s, b * c]])


def hexagon_centres(rings: int, pitch: float, angle: float) -> Array:
    """Return the centres of close-packed hexagons, ring by ring from the middle one, (n, 2), m.

    Neighbours are ``pitch`` apart, m. One neighbour of the middle is at ``angle`` from the u axis,
    rad. There are ``1 + 3 rings (rings + 1)`` hexagons.
    """
    turn = angle + math.pi / 3 * np.arange(8)
    step = pitch * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    found = [np.zeros(2)]
    for ring in range(1, rings + 1):
        for k in range(6):
            found += [ring * step[k] + i * step[k + 2] for i in range(ring)]
    return np.array(found)


def sectors(
    radius: float, obscuration: float, vanes: int, width: float, angle: float
) -> list[tuple[list[Curve], list[Sides]]]:
    """Outline and patches of each sector that straight vanes leave of a disc or ring."""
    positive("vane_width", width, unit="m")
    inner, spread = obscuration * radius, 2 * math.pi / vanes
    if obscuration == 0 and vanes == 1:
        raise SceneError(
            "vanes = 1 with obscuration = 0 does not divide the pupil into sectors; give two vanes "
            "or more, or an obscuration"
        )
    # Radius at which the edges of two vanes meet, or half the width of a single vane.
    apex = width / 2 / math.sin(min(spread, math.pi) / 2)
    least = radius if obscuration == 0 else inner
    if apex >= least * (1 - 1e-9):
        raise SceneError(
            f"vane_width = {width:.4g} m: the edges of {counted(vanes, 'vane')} meet "
            f"{apex:.4g} m from the axis, limit {least:.4g} m, the radius of the "
            f"{'pupil' if obscuration == 0 else 'hole'}; use narrower vanes"
        )
    found = []
    for k in range(vanes):
        low, high = angle + k * spread, angle + (k + 1) * spread
        cut = math.asin(width / (2 * radius))
        outer = Curve.circle((0.0, 0.0), radius, low + cut, high - cut)
        if obscuration == 0:
            middle = (low + high) / 2
            within = Curve.point((apex * math.cos(middle), apex * math.sin(middle)))
        else:
            cut = math.asin(width / (2 * inner))
            within = Curve.circle((0.0, 0.0), inner, low + cut, high - cut)
        found.append(_between(within, outer))
    return found


def _between(inner: Curve, outer: Curve) -> tuple[list[Curve], list[Sides]]:
    """Return outline and patches between an inner arc or point and an outer arc.

    Straight lines connect the ends of both arcs.
    """
    outers = outer.parts()
    count = len(outers)
    inners = [inner.part(i / count, (i + 1) / count) for i in range(count)]
    a, b = inner.at([0.0, 1.0]), outer.at([0.0, 1.0])
    outline = [Curve.line(a[0], b[0]), *outers, Curve.line(b[1], a[1])]
    if inner.is_arc:
        outline += [c.part(1.0, 0.0) for c in reversed(inners)]
    return outline, list(zip(inners, outers, strict=True))


def common_outline(
    discs: Iterable[tuple[Any, Any]], corners: Array | None = None
) -> tuple[list[Curve], Array]:
    """Counterclockwise outline of the intersection of discs, and a point well inside it.

    ``corners`` (n, 2), m, counterclockwise, add a convex polygon to the intersection.
    """
    centres, radii = _checked_discs(discs)
    pieces = [
        Curve.circle(centres[i], float(radii[i]), low, high)
        for i in range(len(radii))
        for low, high in _free_arcs(i, centres, radii, corners)
    ]
    whole = len(pieces) == 1 and abs(float(pieces[0].turn)) > 6
    if corners is not None:
        pieces += _free_sides(corners, centres, radii)
    if not pieces:
        raise SceneError(
            "the discs and sides given have no area in common; move their centres closer together"
        )
    middle = pieces[0].base if whole else _middle(pieces)
    order = np.argsort([math.atan2(*(p.at([0.5])[0] - middle)[::-1]) for p in pieces])
    return [part for k in order for part in pieces[int(k)].parts()], np.asarray(middle)


def _middle(pieces: Sequence[Curve]) -> Array:
    """Mean of the ends and midpoints of a convex outline's pieces; it lies inside."""
    return np.asarray(np.mean([p.at([0.0, 0.5, 1.0]) for p in pieces], axis=(0, 1)))


def _free_sides(corners: Array, centres: Array, radii: Array) -> list[Curve]:
    """Parts of a convex polygon's sides that lie inside all discs."""
    found = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        low, high = 0.0, 1.0
        step = b - a
        for c, r in zip(centres, radii, strict=True):
            # Solve |a + t step - c| = r for t.
            square, half, rest = step @ step, (a - c) @ step, (a - c) @ (a - c) - r * r
            root = half * half - square * rest
            if root <= 2 * TOUCHING * square * r * r:  # the line misses or touches the disc
                high = -1.0
                break
            low = max(low, (-half - math.sqrt(root)) / square)
            high = min(high, (-half + math.sqrt(root)) / square)
        if high - low > TOUCHING:
            found.append(Curve.line(a + low * step, a + high * step))
    return found


def _checked_discs(discs: Iterable[tuple[Any, Any]]) -> tuple[Array, Array]:
    """Check discs and return the centres (n, 2) and radii (n,) of distinct ones, m."""
    try:
        pairs = [(centre, radius) for centre, radius in discs]
    except (TypeError, ValueError):
        raise SceneError("discs are not pairs; give [((u, v), radius), ...] in m") from None
    if not pairs:
        raise SceneError("discs = []; give at least one ((u, v), radius) in m")
    kept: list[tuple[Array, float]] = []
    for k, (centre, radius) in enumerate(pairs):
        c = place(f"discs[{k}] centre", centre)
        r = positive(f"discs[{k}] radius", radius, unit="m")
        # A repeated disc does not change the intersection.
        if not any(np.hypot(*(c - o)) + abs(r - s) <= TOUCHING * r for o, s in kept):
            kept.append((c, r))
    return np.stack([c for c, _ in kept]), np.array([r for _, r in kept])


def _free_arcs(
    i: int, centres: Array, radii: Array, corners: Array | None
) -> list[tuple[float, float]]:
    """Arcs of circle i, as (start, end) angles, inside all other discs and the polygon."""
    cuts: list[float] = []
    for j in range(len(radii)):
        step = centres[j] - centres[i]
        apart = float(np.hypot(*step))
        if apart + radii[i] <= radii[j] * (1 + TOUCHING):
            continue  # disc j contains the whole circle i, or is the same
        if not abs(radii[i] - radii[j]) < apart < radii[i] + radii[j]:
            return []  # disc j lies inside circle i, or the two are disjoint
        cosine = (apart**2 + radii[i] ** 2 - radii[j] ** 2) / (2 * apart * radii[i])
        half, middle = math.acos(min(1.0, max(-1.0, cosine))), math.atan2(step[1], step[0])
        cuts += [middle - half, middle + half]
    sides: list[tuple[Array, Array]] = []
    if corners is not None:
        sides = list(zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True))
    for corner, along in sides:
        inward = np.array([-along[1], along[0]]) / math.hypot(*along)
        depth = float((centres[i] - corner) @ inward) / radii[i]
        if depth <= TOUCHING - 1:
            return []  # the side's line separates the circle from the polygon
        if depth < 1 - TOUCHING:
            half, middle = math.acos(-depth), math.atan2(inward[1], inward[0])
            cuts += [middle - half, middle + half]
    cuts = sorted({c % (2 * math.pi) for c in cuts}) or [0.0]
    found: list[tuple[float, float]] = []
    for low, high in zip(cuts, [*cuts[1:], cuts[0] + 2 * math.pi], strict=True):
        middle = (low + high) / 2
        point = centres[i] + radii[i] * np.array([math.cos(middle), math.sin(middle)])
        inside = bool(np.all(np.hypot(*(point - centres).T) <= radii * (1 + TOUCHING)))
        inside &= all(
            a[0] * (point - c)[1] - a[1] * (point - c)[0] >= -TOUCHING * radii[i] * math.hypot(*a)
            for c, a in sides
        )
        if high - low > 1e-9 and inside:
            found.append((low, high))
    return found
