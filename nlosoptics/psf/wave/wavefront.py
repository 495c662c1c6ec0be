"""Samples of the wave in the exit pupil."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import in_range, one_of, positive, real, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._vectors import Array
from ..._xarray import Labelled
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import pupil_points
from ..aperture.quadrature_nodes import fitting_pitch
from .cell_series import CellSpectrum, spectrum
from .fits import fitted_terms
from .node_checks import check_aperture, check_nodes, grid_pitch, wave_labels
from .polar_series import PolarSpectrum
from .removed import Removed
from .sampling import (
    Fill,
    Nodes,
    PupilFunction,
    PupilNodes,
    Sampling,
    nodes_of,
    owned,
    polar_counts,
    segment_terms,
    values_on,
    zernike_degree,
    zernike_fill,
)
from .zernikes import ORDERINGS, Ordering

Layout = Literal["polar", "cells", "grid", "scattered"]
LAYOUTS = ("polar", "cells", "grid", "scattered")


@dataclass(frozen=True, eq=False, kw_only=True)
class Wavefront(Noun, Shown, Labelled):
    """Wave in the exit pupil: aberration and amplitude at sample points, with the pupil's geometry.

    Make one from a scene with `wavefront`, or with `from_zernike`, `from_function` or `from_map`.
    Arrays are copied, as read-only float64.

    Parameters
    ----------
    u, v : ndarray
        Pupil coordinates of the sample points, m, parallel to the image's x and y. They are
        distances from the axis on the reference sphere, whose centre is the image point on the axis
        and whose radius is ``|image_distance|``. The shape depends on ``layout``.
    aberration : ndarray
        Wave aberration W, m, in the shape of u: optical path minus that of the reference sphere.
    amplitude : ndarray
        Amplitude in the shape of u, at least 0; 1 for a clear pupil.
    weights : ndarray
        Pupil area that each sample point represents, m^2, in the shape of u. A square of a grid
        that the rim crosses counts with the part inside.
    wavelength : float
        Vacuum wavelength, m.
    image_distance : float
        Distance from the pupil to the image plane, m; negative if the pupil lies beyond the image.
    pupil_radius : float
        Radius of the pupil, m. It defines the F-number and the reference of `flux`.
    obscuration : float
        Inner radius of an annular pupil divided by the outer; 0 for a full disc.
    layout : {"polar", "cells", "grid", "scattered"}
        Arrangement of the sample points, also called nodes, and thereby the shape of the arrays:

        - "polar": rings, (n_r, n_theta), see `polar_nodes`.
        - "cells": patches of an `Aperture`, (n_patches, n_s, n_t), see `Aperture.nodes`.
        - "grid": square grid, (n, n), ``(arange(n) - n//2) * pitch``; v increases from row to row.
        - "scattered": arbitrary points, (n,).
    removed : Removed
        Piston, tilt and defocus that were subtracted from ``aberration``; none by default.
    aperture : Aperture, optional
        Outline of a pupil that is neither disc nor ring, for the layouts "cells" and "grid".

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
    _labels = wave_labels

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
        check_aperture("wavefront.layout", self.layout, self.aperture, self.obscuration)
        for name in ("u", "v", "aberration", "amplitude", "weights"):
            put(self, name, owned(name, getattr(self, name), self.layout))
            if getattr(self, name).shape != self.u.shape:
                raise SceneError(
                    f"wavefront.{name} has shape {getattr(self, name).shape} and u has "
                    f"{self.u.shape}; give one value per node"
                )
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
        check_nodes(self.layout, self.u, self.v, self.pupil_radius, self.obscuration, self.aperture)

    def _figures(self) -> Figures:
        plane, weights = (
            np.stack([np.ones_like(self.u), self.u, self.v]),
            self.amplitude * self.weights,
        )
        fit = fitted_terms(self.aberration, weights, plane)
        rest = self.aberration - np.tensordot(fit, plane, 1)
        rms = math.sqrt(np.sum(weights * rest**2) / np.sum(weights))
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
        """Make a wave of uniform amplitude from Zernike coefficients.

        Parameters
        ----------
        coefficients : mapping of int to float
            Zernike index to coefficient, m. With Noll and OSA indices a coefficient is the rms of
            its term over the full disc; with Fringe indices it is the value at the rim. A pupil
            with a hole keeps the polynomials of the full disc.
        wavelength : float
            Vacuum wavelength, m.
        pupil_radius : float
            Radius of the pupil, m. It defines the F-number and the unit disc of the polynomials.
        image_distance : float
            Distance from the pupil to the image plane, m; negative if the pupil lies beyond the
            image.
        ordering : {"noll", "osa", "fringe"}
            Index scheme of the coefficients, see `zernike_order`.
        nodes : {"polar", "cells", "grid"}, optional
            Arrangement of the sample points, see the ``layout`` of `Wavefront`. Default "polar", or
            "cells" with an aperture: few points suffice for these. Choose "grid" for FFTs.
        samples : int or (int, int), optional
            Number of sample points:

            - "polar": rings, with four times as many points on each; or (rings, points per ring).
              Default (24, 96), or more for polynomials of higher degree.
            - "cells": points along each direction of a patch, or (n_s, n_t). Default 8, or 12 if
              the outline is curved; more if the wave needs them.
            - "grid": squares per side, default 512.
        obscuration : float
            Inner radius of the pupil divided by the outer, 0 to 0.99; 0 for a full disc.
        aperture : Aperture, optional
            Outline of the pupil; by default a disc or ring of the pupil radius.

        Returns
        -------
        Wavefront
            Wave of amplitude 1.

        Raises
        ------
        SceneError
            If an option is out of range, or options contradict one another.
        SamplingError
            If ``samples`` are too few for the degree of the polynomials.

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
        obscuration = real("obscuration", obscuration)
        nodes = nodes_of(nodes, aperture, obscuration, samples)
        pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        if nodes == "polar":
            samples = polar_counts(zernike_degree(coefficients, ordering), samples)
        fill = zernike_fill(coefficients, pupil_radius, ordering, obscuration, aperture)
        sampling = Sampling(nodes, samples, pupil_radius, obscuration, aperture)
        return cls._filled(fill, sampling, wavelength, image_distance)

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
        """Make a wave from functions W(u, v) and A(u, v), on a pupil of any outline.

        Parameters
        ----------
        aberration : callable, optional
            Function of coordinate arrays u and v (n,), m, that returns the aberration W (n,), m,
            smooth over each connected part of the pupil. Default 0.
        wavelength : float
            Vacuum wavelength, m.
        image_distance : float
            Distance from the pupil to the image plane, m; negative if the pupil lies beyond the
            image.
        pupil_radius : float, optional
            Radius of the pupil, m, which defines the F-number. Required without an aperture; by
            default the radius of the circle around the aperture.
        aperture : Aperture, optional
            Outline of the pupil; by default a disc or ring of the pupil radius.
        amplitude : callable, optional
            Function of u and v, like ``aberration``, that returns the relative amplitude A (n,), at
            least 0. Default 1.
        pistons : array_like, (n_cells,), optional
            Path added to each cell of the aperture, m. A mirror segment recessed by h adds 2 h.
            Default 0.
        tilts : array_like, (n_cells, 2), optional
            Slopes dW/du and dW/dv added to each cell of the aperture, rad. The added path is 0 at
            the centroid of the cell. Default 0.
        nodes, samples
            Arrangement and number of the sample points, as in `from_zernike`. By default, "polar"
            and "cells" points are added until they resolve the functions, up to a limit; a grid has
            512 squares per side. Error estimates of PSFs include detail that is not resolved.
        obscuration : float
            Inner radius of the pupil divided by the outer, 0 to 0.99; 0 for a full disc.

        Returns
        -------
        Wavefront
            Wave at the sample points.

        Raises
        ------
        SceneError
            If a function does not return finite real numbers, or options contradict one another.
        """
        obscuration = real("obscuration", obscuration)
        layout = nodes_of(nodes, aperture, obscuration, samples)
        if pupil_radius is None:
            if aperture is None:
                raise SceneError("pupil_radius is missing; give it or an aperture")
            pupil_radius = aperture.bounding_radius
        pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        moved = segment_terms(aperture, pistons, tilts)

        def fill(at: PupilNodes) -> tuple[Array, Array]:
            path = moved(at)
            if aberration is not None:
                path = path + values_on("aberration", aberration, at)
            if amplitude is None:
                return path, np.ones_like(path)
            return path, values_on("amplitude", amplitude, at)

        sampling = Sampling(layout, samples, pupil_radius, obscuration, aperture)
        return cls._filled(fill, sampling, wavelength, image_distance)

    @classmethod
    def _filled(
        cls, fill: Fill, sampling: Sampling, wavelength: float, image_distance: float
    ) -> Wavefront:
        """Return the wave whose aberration and amplitude ``fill`` gives on nodes."""
        wavenumber = 2 * np.pi / positive("wavelength", wavelength, unit="m")
        nodes, path, size = sampling.filled(fill, wavenumber)
        return cls(
            u=nodes.u,
            v=nodes.v,
            aberration=path,
            amplitude=size,
            weights=nodes.weights,
            wavelength=wavelength,
            image_distance=image_distance,
            pupil_radius=sampling.radius,
            obscuration=sampling.obscuration,
            layout=nodes.layout,
            aperture=sampling.outline,
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
        """Make a wave from maps of aberration and amplitude on a square grid of pupil pixels.

        Parameters
        ----------
        aberration : array_like, (n, n)
            Wave aberration W, m, positive for a longer path. Row 0 is at the lowest v, and pixel
            [n//2, n//2] is centred on the axis.
        amplitude : array_like, (n, n), optional
            Relative amplitude, 0 outside the pupil. A pixel on the rim may have the fraction of its
            area inside the pupil. Default 1 everywhere, which is a square pupil.
        wavelength : float
            Vacuum wavelength, m.
        pupil_pitch : float
            Side of a pixel in the pupil, m.
        image_distance : float
            Distance from the pupil to the image plane, m; negative if the pupil lies beyond the
            image.
        pupil_radius : float, optional
            Radius of the pupil, m, which defines the F-number; by default that of the disc that
            just fits the map.

        Returns
        -------
        Wavefront
            Wave with the layout "grid": one node for each pixel, with the pixel's area as weight.

        Raises
        ------
        SceneError
            If a map is not square and finite, or a number is out of range.
        """
        positive("pupil_pitch", pupil_pitch, unit="m")
        surface = owned("aberration", aberration, "grid")
        n = surface.shape[0]
        if surface.shape != (n, n):
            raise SceneError(f"wavefront.aberration has shape {surface.shape}; a grid is square")
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
        """Working F-number: image distance over pupil diameter."""
        return abs(self.image_distance) / (2 * self.pupil_radius)

    @property
    def pupil_pitch(self) -> float:
        """Spacing of the sample points, m; raises `SamplingError` unless the layout is "grid"."""
        if self.layout != "grid":
            raise SamplingError(
                f"a {self.layout} wavefront has no pupil pitch; sample it with nodes='grid'"
            )
        return grid_pitch(self.u)

    @property
    def flux(self) -> float:
        """Energy through the pupil divided by that through a clear disc of the pupil's radius."""
        disc = np.pi * self.pupil_radius**2
        return float(np.sum(self.amplitude**2 * self.weights) / disc)

    @cached_property
    def is_uniform(self) -> bool:
        """Whether the amplitude is the same at every sample point."""
        return bool((self.amplitude == self.amplitude.flat[0]).all())

    @property
    def is_spectral(self) -> bool:
        """Whether the wave can be interpolated to more points: the layout is "polar" or "cells"."""
        return self.layout in ("polar", "cells")

    def nodes(self, *counts: int) -> tuple[Array, Array, Array]:
        """Return points and weights for integrals over the pupil, as many as requested.

        Parameters
        ----------
        *counts : int
            Shape of the result. For the layout "polar" it is (rings, points per ring). For "cells"
            it is (n_patches, n_s, n_t); n_patches must be ``len(wavefront.u)``.

        Returns
        -------
        u, v, weights : ndarray
            Coordinates, m, and areas, m^2, each of the shape ``counts``.

        Raises
        ------
        SamplingError
            If the layout is "grid" or "scattered".
        """
        self._require_spectral("have more nodes")
        return pupil_points(self.pupil_radius, self.obscuration, self.aperture, counts)

    def series(self, values: Array) -> PolarSpectrum | CellSpectrum:
        """Return the polynomial series that interpolates a function known at the sample points.

        Parameters
        ----------
        values : ndarray
            Values at the sample points, such as ``aberration``, in the shape of u.

        Returns
        -------
        PolarSpectrum or CellSpectrum
            Series whose method ``at_nodes(*counts)`` evaluates it at the points of `nodes`.

        Raises
        ------
        SamplingError
            If the layout is "grid" or "scattered".
        """
        self._require_spectral("have a series")
        return spectrum(values, self.pupil_radius, self.obscuration, self.aperture)

    def resampled(self, *counts: int) -> Wavefront:
        """Return the wave interpolated to more sample points.

        Parameters
        ----------
        *counts : int
            Numbers of points, not below the current ones: rings and points per ring for the layout
            "polar"; n_s, n_t of each patch for "cells".

        Returns
        -------
        Wavefront
            Wave of the same layout and pupil.

        Raises
        ------
        SamplingError
            If the layout is "grid" or "scattered", or a number is below the current one.
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
        """Estimate the detail of the wave that its sample points do not resolve.

        Returns
        -------
        aberration : float
            Estimated error of interpolating the aberration between the sample points, m.
        amplitude : float
            Estimated error of interpolating the amplitude.

        Raises
        ------
        SamplingError
            If the layout is "grid" or "scattered".

        Notes
        -----
        The estimate is the sum (layout "polar") or four times the rms (layout "cells") of the
        highest terms of the polynomial series through the samples.
        """
        return self.series(self.aberration).truncation(), self.series(self.amplitude).truncation()

    def _require_spectral(self, what: str) -> None:
        if not self.is_spectral:
            raise SamplingError(
                f"only a wavefront of layout 'polar' or 'cells' can {what}, not "
                f"'{self.layout}'; "
                "sample the wave with nodes='polar' or 'cells'"
            )
