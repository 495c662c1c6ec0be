"""Frequency-wavenumber (f-k) migration of confocal captures."""

from __future__ import annotations

import time
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, one_of
from ..._progress import Progress
from ...errors import SamplingError
from ..capture.capture import TransientCapture
from .confocal_grids import (
    ConfocalGrid,
    confocal_grid,
    next_size,
    reached_volume,
    waves_along,
    waves_kind,
)
from .gridding import PER_TAP, Gridding
from .volume import Volume, VolumeImage

Array = NDArray[np.floating]
Waves = NDArray[np.complexfloating]
Target = Literal["diffuse", "retroreflective"]
Precision = Literal["float32", "float64"]
Amplitude = Literal["root", "light", "albedo"]

#: Exponent of the falloff of a target's confocal intensity with distance.
FALLOFF: Final = {"diffuse": 4, "retroreflective": 2}

ROWS: Final = 8  # lateral frequencies along y per step, to bound the memory
TAPS: Final = 8
GRIDDING: Final = Gridding(TAPS, 2.0)


def fk_migration(
    capture: TransientCapture,
    volume: Volume | None = None,
    *,
    target: Target = "diffuse",
    amplitude: Amplitude = "root",
    dtype: Precision = "float32",
    progress: Progress | None = None,
) -> VolumeImage:
    """Reconstruct a hidden scene by frequency-wavenumber (f-k) migration of a confocal capture.

    The method treats the recorded light as a wave field on the wall and propagates it back to the
    time at which the hidden surfaces would have emitted it.

    Parameters
    ----------
    capture : TransientCapture
        Capture in which each wall point is observed only while it is lit (confocal), on an evenly
        spaced grid [y, x] in z = 0. It must not contain light that goes directly from the laser
        spot to the sensor (remove it with `gated`), nor must its times include the outer legs, the
        paths from laser to wall and from wall to sensor (remove them with `without_outer_legs`).
    volume : Volume, optional
        Voxels within the depths that the time window covers. None: the x and y of the grid's
        points, at the depths of the bins (half their optical path).
    target : {"diffuse", "retroreflective"}
        Kind of hidden surface. It sets the falloff of the intensity that is undone: the fourth or
        the second power of the distance.
    amplitude : {"root", "light", "albedo"}
        Wave to propagate back. "root": the square root of the falloff-corrected intensity [1]_,
        with its sign; the image scales linearly with the capture. "light": the corrected intensity
        itself; the waves of several objects then add linearly, and weak objects appear darker in
        the image. "albedo": its derivative over time, the wave of sources as strong as the albedo:
        sharper, and more sensitive to noise.
    dtype : {"float32", "float64"}
        Precision of the waves; the error of float32 is about 1e-6 of the brightest voxel.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    VolumeImage
        Squared modulus of the back-propagated wave in each voxel, (nz, ny, nx), in arbitrary units.

    Raises
    ------
    SamplingError
        If the capture is not confocal on an evenly spaced grid, the volume exceeds the covered
        range, or "albedo" has a single bin.
    SceneError
        If the capture has direct light, or its times include the outer legs.
    MemoryLimitError
        If spectrum and image exceed the free memory.

    See Also
    --------
    lct : Linear reconstruction of the albedo, with regularisation.
    phasor_image : For captures that are not confocal.

    Notes
    -----
    Let w be half the optical path, and Psi the spectrum of the amplitude on the wall over x, y and
    w, with the frequencies kx, ky and f, 1/m. The back-propagated wave is the sum over kx, ky and
    kz > 0 of ``Psi(kx, ky, f) (kz/f) exp(2 pi i (kx x + ky y + kz z))``, where
    ``f = sqrt(kx^2 + ky^2 + kz^2)`` [1]_. The grid of wall points is zero-padded to twice its
    width. Psi at these frequencies f is interpolated by gridding [2]_, to a relative error of 1e-6.

    References
    ----------
    .. [1] Lindell, Wetzstein, O'Toole, Wave-based non-line-of-sight imaging using fast f-k
       migration, ACM Trans. Graph. 38, 116 (2019).
    .. [2] Barnett, Magland, af Klinteberg, A parallel nonuniform fast Fourier transform library,
       SIAM J. Sci. Comput. 41, C479 (2019).

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, Volume, fk_migration, wall_grid
    >>> wall = wall_grid(side=1.0, count=16)
    >>> path = 2 * np.linalg.norm(wall - (0.1, 0.0, 0.6), axis=-1)  # echo of one point
    >>> capture = TransientCapture(
    ...     H=np.stack([path // 0.02 == k for k in range(80)]).astype(float),
    ...     laser_points=wall,
    ...     sensor_points=wall,
    ...     delta_t=0.02,
    ...     pairing="confocal",
    ... )
    >>> volume = Volume.box(centre=(0.0, 0.0, 0.6), size=(0.5, 0.5, 0.3), pitch=0.1)
    >>> image = fk_migration(capture, volume)
    >>> z, y, x = np.unravel_index(image.intensity.argmax(), volume.shape)
    >>> print(volume.points[z, y, x].round(3) + 0.0)
    [0.1 0.  0.6]
    """
    capture = expect("capture", capture, "TransientCapture")
    begun = time.perf_counter()
    one_of("target", target, FALLOFF)
    one_of("amplitude", amplitude, ("root", "light", "albedo"))
    kind = waves_kind(dtype)
    grid = confocal_grid(capture, "fk_migration")
    if amplitude == "albedo" and grid.n_bins < 2:
        raise SamplingError(
            "amplitude = 'albedo' is a derivative over time and needs 2 bins, the capture has 1; "
            "give amplitude='light'"
        )
    volume = reached_volume(grid, volume, "fk_migration")
    n = _depth_axis(grid, volume)[1]
    nz, ny, nx = volume.shape
    columns, n_f = len(grid.x) * len(grid.y), grid.n_bins + 2 * TAPS
    room = 3 * columns * n_f + 3 * nz * ny * nx + 2 * ROWS * 2 * len(grid.x) * (n_f + n)
    fits_memory(
        "f-k migration",
        float(room) * np.dtype(kind).itemsize + 16.0 * capture.H.size,
        "give a volume of fewer or larger voxels, or a coarser capture",
    )
    light = capture.H * grid.depths[:, None, None] ** FALLOFF[target]
    wave = np.sign(light) * np.sqrt(np.abs(light)) if amplitude == "root" else light
    if amplitude == "albedo":
        wave = np.gradient(light, grid.pitch, axis=0)
    field = _migrated(wave, grid, volume, kind, progress)
    intensity = field.real**2 + field.imag**2
    details = {"target": target, "amplitude": amplitude, "dtype": dtype}
    return VolumeImage(
        intensity=np.ascontiguousarray(intensity),
        volume=volume,
        method="fk_migration",
        seconds=time.perf_counter() - begun,
        details=details,
    )


