"""Differentiable transform from the wave in a circular pupil to its point spread, in torch."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..._checks import fits_memory, in_range, positive, real
from ...errors import SamplingError, SceneError
from ...psf.aperture.quadrature_nodes import circle_shares
from ...psf.window.window import shape_of

Array = NDArray[np.float64]
#: Function of u and v, m, that returns the relative amplitude.
Transmission = Callable[[Array, Array], Array]
#: Relative tolerance when lengths are compared, since they may be given as rounded numbers.
_ROUNDING = 1e-9


class ImageOptions(TypedDict, total=False):
    """Options of `PupilOptics` that do not depend on how the wave is parametrised."""

    pixel_integrated: bool
    device: torch.device | str
    dtype: torch.dtype


class PupilOptics(nn.Module):
    """Fraunhofer transform of a circular pupil to point spread and transfer function.

    It is a fast Fourier transform, of which the image is one period. All results are differentiable
    with respect to the wave.

    ``wavelength``, ``pupil_radius``, ``image_distance``, ``pitch``: wavelength, radius, distance
    from pupil to image, and pixel pitch of the image, m. ``shape`` (int, int): rows H and columns W
    of the image. ``pixel_integrated``: whether values are integrals over square pixels of side
    ``pitch``, which may then be any length; point samples need a pitch of at most lambda |d|/(4
    radius). ``transmission``: relative amplitude as a function of u, v, m; by default 1.
    ``device``: device of the tensors. ``dtype``: ``torch.float32`` or ``torch.float64``.

    ``u``, ``v`` (n_u,): coordinates of the pupil's cells, m, along columns and rows; cell [n_v//2,
    n_u//2] is on the axis. ``share`` (n_v, n_u): fraction of each cell that lies in the pupil.
    ``amplitude`` (n_v, n_u): this fraction times the transmission. ``nyquist_pitch``: largest pitch
    of point samples, m. ``fine_grid`` (int, int): rows and columns of the fine samples; `shape` if
    pixels are small.
    """

    _amplitude: Tensor
    _pixel: Tensor

    def __init__(
        self,
        *,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        pixel_integrated: bool = False,
        transmission: Transmission | None = None,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if dtype not in (torch.float32, torch.float64):
            raise SamplingError(
                f"dtype = {dtype} is not supported by the transform; use torch.float32 or "
                "torch.float64"
            )
        self.wavelength = in_range(
            "wavelength", wavelength, 1e-8, 1e-3, unit="m", remedy="give metres in vacuum"
        )
        self.pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        self.image_distance = real("image_distance", image_distance)
        if self.image_distance == 0.0:
            raise SceneError(
                "image_distance = 0 m, must not be 0; give the signed distance from pupil to image"
            )
        self.pitch = positive("pitch", pitch, unit="m")
        self.shape = shape_of(shape)
        self.pixel_integrated = bool(pixel_integrated)
        self.transmission = transmission
        #: lambda |d|, m^2: pupil pitch times image period
        self._spread = self.wavelength * abs(self.image_distance)
        self.nyquist_pitch = self._spread / (4 * self.pupil_radius)
        if not self.pixel_integrated and self.pitch > self.nyquist_pitch * (1 + _ROUNDING):
            raise SamplingError(
                f"pitch = {self.pitch:.6g} m, limit for point samples (Nyquist) "
                f"{self.nyquist_pitch:.6g} m; use a finer pitch, or pixel_integrated=True"
            )
        self.v, self.u = self._period_axis(0), self._period_axis(1)
        pitch_v, pitch_u = (float(axis[1] - axis[0]) for axis in (self.v, self.u))
        self.pupil_pitch = (pitch_v, pitch_u)
        self._finer, self.fine_grid = self._samples()
        self.share = circle_shares(self.u, self.v, pitch_u, self.pupil_radius, pitch_v)
        self.amplitude = self.share
        if transmission is not None:
            v, u = np.meshgrid(self.v, self.u, indexing="ij")
            lit = self.share > 0
            self.amplitude = np.zeros_like(self.share)
            self.amplitude[lit] = self.share[lit] * transmission(u[lit], v[lit])
        self._prepare(device, dtype)

    def resized(self, shape: int | tuple[int, int], pitch: float) -> PupilOptics:
        """Return these optics in double precision for an image of another shape and pitch, m."""
        return PupilOptics(
            wavelength=self.wavelength,
            pupil_radius=self.pupil_radius,
            image_distance=self.image_distance,
            pitch=pitch,
            shape=shape,
            pixel_integrated=self.pixel_integrated,
            transmission=self.transmission,
            dtype=torch.float64,
        )

    def cell_weights(self) -> Array:
        """Return the pupil function's modulus on the cells, (n_v, n_u); the image sums to 1."""
        return self._amplitude.double().cpu().numpy()

    def pixel_transfer(self) -> Array:
        """Return the transfer function of a pixel for the half spectrum of the fine samples."""
        if not self.pixel_integrated:
            return np.ones((self.fine_grid[0], self.fine_grid[1] // 2 + 1))
        return self._pixel.double().cpu().numpy()

    @property
    def dtype(self) -> torch.dtype:
        """Data type of all real tensors."""
        return self._amplitude.dtype

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self._amplitude.device

    def point_spread(self, turns: Tensor) -> Tensor:
        """Return point spreads (..., H, W), centre at [H//2, W//2].

        ``turns`` (..., n_v, n_u) is the wave aberration divided by the wavelength.
        """
        if not self.pixel_integrated:
            spread = self._periodic(turns)
        else:
            spread = torch.fft.irfft2(self.transfer(turns), s=self.shape)
        centred: Tensor = torch.fft.fftshift(spread, dim=(-2, -1))
        return centred

    def transfer(self, turns: Tensor) -> Tensor:
        """Return ``rfft2`` of the point spreads, (..., H, W//2 + 1), their centre at sample [0, 0].

        ``turns`` (..., n_v, n_u) is the wave aberration divided by the wavelength.
        """
        spectrum: Tensor = torch.fft.rfft2(self._periodic(turns))
        if self.pixel_integrated:
            spectrum = spectrum * self._pixel
        if self._finer > 1:
            fine = torch.fft.irfft2(spectrum, s=self.fine_grid)
            spectrum = torch.fft.rfft2(fine[..., :: self._finer, :: self._finer])
        return spectrum

    def steepest(self, turns: Tensor) -> float:
        """Return the largest difference, in waves, between neighbouring cells of ``turns``."""
        lit = torch.from_numpy(self.share > 0).to(turns.device)
        steps = []
        for axis in (-2, -1):
            pairs = lit.narrow(axis, 1, lit.shape[axis] - 1)
            pairs = pairs & lit.narrow(axis, 0, lit.shape[axis] - 1)
            steps.append(float((turns.diff(dim=axis).abs() * pairs).max()))
        return max(steps)

    def warn_of_steps(self, turns: Tensor) -> None:
        """Warn if the wave changes by more than the cells can sample."""
        step = self.steepest(turns)
        if step > 0.5:
            warnings.warn(
                f"the wave rises {step:.3g} waves from one pupil cell of "
                f"{min(self.pupil_pitch):.3g} m to the next, limit 0.5, a slope of lambda/(2 cell):"
                " the point spread is aliased; use a larger shape",
                stacklevel=4,
            )

    def _periodic(self, turns: Tensor) -> Tensor:
        """Return the intensity over one period of fine samples, centre at sample [0, 0].

        The origin of the pupil is moved from its centre to its corner, which changes only the phase
        in the image.
        """
        rows, columns = self.fine_grid
        phase = turns * math.copysign(2 * math.pi, self.image_distance)
        pupil = torch.complex(self._amplitude * phase.cos(), self._amplitude * phase.sin())
        field = torch.fft.fft(torch.fft.fft(pupil, n=columns, dim=-1), n=rows, dim=-2)
        intensity: Tensor = field.real.square() + field.imag.square()
        return intensity

    def _period_axis(self, side: int) -> Array:
        """Return cell centres, m, for which ``side`` image pixels are exactly one period."""
        cell = self._spread / (self.shape[side] * self.pitch)
        if cell > self.pupil_radius:
            need = math.ceil(self._spread / (self.pupil_radius * self.pitch))
            raise SamplingError(
                f"shape[{side}] = {self.shape[side]} samples the pupil every {cell:.3g} m, limit "
                f"its radius, {self.pupil_radius:.3g} m; use {need} pixels or more"
            )
        # the rim ends within half a cell of the last one
        reach = math.ceil(self.pupil_radius / cell + 0.5 - _ROUNDING) - 1
        return np.arange(-reach, reach + 1, dtype=np.float64) * cell

    def _samples(self) -> tuple[int, tuple[int, int]]:
        """Return fine samples per pixel and their number (rows, columns), checked for memory."""
        finer = 1
        if self.pixel_integrated:
            finer = math.ceil(self.pitch / self.nyquist_pitch * (1 - _ROUNDING))
        grid = (self.shape[0] * finer, self.shape[1] * finer)
        cells = (self.v.size, self.u.size)
        fits_memory(
            f"the transform of {cells} pupil cells to {grid} samples",
            64.0 * math.prod(grid),
            "use fewer pixels, a finer pitch or a smaller pupil",
        )
        return finer, grid

    def _prepare(self, device: torch.device | str, dtype: torch.dtype) -> None:
        """Allocate the tensors of the transform."""
        cell = math.sqrt(math.prod(self.pupil_pitch))
        # Parseval: all samples of a period sum to 1
        scale = self.pitch * cell / (self._spread * math.sqrt(np.sum(self.amplitude**2)))

        def keep(name: str, values: Array) -> None:
            self.register_buffer(name, torch.from_numpy(values).to(device=device, dtype=dtype))

        keep("_amplitude", self.amplitude * (scale / self._finer))
        if self.pixel_integrated:
            # a pixel is _finer samples wide: its energy is their mean times their number
            y, x = (np.fft.fftfreq(n, 1 / self._finer) for n in self.fine_grid)
            keep("_pixel", np.outer(np.sinc(y), np.sinc(x[: len(x) // 2 + 1])) * self._finer**2)
