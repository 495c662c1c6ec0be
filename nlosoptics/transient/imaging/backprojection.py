"""Backprojection: light put back on the ellipsoids that its path allows, any pairing, any grid."""

from __future__ import annotations

import time
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, one_of, positive
from ..._progress import Progress
from ...errors import SamplingError, SceneError
from ..capture.capture import TransientCapture
from ..capture.preprocessing import outer_legs
from .confocal_grids import refuse_direct_light
from .volume import Volume, VolumeImage, axes_before

Array = NDArray[np.floating]
Filter = Literal["none", "second_derivative", "laplacian"]
Falloff = Literal["none", "matched", "diffuse", "retroreflective"]

#: The power of r1 r2 that weights each path.
POWERS: Final = {"none": 0, "matched": -2, "diffuse": 2, "retroreflective": 1}
BLOCK: Final = 8  # rows of voxels between two calls of progress


def backprojection(
    capture: TransientCapture,
    volume: Volume | None = None,
    *,
    filter: Filter = "none",
    width: float | None = None,
    falloff: Falloff = "none",
    progress: Progress | None = None,
) -> VolumeImage:
    """Picture of a hidden scene by backprojection onto ellipsoids.

    Parameters
    ----------
    capture : TransientCapture
        Any pairing and grids, with or without outer legs, without direct light.
    volume : Volume, optional
        Any before the wall; None, for an even grid of sensor points [y, x] without outer legs: a
        voxel before each, at half the paths of the bins, as far as light comes back in time from
        all of a plane.
    filter : {"none", "second_derivative", "laplacian"}
        Of the sums: ``-d^2/dz^2``, or minus the Laplacian of a Gaussian along all axes that have
        voxels.
    width : float, optional
        The Gaussian's standard deviation, m, for both filters alone; None: the voxels' pitch along
        z.
    falloff : {"none", "matched", "diffuse", "retroreflective"}
        Weight of each path: 1; ``1/(r1 r2)^2``, the falloff itself, which makes the sum the adjoint
        of light off points; ``(r1 r2)^2`` or ``r1 r2``, which undo it.
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    VolumeImage
        Without a filter linear in the capture; filtered sums below 0 are 0, and
        ``details["below_zero"]`` says how much that was, over the sum of what is above.

    Raises
    ------
    SamplingError
        If voxels are outside of what the window of time covers, or a filter has no three voxels.
    SceneError
        If direct light is in, the volume is not before the wall, or ``width`` has no filter.
    MemoryLimitError
        If light and picture would not fit.

    Notes
    -----
    Each voxel adds the light at the path ``r1 + r2`` over it, taken between the middles of the two
    nearest bins (nothing is outside of the first and last), in float32 with sums in float64 [1]_.
    The filters sharpen what is a blur by about 1/distance [2]_.

    References
    ----------
    .. [1] Velten, Willwacher, Gupta et al., Recovering three-dimensional shape around a corner
       using ultrafast time-of-flight imaging, Nature Communications 3, 745 (2012).
    .. [2] Laurenzis, Velten, Feature selection and back-projection algorithms for
       non-line-of-sight laser-gated viewing, J. Electron. Imaging 23, 063003 (2014).
    """
    begun = time.perf_counter()
    one_of("filter", filter, ("none", "second_derivative", "laplacian"))
    one_of("falloff", falloff, POWERS)
    if filter == "none" and width is not None:
        raise SceneError("width is for a filter, and filter = 'none'; leave it out or name one")
    volume = _own_volume(capture) if volume is None else volume
    volume.check_before_wall()
    if filter != "none":
        pitch = volume.z[1] - volume.z[0] if len(volume.z) > 2 else 0.0
        if not pitch:
            raise SamplingError(
                f"filter = {filter!r} needs at least 3 voxels along z, the volume has "
                f"{len(volume.z)}; give more or filter='none'"
            )
        width = pitch if width is None else positive("width", width, unit="m")
    refuse_direct_light(capture, "backprojection")
    sums = _sums(capture, volume, POWERS[falloff], progress)
    details: dict[str, Any] = {"filter": filter, "falloff": falloff}
    if filter != "none":
        assert width is not None
        sums = _filtered(sums, volume, filter, width)
        below = -float(sums[sums < 0.0].sum())
        sums = np.maximum(sums, 0.0)
        above = float(sums.sum())
        details |= {"width": width, "below_zero": below / above if above else 0.0}
    return VolumeImage(
        intensity=sums,
        volume=volume,
        method="backprojection",
        seconds=time.perf_counter() - begun,
        details=details,
    )


