"""Pupil nodes of each layout, and functions of u and v sampled on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import counted, mapping, numbers, one_of, real, whole
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import pupil_points
from ..aperture.quadrature_nodes import KEPT, grid_nodes
from .cell_series import spectrum
from .node_checks import check_aperture
from .zernikes import Ordering, kept_zernikes, zernike_order, zernike_sum

Nodes = Literal["polar", "cells", "grid"]
#: W(u, v), m, or A(u, v), of arrays of u and v, m.
PupilFunction = Callable[[Array, Array], ArrayLike]

#: Nodes per side of a patch, tried in this order until they resolve the wave. The first does not
#: resolve a tilt on an arc of 90 degrees and is left out on curved outlines.
SIDES: Final = (8, 12, 16, 24, 32, 48, 64)
#: Largest total number of nodes that a trial after the first may use.
MOST_NODES: Final = 1_000_000
#: Truncation error of the phase, rad, and of the amplitude, below which trials end.
NEGLIGIBLE: Final = 1e-11


@dataclass(frozen=True, eq=False)
class PupilNodes:
    """Coordinates and areas of pupil nodes.

    Parameters
    ----------
    layout : {"polar", "cells", "grid"}
        Layout of the nodes.
    u, v : ndarray
        Coordinates, m, all of the layout's shape.
    weights : ndarray
        Area of each node, m^2, of the same shape.
    owners : ndarray of int
        Index of the aperture's cell of each node, in a shape that broadcasts to theirs.
    """

    layout: Nodes
    u: Array
    v: Array
    weights: Array
    owners: NDArray[np.int64]


#: Function that gives the aberration, m, and the amplitude on nodes.
Fill = Callable[[PupilNodes], tuple[Array, Array]]


def nodes_of(
    nodes: str | None, aperture: Aperture | None, obscuration: float, samples: Any
) -> Nodes:
    """Return the requested or default layout after checking that it fits the other options.

    Raises
    ------
    SceneError
        If the layout, the aperture, the obscuration and the samples contradict one another.
    """
    if aperture is not None and not isinstance(aperture, Aperture):
        raise SceneError(f"aperture is a {type(aperture).__name__}; give a psf.Aperture")
    if isinstance(samples, tuple) and len(samples) != 2:
        raise SceneError(f"samples = {samples}; give one whole number or two")
    if nodes is None:
        nodes = "polar" if aperture is None else "cells"
    one_of("nodes", nodes, ("polar", "cells", "grid"))
    check_aperture("nodes", nodes, aperture, obscuration)
    if nodes == "grid" and isinstance(samples, tuple):
        raise SceneError(f"samples = {samples}; a grid is square, give one whole number")
    return nodes  # type: ignore[return-value]  # one of its literals


def polar_counts(degree: int, samples: int | tuple[int, int] | None) -> tuple[int, int]:
    """Return the numbers of rings and of points per ring for Zernike polynomials up to a degree.

    Raises `SamplingError` if the requested ``samples`` are too few for them.
    """
    # By default enough nodes to see that the tail of the spectrum vanishes.
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
    return n_r, n_theta


def segment_terms(
    aperture: Aperture | None, pistons: ArrayLike | None, tilts: ArrayLike | None
) -> Callable[[PupilNodes], Array]:
    """Return a function that gives the path at nodes, m, from each cell's piston and tilt.

    Tilts turn a cell about its centroid.

    Raises
    ------
    SceneError
        If there is not one finite piston and one finite pair of slopes for every cell.
    """
    if aperture is None:
        if pistons is not None or tilts is not None:
            raise SceneError("pistons or tilts need an aperture, whose cells they move; give one")
        return lambda nodes: np.zeros_like(nodes.u)
    n = len(aperture.cells)
    heights = _per_cell("pistons", pistons, (n,), "m")
    slopes = _per_cell("tilts", tilts, (n, 2), "slopes dW/du and dW/dv")
    centres = np.array([cell.centroid for cell in aperture.cells])

    def path(nodes: PupilNodes) -> Array:
        """Path of the cells' pistons and tilts at nodes, m."""
        k = nodes.owners
        along_u = slopes[k, 0] * (nodes.u - centres[k, 0])
        return np.asarray(heights[k] + along_u + slopes[k, 1] * (nodes.v - centres[k, 1]))

    return path


