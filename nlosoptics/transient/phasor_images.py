"""What a virtual camera of phasor fields saw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError
from .volumes import VolumeImage

Array = NDArray[np.floating]
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

    def peak_depth(self) -> Array:
        """Depth of the brightest voxel along z, found between the planes.

        Returns
        -------
        ndarray
            (ny, nx), m: where a parabola through the logarithm of the intensity at the brightest
            plane and its two neighbours is highest, which is exact for one surface under the
            pulse's Gaussian envelope; the plane itself at the volume's ends and where a neighbour
            is dark. Every column has one: dim columns are for a threshold to leave out.
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
        ones = np.where(inside, 1.0, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            fall, rise = np.log(top / low) * ones, np.log(top / high) * ones
            # both are at least 0 at the brightest plane, so the peak is within half a step
            shift = 0.5 * (fall - rise) / (fall + rise)
        shift = np.where(inside & np.isfinite(shift), shift, 0.0)
        return np.asarray(depth + shift * (z[1] - z[0]))