def _migrated(
    wave: Array, grid: ConfocalGrid, volume: Volume, kind: type, progress: Progress | None
) -> Waves:
    """Return the complex wave (nz, ny, nx) at path length 0 in the voxels of ``volume``.

    ``wave`` (n_bins, ny, nx) is the amplitude on the wall, and ``kind`` the complex dtype.
    """
    import scipy.fft

    from . import _migration_kernels as kernels

    spectrum, size, centre = _gridded(wave, grid, kind)
    kx, to_kx, from_kx = waves_along(grid.x, volume.x, next_size(2 * len(grid.x)), kind)
    ky, to_ky, from_ky = waves_along(grid.y, volume.y, next_size(2 * len(grid.y)), kind)
    pitch, n = _depth_axis(grid, volume)
    n_waves = int(0.5 / grid.pitch * n * pitch) + 1
    nz, ny, nx = volume.shape
    n_rows, width, n_f = spectrum.shape
    scales = (n * pitch, grid.pitch, size, centre, volume.z[0])
    bell = (GRIDDING.table, TAPS, PER_TAP)
    field: Waves = np.zeros((ny, nx * nz), dtype=kind)
    for first in range(0, len(ky), ROWS):
        rows = slice(first, first + ROWS)
        waves = (to_ky[rows] @ spectrum.reshape(n_rows, -1)).reshape(-1, width, n_f)
        waves = np.matmul(to_kx, waves)
        deep: Waves = np.empty((len(waves), len(kx), n), dtype=kind)
        lateral_sq = ky[rows, None] ** 2 + kx**2
        kernels.stolt(waves, lateral_sq, scales, bell, n_waves, deep)
        deep = scipy.fft.ifft(deep, axis=2, overwrite_x=True)[:, :, :nz]
        part = np.matmul(from_kx, deep)  # (rows, nx, nz)
        field += from_ky[:, rows] @ part.reshape(len(part), -1)
        if progress is not None:
            progress("f-k migration", min(1.0, (first + ROWS) / len(ky)))
    return field.reshape(ny, nx, nz).transpose(2, 0, 1)


def _depth_axis(grid: ConfocalGrid, volume: Volume) -> tuple[float, int]:
    """Return the pitch, m, and the number of depth samples in one period along z.

    Waves beyond the period, 1.5 times the largest depth, wrap around.
    """
    pitch = float(volume.z[1] - volume.z[0]) if len(volume.z) > 1 else grid.pitch
    return pitch, next_size(1.5 * grid.stop / pitch)


def _gridded(wave: Array, grid: ConfocalGrid, kind: type) -> tuple[Waves, int, float]:
    """Return the oversampled spectrum over w, (ny, nx, n_f), for gridding by the kernel.

    Index m + TAPS is frequency m of the oversampled grid. Frequencies below 0 and above the
    Nyquist frequency are the complex conjugates implied by a real series. Also returned are the
    size of the oversampled grid and the depth at which its phase is 0.
    """
    import scipy.fft

    n_bins = grid.n_bins
    size = next_size(2 * max(n_bins, TAPS))
    middle = n_bins // 2
    series = wave.astype(np.float32 if kind is np.complex64 else np.float64)
    series = series * GRIDDING.correction((np.arange(n_bins) - middle) / size)[
        :, None, None
    ].astype(series.dtype)
    found = scipy.fft.rfft(np.ascontiguousarray(series.transpose(1, 2, 0)), size, axis=2)
    turns = np.arange(size // 2 + 1) * middle % size
    found *= np.exp(2j * np.pi * turns / size).astype(kind)
    below = found[:, :, TAPS:0:-1].conj()
    above = found[:, :, -2 : -2 - TAPS : -1].conj()
    return np.concatenate([below, found, above], axis=2), size, float(grid.depths[middle])
