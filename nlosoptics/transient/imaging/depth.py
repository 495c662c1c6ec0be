"""Depth maps of images and of meshes, and the error between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import each, expect, in_range, whole
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..capture.wall_points import real_array
from .volume import Volume, VolumeImage

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthMap(Noun):
    """Depth of a reconstructed scene over x and y: distance from the wall to the surface along z.

    `depth_map` computes it from the image on a volume. Each x and y of the volume is a cell of the
    map.

    Parameters
    ----------
    depth : ndarray
        (ny, nx): distance from the wall z = 0, m; NaN for cells without a surface.
    confidence : ndarray
        (ny, nx): largest intensity of each cell's voxels along z, relative to the brightest voxel
        of the image, 0 to 1.
    x, y : ndarray
        (nx,) and (ny,): cell centres, world frame, m.
    threshold : float
        Confidence below which a cell is taken as empty, 0 to 1.
    standard_error : ndarray, optional
        (ny, nx): standard deviation of the error of ``depth``, m, from `advise` or of an image of
        `inverse_image`.

    See Also
    --------
    depth_map : Depths of an image.
    depth_error : Error of a depth map.
    """

    depth: Array
    confidence: Array
    x: Array
    y: Array
    threshold: float
    standard_error: Array | None = None

    @property
    def coverage(self) -> float:
        """Fraction of the cells that have a depth."""
        return float(np.mean(np.isfinite(self.depth)))


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthError(Noun):
    """Error of a depth map against the truth, at the threshold of confidence with the least error.

    `depth_error` computes it. Each x and y is a cell of the depth map. The confidence of a cell is
    its largest intensity along z, relative to the brightest voxel of the image. Cells below the
    threshold are taken as empty.

    Parameters
    ----------
    mae : float
        Mean absolute error at ``threshold``, m, over the cells in which both maps have a depth.
    threshold : float
        Threshold of confidence with the least ``mae``, 0 to 1, among those that keep the coverage
        required by `depth_error`.
    coverage : float
        Fraction of the cells with a true depth that have a reconstructed depth at this threshold.
    missed, false : float
        Fraction of the cells with a true depth that have no reconstructed depth, and fraction of
        the cells with a reconstructed depth that have no true depth.
    median : float
        Median of reconstructed minus true depth, m, over the same cells as ``mae``.
    curve : ndarray
        (n, 3): for each threshold that was tried, the threshold, the mean absolute error, m, and
        the coverage. The error is NaN if no cell is left.

    See Also
    --------
    depth_error : Error of a depth map.
    """

    mae: float
    threshold: float
    coverage: float
    missed: float
    false: float
    median: float
    curve: Array


def depth_map(
    image: VolumeImage, *, threshold: float | None = None, interpolate: bool = True
) -> DepthMap:
    """Return the depth of the brightest voxel along z, for each x and y of an image.

    Parameters
    ----------
    image : VolumeImage
        Image of the hidden scene on the voxels of a volume.
    threshold : float, optional
        Least confidence at which a depth is returned, 0 to 1. The confidence at x and y is the
        largest intensity along z, relative to the brightest voxel of the image. Where it is below
        the threshold, the depth is NaN. None: the depth is NaN only where all voxels along z are 0.
    interpolate : bool
        Whether to interpolate the position of the maximum between voxels, as
        `VolumeImage.peak_depth` does. The depth then differs by up to half a voxel from that of the
        brightest voxel.

    Returns
    -------
    DepthMap
        Distance from the wall and confidence for each x and y, (ny, nx).

    Raises
    ------
    SceneError
        If the image is all 0 or not finite, or the threshold is not within 0 to 1.

    See Also
    --------
    depth_error : Error of a depth map.
    true_depths : True depths of meshes.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import Volume, VolumeImage, depth_map
    >>> volume = Volume([0.0, 0.1], [0.0], np.linspace(0.4, 0.8, 9))
    >>> pulse = np.exp(-(((volume.z - 0.53) / 0.1) ** 2))[:, None, None]
    >>> image = VolumeImage(intensity=pulse * [1.0, 0.1], volume=volume, method="test")
    >>> print(depth_map(image, threshold=0.5).depth.round(3))
    [[0.53  nan]]
    """
    image = expect("image", image, "VolumeImage")
    share = 0.0 if threshold is None else in_range("threshold", threshold, 0.0, 1.0)
    values, z = image.intensity, image.volume.z
    brightest = float(values.max())
    if not np.isfinite(values).all() or brightest <= 0.0:
        raise SceneError(
            f"the brightest voxel is {brightest:g}, must be above 0 and finite; check the image"
        )
    depth = image.peak_depth() if interpolate else z[values.argmax(axis=0)]
    confidence = np.asarray(image.projection() / brightest, dtype=np.float64)
    nothing = (confidence < share) | (confidence <= 0.0)
    return DepthMap(
        depth=np.where(nothing, np.nan, depth),
        confidence=confidence,
        x=image.volume.x,
        y=image.volume.y,
        threshold=share,
        standard_error=image.details.get("standard_error"),
    )


def depth_error(
    found: DepthMap | VolumeImage,
    truth: ArrayLike,
    *,
    n_thresholds: int = 100,
    min_coverage: float = 0.5,
) -> DepthError:
    """Compare a reconstructed depth map with the truth: mean absolute error at the best threshold.

    Each x and y is a cell of the depth map. The confidence of a cell is its largest intensity along
    z, relative to the brightest voxel of the image. Cells with a confidence below a threshold are
    taken as empty. Several thresholds are tried, and the one with the least error is used.

    Parameters
    ----------
    found : DepthMap or VolumeImage
        Reconstructed depths; an image is converted by `depth_map`.
    truth : array_like
        True depths on the same cells, (ny, nx), m; NaN for cells without a surface.
    n_thresholds : int
        Number n of thresholds to try: those that leave out 0, 1/n, 2/n, ... of the cells in which
        both maps have a depth.
    min_coverage : float
        Least coverage of a threshold that may be used, 0 to 1. The coverage is the fraction of the
        cells with a true depth that have a reconstructed depth at this threshold. Without this
        limit, the best threshold could keep a single cell.

    Returns
    -------
    DepthError
        Error at the best threshold, and errors at all thresholds.

    Raises
    ------
    SamplingError
        If the maps differ in shape, or no threshold keeps enough cells.
    SceneError
        If all true depths are NaN.

    See Also
    --------
    depth_map : Depths of an image.
    true_depths : Depths of meshes.

    Notes
    -----
    The error is averaged over the cells in which both maps have a depth. ``missed`` and ``false``
    report the cells in which only one map has a depth.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import Volume, VolumeImage, depth_error
    >>> volume = Volume([0.0, 0.1], [0.0], np.linspace(0.4, 0.8, 9))
    >>> pulse = np.exp(-(((volume.z - 0.53) / 0.1) ** 2))[:, None, None]
    >>> image = VolumeImage(intensity=pulse * [1.0, 0.9], volume=volume, method="test")
    >>> round(depth_error(image, [[0.55, 0.54]]).mae, 3)
    0.015
    """
    found = expect("found", found, "DepthMap", "VolumeImage")
    if isinstance(found, VolumeImage):
        found = depth_map(found)
    true = real_array("true depths", truth)
    if true.shape != found.depth.shape:
        raise SamplingError(
            f"true depths have shape {true.shape}, must be {found.depth.shape} like the "
            "reconstructed ones; compute them on the same cells"
        )
    there = np.isfinite(true)
    if not there.any():
        raise SceneError("the true depths are all NaN; give at least one finite depth")
    least = in_range("min_coverage", min_coverage, 0.0, 1.0)
    seen = np.isfinite(found.depth)
    both = there & seen
    wrong = np.abs(found.depth - true)
    n_thresholds = whole("n_thresholds", n_thresholds)
    # each leaves out as many cells more; brightness may vary by orders of magnitude
    shares = np.arange(n_thresholds) / n_thresholds
    thresholds = np.quantile(found.confidence[both], shares) if both.any() else shares
    curve = np.full((n_thresholds, 3), np.nan)
    curve[:, 0] = thresholds
    for i, share in enumerate(thresholds):
        kept = both & (found.confidence >= share)
        curve[i, 2] = kept.sum() / there.sum()
        if kept.any():
            curve[i, 1] = wrong[kept].mean()
    allowed = np.isfinite(curve[:, 1]) & (curve[:, 2] >= least)
    if not allowed.any():
        raise SamplingError(
            f"at most {curve[0, 2]:.3g} of the true cells have a depth, limit {least:g}; image a "
            "larger volume or lower min_coverage"
        )
    best = int(np.argmin(np.where(allowed, curve[:, 1], np.inf)))
    taken = seen & (found.confidence >= thresholds[best])
    return DepthError(
        mae=float(curve[best, 1]),
        threshold=float(thresholds[best]),
        coverage=float(curve[best, 2]),
        missed=float(1.0 - curve[best, 2]),
        false=float((taken & ~there).sum() / max(1, taken.sum())),
        median=float(np.median((found.depth - true)[taken & there])),
        curve=curve,
    )


def true_depths(meshes: trimesh.Trimesh | Iterable[trimesh.Trimesh], volume: Volume) -> Array:
    """Return the true depth map of meshes: distance from the wall to the first surface along +z.

    One ray is traced from each cell centre on the wall z = 0.

    Parameters
    ----------
    meshes : trimesh.Trimesh or iterable of them
        Hidden surfaces, world frame, m.
    volume : Volume
        Volume whose x and y are the cell centres; its depths are ignored.

    Returns
    -------
    ndarray
        Distances from the wall, (ny, nx), m; NaN where the ray meets no surface.

    Raises
    ------
    SceneError
        If there is no mesh.

    See Also
    --------
    depth_error : Error of a depth map.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics.transient import Volume, true_depths
    >>> box = trimesh.creation.box((1.0, 1.0, 1.0)).apply_translation((0.0, 0.0, 1.5))
    >>> print(true_depths(box, Volume([0.1, 2.0], [0.2], [1.0])))
    [[ 1. nan]]
    """
    from ...raytrace import intersect_mesh

    expect("volume", volume, "Volume")
    several = each("meshes", meshes if isinstance(meshes, Iterable) else [meshes], "Trimesh")
    if not several:
        raise SceneError("no mesh was given; give at least one")
    origins = np.zeros((len(volume.y), len(volume.x), 3))
    origins[..., 0], origins[..., 1] = volume.x, volume.y[:, None]
    nearest = np.full(origins.shape[:2], np.inf)
    for mesh in several:
        hits = intersect_mesh(mesh, origins, (0.0, 0.0, 1.0))
        nearest = np.where(hits.status == 0, np.minimum(nearest, hits.distance), nearest)
    return np.where(np.isfinite(nearest), nearest, np.nan)
