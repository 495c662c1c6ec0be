"""Light of the hidden scene in a capture: where it begins and ends, and the background under it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, real
from ...errors import SamplingError
from .capture import TransientCapture
from .preprocessing import straight_paths
from .wall_points import point_steps

Array = NDArray[np.floating]

#: Standard deviations by which light must exceed the background to be taken as the scene's.
CLEAR = 5.0


def hidden_light(capture: TransientCapture, *, start: float | None = None) -> TransientCapture:
    """Return the light of the hidden scene: direct light cut off, background subtracted.

    Paths are counted beyond the straight path from the laser point along the wall to the sensor
    point. Direct light begins there and fades. The scene's light begins at the least signal before
    the first rise that noise cannot explain, and ends with the last signal above the background.

    Parameters
    ----------
    capture : TransientCapture
        Capture with or without direct light, outer legs and dark counts.
    start : float, optional
        Begin of the scene's light, m of path beyond the straight path along the wall. None: from
        the capture.

    Returns
    -------
    TransientCapture
        Capture with the same points and bins; those before the scene's light and after it are 0.
        The mean of the bins without light is subtracted, of each pair as far as pairs differ beyond
        their noise, so that values may be below 0.
        ``details["hidden_light"]`` holds begin and end of the light, ``start`` and ``stop``, m, and
        the ``background`` per bin.

    Raises
    ------
    SamplingError
        If no light exceeds the background.

    See Also
    --------
    advise : Choose wavelength and volume for an image of this light.
    gated : Crop a capture to a range of optical path.

    Notes
    -----
    Counts, that is whole numbers, have the noise of photons; other values have the given standard
    errors, or none. A rise must exceed 5 standard deviations of the sum over all pairs, averaged
    over the bins of one pitch of the wall points. Light on the slope of brighter direct light makes
    no rise; give ``start`` then.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, hidden_light
    >>> counts = 50.0 * np.exp(-np.arange(100) / 5.0).round(1) + 2.0
    >>> counts[60:65] = 90.0
    >>> capture = TransientCapture(
    ...     H=counts, laser_points=(0, 0, 0), sensor_points=(0, 0, 0), delta_t=0.01
    ... )
    >>> light = hidden_light(capture)
    >>> print(light.H[[0, 50, 60, 64]])
    [ 0.  0. 88. 88.]
    """
    capture = expect("capture", capture, "TransientCapture")
    # bin, with fraction, at which direct light arrives at each pair
    lags = (straight_paths(capture) - capture.t_start) / capture.delta_t
    origin = float(lags.max())  # bins before path 0 of the latest pair
    signal, spread, near = _mean_signal(capture, lags)
    above = signal + CLEAR * spread  # beyond what noise explains
    if start is None:
        zero = int(np.argmax(signal[: near + 1]))  # the laser's own peak, if it is there
        later = above[zero:]
        lowest = np.minimum.accumulate(later)
        at = np.maximum.accumulate(np.where(later == lowest, np.arange(len(later)), 0))
        rises = np.flatnonzero(signal[zero:] > lowest)
        begin = zero + int(at[rises[0]]) if rises.size else len(signal)
    else:
        begin = int(np.ceil(real("start", start) / capture.delta_t + origin))
    after = np.arange(len(signal)) >= begin
    dark = after & (signal <= above[after].min(initial=np.inf))
    level = float(signal[dark].mean()) if dark.any() else 0.0
    lit = np.flatnonzero(after & (signal > level + CLEAR * spread))
    if not lit.size:
        raise SamplingError(
            f"the capture has no light of {CLEAR:g} standard deviations above its background; give "
            "a capture of more photons or an earlier start"
        )
    # index of each value in the signal
    bins = np.arange(capture.n_bins).reshape(-1, *[1] * lags.ndim) + (origin - lags).astype(int)
    end = int(lit[-1]) + 1
    rest = capture.H - level
    rest -= _own_levels(rest, np.append(dark, False)[np.minimum(bins, len(dark))])
    return replace(
        capture,
        H=np.where((bins >= begin) & (bins < end), rest, 0.0),
        quantity="unknown",
        by_bounce={},
        details=dict(capture.details)
        | {
            "hidden_light": {
                "start": (begin - origin) * capture.delta_t,
                "stop": (end - origin) * capture.delta_t,
                "background": level,
            }
        },
    )


def _own_levels(rest: Array, dark: NDArray[np.bool_]) -> Array:
    """Return the mean of each pair's dark values, shrunk to 0 as far as noise explains it.

    The best linear estimate of levels whose variance is that of the means beyond their noise.
    """
    count = np.maximum(dark.sum(axis=0), 1)
    own = rest.sum(axis=0, where=dark) / count
    noise = ((rest**2).sum(axis=0, where=dark) / count - own**2) / count
    spread = max(float(own.var() - noise.mean()), 0.0)
    return np.asarray(own * (spread / np.maximum(spread + noise, 1e-300)))


def pitch(capture: TransientCapture) -> float:
    """Return the largest distance of neighbouring points of the finer grid of a capture, m."""
    grids = (p for p in (capture.sensor_points, capture.laser_points) if p.ndim == 3)
    sides = [max(float(step.max()) for step in steps) for p in grids if (steps := point_steps(p))]
    return min(sides, default=0.0)


def counts_photons(capture: TransientCapture) -> bool:
    """Return whether all values are whole numbers of at least 0, as counts are."""
    return bool((capture.H >= 0.0).all() and (np.rint(capture.H) == capture.H).all())


def _mean_signal(capture: TransientCapture, lags: Array) -> tuple[Array, Array, int]:
    """Return mean signal, its spread, and the index one pitch after the straight path.

    Signal and spread are means over the pairs for each bin of path beyond the straight one.
    """
    offsets = (lags.max() - lags).astype(np.int64).ravel()
    sums = np.zeros((3, capture.n_bins + int(offsets.max())))
    counts = counts_photons(capture)
    error = capture.standard_error
    for k, light in enumerate(capture.H.reshape(capture.n_bins, -1)):
        noise = light if counts else 0.0 * light if error is None else error[k].ravel() ** 2
        for row, values in zip(sums, (light, noise, None), strict=True):
            row += np.bincount(offsets + k, weights=values, minlength=len(row))
    width = max(1, round(pitch(capture) / capture.delta_t))
    kernel, length = np.ones(width), capture.n_bins  # all pairs have a bin up to there
    total, variance, pairs = (np.convolve(row, kernel, mode="same")[:length] for row in sums)
    floor = 1.0 if counts else 0.0  # an empty bin may have held a photon
    spread = np.sqrt(np.maximum(variance, floor)) / pairs
    near = int(np.ceil(float(lags.max()))) + width
    return total / pairs, spread, min(max(near, 0), length - 1)
