"""Waves from a wall of random facets: facet tilts on the wall become wave slopes in the pupil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import CausticError, SamplingError, SceneError
from ...raytrace import facet_angles
from ...raytrace.fans.facets import material_slope
from ...scene import Scene
from ..wave.wavefront import Wavefront
from .slope_integration import integrated_slopes
from .wall_view import _optics, _zoom, facet_reach
from .wall_wavefront import wavefront

Array = NDArray[np.float64]


def facet_wavefront(
    scene: Scene,
    *,
    cell: float,
    slope_rms: float | None = None,
    samples: int = 256,
    seed: int = 0,
) -> tuple[Wavefront, float]:
    """Return the wave from a wall with one random facet per cell, on a pupil grid.

    Parameters
    ----------
    scene : Scene
        Scene with the camera and the wall, which is the mean surface of the facets.
    cell : float
        Side of a facet's square cell, m.
    slope_rms : float, optional
        Rms slope of the facets per axis, rad; by default that of the strongest lobe of the wall
        material that has a slope.
    samples : int
        Cells of the pupil grid per side.
    seed : int
        Seed of the facets, see `raytrace.facet_angles`.

    Returns
    -------
    wavefront : Wavefront
        Wave of the mean wall (`psf.wavefront`) plus the least-squares wave of the facets' slopes.
        The tilt of the latter is not removed.
    curl_residual_rms : float
        Rms of the part of the pupil slopes that is not the gradient of a wave, rad; see
        `wavefront_from_slopes`.

    Raises
    ------
    CausticError
        If facets deflect rays beyond neighbouring facets, so that W is undefined, or if the mean
        wall has no single wave.
    SamplingError
        If the pupil grid is so coarse that it skips cells.

    See Also
    --------
    pupil_slopes : Wave slopes caused by facet tilts.
    sample_point_spread : PSF of one random rough wall.
    nlosoptics.raytrace.facet_angles : Random tilts of a rough wall's facets.

    Notes
    -----
    With a facet of slope s, a pupil point sees a wall point that is ``(cos_i + cos_o) s d_eff``
    away from the point seen by the mean wall, see `facet_reach`. If this distance exceeds a cell,
    several facets or none reach a pupil point. If it exceeds the wall patch seen by the pupil,
    nothing remains of the mean wave. In both cases W is undefined. To use such slopes as a model
    nevertheless, call `raytrace.facet_angles`, `pupil_slopes` and `wavefront_from_slopes` in turn.
    """
    if slope_rms is None:
        slope_rms = material_slope(scene)
    slopes, positions = facet_angles(scene, cell=cell, slope_rms=slope_rms, seed=seed)
    reach, patch = facet_reach(scene, slope_rms=slope_rms)
    limit = min(float(cell), patch)
    if reach > limit:
        what = "one cell" if cell <= patch else "the patch that the pupil sees"
        raise CausticError(
            f"facets of slope_rms = {slope_rms:.3g} rad shift rays {reach:.3g} m along the wall, "
            f"limit {limit:.3g} m ({what}), {reach / limit:.3g} times too far: W is undefined; use "
            f"a slope_rms of at most {slope_rms * limit / reach:.3g} rad or rays instead of waves"
        )
    mean = wavefront(scene, nodes="grid", samples=samples)
    # Cells just outside the disc can have areas of the order of rounding error.
    mask = mean.weights > 1e-12 * mean.pupil_pitch**2
    nodes = np.stack([mean.u[mask], mean.v[mask]], axis=1)
    zoom = _zoom(scene)
    step = mean.pupil_pitch / abs(zoom)
    step *= float(np.linalg.norm(_optics(scene, np.zeros((1, 2))).footprint[0], 2))
    if step > cell:
        raise SamplingError(
            f"neighbours among {samples} x {samples} pupil samples see wall points {step:.3g} m "
            f"apart, limit cell = {cell:.3g} m; use {int(np.ceil(samples * step / cell)) + 1} "
            "samples"
        )
    table = np.zeros((*mask.shape, 2))
    table[mask] = pupil_slopes(scene, slopes, positions, nodes)
    rough, residual = integrated_slopes(table, mean.pupil_pitch, mask)
    return replace(mean, aberration=mean.aberration + rough), residual


def pupil_slopes(scene: Scene, slopes: ArrayLike, positions: ArrayLike, nodes: ArrayLike) -> Array:
    """Return the wave slopes that the tilts of wall facets cause at fixed pupil points.

    Parameters
    ----------
    scene : Scene
        Scene with the camera, the object and the mean wall.
    slopes : array_like, (ny, nx, 2)
        Facet slopes relative to the mean wall, see `raytrace.facet_angles`.
    positions : array_like, (ny, nx, 3)
        Centres of the cells, world, m.
    nodes : array_like, (n, 2)
        Points (u, v) of the exit pupil, m.

    Returns
    -------
    ndarray, (n, 2)
        Contributions of the facets to dW/du and dW/dv, rad, to first order in their slopes.

    Raises
    ------
    SamplingError
        If a node sees a wall point outside the cells.
    CausticError
        If the W of the mean wall is undefined.
    SceneError
        If an array has the wrong shape or is not finite.

    See Also
    --------
    facet_wavefront : Wave of a wall of tilted facets.
    wavefront_from_slopes : Wave from slopes, by least squares.
    nlosoptics.raytrace.facet_angles : Random tilts of a rough wall's facets.

    Notes
    -----
    ``grad_p W = -(cos_i + cos_o) M^T grad h`` with
    ``M = [P_i/d1 + P_o/d2 - (cos_i + cos_o) K]^-1 E/d2``. The pupil point p sees the wall point
    M p. P_i and P_o project the wall's tangent plane across the two legs. K is the Hessian of the
    mean wall (positive if concave to the room). E projects the pupil's axes across the ray into the
    tangent plane.
    """
    table, x, y = _lattice(slopes, positions)
    points = np.asarray(nodes, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise SceneError(f"nodes have shape {points.shape}; give (n, 2) finite u and v in m")
    zoom = _zoom(scene)
    seen = _optics(scene, points / zoom)
    columns, rows = (_cell_index(axis, seen.points[:, k]) for k, axis in enumerate((x, y)))
    outside = (columns < 0) | (columns >= len(x)) | (rows < 0) | (rows >= len(y))
    if outside.any():
        i = int(np.argmax(outside))
        raise SamplingError(
            f"pupil node {i} sees the wall at x = {seen.points[i, 0]:.6g} m, y = "
            f"{seen.points[i, 1]:.6g} m, beyond the cells (x from {x[0]:.6g} to {x[-1]:.6g} m, y "
            f"from {y[0]:.6g} to {y[-1]:.6g} m); give facets on the whole patch that the pupil sees"
        )
    tilt = table[rows, columns]
    found = -seen.cosines[:, None] * np.einsum("nba,nb->na", seen.footprint, tilt)
    return np.asarray(found / zoom)


def _lattice(slopes: ArrayLike, positions: ArrayLike) -> tuple[Array, Array, Array]:
    """Check facets and return their slopes (ny, nx, 2) and the cells' x (nx,) and y (ny,), m."""
    table, places = np.asarray(slopes, np.float64), np.asarray(positions, np.float64)
    if table.ndim != 3 or table.shape[2] != 2 or places.shape != (*table.shape[:2], 3):
        raise SceneError(
            f"slopes have shape {table.shape} and positions {places.shape}; give (ny, nx, 2) and "
            "(ny, nx, 3)"
        )
    if min(table.shape[:2]) < 2:
        raise SceneError(f"slopes have shape {table.shape}; give two cells or more per axis")
    if not (np.isfinite(table).all() and np.isfinite(places).all()):
        raise SceneError("slopes or positions hold NaN or infinity; give finite facets")
    x, y = places[0, :, 0], places[:, 0, 1]
    for axis, found in ((x, places[..., 0]), (y[:, None], places[..., 1])):
        step = (axis.ravel()[-1] - axis.ravel()[0]) / (axis.size - 1)
        even = axis.ravel()[0] + step * np.arange(axis.size)
        error = max(float(np.abs(found - axis).max()), float(np.abs(axis.ravel() - even).max()))
        if not (step > 0 and error <= 1e-6 * step):
            raise SceneError(
                f"positions are {error:.3g} m off a lattice of {step:.3g} m; take them from "
                "raytrace.facet_angles"
            )
    return table, x, y


def _cell_index(centres: Array, at: Array) -> NDArray[np.int64]:
    """Index of the cell that contains each coordinate; out of range for coordinates outside."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    return np.asarray(np.floor((at - centres[0]) / step + 0.5), dtype=np.int64)
