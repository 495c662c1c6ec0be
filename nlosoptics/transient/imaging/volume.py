"""Voxel grids and the images reconstructed on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import counted, fits_memory, is_single, one_of, pair, positive, vector, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._xarray import Labelled, Labels, Variable, variable
from ...errors import SamplingError, SceneError
from ..capture.wall_points import UNEVEN, even_axes, real_array

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Volume(Noun):
    """Rectangular grid of voxels in the hidden space, given by the coordinates of their centres.

    Images are reconstructed on such a grid. `Volume.box` fills a box with voxels, and
    `Volume.before` and `Volume.facing` place them in front of the points of a wall grid.

    Parameters
    ----------
    x, y, z : array_like
        Centres along each axis, (nx,), (ny,) and (nz,), world frame, m, evenly spaced and
        increasing. An axis may have a single value. z is the distance from the wall.

    Raises
    ------
    SamplingError
        If an axis is empty, unevenly spaced or not increasing.
    SceneError
        If a value is not finite.

    See Also
    --------
    VolumeImage : Image on a voxel grid.
    phasor_image : Image by virtual waves, for any capture.

    Examples
    --------
    >>> from nlosoptics.transient import Volume
    >>> volume = Volume.box(centre=(0.0, 0.0, 1.0), size=(0.4, 0.2, 0.2), pitch=0.1)
    >>> volume.shape
    (2, 2, 4)
    >>> print(volume.x.round(3))
    [-0.15 -0.05  0.05  0.15]
    """

    x: Array
    y: Array
    z: Array

    def __post_init__(self) -> None:
        for name in ("x", "y", "z"):
            object.__setattr__(self, name, _axis(name, getattr(self, name)))

    @classmethod
    def box(cls, centre: Any, size: Any, pitch: float) -> Volume:
        """Return a volume of cubic voxels that fills a box.

        Parameters
        ----------
        centre : array_like of 3 floats
            Centre of the box, world frame, m.
        size : array_like of 3 floats
            Extents of the box along x, y and z, m. Each is rounded to a whole number of voxels, at
            least one.
        pitch : float
            Side of a voxel, m.

        Returns
        -------
        Volume
            Voxels centred in the box.

        Raises
        ------
        SceneError
            If an extent is below 0 or ``pitch`` is not above 0.
        """
        middle, pitch = vector("centre", centre), positive("pitch", pitch, unit="m")
        extents = vector("size", size)
        if min(extents) < 0.0:
            raise SceneError(f"size = {extents} m has an extent below 0; give extents from 0 up")
        counts = [max(1, round(extent / pitch)) for extent in extents]
        axes = [middle[i] + pitch * (np.arange(n) - 0.5 * (n - 1)) for i, n in enumerate(counts)]
        return cls(*axes)

    @classmethod
    def before(cls, side: Any, count: int, depths: ArrayLike) -> Volume:
        """Return a volume whose x and y are the cell centres of a wall grid, about the origin.

        Parameters
        ----------
        side : float or (float, float)
            Side of the wall, or its extents along x and y, m.
        count : int
            Number of cells along each side, as in `wall_grid`.
        depths : array_like
            Distances of the planes of voxels from the wall, (nz,), m, evenly spaced.

        Returns
        -------
        Volume
            Voxels (nz, count, count).
        """
        width, height = pair("side", side)
        middles = (np.arange(whole("count", count)) + 0.5) / count - 0.5
        return cls(middles * width, middles * height, real_array("depths", depths))

    @classmethod
    def facing(cls, points: ArrayLike, planes: tuple[float, float, float]) -> Volume:
        """Return a volume whose x and y are those of given wall points, at evenly spaced depths.

        On such a volume, `phasor_image` can use its fast method.

        Parameters
        ----------
        points : array_like
            Wall points, (ny, nx, 3), world frame, m, increasing along x and y, and evenly spaced
            to 1/1000 of the pitch.
        planes : (float, float, float)
            Nearest and farthest distance of a plane of voxels from the wall, and the step, m. The
            first plane is at the nearest distance; the last one does not exceed the farthest.

        Returns
        -------
        Volume
            Voxels (nz, ny, nx).

        Raises
        ------
        SamplingError
            If the points are not an evenly spaced grid.
        SceneError
            If ``planes`` is not an increasing range above 0.
        """
        x, y = axes_before(points)
        if is_single(planes) or len(planes) != 3:
            raise SceneError(f"planes = {planes!r} must be (near, far, step), m")
        near, far, step = (
            positive(name, value, unit="m")
            for name, value in zip(("near", "far", "step"), planes, strict=True)
        )
        if far < near:
            raise SceneError(f"far = {far:g} m is before near = {near:g} m; swap them")
        count = (far - near) / step * (1 + 1e-12) + 1 + 1e-9
        voxels = f"a volume of {len(x)} x {len(y)} x {count:.3g} voxels"
        fits_memory(voxels, 8.0 * count * len(x) * len(y), "use a larger step")
        return cls(x, y, near + step * np.arange(int(count)))

    def check_before_wall(self) -> None:
        """Raise `SceneError` if voxels lie in the wall, z = 0, or behind it."""
        if self.z[0] <= 0.0:
            raise SceneError(
                f"volume.z begins at {self.z[0]:g} m, must be above 0, in front of the wall; give "
                "larger depths"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels, (nz, ny, nx)."""
        return (len(self.z), len(self.y), len(self.x))

    @property
    def points(self) -> Array:
        """Centres of the voxels, (nz, ny, nx, 3), world frame, m."""
        z, y, x = np.meshgrid(self.z, self.y, self.x, indexing="ij")
        return np.stack([x, y, z], axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class VolumeImage(Noun, Shown, Labelled):
    """Reconstructed image of a hidden scene on the voxels of a volume.

    Parameters
    ----------
    intensity : ndarray
        Value of each voxel, (nz, ny, nx), at least 0; the unit depends on the method.
    volume : Volume
        Positions of the voxels.
    method : str
        Name of the reconstruction method, such as "lct".
    seconds : float
        Computation time, s.
    details : mapping
        Options and further results of the method, by name.

    Raises
    ------
    SamplingError
        If ``intensity`` is not shaped like the volume.

    See Also
    --------
    fk_migration : Wave-based image of a confocal capture.
    depth_map : Depths of an image.
    nlosoptics.views.volume : Projections of a volume.
    """

    intensity: Array
    volume: Volume
    method: str
    seconds: float = 0.0
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.intensity.shape != self.volume.shape:
            raise SamplingError(
                f"intensity has shape {self.intensity.shape}, must be {self.volume.shape} like the "
                "volume; give one value per voxel"
            )
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))

    def _figures(self) -> Figures:
        volume = self.volume
        ends = {
            f"{name} (m)": f"{axis[0]:.4g} to {axis[-1]:.4g}, {counted(len(axis), 'plane')}"
            for name, axis in (("x", volume.x), ("y", volume.y), ("z", volume.z))
        }
        figures = {"method": self.method, "seconds": f"{self.seconds:.3g}", **ends}
        alt = "Brightest voxels of the hidden scene as seen from the relay wall"
        return Figures("Volume", figures, alt)

    def _labels(self) -> Labels:
        volume = self.volume
        axes = {n: variable(n, getattr(volume, n), "m", f"world {n}") for n in "zyx"}
        light = variable("zyx", self.intensity, "1", f"intensity by {self.method}")
        return Labels({"intensity": light}, axes, {"method": self.method})

    def projection(self, axis: str = "z") -> Array:
        """Return the image seen along an axis: the largest intensity on each line of voxels.

        Parameters
        ----------
        axis : {"x", "y", "z"}
            Axis along which to take the maximum; "z" is the view from the wall.

        Returns
        -------
        ndarray
            Maximum intensity projection, (ny, nx) for "z", (nz, nx) for "y", (nz, ny) for "x".
        """
        return np.asarray(self.intensity.max(axis="zyx".index(one_of("axis", axis, "zyx"))))

    def peak_depth(self) -> Array:
        """Return the depth of the maximum along z for each x and y, interpolated between voxels.

        Returns
        -------
        ndarray
            Distance from the wall, (ny, nx), m. A parabola is fitted to the logarithm of the
            intensity of the brightest voxel and its two neighbours along z, and the depth is that
            of its vertex. If the brightest voxel is the first or the last one, or if a neighbour is
            0, the depth is that of the brightest voxel. Dark lines of voxels get a depth, too; use
            `depth_map` with a threshold to exclude them.

        Notes
        -----
        The interpolation is exact for a single surface with a Gaussian intensity over depth, as the
        pulse of `phasor_image` gives. For a point imaged by `phasor_image`, on planes spaced by 1,
        1/2 and 1/4 of the virtual wavelength, the error is below 0.6 % of the spacing. A
        parabola through the intensity itself would give 18, 10 and 3 %.
        """
        light, z = self.intensity, self.volume.z
        best = light.argmax(axis=0)
        depth = z[best]
        if len(z) < 3:
            return np.asarray(depth)
        middle = np.clip(best, 1, len(z) - 2)
        rows, columns = np.indices(best.shape)
        low, top, high = (
            light[middle + step, rows, columns].astype(np.float64) for step in (-1, 0, 1)
        )
        inside = (best == middle) & (np.minimum(low, high) > 0.0)
        low, top, high = (np.where(inside, values, 1.0) for values in (low, top, high))
        # both are at least 0 at the brightest plane, so the vertex is within half a step
        fall, rise = np.log(top / low), np.log(top / high)
        bend = fall + rise
        shift = np.where(bend > 0.0, 0.5 * (fall - rise) / np.where(bend > 0.0, bend, 1.0), 0.0)
        return np.asarray(depth + shift * (z[1] - z[0]))