def _per_cell(name: str, values: ArrayLike | None, shape: tuple[int, ...], unit: str) -> Array:
    """Check one finite value or pair per cell; zeros if None."""
    given = np.zeros(shape) if values is None else numbers(name, values)
    if given.shape != shape:
        raise SceneError(f"{name} have shape {given.shape}; give {shape}, {unit} of every cell")
    if not np.isfinite(given).all():
        worst = int(np.argmin(np.isfinite(given.reshape(shape[0], -1)).all(axis=1)))
        raise SceneError(f"{name}[{worst}] = {given[worst]}; give finite numbers, {unit}")
    return given


def values_on(name: str, function: PupilFunction, nodes: PupilNodes) -> Array:
    """Evaluate a function on the nodes with nonzero area; 0 elsewhere.

    Raises
    ------
    SceneError
        If it does not return one finite real number per node.
    """
    lit = nodes.weights > 0
    u, v = nodes.u[lit], nodes.v[lit]
    try:
        given = function(u, v)
        if np.iscomplexobj(given):  # numpy would only warn and drop the imaginary part
            raise TypeError("the values are complex; put a phase into the aberration")
        found = np.broadcast_to(np.asarray(given, dtype=np.float64), u.shape)
    except SceneError:  # raised for Zernike coefficients, whose message is complete
        raise
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"{name}(u, v) must return one real number for each of {u.size} nodes: {error}"
        ) from error
    finite = np.isfinite(found)
    if not finite.all():
        worst = int(np.argmin(finite))
        raise SceneError(
            f"{name}(u, v) = {found[worst]} at u = {u[worst]:.4g} m, v = {v[worst]:.4g} m; give "
            "finite numbers everywhere in the pupil"
        )
    values = np.zeros_like(nodes.u)
    values[lit] = found
    return values


def zernike_degree(coefficients: Mapping[int, float], ordering: Ordering) -> int:
    """Return the highest radial degree of a sum of Zernike polynomials, 0 for none."""
    listed = mapping("coefficients", coefficients, "{index: metres}")
    return max((zernike_order(index, ordering)[0] for index in listed), default=0)


def zernike_fill(
    coefficients: Mapping[int, float],
    radius: float,
    ordering: Ordering,
    obscuration: float,
    aperture: Aperture | None,
) -> Fill:
    """Return the function that gives a sum of Zernike polynomials, m, and a uniform amplitude.

    ``radius``, m, is that of the polynomials' disc. On few nodes the polynomials are kept.
    """
    listed = mapping("coefficients", coefficients, "{index: metres}")
    heights = np.array([real(f"coefficients[{j}]", a) for j, a in listed.items()])
    # The nodes of discs and rings of any radius are alike.
    pupil = (1.0, obscuration, None) if aperture is None else (radius, 0.0, aperture)

    def fill(nodes: PupilNodes) -> tuple[Array, Array]:
        """Aberration and amplitude on nodes."""
        path = np.zeros_like(nodes.u)
        if nodes.layout != "grid" and heights.size and path.size <= KEPT:
            modes = kept_zernikes(tuple(coefficients), ordering, *pupil, path.shape)
            # einsum does not call BLAS, so results are bit-identical for any thread count.
            path = np.einsum("m,m...->...", heights, modes)
        elif heights.size:
            lit = nodes.weights > 0
            path[lit] = zernike_sum(coefficients, nodes.u[lit], nodes.v[lit], radius, ordering)
        return path, np.ones_like(path)

    return fill


