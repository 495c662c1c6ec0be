"""The confocal light-cone transform: squares of distances make the capture a convolution."""

from __future__ import annotations

import math
import time
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, one_of, positive
from ..._progress import Progress
from ..capture.capture import TransientCapture
from .confocal_grids import (
    ConfocalGrid,
    confocal_grid,
    next_size,
    reached_volume,
    waves_along,
    waves_kind,
)
from .fk_migration import FALLOFF, Precision, Target
from .volume import Volume, VolumeImage

Array = NDArray[np.floating]
Waves = NDArray[np.complexfloating]
Penalty = Literal["size", "curvature"]

FINEST: Final = 2  # samples of the squared distance over bins, at most


def lct(
    capture: TransientCapture,
    volume: Volume | None = None,
    *,
    target: Target = "diffuse",
    snr: float = 1.0,
    penalty: Penalty = "size",
    dtype: Precision = "float32",
    progress: Progress | None = None,
) -> VolumeImage:
    """Picture of a hidden scene by the light-cone transform of a confocal capture.

    Parameters
    ----------
    capture : TransientCapture
        Confocal on an even grid [y, x] in z = 0, without outer legs and direct light.
    volume : Volume, optional
        Any even axes within the window of time; None: the grid's points at the bins' depths.
    target : {"diffuse", "retroreflective"}
        Whose light falls with the fourth power of the distance or with its square.
    snr : float
        Power of the signal over that of the noise, where the cone's mean power is 1.
    penalty : {"size", "curvature"}
        What Wiener's filter holds down: the albedo itself, ``1/snr`` at all frequencies, or its
        second derivatives, ``q^4/snr`` with q^2 the squared frequency over its mean.
    dtype : {"float32", "float64"}
        Of the waves; of float32 they err by about 1e-6 of the brightest voxel.
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    VolumeImage
        Albedo per unit of depth, linear in the capture; what the filter takes below 0 is 0, and
        ``details["below_zero"]`` says how much that was, over the sum of what is above.

    Raises
    ------
    SamplingError
        If the capture is not confocal on an even grid, or the volume is outside of what it covers.
    SceneError
        If direct light or outer legs are in, or light is below 0.
    MemoryLimitError
        If the spectrum would not fit.

    Notes
    -----
    With v the squared half path and u the squared depth, light times its falloff is the albedo in
    (x, y, u) convolved with ``delta(x^2 + y^2 - v)`` [1]_. That cone's spectrum over v is a product
    of one factor in x and one in y, Fresnel integrals over a cell, so it is never sampled.

    References
    ----------
    .. [1] O'Toole, Lindell, Wetzstein, Confocal non-line-of-sight imaging based on the light-cone
       transform, Nature 555, 338 (2018).
    """
    begun = time.perf_counter()
    one_of("target", target, FALLOFF)
    one_of("penalty", penalty, ("size", "curvature"))
    snr = positive("snr", snr)
    kind = waves_kind(dtype)
    grid = confocal_grid(capture, "lct")
    volume = reached_volume(grid, volume, "lct")
    squares = _squares(grid, volume)
    reach = sum((next_size(2 * len(a)) // 2 * (a[1] - a[0])) ** 2 for a in (grid.x, grid.y))
    # a cone that is wider than the padded axis would come in again at its start
    size = next_size(max(2 * len(squares), len(squares) + reach / (squares[1] - squares[0])))
    room = (size // 2 + 1) * (len(grid.x) * len(grid.y) + len(volume.x) * len(volume.y))
    room += (size + 4 * len(squares)) * len(grid.x) * len(grid.y) // 2
    fits_memory(
        "the light-cone transform",
        room * np.dtype(kind).itemsize,
        "gate the capture to the depths wanted, or make it coarser",
    )
    light = _over_squares(capture.H, grid, squares, FALLOFF[target], kind)
    found = _inverted(light, grid, volume, squares, size, snr, penalty, kind, progress)
    image = _over_depths(found, squares, volume)
    below = -float(image[image < 0.0].sum(dtype=np.float64))
    image = np.maximum(image, 0.0)
    above = float(image.sum(dtype=np.float64))
    details: dict[str, Any] = {"target": target, "snr": snr, "penalty": penalty}
    details |= {"dtype": dtype, "below_zero": below / above if above else 0.0}
    return VolumeImage(
        intensity=image,
        volume=volume,
        method="lct",
        seconds=time.perf_counter() - begun,
        details=details,
    )


def _squares(grid: ConfocalGrid, volume: Volume) -> Array:
    """(n,) evenly spaced middles of cells of squared distance, m^2, over window and volume.

    As fine as the bins at the nearest depth of the volume, within reason.
    """
    low, high = min(max(grid.start, 0.0), float(volume.z[0])) ** 2, grid.stop**2
    wanted = (high - low) / (2.0 * float(volume.z[0]) * grid.pitch)
    n = math.ceil(min(max(wanted, grid.n_bins), FINEST * grid.n_bins))
    return np.asarray(low + (np.arange(n) + 0.5) * ((high - low) / n))


def _over_squares(H: Array, grid: ConfocalGrid, squares: Array, power: int, kind: type) -> Array:
    """Light times falloff (n, ny, nx), each bin's shared among the squares that it covers."""
    from scipy.sparse import csr_array, diags_array

    step = squares[1] - squares[0]
    ends = np.sqrt(np.maximum(np.append(squares - 0.5 * step, squares[-1] + 0.5 * step), 0.0))
    # light up to each end: whole bins, and a share of the one that the end is in
    place = np.clip((ends - grid.start) / grid.pitch, 0.0, grid.n_bins)
    cuts = np.union1d(place, np.arange(grid.n_bins + 1))
    middles, shares = 0.5 * (cuts[1:] + cuts[:-1]), np.diff(cuts)
    row = np.searchsorted(place, middles) - 1
    inside = (row >= 0) & (row < len(squares))
    column = np.minimum(middles.astype(np.int64), grid.n_bins - 1)
    matrix = csr_array(
        (shares[inside], (row[inside], column[inside])), shape=(len(squares), grid.n_bins)
    )
    matrix = (matrix @ diags_array(grid.depths**power)).astype(
        np.float32 if kind is np.complex64 else np.float64
    )
    return np.asarray(matrix @ H.reshape(grid.n_bins, -1).astype(matrix.dtype)).reshape(
        len(squares), *H.shape[1:]
    )


def _cone(pitch: float, size: int, frequencies: Array) -> Waves:
    """Spectrum over u of the cone's factor along one axis, (n_f, size - 1) over its frequencies.

    The mean of ``exp(-2 pi i f s^2)`` over each cell of width ``pitch``, and its transform.
    """
    from scipy.special import fresnel

    ends = (np.arange(-(size // 2), size // 2 + 1) - 0.5) * pitch
    factor = np.ones((len(frequencies), size), dtype=np.complex128)
    scale = 2.0 * np.sqrt(frequencies[1:, None])
    sine, cosine = fresnel(scale * ends)
    factor[1:] = np.diff(cosine - 1j * sine, axis=1) / (scale * pitch)
    spectrum = np.fft.fftshift(np.fft.fft(np.fft.ifftshift(factor, axes=1), axis=1), axes=1)
    return np.asarray(spectrum[:, 1:])


def _inverted(
    light: Array,
    grid: ConfocalGrid,
    volume: Volume,
    squares: Array,
    size: int,
    snr: float,
    penalty: Penalty,
    kind: type,
    progress: Progress | None,
) -> Array:
    """Wiener's estimate (n, ny, nx) of the albedo over x and y of the volume and squared depth."""
    import scipy.fft

    step = squares[1] - squares[0]
    n_x, n_y = next_size(2 * len(grid.x)), next_size(2 * len(grid.y))
    kx, to_kx, from_kx = waves_along(grid.x, volume.x, n_x, kind)
    ky, to_ky, from_ky = waves_along(grid.y, volume.y, n_y, kind)
    frequencies = np.arange(size // 2 + 1) / (size * step)
    along_x = _cone(grid.x[1] - grid.x[0], n_x, frequencies)
    along_y = _cone(grid.y[1] - grid.y[0], n_y, frequencies)
    power_x, power_y = np.mean(np.abs(along_x) ** 2, axis=1), np.mean(np.abs(along_y) ** 2, axis=1)
    mean = float(np.mean(power_x * power_y))
    # lateral and squared-depth frequencies, each over its own Nyquist frequency
    lateral = (kx * 2 * (grid.x[1] - grid.x[0])) ** 2 + (
        (ky[:, None] * 2 * (grid.y[1] - grid.y[0])) ** 2
    )
    spectrum = scipy.fft.rfft(light, size, axis=0)
    found: Waves = np.empty((len(frequencies), len(volume.y), len(volume.x)), dtype=kind)
    for i, frequency in enumerate(frequencies):
        cone = along_y[i][:, None] * along_x[i]
        noise = mean / snr
        weight: Any = noise
        if penalty == "curvature":
            # three squares whose mean over a band is 1/3 each
            weight = noise * (lateral + (2.0 * frequency * step) ** 2) ** 2
            weight = np.maximum(weight, noise * np.finfo(np.float32).eps)
        wiener = (np.conj(cone) / (np.abs(cone) ** 2 + weight)).astype(kind)
        waves = (to_ky @ spectrum[i] @ to_kx.T) * wiener
        found[i] = from_ky @ waves @ from_kx.T
        if progress is not None and (i % 64 == 0 or i == len(frequencies) - 1):
            progress("light-cone transform", (i + 1) / len(frequencies))
    return np.asarray(scipy.fft.irfft(found, size, axis=0)[: len(squares)])


def _over_depths(found: Array, squares: Array, volume: Volume) -> Array:
    """The albedo over depth: that over squared depth between its samples, times du/dz = 2 z."""
    place = (volume.z**2 - squares[0]) / (squares[1] - squares[0])
    place = np.clip(place, 0.0, len(squares) - 1.0)  # half a cell beyond the outer middles
    cell = np.minimum(place.astype(np.int64), len(squares) - 2)
    part = (place - cell)[:, None, None].astype(found.dtype)
    between = found[cell] + part * (found[cell + 1] - found[cell])
    return np.asarray(between * (2.0 * volume.z)[:, None, None].astype(found.dtype))
