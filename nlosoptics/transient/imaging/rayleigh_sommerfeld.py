"""Fields carried from wall points into a volume: the direct sum, the reference of all others.

The field of a wave with wavenumber k at a voxel x is the Rayleigh-Sommerfeld sum over the wall

    F_k(x) = sum_ji s_k[j, i] exp(i k (|x - far_j| + |x - near_i|)),

without the far leg where light was not focused; the sign of the phase looks back in time, from the
wall to where light came from. Voxel weights are equal (Liu et al., Nature 572, 620 (2019), drop the
1/r, which changes little over the wall), or 1/r for each leg.
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

#: Pairs of paths and waves in one step of the direct sum.
STEP = 2e8

Advance = Callable[[float], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Legs:
    """The wall points that paths to a voxel start from and end at.

    Parameters
    ----------
    near : ndarray
        (n, 3), m: each has a spectrum.
    far : ndarray
        (m, 3), m; (0, 3) without a second leg.
    paired : bool
        Whether far_i belongs to near_i, and not to all.
    falls : bool
        Whether each leg divides by its length.
    """

    near: Array
    far: Array
    paired: bool = False
    falls: bool = False

    @property
    def twice(self) -> bool:
        """Whether both legs are the same."""
        return self.paired and bool(np.allclose(self.near, self.far, rtol=0.0, atol=1e-9))


def direct_sum(
    volume: Volume, legs: Legs, band: Band, spectra: ComplexArray, times: Array, advance: Advance
) -> ComplexArray:
    """The field at each voxel by summing every path.

    Parameters
    ----------
    volume : Volume
    legs : Legs
    band : Band
        Its n wavenumbers.
    spectra : ndarray
        (n, m, points) complex, m = 1 unless all far points belong to all near ones.
    times : ndarray
        (t,), m.
    advance : callable
        Takes the share done.

    Returns
    -------
    ndarray
        (t, nz, ny, nx) complex128.
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
            voxels[part], legs.near, far, kind, legs.falls, waves[0], band.step, last, turns, out
        )
        fields[:, part] = out
        advance(part.stop / len(voxels))
    return fields.reshape(len(times), *volume.shape)
