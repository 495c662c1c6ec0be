"""Preprocessing of captures: gating, binning, outer legs, moveout."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, expect, real, whole
from ...errors import SamplingError, SceneError
from .capture import TransientCapture
from .wall_points import UNEVEN, even_axes

Array = NDArray[np.floating]


def gated(
    capture: TransientCapture, *, start: float | None = None, stop: float | None = None
) -> TransientCapture:
    """Crop a capture to a range of optical path, for example to remove direct light.

    Direct light goes from the laser spot straight to the sensor, without the hidden scene.

    Parameters
    ----------
    capture : TransientCapture
        Capture to crop.
    start, stop : float, optional
        Start and end of the range to keep, m of optical path. None: no limit on that side. Bins
        that the range covers only in part are removed.

    Returns
    -------
    TransientCapture
        Capture with the bins in the range; ``t_start`` is the start of the first one.

    Raises
    ------
    SamplingError
        If the range contains no whole bin.

    See Also
    --------
    downsampled : Sum bins and average points.
    without_outer_legs : Subtract the paths from laser to wall and from wall to sensor.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, gated
    >>> capture = TransientCapture(
    ...     H=np.ones(100), laser_points=(0, 0, 0), sensor_points=(0.1, 0, 0), delta_t=0.02
    ... )
    >>> late = gated(capture, start=0.5)
    >>> late.n_bins, round(late.t_start, 3)
    (75, 0.5)
    """
    capture = expect("capture", capture, "TransientCapture")
    edges = capture.edges
    low = edges[0] if start is None else real("start", start)
    high = edges[-1] if stop is None else real("stop", stop)
    slack = 1e-6 * capture.delta_t  # edges have rounding errors
    first = int(np.searchsorted(edges, low - slack))
    last = int(np.searchsorted(edges, high + slack, side="right")) - 1
    if last <= first:
        raise SamplingError(
            f"gate from {low:g} to {high:g} m holds no bin of this capture, which covers "
            f"{edges[0]:g} to {edges[-1]:g} m in steps of {capture.delta_t:g} m; widen the gate"
        )
    return _mapped(capture, lambda h: h[first:last], t_start=float(edges[first]))


def downsampled(capture: TransientCapture, *, bins: int = 1, grid: int = 1) -> TransientCapture:
    """Reduce the resolution of a capture: sum neighbouring bins and average neighbouring points.

    Parameters
    ----------
    capture : TransientCapture
        Capture to reduce.
    bins : int
        Number of consecutive bins that are summed to one; 1 leaves the bins unchanged.
    grid : int
        Number of neighbouring wall points along each axis that are averaged to one, in position,
        normal and intensity. Axes with a single point are unchanged.

    Returns
    -------
    TransientCapture
        Capture with fewer, wider bins and fewer wall points.

    Raises
    ------
    SamplingError
        If the number of bins or points is not a multiple of ``bins`` or ``grid``.

    See Also
    --------
    gated : Crop a capture to a range of optical path.

    Notes
    -----
    Standard errors are combined as for independent values.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, downsampled, wall_grid
    >>> capture = TransientCapture(
    ...     H=np.ones((100, 4, 4)),
    ...     laser_points=(0, 0, 0),
    ...     sensor_points=wall_grid(side=1.0, count=4),
    ...     delta_t=0.02,
    ... )
    >>> downsampled(capture, bins=5, grid=2).H.shape
    (20, 2, 2)
    """
    capture = expect("capture", capture, "TransientCapture")
    bins, grid = whole("bins", bins), whole("grid", grid)
    if capture.n_bins % bins:
        raise SamplingError(
            f"the capture has {counted(capture.n_bins, 'bin')}, no multiple of bins = {bins}; "
            "crop the capture with transient.gated first"
        )
    shape = capture.H.shape[1:]
    odd = [n for n in shape if n > 1 and n % grid]
    if odd:
        raise SamplingError(
            f"{odd[0]} points along an axis are no multiple of grid = {grid}; give a divisor"
        )

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


def without_outer_legs(capture: TransientCapture) -> TransientCapture:
    """Subtract the paths from laser to wall and from wall to sensor from the times of a capture.

    Parameters
    ----------
    capture : TransientCapture
        Capture with ``laser_origin`` and ``sensor_origin``. If its times do not include these two
        paths (``outer_legs`` is False), it is returned unchanged.

    Returns
    -------
    TransientCapture
        Capture whose times begin at the laser point and end at the sensor point. The signal of each
        pair of points is shifted by the sum of its two paths, with linear interpolation between
        bins. Only bins that all pairs cover are kept, which leaves fewer bins. The first one begins
        at the old ``t_start`` minus the smallest of the sums.

    Raises
    ------
    SceneError
        If an origin is missing.
    SamplingError
        If no bin is covered by all pairs.

    See Also
    --------
    gated : Crop a capture to a range of optical path.
    fk_migration : Wave-based image of a confocal capture.
    lct : Albedo from a confocal capture.

    Notes
    -----
    Standard errors are interpolated like the values, which gives an upper bound.
    """
    capture = expect("capture", capture, "TransientCapture")
    if not capture.outer_legs:
        return capture
    legs = outer_legs(capture)
    steps = (legs - legs.min()) / capture.delta_t  # shift of each pair in bins, beyond the least
    whole_steps = np.floor(steps).astype(np.int64)
    part = steps - whole_steps
    n_bins = capture.n_bins - int(np.ceil(steps.max()))
    if n_bins < 1:
        raise SamplingError(
            f"the outer legs differ by {np.ptp(legs):g} m, limit {capture.n_bins - 1} bins of "
            f"{capture.delta_t:g} m; give a capture with more bins"
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


def normal_moveout(capture: TransientCapture) -> TransientCapture:
    """Convert a capture of a single laser point to a confocal one, by dip moveout.

    Light of a path t between two wall points comes from an ellipsoid with these as foci, which
    confocal spheres about the points between them touch. The light is spread over these spheres.
    Thus `fk_migration` and `lct` can image the capture.

    Parameters
    ----------
    capture : TransientCapture
        Capture with a single laser point and an even grid of sensor points, or the reverse. Outer
        legs are subtracted.

    Returns
    -------
    TransientCapture
        Confocal capture at the midpoints, which span half the side of the grid, with bins of the
        same width. Its values may be below 0, in arbitrary units; ``by_bounce`` and
        ``standard_error`` are not kept.

    Raises
    ------
    SamplingError
        If there are several laser points and several sensor points, or no even grid.

    See Also
    --------
    phasor_image : Image of the capture as it is.

    Notes
    -----
    Let s be the distance of both wall points and x that of a confocal point from their middle. The
    confocal path is ``sqrt((t^2 - s^2) (1 - 4 x^2/s^2))``, the normal moveout and the dip moveout
    of seismics [1]_. All sensor points along a line from the laser point through the confocal
    point count equally. Of the paths to one hidden point, the longest has its true distance, and
    the others trail before it as 1/sqrt(time); half a derivative over time makes this a pulse.

    References
    ----------
    .. [1] Hale, Dip-moveout by Fourier transform, Geophysics 49, 741 (1984).

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, normal_moveout, wall_grid
    >>> capture = TransientCapture(
    ...     H=np.ones((50, 8, 8)),
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=wall_grid(side=1.0, count=8),
    ...     delta_t=0.02,
    ...     t_start=1.0,
    ... )
    >>> confocal = normal_moveout(capture)
    >>> confocal.pairing, round(float(np.ptp(confocal.sensor_points[..., 0])), 4)
    ('confocal', 0.4375)
    """
    import scipy.fft

    from . import _moveout_kernels as kernels

    expect("capture", capture, "TransientCapture")
    capture = without_outer_legs(capture)
    lasers, sensors, width = capture.laser_points, capture.sensor_points, capture.delta_t
    alone, grid = (sensors, lasers) if sensors.size == 3 else (lasers, sensors)
    even = grid.ndim == 3 and min(grid.shape[:2]) > 1 and even_axes(grid)[2] <= UNEVEN
    if capture.pairing != "all" or alone.size > 3 or not even:
        raise SamplingError(
            f"normal_moveout needs a single laser point or a single sensor point and an even grid "
            f"(ny, nx) of the others, the capture has {lasers.shape[:-1]} and {sensors.shape[:-1]} "
            f"with pairing = {capture.pairing!r}; give the part of one laser point, or use "
            "phasor_image"
        )
    points = 0.5 * (alone.reshape(3) + grid)
    apart = float(straight_paths(capture).max())
    first = math.sqrt(max(float(capture.edges[0]) ** 2 - apart**2, 0.0))
    n_bins = math.ceil((capture.edges[-1] - first) / width - 1e-9)
    corner, pitch = (grid[0, 0] - alone.reshape(3))[:2], (grid[1, 1] - grid[0, 0])[:2]
    moved = np.empty((points[..., 0].size, n_bins))
    kernels.dip_moveout(
        np.ascontiguousarray(capture.H.reshape(capture.n_bins, *grid.shape[:2]).transpose(1, 2, 0)),
        corner,
        pitch,
        (points - alone.reshape(3)).reshape(-1, 3)[:, :2],
        0.5 * float(np.abs(pitch).min()),
        capture.t_start,
        width,
        first,
        moved,
    )
    size = scipy.fft.next_fast_len(2 * n_bins, real=True)
    waves = scipy.fft.rfft(moved, size) * np.sqrt(-1j * np.arange(size // 2 + 1))
    moved = scipy.fft.irfft(waves, size)[:, :n_bins].T
    return replace(
        capture,
        H=moved.reshape(n_bins, *grid.shape[:2]),
        laser_points=points,
        sensor_points=points,
        laser_normals=None,
        sensor_normals=None,
        t_start=first,
        pairing="confocal",
        quantity="unknown",
        by_bounce={},
        standard_error=None,
    )


def outer_legs(capture: TransientCapture) -> Array:
    """Return the length of the outer legs of every pair, m, shaped like ``capture.H[0]``.

    It is 0 if the times of the capture do not include outer legs.
    """
    shape = capture.H.shape[1:]
    if not capture.outer_legs:
        return np.zeros(shape)
    missing = [n for n in ("laser_origin", "sensor_origin") if getattr(capture, n) is None]
    if missing:
        raise SceneError(
            f"outer_legs = True and {' and '.join(missing)} not given, so the outer legs cannot "
            "be subtracted; give laser_origin and sensor_origin, or a capture without outer legs"
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


def straight_paths(capture: TransientCapture) -> Array:
    """Return the path of direct light for every pair, m: along the wall, and the outer legs."""
    if capture.pairing == "confocal":
        apart = np.linalg.norm(capture.laser_points - capture.sensor_points, axis=-1)
    else:
        lasers = capture.laser_points.reshape(-1, 1, 3)
        apart = np.linalg.norm(lasers - capture.sensor_points.reshape(1, -1, 3), axis=-1)
    return np.asarray(apart.reshape(capture.H.shape[1:]) + outer_legs(capture))


def _means(array: Array, first: int, last: int, count: int) -> Array:
    """Average blocks of ``count`` along axes ``first`` to ``last`` - 1, except axes of length 1."""
    for axis in range(first, last):
        shape = array.shape
        if shape[axis] == 1:
            continue
        array = array.reshape(*shape[:axis], -1, count, *shape[axis + 1 :]).mean(axis=axis + 1)
    return array


def _mapped(
    capture: TransientCapture, change: Callable[[Array], Array], **others: Any
) -> TransientCapture:
    """Apply a linear change to ``H``, ``by_bounce`` and ``standard_error`` of a capture."""
    error = capture.standard_error
    changed: dict[str, Any] = {
        "H": change(capture.H),
        "by_bounce": {n: change(h) for n, h in capture.by_bounce.items()},
        "standard_error": None if error is None else change(error),
    }
    return replace(capture, **(changed | others))
