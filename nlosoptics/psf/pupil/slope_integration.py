"""Wave fronts from slopes: least-squares integration over any mask of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import positive
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ..wave.wavefront import Wavefront

Mask = NDArray[np.bool_]

#: Largest number of conjugate-gradient steps; a disc needs about 20.
MOST_STEPS = 5000


def wavefront_from_slopes(
    slopes: ArrayLike,
    pitch: float,
    mask: ArrayLike,
    *,
    wavelength: float,
    image_distance: float,
    pupil_radius: float | None = None,
) -> tuple[Wavefront, float]:
    """Integrate wave slopes on a pupil grid to a wavefront, in the least-squares sense.

    Slopes come from a Shack-Hartmann sensor, for example.

    Parameters
    ----------
    slopes : array_like, (n, n, 2)
        Slopes dW/du and dW/dv of the aberration W at the grid points, rad. v increases from row to
        row, u along a row; point [n//2, n//2] is on the axis. Values outside the mask are ignored.
    pitch : float
        Distance between grid points, m.
    mask : array_like of bool, (n, n)
        Grid points inside the pupil. The pupil may have several separate parts of any shape.
    wavelength : float
        Vacuum wavelength, m.
    image_distance : float
        Distance from the pupil to the image plane, m; negative if the pupil lies beyond the image.
    pupil_radius : float, optional
        Radius of the pupil, m, which defines the F-number; by default that of the disc that just
        fits the grid.

    Returns
    -------
    wavefront : Wavefront
        Wave of the layout "grid", with amplitude 1 on the mask and 0 elsewhere. The mean aberration
        of every separate part of the pupil is 0, because slopes do not determine pistons.
    curl_residual_rms : float
        Rms difference between the given slopes and those of the wavefront, rad, over all pairs of
        neighbouring points. It is the part of the slopes that is not a gradient, and 0 to rounding
        error for the slopes of a quadratic W.

    Raises
    ------
    SceneError
        If shapes differ, the mask is empty, or a slope on it is not finite.
    SamplingError
        If the iteration does not converge, which long narrow passages of the mask can cause.

    See Also
    --------
    point_spread : PSF of a given wave.

    Notes
    -----
    Slopes of every wavefront are a gradient (theorem of Malus and Dupin). Slopes of random,
    independent wall facets are not; ``curl_residual_rms`` measures by how much.

    The height difference of two neighbouring points a and b is fitted to ``pitch (s_a + s_b)/2``,
    with s the slope along the line between them [1]_. This is exact for quadratics; otherwise the
    error is of second order in the pitch. The equations are a Poisson problem with Neumann boundary
    conditions. They are solved by conjugate gradients, with cosine transforms on the full rectangle
    as preconditioner. Results are bit-identical for any number of threads.

    References
    ----------
    .. [1] Southwell, J. Opt. Soc. Am. 70, 998 (1980).

    Examples
    --------
    Slopes of ``W = 1e-3 (u^2 + v^2)``, all lengths in m:

    >>> import numpy as np
    >>> from nlosoptics import psf
    >>> axis = 1e-3 * (np.arange(9) - 4)
    >>> v, u = np.meshgrid(axis, axis, indexing="ij")
    >>> wave, residual = psf.wavefront_from_slopes(
    ...     2e-3 * np.stack([u, v], axis=2), 1e-3, u**2 + v**2 < 2e-5,
    ...     wavelength=550e-9, image_distance=0.1,
    ... )
    >>> print(f"{1e9 * np.ptp(wave.aberration[4]):.0f} nm", residual < 1e-15)
    16 nm True
    """
    aberration, residual = integrated_slopes(slopes, pitch, mask)
    if aberration.shape[0] != aberration.shape[1]:
        raise SceneError(f"slopes have shape {np.shape(slopes)}; a wave front's grid is square")
    wavefront = Wavefront.from_map(
        aberration,
        np.asarray(mask, dtype=np.float64),
        wavelength=wavelength,
        pupil_pitch=float(pitch),
        image_distance=image_distance,
        pupil_radius=pupil_radius,
    )
    return wavefront, residual


@dataclass(frozen=True, eq=False, kw_only=True)
class SlopeFilter:
    """Least-squares integration of slopes on a full rectangle, as products of small matrices.

    It is `integrated_slopes` without a mask. With slopes s_x, s_y at nodes (ny, nx),
    ``surface/pitch = Y' [(Y s_x G_x' + G_y s_y X')/L] X``, where ' is the transpose.
    """

    # (ndarray, ndarray); Y (ny, ny) and X (nx, nx), orthonormal; row k holds the k-th cosine.
    cosines: tuple[Array, Array]
    # (ndarray, ndarray); G_y (ny, ny) and G_x (nx, nx): cosine transforms of minus the divergence
    # of the neighbours' mean slopes.
    sources: tuple[Array, Array]
    inverse: Array  # (ny, nx); 1/L with the eigenvalues L of the Laplacian; 0 for the mean


def slope_filter(shape: tuple[int, int]) -> SlopeFilter:
    """Return the filter from slopes to the least-squares surface on a full rectangle of cells."""
    from scipy import fft

    ny, nx = shape
    cosines, sources = [], []
    for n in shape:
        nodes = np.eye(n)
        steps = (nodes[1:] + nodes[:-1]) / 2
        right = _divergence(np.zeros((n, n - 1)), steps)
        sources.append(fft.dct(right, axis=0, norm="ortho"))
        cosines.append(fft.dct(nodes, axis=0, norm="ortho"))
    spectrum = _laplacian_spectrum(ny, nx)
    spectrum[0, 0] = np.inf
    return SlopeFilter(
        cosines=(cosines[0], cosines[1]), sources=(sources[0], sources[1]), inverse=1 / spectrum
    )


def integrated_slopes(slopes: ArrayLike, pitch: float, mask: ArrayLike) -> tuple[Array, float]:
    """Integrate slopes (ny, nx, 2) on a grid of any outline to a surface, by least squares.

    Returns heights (ny, nx), m, and the rms difference between the slopes and those of the surface,
    see `wavefront_from_slopes`.
    """
    from scipy import ndimage

    table, inside = _checked(slopes, mask)
    positive("pitch", pitch, unit="m")
    table = np.where(inside[..., None], table, 0.0)
    pairs_x, pairs_y = inside[:, 1:] & inside[:, :-1], inside[1:] & inside[:-1]
    step_x = np.where(pairs_x, (table[:, 1:, 0] + table[:, :-1, 0]) / 2, 0.0)
    step_y = np.where(pairs_y, (table[1:, :, 1] + table[:-1, :, 1]) / 2, 0.0)
    surface = _poisson(_divergence(step_x, step_y), pairs_x, pairs_y)
    pieces, n_pieces = ndimage.label(inside)
    index = np.arange(1, n_pieces + 1)
    means = np.concatenate([[0.0], np.atleast_1d(ndimage.mean(surface, pieces, index))])
    surface = np.where(inside, surface - means[pieces], 0.0)
    miss_x = np.where(pairs_x, np.diff(surface, axis=1) - step_x, 0.0)
    miss_y = np.where(pairs_y, np.diff(surface, axis=0) - step_y, 0.0)
    n_pairs = int(pairs_x.sum() + pairs_y.sum())
    square = float(np.sum(miss_x**2) + np.sum(miss_y**2))
    return surface * float(pitch), float(np.sqrt(square / max(n_pairs, 1)))


def _checked(slopes: ArrayLike, mask: ArrayLike) -> tuple[Array, Mask]:
    """Check and return slopes (ny, nx, 2), finite on the mask, and the mask (ny, nx)."""
    inside = np.asarray(mask)
    if inside.dtype != bool:
        raise SceneError(f"mask holds {inside.dtype}; give booleans, such as weights > 0")
    try:
        table = np.asarray(slopes, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError("slopes are not an array of real numbers; give (ny, nx, 2)") from None
    if table.ndim != 3 or table.shape[2] != 2 or inside.shape != table.shape[:2]:
        raise SceneError(
            f"slopes have shape {table.shape} and mask {inside.shape}; give (n, n, 2) and (n, n)"
        )
    if not inside.any():
        raise SceneError("mask is false everywhere; give at least one node")
    wrong = inside & ~np.isfinite(table).all(axis=-1)
    if wrong.any():
        place = np.argwhere(wrong)[0].tolist()
        raise SceneError(f"slopes{place} hold NaN or infinity; give finite values or mask them out")
    return table, inside


def _divergence(step_x: Array, step_y: Array) -> Array:
    """Minus the divergence of steps between neighbours, at the nodes (ny, nx).

    It is the adjoint of the differences. Steps are (ny, nx - 1) along x and (ny - 1, nx) along y.
    """
    out = np.zeros((step_x.shape[0], step_y.shape[1]))
    out[:, 1:] += step_x
    out[:, :-1] -= step_x
    out[1:] += step_y
    out[:-1] -= step_y
    return out


def _laplacian_spectrum(ny: int, nx: int) -> Array:
    """Eigenvalues of a full rectangle's graph Laplacian for its cosines, (ny, nx)."""
    spectrum: Array = 4 * (
        np.sin(np.pi * np.arange(nx) / (2 * nx)) ** 2
        + np.sin(np.pi * np.arange(ny) / (2 * ny))[:, None] ** 2
    )
    return spectrum


def _poisson(right: Array, pairs_x: Mask, pairs_y: Mask) -> Array:
    """Solve for the surface with the graph Laplacian ``right`` by conjugate gradients."""
    from scipy import fft

    ny, nx = right.shape
    spectrum = _laplacian_spectrum(ny, nx)
    spectrum[0, 0] = 1.0  # any value: the numerator is 0 to rounding error
    inside = np.zeros(right.shape, dtype=bool)
    inside[:, 1:] |= pairs_x
    inside[:, :-1] |= pairs_x
    inside[1:] |= pairs_y
    inside[:-1] |= pairs_y

    def laplacian(w: Array) -> Array:
        """Graph Laplacian over the pairs."""
        return _divergence(
            np.where(pairs_x, np.diff(w, axis=1), 0.0), np.where(pairs_y, np.diff(w, axis=0), 0.0)
        )

    def preconditioned(r: Array) -> Array:
        """Solution on the full rectangle, restricted to the mask."""
        solution = fft.idctn(fft.dctn(r, norm="ortho") / spectrum, norm="ortho")
        return np.where(inside, solution, 0.0)

    surface = np.zeros_like(right)
    first = 0.0
    residual = right
    for _ in range(2):  # the second pass removes the rounding error of the first
        z = preconditioned(residual)
        direction, product = z, float(np.sum(residual * z))
        first = max(first, product)
        for step in range(MOST_STEPS + 1):
            if product <= 1e-30 * first:  # 1e-15 of the initial residual
                break
            if step == MOST_STEPS:
                raise SamplingError(
                    f"the least-squares surface has not converged after {MOST_STEPS} steps; give a "
                    "mask without narrow passages, or its parts one by one"
                )
            image = laplacian(direction)
            length = product / float(np.sum(direction * image))
            surface = surface + length * direction
            residual = residual - length * image
            z = preconditioned(residual)
            previous, product = product, float(np.sum(residual * z))
            direction = z + (product / previous) * direction
        residual = right - laplacian(surface)
    return surface