def axes_before(points: ArrayLike) -> tuple[Array, Array]:
    """Return the axes x (nx,) and y (ny,) of an even, rising grid of wall points (ny, nx, 3)."""
    grid = real_array("wall points", points)
    if grid.ndim != 3 or grid.shape[-1] != 3 or grid.size == 0:
        raise SamplingError(
            f"wall points of shape {grid.shape} are no grid (ny, nx, 3); give a line of n points "
            "as (1, n, 3), or phasor_image a Volume by its axes"
        )
    x, y, off = even_axes(grid)
    if off > UNEVEN:
        raise SamplingError(
            f"wall points are {off:.2g} pitches off an even grid, limit {UNEVEN:g}; give a Volume"
        )
    return x, y


def _axis(name: str, values: ArrayLike) -> Array:
    axis = real_array(f"volume.{name}", values, ndmin=1)
    if axis.ndim != 1 or axis.size == 0:
        raise SamplingError(f"volume.{name} has shape {axis.shape}, must be (n,); give a list in m")
    if not np.isfinite(axis).all():
        raise SceneError(f"volume.{name} has values that are not finite; give finite numbers in m")
    steps = np.diff(axis)
    # allow four rounding errors of single precision, because many files store coordinates so
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(axis).max())
    if len(steps) and (steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean() + rounding):
        raise SamplingError(
            f"volume.{name} steps by {steps.min():.9g} to {steps.max():.9g} m, must have equal "
            "steps above 0; give values that rise evenly"
        )
    return axis


