"""Waves on pupil cells from few numbers, each linear in them, in torch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .._checks import fits_memory, real, whole
from ..errors import SamplingError, SceneError
from ..psf.zernikes import zernike
from .pupil_optics import PupilOptics

Array = NDArray[np.float64]
#: Noll's defocus.
DEFOCUS = 4


class ZernikeWaves(nn.Module):
    """Sums of Zernike polynomials.

    Parameters
    ----------
    modes : iterable of int
        Noll indices, each once, not 1: piston moves nothing.
    optics : PupilOptics

    Attributes
    ----------
    leaf_shape : (int,)
        Shape of one set of coefficients: waves rms over the full disc.
    """

    _basis: Tensor

    def __init__(self, modes: Iterable[int], optics: PupilOptics) -> None:
        super().__init__()
        self.modes = _checked_modes(modes)
        self.leaf_shape: tuple[int, ...] = (len(self.modes),)
        lit = int(np.count_nonzero(optics.share))
        if lit < len(self.modes):
            raise SamplingError(
                f"{lit} pupil cells cannot hold {len(self.modes)} modes; use fewer modes or a "
                "larger shape"
            )
        size = optics.share.size * len(self.modes)
        fits_memory(f"{len(self.modes)} modes on the pupil", 24.0 * size, "use fewer modes")
        basis = np.stack([noll_mode(mode, optics) for mode in self.modes])
        self.register_buffer("_basis", like(optics, basis))

    def forward(self, coefficients: Tensor) -> Tensor:
        """Aberration over wavelength, (..., n_v, n_u), 0 outside the pupil."""
        flat = coefficients @ self._basis.flatten(1)
        return flat.reshape(*coefficients.shape[:-1], *self._basis.shape[1:])


def noll_mode(mode: int, optics: PupilOptics) -> Array:
    """Zernike polynomial on the pupil's cells, rms 1 over the disc, (n_v, n_u)."""
    v, u = np.meshgrid(optics.v, optics.u, indexing="ij")
    values = zernike(mode, np.hypot(u, v) / optics.pupil_radius, np.arctan2(v, u))
    return np.where(optics.share > 0, values, 0.0)


def like(optics: PupilOptics, values: Any) -> Tensor:
    """Tensor of an array, where and as precise as the optics."""
    array = np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    return torch.tensor(array, device=optics.device, dtype=optics.dtype)


def start_values(modes: Sequence[int] | Mapping[int, float], wavelength: float) -> list[float]:
    """Coefficients in waves of a mapping from mode to metres; 0 for a sequence."""
    if not isinstance(modes, Mapping):
        return [0.0] * len(modes)
    return [real(f"modes[{mode}]", value) / wavelength for mode, value in modes.items()]


def _checked_modes(modes: Iterable[int]) -> tuple[int, ...]:
    if isinstance(modes, (str, int, float)) or not hasattr(modes, "__iter__"):
        raise SceneError(f"modes = {modes!r}; give a sequence of Noll indices")
    found = tuple(whole("mode", mode, 1) for mode in modes)
    if not found:
        raise SceneError("modes is empty; give Noll indices from 2 on")
    if 1 in found:
        raise SceneError("modes holds 1, piston, which moves no image; leave it out")
    if len(set(found)) < len(found):
        twice = next(mode for mode in found if found.count(mode) > 1)
        raise SceneError(f"modes holds {twice} more than once; give each index once")
    return found
