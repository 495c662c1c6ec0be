"""Differentiable transforms from the wave in a circular pupil to its point spread, in torch."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any, Literal, TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..._checks import fits_memory, in_range, one_of, positive, real, whole
from ...errors import SamplingError, SceneError
from ...psf.aperture.quadrature_nodes import circle_shares, fitting_pitch
from ...psf.window.pixels import pixel_rule
from ...psf.window.window import Window, shape_of

Array = NDArray[np.float64]
Method = Literal["fft", "mdft"]
#: Function of u and v, m, that returns the relative amplitude.
Transmission = Callable[[Array, Array], Array]
#: Relative tolerance when lengths are compared, since they may be given as rounded numbers.
_ROUNDING = 1e-9


class ImageOptions(TypedDict, total=False):
    """Options of `PupilOptics` that do not depend on how the wave is parametrised."""

    method: Method
    samples: int | None
    pixel_integrated: bool
    device: torch.device | str
    dtype: torch.dtype


class PupilOptics(nn.Module):
    """Fraunhofer transform of a circular pupil to point spread and transfer function.

    All results are differentiable with respect to the wave.

    Parameters
    ----------
    wavelength, pupil_radius, image_distance, pitch : float
        Wavelength, radius, distance from pupil to image, and pixel pitch of the image, m.
    shape : int or (int, int)
        Rows H and columns W of the image.
    method : {"fft", "mdft"}
        "fft": the image is one period of the transform. "mdft": matrix products; the image is a
        window of a longer period.
    samples : int, optional
        For "mdft": pupil cells per side. By default the period is twice the window.
    pixel_integrated : bool
        Whether values are integrals over square pixels of side ``pitch``, which may then be any
        length; point samples need a pitch of at most lambda |d|/(4 radius).
    transmission : callable, optional
        Relative amplitude as a function of u, v, m; by default 1.
    device : torch.device or str
        Device of the tensors.
    dtype : torch.dtype
        ``torch.float32`` or ``torch.float64``.

    Attributes
    ----------
    u, v : ndarray, (n_u,) and (n_v,)
        Coordinates of the pupil's cells, m, along columns and rows; cell [n_v//2, n_u//2] is on the
        axis.
    share : ndarray, (n_v, n_u)
        Fraction of each cell that lies in the pupil.
    amplitude : ndarray, (n_v, n_u)
        This fraction times the transmission.
    nyquist_pitch : float
        Largest pitch of point samples, m.
    fine_grid : (int, int)
        Rows and columns of the fine samples of the method "fft"; `shape` if pixels are small.
    """

    _amplitude: Tensor
    _along_x: Tensor
    _along_y: Tensor
    _mean_x: Tensor
    _mean_y: Tensor
    _pixel: Tensor

    def __init__(
        self,
        *,
        wavelength: float,
        pupil_radius: float,
        image_distance: float,
        pitch: float,
        shape: int | tuple[int, int],
        method: Method = "fft",
        samples: int | None = None,
        pixel_integrated: bool = False,
        transmission: Transmission | None = None,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        check_precision(dtype)
        self.wavelength = checked_wavelength(wavelength)
        self.pupil_radius = positive("pupil_radius", pupil_radius, unit="m")
        self.image_distance = checked_distance(image_distance)
        self.pitch = positive("pitch", pitch, unit="m")
        self.shape = shape_of(shape)
        self.method = one_of("method", method, ("fft", "mdft"))
        self.pixel_integrated = bool(pixel_integrated)
        self.transmission = transmission
        #: lambda |d|, m^2: pupil pitch times image period
        self._spread = self.wavelength * abs(self.image_distance)
        self.nyquist_pitch = self._spread / (4 * self.pupil_radius)
        self.v, self.u = self._cells(samples)
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
        """Return these optics in double precision for another image, by the method "fft".

        Parameters
        ----------
        shape : int or (int, int)
            Rows and columns of the image.
        pitch : float
            Pitch of its samples, m.
        """
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

        Parameters
        ----------
        turns : Tensor, (..., n_v, n_u)
            Wave aberration divided by the wavelength.
        """
        if self.method == "mdft":
            return self._by_matrices(turns)
        if not self.pixel_integrated:
            return centred(self._periodic(turns))
        return centred(torch.fft.irfft2(self.transfer(turns), s=self.shape))

    def transfer(self, turns: Tensor) -> Tensor:
        """Return ``rfft2`` of the point spreads, (..., H, W//2 + 1), their centre at sample [0, 0].

        ``turns`` (..., n_v, n_u) is the wave aberration divided by the wavelength.
        """
        if self.method == "mdft":
            spread = torch.fft.ifftshift(self._by_matrices(turns), dim=(-2, -1))
            spectrum: Tensor = torch.fft.rfft2(spread)
            return spectrum
        spectrum = torch.fft.rfft2(self._periodic(turns))
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
                " the point spread is aliased; use a larger shape, or more samples",
                stacklevel=4,
            )

    def _periodic(self, turns: Tensor) -> Tensor:
        """Return the intensity over one period of fine samples, centre at sample [0, 0].

        The origin of the pupil is moved from its centre to its corner, which changes only the phase
        in the image.
        """
        rows, columns = self.fine_grid
        field = torch.fft.fft(self._pupil(turns), n=columns, dim=-1)
        return _intensity(torch.fft.fft(field, n=rows, dim=-2))

    def _by_matrices(self, turns: Tensor) -> Tensor:
        along_x, along_y = (torch.view_as_complex(m) for m in (self._along_x, self._along_y))
        spread = _intensity(along_y @ (self._pupil(turns) @ along_x))
        if not self.pixel_integrated:
            return spread
        return self._mean_y @ spread @ self._mean_x

    def _pupil(self, turns: Tensor) -> Tensor:
        """Return the pupil function: amplitude times exp(2 pi i turns).

        It is conjugated if the pupil lies behind the image.
        """
        phase = turns * math.copysign(2 * math.pi, self.image_distance)
        return torch.complex(self._amplitude * phase.cos(), self._amplitude * phase.sin())

    def _cells(self, samples: int | None) -> tuple[Array, Array]:
        """Return the cell centres along v and u, m."""
        if not self.pixel_integrated and self.pitch > self.nyquist_pitch * (1 + _ROUNDING):
            raise SamplingError(
                f"pitch = {self.pitch:.6g} m, limit for point samples (Nyquist) "
                f"{self.nyquist_pitch:.6g} m; use a finer pitch, or pixel_integrated=True"
            )
        if self.method == "mdft":
            axis = self._matrix_axis(samples)
            return axis, axis
        if samples is not None:
            raise SamplingError(
                f"samples = {samples} with method='fft', whose pupil cells follow from shape and "
                "pitch; leave it out, or use method='mdft'"
            )
        return self._period_axis(0), self._period_axis(1)

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

    def _matrix_axis(self, samples: int | None) -> Array:
        """Return the centres, m, of cells that just cover the pupil, for matrix products."""
        longest = max(self.shape) * self.pitch
        if samples is None:
            samples = max(32, 1 + math.ceil(4 * self.pupil_radius * longest / self._spread))
        samples = whole("samples", samples, 2)
        cell = fitting_pitch(self.pupil_radius, samples)
        period = self._spread / cell
        if longest > period * (1 + _ROUNDING):
            need = math.ceil(2 * self.pupil_radius * longest / self._spread) + 1
            raise SamplingError(
                f"{samples} pupil samples repeat the image every {period:.3g} m, inside its "
                f"{longest:.3g} m; use samples = {need} or more"
            )
        return (np.arange(samples, dtype=np.float64) - samples // 2) * cell

    def _samples(self) -> tuple[int, tuple[int, int]]:
        """Return fine samples per pixel and their number (rows, columns), checked for memory."""
        finer = 1
        if self.method == "fft" and self.pixel_integrated:
            finer = math.ceil(self.pitch / self.nyquist_pitch * (1 - _ROUNDING))
        grid = (self.shape[0] * finer, self.shape[1] * finer)
        cells = (self.v.size, self.u.size)
        fits_memory(
            f"the transform of {cells} pupil cells to {grid} samples",
            64.0 * (math.prod(grid) + sum(cells) * sum(grid)),
            "use fewer pixels, a finer pitch or a smaller pupil",
        )
        return finer, grid

    def _prepare(self, device: torch.device | str, dtype: torch.dtype) -> None:
        """Allocate the tensors of the chosen transform."""
        cell = math.sqrt(math.prod(self.pupil_pitch))
        # Parseval: all samples of a period sum to 1
        scale = self.pitch * cell / (self._spread * math.sqrt(np.sum(self.amplitude**2)))

        def keep(name: str, values: Array) -> None:
            self.register_buffer(name, torch.from_numpy(values).to(device=device, dtype=dtype))

        keep("_amplitude", self.amplitude * (scale / self._finer))
        if self.method == "mdft":
            window = Window.centred(self.pitch, self.shape)
            if self.pixel_integrated:
                rule = pixel_rule(self.pitch, self.nyquist_pitch, max(self.shape))
                window = rule.window(self.pitch, self.shape)
                keep("_mean_y", rule.matrix(window.shape[0]))
                keep("_mean_x", np.ascontiguousarray(rule.matrix(window.shape[1]).T))
            keep("_along_y", _kernel(np.outer(window.y, self.v) / self._spread))
            keep("_along_x", _kernel(np.outer(self.u, window.x) / self._spread))
        elif self.pixel_integrated:
            # a pixel is _finer samples wide: its energy is their mean times their number
            y, x = (np.fft.fftfreq(n, 1 / self._finer) for n in self.fine_grid)
            keep("_pixel", np.outer(np.sinc(y), np.sinc(x[: len(x) // 2 + 1])) * self._finer**2)


def _kernel(turns: Array) -> Array:
    """Return exp(-2 pi i turns) as pairs of real numbers.

    A complex tensor would lose its imaginary part in ``Module.to(dtype)``.
    """
    turns = 2 * np.pi * (turns - np.round(turns))
    return np.stack([np.cos(turns), -np.sin(turns)], axis=-1)


class _SquaredModulus(torch.autograd.Function):
    """|z|^2 with gradient 0 at 0; three times as fast as the squares of both parts in torch."""

    generate_vmap_rule = True

    @staticmethod
    def forward(field: Tensor) -> Tensor:
        real, imaginary = field.real, field.imag
        return torch.addcmul(real.square(), imaginary, imaginary)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (field,) = ctx.saved_tensors
        pairs = torch.view_as_real(field) * (2.0 * gradient).unsqueeze(-1)
        return torch.view_as_complex(pairs)

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor) -> Tensor:
        (field,) = ctx.saved_tensors
        change: Tensor = 2.0 * (field.real * tangent.real + field.imag * tangent.imag)
        return change


def _intensity(field: Tensor) -> Tensor:
    intensity: Tensor = _SquaredModulus.apply(field)  # type: ignore[no-untyped-call]
    return intensity


def centred(spread: Tensor) -> Tensor:
    """Move the centre of point spreads (..., H, W) from sample [0, 0] to [H//2, W//2]."""
    shifted: Tensor = torch.fft.fftshift(spread, dim=(-2, -1))
    return shifted


def check_precision(dtype: torch.dtype) -> None:
    """Raise a `SamplingError` if a pupil model does not support a data type."""
    if dtype not in (torch.float32, torch.float64):
        raise SamplingError(
            f"dtype = {dtype} is not supported by the transform; use torch.float32 or torch.float64"
        )


def checked_wavelength(wavelength: float) -> float:
    """Return a wavelength, m; raise a `SceneError` if it is out of range."""
    return in_range("wavelength", wavelength, 1e-8, 1e-3, unit="m", remedy="give metres in vacuum")


def checked_distance(image_distance: float) -> float:
    """Return the signed distance from pupil to image, m; raise a `SceneError` if it is 0."""
    distance = real("image_distance", image_distance)
    if distance == 0.0:
        raise SceneError(
            "image_distance = 0 m, must not be 0; give the signed distance from pupil to image"
        )
    return distance
