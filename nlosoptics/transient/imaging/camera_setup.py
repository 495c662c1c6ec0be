"""Wall points and paths that a virtual camera uses, and the limits of its sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import is_single, positive
from ...errors import SamplingError, SceneError
from ..capture.capture import TransientCapture
from ..capture.preprocessing import outer_legs
from ..capture.wall_points import UNEVEN, point_steps
from .rayleigh_sommerfeld import Legs
from .volume import Volume

Array = NDArray[np.floating]


def grid_note(name: str, points: Array, wavelength: float, ways: int) -> str | None:
    """Return a note if wall points are too coarse for the wavelength or uneven, or None."""
    steps = point_steps(points)
    if not steps or points.ndim != 3:
        return None
    largest = max(float(step.max()) for step in steps)
    limit = wavelength / (2 * ways)
    if largest > limit * (1.0 + 1e-9):
        return (
            f"{name} are up to {largest:.4g} m apart, limit {limit:.4g} m, wl_mean/{2 * ways}: "
            f"aliases of the scene may appear; give wl_mean of {2 * ways * largest:.4g} m or more"
        )
    spread = max(float(np.ptp(step)) / float(step.mean()) for step in steps)
    if spread > UNEVEN:
        return (
            f"{name} are unevenly spaced by {spread:.2g} of their pitch, limit {UNEVEN:g}: densely "
            "sampled parts of the wall get more weight"
        )
    return None


def bin_note(delta_t: float, wavelength: float) -> str | None:
    """Return a note if bins are wider than a quarter of the wavelength, or None."""
    if delta_t > 0.5 * wavelength:
        raise SamplingError(
            f"delta_t = {delta_t:.4g} m exceeds half of wl_mean = {wavelength:.4g} m, so that the "
            f"wave is undersampled; give wl_mean of {4 * delta_t:.4g} m or more"
        )
    if delta_t > 0.25 * wavelength:
        return (
            f"delta_t = {delta_t:.4g} m exceeds a quarter of wl_mean = {wavelength:.4g} m: bins "
            f"blur the wave's phase; give wl_mean of {4 * delta_t:.4g} m or more"
        )
    return None


def window_note(capture: TransientCapture, volume: Volume, paths: Array) -> str | None:
    """Return a note if part of the volume's paths lies outside the capture's bins, or None."""
    edges = capture.edges
    early = float(np.mean(paths < edges[0]))
    late = float(np.mean(paths > edges[-1]))
    if early + late <= 0.01:
        return None
    return (
        f"bins from {edges[0]:.4g} to {edges[-1]:.4g} m leave out {100 * (early + late):.2g} % of "
        f"the paths of a volume from z = {volume.z[0]:.4g} to {volume.z[-1]:.4g} m "
        f"({paths.min():.4g} to {paths.max():.4g} m): those parts of the image are too dark"
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """Assignment of a capture's wall points to the near and far points of a virtual camera."""

    legs: Legs  # Near and far points, whose distances to a voxel make up its path
    grid: Array  # (..., 3), m: ``legs.near`` in the shape of its grid
    # (m, n): index of the capture's pair that far point j and near point i form
    columns: NDArray[np.intp]
    given: Array  # (m, n), m: outer legs, in addition to the legs to a voxel
    # (n,): near points within the aperture; the spectra of others are set to 0
    used: NDArray[np.bool_]
    # Kind of the near and of the far points, ("sensor", "laser") or ("laser", "sensor")
    sides: tuple[str, str]
    far_points: Array  # (m, 3), m: points from which the light comes
    far_shape: tuple[int, ...] = ()  # Shape of the grid of ``far_points``

    def cut(self, near: NDArray[np.bool_], far: NDArray[np.bool_]) -> Setup:
        """Return the setup without unused far points and with ``near`` as its used near points."""
        keep = np.flatnonzero(far)
        if len(keep) == len(far):
            return replace(self, used=near)
        return replace(
            self,
            legs=replace(self.legs, far=self.legs.far[keep]),
            columns=self.columns[keep],
            given=self.given[keep],
            far_points=self.far_points[keep],
            used=near,
        )

    def paths(self, volume: Volume, moments: Array) -> tuple[float, float, Array]:
        """Return the least and greatest requested time, and a sample of times.

        All are in m and include ``given``, so that they compare with the capture's bins.
        """
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
        """Return path lengths, including ``given``, for a few hundred voxels and wall points."""
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


def camera_setup(capture: TransientCapture, camera: str) -> Setup:
    """Assign laser and sensor points to a virtual camera."""
    lasers, sensors = capture.laser_points.reshape(-1, 3), capture.sensor_points.reshape(-1, 3)
    outer = outer_legs(capture)
    if capture.pairing == "confocal":
        if camera == "transient":
            raise SamplingError(
                f"camera = {camera!r} needs a laser point observed at many sensor points, but this "
                "capture has pairs; give camera = 'confocal_time_gated'"
            )
        return Setup(
            legs=Legs(near=sensors, far=lasers, paired=True),
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
    far: Array
    if camera == "transient":
        if len(lasers) > 1:
            raise SceneError(
                f"camera = 'transient' needs one laser point, the capture has {len(lasers)}; give "
                "capture.of_laser(index)"
            )
        far, far_shape = np.empty((0, 3)), ()
    # by reciprocity, one sensor with many lasers equals one laser with many sensors
    elif len(sensors) == 1 and len(lasers) > 1:
        lasers, sensors, columns, outer = sensors, lasers, columns.T, outer.T
        far, grid, sides, far_shape = lasers, capture.laser_points, ("laser", "sensor"), ()
    else:
        far = lasers
    return Setup(
        legs=Legs(near=sensors, far=far),
        grid=grid,
        columns=columns,
        given=outer,
        used=np.ones(len(sensors), dtype=bool),
        sides=sides,
        far_points=lasers,
        far_shape=far_shape,
    )


def apertures(setup: Setup, aperture: Any) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the near points (n,) and the far points (m,) within the aperture."""
    if aperture is None:
        return np.ones(len(setup.used), dtype=bool), np.ones(len(setup.columns), dtype=bool)
    if not is_single(aperture):
        raise SceneError("aperture is no single length; give the side of a square, m")
    side = positive("aperture", aperture, unit="m")
    return _square(setup.legs.near, side), _square(setup.far_points, side)


def _square(points: Array, side: float) -> NDArray[np.bool_]:
    """Return a mask of the points within a square of ``side``, m, about their centre."""
    flat = points[:, :2]
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    inside = np.asarray((np.abs(flat - middle) <= 0.5 * side + 1e-9).all(axis=1))
    if not inside.any():
        raise SamplingError(
            f"aperture = {side:g} m contains none of {len(flat)} wall points; give a larger one"
        )
    return inside


def _reach(volume: Volume, points: Array) -> tuple[Array, Array]:
    """Return the least and greatest distance from each point to the volume's voxels, m."""
    ends = np.array([[a[0], a[-1]] for a in (volume.x, volume.y, volume.z)])
    nearest = np.clip(points, ends[:, 0], ends[:, 1])
    furthest = np.where(np.abs(points - ends[:, 0]) > np.abs(points - ends[:, 1]), *ends.T)
    return np.linalg.norm(points - nearest, axis=1), np.linalg.norm(points - furthest, axis=1)
