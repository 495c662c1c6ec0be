"""Kernels in frames with nothing around, in torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ..imaging.forward_model import padded_grid


def padded_transfer(kernel: Tensor, frame: tuple[int, int]) -> tuple[tuple[int, int], Tensor]:
    """FFT grid of a frame, and ``rfft2`` of kernels on it.

    Parameters
    ----------
    kernel : Tensor
        (..., ky, kx), centre at [ky//2, kx//2].
    frame : (int, int)
        Rows and columns of object and image.

    Returns
    -------
    grid : (int, int)
        As of `imaging.ForwardModel`.
    transfer : Tensor
        (..., rows, columns//2 + 1), origin at sample [0, 0]. What cannot reach from one edge of
        the frame to the other is left out.
    """
    sides = kernel.shape[-2:]
    grid = padded_grid(tuple(sides), frame)
    places, cuts = [], []
    for side, length in zip(sides, frame, strict=True):
        centre = side // 2
        first = max(0, centre - length + 1)
        cuts.append(slice(first, min(side, centre + length)))
        places.append(first - centre)
    kept = kernel[..., cuts[0], cuts[1]]
    room = [n - m for n, m in zip(grid, kept.shape[-2:], strict=True)]
    on_grid = functional.pad(kept, (0, room[1], 0, room[0])).roll(places, (-2, -1))
    transfer: Tensor = torch.fft.rfft2(on_grid)
    return grid, transfer
