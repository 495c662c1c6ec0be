"""Backprojection of captures onto ellipsoids of equal path, for any pairing and any grid."""

from __future__ import annotations

import math
import time
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect, fits_memory, one_of, positive
from ..._progress import Progress
from ...errors import SamplingError, SceneError
from ..capture.capture import TransientCapture
from ..capture.preprocessing import outer_legs
from .confocal_grids import refuse_direct_light
from .volume import Volume, VolumeImage

Array = NDArray[np.floating]
Filter = Literal["none", "second_derivative", "laplacian"]
Falloff = Literal["none", "matched", "diffuse", "retroreflective"]

#: Exponent of r1 r2 in the weight of each path.
POWERS: Final = {"none": 0, "matched": -2, "diffuse": 2, "retroreflective": 1}


def backprojection(
    capture: TransientCapture,
    volume: Volume,
    *,
    filter: Filter = "none",
    width: float | None = None,
    falloff: Falloff = "none",
    progress: Progress | None = None,
) -> VolumeImage:
    """Reconstruct a hidden scene by backprojection: sum the light that may come from each voxel.

    For one laser and one sensor point, all light of the same optical path comes from an ellipsoid
    with its foci at the two points. The value of a voxel is the sum over all pairs of points of the
    signal at the path via the voxel.

    Parameters
    ----------
    capture : TransientCapture
        Capture of any pairing and grid, without light that goes directly from the laser spot to the
        sensor. Its times may or may not include the outer legs: the paths from laser to wall and
        from wall to sensor.
    volume : Volume
        Voxels in front of the wall; `Volume.facing` puts one column before each wall point.
    filter : {"none", "second_derivative", "laplacian"}
        Filter that sharpens the sums, applied after a Gaussian blur. "second_derivative":
        ``-d^2/dz^2``. "laplacian": minus the Laplacian over all axes with at least 3 voxels.
    width : float, optional
        Standard deviation of the Gaussian blur, m; only with a filter. None: pitch of the voxels
        along z.
    falloff : {"none", "matched", "diffuse", "retroreflective"}
        Weight of each path, where r1 and r2 are its lengths from the laser point to the voxel and
        from there to the sensor point. "none": 1. "matched": ``1/(r1 r2)^2``, the falloff of the
        light itself: the sum is then the adjoint of the model that computes a capture from points,
        as iterative solvers need it.
        "diffuse": ``(r1 r2)^2``, which undoes the falloff of diffuse objects. "retroreflective":
        ``r1 r2``, which undoes that of retro-reflective ones.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    VolumeImage
        Sum of each voxel, linear in the capture without a filter. With a filter, negative values
        are set to 0; ``details["below_zero"]`` is their sum relative to the sum of the positive
        ones.

    Raises
    ------
    SamplingError
        If voxels have no path within the time window, or a filter has fewer than 3 voxels along z.
    SceneError
        If the capture has direct light, the volume is not in front of the wall, or ``width`` is
        given without a filter.
    MemoryLimitError
        If capture and image exceed the free memory.

    See Also
    --------
    fk_migration, lct : Faster methods with sharper images, for confocal captures.
    phasor_image : Image by virtual waves, for any capture.

    Notes
    -----
    Each voxel sums the signal at the path ``r1 + r2`` over all pairs [1]_, interpolated linearly
    between bin centres. The signal outside the bins is taken as 0. The signal is stored in float32
    and summed in float64. Without a filter, the image of a point decreases only about as 1/distance
    from it; the filters make it sharper [2]_.

    References
    ----------
    .. [1] Velten, Willwacher, Gupta et al., Recovering three-dimensional shape around a corner
       using ultrafast time-of-flight imaging, Nature Communications 3, 745 (2012).
    .. [2] Laurenzis, Velten, Feature selection and back-projection algorithms for
       non-line-of-sight laser-gated viewing, J. Electron. Imaging 23, 063003 (2014).
    """
    capture = expect("capture", capture, "TransientCapture")
    volume = expect("volume", volume, "Volume")
    begun = time.perf_counter()
    one_of("filter", filter, ("none", "second_derivative", "laplacian"))
    one_of("falloff", falloff, POWERS)
    if filter == "none" and width is not None:
        raise SceneError("width is for a filter, but filter = 'none'; omit width or give a filter")
    volume.check_before_wall()
    if filter != "none":
        pitch = volume.z[1] - volume.z[0] if len(volume.z) > 2 else 0.0
        if not pitch:
            raise SamplingError(
                f"filter = {filter!r} needs at least 3 voxels along z, the volume has "
                f"{len(volume.z)}; give more, or filter='none'"
            )
        width = pitch if width is None else positive("width", width, unit="m")
    refuse_direct_light(capture, "backprojection")
    each = 17.0 if filter == "none" else 33.0  # bytes per voxel
    fits_memory(
        "backprojection",
        4.0 * capture.H.size + each * math.prod(volume.shape) + 64.0 * capture.H[0].size,
        "give a smaller volume, or a coarser capture",
    )
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


def _sums(
    capture: TransientCapture, volume: Volume, power: int, progress: Progress | None
) -> Array:
    """Return the sums (nz, ny, nx) over all pairs of a capture."""
    from . import _migration_kernels as kernels

    nz, ny, nx = volume.shape
    n_paths = capture.H[0].size
    lasers = capture.laser_points.reshape(-1, 3)
    sensors = capture.sensor_points.reshape(-1, 3)
    if capture.pairing == "confocal":
        laser_of = sensor_of = np.arange(n_paths)
    else:
        laser_of, sensor_of = np.divmod(np.arange(n_paths), len(sensors))
    series = np.zeros((n_paths, capture.n_bins + 2), dtype=np.float32)
    series[:, 1:-1] = capture.H.reshape(capture.n_bins, n_paths).T
    pairs = (lasers, sensors, laser_of, sensor_of, outer_legs(capture).ravel())
    window = (capture.t_start, capture.delta_t)
    found = np.empty((ny, nx, nz))
    seen = np.empty((ny, nx, nz), dtype=np.bool_)
    for first in range(0, ny, 8):  # rows between calls of progress
        rows = slice(first, first + 8)
        axes = (volume.x, volume.y[rows], volume.z)
        kernels.backproject(series, pairs, axes, window, power, found[rows], seen[rows])
        if progress is not None:
            progress("backprojection", min(1.0, (first + 8) / ny))
    unseen = np.flatnonzero(~seen.all(axis=(0, 1)))
    if len(unseen):
        raise SamplingError(
            f"voxels at depths {volume.z[unseen[0]]:g} to {volume.z[unseen[-1]]:g} m have no path "
            f"within the times {capture.edges[0]:g} to {capture.edges[-1]:g} m; make the volume "
            "smaller or capture more bins"
        )
    return np.ascontiguousarray(found.transpose(2, 0, 1))


def _filtered(sums: Array, volume: Volume, filter: str, width: float) -> Array:
    """Return minus the second derivative along z, or the Laplacian, of the blurred sums, 1/m^2."""
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
