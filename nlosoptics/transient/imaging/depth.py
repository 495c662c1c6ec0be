"""Depth maps of pictures and meshes, and how far they are apart."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, is_single, whole
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..capture.wall_points import real_array
from .volume import Volume, VolumeImage

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthMap(Noun):
    """Distance from the wall of what is seen along z.

    Parameters
    ----------
    depth : ndarray
        (ny, nx), m; NaN where nothing is.
    confidence : ndarray
        (ny, nx), brightness at that depth over the brightest of all, 0 to 1.
    x, y : ndarray
        (nx,) and (ny,), m.
    threshold : float
        Confidence below which nothing was taken to be.
    """

    depth: Array
    confidence: Array
    x: Array
    y: Array
    threshold: float

    @property
    def coverage(self) -> float:
        """Share of the map where something is."""
        return float(np.mean(np.isfinite(self.depth)))


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthError(Noun):
    """Mean absolute error of a depth map at its best threshold.

    Parameters
    ----------
    mae : float
        m, over the cells where both maps have a depth.
    threshold : float
        Of confidence, the one of the least error.
    coverage : float
        Share of the true map's cells that are found at this threshold.
    missed, false : float
        Shares of the true cells without a found depth, and of found cells without a true one.
    median : float
        Of found minus true, m.
    curve : ndarray
        (n, 3), thresholds, their errors, m, and coverages; NaN errors where no cell is left.
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
    """Depth of the brightest voxel along z.

    Parameters
    ----------
    image : VolumeImage
    threshold : float, optional
        Columns whose peak is below this share of the brightest voxel hold nothing; None: only
        those without any light.
    interpolate : bool
        Whether the depth is found between the planes, `VolumeImage.peak_depth`, at most half a
        voxel away, not the voxel's own.

    Raises
    ------
    SceneError
        If the picture is dark, holds NaN, or the threshold is not from 0 to 1.
    """
    share = 0.0 if threshold is None else in_range("threshold", threshold, 0.0, 1.0)
    values, z = image.intensity, image.volume.z
    brightest = float(values.max())
    if not np.isfinite(values).all() or brightest <= 0.0:
        raise SceneError(
            f"the brightest voxel is {brightest:g}, must be above 0 and finite, to have a depth"
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
    )


def depth_error(
    found: DepthMap | VolumeImage,
    truth: DepthMap | ArrayLike,
    *,
    n_thresholds: int = 100,
    min_coverage: float = 0.5,
) -> DepthError:
    """Mean absolute error of depths at the best threshold of confidence.

    Parameters
    ----------
    found : DepthMap or VolumeImage
        A picture's map is `depth_map`.
    truth : DepthMap or array_like
        (ny, nx), m, NaN where nothing is.
    n_thresholds : int
        Shares of the brightest that are tried, evenly from 0 up to 1.
    min_coverage : float
        Share of the true cells that a threshold must leave, or the best one keeps a single cell.

    Raises
    ------
    SamplingError
        If the maps differ in shape or cells, or no threshold leaves enough cells.
    SceneError
        If the true map is empty.

    Notes
    -----
    The error is taken over the cells where both have a depth; ``missed`` and ``false`` say how many
    have one alone.
    """
    if isinstance(found, VolumeImage):
        found = depth_map(found)
    true = real_array("true depths", truth.depth if isinstance(truth, DepthMap) else truth)
    if true.shape != found.depth.shape:
        raise SamplingError(
            f"true depths have shape {true.shape}, must be {found.depth.shape} like those found"
        )
    if isinstance(truth, DepthMap):
        off = max(float(np.abs(truth.x - found.x).max()), float(np.abs(truth.y - found.y).max()))
        if off > 1e-6:
            raise SamplingError(
                f"true depths are of cells up to {off:g} m beside those found; take one grid for "
                "both"
            )
    there = np.isfinite(true)
    if not there.any():
        raise SceneError("the true depths are all NaN; there is nothing to be found")
    least = in_range("min_coverage", min_coverage, 0.0, 1.0)
    seen = np.isfinite(found.depth)
    both = there & seen
    wrong = np.abs(found.depth - true)
    n_thresholds = whole("n_thresholds", n_thresholds)
    thresholds = np.arange(n_thresholds) / n_thresholds
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
            f"at most {curve[0, 2]:.3g} of the true cells have a depth, limit {least:g}; look in a "
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


