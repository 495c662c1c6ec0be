"""Even grids of confocal captures, and the checks of the Fourier methods that need them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, one_of
from ...errors import SamplingError, SceneError
from ..capture.capture import TransientCapture
from ..capture.preprocessing import straight_paths
from ..capture.wall_points import UNEVEN, even_axes
from .volume import Volume

Array = NDArray[np.floating]

#: Fraction of the total at the shortest possible paths from which on a capture is refused.
DIRECT_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class ConfocalGrid:
    """Even grid of confocal wall points in z = 0, with the time axis as half the optical path."""

    x: Array  # (nx,) and (ny,): coordinates of the points, m
    y: Array
    start: float  # Start of bin 0 and width of the bins, m of half the optical path
    pitch: float
    n_bins: int  # Number of bins

    @property
    def depths(self) -> Array:
        """Centres of the bins, (n_bins,), m of half the optical path."""
        return self.start + self.pitch * (np.arange(self.n_bins) + 0.5)

    @property
    def stop(self) -> float:
        """End of the last bin, m of half the optical path."""
        return self.start + self.pitch * self.n_bins

    def volume(self) -> Volume:
        """Return voxels in front of the points, at all depths of bins above 0."""
        depths = self.depths
        return Volume(self.x, self.y, depths[depths > 0.0])


def confocal_grid(capture: TransientCapture, method: str) -> ConfocalGrid:
    """Return the even confocal grid of a capture, or raise if it has none."""
    if not capture.is_confocal:
        raise SamplingError(
            f"{method} needs a confocal capture with equal laser and sensor points, this one has "
            f"pairing = {capture.pairing!r}; use backprojection or phasor_image"
        )
    if capture.outer_legs:
        raise SceneError(
            f"{method} needs times without the outer legs; call transient.without_outer_legs first"
        )
    points = capture.sensor_points
    if points.ndim != 3 or min(points.shape[:2]) < 2:
        raise SamplingError(
            f"{method} needs a grid of points (ny, nx), at least 2 x 2, sensor points have shape "
            f"{capture.sensor_shape}; use backprojection"
        )
    x, y, off = even_axes(points)
    pitch = min(x[1] - x[0], y[1] - y[0])
    away = max(off * abs(pitch), float(np.abs(points[..., 2]).max()))
    if pitch <= 0.0 or away > UNEVEN * pitch:
        raise SamplingError(
            f"{method} needs an even grid [y, x] in z = 0 with x and y rising, sensor points "
            f"deviate by up to {away:.3g} m; use backprojection"
        )
    refuse_direct_light(capture, method)
    return ConfocalGrid(x, y, 0.5 * capture.t_start, 0.5 * capture.delta_t, capture.n_bins)


def refuse_direct_light(capture: TransientCapture, method: str) -> None:
    """Raise `SceneError` if the capture contains direct light from the laser's spot.

    Values up to two bins after the straight path along the wall cannot come from a hidden object.
    Dark counts are constant over time: the mean of the darkest time interval is subtracted, and
    its noise is allowed for.
    """
    n_bins, n_paths = capture.n_bins, max(1, capture.H[0].size)
    shortest = (straight_paths(capture).ravel() - capture.t_start) / capture.delta_t
    ends = np.clip(np.floor(shortest) + 2, 0, n_bins).astype(np.int64)
    if not ends.any():
        return
    # sum, sum of squares and number of paths for each bin: up to the path along the wall, and later
    sums = np.zeros((2, 3, n_bins))
    for k, light in enumerate(np.abs(bins) for bins in capture.H.reshape(n_bins, n_paths)):
        for part, chosen in zip(sums, (ends > k, ends <= k), strict=True):
            some = light[chosen].astype(np.float64)
            part[:, k] = some.sum(), some @ some, some.size
    level, spread = _dark_level(*sums[1])
    open_bins = sums[:, 0].sum(axis=0) > 0.0  # a closed gate blocks dark counts, too
    direct, total = (
        float(part[0].sum() - level * part[2, open_bins].sum()) for part in (sums[0], sums.sum(0))
    )
    chance = 4.0 * spread * math.sqrt(sums[0, 2, open_bins].sum())
    if direct > DIRECT_SHARE * max(total, 0.0) + chance:
        raise SceneError(
            f"{method}: {100 * direct / max(total, direct):.2g} % of the capture is direct light "
            f"from the lit point itself, limit {100 * DIRECT_SHARE:g} %; remove it with "
            "transient.gated(capture, start=...)"
        )


def _dark_level(light: Array, squares: Array, count: Array) -> tuple[float, float]:
    """Return mean and standard deviation per path and bin of the darkest of 16 time intervals.

    Bins without any counts are ignored; a gate may have been closed there.
    """
    lit = np.flatnonzero(light > 0.0)
    if not lit.size:
        return 0.0, 0.0
    starts = np.unique(np.linspace(0, lit.size, 16, endpoint=False).astype(np.int64))
    sums = [np.add.reduceat(values[lit], starts) for values in (light, squares, count)]
    means = sums[0] / sums[2]
    darkest = int(means.argmin())
    variance = sums[1][darkest] / sums[2][darkest] - means[darkest] ** 2
    return float(means[darkest]), math.sqrt(max(float(variance), 0.0))


def reached_volume(grid: ConfocalGrid, volume: Volume | None, method: str) -> Volume:
    """Return the volume, by default the grid's own, after checking that the capture covers it."""
    if volume is None:
        volume = grid.volume()
    expect("volume", volume, "Volume")
    low, high = float(volume.z[0]), float(volume.z[-1])
    # oblique paths across the whole grid still record points nearer than the first bin
    aslant = float(np.ptp(grid.x) ** 2 + np.ptp(grid.y) ** 2)
    nearest = math.sqrt(max(grid.start**2 - aslant, 0.0)) if grid.start > 0.0 else 0.0
    slack = 1e-6 * grid.pitch
    volume.check_before_wall()
    if low < nearest - slack or high > grid.stop + slack:
        raise SamplingError(
            f"{method}: the volume's depths {low:g} to {high:g} m are not within the "
            f"{nearest:g} to {grid.stop:g} m that the time window covers; change the volume or "
            "capture more bins"
        )
    for name, own, asked in (("x", grid.x, volume.x), ("y", grid.y, volume.y)):
        width = (own[1] - own[0]) * len(own)
        middle = 0.5 * (own[0] + own[-1])
        off = max(abs(asked[0] - middle), abs(asked[-1] - middle))
        if off > 0.75 * width:
            raise SamplingError(
                f"{method}: the volume extends {off:g} m from the grid's centre along {name}, "
                f"limit {0.75 * width:g} m; make it smaller or use backprojection"
            )
    return volume


def next_size(count: float) -> int:
    """Return the least even length of at least ``count`` with a fast Fourier transform."""
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len(math.ceil(count / 2)))


def waves_kind(dtype: str) -> type:
    """Return the complex type for real and imaginary parts of type "float32" or "float64"."""
    name = one_of("dtype", dtype, ("float32", "float64"))
    return np.complex64 if name == "float32" else np.complex128


def waves_along(
    own: Array, asked: Array, size: int, kind: type
) -> tuple[Array, NDArray[np.complexfloating], NDArray[np.complexfloating]]:
    """Return the lateral frequencies of a padded axis and the matrices of both transforms.

    Returns frequencies (size - 1,), 1/m; forward matrix (size - 1, n); inverse matrix (m, size -
    1).
    """
    pitch = own[1] - own[0]
    frequencies = np.arange(-(size // 2) + 1, size // 2) / (size * pitch)
    there = np.exp(-2j * np.pi * frequencies[:, None] * (own - own[0]))
    back = np.exp(2j * np.pi * (asked[:, None] - own[0]) * frequencies) / size
    return frequencies, there.astype(kind), back.astype(kind)
