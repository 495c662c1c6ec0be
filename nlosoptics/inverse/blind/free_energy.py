"""Variational free energy of images by an unknown wave, with the object integrated out.

The object's posterior is a Gaussian whose covariance is diagonal in Fourier space. Its prior is a
Gaussian scale mixture for differences of neighbouring pixels. Sums extend over the padded FFT grid
that contains the image. Light that leaves the image is lost, and the object is dark outside.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..data.arrays import half_spectrum_weights
from ..wave.frames import Frames
from ..wave.pupil_psf import PupilPSF
from ..wave.pupil_waves import ZernikeWaves, twin_signs
from .search_settings import SETTINGS, Stage

Floats = NDArray[Any]


class OutOfTime(Exception):
    """Raised by a descent that is to end without a result."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Starts:
    """Walls and objects during a fit, one per row.

    ``coefficients`` (B, M): Zernike coefficients of the walls, waves rms; those of several walls
    one after the other. ``free`` (B, H, W): free parameters x of the objects (x + sqrt(x^2 +
    s^2))/2. ``gains`` (B, K): relative brightness of the images. ``variances`` (B, 2): posterior
    variances of the objects' differences along x and y. ``energy`` (B,): free energy at the end of
    the last stage, infinite before. ``chi_square`` (B, K): mean squared residual of each image over
    its noise variance. ``radius`` (B,): fixed norm of the coefficients, waves rms; infinite if it
    is free.
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


class Terms(NamedTuple):
    """Terms of the free energy for B starts.

    ``energy`` (B,): energy. ``squares`` (B, K): squared residuals over the noise variance.
    ``background`` (B, K): strengths of the backgrounds. ``gains`` (B, K): brightness for the next
    iteration. ``variances`` (B, 2): posterior variances of the objects' differences. ``effective``
    (B,): number of values of the object that the images determine. ``by_object`` (B, H, W),
    ``by_wall`` (B, M): gradients with respect to the mean objects and the coefficients.
    """

    energy: Tensor
    squares: Tensor
    background: Tensor
    gains: Tensor
    variances: Tensor
    effective: Tensor
    by_object: Tensor
    by_wall: Tensor


class FreeEnergy:
    """Free energy of images as a function of wall coefficients and mean object.

    ``frames``: the images with their noise, walls and known defoci. ``pupil_psf``: point spread
    with Zernike coefficients, of any shape. ``grid`` (int, int): rows p and columns c of the padded
    FFT grid, at least those of the images; c is even. ``modes``: Noll indices of the coefficients;
    by default those of ``pupil_psf``. ``support``: mask, (H, W), 0 where the object is known to be
    dark. ``known_object``: known object of unknown brightness, (H, W). Then F is half the squared
    residuals. ``dtype``: ``torch.float32`` or ``torch.float64``; by default float32 unless the
    noise is too small. ``late``: function that each iteration of a descent calls; if it returns
    True, `OutOfTime` is raised.

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
        support: Floats | None = None,
        known_object: Floats | None = None,
        dtype: torch.dtype | None = None,
        late: Callable[[], bool] = lambda: False,
    ) -> None:
        if dtype is None:
            dtype = torch.float32 if frames.sigmas.min() > 1e-4 else torch.float64
        self.sigma = float(np.mean(np.square(frames.sigmas)) ** 0.5)
        self.grid, self.modes = grid, tuple(pupil_psf.modes if modes is None else modes)
        self._dtype, self._late, self._frames = dtype, late, frames
        levels = self.sigma / frames.sigmas
        self._levels = self._tensor(levels)[:, None, None]
        self._images = self._tensor(frames.images) * self._levels
        self._weights = self._tensor(frames.weights())
        # strengths of backgrounds are sums over the image times these
        shapes = self._tensor(frames.background_shapes()) * frames.fit_background
        self._shapes = shapes
        norms = (self._weights * shapes**2).sum((1, 2), keepdim=True)
        self._averages = self._weights * shapes / norms.clamp(min=1e-12)
        self._support = self._tensor(np.ones(frames.shape) if support is None else support > 0.0)
        self._known: Tensor | None = None
        if known_object is not None:
            self._known = self._tensor(known_object / known_object.max())
        #: signs that convert a wall to the one with the same in-focus point spread, W(x) -> -W(-x)
        self.twin = np.tile(twin_signs(self.modes), frames.n_walls)
        self._share = math.prod(frames.shape) / math.prod(grid)
        down, along = (2.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(n) / n) for n in grid)
        # squared transfer functions of the differences, and how often a column counts
        half = along[: grid[1] // 2 + 1], down, half_spectrum_weights(grid[1])
        self._steps = [self._tensor(values) for values in half]
        given = pupil_psf.optics
        pitch = given.pitch
        # the transfer function 2 % below the cutoff is less than 1e-3
        if given.nyquist_pitch < pitch <= 1.02 * given.nyquist_pitch:
            pitch = given.nyquist_pitch
        optics = given.resized(grid, pitch, dtype)
        rest: Any = pupil_psf.waves.rest_of
        waves = ZernikeWaves(self.modes, optics, rest)
        self._pupil = PupilPSF(optics, waves, np.zeros(len(self.modes))).requires_grad_(False)
        self._pixel = optics.pixel * self._levels
        self._defocus = self._pupil.defocus_turns(self._tensor(frames.defocus))
        self._first, self._stiffness = self._tensor(np.zeros(self.size)), 0.0

    @property
    def size(self) -> int:
        """Number of coefficients of all walls."""
        return len(self.twin)

    @property
    def known(self) -> bool:
        """Whether the object is known."""
        return self._known is not None

    def point_spread(self, starts: Starts) -> Floats:
        """Return the point spread of the first start for the first image, (p, c), centred."""
        spread = self._spreads(starts.coefficients[:1])[0, 0] / float(self._levels[0])
        return np.maximum(np.fft.fftshift(spread).astype(np.float64), 0.0)

    def sharpness(self, walls: Floats) -> Floats:
        """Return the sums of squares (B,) of the first image's point spreads, of walls (B, M)."""
        squares: Floats = np.square(self._spreads(walls)[:, 0]).sum(axis=(1, 2))
        return squares

    def about(self, first: Floats, error: float) -> Self:
        """Return this energy with a Gaussian prior of the coefficients about ``first`` (M,).

        ``error`` is the expected rms difference of a wall's wave, waves.
        """
        prior = copy.copy(self)
        prior._first = self._tensor(first)
        prior._stiffness = len(self.modes) / (2.0 * error**2)
        return prior

    def held(self, coefficients: Floats) -> Floats:
        """Return the energy (B,) that the prior of the coefficients adds."""
        return self._held(self._tensor(coefficients)).numpy()

    def starts(self, coefficients: Floats, noise: float, radius: Any = np.inf) -> Starts:
        """Return starts with given walls and Wiener-filtered objects.

        ``coefficients`` (B, M): coefficients of the walls, waves rms. ``noise``: ratio of the
        assumed noise to the actual one. ``radius`` (B,): fixed norm of the coefficients, waves rms;
        infinite: free.
        """
        wall = self._tensor(coefficients)
        mean = np.concatenate(self._spread(lambda rows: self._objects(rows, noise), wall))
        count, frames = len(wall), len(self._images)
        return Starts(
            coefficients=wall.numpy(),
            free=self.parameters(mean),
            gains=np.ones((count, frames)),
            variances=np.full((count, 2), 1e-3),
            energy=np.full(count, np.inf),
            chi_square=np.full((count, frames), np.inf),
            radius=np.broadcast_to(np.float64(radius), count).copy(),
        )

    def parameters(self, objects: Floats) -> Floats:
        """Return the free parameters of positive objects (B, H, W), in the images' unit."""
        soft = SETTINGS.softness
        bright = np.maximum(objects, 0.1 * soft)
        return self._tensor(bright - soft**2 / (4.0 * bright)).numpy()

    def objects(self, starts: Starts) -> Floats:
        """Return the mean objects, (B, H, W), in the images' unit."""
        return self._mean(self._tensor(starts.free))[0].numpy()

    def descend(self, starts: Starts, stage: Stage) -> Starts:
        """Run one stage; return the resulting starts with their energies."""
        return joined(self._spread(lambda part: self._descend(part, stage), starts))

    def terms(self, starts: Starts, noise: float = 1.0, kappa: float = 0.5) -> Terms:
        """Return the terms of the energy of starts and its gradients.

        ``noise``: ratio of the assumed noise to the actual one. ``kappa``: strength of the object's
        prior.
        """
        free, wall, gains, variances = self._state(starts)
        return self._terms(self._mean(free)[0], wall, gains, variances, noise, kappa)

    def judged(self, starts: Starts) -> tuple[Starts, Floats]:
        """Return starts with their residuals, and the backgrounds (B, K) in the images' unit."""
        terms = self.terms(starts)
        level: Floats = terms.background.numpy() / self._levels.numpy().ravel()
        return replace(starts, chi_square=self._chi_square(terms)), level

    def _terms(
        self,
        mean: Tensor,
        wall: Tensor,
        gains: Tensor,
        variances: Tensor,
        noise: float,
        kappa: float,
        last: bool = True,
    ) -> Terms:
        """Return the terms of the energy and its gradients.

        ``mean`` (B, H, W): mean objects. ``wall`` (B, M), ``gains`` (B, K), ``variances`` (B, 2):
        as in `Starts`. ``noise``: ratio of the assumed noise to the actual one. ``kappa``: strength
        of the object's prior. ``last``: whether ``energy`` and ``effective`` are wanted.
        """
        precision, count = (noise * self.sigma) ** -2, math.prod(self.grid)
        with torch.enable_grad():
            wall = wall.detach().requires_grad_()
            samples = self._samples(wall)
        transfer = torch.fft.rfft2(samples.detach()).mul_(self._pixel)
        transfer *= gains[..., None, None]
        spectrum = torch.fft.rfft2(mean, s=self.grid)[:, None]
        seen = self._cut(transfer * spectrum)
        residual = seen - self._images
        background = -(self._averages * residual).sum((2, 3))
        residual += background[..., None, None] * self._shapes
        weighed = self._weights * residual
        squares = (weighed * residual).sum((2, 3))
        energy = 0.5 * precision * squares.sum(1) + self._held(wall.detach())
        pull = torch.fft.rfft2(weighed, s=self.grid).mul_(precision)
        by_object = self._cut((transfer.conj() * pull).sum(1))
        pull *= spectrum.conj()
        effective = torch.zeros(len(mean))
        if self._known is None:
            weights = []
            for i, pad in enumerate(((1, 1), (0, 0, 1, 1))):
                step = nn.functional.pad(mean, pad).diff(dim=2 - i)
                width = step.square().add_(variances[:, i, None, None])
                weight = kappa / width
                weights.append(weight.mean((1, 2)))
                by_object -= weight.mul_(step).diff(dim=2 - i)
                if last:
                    energy += 0.5 * kappa * width.log_().sum((1, 2))
            along, down, twice = self._steps
            wx, wy = (weight[:, None] for weight in weights)
            power = (transfer.real.square() + transfer.imag.square()).sum(1).mul_(precision)
            power += (wx * along + 1e-6)[:, None] + (wy * down)[..., None]
            covariance = power.reciprocal()
            sums = [covariance.sum(1) @ (twice * along), covariance @ twice @ down]
            variances = torch.stack(sums, 1) / count
            if last:
                effective = self._share * (
                    count - (torch.stack(weights, 1) * torch.stack(sums, 1)).sum(1)
                )
                energy += 0.5 * (effective + self._share * (power.log_() @ twice).sum(1))
            # the trace of the covariance is what counts against no blur
            transfer *= covariance.mul_(count * self._share * precision)[:, None]
            pull += transfer
        pull *= self._pixel * gains[..., None, None]
        by_samples = torch.fft.irfft2(pull, s=self.grid)
        (by_wall,) = torch.autograd.grad(samples, wall, by_samples)
        by_wall += 2.0 * self._stiffness * (wall.detach() - self._first)
        gains = self._brightness(seen, gains, precision)
        return Terms(energy, squares, background, gains, variances, effective, by_object, by_wall)

    def _brightness(self, seen: Tensor, gains: Tensor, precision: float) -> Tensor:
        """Return the relative brightness of the images (B, K) after one step of least squares.

        ``seen`` (B, K, H, W): predicted images. ``precision``: 1 over the noise's variance.

        Without a known object, gains are near 1, and their geometric mean is 1, since the
        brightness of the object is free.
        """
        if gains.shape[1] == 1 and self._known is None:
            return gains
        level = (self._averages * seen).sum((2, 3), keepdim=True)
        even = self._weights * (seen - level * self._shapes) * precision
        cross, norm = (even * self._images).sum((2, 3)), (even * seen).sum((2, 3))
        if self._known is not None:
            return gains * (cross / norm.clamp(min=1e-12)).clamp(1.0 / 1.2, 1.2)
        prior = SETTINGS.gain_error**-2
        ratio = (cross + prior * gains) / (norm + prior * gains.square())
        ratio = ratio.clamp(min=1e-3)
        ratio = ratio / ratio.log().mean(1, keepdim=True).exp()
        return gains * ratio.clamp(1.0 / 1.2, 1.2)

    def _state(self, starts: Starts) -> list[Tensor]:
        """Return copies of objects, walls, gains and variances as tensors."""
        parts = (starts.free, starts.coefficients, starts.gains, starts.variances)
        return [torch.tensor(part, dtype=self._dtype) for part in parts]

    def _descend(self, starts: Starts, stage: Stage) -> Starts:
        free, wall, gains, variances = self._state(starts)
        radius = self._tensor(starts.radius)[:, None]
        fixed = radius.isfinite()
        radius = radius.where(fixed, torch.tensor(1.0, dtype=self._dtype))
        rates = (SETTINGS.object_rate, stage.wave_rate)
        groups = [{"params": [part]} for part in (free, wall)]
        adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-10, foreach=False)
        for step in range(stage.iterations):
            if self._late():
                raise OutOfTime
            length = torch.linalg.vector_norm(wall, dim=1, keepdim=True).clamp(min=1e-12)
            placed = wall.where(~fixed, wall * (radius / length))
            mean, bend = self._mean(free)
            factors, last = (stage.noise(step), stage.kappa), step == stage.iterations - 1
            terms = self._terms(mean, placed, gains, variances, *factors, last)
            along = (terms.by_wall * placed).sum(1, keepdim=True) * placed / radius.square()
            slope = (terms.by_wall - along) * (radius / length)
            wall.grad = terms.by_wall.where(~fixed, slope)
            free.grad = bend * terms.by_object
            for group, rate in zip(adam.param_groups, rates, strict=True):
                group["lr"] = rate * stage.pace(step)
            adam.step()
            variances, gains = (0.5 * (variances + terms.variances)).clamp(min=1e-6), terms.gains
        return Starts(
            coefficients=placed.where(fixed, wall).numpy(),
            free=free.numpy(),
            gains=gains.double().numpy(),
            variances=variances.double().numpy(),
            energy=terms.energy.double().numpy(),
            chi_square=self._chi_square(terms),
            radius=starts.radius,
        )

    def _chi_square(self, terms: Terms) -> Floats:
        squares: Floats = terms.squares.double().numpy()
        return squares / (self.sigma**2 * self._frames.counted)

    def _spread(self, work: Callable[[Any], Any], rows: Any) -> list[Any]:
        """Apply ``work`` to chunks of rows, on several threads; the chunks do not depend on them.

        Eight starts fit into the processor's cache. Torch releases the interpreter lock.
        """
        parts = [rows[first : first + 8] for first in range(0, len(rows), 8)]
        threads = min(len(parts), numba.get_num_threads())
        # also for one chunk: numba's first question for threads gives torch in the calling thread
        # as many, and its small transforms then take ten times longer on a busy machine
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            return list(pool.map(work, parts))

    def _mean(self, free: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean objects (B, H, W) of free parameters, and their derivatives."""
        if self._known is not None:
            return self._known.expand(len(free), -1, -1), torch.zeros(())
        root = (free.square() + SETTINGS.softness**2).sqrt_()
        mean = (free + root).mul_(0.5 * self._support)
        return mean, mean / root

    def _objects(self, wall: Tensor, noise: float) -> Floats:
        """Return Wiener-filtered objects, (B, H, W), at least 0.01 of the image's range.

        ``noise`` is the ratio of the assumed noise to the actual one.
        """
        transfer, images = self._transfer(wall), self._images
        if self._frames.fit_background:
            edges = [images[:, [0, -1]].flatten(1), images[:, :, [0, -1]].flatten(1)]
            images = images - torch.cat(edges, 1).median(dim=1).values[:, None, None]
        seen, (along, down, _) = torch.fft.rfft2(images, s=self.grid), self._steps
        prior = (noise * self.sigma) ** 2 * ((along + down[:, None]) / 0.02 + 1e-3)
        power = (transfer.real.square() + transfer.imag.square()).sum(1)
        mean = self._cut((transfer.conj() * seen).sum(1) / (power + prior))
        return mean.clamp(min=0.01).numpy()

    def _samples(self, wall: Tensor) -> Tensor:
        """Return point spreads (B, K, p, c) of walls (B, M), without the pixels of the detector."""
        turns = self._pupil.waves(wall.reshape(len(wall), -1, len(self.modes)))
        samples: Tensor = self._pupil.optics.samples(turns[:, self._frames.walls] + self._defocus)
        return samples

    def _transfer(self, wall: Tensor) -> Tensor:
        """Return transfer functions of walls (B, M) times the images' levels, (B, K, p, q)."""
        transfer: Tensor = torch.fft.rfft2(self._samples(wall)) * self._pixel
        return transfer

    def _held(self, wall: Tensor) -> Tensor:
        held: Tensor = self._stiffness * (wall - self._first).square().sum(1)
        return held

    def _spreads(self, walls: Floats) -> Floats:
        """Return the point spreads (B, K, p, c) of walls (B, M), their centre at sample [0, 0]."""
        spreads: Floats = torch.fft.irfft2(self._transfer(self._tensor(walls)), s=self.grid).numpy()
        return spreads

    def _cut(self, spectra: Tensor) -> Tensor:
        """Return the images (..., H, W) of half spectra."""
        rows, columns = self._frames.shape
        images: Tensor = torch.fft.irfft2(spectra, s=self.grid)
        return images[..., :rows, :columns]

    def _tensor(self, values: Any) -> Tensor:
        return torch.as_tensor(np.asarray(values), dtype=self._dtype)
