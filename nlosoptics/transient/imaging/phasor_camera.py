"""Phasor-field imaging: virtual cameras in place of the relay wall."""

from __future__ import annotations

import time
import warnings
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import counted, expect, fits_memory, in_range, one_of, positive, real
from ..._progress import Progress
from ...errors import PerformanceWarning, SamplingError, SceneError, ValidityWarning
from ..capture.capture import TransientCapture
from ..capture.wall_points import real_array
from . import camera_setup as validity
from .camera_setup import Setup, apertures, camera_setup
from .plane_convolutions import Lattice, lattice, plane_by_plane
from .rayleigh_sommerfeld import direct_sum
from .virtual_pulse import Band, blocks, pulse_band, responses
from .volume import Camera, PhasorImage, Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Bytes of spectra that are held at a time; further waves are processed slice by slice.
SPECTRA = 2**29

#: Number of paths in a direct sum that cost as much time as one element of a plane's transforms.
PATHS = 8
#: Products of voxels, wall points and waves beyond which a direct sum that transforms could replace
#: is warned of, and that a core sums in a second.
LARGE, SPEED = 1e9, 3.5e8


def phasor_image(
    capture: TransientCapture,
    volume: Volume,
    *,
    camera: Camera = "confocal_time_gated",
    wl_mean: float,
    wl_sigma: float | None = None,
    times: ArrayLike | None = None,
    aperture: float | None = None,
    tol: float = 1e-3,
    method: str = "auto",
    progress: Progress | None = None,
) -> PhasorImage:
    """Image a hidden volume by phasor fields: a virtual camera in place of the relay wall.

    The capture is convolved with a short pulse of a virtual wave, with a wavelength of centimetres
    to decimetres. The result is the wave that the wall would receive if the laser points emitted
    this pulse. As in a camera, the wave is then focused on each voxel.

    Times t are optical paths, m. The pulse is
    ``K(t) = exp(2 pi i t/wl_mean - t^2/(2 wl_sigma^2))``. Let l be a laser point, s a sensor point,
    ``H_ls`` the capture for this pair over time, ``*`` a convolution over time, and ``|x-l|`` the
    distance between two points. The field at a voxel x and a time t depends on the virtual camera:

    - "confocal_time_gated": ``sum_ls (H_ls * K)(|x-l| + |x-s| + t)``. Pulse and camera are focused
      on x, where the pulse arrives at t = 0.
    - "direct_light": the same at t = 0, so that light that the hidden scene has reflected once, at
      x, is in focus. It equals "confocal_time_gated" with ``times=None``.
    - "transient": ``sum_s (H_ls * K)(|x-s| + t)`` for the only laser point l. A camera focused on
      x films a pulse that leaves l at t = 0. Of a capture with several laser points, give the part
      of one, `TransientCapture.of_laser`.

    Parameters
    ----------
    capture : TransientCapture
        Capture of the relay wall. If its times include the outer legs (the paths from laser to wall
        and from wall to sensor), these are subtracted, which requires ``laser_origin`` and
        ``sensor_origin``.
    volume : Volume
        Voxels to image, in front of the wall, z > 0.
    camera : {"confocal_time_gated", "transient", "direct_light"}
        Virtual camera, one of the three described at the beginning.
    wl_mean : float
        Wavelength of the virtual wave, m; at least twice the spacing of the wall points (four times
        in confocal captures).
    wl_sigma : float, optional
        Standard deviation of the pulse, m of optical path. None: wl_mean/sqrt(2).
    times : array_like, optional
        Times t of the field, (n_times,), m of optical path. Required for "transient", not accepted
        for "direct_light". None: t = 0 alone.
    aperture : float, optional
        Part of the wall that is used: side of a square about the centre of the laser points and of
        the sensor points, m. None: all points. A single laser or sensor point is always used.
    tol : float
        Largest error of the computed pulse, relative to the peak of K, 1e-14 to 0.1. The pulse is
        computed as a sum of harmonic waves of different wavelengths. Their number, and with it the
        computing time, grows at most as log(1/tol). Transforms have single precision from 1e-5 on.
    method : {"auto", "fft", "direct"}
        "direct" sums over all paths. "fft" convolves plane by plane, usually much faster, and
        adds at most a tenth of ``tol`` to the error. For
        "fft", the x and y pitch of the volume must equal that of the sensor grid (of the laser grid
        if there is a single sensor point), or one must be a whole multiple of the other;
        `Volume.facing` makes such a volume. "auto" selects "fft" if possible and faster.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    PhasorImage
        Complex field on the volume, and intensity: the largest squared modulus of the field over
        the times. ``details["sum"]`` is the method used, "fft" or "direct".

    Raises
    ------
    SceneError
        If an argument is invalid or missing for this camera, or if positions of laser and sensor
        that are needed are missing.
    SamplingError
        If the bins, the pairs of points or the grids are unsuitable for this camera or method.
    MemoryLimitError
        If fields or spectra exceed the free memory.

    Warns
    -----
    ValidityWarning
        If the wall points are too far apart or the bins too wide for the wavelength, or if the bins
        leave out paths to some voxels. The texts are also in ``PhasorImage.notes``.
    PerformanceWarning
        If the voxels of a large volume do not lie on the grid of the wall points. Their values are
        then summed directly, which often takes a hundred times longer than by transforms.

    See Also
    --------
    depth_map : Depths of the image.
    fk_migration, lct, backprojection : Other reconstructions.

    Notes
    -----
    Transforms of up to 256 MB that depend on the volume are kept for the next capture of the same
    points, bins and wavelength, which then takes half to three quarters of the time.

    The cameras follow [1]_, where paths have equal weights, since 1/r varies little over the wall.
    The falloff of the real light with distance and its cosines are not compensated.

    References
    ----------
    .. [1] Liu et al., Non-line-of-sight imaging using phasor-field virtual wave optics, Nature 572,
       620 (2019).

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, Volume, phasor_image, wall_grid
    >>> wall = wall_grid(side=1.0, count=16)
    >>> path = 2 * np.linalg.norm(wall - (0.1, 0.0, 0.6), axis=-1)  # echo of one point
    >>> capture = TransientCapture(
    ...     H=np.stack([path // 0.02 == k for k in range(120)]).astype(float),
    ...     laser_points=wall,
    ...     sensor_points=wall,
    ...     delta_t=0.02,
    ...     pairing="confocal",
    ... )
    >>> volume = Volume.box(centre=(0.0, 0.0, 0.6), size=(0.5, 0.5, 0.3), pitch=0.1)
    >>> image = phasor_image(capture, volume, wl_mean=0.3)
    >>> z, y, x = np.unravel_index(image.intensity.argmax(), volume.shape)
    >>> print(volume.points[z, y, x].round(3) + 0.0)
    [0.1 0.  0.6]
    """
    capture = expect("capture", capture, "TransientCapture")
    volume = expect("volume", volume, "Volume")
    started = time.perf_counter()
    one_of("camera", camera, get_args(Camera))
    one_of("method", method, ("auto", "fft", "direct"))
    wl_mean = positive("wl_mean", wl_mean, unit="m")
    wl_sigma = wl_mean / np.sqrt(2.0) if wl_sigma is None else positive("wl_sigma", wl_sigma)
    tol = in_range("tol", tol, 1e-14, 0.1)
    # single precision errs by about 1e-6
    dtype = "float32" if tol >= 1e-5 and method != "direct" else "float64"
    volume.check_before_wall()
    moments = _times(camera, times)
    setup = camera_setup(capture, camera)
    setup = setup.cut(*apertures(setup, aperture))
    first, last, sample = setup.paths(volume, moments)
    notes = _notes(capture, volume, setup, wl_mean, sample)
    grid, reason = _grid(setup, volume, wl_mean, method)
    band = pulse_band(capture, wl_mean, float(wl_sigma), (first, last), tol)
    _check_memory(setup, volume, band, moments, dtype)
    paths = volume.points.size / 3 * len(setup.legs.near)
    asked = reason in ("requested", "few voxels")
    work = paths * len(band.numbers)
    if grid is None and not asked and work > LARGE:
        warnings.warn(
            f"{reason}. Each path is summed, about {work / SPEED:.2g} s of a core, often a hundred "
            "times the work of transforms; method='direct' sums without this warning",
            PerformanceWarning,
            stacklevel=2,
        )
    field = _carry(capture, volume, setup, grid, band, moments, (dtype, tol), progress)
    light = (field.real**2 + field.imag**2).max(axis=0)
    return PhasorImage(
        intensity=light,
        volume=volume,
        method=f"phasor field, {camera}",
        seconds=time.perf_counter() - started,
        details={
            "sum": "direct" if grid is None else "fft",
            "reason": reason,
            "n_waves": len(band.numbers),
            "bins": (band.bins.start, band.bins.stop),
            "tol": tol,
            "dtype": dtype,
        },
        field=field[0] if times is None else field,
        camera=camera,
        wl_mean=wl_mean,
        wl_sigma=float(wl_sigma),
        times=None if times is None else moments,
        aperture=aperture,
        notes=notes,
    )


