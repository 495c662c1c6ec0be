"""Samples of the wave in the exit pupil."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, one_of, positive, real, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import kept_even_cells, shared_cell_nodes
from ..aperture.quadrature_nodes import (
    KEPT,
    fitting_pitch,
    grid_nodes,
    kept_even,
    kept_polar_nodes,
    polar_nodes,
    shared_polar_nodes,
)
from .cell_series import CellSpectrum
from .fits import fitted_terms
from .polar_series import PolarSpectrum
from .removed import Removed
from .sampling import (
    Fill,
    Nodes,
    PupilFunction,
    PupilNodes,
    even,
    nodes_of,
    owned,
    sampled,
    segment_terms,
    values_on,
    zernike_fill,
)
from .zernikes import ORDERINGS, Ordering, kept_zernikes, zernike_order, zernike_sum

Array = NDArray[np.float64]
Layout = Literal["polar", "cells", "grid", "scattered"]
LAYOUTS = ("polar", "cells", "grid", "scattered")


@dataclass(frozen=True, eq=False, kw_only=True)
class Wavefront(Noun, Shown):
    """Wave in the exit pupil: sampled aberration and amplitude, wavelength and pupil geometry.

    Arrays are copied, float64 and read-only. All have the same shape, which depends on ``layout``.

    Parameters
    ----------
    u, v : ndarray
        Pupil coordinates, m, parallel to the image's x and y: heights on the sphere of radius
        ``|image_distance|`` about the image point. Polar: (n_r, n_theta), see `polar_nodes`. Cells:
        (n_patches, n_s, n_t), see `Aperture.nodes`. Grid: (n, n), rows are v,
        ``(arange(n) - n//2) * pitch``. Scattered: (n,).
    aberration : ndarray
        Aberration W, m, in the shape of u; positive for a path longer than the reference.
    amplitude : ndarray
        Relative amplitude in the shape of u; 1 for a clear pupil.
    weights : ndarray
        Pupil area that each node represents, m^2, in the shape of u. Grid cells at the pupil's
        edge count only with the part inside.
    wavelength : float
        Vacuum wavelength, m.
    image_distance : float
        Signed distance from pupil to image, m; negative if the pupil lies beyond the image.
    pupil_radius : float
        Radius that defines the F-number and the flux, m.
    obscuration : float
        Inner radius of an annular pupil as a fraction of the outer.
    layout : {"polar", "cells", "grid", "scattered"}
        Arrangement of the nodes, that is of the pupil points at which the wave is sampled: rings
        ("polar"), patches of an `Aperture` ("cells"), a square grid ("grid") or arbitrary points
        ("scattered").
    removed : Removed
        Terms that were subtracted from ``aberration``.
    aperture : Aperture, optional
        Outline of a pupil that is neither disc nor ring; layouts "cells" and "grid" follow it.

    See Also
    --------
    wavefront : Wave aberration of a scene.
    point_spread : PSF of a given wave.
    Aperture : Outline of a pupil.
    nlosoptics.views.wavefront : Map of a wave aberration.
    """

    u: Array
    v: Array
    aberration: Array
    amplitude: Array
    weights: Array
    wavelength: float
    image_distance: float
    pupil_radius: float
    obscuration: float = 0.0
    layout: Layout
    removed: Removed = field(default_factory=Removed)
    aperture: Aperture | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        one_of("wavefront.layout", self.layout, LAYOUTS)
        hint = "give metres (vacuum wavelength)"
        in_range("wavefront.wavelength", self.wavelength, 1e-8, 1e-3, unit="m", remedy=hint)
        positive("wavefront.pupil_radius", self.pupil_radius, unit="m")
        in_range("wavefront.obscuration", self.obscuration, 0.0, 0.99)
        if real("wavefront.image_distance", self.image_distance) == 0:
            raise SceneError("wavefront.image_distance = 0 m; the pupil cannot lie in the image")
        for name in ("wavelength", "image_distance", "pupil_radius", "obscuration"):
            put(self, name, float(getattr(self, name)))
        self._check_aperture()
        kept = self._kept()
        for name in ("u", "v", "aberration", "amplitude", "weights"):
            if name not in kept or getattr(self, name) is not kept[name]:
                put(self, name, owned(name, getattr(self, name), self.layout))
            if getattr(self, name).shape != self.u.shape:
                raise SceneError(
                    f"wavefront.{name} has shape {getattr(self, name).shape} and u has "
                    f"{self.u.shape}; give one value per node"
                )
        if kept and all(getattr(self, name) is values for name, values in kept.items()):
            return
        for name in ("amplitude", "weights"):
            values = getattr(self, name)
            if np.any(values < 0):
                where = tuple(int(i) for i in np.unravel_index(np.argmin(values), values.shape))
                raise SceneError(
                    f"wavefront.{name} = {values[where]:g} at {where} is below 0; write a sign "
                    "change of the wave as half a wave of aberration"
                )
        if not np.any(self.amplitude * self.weights > 0):
            raise SceneError("wavefront.amplitude is 0 everywhere; no light passes the pupil")
        self._check_nodes()

    def _figures(self) -> Figures:
        plane = np.stack([np.ones_like(self.u), self.u, self.v])
        rest = self.aberration - np.tensordot(
            fitted_terms(self.aberration, self.amplitude * self.weights, plane), plane, 1
        )
        weights = self.amplitude * self.weights
        rms = float(np.sqrt(np.sum(weights * rest**2) / np.sum(weights)))
        waves = f"{rms / self.wavelength:.3g} waves rms"
        figures = {
            "aberration": f"{waves}, {1e9 * rms:.3g} nm, without tilt",
            "pupil": f"{1e3 * self.pupil_radius:.4g} mm radius, F/{self.f_number:.3g}",
            "light": f"{1e9 * self.wavelength:.4g} nm, {100 * self.flux:.4g} % of a clear disc",
            "nodes": f"{' x '.join(map(str, self.u.shape))}, {self.layout}",
        }
        alt = f"Map of the wave aberration over the pupil, {waves}"
        return Figures("Wavefront", figures, alt)

    @classmethod
    def from_zernike(
        cls,
        coefficients: Mapping[int, float],
        *,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        ordering: Ordering = "noll",
        nodes: Nodes | None = None,
        samples: int | tuple[int, int] | None = None,
        obscuration: float = 0.0,
        aperture: Aperture | None = None,
    ) -> Wavefront:
        """Sample a sum of Zernike polynomials on a pupil of uniform amplitude.

        Parameters
        ----------
        coefficients : mapping of int to float
            Index to coefficient, m: the rms over the full disc for Noll and OSA, the value at the
            rim for Fringe. An obscured pupil keeps the polynomials of the full disc.
        wavelength, pupil_radius, image_distance : float
            As in `Wavefront`, m. The unit disc of the polynomials has the pupil radius.
        ordering : {"noll", "osa", "fringe"}
            Index scheme, see `zernike_order`.
        nodes : {"polar", "cells", "grid"}, optional
            Layout; by default "polar", or "cells" with an aperture: both are exact with few nodes.
            Fourier transforms use "grid".
        samples : int or (int, int), optional
            Polar: radii, with four times as many angles, or (radii, angles); at least 24 x 96 by
            default. Cells: nodes per patch along s and t; by default 8 x 8, 12 x 12 on curved
            outlines, or more if the wave needs them. Grid: cells per side, 512 by default.
        obscuration : float
            Inner radius as a fraction of the outer.
        aperture : Aperture, optional
            Outline of the pupil; a disc or ring by default.

        Returns
        -------
        Wavefront
            Wave of amplitude 1 on the nodes.

        Examples
        --------
        >>> from nlosoptics import psf
        >>> wave = psf.Wavefront.from_zernike(
        ...     {4: 50e-9}, wavelength=632.8e-9, pupil_radius=0.0125, image_distance=1.0
        ... )
        >>> print(wave.layout, wave.f_number, f"{psf.rms_aberration(wave):.2e} m")
        polar 40.0 5.00e-08 m
        """
        one_of("ordering", ordering, ORDERINGS)
        nodes = nodes_of(nodes, aperture, obscuration, samples)
        positive("pupil_radius", pupil_radius, unit="m")
        if aperture is not None:
            fill = zernike_fill(coefficients, pupil_radius, ordering, aperture)
            given = fill, wavelength, image_distance, pupil_radius
            return cls._filled(*given, aperture, nodes, samples, 0.0)
        orders = [zernike_order(index, ordering) for index in coefficients]
        degree = max((n for n, _ in orders), default=0)
        if nodes == "grid":
            if isinstance(samples, tuple):
                raise SceneError(f"samples = {samples}; a grid is square, give one whole number")
            cells = 512 if samples is None else whole("samples", samples, 2)
            u, v, weights = grid_nodes(pupil_radius, cells, obscuration)
        else:
            # Enough nodes to see that the tail of the spectrum vanishes.
            n_r, n_theta = max(24, degree), max(96, 4 * degree)
            if isinstance(samples, tuple):
                n_r, n_theta = samples
            elif samples is not None:
                n_r, n_theta = samples, 4 * samples
            if n_r < degree // 2 + 1 or n_theta < 2 * degree + 1:
                raise SamplingError(
                    f"{n_r} x {n_theta} polar nodes cannot hold Zernike degree {degree}; use "
                    f"{degree // 2 + 1} x {2 * degree + 1} or more"
                )
            u, v, weights = shared_polar_nodes(pupil_radius, n_r, n_theta, obscuration)
        if nodes == "polar" and u.size <= KEPT:
            amplitude, aberration = kept_even(*u.shape), np.zeros(u.shape)
            heights = [real(f"coefficients[{j}]", value) for j, value in coefficients.items()]
            if heights:
                modes = kept_zernikes(tuple(coefficients), ordering, *u.shape, float(obscuration))
                # einsum does not call BLAS, so results are bit-identical for any thread count.
                aberration = np.einsum("m,mrt->rt", np.array(heights), modes)
        else:
            amplitude = np.ones_like(u)
            aberration = zernike_sum(coefficients, u, v, pupil_radius, ordering)
        return cls(
            u=u,
            v=v,
            aberration=aberration,
            amplitude=amplitude,
            weights=weights,
            wavelength=wavelength,
            image_distance=image_distance,
            pupil_radius=pupil_radius,
            obscuration=obscuration,
            layout=nodes,
        )

    @classmethod
    def from_function(
        cls,
        aberration: PupilFunction | None = None,
        *,
        wavelength: float,
        image_distance: float,
        pupil_radius: float | None = None,
        aperture: Aperture | None = None,
        amplitude: PupilFunction | None = None,
        pistons: ArrayLike | None = None,
        tilts: ArrayLike | None = None,
        nodes: Nodes | None = None,
        samples: int | tuple[int, int] | None = None,
        obscuration: float = 0.0,
    ) -> Wavefront:
        """Sample an aberration and an amplitude, functions of u and v, on a pupil of any outline.

        Parameters
        ----------
        aberration : callable, optional
            W(u, v), m, of coordinate arrays (n,), m; smooth over each cell. Default 0.
        wavelength, image_distance : float
            As in `Wavefront`, m.
        pupil_radius : float, optional
            As in `Wavefront`, m; the aperture's bounding radius by default. Required for a disc.
        aperture : Aperture, optional
            Outline of the pupil; a disc or ring by default.
        amplitude : callable, optional
            Relative amplitude A(u, v). Default 1.
        pistons : array_like, (n_cells,), optional
            Path added to each cell of the aperture, m. A mirror segment recessed by h adds 2 h.
        tilts : array_like, (n_cells, 2), optional
            Slopes dW/du and dW/dv added to each cell about its centroid, rad.
        nodes : {"polar", "cells", "grid"}, optional
            Layout, as in `from_zernike`.
        samples : int or (int, int), optional
            As in `from_zernike`. By default, "polar" and "cells" nodes are added until they resolve
            the functions or reach a limit. Error estimates of PSFs include what is unresolved.
        obscuration : float
            Inner radius of a ring as a fraction of the outer.

        Returns
        -------
        Wavefront
            Wave on the nodes of the pupil.

        Raises
        ------
        SceneError
            If a function does not return finite real numbers, or options contradict one another.
        """
        layout = nodes_of(nodes, aperture, obscuration, samples)
        if pupil_radius is None:
            if aperture is None:
                raise SceneError("pupil_radius is missing; give it or an aperture")
            pupil_radius = aperture.bounding_radius
        positive("pupil_radius", pupil_radius, unit="m")
        moved = segment_terms(aperture, pistons, tilts)

        def fill(at: PupilNodes) -> tuple[Array, Array]:
            path = moved(at)
            if aberration is not None:
                path = path + values_on("aberration", aberration, at)
            if amplitude is None:
                return path, even(at)
            return path, values_on("amplitude", amplitude, at)

        given = fill, wavelength, image_distance, pupil_radius
        return cls._filled(*given, aperture, layout, samples, obscuration)

    @classmethod
    def _filled(
        cls,
        fill: Fill,
        wavelength: float,
        image_distance: float,
        pupil_radius: float,
        aperture: Aperture | None,
        layout: Nodes,
        samples: int | tuple[int, int] | None,
        obscuration: float,
    ) -> Wavefront:
        """Return the wave whose aberration and amplitude ``fill`` gives on nodes."""
        found, path, size = sampled(
            layout,
            samples,
            fill,
            wavenumber=2 * np.pi / positive("wavelength", wavelength, unit="m"),
            radius=pupil_radius,
            obscuration=obscuration,
            aperture=aperture,
        )
        return cls(
            u=found.u,
            v=found.v,
            aberration=path,
            amplitude=size,
            weights=found.weights,
            wavelength=wavelength,
            image_distance=image_distance,
            pupil_radius=pupil_radius,
            obscuration=obscuration,
            layout=layout,
            aperture=aperture,
        )

    @classmethod
    def from_map(
        cls,
        aberration: ArrayLike,
        amplitude: ArrayLike | None = None,
        *,
        wavelength: float,
        pupil_pitch: float,
        image_distance: float,
        pupil_radius: float | None = None,
    ) -> Wavefront:
        """Make a grid wavefront from pixel maps of the pupil, each pixel with its full area.

        Parameters
        ----------
        aberration : array_like, (n, n)
            Aberration W, m; row 0 at the lowest v, sample [n//2, n//2] on the axis.
        amplitude : array_like, (n, n), optional
            Relative amplitude, 0 outside the pupil; an edge pixel may carry the fraction inside.
            Default 1 everywhere, which is a square pupil.
        wavelength, pupil_pitch, image_distance : float
            Wavelength, pixel side in the pupil, and distance as in `Wavefront`, m.
        pupil_radius : float, optional
            As in `Wavefront`, m; by default that of the disc that just fits the map.

        Returns
        -------
        Wavefront
            Wave of layout "grid" on the map's pixels.
        """
        positive("pupil_pitch", pupil_pitch, unit="m")
        surface = owned("aberration", aberration, "grid")
        n = surface.shape[0]
        if amplitude is None:
            amplitude = np.ones_like(surface)
        axis = (np.arange(n) - n // 2) * float(pupil_pitch)
        v, u = np.meshgrid(axis, axis, indexing="ij")
        if pupil_radius is None:
            pupil_radius = pupil_pitch / fitting_pitch(1.0, n)
        return cls(
            u=u,
            v=v,
            aberration=surface,
            amplitude=owned("amplitude", amplitude, "grid"),
            weights=np.full_like(u, float(pupil_pitch) ** 2),
            wavelength=wavelength,
            image_distance=image_distance,
            pupil_radius=pupil_radius,
            layout="grid",
        )

    @property
    def f_number(self) -> float:
        """Working F-number, ``|image_distance|/(2 pupil_radius)``."""
        return abs(self.image_distance) / (2 * self.pupil_radius)

    @property
    def pupil_pitch(self) -> float:
        """Spacing of the samples, m, for the layout "grid" only."""
        if self.layout != "grid":
            raise SamplingError(
                f"a {self.layout} wavefront has no pupil pitch; sample it on a grid"
            )
        # Next to the axis, where u is 0, the difference is exact.
        axis = self.u.shape[1] // 2
        return float(self.u[0, axis] - self.u[0, axis - 1])

    @property
    def flux(self) -> float:
        """Energy through the pupil, relative to that through a clear disc of ``pupil_radius``."""
        disc = np.pi * self.pupil_radius**2
        return float(np.sum(self.amplitude**2 * self.weights) / disc)

    @cached_property
    def is_uniform(self) -> bool:
        """Whether the amplitude is the same at every node."""
        return bool((self.amplitude == self.amplitude.flat[0]).all())

    @property
    def is_spectral(self) -> bool:
        """Whether the nodes define a polynomial series, and so can be refined (polar, cells)."""
        return self.layout in ("polar", "cells")

    def nodes(self, *counts: int) -> tuple[Array, Array, Array]:
        """Return a given number of nodes on the same pupil, for the layouts "polar" and "cells".

        Parameters
        ----------
        *counts : int
            Radii and angles n_r, n_theta of a polar wavefront; n_patches, n_s, n_t of cells.

        Returns
        -------
        u, v, weights : ndarray
            Coordinates, m, and areas, m^2, each of the shape ``counts``.
        """
        self._require_spectral("have more nodes")
        if self.aperture is not None:
            n_patches, n_s, n_t = counts
            whole("the number of patches", n_patches, len(self.u), len(self.u))
            return shared_cell_nodes(self.aperture, n_s, n_t)
        return polar_nodes(self.pupil_radius, counts[0], counts[1], self.obscuration)

    def series(self, values: Array) -> PolarSpectrum | CellSpectrum:
        """Return the polynomial series through values at the nodes, for "polar" and "cells"."""
        self._require_spectral("have a series")
        if self.aperture is not None:
            return CellSpectrum(values, self.aperture)
        return PolarSpectrum(values, self.pupil_radius, self.obscuration)

    def resampled(self, *counts: int) -> Wavefront:
        """Return the wave interpolated to more nodes, for the layouts "polar" and "cells".

        Parameters
        ----------
        *counts : int
            n_r, n_theta of a polar wavefront, or n_s, n_t of each patch of cells; at least the
            current numbers.

        Returns
        -------
        Wavefront
            Wave of the same layout and pupil on more nodes.
        """
        self._require_spectral("be resampled")
        old = self.u.shape[-2:]
        new = tuple(whole("count", n) for n in counts)
        if len(new) != 2 or any(n < o for n, o in zip(new, old, strict=True)):
            given = " x ".join(map(str, new))
            raise SamplingError(
                f"{given} {self.layout} nodes are fewer than the present {old[0]} x {old[1]}; "
                "give as many or more"
            )
        shape = (*self.u.shape[:-2], *new)
        u, v, weights = self.nodes(*shape)
        return replace(
            self,
            u=u,
            v=v,
            weights=weights,
            aberration=self.series(self.aberration).at_nodes(*shape),
            amplitude=np.maximum(self.series(self.amplitude).at_nodes(*shape), 0.0),
        )

    def truncation(self) -> tuple[float, float]:
        """Estimate how much of the aberration, m, and of the amplitude the nodes do not resolve.

        Only the layouts "polar" and "cells" have this estimate. It is the sum (polar) or four times
        the rms (cells) of the highest terms of the polynomial series that the nodes define.
        """
        return (
            self.series(self.aberration).truncation(),
            self.series(self.amplitude).truncation(),
        )

    def _require_spectral(self, what: str) -> None:
        if not self.is_spectral:
            raise SamplingError(
                f"only a wavefront of layout 'polar' or 'cells' can {what}, not "
                f"'{self.layout}'; "
                "sample the wave with nodes='polar' or 'cells'"
            )

    def _kept(self) -> dict[str, Array]:
        """Return cached nodes and uniform amplitude of this shape; they need no checks."""
        if not isinstance(self.u, np.ndarray) or not 0 < self.u.size <= KEPT:
            return {}
        shape = self.u.shape
        if self.layout == "cells" and self.aperture is not None and len(shape) == 3:
            u, v, weights = shared_cell_nodes(self.aperture, *shape[1:])
            if len(u) != shape[0]:
                return {}
            return {"u": u, "v": v, "amplitude": kept_even_cells(shape), "weights": weights}
        if self.layout != "polar" or len(shape) != 2:
            return {}
        u, v, weights = kept_polar_nodes(self.pupil_radius, *shape, self.obscuration)
        return {"u": u, "v": v, "amplitude": kept_even(*shape), "weights": weights}

    def _check_aperture(self) -> None:
        if self.aperture is None and self.layout == "cells":
            raise SceneError("wavefront.aperture is missing, layout 'cells' needs it; give it")
        if self.aperture is not None and self.layout not in ("cells", "grid"):
            raise SceneError(
                f"wavefront.layout = '{self.layout}' cannot follow an aperture; use 'cells' or "
                "'grid'"
            )
        if self.aperture is not None and self.obscuration != 0:
            raise SceneError(
                f"wavefront.obscuration = {self.obscuration:g} with an aperture, limit 0; make it "
                "part of the aperture"
            )

    def _check_nodes(self) -> None:
        """Raise `SceneError` if the coordinates are not those of the layout."""
        if self.layout == "scattered":
            return
        if self.layout == "cells" and self.aperture is not None:
            self._check_cells(self.aperture)
            return
        rows, columns = self.u.shape
        if self.layout == "polar":
            make = kept_polar_nodes if self.u.size <= KEPT else polar_nodes
            u, v, _ = make(self.pupil_radius, rows, columns, self.obscuration)
            remedy = "take them from psf.polar_nodes"
        else:
            if rows != columns or rows < 2:
                raise SceneError(f"a grid wavefront has shape {self.u.shape}; give a square grid")
            axis = (np.arange(rows) - rows // 2) * self.pupil_pitch
            v, u = np.meshgrid(axis, axis, indexing="ij")
            remedy = "use (arange(n) - n//2) * pitch, rows along v"
        error = max(float(np.abs(self.u - u).max()), float(np.abs(self.v - v).max()))
        if not error <= 1e-9 * self.pupil_radius:
            raise SceneError(
                f"wavefront.u, v are {error:.3g} m off the nodes of layout '{self.layout}', limit "
                f"{1e-9 * self.pupil_radius:.1g} m; {remedy}"
            )

    def _check_cells(self, aperture: Aperture) -> None:
        u, v, _ = shared_cell_nodes(aperture, *self.u.shape[1:])
        if u.shape != self.u.shape:
            raise SceneError(
                f"wavefront.u has shape {self.u.shape}; the aperture's {len(u)} patches need "
                f"{u.shape}"
            )
        error = max(float(np.abs(self.u - u).max()), float(np.abs(self.v - v).max()))
        limit = 1e-9 * aperture.bounding_radius
        if not error <= limit:
            raise SceneError(
                f"wavefront.u, v are {error:.3g} m off the nodes of layout 'cells', limit "
                f"{limit:.1g} m; take them from aperture.nodes"
            )