@dataclass(frozen=True, eq=False)
class Sampling:
    """Layout, number and pupil of the sample points of a wave.

    Parameters
    ----------
    layout : {"polar", "cells", "grid"}
        Layout of the nodes.
    samples : int or (int, int), optional
        Their number, as in `Wavefront.from_function`; by default as many as a function needs.
    radius, obscuration : float
        Outer radius of a disc or ring, m, and its inner radius divided by the outer.
    outline : Aperture, optional
        Outline of a pupil that is neither disc nor ring.
    """

    layout: Nodes
    samples: int | tuple[int, int] | None
    radius: float
    obscuration: float
    outline: Aperture | None

    @property
    def trials(self) -> list[int | tuple[int, int]]:
        """Numbers of samples to try, in order."""
        if self.samples is not None:
            return [self.samples]
        if self.layout == "grid":
            return [512]  # cells per side
        if self.outline is None:
            return [24, 48, 96, 192]  # radii, with four times as many angles
        n = len(self.outline.owners)
        sides = SIDES[1:] if any(side.turn.any() for side in self.outline.patches) else SIDES
        return [sides[0], *(side for side in sides[1:] if n * side**2 <= MOST_NODES)]

    def nodes(self, samples: int | tuple[int, int]) -> PupilNodes:
        """Return a number of nodes."""
        pupil, none = (self.radius, self.obscuration, self.outline), np.zeros((), dtype=np.int64)
        if self.layout == "grid":
            count = whole("samples", samples, 2)
            if self.outline is not None:
                return PupilNodes(self.layout, *self.outline.grid_nodes(count))
            return PupilNodes(self.layout, *grid_nodes(self.radius, count, self.obscuration), none)
        if self.outline is None:
            counts = samples if isinstance(samples, tuple) else (samples, 4 * samples)
            return PupilNodes(self.layout, *pupil_points(*pupil, counts), none)
        owners = self.outline.owners[:, None, None]
        counts = samples if isinstance(samples, tuple) else (samples, samples)
        return PupilNodes(self.layout, *pupil_points(*pupil, (len(owners), *counts)), owners)

    def filled(self, fill: Fill, wavenumber: float) -> tuple[PupilNodes, Array, Array]:
        """Return nodes, and the aberration (m) and amplitude that ``fill`` gives on them.

        Their number is increased until the truncation error of both is negligible.
        """
        trials = self.trials
        for samples in trials:
            nodes = self.nodes(samples)
            path, amplitude = fill(nodes)
            if samples == trials[-1]:
                break
            lack = 0.0
            for values, scale in ((path, wavenumber), (amplitude, 1.0)):
                if (values == values.flat[0]).all():
                    continue
                # The rounding error of many waves of aberration must not count as truncation.
                least = max(NEGLIGIBLE, 1e-13 * scale * float(np.abs(values).max()))
                series = spectrum(values, self.radius, self.obscuration, self.outline)
                lack = max(lack, scale * series.truncation() / least)
            if lack <= 1:
                break
        return nodes, path, amplitude


def owned(name: str, values: Any, layout: str) -> Array:
    """Copy values to a read-only float64 array; check that they are finite and fit the layout."""
    try:
        if np.iscomplexobj(values):  # numpy would only warn and drop the imaginary part
            raise TypeError
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        told = f"wavefront.{name} is not an array of real numbers"
        raise SceneError(f"{told}; give real values, and a phase as aberration") from None
    dimension = {"scattered": 1, "cells": 3}.get(layout, 2)
    if array.ndim != dimension or array.size == 0:
        raise SceneError(
            f"wavefront.{name} has shape {array.shape}; layout '{layout}' needs "
            f"{counted(dimension, 'dimension')}"
        )
    finite = np.isfinite(array)
    if not finite.all():
        where = tuple(int(i) for i in np.unravel_index(np.argmin(finite), array.shape))
        raise SceneError(
            f"wavefront.{name} = {array[where]} at {where}; give finite numbers, and amplitude 0 "
            "where there is no light"
        )
    array.setflags(write=False)
    return array
