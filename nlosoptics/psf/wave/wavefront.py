"""The wave at the exit pupil, sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, one_of, positive, real, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
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
from .sampling import Nodes, PupilFunction, PupilNodes, nodes_of, sampled, segment_terms, values_on
from .zernikes import ORDERINGS, Ordering, kept_zernikes, zernike_order, zernike_sum

Array = NDArray[np.float64]
Layout = Literal["polar", "cells", "grid", "scattered"]
LAYOUTS = ("polar", "cells", "grid", "scattered")


@dataclass(frozen=True, kw_only=True)
class Removed:
    """Terms taken out of an aberration before it was sampled.

    Parameters
    ----------
    piston : float
        m.
    tilt : (float, float)
        Slopes dW/du and dW/dv; they shift the image by ``tilt * image_distance``.
    defocus : float
        Coefficient of (u^2 + v^2)/2, 1/m: a longitudinal shift of focus.
    """

    piston: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    defocus: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Wavefront(Noun, Shown):
    """Samples of the wave in the exit pupil.

    Parameters
    ----------
    u, v : ndarray
        Pupil coordinates, m, parallel to the image's x and y. Polar: (n_r, n_theta), radii at
        Gauss-Legendre nodes of r^2, angles 2 pi j/n_theta. Cells: (n_patches, n_s, n_t), see
        `Aperture.nodes`. Grid: (n, n), rows are v, ``(arange(n) - n//2) * pitch``. Scattered: (n,).
    aberration : ndarray
        W, m, positive where the wave has gone a longer path than the reference.
    amplitude : ndarray
        Relative, 1 for the unobstructed clear pupil.
    weights : ndarray
        Pupil area that each node stands for, m^2; edge cells of a grid count with the part that
        lies inside.
    wavelength : float
        m.
    image_distance : float
        From pupil to image, m; negative when the pupil lies behind the image.
    pupil_radius : float
        What the F-number and the flux refer to, m.
    obscuration : float
        Inner radius of an annular pupil as a fraction of the outer.
    layout : {"polar", "cells", "grid", "scattered"}
    removed : Removed
        What ``aberration`` no longer holds.
    aperture : Aperture, optional
        Outline of the pupil, where it is not a disc or ring: that of ``cells``, or what the
        weights of a grid follow.

    Notes
    -----
    Arrays are copied, float64 and read-only.
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
        hint = "give metres in vacuum"
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
                put(self, name, _owned(name, getattr(self, name), self.layout))
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
                    f"wavefront.{name} = {values[where]:g} at {where} is below 0; a change of sign "
                    "is half a wave of aberration"
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
            "light": f"{1e9 * self.wavelength:.4g} nm, {100 * self.flux:.4g} % of a clear disc's",
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
        """Sample a sum of Zernike polynomials on a clear pupil, round unless an aperture is given.

        Parameters
        ----------
        coefficients : mapping of int to float
            Index to coefficient, m. For Noll and OSA it is the rms over the full disc; for Fringe
            the value at the rim. An obscured pupil keeps the polynomials of the full disc.
        wavelength, pupil_radius, image_distance : float
            m. The polynomials' unit disc has the pupil radius, whatever the aperture.
        ordering : {"noll", "osa", "fringe"}
        nodes : {"polar", "cells", "grid"}, optional
            Polar nodes, or those of an aperture's cells, are exact and few, and the default; a
            grid is what the Fourier transforms take.
        samples : int or (int, int), optional
            Polar: radii, with four times as many angles, or (radii, angles); default at least
            24 x 96. Cells: nodes per patch along s and t; 12 x 12 by default, and more
            where the wave needs them. Grid: cells per side, default 512.
        obscuration : float
            Inner radius as a fraction of the outer.
        aperture : Aperture, optional
            Outline of the pupil, m.

        Returns
        -------
        Wavefront
        """
        one_of("ordering", ordering, ORDERINGS)
        nodes = nodes_of(nodes, aperture, obscuration, samples)
        positive("pupil_radius", pupil_radius, unit="m")
        if aperture is not None:
            return cls.from_function(
                lambda u, v: zernike_sum(coefficients, u, v, pupil_radius, ordering),
                wavelength=wavelength,
                image_distance=image_distance,
                pupil_radius=pupil_radius,
                aperture=aperture,
                nodes=nodes,
                samples=samples,
            )
        orders = [zernike_order(index, ordering) for index in coefficients]
        degree = max((n for n, _ in orders), default=0)
        if nodes == "grid":
            if isinstance(samples, tuple):
                raise SceneError(f"samples = {samples}; a grid is square, give one whole number")
            cells = 512 if samples is None else whole("samples", samples, 2)
            u, v, weights = grid_nodes(pupil_radius, cells, obscuration)
        else:
            # Enough that the tail of the spectrum is seen to vanish.
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
                # einsum without BLAS: the same bits for any thread count
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
        """Sample functions of the pupil's coordinates on a pupil of any outline.

        Parameters
        ----------
        aberration : callable, optional
            W(u, v), m, of arrays (n,) of u and v, m; smooth over each cell. Default 0.
        wavelength, image_distance : float
            m.
        pupil_radius : float, optional
            m; default the aperture's bounding radius. Without an aperture, the disc's own.
        aperture : Aperture, optional
            Outline; default a disc or ring.
        amplitude : callable, optional
            A(u, v), relative. Default 1.
        pistons : array_like, (n_cells,), optional
            Path of each of the aperture's cells, m, added to the aberration. A mirror's segment
            that stands back by h adds 2 h.
        tilts : array_like, (n_cells, 2), optional
            Slopes dW/du and dW/dv of each cell about its centroid, added as well.
        nodes : {"polar", "cells", "grid"}, optional
            As of `from_zernike`.
        samples : int or (int, int), optional
            As of `from_zernike`, but by default as many, up to a limit, as the functions need:
            what the nodes lack is in the error estimate of every point spread.
        obscuration : float
            Of a ring.

        Returns
        -------
        Wavefront

        Raises
        ------
        SceneError
            If a function gives no finite number for every node, or an option does not fit.
        """
        layout = nodes_of(nodes, aperture, obscuration, samples)
        if pupil_radius is None:
            if aperture is None:
                raise SceneError("pupil_radius is missing; give it, or an aperture")
            pupil_radius = aperture.bounding_radius
        positive("pupil_radius", pupil_radius, unit="m")
        moved = segment_terms(aperture, pistons, tilts)

        def fill(at: PupilNodes) -> tuple[Array, Array]:
            path = moved(at)
            if aberration is not None:
                path = path + values_on("aberration", aberration, at)
            if amplitude is None:
                return path, np.ones_like(at.u)
            return path, values_on("amplitude", amplitude, at)

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
        """Take a pixel map of the pupil as it is: every sample stands for a whole cell.

        Parameters
        ----------
        aberration : array_like
            (n, n), m, row 0 at the lowest v, sample [n//2, n//2] on the axis.
        amplitude : array_like, optional
            (n, n), relative, 0 outside the pupil; an edge cell may carry the part that is inside.
            Default 1 everywhere: a square pupil.
        wavelength, pupil_pitch, image_distance : float
            m.
        pupil_radius : float, optional
            What the F-number and the flux refer to, m; default the disc that just fits the map.

        Returns
        -------
        Wavefront
        """
        positive("pupil_pitch", pupil_pitch, unit="m")
        surface = _owned("aberration", aberration, "grid")
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
            amplitude=_owned("amplitude", amplitude, "grid"),
            weights=np.full_like(u, float(pupil_pitch) ** 2),
            wavelength=wavelength,
            image_distance=image_distance,
            pupil_radius=pupil_radius,
            layout="grid",
        )

    @property
    def f_number(self) -> float:
        """Paraxial working F-number, |image_distance|/(2 pupil_radius)."""
        return abs(self.image_distance) / (2 * self.pupil_radius)

    @property
    def pupil_pitch(self) -> float:
        """Spacing of a grid's samples, m."""
        if self.layout != "grid":
            raise SamplingError(
                f"a {self.layout} wavefront has no pupil pitch; sample it on a grid"
            )
        # beside the axis, where u is 0 and the difference keeps all digits
        axis = self.u.shape[1] // 2
        return float(self.u[0, axis] - self.u[0, axis - 1])

    @property
    def flux(self) -> float:
        """Light through the pupil over that of a clear disc of ``pupil_radius``."""
        disc = np.pi * self.pupil_radius**2
        return float(np.sum(self.amplitude**2 * self.weights) / disc)

    @cached_property
    def is_uniform(self) -> bool:
        """Whether the amplitude is the same at every node."""
        return bool((self.amplitude == self.amplitude.flat[0]).all())

    @property
    def is_spectral(self) -> bool:
        """Whether the nodes hold a series, so that more of them can be had: polar and cells."""
        return self.layout in ("polar", "cells")

    def nodes(self, *counts: int) -> tuple[Array, Array, Array]:
        """Places and areas of as many nodes of the same pupil; polar and cells.

        Parameters
        ----------
        *counts : int
            Shape: (n_r, n_theta) of a polar wavefront, (n_patches, n_s, n_t) of cells.

        Returns
        -------
        u, v, weights : ndarray
        """
        self._require_spectral("have more nodes")
        if self.aperture is not None:
            return self.aperture.nodes(*counts[1:])
        n_r, n_theta = counts
        return polar_nodes(self.pupil_radius, n_r, n_theta, self.obscuration)

    def series(self, values: Array) -> PolarSpectrum | CellSpectrum:
        """Series of a function given on the nodes; polar and cells."""
        self._require_spectral("have a series")
        if self.aperture is not None:
            return CellSpectrum(values, self.aperture)
        return PolarSpectrum(values, self.pupil_radius, self.obscuration)

    def resampled(self, *counts: int) -> Wavefront:
        """The same wave on more nodes, by its series; polar and cells.

        Parameters
        ----------
        *counts : int
            n_r, n_theta of a polar wavefront, n_s, n_t of each patch of cells; none below the
            present one.

        Returns
        -------
        Wavefront
        """
        self._require_spectral("be resampled")
        old = self.u.shape[-2:]
        new = tuple(whole("count", n) for n in counts)
        if len(new) != 2 or any(n < o for n, o in zip(new, old, strict=True)):
            given = " x ".join(map(str, new))
            raise SamplingError(
                f"{given} {self.layout} nodes are fewer than the present {old[0]} x {old[1]}; "
                "resampling only refines"
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
        """What the nodes may miss of the aberration, m, and of the amplitude; polar and cells.

        By the highest terms of the series, about an eighth of them each way: their sum on polar
        nodes, four times their rms on cells.
        """
        return (
            self.series(self.aberration).truncation(),
            self.series(self.amplitude).truncation(),
        )

    def _require_spectral(self, what: str) -> None:
        if not self.is_spectral:
            raise SamplingError(
                f"only a polar wavefront, or one of cells, can {what}, this one is {self.layout}; "
                "sample it with nodes='polar' or 'cells'"
            )

    def _kept(self) -> dict[str, Array]:
        """Nodes and even amplitude that polar waves of this shape share and need not be checked."""
        known = self.layout == "polar" and isinstance(self.u, np.ndarray) and self.u.ndim == 2
        if not known or not 0 < self.u.size <= KEPT:
            return {}
        shape = self.u.shape
        u, v, weights = kept_polar_nodes(self.pupil_radius, *shape, self.obscuration)
        return {"u": u, "v": v, "amplitude": kept_even(*shape), "weights": weights}

    def _check_aperture(self) -> None:
        if self.aperture is None and self.layout == "cells":
            raise SceneError("wavefront.aperture is missing, whose cells hold the nodes; give it")
        if self.aperture is not None and self.layout not in ("cells", "grid"):
            raise SceneError(
                f"wavefront.aperture with layout '{self.layout}', which does not follow it; use "
                "'cells' or 'grid'"
            )
        if self.aperture is not None and self.obscuration != 0:
            raise SceneError(
                f"wavefront.obscuration = {self.obscuration:g} beside an aperture; give it to the "
                "aperture"
            )

    def _check_nodes(self) -> None:
        """Refuse coordinates that are not those of the layout."""
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
                raise SceneError(f"a grid wavefront of shape {self.u.shape}; give a square one")
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
        u, v, _ = aperture.nodes(*self.u.shape[1:])
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


def _owned(name: str, values: Any, layout: Layout) -> Array:
    """Copy to a read-only float64 array of the layout's dimension, all of it finite."""
    try:
        if np.iscomplexobj(values):  # numpy would drop the imaginary part with a mere warning
            raise TypeError
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        told = f"wavefront.{name} is not an array of real numbers"
        raise SceneError(f"{told}; give such, and a phase as aberration") from None
    dimension = {"scattered": 1, "cells": 3}.get(layout, 2)
    if array.ndim != dimension or array.size == 0:
        raise SceneError(
            f"wavefront.{name} has shape {array.shape}; layout '{layout}' needs {dimension} "
            "dimensions"
        )
    if name == "aberration" and layout == "grid" and array.shape[0] != array.shape[1]:
        raise SceneError(f"wavefront.{name} has shape {array.shape}; a grid is square")
    finite = np.isfinite(array)
    if not finite.all():
        where = tuple(int(i) for i in np.unravel_index(np.argmin(finite), array.shape))
        raise SceneError(
            f"wavefront.{name} = {array[where]} at {where}; give finite numbers, and amplitude 0 "
            "where there is no light"
        )
    array.setflags(write=False)
    return array
