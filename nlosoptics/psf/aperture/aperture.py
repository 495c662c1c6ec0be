"""Pupils of any outline: ellipses, polygons, segments, cut discs, vanes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, in_range, positive, real, whole
from ..._nouns import Noun
from ...errors import SceneError
from . import shapes as parts
from .curves import Curve, box, cross, lengths, moments, shares, within
from .polygons import Sides, convex_polygon, sees_all, simple_polygon, straight_sides
from .quadrature_nodes import fitting_pitch, gauss_legendre

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Point = tuple[float, float]

#: Of the farthest corner's distance, how far each side's line at least passes by the middle of a
#: similar hole; nearer, rounding alone would tell the sides of it apart.
SEEN: Final = 1e-9
#: Share of a patch's size by which its rim is drawn in where cells are tested for overlap.
TOUCH: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Cell(Noun):
    """Connected part of a pupil, over which a wave is smooth.

    Parameters
    ----------
    outline : tuple of Curve
        Closed curves, the outer counterclockwise and holes clockwise.
    sides : tuple of (Curve, Curve)
        Patches that cover it: the straight lines between points of equal t on two curves.
    """

    outline: tuple[Curve, ...]
    sides: tuple[Sides, ...]
    area: float = field(init=False)
    centroid: Point = field(init=False)

    def __post_init__(self) -> None:
        area, x, y = moments(self.outline)
        object.__setattr__(self, "area", area)
        object.__setattr__(self, "centroid", (x / area, y / area))


@dataclass(frozen=True, eq=False)
class Aperture(Noun):
    """Outline of a pupil: disjoint cells, each of segments and elliptic arcs.

    Made by `ellipse`, `round`, `polygon`, `regular`, `hexagons`, `discs` and `union`. All
    coordinates are (u, v) in the exit pupil, m.

    Parameters
    ----------
    cells : tuple of Cell

    Notes
    -----
    Every cell is covered by patches: the straight lines between points of equal t on two opposite
    sides, ``(1 - s) A(t) + s B(t)``. A side may be a point, as at the middle of a fan. On
    Gauss-Legendre nodes of s and t with the map's Jacobian in the weights, a wave that is smooth
    over a cell is integrated with spectral convergence, and a polynomial exactly on straight sides.
    """

    cells: tuple[Cell, ...]

    @classmethod
    def ellipse(
        cls,
        a: float,
        b: float,
        angle: float = 0.0,
        *,
        obscuration: float = 0.0,
        centre: Point = (0.0, 0.0),
    ) -> Aperture:
        """Ellipse, or the ring between it and a similar one.

        Parameters
        ----------
        a, b : float
            Half axes, m.
        angle : float
            Of the axis a from u toward v, rad.
        obscuration : float
            Size of the inner ellipse as a fraction of the outer.
        centre : (float, float)
            m.
        """
        axes = parts.ellipse_axes(a, b, angle)
        inner = in_range("obscuration", obscuration, 0.0, 0.99)
        middle = parts.place("centre", centre)
        outer = Curve.arc(middle, axes[0], axes[1], 0.0, 2 * math.pi).parts()
        return cls((_ring(outer, middle, inner),))

    @classmethod
    def round(
        cls,
        radius: float,
        obscuration: float = 0.0,
        *,
        vanes: int = 0,
        vane_width: float = 0.0,
        angle: float = 0.0,
    ) -> Aperture:
        """Disc or ring, with vanes that hold the obscuration; a cell between each two of them.

        Parameters
        ----------
        radius : float
            m.
        obscuration : float
            Inner radius as a fraction of the outer.
        vanes : int
            Straight arms from the middle to the rim, at equal angles.
        vane_width : float
            m.
        angle : float
            Of the first vane, rad from u toward v.
        """
        real("angle", angle)
        if whole("vanes", vanes, 0) == 0:
            if real("vane_width", vane_width) != 0:
                raise SceneError(f"vane_width = {vane_width:g} m without vanes; give their number")
            return cls.ellipse(radius, radius, obscuration=obscuration)
        positive("radius", radius, unit="m")
        in_range("obscuration", obscuration, 0.0, 0.99)
        cells = parts.sectors(radius, obscuration, vanes, vane_width, angle)
        return cls(tuple(Cell(tuple(outline), tuple(sides)) for outline, sides in cells))

    @classmethod
    def polygon(cls, vertices: ArrayLike, *, obscuration: float = 0.0) -> Aperture:
        """Any polygon that does not cross itself.

        Parameters
        ----------
        vertices : array_like
            Corners (n, 2), m, in order either way.
        obscuration : float
            Size, as a fraction, of a similar polygon about the centroid that is left out; the
            centroid must see every side.
        """
        return cls((_polygon_cell(simple_polygon(vertices), obscuration),))

    @classmethod
    def regular(
        cls, sides: int, radius: float, angle: float = 0.0, *, obscuration: float = 0.0
    ) -> Aperture:
        """Regular polygon about the axis.

        Parameters
        ----------
        sides : int
        radius : float
            Of the circle through its corners, m.
        angle : float
            Of one corner from u toward v, rad.
        obscuration : float
            Size of a similar polygon that is left out.
        """
        whole("sides", sides, 3)
        positive("radius", radius, unit="m")
        turn = real("angle", angle) + 2 * math.pi * np.arange(sides) / sides
        corners = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return cls((_polygon_cell(simple_polygon(corners), obscuration),))

    @classmethod
    def hexagons(
        cls,
        rings: int,
        flat_to_flat: float,
        gap: float = 0.0,
        *,
        angle: float = 0.0,
        central: bool = True,
    ) -> Aperture:
        """Segmented mirror of equal hexagons.

        Parameters
        ----------
        rings : int
            About the central segment; 3 rings are 37 segments.
        flat_to_flat : float
            Width of a segment between opposite sides, m.
        gap : float
            Between neighbours' sides, m.
        angle : float
            Of one corner of each segment from u toward v, rad.
        central : bool
            Whether there is a central segment.

        Notes
        -----
        Cells go from the centre outward, ring by ring, each ring counterclockwise from the segment
        at ``angle + pi/6``.
        """
        whole("rings", rings, 0)
        width = positive("flat_to_flat", flat_to_flat, unit="m")
        pitch = width + in_range("gap", gap, 0.0, unit="m")
        if rings == 0 and not central:
            raise SceneError("rings = 0 without a central segment leaves none; give more rings")
        turn = real("angle", angle) + math.pi / 3 * np.arange(6)
        corners = width / math.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        centres = parts.hexagon_centres(rings, pitch, float(turn[0]) + math.pi / 6)
        return cls(
            tuple(_polygon_cell(corners + middle, 0.0) for middle in centres[0 if central else 1 :])
        )

    @classmethod
    def discs(
        cls, discs: Iterable[tuple[Point, float]], *, within: ArrayLike | None = None
    ) -> Aperture:
        """What discs have in common, as a lens barrel leaves of an oblique beam.

        Parameters
        ----------
        discs : iterable of ((float, float), float)
            Centre and radius of each, m.
        within : array_like, optional
            Corners (n, 2), m, of a convex polygon that cuts them too.
        """
        corners = None if within is None else convex_polygon(within, "within")
        outer, middle = parts.common_outline(discs, corners)
        return cls((_ring(outer, middle, 0.0),))

    @classmethod
    def union(cls, *apertures: Aperture) -> Aperture:
        """Several apertures side by side.

        Raises
        ------
        SceneError
            If two of their cells overlap.
        """
        for a in apertures:
            if not isinstance(a, Aperture):
                raise SceneError(f"a union of a {type(a).__name__}; give apertures alone")
        if not apertures:
            raise SceneError("a union of no apertures; give one or more")
        whole_one = cls(tuple(cell for a in apertures for cell in a.cells))
        whole_one._check_apart()
        return whole_one

    def moved(self, by: Point) -> Aperture:
        """Shifted by (u, v), m."""
        step = parts.place("by", by)
        return Aperture(
            tuple(
                Cell(
                    tuple(c.moved(step) for c in cell.outline),
                    tuple((a.moved(step), b.moved(step)) for a, b in cell.sides),
                )
                for cell in self.cells
            )
        )

    @cached_property
    def area(self) -> float:
        """m^2."""
        return math.fsum(cell.area for cell in self.cells)

    @cached_property
    def perimeter(self) -> float:
        """Length of all rims, m."""
        return float(np.sum(lengths(self.rims)))

    @cached_property
    def rims(self) -> Curve:
        """Every curve of the outlines, (n,)."""
        return Curve.stack([curve for cell in self.cells for curve in cell.outline])

    @cached_property
    def bounding_radius(self) -> float:
        """Radius of the circle about the axis that holds the pupil, m."""
        # the distance of an arc turns at few places: a dense look, then a parabola's top
        t = np.linspace(0.0, 1.0, 129)
        r = np.hypot(*np.moveaxis(self.rims.at(t), -1, 0))
        left, middle, right = r[:, :-2], r[:, 1:-1], r[:, 2:]
        bend = left - 2 * middle + right
        top = np.where(
            (bend < 0) & (middle >= left) & (middle >= right),
            middle - (left - right) ** 2 / (8 * np.where(bend < 0, bend, -1.0)),
            middle,
        )
        return float(max(r.max(), top.max()))

    @cached_property
    def half_width(self) -> float:
        """Farthest |u| or |v|, m."""
        low, high = box([curve for cell in self.cells for curve in cell.outline])
        return float(max(np.abs(low).max(), np.abs(high).max()))

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """Index of the cell of every patch, (n_patches,)."""
        return np.repeat(np.arange(len(self.cells)), [len(cell.sides) for cell in self.cells])

    @cached_property
    def patches(self) -> tuple[Curve, Curve]:
        """The two sides of all patches, (n_patches,) each."""
        pairs = [pair for cell in self.cells for pair in cell.sides]
        return Curve.stack([a for a, _ in pairs]), Curve.stack([b for _, b in pairs])

    @cached_property
    def patch_areas(self) -> Array:
        """Area of every patch, (n_patches,), m^2."""
        return np.asarray(self.nodes(12, 12)[2].sum(axis=(1, 2)))

    @cached_property
    def patch_size(self) -> tuple[float, float]:
        """Longest lines along s and along t of any patch, m."""
        a, b = self.patches
        t = np.linspace(0.0, 1.0, 17)
        across = np.hypot(*np.moveaxis(b.at(t) - a.at(t), -1, 0))
        along = [np.hypot(*np.moveaxis(side.rate(t), -1, 0)) for side in (a, b)]
        return float(across.max()), float(max(r.max() for r in along))

    def map(self, s: Array, t: Array) -> tuple[Array, Array, Array]:
        """Points of the patches and their derivatives with s and t, (n_patches, n_s, n_t, 2)."""
        a, b = self.patches
        low, high = a.at(t)[:, None], b.at(t)[:, None]
        s = s[:, None, None]
        place = low * (1 - s) + high * s
        along_s = np.broadcast_to(high - low, place.shape)
        along_t = a.rate(t)[:, None] * (1 - s) + b.rate(t)[:, None] * s
        return place, along_s, along_t

    def nodes(self, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
        """Gauss-Legendre nodes of every patch.

        Parameters
        ----------
        n_s, n_t : int
            Along s and t.

        Returns
        -------
        u, v, weights : ndarray
            (n_patches, n_s, n_t); m, m and m^2. The weights sum to the area.
        """
        n = len(self.owners)
        whole("n_s", n_s)
        whole("n_t", n_t)
        fits_memory(f"{n} x {n_s} x {n_t} pupil nodes", 200.0 * n * n_s * n_t, "use fewer")
        (s, w_s), (t, w_t) = gauss_legendre(n_s), gauss_legendre(n_t)
        place, along_s, along_t = self.map(s, t)
        weights = cross(along_s, along_t) * (w_s[:, None] * w_t)
        return place[..., 0].copy(), place[..., 1].copy(), weights

    def grid_nodes(
        self, samples: int, radius: float | None = None
    ) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """Square grid over the pupil, each of its squares with its exact area inside.

        Parameters
        ----------
        samples : int
            Squares per side.
        radius : float, optional
            The grid just holds the centred square of this half side, m; default `half_width`.

        Returns
        -------
        u, v, weights : ndarray
            (samples, samples), rows are v; m, m and m^2, to 1e-12 of the pupil's area. Coordinates
            are ``(arange(n) - n//2) * pitch``.
        owners : ndarray of int
            Cell that has the largest part of each square, 0 where none has any.
        """
        n = whole("samples", samples, 2)
        fits_memory(f"a pupil of {n} x {n} samples", 120.0 * n * n, "use fewer")
        half = self.half_width if radius is None else positive("radius", radius, unit="m")
        pitch = fitting_pitch(half, n)
        axis = (np.arange(n, dtype=np.float64) - n // 2) * pitch
        total, _, owners = self.grid_shares(n, pitch)
        v, u = np.meshgrid(axis, axis, indexing="ij")
        return u, v, total * pitch**2, owners

    def grid_shares(self, samples: int, pitch: float) -> tuple[Array, Array, NDArray[np.int64]]:
        """Shares of a grid's squares inside, the largest of one cell, and whose that is.

        Parameters
        ----------
        samples : int
            Squares per side, n.
        pitch : float
            m; square [n//2, n//2] is about the axis.

        Returns
        -------
        total, largest : ndarray
            (n, n).
        owners : ndarray of int
            (n, n), 0 where none has any.
        """
        n = samples
        axis = (np.arange(n, dtype=np.float64) - n // 2) * pitch
        total, most = np.zeros((n, n)), np.zeros((n, n))
        owners = np.zeros((n, n), dtype=np.int64)
        for index, cell in enumerate(self.cells):
            low, high = box(cell.outline)
            first = np.clip(np.floor(low / pitch + 0.5).astype(np.int64) + n // 2, 0, n)
            last = np.clip(np.floor(high / pitch + 0.5).astype(np.int64) + n // 2 + 1, 0, n)
            x, y = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
            if x.stop <= x.start or y.stop <= y.start:
                continue
            part = shares(cell.outline, axis[x], axis[y], pitch)
            total[y, x] += part
            owners[y, x] = np.where(part > most[y, x], index, owners[y, x])
            most[y, x] = np.maximum(most[y, x], part)
        return np.minimum(total, 1.0), most, owners

    def contains(self, u: ArrayLike, v: ArrayLike) -> Bools:
        """Whether points (u, v), m, lie within, of the broadcast shape."""
        x, y = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        inside = np.zeros(np.broadcast(x, y).shape, dtype=bool)
        for cell in self.cells:
            inside |= within(cell.outline, x, y)
        return inside

    def _check_apart(self) -> None:
        """Refuse cells that overlap: points of one's patches that lie within another."""
        boxes = [box(cell.outline) for cell in self.cells]
        points = [parts.drawn_in(cell.sides, TOUCH) for cell in self.cells]
        for i, (low, high) in enumerate(boxes):
            for j, (other_low, other_high) in enumerate(boxes):
                if i == j or np.any(low >= other_high) or np.any(other_low >= high):
                    continue
                inside = within(self.cells[j].outline, points[i][:, 0], points[i][:, 1])
                if inside.any():
                    u, v = points[i][int(np.argmax(inside))]
                    raise SceneError(
                        f"cells {i} and {j} of the aperture overlap at u = {u:.4g} m, v = "
                        f"{v:.4g} m; move them apart"
                    )


def _ring(outer: Sequence[Curve], centre: Array, inner: float) -> Cell:
    """Cell between a convex outline and a similar one about a point within."""
    if inner == 0:
        return Cell(tuple(outer), tuple((Curve.point(centre), c) for c in outer))
    holes = [c.scaled(inner, centre) for c in outer]
    outline = (*outer, *(c.part(1.0, 0.0) for c in holes))
    return Cell(outline, tuple(zip(holes, outer, strict=True)))


def _polygon_cell(corners: Array, obscuration: float) -> Cell:
    outer = [Curve.line(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    area, x, y = moments(outer)
    centre = np.array([x / area, y / area])
    inner = in_range("obscuration", obscuration, 0.0, 0.99)
    if inner > 0:
        if not sees_all(corners, centre, SEEN):
            raise SceneError(
                f"obscuration = {inner:g} of a polygon whose centroid does not see every side; "
                "give two polygons and their union"
            )
        return _ring(outer, centre, inner)
    return Cell(tuple(outer), tuple(straight_sides(corners, centre)))
