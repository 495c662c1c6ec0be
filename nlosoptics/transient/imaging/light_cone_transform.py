"""Light-cone transform of confocal captures, a convolution in squared distances."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, one_of, positive
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


def lct(
    capture: TransientCapture,
    volume: Volume | None = None,
    *,
    target: Target = "diffuse",
    snr: float = 1.0,
    dtype: Precision = "float32",
    progress: Progress | None = None,
) -> VolumeImage:
    """Reconstruct a hidden scene by the light-cone transform (LCT) of a confocal capture.

    In squared times and squared depths, a confocal capture is the hidden albedo convolved with a
    known kernel. A Wiener filter inverts this convolution.

    Parameters
    ----------
    capture, volume, target, dtype, progress
        As in `fk_migration`: confocal capture on an evenly spaced grid, without direct light and
        outer legs; voxels; kind of hidden surface, "diffuse" or "retroreflective"; precision; and
        progress callback.
    snr : float
        Assumed ratio of signal to noise power, above 0. A larger value gives a sharper image with
        more noise. The kernel passes some frequencies better than others, so that the ratio depends
        on the frequency. ``snr`` is the ratio at frequencies at which the power of the kernel
        equals its mean over all frequencies.

    Returns
    -------
    VolumeImage
        Albedo per unit depth in each voxel, in arbitrary units. It is linear in the capture, except
        that negative values are set to 0; ``details["below_zero"]`` is their sum relative to the
        sum of the positive ones.

    Raises
    ------
    SamplingError, SceneError, MemoryLimitError
        As by `fk_migration`.

    See Also
    --------
    fk_migration : Wave-based reconstruction without regularisation, called in the same way.
    backprojection : For any pairing and any grid.

    Notes
    -----
    Let v be the square of half the optical path and u the squared depth. The falloff-corrected
    capture, over x, y and v, is then the albedo, over x, y and u, convolved with the kernel
    ``delta(x^2 + y^2 - v)``, the light cone [1]_. The Fourier transform of the cone over v is the
    product of a factor in x and a factor in y. The mean of each factor over a grid cell follows
    from Fresnel integrals. The infinitely thin cone itself is therefore never sampled.

    References
    ----------
    .. [1] O'Toole, Lindell, Wetzstein, Confocal non-line-of-sight imaging based on the light-cone
       transform, Nature 555, 338 (2018).
    """
    capture = expect("capture", capture, "TransientCapture")
    begun = time.perf_counter()
    one_of("target", target, FALLOFF)
    snr = positive("snr", snr)
    kind = waves_kind(dtype)
    grid = confocal_grid(capture, "lct")
    volume = reached_volume(grid, volume, "lct")
    squares = _squares(grid, volume)
    reach = sum((next_size(2 * len(a)) // 2 * (a[1] - a[0])) ** 2 for a in (grid.x, grid.y))
    # a cone longer than the padded axis would wrap around
    size = next_size(max(2 * len(squares), len(squares) + reach / (squares[1] - squares[0])))
    nz, ny, nx = volume.shape
    room = (size // 2 + 1) * (len(grid.x) * len(grid.y) + 2 * ny * nx) + 2 * nz * ny * nx
    room += (size + 4 * len(squares)) * len(grid.x) * len(grid.y) // 2
    fits_memory(
        "the light-cone transform",
        room * np.dtype(kind).itemsize,
        "gate the capture to the required depths, or make it coarser",
    )
    light = _over_squares(capture.H, grid, squares, FALLOFF[target], kind)
    found = _inverted(light, grid, volume, squares, size, snr, kind, progress)
    image = _over_depths(found, squares, volume)
    below = -float(image[image < 0.0].sum(dtype=np.float64))
    image = np.maximum(image, 0.0)
    above = float(image.sum(dtype=np.float64))
    details: dict[str, Any] = {"target": target, "snr": snr}
    details |= {"dtype": dtype, "below_zero": below / above if above else 0.0}
    return VolumeImage(
        intensity=image,
        volume=volume,
        method="lct",
        seconds=time.perf_counter() - begun,
        details=details,
    )


def _squares(grid: ConfocalGrid, volume: Volume) -> Array:
    """Return the centres (n,) of even cells of squared distance, m^2, over window and volume.

    Cells are as fine as the bins at the nearest depth of the volume, with at most two per bin.
    """
    low, high = min(max(grid.start, 0.0), float(volume.z[0])) ** 2, grid.stop**2
    wanted = (high - low) / (2.0 * float(volume.z[0]) * grid.pitch)
    n = math.ceil(min(max(wanted, grid.n_bins), 2 * grid.n_bins))
    return np.asarray(low + (np.arange(n) + 0.5) * ((high - low) / n))


def _over_squares(H: Array, grid: ConfocalGrid, squares: Array, power: int, kind: type) -> Array:
    """Return the falloff-corrected capture over squared distance, (n, ny, nx).

    Each bin is distributed over the cells that it overlaps.
    """
    from scipy.sparse import csr_array, diags_array

    step = squares[1] - squares[0]
    ends = np.sqrt(np.maximum(np.append(squares - 0.5 * step, squares[-1] + 0.5 * step), 0.0))
    # position of each cell's end in units of bins
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
    """Return the cone's spectrum along one lateral axis, (n_f, size - 1).

    Rows are frequencies f over u, 1/m^2, columns lateral frequencies. It is the transform of
    ``exp(-2 pi i f s^2)``, averaged over cells of width ``pitch``, m.
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
    kind: type,
    progress: Progress | None,
) -> Array:
    """Return the Wiener estimate (n, ny, nx) of the albedo over squared depth, y and x."""
    import scipy.fft

    step = squares[1] - squares[0]
    n_x, n_y = next_size(2 * len(grid.x)), next_size(2 * len(grid.y))
    _, to_kx, from_kx = waves_along(grid.x, volume.x, n_x, kind)
    _, to_ky, from_ky = waves_along(grid.y, volume.y, n_y, kind)
    frequencies = np.arange(size // 2 + 1) / (size * step)
    along_x = _cone(grid.x[1] - grid.x[0], n_x, frequencies)
    along_y = _cone(grid.y[1] - grid.y[0], n_y, frequencies)
    power_x, power_y = np.mean(np.abs(along_x) ** 2, axis=1), np.mean(np.abs(along_y) ** 2, axis=1)
    mean = float(np.mean(power_x * power_y))
    spectrum = scipy.fft.rfft(light, size, axis=0)
    found: Waves = np.empty((len(frequencies), len(volume.y), len(volume.x)), dtype=kind)
    for i in range(len(frequencies)):
        cone = along_y[i][:, None] * along_x[i]
        wiener = (np.conj(cone) / (np.abs(cone) ** 2 + mean / snr)).astype(kind)
        waves = (to_ky @ spectrum[i] @ to_kx.T) * wiener
        found[i] = from_ky @ waves @ from_kx.T
        if progress is not None and (i % 64 == 0 or i == len(frequencies) - 1):
            progress("light-cone transform", (i + 1) / len(frequencies))
    return np.asarray(scipy.fft.irfft(found, size, axis=0)[: len(squares)])


def _over_depths(found: Array, squares: Array, volume: Volume) -> Array:
    """Return the albedo per depth: interpolated over squared depth, times du/dz = 2 z."""
    place = (volume.z**2 - squares[0]) / (squares[1] - squares[0])
    place = np.clip(place, 0.0, len(squares) - 1.0)  # depths in the outer half of an end cell
    cell = np.minimum(place.astype(np.int64), len(squares) - 2)
    part = (place - cell)[:, None, None].astype(found.dtype)
    between = found[cell] + part * (found[cell + 1] - found[cell])
    return np.asarray(between * (2.0 * volume.z)[:, None, None].astype(found.dtype))
