"""Field-dependent point spread functions over the hidden object, compressed to a few modes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import carried, fits_memory, in_range, is_single, positive, whole
from ..._nouns import Noun
from ..._progress import Progress
from ..._random import generator
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ...raytrace.intersection.meshes import worker_pool
from ...scene import PlanarObject, Scene
from ..pupil.scene_optics import PointOptics, SceneOptics, optics_of
from ..transform.point_spread import PointSpread
from .scene_psf import point_window, wall_image

#: Coordinates of an object point across and up, -1 to 1 from edge to edge.
Place = tuple[float, float]
EDGES: Final = np.array([-1.0, 1.0])
HELD_OUT = 501  # random stream of the points at which a field is checked
AVERAGED = 32  # points along each side of the object over which a field is averaged
BLOCK = 1 << 14  # points that are interpolated together, few enough for the processor's cache


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSpreadField(Noun):
    """Point spread functions (PSFs) at all points of a planar object, stored as a few modes.

    The PSF of an object point is a sum of modes, ``sum_k weights[k] * modes[k]``. The modes are the
    same for all points; the weights vary smoothly over the object.

    Parameters
    ----------
    modes : ndarray, (K, py, px)
        K images, energy per pixel. Pixel [py//2, px//2] is where the chief ray of the object point
        (through the centre of the lens) meets the detector.
    weights : ndarray, (K, ny, nx)
        Weights of the modes at ny x nx object points, a grid given by ``up`` and ``across``.
    across, up : ndarray, (nx,) and (ny,)
        Coordinates of these points, -1 to 1 from the left to the right edge of the object and from
        its lower to its upper edge. They are Chebyshev nodes, which suit interpolation.
    pitch : float
        Side of an image pixel, m.
    truncation_error : float
        Largest error of a PSF at the ny x nx points that is due to the small number of modes,
        relative to its peak.
    error_estimate : float
        Largest error of a PSF anywhere on the object, relative to its peak. It is found by
        comparing with directly computed PSFs at random object points, and includes the error
        estimates of these.
    normalisation : str
        "unit-sum": each PSF has the energy 1 in the whole image plane.

    See Also
    --------
    point_spread_field : PSFs over the hidden object.
    nlosoptics.imaging.image_field : PSFs at as many points as an image needs.
    """

    modes: Array
    weights: Array
    across: Array
    up: Array
    pitch: float
    truncation_error: float
    error_estimate: float
    normalisation: str = "unit-sum"

    def __post_init__(self) -> None:
        for array in (self.modes, self.weights, self.across, self.up):
            array.flags.writeable = False

    def at(self, across: ArrayLike, up: ArrayLike) -> Array:
        """Interpolate the weights of the modes at points of the object.

        Parameters
        ----------
        across, up : array_like
            Coordinates of the points, -1 to 1 from the left to the right edge of the object and
            from its lower to its upper edge; their shapes broadcast. Points outside the object get
            the weights at the nearest edge.

        Returns
        -------
        ndarray, (K, ...)
            Weights of the K modes, in the broadcast shape of the coordinates.

        Raises
        ------
        SamplingError
            If a coordinate is NaN or infinite.
        """
        x, y = (np.asarray(v, dtype=np.float64) for v in (across, up))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise SamplingError("across or up holds NaN or infinity; give coordinates from -1 to 1")
        if x.ndim == y.ndim == 2 and x.shape[0] == y.shape[1] == 1:  # the points form a grid
            return self._interpolated("kyn,my->kmn", x[0], y[:, 0])
        x, y = np.broadcast_arrays(x, y)
        shape, x, y = x.shape, x.ravel(), y.ravel()
        weights = np.empty((len(self.weights), x.size))

        def fill(first: int) -> None:
            block = slice(first, first + BLOCK)
            weights[:, block] = self._interpolated("kyn,ny->kn", x[block], y[block])

        mapped = map if x.size <= BLOCK else worker_pool().map
        list(mapped(fill, range(0, x.size, BLOCK)))
        return weights.reshape(len(weights), *shape)

    def _interpolated(self, sums: str, x: Array, y: Array) -> Array:
        """Return the weights at coordinates x (n,) and y, summed over the rows of nodes last."""
        on_x = chebyshev_weights(len(self.across), x)
        on_y = chebyshev_weights(len(self.up), y)
        # einsum without BLAS, whose rounding can depend on the number of threads
        half = np.einsum("kyx,nx->kyn", self.weights, on_x)
        return np.asarray(np.einsum(sums, half, on_y))

    def point_spread(self, across: float, up: float) -> Array:
        """Return the point spread function at one point of the object.

        ``across`` and ``up`` are those of `at`. The result, (py, px), is the energy per pixel.
        """
        return np.asarray(np.tensordot(self.at(across, up), self.modes, 1))

    def mean(self) -> Array:
        """Return the point spread function averaged over the object, (py, px), energy per pixel."""
        return np.asarray(np.tensordot(self._even_weights.mean(axis=(1, 2)), self.modes, 1))

    def deviation(self) -> float:
        """Return how far the point spreads differ from their mean: rms difference over rms mean.

        Both are over object and pixels; 0 if the point spread is the same everywhere.
        """
        weights, products = self._even_weights.reshape(len(self.modes), -1), self._products
        mean = weights.mean(axis=1)
        apart = weights - mean[:, None]
        squares = np.einsum("in,ij,jn->n", apart, products, apart)
        return math.sqrt(max(float(squares.mean()), 0.0) / float(mean @ products @ mean))

    def compressed(self, tol: float) -> PointSpreadField:
        """Return the field without its last modes, as far as a tolerance allows.

        Parameters
        ----------
        tol : float
            Largest rms of the omitted part relative to that of the point spreads, over object and
            pixels, 0 to 1.

        Returns
        -------
        PointSpreadField
            Field with the first modes of this one, at least one. Its ``truncation_error`` and
            ``error_estimate`` include the error by the omitted modes at the points of the grid.
        """
        in_range("tol", tol, 0.0, 1.0)
        weights = self._even_weights.reshape(len(self.modes), -1)
        powers = self._products * (weights @ weights.T)
        # Entry k is the power of modes k to the last; modes of given fields may overlap.
        rest = np.diagonal(powers[::-1, ::-1].cumsum(axis=0).cumsum(axis=1))[::-1]
        count = max(1, int(np.count_nonzero(rest > tol**2 * rest[0])))
        if count == len(self.modes):
            return self
        omitted = np.einsum("kyx,kp->yxp", self.weights[count:], self._flat[count:])
        peaks = np.einsum("kyx,kp->yxp", self.weights, self._flat).max(axis=-1)
        lost = float((np.abs(omitted).max(axis=-1) / peaks).max())
        return replace(
            self,
            modes=self.modes[:count],
            weights=self.weights[:count],
            truncation_error=self.truncation_error + lost,
            error_estimate=self.error_estimate + lost,
        )

    @property
    def _flat(self) -> Array:
        return self.modes.reshape(len(self.modes), -1)

    @cached_property
    def _even_weights(self) -> Array:
        """Weights at evenly spread object points, (K, AVERAGED, AVERAGED)."""
        steps = (2 * np.arange(AVERAGED) + 1) / AVERAGED - 1
        return self.at(steps[None, :], steps[:, None])

    @cached_property
    def _products(self) -> Array:
        """Sums over pixels of the products of two modes, (K, K)."""
        return np.asarray(np.einsum("ip,jp->ij", self._flat, self._flat))


def point_spread_field(
    scene: Scene | SceneOptics,
    grid: int | tuple[int, int] = 5,
    *,
    tol: float = 1e-3,
    pitch: float | None = None,
    checks: int = 6,
    seed: int = 0,
    progress: Progress | None = None,
) -> PointSpreadField:
    """Compute the point spread functions (PSFs) at all points of the planar hidden object.

    PSFs are computed at a grid of object points, compressed, and interpolated in between.

    Parameters
    ----------
    scene : Scene or SceneOptics
        Scene with a `PlanarObject`. A `SceneOptics` made from it stores its exit pupil and
        central wave for further calls.
    grid : int or (int, int)
        Number of object points (ny, nx) at which PSFs are computed, each 1 to 64; one number is
        used for both.
    tol : float
        Largest error of the PSFs at these points relative to their peaks, 1e-9 to 0.1. The error
        between the points depends on ``grid``; ``error_estimate`` of the result includes it.
    pitch : float, optional
        Pixel side, m; by default that of the camera's image. Values are integrals over pixels.
    checks : int
        Number of random object points at which the interpolated PSF is compared with a directly
        computed one. If 0, ``error_estimate`` does not include the interpolation.
    seed : int
        Random seed of these points.
    progress : callable(str, float), optional
        Called with "field" and the completed fraction, 0 to 1.

    Returns
    -------
    PointSpreadField
        PSFs as a sum of a few modes with weights, and their errors.

    Raises
    ------
    SceneError
        If the object is a mesh or an option is out of range.
    CausticError, NotWaveGradeError, SamplingError
        If the aberration of an object point has no single value (several rays or none reach a pupil
        point), a mesh wall is not accurate enough for waves, or ``tol`` cannot be reached.

    See Also
    --------
    scene_point_spread : For one object point.

    Notes
    -----
    The modes come from a singular value decomposition of all computed PSFs; as many are kept as
    ``tol`` requires. Half of ``tol`` is for the computed PSFs, half for the omitted modes. The
    weights are interpolated by Chebyshev polynomials. All cores are used; the result does not
    depend on their number.
    """
    optics = optics_of(scene)
    scene = optics.scene
    ny, nx = _grid_counts(grid)
    in_range("tol", tol, 1e-9, 0.1)
    checks = whole("checks", checks, 0)
    pitch = scene.camera.image_pitch if pitch is None else positive("pitch", pitch, unit="m")
    drawn = generator(seed, HELD_OUT).uniform(-1.0, 1.0, size=(checks, 2)).tolist()
    spreads = SampledSpreads(optics, pitch, tol / 2, picture_nodes(nx), picture_nodes(ny))
    return spreads.field((ny, nx), [(x, y) for x, y in drawn], progress)


class SampledSpreads:
    """Point spreads of points of a planar object on one window, each computed once.

    Parameters
    ----------
    optics : SceneOptics
        Optics of a scene with a `PlanarObject`.
    pitch : float
        Pixel side, m.
    tol : float
        Largest error of each point spread, relative to its peak.
    across, up : ndarray, (nx,) and (ny,)
        Increasing coordinates of the points. Those at the corners and at the object's centre
        determine the window; by default the object's own corners.

    Attributes
    ----------
    side : int
        Pixels along each side of the window.
    """

    def __init__(
        self,
        optics: SceneOptics,
        pitch: float,
        tol: float,
        across: Array = EDGES,
        up: Array = EDGES,
    ) -> None:
        self.optics, self.pitch, self.tol = optics, pitch, tol
        if not isinstance(optics.scene.hidden, PlanarObject):
            raise SceneError(
                "scene.hidden is a mesh; point spreads over a field need a PlanarObject"
            )
        self._hidden = optics.scene.hidden
        corners = {(float(x), float(y)) for y in (up[0], up[-1]) for x in (across[0], across[-1])}
        seen = [self._optics_at(place) for place in sorted(corners | {(0.0, 0.0)})]
        self.side = max(point_window(one, pitch, tol) for one in seen)
        self._found: dict[Place, PointSpread] = {}

    def _optics_at(self, place: Place) -> PointOptics:
        return self.optics.at(picture_point(self._hidden, *place))

    def _compute(self, place: Place) -> PointSpread:
        window = self.side, self.side
        return wall_image(self._optics_at(place), self.pitch, window, self.tol).run()[1]

    def at(self, places: list[Place], progress: Progress | None = None) -> list[PointSpread]:
        """Return the point spreads at coordinates across and up, -1 to 1, on all cores."""
        missing = [place for place in dict.fromkeys(places) if place not in self._found]
        done = worker_pool().map(carried(self._compute), missing)
        for number, (place, one) in enumerate(zip(missing, done, strict=True), 1):
            self._found[place] = one
            if progress is not None:
                progress("field", number / len(missing))
        return [self._found[place] for place in places]

    def field(
        self, grid: tuple[int, int], held_out: list[Place], progress: Progress | None = None
    ) -> PointSpreadField:
        """Return the field of a grid of (ny, nx) points, compared with the points held out."""
        ny, nx = grid
        up, across = picture_nodes(ny), picture_nodes(nx)
        fits_memory(
            f"{ny} x {nx} point spreads of {self.side} x {self.side} pixels",
            40.0 * ny * nx * self.side**2,
            "use a larger tol, or fewer nodes",
        )
        points = [(x, y) for y in up.tolist() for x in across.tolist()]
        found = self.at([*points, *held_out], progress)
        spreads = np.array([one.intensity.ravel() for one in found[: ny * nx]])
        modes, weights, lost = _compressed(spreads, self.tol)
        worst = max(one.error_estimate for one in found)
        field = PointSpreadField(
            modes=modes.reshape(-1, self.side, self.side),
            weights=np.ascontiguousarray(weights.T).reshape(-1, ny, nx),
            across=across,
            up=up,
            pitch=self.pitch,
            truncation_error=lost,
            error_estimate=lost,
        )
        errors = [lost]
        for (x, y), one in zip(held_out, found[ny * nx :], strict=True):
            miss = np.abs(field.point_spread(x, y) - one.intensity).max()
            errors.append(float(miss / one.intensity.max()))
        return replace(field, error_estimate=max(errors) + worst)


def _grid_counts(grid: int | tuple[int, int]) -> tuple[int, int]:
    """Check a grid; one number stands for both (ny, nx)."""
    counts = (grid, grid) if isinstance(grid, int) or is_single(grid) else grid
    if not hasattr(counts, "__len__") or len(counts) != 2:
        raise SceneError(f"grid = {grid!r}; give one whole number or (ny, nx)")
    ny, nx = (whole("grid", n, 1, 64) for n in counts)
    return ny, nx


def picture_nodes(count: int) -> Array:
    """Return increasing Chebyshev points of the first kind; the middle one of an odd count is 0."""
    nodes = -np.cos(np.pi * (np.arange(count) + 0.5) / count)
    if count % 2:
        nodes[count // 2] = 0.0
    return nodes


def chebyshev_weights(count: int, at: Array) -> Array:
    """Return Chebyshev interpolation weights (n, count) at points, clipped to [-1, 1]."""
    angles = np.pi * (np.arange(count) + 0.5) / count
    orders = np.arange(count)
    from_nodes = np.cos(orders[:, None] * (np.pi - angles)) * (2.0 / count)
    from_nodes[0] /= 2.0
    terms = np.cos(orders * np.arccos(np.clip(at, -1.0, 1.0))[:, None])
    return np.asarray(np.einsum("nj,jk->nk", terms, from_nodes))


def picture_point(hidden: PlanarObject, across: float, up: float) -> Array:
    """Return the world point, m, at the coordinates -1 to 1 of a planar object."""
    right, upward, _ = hidden.axes
    half = 0.5 * np.array(hidden.size)
    return np.asarray(hidden.position + across * half[0] * right + up * half[1] * upward)


def _compressed(spreads: Array, tol: float) -> tuple[Array, Array, float]:
    """Return the fewest modes (K, p) and their weights (n, K) within ``tol``, and their error.

    Both the largest error of a sample relative to the row's peak and the summed error relative to
    the row's sum are within ``tol``; the latter bounds the error of an image. The former is
    returned.
    """
    left, values, modes = np.linalg.svd(spreads, full_matrices=False)
    peaks, sums = spreads.max(axis=1), np.abs(spreads).sum(axis=1)
    rest = spreads.copy()
    for count in range(1, len(values) + 1):
        rest -= np.outer(left[:, count - 1] * values[count - 1], modes[count - 1])
        size = np.abs(rest)
        error = float((size.max(axis=1) / peaks).max())
        if max(error, float((size.sum(axis=1) / sums).max())) <= tol or count == len(values):
            break
    return np.ascontiguousarray(modes[:count]), left[:, :count] * values[:count], error