def _times(camera: str, times: Any) -> Array:
    if times is None:
        if camera == "transient":
            raise SceneError(
                "camera = 'transient' needs times; give m of optical path after the laser point"
            )
        return np.zeros(1)
    if camera == "direct_light":
        raise SceneError(
            "camera = 'direct_light' is at t = 0; omit times, or give 'confocal_time_gated'"
        )
    moments = real_array("times", times, ndmin=1)
    if moments.ndim != 1 or not len(moments):
        raise SamplingError(f"times have shape {moments.shape}, must be (n,); give a list in m")
    for value in moments:
        real("times", value)
    return moments


def _notes(
    capture: TransientCapture, volume: Volume, setup: Setup, wl_mean: float, sample: Array
) -> tuple[str, ...]:
    """Warn of each limit of the sampling that the image exceeds, and return the messages."""
    ways = 2 if setup.legs.twice else 1
    found = [
        validity.grid_note(f"{setup.sides[0]} points", setup.grid, wl_mean, ways),
        validity.bin_note(capture.delta_t, wl_mean),
        validity.window_note(capture, volume, sample),
    ]
    if len(setup.far_shape) == 2:
        points = capture.laser_points
        found.append(validity.grid_note(f"{setup.sides[1]} points", points, wl_mean, 1))
    notes = tuple(note for note in found if note)
    for note in notes:
        warnings.warn(note, ValidityWarning, stacklevel=3)
    return notes


