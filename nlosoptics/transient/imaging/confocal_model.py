"""Linear model of a confocal capture: counts from albedo, by lateral frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..capture.capture import TransientCapture
from .confocal_grids import ConfocalGrid

Array = NDArray[np.floating]

#: Width of the pulse before its peak, relative to a Gaussian as wide as its later side.
RISE = 0.7


class ConfocalModel:
    """Light of a matt facing surface, at each wall point and bin, for voxels behind wall points.

    The light of a voxel depends on its lateral distance from the wall point alone, so that each
    lateral frequency of the capture is a real matrix (bins, planes) times that of the albedo.

    Parameters
    ----------
    grid : ConfocalGrid
        Wall points and bins.
    z : ndarray
        Depths of the planes of voxels, (nz,), evenly spaced, m.
    pulse : (ndarray, ndarray), optional
        Response of laser and detector: path at the ends of its bins, m, and its sum up to there.
        None: shorter than a bin.
    """

    def __init__(self, grid: ConfocalGrid, z: Array, pulse: tuple[Array, Array] | None) -> None:
        import scipy.fft
        from scipy.special import erf

        nx, ny = len(grid.x), len(grid.y)
        self.shape, self.planes = (ny, nx), z
        fits_memory(
            "the matrices of the lateral frequencies",
            16.0 * (nx + 1) * (ny + 1) * grid.n_bins * len(z),
            "gate the capture, or make it coarser with transient.downsampled",
        )
        steps = grid.x[1] - grid.x[0], grid.y[1] - grid.y[0], z[1] - z[0]
        x = steps[0] * np.arange(nx + 1)
        y = steps[1] * np.arange(ny + 1)[:, None]
        ends = 2.0 * (grid.start + grid.pitch * np.arange(grid.n_bins + 1))[:, None, None]
        light = np.empty((ny + 1, nx + 1, grid.n_bins, len(z)), dtype=np.float32)
        for k, depth in enumerate(z):
            r = np.sqrt(x**2 + y**2 + depth**2)
            # standard deviation of the path over a voxel
            sides = zip((x, y, depth), steps, strict=True)
            width = np.sqrt(sum((2.0 * a * d / r) ** 2 for a, d in sides) / 12.0)
            if pulse is None:
                before = 0.5 * erf((ends - 2.0 * r) / (np.sqrt(2.0) * width))
            else:  # three points with this standard deviation
                before = sum(
                    share * np.interp(ends - 2.0 * r + off * width, *pulse)
                    for share, off in ((0.25, -(2.0**0.5)), (0.5, 0.0), (0.25, 2.0**0.5))
                )
            cosines = (depth / r) ** 4 * (z.mean() / r) ** 4
            light[..., k] = np.moveaxis(np.diff(before, axis=0) * cosines, 0, -1)
        light[-1], light[:, -1] = 0.0, 0.0
        # even over both axes, with the period of twice the grid
        matrices = scipy.fft.dctn(light, type=1, axes=(0, 1), overwrite_x=True)
        self._matrices = matrices.reshape(-1, grid.n_bins, len(z))

    def light(self, albedo: Array) -> Array:
        """Return the expected counts (bins, ny, nx) of an albedo (nz, ny, nx)."""
        return self._back(self._matrices @ self._waves(albedo))

    def adjoint(self, light: Array) -> Array:
        """Return the adjoint of `light`, (nz, ny, nx)."""
        return self._back(self._matrices.transpose(0, 2, 1) @ self._waves(light))

    def _waves(self, values: Array) -> Array:
        """Return real and imaginary parts (frequencies, m, 4) for both signs of the one along y."""
        import scipy.fft

        ny, nx = self.shape
        waves = scipy.fft.rfft2(values.astype(np.float32, copy=False), (2 * ny, 2 * nx))
        both = (waves[:, : ny + 1], waves[:, -np.arange(ny + 1) % (2 * ny)])
        parts = np.stack([part for w in both for part in (w.real, w.imag)], axis=-1)
        return np.ascontiguousarray(parts.reshape(len(values), -1, 4).transpose(1, 0, 2))

    def _back(self, parts: Array) -> Array:
        """Return the values on the grid, the inverse of `_waves`."""
        import scipy.fft

        ny, nx = self.shape
        parts = parts.transpose(1, 0, 2).reshape(-1, ny + 1, nx + 1, 4)
        waves = np.empty((len(parts), 2 * ny, nx + 1), dtype=np.complex64)
        waves[:, : ny + 1] = parts[..., 0] + 1j * parts[..., 1]
        waves[:, ny + 1 :] = (parts[..., 2] + 1j * parts[..., 3])[:, ny - 1 : 0 : -1]
        return np.asarray(scipy.fft.irfft2(waves, (2 * ny, 2 * nx))[:, :ny, :nx])


def direct_pulse(
    capture: TransientCapture, start: int, level: float
) -> tuple[tuple[Array, Array] | None, Array]:
    """Return the response of laser and detector, and the background of each bin.

    Direct light of a confocal capture is the laser's pulse as the detector sees it. Files that
    begin at its peak lack its rise. A Gaussian is assumed then, `RISE` times as wide as one that
    falls to 3/4 like the later side; this width makes measured captures most likely. The tail of
    the direct light adds to the background ``level`` after the scene's light begins in bin
    ``start``.
    """
    mean = capture.H.mean(axis=(1, 2)) - level
    background = np.full(len(mean), level)
    peak = int(mean[:start].argmax()) if start else 0
    if start - peak < 8 or mean[peak] < mean[start:].max():
        return None, background
    fall = np.maximum(mean[peak:start], 0.0)
    rise = np.maximum(mean[:peak], 0.0)
    if not peak:
        # a Gaussian falls to 3/4 after 0.7585 standard deviations
        sigma = RISE * max(float(np.argmax(fall < 0.75 * fall[0])) / 0.7585, 0.5)
        rise = fall[0] * np.exp(-0.5 * (np.arange(-int(4 * sigma), 0) / sigma) ** 2)
    tail = fall[-len(fall) // 4 :] + 1e-12 * fall[0]
    if tail.mean() > 5.0 * np.sqrt(level / capture.H[0].size):  # above the noise of one bin
        slope, height = np.polyfit(np.arange(len(tail)) - len(tail), np.log(tail), 1, w=tail)
        background[start:] += np.exp(height + min(slope, 0.0) * np.arange(len(mean) - start))
    # the path of direct light along the wall is 0
    path = capture.t_start + capture.delta_t * np.arange(peak - len(rise), start + 1)
    total = np.cumsum(np.concatenate([[0.0], rise, fall]))
    return (path, total / total[-1]), background
