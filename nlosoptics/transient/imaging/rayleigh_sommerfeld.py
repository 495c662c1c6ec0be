"""Propagation of fields from wall points into a volume by direct summation, the reference method.

The field of a wave with wavenumber k at a voxel x is the Rayleigh-Sommerfeld sum over the wall

    F_k(x) = sum_ji s_k[j, i] exp(i k (|x - far_j| + |x - near_i|)),

without the far leg if the illumination is not focused. The sign of the phase propagates back in
time, from the wall to the origin of the light. Paths have equal weights: Liu et al., Nature 572,
620 (2019), drop 1/r because it varies little over the wall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .virtual_pulse import Band, blocks
from .volume import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

#: Number of terms (paths times waves) in one step of the direct sum.
STEP = 2e8

Advance = Callable[[float], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Legs:
    """Wall points at both ends of the paths to a voxel."""

    near: Array  # (n, 3), m: points of the camera, each with a spectrum
    far: Array  # (m, 3), m: points of the focused illumination; (0, 3) if paths have one leg only
    # Whether far point i belongs to near point i only, instead of to all near points
    paired: bool = False

    @property
    def twice(self) -> bool:
        """Whether both legs of each path are equal."""
        return self.paired and bool(np.allclose(self.near, self.far, rtol=0.0, atol=1e-9))


def direct_sum(
    volume: Volume, legs: Legs, band: Band, spectra: ComplexArray, times: Array, advance: Advance
) -> ComplexArray:
    """Return the field at each voxel by summing over every path.

    Returns (t, nz, ny, nx) complex128.
    """
    from . import _phasor_kernels as kernels

    waves = band.wavenumbers
    voxels = volume.points.reshape(-1, 3)
    fields = np.empty((len(times), len(voxels)), dtype=np.complex128)
    last = np.ascontiguousarray(np.moveaxis(spectra, 0, -1).astype(np.complex128))
    turns = np.exp(1j * np.outer(times, waves))
    kind = kernels.ALONE if not len(legs.far) else kernels.PAIRED if legs.paired else kernels.ALL
    far = legs.far if len(legs.far) else legs.near[:1]
    for part in blocks(len(voxels), max(1, int(STEP // last.size))):
        out = np.empty((len(times), part.stop - part.start), dtype=np.complex128)
        kernels.direct_sum(
            voxels[part], legs.near, far, kind, waves[0], band.step, last, turns, out
        )
        fields[:, part] = out
        advance(part.stop / len(voxels))
    return fields.reshape(len(times), *volume.shape)