def _grid(setup: Setup, volume: Volume, wl_mean: float, method: str) -> tuple[Lattice | None, str]:
    """Return the lattice for FFT convolutions, or None for direct sums, and the reason."""
    if method == "direct":
        return None, "requested"
    try:
        if setup.legs.paired and not setup.legs.twice:
            raise SamplingError(
                "pairs with different laser and sensor points have no convolution; give "
                "method='direct'"
            )
        grid = lattice(setup.grid, volume, wl_mean)
        paths = volume.shape[1] * volume.shape[2] * len(setup.legs.near)
        if method == "auto" and paths < PATHS * grid.size:
            return None, "few voxels"
        return grid, "planes and wall share a grid"
    except SamplingError as error:
        if method == "fft":
            raise
        return None, str(error)


def _slice(setup: Setup, n_waves: int, dtype: str) -> tuple[int, float]:
    """Return how many waves are propagated at a time, and the bytes per wave."""
    size = setup.columns.size * (8 if dtype == "float32" else 16)
    return min(n_waves, max(1, SPECTRA // size)), float(size)


def _check_memory(setup: Setup, volume: Volume, band: Band, moments: Array, dtype: str) -> None:
    voxels = float(np.prod(volume.shape))
    fits_memory(
        f"a field at {counted(len(moments), 'time')} on {voxels:.3g} voxels",
        52.0 * len(moments) * voxels,  # the result has double precision in any case
        "ask for fewer voxels or times",
    )
    n_waves, each = _slice(setup, len(band.numbers), dtype)
    fits_memory(
        f"spectra of {counted(setup.columns.size, 'pair')}",
        3.0 * each * n_waves,
        "use a smaller aperture, or a larger tol",
    )


def _carry(
    capture: TransientCapture,
    volume: Volume,
    setup: Setup,
    grid: Lattice | None,
    band: Band,
    moments: Array,
    precision: tuple[str, float],
    progress: Progress | None,
) -> ComplexArray:
    """Return the field (t, nz, ny, nx), summed over slices of waves to bound the memory."""
    n_waves, (dtype, tol) = len(band.numbers), precision
    total: ComplexArray | None = None
    for kept in blocks(n_waves, _slice(setup, n_waves, dtype)[0]):
        part = band.part(kept)
        spectra = _spectra(capture, setup, part, dtype)

        def advance(share: float, kept: slice = kept) -> None:
            if progress is not None:
                done = (kept.start + share * (kept.stop - kept.start)) / n_waves
                progress(f"waves {kept.start + 1} to {kept.stop} of {n_waves}", done)

        if grid is None:
            field = direct_sum(volume, setup.legs, part, spectra, moments, advance)
        else:
            field = plane_by_plane(
                volume, setup.legs, grid, band, kept, spectra, moments, tol, advance
            )
        total = field if total is None else total + field
    assert total is not None
    return total


def _spectra(capture: TransientCapture, setup: Setup, band: Band, dtype: str) -> ComplexArray:
    """Return the spectra (n, m, points) of m far points."""
    columns, given = setup.columns, setup.given
    light = responses(capture, band, columns.ravel(), given.ravel(), dtype)
    light = light.reshape(len(light), *columns.shape)
    light[:, :, ~setup.used] = 0.0
    return light
