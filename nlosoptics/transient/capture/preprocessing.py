"""What measured captures need before imaging: gates, coarser bins, blurs, weights, legs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import in_range, real, whole
from ...errors import SamplingError, SceneError
from .capture import TransientCapture

Array = NDArray[np.floating]


def gated(
    capture: TransientCapture, *, start: float | None = None, stop: float | None = None
) -> TransientCapture:
    """Crop a capture to a range of optical path, for example to remove direct light.

    Parameters
    ----------
    capture : TransientCapture
    start, stop : float, optional
        m of optical path; None: the capture's own. Bins that the gate cuts through are left out.

    Raises
    ------
    SamplingError
        If no whole bin is left.
    """
    edges = capture.edges
    low = edges[0] if start is None else real("start", start)
    high = edges[-1] if stop is None else real("stop", stop)
    slack = 1e-6 * capture.delta_t  # edges are sums of bins, which rounding moves
    first = int(np.searchsorted(edges, low - slack))
    last = int(np.searchsorted(edges, high + slack, side="right")) - 1
    if last <= first:
        raise SamplingError(
            f"gate from {low:g} to {high:g} m holds no bin of this capture, which covers "
            f"{edges[0]:g} to {edges[-1]:g} m; widen it"
        )
    return _mapped(capture, lambda h: h[first:last], t_start=float(edges[first]))


def downsampled(capture: TransientCapture, *, bins: int = 1, grid: int = 1) -> TransientCapture:
    """Sums over neighbouring bins, and means over neighbouring points of the grids.

    Parameters
    ----------
    capture : TransientCapture
    bins : int
        Bins that become one.
    grid : int
        Points along each axis of a grid that become one at their middle, with their mean light and
        normal. An axis of one point stays.

    Raises
    ------
    SamplingError
        If the bins or points cannot be shared out evenly.

    Notes
    -----
    Standard errors are added as those of independent values.
    """
    bins, grid = whole("bins", bins), whole("grid", grid)
    if capture.n_bins % bins:
        raise SamplingError(
            f"{capture.n_bins} bins are no multiple of bins = {bins}; gate the capture first"
        )
    shape = capture.H.shape[1:]
    odd = [n for n in shape if n > 1 and n % grid]
    if odd:
        raise SamplingError(f"{odd[0]} points along an axis are no multiple of grid = {grid}")

    def coarse(h: Array) -> Array:
        h = h.reshape(-1, bins, *h.shape[1:]).sum(axis=1)
        return _means(h, 1, h.ndim, grid)

    def points(p: Array) -> Array:
        return _means(p, 0, p.ndim - 1, grid)

    def normals(p: Array | None) -> Array | None:
        if p is None:
            return None
        mean = points(p)
        return np.asarray(mean / np.linalg.norm(mean, axis=-1, keepdims=True))

    error = capture.standard_error
    if error is not None:
        error = np.sqrt(coarse(error**2) / grid ** sum(n > 1 for n in shape))
    return _mapped(
        replace(capture, standard_error=None),
        coarse,
        delta_t=capture.delta_t * bins,
        laser_points=points(capture.laser_points),
        sensor_points=points(capture.sensor_points),
        laser_normals=normals(capture.laser_normals),
        sensor_normals=normals(capture.sensor_normals),
        standard_error=error,
    )


def smoothed(
    capture: TransientCapture, *, path: float = 0.0, grid: float = 0.0
) -> TransientCapture:
    """Light blurred by a Gaussian: as long as the detector's pulse, it holds down what is noise.

    Parameters
    ----------
    capture : TransientCapture
    path : float
        Standard deviation over time, m of optical path.
    grid : float
        The same along the axes of the grids of points, in steps between neighbours.

    Raises
    ------
    SceneError
        If a standard deviation is below 0, or the capture has standard errors, which neighbours
        would then share.

    Notes
    -----
    Beyond its ends a histogram or grid goes on with its outermost values.
    """
    from scipy.ndimage import gaussian_filter

    path, grid = in_range("path", path, 0.0, unit="m"), in_range("grid", grid, 0.0)
    if capture.standard_error is not None:
        raise SceneError(
            "smoothed makes standard errors depend on each other; give a capture without any"
        )
    sigma = [path / capture.delta_t, *[grid] * (capture.H.ndim - 1)]
    return _mapped(capture, lambda h: np.asarray(gaussian_filter(h, sigma, mode="nearest")))


def distance_weighted(capture: TransientCapture, power: float) -> TransientCapture:
    """Light times a power of half its path, m: 4 undoes the falloff of diffuse targets.

    Parameters
    ----------
    capture : TransientCapture
        Without outer legs.
    power : float
        2 for retro-reflective targets, whose light falls with the square of the distance.

    Raises
    ------
    SceneError
        If outer legs are in, or the first bin's middle is not above 0.
    """
    power = real("power", power)
    _inner(capture, "distance_weighted")
    half = 0.5 * capture.times
    if half[0] <= 0.0:
        raise SceneError(
            f"bin 0 is at a path of {capture.times[0]:g} m, must be above 0; gate the capture first"
        )
    weights = half**power
    return _mapped(capture, lambda h: h * weights.reshape(-1, *[1] * (h.ndim - 1)).astype(h.dtype))


def without_outer_legs(capture: TransientCapture) -> TransientCapture:
    """Times without the legs from the laser to the wall and from the wall to the sensor.

    Parameters
    ----------
    capture : TransientCapture
        One whose times have no outer legs comes back as it is.

    Returns
    -------
    TransientCapture
        ``t_start`` is earlier by the shortest legs; each bin's light is shared between the two bins
        that it comes to lie on. Light that falls before the last of the paths' first bins or after
        the first of their ends is cut, so that all paths cover the same times.

    Raises
    ------
    SceneError
        If the capture does not say where laser and sensor stand.
    SamplingError
        If no bin is left that all paths cover.

    Notes
    -----
    Standard errors are shared as the light is: they are upper bounds.
    """
    if not capture.outer_legs:
        return capture
    legs = outer_legs(capture)
    steps = (legs - legs.min()) / capture.delta_t  # each path goes back by this many bins more
    whole_steps = np.floor(steps).astype(np.int64)
    part = steps - whole_steps
    n_bins = capture.n_bins - int(np.ceil(steps.max()))
    if n_bins < 1:
        raise SamplingError(
            f"the outer legs differ by {np.ptp(legs):g} m, more than the capture's "
            f"{capture.n_bins * capture.delta_t:g} m; take more bins"
        )

    def shifted(h: Array) -> Array:
        flat = h.reshape(h.shape[0], -1)
        at, share = whole_steps.ravel(), part.ravel().astype(h.dtype)
        out = np.empty((n_bins, flat.shape[1]), dtype=h.dtype)
        for j in range(flat.shape[1]):
            own = flat[at[j] :, j]
            later = own[1 : n_bins + 1] if share[j] else own[:n_bins]
            out[:, j] = (1 - share[j]) * own[:n_bins] + share[j] * later
        return out.reshape(n_bins, *h.shape[1:])

    moved = _mapped(capture, shifted, t_start=capture.t_start - float(legs.min()))
    return replace(moved, outer_legs=False)


def outer_legs(capture: TransientCapture) -> Array:
    """Length of the outer legs of every path, m, of the shape of ``capture.H[0]``; 0 without.

    Raises
    ------
    SceneError
        If the times hold them and an origin is not known.
    """
    shape = capture.H.shape[1:]
    if not capture.outer_legs:
        return np.zeros(shape)
    missing = [n for n in ("laser_origin", "sensor_origin") if getattr(capture, n) is None]
    if missing:
        raise SceneError(
            f"outer_legs = True and {' and '.join(missing)} not given: the path outside cannot be "
            "taken away; give both origins, or times without these legs"
        )
    sides: list[Array] = []
    for name in ("laser", "sensor"):
        origin = getattr(capture, f"{name}_origin")
        points = getattr(capture, f"{name}_points")
        sides.append(np.linalg.norm(points - np.asarray(origin), axis=-1))
    first, last = sides
    if capture.pairing == "confocal":
        return np.asarray(first + last)
    return np.asarray(np.add.outer(first, last))


def _inner(capture: TransientCapture, what: str) -> None:
    if capture.outer_legs:
        raise SceneError(
            f"{what} needs times without the outer legs; call transient.without_outer_legs first"
        )


def _means(array: Array, first: int, last: int, count: int) -> Array:
    """Means over blocks of ``count`` along the axes from ``first`` up to ``last``, but of one."""
    for axis in range(first, last):
        shape = array.shape
        if shape[axis] == 1:
            continue
        array = array.reshape(*shape[:axis], -1, count, *shape[axis + 1 :]).mean(axis=axis + 1)
    return array


def _mapped(
    capture: TransientCapture, change: Callable[[Array], Array], **others: Any
) -> TransientCapture:
    """A capture whose histograms, parts and errors went through one linear change."""
    error = capture.standard_error
    changed: dict[str, Any] = {
        "H": change(capture.H),
        "by_bounce": {n: change(h) for n, h in capture.by_bounce.items()},
        "standard_error": None if error is None else change(error),
    }
    return replace(capture, **(changed | others))