ComplexArray = NDArray[np.complexfloating]
Camera = Literal["confocal_time_gated", "transient", "direct_light"]


@dataclass(frozen=True, eq=False, kw_only=True)
class PhasorImage(VolumeImage):
    """Image of a hidden scene and its complex field, as `phasor_image` computes them.

    A virtual wave, with a wavelength of centimetres to decimetres, takes the place of the laser
    light. The image has all attributes of `VolumeImage`; its ``intensity`` is the largest squared
    modulus of the field over the times.

    Parameters
    ----------
    field : ndarray
        Complex field of the virtual wave: (n_times, nz, ny, nx) if times were given, else
        (nz, ny, nx). Its unit is that of ``TransientCapture.H``, the signal of the capture in each
        bin.
    camera : {"confocal_time_gated", "transient", "direct_light"}
        Virtual camera, see `phasor_image`.
    wl_mean, wl_sigma : float
        Wavelength of the virtual wave, and standard deviation of its Gaussian pulse, m.
    times : ndarray, optional
        Times of ``field``, (n_times,), m of optical path. None: t = 0 alone.
    aperture : float, optional
        Part of the laser and sensor points that was used: those in a square of this side about
        their centre, m. None: all.
    notes : tuple of str
        Warnings: one text for each limit of sampling that the image exceeds.

    See Also
    --------
    phasor_image : Image by virtual waves, for any capture.
    VolumeImage : Image on a voxel grid.
    nlosoptics.views.phasor_volume : Isosurface of a volume in 3-D.
    """

    field: ComplexArray
    camera: Camera
    wl_mean: float
    wl_sigma: float
    times: Array | None = None
    aperture: float | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.volume.shape if self.times is None else (len(self.times), *self.volume.shape)
        if self.field.shape != shape:
            raise SamplingError(
                f"field has shape {self.field.shape}, must be {shape}; give one value per voxel "
                "and time"
            )

    def _labels(self) -> Labels:
        (arrays, axes, values), names = super()._labels(), [*"zyx"]
        more: dict[str, Variable] = {}
        if self.times is not None:
            names = ["path", *names]
            more["path"] = variable(["path"], self.times, "m", "optical path")
        field = variable(names, self.field, "1", "complex field of the virtual wave")
        told = {"wl_mean": self.wl_mean, "wl_sigma": self.wl_sigma}
        return Labels({**arrays, "field": field}, {**axes, **more}, {**values, **told})
