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
