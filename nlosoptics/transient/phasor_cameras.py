"""Virtual cameras: a capture turned into what a lens in place of the relay wall would see."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory, in_range, is_single, one_of, positive, real, vector, whole
from ..errors import SamplingError, SceneError, ValidityWarning
from . import phasor_validity as validity
from .captures import TransientCapture
from .phasor_fields import Band, blocks, pulse_band, responses
from .phasor_images import Camera, PhasorImage
from .plane_convolutions import Lattice, lattice, plane_by_plane
from .rayleigh_sommerfeld import Legs, direct_sum
from .volumes import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
Progress = Callable[[float, str], None]

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
    progress : callable, optional
        Takes (share done, text).

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
    if volume.z[0] <= 0.0:
        raise SceneError(f"volume.z begins at {volume.z[0]:g} m, must be above 0, before the wall")
    moments = _times(camera, times)
    setup = _setup(capture, camera, laser, projector_focus, weight == "inverse")
    setup = setup.cut(*_apertures(setup, aperture, aperture_of))
    first, last, sample = setup.paths(volume, moments)
    notes = _notes(capture, volume, setup, wl_mean, sample)
    grid, reason = _grid(setup, volume, wl_mean, method)
    band = pulse_band(capture, wl_mean, float(wl_sigma), (first, last), tol)
    _check_memory(setup, volume, band, moments, dtype)
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


@dataclass(frozen=True, eq=False, kw_only=True)
class _Setup:
    """A camera's way through a capture.

    Parameters
    ----------
    legs : Legs
    grid : ndarray
        ``legs.near`` in the shape of its grid, (..., 3), m.
    columns : ndarray of int
        (m, n): which pair of the capture far_j and near_i make.
    given : ndarray
        (m, n), m: what the recorded times hold beside the paths to a voxel; a projector's leg,
        being known, is taken away from it.
    used : ndarray of bool
        (n,), near points within the aperture; their spectra are 0 without.
    sides : tuple of str
        Whose points near and far are.
    far_points, far_shape
        (m, 3), m, and the shape of their grid: lasers that light is focused by, also where their
        legs are part of ``given``.
    merged : bool
        Whether it is, so that their spectra add up.
    """

    legs: Legs
    grid: Array
    columns: NDArray[np.intp]
    given: Array
    used: NDArray[np.bool_]
    sides: tuple[str, str]
    far_points: Array
    far_shape: tuple[int, ...] = ()
    merged: bool = False

    def cut(self, near: NDArray[np.bool_], far: NDArray[np.bool_]) -> _Setup:
        """Without far points beyond the aperture, and with near ones marked."""
        keep = np.flatnonzero(far)
        if len(keep) == len(far):
            return replace(self, used=near)
        legs = self.legs if self.merged else replace(self.legs, far=self.legs.far[keep])
        return replace(
            self,
            legs=legs,
            columns=self.columns[keep],
            given=self.given[keep],
            far_points=self.far_points[keep],
            used=near,
        )

    def paths(self, volume: Volume, moments: Array) -> tuple[float, float, Array]:
        """Bounds of the times asked for, without outer legs, and a sample with them."""
        near = self.legs.near[self.used]
        low, high = _reach(volume, near)
        given = self.given[:, self.used]
        if len(self.legs.far):
            other = _reach(volume, self.legs.far)
            if self.legs.paired:
                other = _reach(volume, self.legs.far[self.used])
                low, high = low + other[0], high + other[1]
            else:
                low, high = low.min() + other[0].min(), high.max() + other[1].max()
        first = float(np.min(low + given.min(axis=0))) + float(moments.min())
        last = float(np.max(high + given.max(axis=0))) + float(moments.max())
        return first, last, self._sample(volume, moments)

    def _sample(self, volume: Volume, moments: Array) -> Array:
        """Path lengths, as the capture counts them, of a few hundred voxels and wall points."""
        axes = (a[len(a) // 16 :: max(1, len(a) // 8)] for a in (volume.x, volume.y, volume.z))
        voxels = Volume(*axes).points.reshape(-1, 3)
        some = np.flatnonzero(self.used)
        some = some[:: max(1, len(some) // 64)]
        paths = np.linalg.norm(voxels[:, None] - self.legs.near[some], axis=-1)
        if self.legs.paired:
            paths += np.linalg.norm(voxels[:, None] - self.legs.far[some], axis=-1)
        elif len(self.legs.far):
            paths += np.linalg.norm(voxels - self.legs.far[len(self.legs.far) // 2], axis=-1)[
                :, None
            ]
        paths += self.given[len(self.given) // 2, some]
        return np.asarray(paths[..., None] + moments)


def _setup(capture: TransientCapture, camera: str, laser: Any, focus: Any, falls: bool) -> _Setup:
    """Which points a camera looks through and which it lights from."""
    lasers, sensors = capture.laser_points.reshape(-1, 3), capture.sensor_points.reshape(-1, 3)
    outer = _outer_legs(capture)
    if camera != "projector_camera" and focus is not None:
        raise SceneError(f"projector_focus is for camera = 'projector_camera', not {camera!r}")
    if camera != "transient" and laser is not None:
        raise SceneError(f"laser is for camera = 'transient', not {camera!r}")
    if capture.pairing == "confocal":
        if camera in ("transient", "projector_camera"):
            raise SamplingError(
                f"camera = {camera!r} needs a laser point seen at many sensor points, and this "
                "capture has pairs; take 'confocal_time_gated'"
            )
        legs = Legs(near=sensors, far=lasers, paired=True, falls=falls)
        return _Setup(
            legs=legs,
            grid=capture.sensor_points,
            columns=np.arange(len(sensors))[None],
            given=outer.reshape(1, -1),
            used=np.ones(len(sensors), dtype=bool),
            sides=("sensor", "laser"),
            far_points=lasers[:1],
        )
    columns = np.arange(len(lasers) * len(sensors)).reshape(len(lasers), len(sensors))
    grid, sides, far_shape = capture.sensor_points, ("sensor", "laser"), capture.laser_shape
    # light's way back is its way: one sensor before many lasers is one laser before many sensors
    if len(sensors) == 1 and len(lasers) > 1 and camera in ("confocal_time_gated", "direct_light"):
        lasers, sensors, columns, outer = sensors, lasers, columns.T, outer.T
        grid, sides, far_shape = capture.laser_points, ("laser", "sensor"), ()
    far: Array = lasers
    merged = False
    if camera == "transient":
        row = _laser_index(capture, laser)
        lasers, columns, outer = lasers[[row]], columns[[row]], outer[[row]]
        far, far_shape = np.empty((0, 3)), ()
    elif camera == "projector_camera":
        if min(len(lasers), len(sensors)) < 2:
            raise SamplingError(
                f"camera = 'projector_camera' needs several laser and several sensor points, and "
                f"there are {len(lasers)} and {len(sensors)}"
            )
        if focus is None:
            raise SceneError("camera = 'projector_camera' needs projector_focus, (x, y, z) in m")
        lead = np.linalg.norm(lasers - np.asarray(vector("projector_focus", focus)), axis=-1)
        outer, far, merged = outer + lead[:, None], np.empty((0, 3)), True
    return _Setup(
        legs=Legs(near=sensors, far=far, falls=falls),
        grid=grid,
        columns=columns,
        given=outer,
        used=np.ones(len(sensors), dtype=bool),
        sides=sides,
        far_points=lasers,
        far_shape=far_shape,
        merged=merged,
    )


def _outer_legs(capture: TransientCapture) -> Array:
    """(lasers, sensors), or (pairs,): path from the laser to the wall and on to the sensor, m."""
    lasers, sensors = capture.laser_points.reshape(-1, 3), capture.sensor_points.reshape(-1, 3)
    to_wall, from_wall = np.zeros(len(lasers)), np.zeros(len(sensors))
    if capture.outer_legs:
        missing = [n for n in ("laser_origin", "sensor_origin") if getattr(capture, n) is None]
        if missing:
            raise SceneError(
                f"outer_legs = True and {' and '.join(missing)} not given: the path outside cannot "
                "be taken away; give both origins, or times without these legs"
            )
        to_wall = np.linalg.norm(lasers - np.asarray(capture.laser_origin), axis=-1)
        from_wall = np.linalg.norm(sensors - np.asarray(capture.sensor_origin), axis=-1)
    if capture.pairing == "confocal":
        return np.asarray(to_wall + from_wall)
    return np.asarray(to_wall[:, None] + from_wall)


def _laser_index(capture: TransientCapture, laser: Any) -> int:
    shape = capture.laser_shape
    count = int(np.prod(shape, dtype=int))
    if laser is None:
        if count == 1:
            return 0
        raise SceneError(f"camera = 'transient' needs laser, the index of one of {count} points")
    if is_single(laser):
        return whole("laser", laser, 0, count - 1)
    if len(laser) != len(shape):
        raise SceneError(f"laser has {len(laser)} indices, must be {len(shape)} like laser points")
    index = tuple(
        whole(f"laser[{i}]", v, 0, n - 1) for i, (v, n) in enumerate(zip(laser, shape, strict=True))
    )
    return int(np.ravel_multi_index(index, shape)) if index else 0


def _times(camera: str, times: Any) -> Array:
    if times is None:
        if camera == "transient":
            raise SceneError("camera = 'transient' needs times, m of optical path since the laser")
        return np.zeros(1)
    if camera == "direct_light":
        raise SceneError(
            "camera = 'direct_light' is at t = 0; take 'confocal_time_gated' for times"
        )
    moments = np.array(times, dtype=np.float64, ndmin=1)
    if moments.ndim != 1 or not len(moments):
        raise SamplingError(f"times have shape {moments.shape}, must be (n,), m")
    for value in moments:
        real("times", value)
    return moments


def _apertures(
    setup: _Setup, aperture: Any, aperture_of: str
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which near points and which far points are used."""
    one_of("aperture_of", aperture_of, ("both", "laser", "sensor"))
    near_shape, far_shape = setup.grid.shape[:-1], setup.far_shape
    n_far = len(setup.columns)
    near, far = np.ones(len(setup.used), dtype=bool), np.ones(n_far, dtype=bool)
    if aperture is None:
        return near, far
    if is_single(aperture):
        side = positive("aperture", aperture, unit="m")
        if aperture_of in ("both", setup.sides[0]) or setup.legs.paired:
            near = _square(setup.legs.near, side)
        if aperture_of in ("both", setup.sides[1]):
            far = _square(setup.far_points, side)
        return near, far
    mask = np.asarray(aperture)
    if mask.dtype != bool:
        raise SceneError(f"aperture of type {mask.dtype} is no mask; give booleans, or a side in m")
    fits = [mask.shape == shape for shape in (near_shape, far_shape)]
    if not any(fits):
        raise SamplingError(
            f"aperture has shape {mask.shape}, must be {near_shape} like the "
            f"{setup.sides[0]} points"
        )
    if fits[0] and (aperture_of in ("both", setup.sides[0]) or setup.legs.paired):
        near = mask.ravel()
    if fits[1] and aperture_of in ("both", setup.sides[1]):
        far = mask.ravel() if n_far > 1 else far
    if not (near.any() and far.any()):
        raise SamplingError("aperture leaves no wall point; give a larger one")
    return near, far


