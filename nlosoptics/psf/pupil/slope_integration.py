"""Wave fronts from their slopes: least squares over any mask of a grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import positive
from ...errors import SamplingError, SceneError
from ..wave.wavefront import Wavefront

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDING: Final = 1e-15  # of the start, where conjugate gradients stop
MOST_STEPS: Final = 5000  # a disc takes some 20


def wavefront_from_slopes(
    slopes: ArrayLike,
    pitch: float,
    mask: ArrayLike,
    *,
    wavelength: float,
    image_distance: float,
    pupil_radius: float | None = None,
) -> tuple[Wavefront, float]:
    """Least-squares wave front of slopes at the nodes of a pupil grid.

    Parameters
    ----------
    slopes : array_like, (n, n, 2)
        dW/du and dW/dv, rad, rows along v, node [n//2, n//2] on the axis. Not read where the mask
        is false.
    pitch : float
        Between nodes, m.
    mask : array_like of bool, (n, n)
        Nodes in the pupil; its pieces may be apart, and of any shape.
    wavelength, image_distance : float
        m.
    pupil_radius : float, optional
        What the F-number refers to, m; default the disc that just fits the grid.

    Returns
    -------
    wavefront : Wavefront
        Layout "grid": amplitude 1 on the mask, 0 beside it, each node with its whole cell. Every
        piece of the mask has a mean aberration of 0: slopes do not tell their pistons.
    curl_residual_rms : float
        rms of what the slopes between neighbours differ by from those of the wave front, rad.
        0 but for rounding if the slopes are the gradient of a quadratic.

    Raises
    ------
    SceneError
        If shapes differ, the mask is empty, or a slope on it is not finite.

    Notes
    -----
    See `integrated_slopes`. Slopes of facets drawn one by one are no gradient (theorem of Malus
    and Dupin): the residual tells how much of them no wave front can have.
    """
    table, inside = _checked(slopes, mask)
    if table.shape[0] != table.shape[1]:
        raise SceneError(f"slopes have shape {table.shape}; a wave front's grid is square")
    positive("pitch", pitch, unit="m")
    aberration, residual = integrated_slopes(table, float(pitch), inside)
    wavefront = Wavefront.from_map(
        aberration,
        inside.astype(np.float64),
        wavelength=wavelength,
        pupil_pitch=float(pitch),
        image_distance=image_distance,
        pupil_radius=pupil_radius,
    )
    return wavefront, residual


@dataclass(frozen=True, eq=False, kw_only=True)
class SlopeFilter:
    """`integrated_slopes` of a whole rectangle as products of small matrices.

    With slopes s_x, s_y at nodes (ny, nx), ``surface/pitch = Y' [(Y s_x G_x' + G_y s_y X')/L] X``.

    Parameters
    ----------
    cosines : (ndarray, ndarray)
        Y (ny, ny) and X (nx, nx), orthonormal: row k is the k-th cosine.
    sources : (ndarray, ndarray)
        G_y and G_x: cosine transforms of minus the divergence of the neighbours' mean slopes.
    inverse : ndarray, (ny, nx)
        1/L, L the Laplacian's values; 0 for the mean.
    """

    cosines: tuple[Array, Array]
    sources: tuple[Array, Array]
    inverse: Array


def slope_filter(shape: tuple[int, int]) -> SlopeFilter:
    """Filter from slopes to the least-squares surface on a rectangle without holes.

    Parameters
    ----------
    shape : (int, int)
        Nodes (ny, nx).

    Returns
    -------
    SlopeFilter
    """
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
    """Least-squares surface of slopes on a masked grid, and the rms of what no surface has.

    Parameters
    ----------
    slopes : array_like, (ny, nx, 2)
        Derivatives along columns and along rows, at the nodes.
    pitch : float
        m.
    mask : array_like of bool, (ny, nx)

    Returns
    -------
    surface : ndarray, (ny, nx)
        m; mean 0 over every piece of the mask, and 0 beside it.
    residual : float
        rms over all pairs of neighbours in the mask, rad; 0 where there is no pair.

    Raises
    ------
    SceneError
        If shapes differ, the mask is empty, or a slope on it is not finite.
    SamplingError
        If a mask as narrow as a maze keeps the iteration from its end.

    Notes
    -----
    Neighbours a, b are to differ by ``pitch (s_a + s_b)/2`` [1]_, which is exact for quadratics and
    wrong in second order of the pitch beyond. The normal equations are a Poisson problem with free
    boundary; conjugate gradients solve it, with the full rectangle's solution by cosine transforms
    as preconditioner: the number of steps depends on the mask's shape and not on the pitch. Sums
    are taken without BLAS: any number of threads gives the same bits.

    References
    ----------
    .. [1] Southwell, J. Opt. Soc. Am. 70, 998 (1980).
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
    """Slopes (ny, nx, 2) and mask (ny, nx), finite where it is true."""
    inside = np.asarray(mask)
    if inside.dtype != bool:
        raise SceneError(f"mask holds {inside.dtype}; give booleans, as weights > 0")
    try:
        table = np.asarray(slopes, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError("slopes are not an array of real numbers") from None
    if table.ndim != 3 or table.shape[2] != 2 or inside.shape != table.shape[:2]:
        raise SceneError(
            f"slopes have shape {table.shape} and mask {inside.shape}; give (n, n, 2) and (n, n)"
        )
    if not inside.any():
        raise SceneError("mask is false everywhere; a wave front needs a node")
    wrong = inside & ~np.isfinite(table).all(axis=-1)
    if wrong.any():
        place = np.argwhere(wrong)[0].tolist()
        raise SceneError(f"slopes{place} hold NaN or infinity; mask such nodes out")
    return table, inside


def _divergence(step_x: Array, step_y: Array) -> Array:
    """Minus the adjoint of differences: what the normal equations have on their right, negated."""
    out = np.zeros((step_x.shape[0], step_y.shape[1]))
    out[:, 1:] += step_x
    out[:, :-1] -= step_x
    out[1:] += step_y
    out[:-1] -= step_y
    return out


def _laplacian_spectrum(ny: int, nx: int) -> Array:
    """The Laplacian of a whole rectangle between its cosines."""
    spectrum: Array = 4 * (
        np.sin(np.pi * np.arange(nx) / (2 * nx)) ** 2
        + np.sin(np.pi * np.arange(ny) / (2 * ny))[:, None] ** 2
    )
    return spectrum


def _poisson(right: Array, pairs_x: Mask, pairs_y: Mask) -> Array:
    """Surface whose graph Laplacian over the pairs is ``right``, by conjugate gradients."""
    from scipy import fft

    ny, nx = right.shape
    spectrum = _laplacian_spectrum(ny, nx)
    spectrum[0, 0] = 1.0  # its numerator is 0 but for rounding
    inside = np.zeros(right.shape, dtype=bool)
    inside[:, 1:] |= pairs_x
    inside[:, :-1] |= pairs_x
    inside[1:] |= pairs_y
    inside[:-1] |= pairs_y

    def laplacian(w: Array) -> Array:
        return _divergence(
            np.where(pairs_x, np.diff(w, axis=1), 0.0), np.where(pairs_y, np.diff(w, axis=0), 0.0)
        )

    def preconditioned(r: Array) -> Array:
        solution = fft.idctn(fft.dctn(r, norm="ortho") / spectrum, norm="ortho")
        return np.where(inside, solution, 0.0)

    surface = np.zeros_like(right)
    first = 0.0
    residual = right
    for _ in range(2):  # the second time for what rounding left
        z = preconditioned(residual)
        direction, product = z, float(np.sum(residual * z))
        first = max(first, product)
        for step in range(MOST_STEPS + 1):
            if product <= ROUNDING**2 * first:
                break
            if step == MOST_STEPS:
                raise SamplingError(
                    f"the least-squares surface is not found in {MOST_STEPS} steps; give a mask "
                    "without narrow passages, or its parts one by one"
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
