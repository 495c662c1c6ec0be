"""Variational free energy of images by an unknown wave, with the object integrated out.

The object's posterior is a Gaussian whose covariance is diagonal in Fourier space. Its prior is a
Gaussian scale mixture for differences of neighbouring pixels. Sums extend over the padded FFT grid
that contains the image. Light that leaves the image is lost, and the object is dark outside.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Self

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..wave.frames import Frames
from ..wave.pupil_psf import PupilPSF
from ..wave.pupil_waves import DEFOCUS, ZernikeWaves, noll_mode
from . import _evidence_kernels as kernels
from .search_settings import Stage

Floats = NDArray[Any]
#: Softness of the transition of object values to 0, relative to the image's maximum.
_SOFTNESS = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Starts:
    """Walls and objects during a fit, one per row.

    ``coefficients`` (B, M): Zernike coefficients of the walls, waves rms. ``free`` (B, H, W): free
    parameters x of the objects (x + sqrt(x^2 + s^2))/2. ``gains`` (B, K): relative brightness of
    the images. ``variances`` (B, 2): posterior variances of the objects' differences along x and y.
    ``energy`` (B,): free energy at the end of the last stage, infinite before. ``chi_square``
    (B, K): mean squared residual of each image over its noise variance. ``radius`` (B,): fixed norm
    of the coefficients, waves rms; infinite if it is free.
    """

    coefficients: Floats
    free: Floats
    gains: Floats
    variances: Floats
    energy: Floats
    chi_square: Floats
    radius: Floats

    def __len__(self) -> int:
        return len(self.energy)

    def __getitem__(self, rows: Any) -> Starts:
        return Starts(**{name: values[rows] for name, values in vars(self).items()})

    def best(self, count: int) -> Starts:
        """Return the ``count`` starts of least free energy, least first."""
        return self[np.argsort(self.energy, kind="stable")[:count]]


def joined(parts: Iterable[Starts]) -> Starts:
    """Concatenate several sets of starts."""
    parts = list(parts)
    return Starts(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in vars(parts[0])})


class FreeEnergy:
    """Free energy of images as a function of wall coefficients and mean object.

    ``frames``: the images with their noise, walls and known defoci. ``pupil_psf``: point spread
    with Zernike coefficients, of any shape. ``grid`` (int, int): rows p and columns c of the padded
    FFT grid, at least those of the images; c is even. ``modes``: Noll indices of the coefficients;
    by default those of ``pupil_psf``. ``known_object``: known object of unknown brightness, (H, W).
    Then F is half the squared residuals. ``dtype``: ``numpy.float32`` or ``numpy.float64``; by
    default float32 unless the noise is too small.

    With residuals r, noise s, prior strength kappa, differences D, mean object m, variances v,
    transfer functions H and posterior covariance C [1]_::

        2 F = sum r^2/s^2 + sum kappa log((D m)^2 + v) + (HW/pc) sum_f (C |H|^2/s^2 - log C)

    The noise may differ from pixel to pixel in the first sum. Pixels of infinite noise are left
    out. The last sum uses each image's mean of 1/s^2. The gradient treats v, C, the brightness of
    the images and their backgrounds as constants, since F is minimal with respect to v, C and the
    backgrounds, and the brightness is updated by least squares in each iteration.

    References
    ----------
    .. [1] Levin, Weiss, Durand and Freeman, CVPR (2011) 2657.
    """

    def __init__(
        self,
        frames: Frames,
        pupil_psf: PupilPSF,
        *,
        grid: tuple[int, int],
        modes: Sequence[int] | None = None,
        known_object: Floats | None = None,
        dtype: type | None = None,
    ) -> None:
        if dtype is None:
            dtype = np.float32 if frames.sigmas.min() > 1e-4 else np.float64
        self.sigma = float(np.mean(np.square(frames.sigmas)) ** 0.5)
        self._dtype, self.grid, self._shape = dtype, grid, frames.shape
        self._levels: Floats = self.sigma / frames.sigmas
        self._images = self._array(frames.images * self._levels[:, None, None])
        self._weights = self._array(np.stack([one.weights for one in frames.measured]))
        shapes = np.stack([one.background_shape for one in frames.measured])
        self._shapes = self._array(shapes * frames.measured[0].fit_background)
        self._norms: Floats = _sums(self._weights * self._shapes**2)
        self._counted = frames.counted
        self._known: Floats | None = None
        if known_object is not None:
            self._known = self._array(known_object / known_object.max())
        self.modes = tuple(pupil_psf.modes if modes is None else modes)
        orders = (np.sqrt(8.0 * np.array(self.modes) - 7.0) - 1.0) // 2.0
        #: signs that convert a wall to the one with the same in-focus point spread, W(x) -> -W(-x)
        self.twin = np.where(orders % 2 == 0, -1.0, 1.0)
        self._share = math.prod(frames.shape) / math.prod(grid)
        turns = [2.0 * np.pi * np.arange(side) / side for side in grid]
        self._steps = self._array(2.0 - 2.0 * np.cos(np.concatenate(turns)))
        self._sample_pupil(pupil_psf, frames.defocus)
        self._first: Floats = np.zeros(len(self.twin))
        self._stiffness = 0.0

    @property
    def known(self) -> bool:
        """Whether the object is known."""
        return self._known is not None

    def point_spread(self, starts: Starts) -> Floats:
        """Return the point spread of the first start for the first image, (p, c), centred."""
        transfer = self._transfer(starts.coefficients[:1])[0][0, 0].numpy() * self._pixel[0]
        spread = np.fft.fftshift(np.fft.irfft2(transfer / self._levels[0], s=self.grid))
        return np.maximum(spread.astype(np.float64), 0.0)

    def apart(self, starts: Starts, wall: Floats) -> Floats:
        """Return the distances (B,) of the point spreads from that of a wall (1, M), relative."""
        each, one = self._spreads(starts.coefficients), self._spreads(wall)
        squares = np.square([each - one, one + 0.0 * each]).sum(axis=(2, 3, 4))
        distances: Floats = np.sqrt(squares[0] / squares[1])
        return distances

    def sharpness(self, walls: Floats) -> Floats:
        """Return the sums of squares (B,) of the first image's point spreads, of walls (B, M)."""
        squares: Floats = np.square(self._spreads(walls)[:, 0]).sum(axis=(1, 2))
        return squares

    def _spreads(self, walls: Floats) -> Floats:
        """Return the point spreads (B, K, p, c) of walls (B, M), their centre at sample [0, 0]."""
        return np.fft.irfft2(
            self._transfer(self._array(walls))[0].numpy() * self._pixel, s=self.grid
        )

    def about(self, first: Floats, error: float) -> Self:
        """Return this energy with a Gaussian prior of the coefficients about ``first`` (M,).

        ``error`` is the expected rms difference of a wall's wave, waves.
        """
        found = copy.copy(self)
        found._first = np.asarray(first, dtype=np.float64)
        found._stiffness = len(self.modes) / (2.0 * error**2)
        return found

    def held(self, coefficients: Floats) -> Floats:
        """Return the energy (B,) that the prior of the coefficients adds."""
        offset = coefficients.astype(np.float64) - self._first
        energy: Floats = self._stiffness * np.square(offset).sum(axis=1)
        return energy

    def starts(self, coefficients: Floats, noise: float, radius: Any = np.inf) -> Starts:
        """Return starts with given walls and Wiener-filtered objects.

        ``coefficients`` (B, M): coefficients of the walls, waves rms. ``noise``: ratio of the
        assumed noise to the actual one. ``radius`` (B,): fixed norm of the coefficients, waves rms;
        infinite: free.
        """
        wall = self._array(coefficients)
        mean = np.concatenate(self._spread(lambda w: self._objects(w, noise), wall))
        count = len(wall)
        return Starts(
            coefficients=wall,
            free=self.parameters(mean),
            gains=np.ones((count, len(self._images))),
            variances=np.full((count, 2), 1e-3),
            energy=np.full(count, np.inf),
            chi_square=np.full((count, len(self._images)), np.inf),
            radius=np.broadcast_to(np.float64(radius), count).copy(),
        )

    def parameters(self, objects: Floats) -> Floats:
        """Return the free parameters of positive objects (B, H, W), in the images' unit."""
        bright = np.maximum(objects, 0.1 * _SOFTNESS)
        return self._array(bright - _SOFTNESS**2 / (4.0 * bright))

    def descend(self, starts: Starts, stage: Stage) -> Starts:
        """Run one stage; return the resulting starts with their energies."""
        return joined(self._spread(lambda part: self._descend(part, stage), starts))

    def objects(self, starts: Starts) -> Floats:
        """Return the mean objects, (B, H, W), in the images' unit."""
        if self._known is not None:
            return np.repeat(self._known[None], len(starts), axis=0)
        free: Floats = starts.free
        return np.asarray(0.5 * (free + np.sqrt(free * free + free.dtype.type(_SOFTNESS**2))))

    def evaluate(
        self, starts: Starts, wall: Floats, noise: float, kappa: float, want_energy: bool
    ) -> tuple[dict[str, Floats], Floats, Floats, Floats]:
        """Return energies and gradients for given walls.

        ``starts``: objects, variances and gains. ``wall`` (B, M): coefficients, used instead of
        those of ``starts``. ``noise``: ratio of the assumed noise to the actual one. ``kappa``:
        strength of the object's prior. ``want_energy``: whether to compute the energies.

        Returns: ``values``: ``energy`` (B,), without meaning if not wanted; ``squares`` (B, K), the
        squared residuals over the noise variance; ``background`` (B, K), times the images' weights;
        ``gains`` (B, K), for the next iteration; ``variances`` (B, 2). ``by_data`` (B, p, c):
        gradient of the data term with respect to the mean object, in its first H x W samples.
        ``by_prior`` (B, H, W): gradient of the prior with respect to the mean object. ``by_wall``
        (B, M): gradient with respect to the coefficients.
        """
        mean, grid = self.objects(starts), self.grid
        count, (rows, columns) = len(mean), self._shape
        transfer, pupil, field = self._transfer(wall)
        scale = self._pixel * self._array(starts.gains)[..., None, None]
        transfer = transfer * torch.from_numpy(scale)
        spectrum = torch.fft.rfft2(torch.from_numpy(mean), s=grid)
        seen = torch.fft.irfft2(transfer * spectrum[:, None], s=grid)[..., :rows, :columns].numpy()
        gains = self._brightness(seen, starts.gains)
        background = self._background(self._images - seen)
        seen -= self._images
        seen += self._array(background)[..., None, None] * self._shapes
        weighted = self._weights * seen
        squares = _sums(weighted * seen)
        residual = torch.fft.rfft2(torch.from_numpy(weighted), s=grid).numpy()
        by_prior, rough, weights = np.zeros_like(mean), np.zeros(count), np.ones((count, 2))
        if self._known is None:
            kernels.roughness(
                mean, starts.variances.astype(self._dtype), kappa, by_prior, weights, rough,
                want_energy,
            )  # fmt: skip
        precision = np.full(count, 1.0 / (noise * self.sigma) ** 2)
        variances, volume = np.empty((count, 2)), np.empty(count)
        toward = np.empty(spectrum.shape, dtype=residual.dtype)
        kernels.spectra(
            transfer.numpy(), residual, spectrum.numpy(), self._pixel, starts.gains, self._steps,
            weights, precision, self._share if self._known is None else 0.0, toward, variances,
            volume, want_energy,
        )  # fmt: skip
        by_data = torch.fft.irfft2(torch.from_numpy(toward), s=grid).numpy()
        energy = 0.5 * (squares.sum(axis=1) * precision + rough + volume) + self.held(wall)
        values = {
            "energy": energy,
            "squares": squares / self.sigma**2,
            "background": background,
            "gains": gains,
            "variances": variances,
        }
        by_wall = self._wall_gradient(residual, pupil, field)
        by_wall += 2.0 * self._stiffness * (wall - self._first)
        return values, by_data, by_prior, by_wall

    def judged(self, starts: Starts) -> tuple[Starts, Floats]:
        """Return starts with their residuals, and the backgrounds (B, K) in the images' unit."""
        values = self.evaluate(starts, starts.coefficients, 1.0, 0.5, False)[0]
        level: Floats = values["background"] / self._levels
        return replace(starts, chi_square=values["squares"] / self._counted), level

    def _spread(self, work: Any, rows: Any) -> list[Any]:
        """Apply ``work`` to chunks of rows, on several threads; the chunks do not depend on them.

        Eight starts fit into the processor's cache. Torch and the kernels release the interpreter
        lock.
        """
        parts = [rows[first : first + 8] for first in range(0, len(rows), 8)]
        threads = min(len(parts), numba.get_num_threads())
        # also for one chunk: numba's first question for threads gives torch in the calling thread
        # as many, and its small transforms then take ten times longer on a busy machine
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            return list(pool.map(work, parts))

    def _descend(self, starts: Starts, stage: Stage) -> Starts:
        wall, free = starts.coefficients.copy(), starts.free.copy()
        now = replace(
            starts, free=free, variances=starts.variances.copy(), gains=starts.gains.copy()
        )
        first, second = np.zeros_like(free), np.zeros_like(free)
        wall_first, wall_second = np.zeros(wall.shape), np.zeros(wall.shape)
        held = np.isfinite(starts.radius)[:, None]
        radius = np.where(held, starts.radius[:, None], 1.0)
        for step in range(stage.iterations):
            length = np.linalg.norm(wall, axis=1, keepdims=True)
            placed = np.where(held, wall * (radius / np.maximum(length, 1e-12)), wall)
            placed = self._array(placed)
            last = step == stage.iterations - 1
            values, by_data, by_prior, slope = self.evaluate(
                now, placed, stage.noise(step), stage.kappa, last
            )
            along = (slope * placed).sum(axis=1, keepdims=True) * placed / radius**2
            slope = np.where(held, (slope - along) * (radius / np.maximum(length, 1e-12)), slope)
            np.maximum(0.5 * (now.variances + values["variances"]), 1e-6, out=now.variances)
            now.gains[:] = values["gains"]
            bias, bias_square = 1.0 - np.array([0.9, 0.99]) ** (step + 1)
            pace = stage.pace(step) / bias
            rate = 0.05 * pace  # of the image's maximum
            kernels.object_step(
                free, by_data, by_prior, first, second, _SOFTNESS, rate, bias_square
            )
            wall_first += 0.1 * (slope - wall_first)
            wall_second += 0.01 * (slope**2 - wall_second)
            root = np.sqrt(wall_second / bias_square) + 1e-10
            wall = (wall - stage.wave_rate * pace * wall_first / root).astype(self._dtype)
        return replace(
            now,
            coefficients=placed if held.all() else np.where(held, placed, wall),
            energy=values["energy"],
            chi_square=values["squares"] / self._counted,
        )

    def _background(self, images: Floats) -> Floats:
        """Return the strengths (B, K) of the backgrounds that fit best; 0 if these are known."""
        return _sums(self._weights * self._shapes * images) / np.where(self._norms, self._norms, 1)

    def _brightness(self, seen: Floats, gains: Floats) -> Floats:
        """Return the relative brightness of the images (B, K) after one step of least squares.

        Unless the object is known, the geometric mean is 1, since its own brightness is free.
        """
        if self._known is None and gains.shape[1] == 1:
            return gains
        own = seen - self._array(self._background(seen))[..., None, None] * self._shapes
        ratio = np.maximum(_sums(self._weights * own * self._images), 1e-12)
        ratio /= np.maximum(_sums(self._weights * own * own), 1e-12)
        if self._known is not None:
            return np.asarray(gains * np.clip(ratio, 1.0 / 1.2, 1.2))
        ratio /= np.exp(np.log(ratio).mean(axis=1, keepdims=True))
        return np.asarray(np.clip(gains * np.clip(ratio, 1.0 / 1.2, 1.2), 0.1, 10.0))

    def _objects(self, wall: Floats, noise: float) -> Floats:
        """Return Wiener-filtered objects, (B, H, W), at least 0.01 of the image's range.

        ``noise`` is the ratio of the assumed noise to the actual one.
        """
        rows, columns = self._shape
        transfer = self._transfer(wall)[0].numpy() * self._pixel
        edges = [self._images[:, [0, -1]], self._images[:, :, [0, -1]].swapaxes(1, 2)]
        flat = [edge.reshape(len(self._images), -1) for edge in edges]
        level = np.median(np.concatenate(flat, axis=1), axis=1) * (self._norms > 0.0)
        data = torch.from_numpy(self._array(self._images - level[:, None, None]))
        seen = torch.fft.rfft2(data, s=self.grid).numpy()
        down, along = self._steps[: self.grid[0]], self._steps[self.grid[0] :]
        rough = down[:, None] + along[: seen.shape[-1]]
        prior = (noise * self.sigma) ** 2 * (rough / 0.02 + 1e-3)
        power = (transfer.real**2 + transfer.imag**2).sum(axis=1)
        spectrum = (transfer.conj() * seen).sum(axis=1) / (power + prior)
        mean = torch.fft.irfft2(torch.from_numpy(spectrum), s=self.grid).numpy()
        bright: Floats = np.maximum(mean[:, :rows, :columns], 0.01)
        return bright

    def _transfer(self, wall: Floats) -> tuple[Tensor, Tensor, Tensor]:
        """Return transfer functions (B, K, p, q), pupil functions, and image fields.

        The transfer functions do not contain that of the detector's pixels, unless these are wider
        than the field's samples.
        """
        rows, columns = self._fine
        phase = (torch.from_numpy(wall) @ self._basis)[:, None] + self._known_phase
        pupil = torch.complex(phase.cos() * self._amplitude, phase.sin() * self._amplitude)
        pupil = pupil.view(*phase.shape[:-1], *self._cells)
        field = torch.fft.fft(torch.fft.fft(pupil, n=rows, dim=-2), n=columns, dim=-1)
        spread = torch.from_numpy(field.numpy().real ** 2 + field.numpy().imag ** 2)
        return torch.fft.rfft2(self._to_pixels(spread)), pupil, field

    def _wall_gradient(self, toward: Floats, pupil: Tensor, field: Tensor) -> Floats:
        rows, columns = self._cells
        spread = self._from_pixels(torch.fft.irfft2(torch.from_numpy(toward), s=self.grid))
        spread = spread * (2.0 * math.prod(self.grid) * math.prod(self._fine))
        cells = torch.fft.ifft(field * spread, dim=-1)[..., :columns]
        cells = torch.fft.ifft(cells, dim=-2)[..., :rows, :]
        phase = (pupil.real * cells.imag - pupil.imag * cells.real).sum(dim=1)
        return np.asarray(phase.flatten(1) @ self._basis.T)

    def _to_pixels(self, spread: Tensor) -> Tensor:
        """Return the energy per pixel (..., p, c) of intensities on the fine grid."""
        if self._wide is None:
            return spread
        finer = self._fine[0] // self.grid[0]
        fine: Tensor = torch.fft.irfft2(torch.fft.rfft2(spread) * self._wide, s=self._fine)
        return fine[..., ::finer, ::finer].contiguous()

    def _from_pixels(self, pixels: Tensor) -> Tensor:
        """Apply the transpose of `_to_pixels`."""
        if self._wide is None:
            return pixels
        finer = self._fine[0] // self.grid[0]
        fine = torch.zeros((*pixels.shape[:-2], *self._fine), dtype=pixels.dtype)
        fine[..., ::finer, ::finer] = pixels
        spread: Tensor = torch.fft.irfft2(torch.fft.rfft2(fine) * self._wide, s=self._fine)
        return spread

    def _sample_pupil(self, pupil_psf: PupilPSF, defocus: Floats) -> None:
        """Sample pupil, modes and known waves for the FFT grid; ``defocus`` (K,) is in m rms."""
        given = pupil_psf.optics
        pitch = given.pitch
        # the transfer function 2 % below the cutoff is less than 1e-3
        if given.nyquist_pitch < pitch <= given.nyquist_pitch * 1.02:
            pitch = given.nyquist_pitch
        optics = given.resized(self.grid, pitch)
        side = math.copysign(2.0 * math.pi, given.image_distance)
        basis = np.stack([noll_mode(mode, optics).ravel() for mode in self.modes])
        known = np.outer(defocus / optics.wavelength, noll_mode(DEFOCUS, optics))
        waves = pupil_psf.waves
        rest = waves.rest_on(optics) if isinstance(waves, ZernikeWaves) else None
        if rest is not None:
            known = known + rest.ravel()
        self._cells, self._fine = optics.share.shape, optics.fine_grid
        self._amplitude = torch.from_numpy(self._array(optics.cell_weights().ravel()))
        self._basis = torch.from_numpy(self._array(side * basis))
        # whole waves are subtracted before the conversion to single precision, to keep digits
        self._known_phase = torch.from_numpy(self._array(side * (known - np.round(known))))
        pixel = optics.pixel_transfer()
        self._wide: Tensor | None = None
        half = (self.grid[0], self.grid[1] // 2 + 1)
        if self._fine != self.grid:
            self._wide, pixel = torch.from_numpy(self._array(pixel)), np.ones(half)
        self._pixel = self._array(pixel * self._levels[:, None, None])

    def _array(self, values: Any) -> Floats:
        return np.ascontiguousarray(values, dtype=self._dtype)


def _sums(images: Floats) -> Floats:
    """Return the sums (...) of images (..., H, W) in double precision."""
    return np.asarray(images.sum(axis=(-2, -1), dtype=np.float64))