def _own_volume(capture: TransientCapture) -> Volume:
    points = capture.sensor_points
    if points.ndim != 3 or capture.outer_legs:
        raise SamplingError(
            f"sensor points {capture.sensor_shape} or outer legs tell no volume; give one"
        )
    depths = 0.5 * capture.times
    # over the sensor point that is farthest from all lasers, light goes z + sqrt(z^2 + farthest^2)
    end, farthest = float(capture.edges[-1]), 0.0
    if capture.pairing == "confocal":
        apart = np.linalg.norm(capture.laser_points - points, axis=-1)
        farthest = float(apart.max())
    else:
        from scipy.spatial import cKDTree

        nearest = cKDTree(capture.laser_points.reshape(-1, 3)).query(points.reshape(-1, 3))[0]
        farthest = float(np.max(nearest))
    last = 0.5 * (end - farthest**2 / end) if end > 0.0 else 0.0
    depths = depths[(depths > 0.0) & (depths <= last)]
    if not len(depths):
        raise SamplingError(
            f"bins up to {end:g} m hold no path to a plane before all of the wall points; give a "
            "volume, or take more bins"
        )
    return Volume(*axes_before(points), depths)


def _sums(
    capture: TransientCapture, volume: Volume, power: int, progress: Progress | None
) -> Array:
    """(nz, ny, nx) sums over the paths of a capture."""
    from . import _migration_kernels as kernels

    nz, ny, nx = volume.shape
    n_paths = capture.H[0].size
    fits_memory(
        "backprojection",
        4.0 * capture.H.size + 12.0 * nz * ny * nx + 8.0 * n_paths,
        "give a smaller volume, or a coarser capture",
    )
    lasers = capture.laser_points.reshape(-1, 3)
    sensors = capture.sensor_points.reshape(-1, 3)
    if capture.pairing == "confocal":
        laser_of = sensor_of = np.arange(n_paths)
    else:
        laser_of, sensor_of = np.divmod(np.arange(n_paths), len(sensors))
    series = np.zeros((n_paths, capture.n_bins + 2), dtype=np.float32)
    series[:, 1:-1] = capture.H.reshape(capture.n_bins, n_paths).T
    legs = outer_legs(capture).ravel()
    found = np.empty((ny, nx, nz))
    seen = np.empty((ny, nx, nz), dtype=np.bool_)
    for first in range(0, ny, BLOCK):
        rows = slice(first, first + BLOCK)
        kernels.backproject(
            series,
            lasers,
            sensors,
            laser_of,
            sensor_of,
            legs,
            volume.x,
            volume.y[rows],
            volume.z,
            capture.t_start,
            capture.delta_t,
            power,
            found[rows],
            seen[rows],
        )
        if progress is not None:
            progress("backprojection", min(1.0, (first + BLOCK) / ny))
    unseen = np.flatnonzero(~seen.all(axis=(0, 1)))
    if len(unseen):
        raise SamplingError(
            f"voxels at depths {volume.z[unseen[0]]:g} to {volume.z[unseen[-1]]:g} m have no path "
            f"within the times {capture.edges[0]:g} to {capture.edges[-1]:g} m; make the volume "
            "smaller or take more bins"
        )
    return np.ascontiguousarray(found.transpose(2, 0, 1))


def _filtered(sums: Array, volume: Volume, filter: str, width: float) -> Array:
    """Minus second derivatives of a Gaussian's blur along z or all axes with voxels, per m^2."""
    from scipy.ndimage import gaussian_filter

    axes = [volume.z, volume.y, volume.x]
    used = [0] if filter == "second_derivative" else [i for i in range(3) if len(axes[i]) > 2]
    pitches = {i: axes[i][1] - axes[i][0] for i in used}
    sigma = [width / pitches[i] if i in used else 0.0 for i in range(3)]
    out = np.zeros_like(sums)
    for i in used:
        order = [2 if j == i else 0 for j in range(3)]
        out -= gaussian_filter(sums, sigma, order=order, mode="nearest") / pitches[i] ** 2
    return out
