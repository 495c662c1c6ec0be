"""Pupil outlines: ellipses, polygons, segmented mirrors, intersecting discs, vanes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, in_range, positive, real, whole
from ..._nouns import Noun
from ..._vectors import Array
from ...errors import SceneError
from . import shapes as parts
from .cells import Cell, polygon_cell, ring_cell
from .curves import Curve, box, cross, lengths, shares, within
from .polygons import convex_polygon, simple_polygon
from .quadrature_nodes import fitting_pitch, gauss_legendre

Bools = NDArray[np.bool_]
Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Aperture(Noun):
    """Outline of a pupil of any shape, made of straight lines and elliptic arcs.

    A pupil consists of one or more cells. A cell is a connected part of the pupil, such as a ring,
    a sector between two vanes or a mirror segment. Build an aperture with `ellipse`, `round`,
    `polygon`, `regular`, `hexagons`, `discs` or `union`. Coordinates are (u, v) in the exit pupil,
    m, with the optical axis at (0, 0). Values out of range raise `SceneError`, and nodes that do
    not fit into memory `MemoryLimitError`.

    Parameters
    ----------
    cells : tuple of Cell
        Connected parts of the pupil; they must not overlap. The methods named above make them.

    See Also
    --------
    Wavefront.from_function : Sample a wave on an aperture.

    Notes
    -----
    Integrals over the pupil are sums over patches, into which every cell is divided. A patch is the
    area between two opposite curves A(t) and B(t). Its points are ``(1 - s) A(t) + s B(t)``, with s
    and t from 0 to 1. One of the curves may be a single point, such as the centre of a circular
    sector. `nodes` returns Gauss-Legendre nodes in s and t, whose weights contain the Jacobian of
    this map. The integral of a function that is smooth over each cell converges exponentially with
    the number of nodes. With straight curves and n nodes along each of s and t it is exact for
    polynomials in u and v up to the degree 2 n - 2.

    Examples
    --------
    A mirror of 36 hexagonal segments without the central one:

    >>> from nlosoptics import psf
    >>> pupil = psf.Aperture.hexagons(3, flat_to_flat=1.8e-3, gap=5e-6, central=False)
    >>> len(pupil.cells)
    36
    >>> print(f"{1e6 * pupil.area:.2f} mm^2")
    101.01 mm^2
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
        """Return an elliptic pupil, with or without a similar hole in its middle.

        Parameters
        ----------
        a, b : float
            Half axes (half of the two diameters), m.
        angle : float
            Angle from the u axis to the half axis a, rad, positive toward v.
        obscuration : float
            Size of the hole: its half axes divided by those of the ellipse, 0 to 0.99. Default 0,
            no hole.
        centre : (float, float)
            Centre (u, v) of the ellipse, m.
        """
        axes = parts.ellipse_axes(a, b, angle)
        inner = in_range("obscuration", obscuration, 0.0, 0.99)
        middle = parts.place("centre", centre)
        outer = Curve.arc(middle, axes[0], axes[1], 0.0, 2 * math.pi).parts()
        return cls((ring_cell(outer, middle, inner),))

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
        """Return a disc or ring centred on the axis, optionally crossed by straight vanes.

        Vanes are the arms that hold a secondary mirror; no light passes them.

        Parameters
        ----------
        radius : float
            Outer radius, m.
        obscuration : float
            Inner radius as a fraction of the outer, 0 to 0.99.
        vanes : int
            Number of straight arms from the centre to the rim, at equal angles.
        vane_width : float
            Width of each arm, m.
        angle : float
            Angle from the u axis to the first vane, rad, positive toward v.

        Returns
        -------
        Aperture
            One cell without vanes; otherwise one cell for each sector between two vanes.

        Examples
        --------
        >>> from nlosoptics import psf
        >>> pupil = psf.Aperture.round(0.01, 0.3, vanes=3, vane_width=5e-4)
        >>> len(pupil.cells)
        3
        >>> print(f"{1e6 * pupil.area:.1f} mm^2")
        275.4 mm^2
        """
        real("angle", angle)
        if whole("vanes", vanes, 0) == 0:
            if real("vane_width", vane_width) != 0:
                raise SceneError(f"vane_width = {vane_width:g} m with vanes = 0; set vanes as well")
            return cls.ellipse(radius, radius, obscuration=obscuration)
        positive("radius", radius, unit="m")
        in_range("obscuration", obscuration, 0.0, 0.99)
        cells = parts.sectors(radius, obscuration, vanes, vane_width, angle)
        return cls(tuple(Cell(tuple(outline), tuple(sides)) for outline, sides in cells))

    @classmethod
    def polygon(cls, vertices: ArrayLike, *, obscuration: float = 0.0) -> Aperture:
        """Return a polygonal pupil, convex or not, whose sides do not cross each other.

        Parameters
        ----------
        vertices : array_like, (n, 2)
            Corners (u, v), m, in clockwise or counterclockwise order.
        obscuration : float
            Size of a hole: its side lengths divided by those of the polygon, 0 to 0.99. The hole
            has the shape of the polygon and the same centroid, from which every side of the
            polygon must be visible. Default 0, no hole.

        Raises
        ------
        SceneError
            If the polygon crosses itself, has no area or has fewer than 3 corners, or if it has a
            hole and one of its sides is not visible from the centroid.
        """
        return cls((polygon_cell(simple_polygon(vertices), obscuration),))

    @classmethod
    def regular(
        cls, sides: int, radius: float, angle: float = 0.0, *, obscuration: float = 0.0
    ) -> Aperture:
        """Return a regular polygon centred on the axis.

        Parameters
        ----------
        sides : int
            Number of sides, 3 or more.
        radius : float
            Radius of the circle through the corners, m.
        angle : float
            Angle from the u axis to one of the corners, rad, positive toward v.
        obscuration : float
            Size of a central hole of the same shape, 0 to 0.99 of the polygon.
        """
        whole("sides", sides, 3)
        positive("radius", radius, unit="m")
        turn = real("angle", angle) + 2 * math.pi * np.arange(sides) / sides
        corners = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return cls.polygon(corners, obscuration=obscuration)

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
        """Return a segmented mirror of equal hexagons.

        Parameters
        ----------
        rings : int
            Number of rings of segments around the central one; 3 rings make 37 segments.
        flat_to_flat : float
            Width of a segment between opposite sides, m.
        gap : float
            Distance between the sides of neighbouring segments, m.
        angle : float
            Angle from the u axis to one corner of each segment, rad, positive toward v.
        central : bool
            Whether the central segment is part of the pupil.

        Notes
        -----
        Cells are ordered ring by ring from the centre outward. Each ring runs counterclockwise
        from the segment at ``angle + pi/6``.
        """
        whole("rings", rings, 0)
        width = positive("flat_to_flat", flat_to_flat, unit="m")
        pitch = width + in_range("gap", gap, 0.0, unit="m")
        if rings == 0 and not central:
            raise SceneError("rings = 0 with central = False leaves no segment; give more rings")
        turn = real("angle", angle) + math.pi / 3 * np.arange(6)
        corners = width / math.sqrt(3) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        centres = parts.hexagon_centres(rings, pitch, float(turn[0]) + math.pi / 6)
        return cls(
            tuple(polygon_cell(corners + middle, 0.0) for middle in centres[0 if central else 1 :])
        )

    @classmethod
    def discs(
        cls, discs: Iterable[tuple[Point, float]], *, within: ArrayLike | None = None
    ) -> Aperture:
        """Return the intersection of discs, for example a beam vignetted by a lens barrel.

        Parameters
        ----------
        discs : iterable of ((float, float), float)
            Centre (u, v) and radius of each disc, m.
        within : array_like, (n, 2), optional
            Corners (u, v), m, of a convex polygon that limits the pupil as well. Default: no such
            polygon.

        Returns
        -------
        Aperture
            One cell: the points that lie in all discs and in the polygon.

        Raises
        ------
        SceneError
            If the discs and the polygon have no area in common, or the polygon is not convex.
        """
        corners = None if within is None else convex_polygon(within, "within")
        outer, middle = parts.common_outline(discs, corners)
        return cls((ring_cell(outer, middle, 0.0),))

    @classmethod
    def union(cls, *apertures: Aperture) -> Aperture:
        """Return one aperture made of several, for example a pupil with separate parts.

        Parameters
        ----------
        *apertures : Aperture
            One or more apertures that do not overlap.

        Raises
        ------
        SceneError
            If two cells overlap, or an argument is not an `Aperture`.
        """
        for a in apertures:
            if not isinstance(a, Aperture):
                raise SceneError(f"union got a {type(a).__name__}; give Aperture objects only")
        if not apertures:
            raise SceneError("union got no apertures; give one or more")
        whole_one = cls(tuple(cell for a in apertures for cell in a.cells))
        whole_one._check_apart()
        return whole_one

    def moved(self, by: Point) -> Aperture:
        """Return the aperture shifted sideways.

        Parameters
        ----------
        by : (float, float)
            Shift along u and v, m.
        """
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
        """Area of the pupil, without its holes, m^2."""
        return math.fsum(cell.area for cell in self.cells)

    @cached_property
    def perimeter(self) -> float:
        """Length of all outer and inner edges of the pupil, m."""
        return float(np.sum(lengths(self.rims)))

    @cached_property
    def rims(self) -> Curve:
        """Edges of the pupil: n straight lines and elliptic arcs, in one `Curve` object.

        ``rims.at(t)`` returns points on each of them, (n, len(t), 2), m, for values t from 0 to 1.
        """
        return Curve.stack([curve for cell in self.cells for curve in cell.outline])

    @cached_property
    def bounding_radius(self) -> float:
        """Radius of the smallest circle centred on the axis that encloses the pupil, m."""
        # The distance along an arc has few maxima: sample densely, then refine by a parabola.
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
        """Largest ``|u|`` or ``|v|`` in the pupil, m."""
        low, high = box([curve for cell in self.cells for curve in cell.outline])
        return float(max(np.abs(low).max(), np.abs(high).max()))

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """Index of the cell (connected part) to which each patch of `patches` belongs, (n,)."""
        return np.repeat(np.arange(len(self.cells)), [len(cell.sides) for cell in self.cells])

    @cached_property
    def patches(self) -> tuple[Curve, Curve]:
        """Patches into which the pupil is divided for integration, given by two opposite curves.

        The two `Curve` objects contain the curves A(t) and B(t) of all n patches, see the Notes of
        `Aperture`. Their method ``at(t)`` returns points (n, len(t), 2), m.
        """
        pairs = [pair for cell in self.cells for pair in cell.sides]
        return Curve.stack([a for a, _ in pairs]), Curve.stack([b for _, b in pairs])

    @cached_property
    def patch_areas(self) -> Array:
        """Area of every patch of `patches`, (n,), m^2."""
        return np.asarray(self.nodes(12, 12)[2].sum(axis=(1, 2)))

    @cached_property
    def patch_size(self) -> tuple[float, float]:
        """Largest width and length of a patch of `patches`, m: across, and along its two curves."""
        a, b = self.patches
        t = np.linspace(0.0, 1.0, 17)
        across = np.hypot(*np.moveaxis(b.at(t) - a.at(t), -1, 0))
        along = [np.hypot(*np.moveaxis(side.rate(t), -1, 0)) for side in (a, b)]
        return float(across.max()), float(max(r.max() for r in along))

    def map(self, s: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return pupil points of every patch, from coordinates within the patch.

        Parameters
        ----------
        s, t : ndarray, (n_s,) and (n_t,)
            Coordinates, 0 to 1: s from one curve of the patch to the other, t along the curves.

        Returns
        -------
        points, along_s, along_t : ndarray, (n_patches, n_s, n_t, 2)
            Points (u, v), m, and their derivatives with respect to s and t, m.
        """
        a, b = self.patches
        low, high = a.at(t)[:, None], b.at(t)[:, None]
        s = s[:, None, None]
        place = low * (1 - s) + high * s
        along_s = np.broadcast_to(high - low, place.shape)
        along_t = a.rate(t)[:, None] * (1 - s) + b.rate(t)[:, None] * s
        return place, along_s, along_t

    def nodes(self, n_s: int, n_t: int) -> tuple[Array, Array, Array]:
        """Return points and weights for integrals over the pupil (Gauss-Legendre quadrature).

        The sum of ``weights * f(u, v)`` is the integral of a function f over the pupil.

        Parameters
        ----------
        n_s, n_t : int
            Number of nodes per patch, along its coordinates s and t. See the Notes of `Aperture`.

        Returns
        -------
        u, v : ndarray
            Coordinates of the nodes, (n_patches, n_s, n_t), m.
        weights : ndarray
            Area that each node represents, (n_patches, n_s, n_t), m^2. The weights sum to the area
            of the pupil.
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
        """Return a square grid over the pupil, with the part of each grid square inside the pupil.

        Parameters
        ----------
        samples : int
            Grid squares per side, n.
        radius : float, optional
            Half side of the area that the grid covers, m, centred on the axis. Default: the largest
            ``|u|`` or ``|v|`` in the pupil (`half_width`).

        Returns
        -------
        u, v : ndarray
            Centres of the squares, (n, n), m: ``(arange(n) - n//2) * pitch`` with the side
            ``pitch`` of a square; v increases from row to row, u along a row.
        weights : ndarray
            Area of the part of each square inside the pupil, (n, n), m^2, accurate to 1e-12 of the
            pupil's area.
        owners : ndarray of int
            Index of the cell of the aperture that covers most of each square, (n, n); 0 where no
            cell covers any of it.
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
        """Return the fraction of each grid square that lies inside the pupil.

        Parameters
        ----------
        samples : int
            Grid squares per side, n.
        pitch : float
            Side of a square, m; square [n//2, n//2] is centred on the axis.

        Returns
        -------
        total : ndarray
            Fraction of each square inside the pupil, (n, n).
        largest : ndarray
            Fraction of each square inside one cell of the aperture: the cell that covers most of
            the square, (n, n).
        owners : ndarray of int
            Index of that cell, (n, n); 0 where no cell covers any of the square.
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
        """Return whether points lie inside the pupil.

        Parameters
        ----------
        u, v : array_like
            Coordinates of the points, m, of any shapes that broadcast.
        """
        x, y = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        inside = np.zeros(np.broadcast(x, y).shape, dtype=bool)
        for cell in self.cells:
            inside |= within(cell.outline, x, y)
        return inside

    def _check_apart(self) -> None:
        """Raise `SceneError` if sample points of one cell's patches lie inside another cell."""
        boxes = [box(cell.outline) for cell in self.cells]
        # Inset, so that cells that merely touch do not overlap.
        inset = np.linspace(1e-9, 1 - 1e-9, 64)
        alone = (Aperture((cell,)) for cell in self.cells)
        points = [part.map(inset, inset)[0].reshape(-1, 2) for part in alone]
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