def true_depths(
    meshes: trimesh.Trimesh | Iterable[trimesh.Trimesh], grid: Volume | tuple[ArrayLike, ArrayLike]
) -> Array:
    """Distance along +z from the wall to the first surface, by rays through cell centres.

    Parameters
    ----------
    meshes : trimesh.Trimesh or several
        World, m.
    grid : Volume or (x, y)
        Whose cells; (nx,) and (ny,), m. A volume's depths limit nothing.

    Returns
    -------
    ndarray
        (ny, nx), m; NaN where a ray meets no surface.

    Raises
    ------
    SceneError
        If there is no mesh, or the cells are neither of the two.
    SamplingError
        If an axis has more than one dimension.
    """
    from ...raytrace import intersect_mesh

    x, y = (grid.x, grid.y) if isinstance(grid, Volume) else _cells(grid)
    origins = np.zeros((len(y), len(x), 3))
    origins[..., 0], origins[..., 1] = x, y[:, None]
    nearest = np.full((len(y), len(x)), np.inf)
    for mesh in _several(meshes):
        hits = intersect_mesh(mesh, origins, (0.0, 0.0, 1.0))
        nearest = np.where(hits.status == 0, np.minimum(nearest, hits.distance), nearest)
    return np.where(np.isfinite(nearest), nearest, np.nan)


def voxelised(
    meshes: trimesh.Trimesh | Iterable[trimesh.Trimesh], volume: Volume
) -> NDArray[np.bool_]:
    """Which voxels a surface passes through, as rays through their centres see it.

    Parameters
    ----------
    meshes : trimesh.Trimesh or several
        World, m.
    volume : Volume
        With at least two voxels along z.

    Returns
    -------
    ndarray of bool
        (nz, ny, nx). The rays run along each axis that has voxels, so that a surface along one of
        them is met by those along the others.

    Raises
    ------
    SamplingError
        If the volume has one voxel along z.
    SceneError
        If there is no mesh.
    """
    if len(volume.z) < 2:
        raise SamplingError("voxels need a depth; give a volume of at least 2 along z")
    several, axes = _several(meshes), (volume.x, volume.y, volume.z)
    full = np.zeros([len(a) for a in axes], dtype=bool)
    for along in range(3):
        if len(axes[along]) > 1:
            for mesh in several:
                _pierce(np.moveaxis(full, along, -1), mesh, axes, along)
    return np.ascontiguousarray(full.transpose(2, 1, 0))


def _pierce(
    full: NDArray[np.bool_], mesh: trimesh.Trimesh, axes: tuple[Array, ...], along: int
) -> None:
    """Mark the voxels (across, across, along) in which rays along an axis meet a mesh."""
    from ...raytrace import all_hits

    across = [i for i in range(3) if i != along]
    axis = axes[along]
    pitch = axis[1] - axis[0]
    origins = np.empty((*full.shape[:2], 3))
    origins[..., across[0]] = axes[across[0]][:, None]
    origins[..., across[1]] = axes[across[1]]
    origins[..., along] = axis[0] - 0.5 * pitch
    hits = all_hits(mesh, origins, np.eye(3)[along])
    level = np.floor(hits.distance / pitch).astype(np.int64)
    inside = level < len(axis)
    rows, columns = np.unravel_index(hits.ray[inside], full.shape[:2])
    full[rows, columns, level[inside]] = True


def _cells(grid: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    """Axes (nx,) and (ny,)."""
    if is_single(grid) or len(grid) != 2:
        raise SceneError("grid is neither a Volume nor (x, y); give one of them")
    x, y = (real_array(f"grid.{n}", v, ndmin=1) for n, v in zip("xy", grid, strict=True))
    if x.ndim != 1 or y.ndim != 1:
        raise SamplingError(f"grid has axes of shapes {x.shape} and {y.shape}, must be (n,), m")
    return x, y


def _several(meshes: trimesh.Trimesh | Iterable[trimesh.Trimesh]) -> Sequence[trimesh.Trimesh]:
    import trimesh

    several = [meshes] if isinstance(meshes, trimesh.Trimesh) else list(meshes)
    if not several:
        raise SceneError("no mesh was given; give at least one")
    return several
