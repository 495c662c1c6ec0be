"""Where a hidden scene is looked for, and what was seen there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import is_single, one_of, pair, positive, vector, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..capture.wall_points import UNEVEN, even_axes, real_array

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Volume(Noun):
    """A grid of points along x, y and z: voxel centres, evenly spaced and rising.

    Parameters
    ----------
    x, y, z : array_like
        (nx,), (ny,) and (nz,), m; one value makes a plane. z is the distance from the wall.

    Raises
    ------
    SamplingError
        If an axis is empty, uneven or falls.
    SceneError
        If a value is not finite.
    """

    x: Array
    y: Array
    z: Array

    def __post_init__(self) -> None:
        for name in ("x", "y", "z"):
            object.__setattr__(self, name, _axis(name, getattr(self, name)))

    @classmethod
    def box(cls, centre: Any, size: Any, pitch: float) -> Volume:
        """Voxels of one pitch that fill a box.

        Parameters
        ----------
        centre, size : array_like of 3 floats
            m; as many voxels as fit best, at least one along each axis.
        pitch : float
            m.
        """
        middle, pitch = vector("centre", centre), positive("pitch", pitch, unit="m")
        extents = vector("size", size)
        if min(extents) < 0.0:
            raise SceneError(f"size = {extents} m has an extent below 0")
        counts = [max(1, round(extent / pitch)) for extent in extents]
        axes = [middle[i] + pitch * (np.arange(n) - 0.5 * (n - 1)) for i, n in enumerate(counts)]
        return cls(*axes)

    @classmethod
    def before(cls, side: Any, count: int, depths: ArrayLike) -> Volume:
        """Planes in front of the wall's cells, of `wall_grid`'s pitch, at given distances.

        Parameters
        ----------
        side : float or (float, float)
            Of the wall, m.
        count : int
            Cells along each side.
        depths : array_like
            (nz,), m.
        """
        width, height = pair("side", side)
        middles = (np.arange(whole("count", count)) + 0.5) / count - 0.5
        return cls(middles * width, middles * height, real_array("depths", depths))

    @classmethod
    def facing(cls, points: ArrayLike, planes: tuple[float, float, float]) -> Volume:
        """Planes in front of a grid of wall points, a voxel before each.

        Parameters
        ----------
        points : array_like
            (ny, nx, 3), m, even to a thousandth of their pitch and rising along x and y.
        planes : (float, float, float)
            First and last distance from the wall and the step, m; the last plane is the last step
            that does not pass it.

        Raises
        ------
        SamplingError
            If the points are no such grid.
        """
        x, y = axes_before(points)
        if is_single(planes) or len(planes) != 3:
            raise SceneError(f"planes = {planes!r} must be (near, far, step), m")
        near, far, step = (
            positive(name, value, unit="m")
            for name, value in zip(("near", "far", "step"), planes, strict=True)
        )
        if far < near:
            raise SceneError(f"far = {far:g} m is before near = {near:g} m; change them about")
        count = int((far - near) / step * (1 + 1e-12) + 1e-9) + 1
        return cls(x, y, near + step * np.arange(count))

    def check_before_wall(self) -> None:
        """Raise `SceneError` if a plane is in the wall z = 0 or behind it."""
        if self.z[0] <= 0.0:
            raise SceneError(
                f"volume.z begins at {self.z[0]:g} m, must be above 0, before the wall; give "
                "planes in the room"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return (len(self.z), len(self.y), len(self.x))

    @property
    def points(self) -> Array:
        """(nz, ny, nx, 3), m."""
        z, y, x = np.meshgrid(self.z, self.y, self.x, indexing="ij")
        return np.stack([x, y, z], axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class VolumeImage(Noun, Shown):
    """Brightness of a hidden scene on a volume.

    Parameters
    ----------
    intensity : ndarray
        (nz, ny, nx), non-negative, any unit.
    volume : Volume
    method : str
        What made it.
    seconds : float
        That it took.
    details : mapping
        Parameters and figures of the method.
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
                "volume"
            )
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))

    def _figures(self) -> Figures:
        volume = self.volume
        ends = {
            f"{name} (m)": f"{axis[0]:.4g} to {axis[-1]:.4g}, {len(axis)} planes"
            for name, axis in (("x", volume.x), ("y", volume.y), ("z", volume.z))
        }
        figures = {"method": self.method, "seconds": f"{self.seconds:.3g}", **ends}
        alt = "Brightest voxels of the hidden scene as seen from the relay wall"
        return Figures("Volume", figures, alt)

    def projection(self, axis: str = "z") -> Array:
        """Brightest voxel along an axis: (ny, nx) along z, (nz, nx) along y, (nz, ny) along x."""
        return np.asarray(self.intensity.max(axis="zyx".index(one_of("axis", axis, "zyx"))))

    def peak_depth(self) -> Array:
        """Depth of the brightest voxel along z, found between the planes.

        Returns
        -------
        ndarray
            (ny, nx), m: where a parabola through the logarithm of the intensity at the brightest
            plane and its two neighbours is highest; the plane itself at the volume's ends and where
            a neighbour is dark. Every column has one: dim columns are for a threshold to leave out.

        Notes
        -----
        Exact for one surface under a Gaussian envelope, which is the phasor fields' pulse. Planes
        one, a half and a quarter of the wavelength apart, a point is found to 0.5, 0.1 and 0.3 % of
        that distance, by a parabola through the intensity itself to 18, 10 and 3 %.
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
        # both are at least 0 at the brightest plane, so the peak is within half a step
        fall, rise = np.log(top / low), np.log(top / high)
        bend = fall + rise
        shift = np.where(bend > 0.0, 0.5 * (fall - rise) / np.where(bend > 0.0, bend, 1.0), 0.0)
        return np.asarray(depth + shift * (z[1] - z[0]))


def axes_before(points: ArrayLike) -> tuple[Array, Array]:
    """Axes x and y of the voxels before an even grid of wall points (ny, nx, 3), rising."""
    grid = real_array("wall points", points)
    if grid.ndim != 3 or grid.shape[-1] != 3 or grid.size == 0:
        raise SamplingError(
            f"wall points of shape {grid.shape} are no grid (ny, nx, 3); give a Volume by its axes"
        )
    x, y, off = even_axes(grid)
    if off > UNEVEN:
        raise SamplingError(
            f"wall points are up to {off:.2g} of their pitch off an even grid along x and y, limit "
            f"{UNEVEN:g}; give a Volume by its axes"
        )
    return x, y


def _axis(name: str, values: ArrayLike) -> Array:
    axis = real_array(f"volume.{name}", values, ndmin=1)
    if axis.ndim != 1 or axis.size == 0:
        raise SamplingError(f"volume.{name} has shape {axis.shape}, must be (n,), m")
    if not np.isfinite(axis).all():
        raise SceneError(f"volume.{name} has values that are not finite")
    steps = np.diff(axis)
    # four roundings of single precision, in which files and arrays of others come
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(axis).max())
    if len(steps) and (steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean() + rounding):
        raise SamplingError(
            f"volume.{name} steps by {steps.min():.9g} to {steps.max():.9g} m; give values that "
            "rise evenly"
        )
    return axis


ComplexArray = NDArray[np.complexfloating]
Camera = Literal["confocal_time_gated", "transient", "direct_light", "projector_camera"]


@dataclass(frozen=True, eq=False, kw_only=True)
class PhasorImage(VolumeImage):
    """A phasor field on a volume; ``intensity`` is its largest squared modulus over time.

    Parameters
    ----------
    field : ndarray
        (nz, ny, nx) complex, or (n_times, nz, ny, nx) where times were asked for; in the unit of
        the capture's H.
    camera : {"confocal_time_gated", "transient", "direct_light", "projector_camera"}
    wl_mean, wl_sigma : float
        Of the virtual pulse, m of optical path.
    times : ndarray, optional
        (n_times,), m of optical path.
    aperture : float or ndarray of bool, optional
        What of the wall was used; None: all.
    notes : tuple of str
        Where the sampling limits the picture; each was warned of as well.
    """

    field: ComplexArray
    camera: Camera
    wl_mean: float
    wl_sigma: float
    times: Array | None = None
    aperture: Any = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.volume.shape if self.times is None else (len(self.times), *self.volume.shape)
        if self.field.shape != shape:
            raise SamplingError(f"field has shape {self.field.shape}, must be {shape}")