def _square(points: Array, side: float) -> NDArray[np.bool_]:
    """Points within a square about their middle."""
    flat = points[:, :2]
    if len(flat) == 1:
        return np.ones(1, dtype=bool)
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    inside = np.asarray((np.abs(flat - middle) <= 0.5 * side + 1e-9).all(axis=1))
    if not inside.any():
        raise SamplingError(
            f"aperture = {side:g} m leaves none of {len(flat)} wall points; give a larger one"
        )
    return inside


def _reach(volume: Volume, points: Array) -> tuple[Array, Array]:
    """Bounds of the distances from each point to the volume's voxels, m."""
    ends = np.array([[a[0], a[-1]] for a in (volume.x, volume.y, volume.z)])
    nearest = np.clip(points, ends[:, 0], ends[:, 1])
    furthest = np.where(np.abs(points - ends[:, 0]) > np.abs(points - ends[:, 1]), *ends.T)
    return np.linalg.norm(points - nearest, axis=1), np.linalg.norm(points - furthest, axis=1)


def _notes(
    capture: TransientCapture, volume: Volume, setup: _Setup, wl_mean: float, sample: Array
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


def _grid(setup: _Setup, volume: Volume, wl_mean: float, method: str) -> tuple[Lattice | None, str]:
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


def _check_memory(setup: _Setup, volume: Volume, band: Band, moments: Array, dtype: str) -> None:
    size = 8 if dtype == "float32" else 16
    voxels = float(np.prod(volume.shape))
    pairs = setup.columns.size * (2.0 if setup.merged else 1.0)
    fits_memory(
        f"a field at {len(moments)} times on {voxels:.3g} voxels",
        2.5 * size * len(moments) * voxels,
        "ask for fewer voxels or times",
    )
    slices = max(1, int(SPECTRA // (size * pairs)))
    fits_memory(
        f"spectra of {setup.columns.size} pairs",
        3.0 * size * pairs * min(slices, len(band.numbers)),
        "use a smaller aperture, or dtype='float32'",
    )


def _carry(
    capture: TransientCapture,
    volume: Volume,
    setup: _Setup,
    grid: Lattice | None,
    band: Band,
    moments: Array,
    dtype: str,
    device: str | None,
    progress: Progress | None,
) -> ComplexArray:
    """(t, nz, ny, nx): the field, some waves after others."""
    size = 8 if dtype == "float32" else 16
    n_waves = len(band.numbers)
    total: ComplexArray | None = None
    for kept in blocks(n_waves, max(1, int(SPECTRA // (size * setup.columns.size)))):
        part = band.part(kept)
        spectra = _spectra(capture, setup, part, dtype)

        def advance(share: float, kept: slice = kept) -> None:
            if progress is not None:
                done = (kept.start + share * (kept.stop - kept.start)) / n_waves
                progress(done, f"waves {kept.start + 1} to {kept.stop} of {n_waves}")

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


def _spectra(capture: TransientCapture, setup: _Setup, band: Band, dtype: str) -> ComplexArray:
    """(n, m, points): the camera's spectra, lasers summed where they are focused elsewhere."""
    columns, given = setup.columns, setup.given
    light = responses(capture, band, columns.ravel(), given.ravel(), dtype)
    light = light.reshape(len(light), *columns.shape)
    light[:, :, ~setup.used] = 0.0
    return light.sum(axis=1, keepdims=True) if setup.merged else light
