"""Which wall points a virtual camera looks through and lights from, and the paths between."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import is_single, one_of, positive, vector, whole
from ...errors import SamplingError, SceneError
from ..capture.capture import TransientCapture
from ..capture.preprocessing import outer_legs
from .rayleigh_sommerfeld import Legs
from .volume import Volume

Array = NDArray[np.floating]

#: Share of the volume's paths that may lie beyond the capture's bins unmentioned.
CUT = 0.01
#: Share of the pitch by which steps of a grid may differ unmentioned.
UNEVEN = 1e-3


def grid_note(name: str, points: Array, wavelength: float, ways: int) -> str | None:
    """Steps of a grid of wall points against the wavelength; None where they are fine enough.

    Parameters
    ----------
    name : str
        Of the points.
    points : ndarray
        (..., 3), m.
    wavelength : float
        m of optical path.
    ways : int
        2 where light leaves from and comes back to the same points, else 1.
    """
    steps = [
        np.linalg.norm(np.diff(points, axis=axis), axis=-1).ravel()
        for axis in range(points.ndim - 1)
        if points.shape[axis] > 1
    ]
    if not steps or points.ndim != 3:
        return None
    largest = max(float(step.max()) for step in steps)
    limit = wavelength / (2 * ways)
    if largest > limit * (1.0 + 1e-9):
        return (
            f"{name} are up to {largest:.4g} m apart, limit {limit:.4g} m, wl_mean/{2 * ways}: "
            f"copies of the scene may appear; take wl_mean of {2 * ways * largest:.4g} m or more"
        )
    spread = max(float(np.ptp(step)) / float(step.mean()) for step in steps)
    if spread > UNEVEN:
        return (
            f"{name} are unevenly spaced by {spread:.2g} of their pitch, limit {UNEVEN:g}: dense "
            "parts weigh more"
        )
    return None


def bin_note(delta_t: float, wavelength: float) -> str | None:
    """Bins against the wavelength.

    Raises
    ------
    SamplingError
        If a wave has less than two bins.
    """
    if delta_t > 0.5 * wavelength:
        raise SamplingError(
            f"delta_t = {delta_t:.4g} m holds over half of wl_mean = {wavelength:.4g} m, which "
            f"is not sampled then; take wl_mean of {4 * delta_t:.4g} m or more"
        )
    if delta_t > 0.25 * wavelength:
        return (
            f"delta_t = {delta_t:.4g} m is over a quarter of wl_mean = {wavelength:.4g} m: bins "
            f"blur the wave's phase; take wl_mean of {4 * delta_t:.4g} m or more"
        )
    return None


def window_note(capture: TransientCapture, volume: Volume, paths: Array) -> str | None:
    """Share of the volume's paths that the capture's bins do not hold.

    Parameters
    ----------
    capture : TransientCapture
    volume : Volume
    paths : ndarray
        A sample of path lengths as the capture counts them, m.
    """
    edges = capture.edges
    early = float(np.mean(paths < edges[0]))
    late = float(np.mean(paths > edges[-1]))
    if early + late <= CUT:
        return None
    return (
        f"bins from {edges[0]:.4g} to {edges[-1]:.4g} m leave out {100 * (early + late):.2g} % of "
        f"the paths of a volume from z = {volume.z[0]:.4g} to {volume.z[-1]:.4g} m "
        f"({paths.min():.4g} to {paths.max():.4g} m): those parts look darker than they are"
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
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

    def cut(self, near: NDArray[np.bool_], far: NDArray[np.bool_]) -> Setup:
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


def camera_setup(
    capture: TransientCapture, camera: str, laser: Any, focus: Any, falls: bool
) -> Setup:
    """Which points a camera looks through and which it lights from."""
    lasers, sensors = capture.laser_points.reshape(-1, 3), capture.sensor_points.reshape(-1, 3)
    outer = outer_legs(capture)
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
        return Setup(
            legs=legs,
            grid=capture.sensor_points,
            columns=np.arange(len(sensors))[None],
            given=outer.reshape(1, -1),
            used=np.ones(len(sensors), dtype=bool),
            sides=("sensor", "laser"),
            far_points=lasers[:1],
        )
    columns = np.arange(len(lasers) * len(sensors)).reshape(len(lasers), len(sensors))
    outer = outer.reshape(columns.shape)
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
    return Setup(
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


def apertures(
    setup: Setup, aperture: Any, aperture_of: str
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
    try:
        mask = np.asarray(aperture)
    except ValueError:
        raise SamplingError("aperture has rows of several lengths; give a mask") from None
    if mask.dtype != bool:
        raise SceneError(f"aperture of type {mask.dtype} is no mask; give booleans, or a side in m")
    fits = [mask.shape == shape for shape in (near_shape, far_shape)]
    if not any(fits):
        raise SamplingError(
            f"aperture has shape {mask.shape}, must be {near_shape} like the "
            f"{setup.sides[0]} points"
        )
    cuts_near = fits[0] and (aperture_of in ("both", setup.sides[0]) or setup.legs.paired)
    cuts_far = fits[1] and n_far > 1 and aperture_of in ("both", setup.sides[1])
    if not (cuts_near or cuts_far):
        raise SamplingError(
            f"aperture of shape {mask.shape} and aperture_of = {aperture_of!r} cut no points; take "
            f"aperture_of = {setup.sides[0]!r} or 'both'"
        )
    if cuts_near:
        near = mask.ravel()
    if cuts_far:
        far = mask.ravel()
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
