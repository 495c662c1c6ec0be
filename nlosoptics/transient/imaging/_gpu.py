"""Convolutions of `plane_convolutions` in torch, for GPUs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MissingExtraError, SceneError
from .plane_convolutions import Lattice
from .rayleigh_sommerfeld import Advance, Legs
from .virtual_pulse import Band, blocks
from .volume import Volume

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]


def carry(
    volume: Volume,
    legs: Legs,
    grid: Lattice,
    band: Band,
    spectra: ComplexArray,
    times: Array,
    device: str,
    advance: Advance,
) -> ComplexArray:
    """Return the field at each voxel, computed in torch.

    Returns (t, nz, ny, nx) complex, in the precision of ``spectra``.
    """
    try:
        import torch
    except ImportError:
        raise MissingExtraError(
            "device needs torch; install nlosoptics[inverse], or omit device"
        ) from None
    try:
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise SceneError(f"device = {device!r} is not available: {reason}; omit device") from None
    with torch.inference_mode():
        fields = _planes(torch, volume, legs, grid, band, spectra, times, device, advance)
        return np.asarray(fields.cpu().numpy())


def _planes(
    torch: Any,
    volume: Volume,
    legs: Legs,
    grid: Lattice,
    band: Band,
    spectra: ComplexArray,
    times: Array,
    device: str,
    advance: Advance,
) -> Any:
    """Convolve the wall spectra with the kernel of each plane, by FFT of the full kernel."""
    y, x = grid.axes
    shape = (y.size(False), x.size(False))
    walls = grid.walls(spectra)
    padded = np.zeros((*walls.shape[:2], *shape), dtype=walls.dtype)
    padded[..., y.places(False)[:, None], x.places(False)] = walls
    light = torch.fft.fft2(torch.as_tensor(padded, device=device))
    up, across = (torch.as_tensor(axis.steps(False), device=device) for axis in grid.axes)
    points = torch.as_tensor(volume.points, device=device)
    far = torch.as_tensor(np.ascontiguousarray(legs.far), device=device)
    fields = torch.zeros((len(times), *volume.shape), dtype=light.dtype, device=device)
    n_far = walls.shape[1]
    for part in blocks(len(volume.z), max(1, 2**26 // (n_far * shape[0] * shape[1]))):
        away = torch.as_tensor(volume.z[part] - grid.depth, device=device)
        ways = 2 if legs.twice else 1
        path = ways * torch.sqrt(away[:, None, None] ** 2 + up[:, None] ** 2 + across**2)
        lead = None
        if len(legs.far) and not legs.paired:
            lead = torch.linalg.norm(points[part, None] - far[:, None, None], dim=-1)
        for k, wave in enumerate(band.wavenumbers):
            response = torch.fft.fft2(torch.exp(1j * wave * path).to(light.dtype))
            planes = torch.fft.ifft2(light[k] * response[:, None])
            planes = planes[..., y.kept, x.kept]
            if lead is not None:
                planes = planes * torch.exp(1j * wave * lead).to(light.dtype)
            plane = planes.sum(dim=1)
            for t, time in enumerate(times):
                fields[t, part] += plane * complex(np.exp(1j * wave * time))
        advance(part.stop / len(volume.z))
    return fields
