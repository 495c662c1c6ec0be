"""Virtual cameras: a capture turned into what a lens in place of the relay wall would see."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, in_range, one_of, positive, real
from ..._progress import Progress
from ...errors import SamplingError, SceneError, ValidityWarning
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

CAMERAS = ("confocal_time_gated", "transient", "direct_light", "projector_camera")
#: Bytes of spectra that are held at once; more waves are done one slice after another.
SPECTRA = 2**29

#: Paths of a direct sum that cost as much as one number of a plane's transforms.
PATHS = 8


def phasor_image(
    capture: TransientCapture,
    volume: Volume,
    *,
    camera: Camera = "confocal_time_gated",
    wl_mean: float,
    wl_sigma: float | None = None,
    times: ArrayLike | None = None,
    laser: int | tuple[int, ...] | None = None,
    projector_focus: ArrayLike | None = None,
    aperture: float | ArrayLike | None = None,
    aperture_of: str = "both",
    weight: str = "unit",
    tol: float = 1e-3,
    method: str = "auto",
    dtype: str = "float64",
    device: str | None = None,
    progress: Progress | None = None,
) -> PhasorImage:
    """See a hidden volume with a virtual camera in place of the relay wall.

    With the virtual pulse ``K(t) = exp(2 pi i t/wl_mean - t^2/(2 wl_sigma^2))``, l over laser
    points and s over sensor points, the field at a voxel x is

    - "confocal_time_gated": ``sum_ls (H_ls * K)(|x-l| + |x-s| + t)``; the pulse and the camera are
      focused on x, which light reaches at t = 0;
    - "direct_light": the same at t = 0 and never at another time, so that only light that met the
      hidden scene once, at x, is in focus;
    - "transient": ``sum_s (H_ls * K)(|x-s| + t)`` for one laser point l: what a camera focused on x
      films while a pulse spreads that left l at t = 0;
    - "projector_camera": ``sum_ls (H_ls * K)(|p-l| + |x-s| + t)``: the pulse is focused on p, which
      it reaches at t = 0, the camera on every x.

    Parameters
    ----------
    capture : TransientCapture
        Its outer legs, where its times hold them, are taken away with its origins.
    volume : Volume
        Where to look, z > 0.
    camera : {"confocal_time_gated", "transient", "direct_light", "projector_camera"}
    wl_mean : float
        Virtual wavelength, m of optical path.
    wl_sigma : float, optional
        Standard deviation of the pulse, m of optical path; None: wl_mean/sqrt(2).
    times : array_like, optional
        (n_times,), m of optical path; "transient" needs them, None: t = 0.
    laser : int or tuple of int, optional
        Index of the laser point from which "transient" light comes, where there are several.
    projector_focus : array_like of 3 floats, optional
        p of "projector_camera", m.
    aperture : float or array_like of bool, optional
        Side of a square about the middle of the wall points, m, or which points of a grid to use.
        None: all. Single points are always used.
    aperture_of : {"both", "laser", "sensor"}
        Which points a square cuts.
    weight : {"unit", "inverse"}
        Of paths: equal, or 1/r for each leg, as in the Rayleigh-Sommerfeld integral.
    tol : float
        Of K's peak: error of K as a sum of waves. Costs as the square root of its logarithm, twice.
    method : {"auto", "fft", "direct"}
        "fft" wants planes with the pitch of the grid of sensors (or of lasers before one sensor),
        or one a whole multiple of the other; "auto" takes it where it can and where it is faster.
    dtype : {"float64", "float32"}
        Of the transforms; "direct" sums in float64 always.
    device : str, optional
        None: numba and FFT on the processor; else torch's name of a device, "cuda" or "cpu".
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    PhasorImage

    Raises
    ------
    SceneError
        If an argument is wrong or missing for this camera, or origins are needed and missing.
    SamplingError
        If the bins, the pairs or the grids cannot make this picture.
    MemoryLimitError
        If fields or spectra do not fit.

    Warns
    -----
    ValidityWarning
        Where the pitch, the bins or their window limit the picture; also in ``notes``.

    Notes
    -----
    Cameras after Liu et al., Nature 572, 620 (2019), and for the projector Marco et al., ICCV 2021.
    1/r and cosines along the real paths are not undone.
    """
    started = time.perf_counter()
    one_of("camera", camera, CAMERAS)
    one_of("method", method, ("auto", "fft", "direct"))
    one_of("dtype", dtype, ("float64", "float32"))
    one_of("weight", weight, ("unit", "inverse"))
    wl_mean = positive("wl_mean", wl_mean, unit="m")
    wl_sigma = wl_mean / np.sqrt(2.0) if wl_sigma is None else positive("wl_sigma", wl_sigma)
    tol = in_range("tol", tol, 1e-14, 0.1)
    volume.check_before_wall()
    moments = _times(camera, times)
    setup = camera_setup(capture, camera, laser, projector_focus, weight == "inverse")
    setup = setup.cut(*apertures(setup, aperture, aperture_of))
    first, last, sample = setup.paths(volume, moments)
    notes = _notes(capture, volume, setup, wl_mean, sample)
    grid, reason = _grid(setup, volume, wl_mean, method)
    band = pulse_band(capture, wl_mean, float(wl_sigma), (first, last), tol)
    _check_memory(setup, volume, grid, band, moments, dtype)
    field = _carry(capture, volume, setup, grid, band, moments, dtype, device, progress)
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
            "device": device or "processor",
            "weight": weight,
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
            raise SceneError("camera = 'transient' needs times, m of optical path since the laser")
        return np.zeros(1)
    if camera == "direct_light":
        raise SceneError(
            "camera = 'direct_light' is at t = 0; take 'confocal_time_gated' for times"
        )
    moments = real_array("times", times, ndmin=1)
    if moments.ndim != 1 or not len(moments):
        raise SamplingError(f"times have shape {moments.shape}, must be (n,), m")
    for value in moments:
        real("times", value)
    return moments


def _notes(
    capture: TransientCapture, volume: Volume, setup: Setup, wl_mean: float, sample: Array
) -> tuple[str, ...]:
    """Warn of each limit, and return them."""
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
    """The lattice for transforms, or None for direct sums, and why."""
    if method == "direct":
        return None, "asked for"
    try:
        if setup.legs.paired and not setup.legs.twice:
            raise SamplingError(
                "pairs of different laser and sensor points are no convolution; take "
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


def _slice(setup: Setup, grid: Lattice | None, n_waves: int, dtype: str) -> tuple[int, float]:
    """Waves that are carried at once, and the bytes that each of them needs."""
    size = 8 if dtype == "float32" else 16
    # two threads hold kernels and products of a plane each, beside the wall's transform
    numbers = max(setup.columns.size, 0 if grid is None else 8 * grid.size)
    return min(n_waves, max(1, int(SPECTRA // (size * numbers)))), float(size * numbers)


def _check_memory(
    setup: Setup, volume: Volume, grid: Lattice | None, band: Band, moments: Array, dtype: str
) -> None:
    size = 8 if dtype == "float32" else 16
    voxels = float(np.prod(volume.shape))
    fits_memory(
        f"a field at {len(moments)} times on {voxels:.3g} voxels",
        2.5 * size * len(moments) * voxels,
        "ask for fewer voxels or times",
    )
    n_waves, each = _slice(setup, grid, len(band.numbers), dtype)
    fits_memory(
        f"spectra of {setup.columns.size} pairs",
        3.0 * each * n_waves,
        "use a smaller aperture, or dtype='float32'",
    )


def _carry(
    capture: TransientCapture,
    volume: Volume,
    setup: Setup,
    grid: Lattice | None,
    band: Band,
    moments: Array,
    dtype: str,
    device: str | None,
    progress: Progress | None,
) -> ComplexArray:
    """(t, nz, ny, nx): the field, some waves after others."""
    n_waves = len(band.numbers)
    total: ComplexArray | None = None
    for kept in blocks(n_waves, _slice(setup, grid, n_waves, dtype)[0]):
        part = band.part(kept)
        spectra = _spectra(capture, setup, part, dtype)

        def advance(share: float, kept: slice = kept) -> None:
            if progress is not None:
                done = (kept.start + share * (kept.stop - kept.start)) / n_waves
                progress(f"waves {kept.start + 1} to {kept.stop} of {n_waves}", done)

        if device is not None:
            from . import _gpu

            field = _gpu.carry(volume, setup.legs, grid, part, spectra, moments, device, advance)
        elif grid is None:
            field = direct_sum(volume, setup.legs, part, spectra, moments, advance)
        else:
            field = plane_by_plane(volume, setup.legs, grid, part, spectra, moments, advance)
        total = field if total is None else total + field
    assert total is not None
    return total


def _spectra(capture: TransientCapture, setup: Setup, band: Band, dtype: str) -> ComplexArray:
    """(n, m, points): the camera's spectra, lasers summed where they are focused elsewhere."""
    columns, given = setup.columns, setup.given
    light = responses(capture, band, columns.ravel(), given.ravel(), dtype)
    light = light.reshape(len(light), *columns.shape)
    light[:, :, ~setup.used] = 0.0
    return light.sum(axis=1, keepdims=True) if setup.merged else light
