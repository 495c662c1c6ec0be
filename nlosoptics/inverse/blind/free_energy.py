"""Variational free energy of images by an unknown wave, with the object integrated out.

The object's posterior is a Gaussian whose covariance is diagonal in Fourier space. Its prior is a
Gaussian scale mixture for differences of neighbouring pixels. Sums extend over the padded FFT grid
that contains the image. Light that leaves the image is lost, and the object is dark outside.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...errors import SamplingError, SceneError
from ..wave.pupil_optics import PupilOptics
from ..wave.pupil_psf import PupilPSF
from ..wave.pupil_waves import DEFOCUS, ZernikeWaves, noll_mode
from . import _evidence_kernels as kernels

Floats = NDArray[Any]
#: Softness of the transition of object values to 0, relative to the image's maximum.
_SOFTNESS = 0.1
#: Number of starts processed together, so that their arrays fit into the processor's cache.
_CHUNK = 8
#: Largest pitch relative to Nyquist's that is treated as Nyquist's: the transfer function 2 % below
#: the cutoff is less than 1e-3.
_NYQUIST_SLACK = 1.02
#: Largest rms, waves, of a known wave in addition to the modes that does not affect the answer.
_MOST_REST = 0.05
_LEAST_VARIANCE = 1e-6
_SHRINK = np.array([0.9, 0.99])


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Settings of one descent.

    Parameters
    ----------
    iterations : int
        Number of iterations.
    kappa : float
        Strength of the object's prior; 0.5 to compare answers, 1 to 1.5 to search.
    first, last : float
        Ratio of the assumed noise to the actual one, at the start and from ``share`` on.
    share : float
        Fraction of the iterations after which ``last`` is reached.
    wave_rate : float
        Largest step of a coefficient, waves.
    object_rate : float
        Largest step of an object value, relative to the image's maximum.
    """

    iterations: int
    kappa: float
    first: float
    last: float
    share: float
    wave_rate: float
    object_rate: float = 0.05

    def noise(self, iteration: int) -> float:
        """Return the ratio of the assumed noise to the actual one in an iteration."""
        done = min(1.0, iteration / (self.share * self.iterations))
        return self.first * math.exp(done * math.log(self.last / self.first))

    def pace(self, iteration: int) -> float:
        """Return the factor of both rates: 1 in the first half, then a cosine down to 5 %."""
        late = max(0.0, 2.0 * iteration / self.iterations - 1.0)
        return 0.05 + 0.95 * 0.5 * (1.0 + math.cos(math.pi * late))


@dataclass(frozen=True, eq=False, kw_only=True)
class Starts:
    """Walls and objects during a fit, one per row.

    Parameters
    ----------
    coefficients : ndarray, (B, M)
        Zernike coefficients of the walls, waves rms.
    free : ndarray, (B, n, n)
        Free parameters from which `softly_positive` computes the objects.
    variances : ndarray, (B, 2)
        Posterior variances of the objects' differences along x and y.
    energy : ndarray, (B,)
        Free energy at the end of the last stage, infinite before.
    chi_square : ndarray, (B, K)
        Mean squared residual of each image over its noise variance.
    radius : ndarray, (B,)
        Fixed norm of the coefficients, waves rms; infinite if it is free.
    """

    coefficients: Floats
    free: Floats
    variances: Floats
    energy: Floats
    chi_square: Floats
    radius: Floats

    def __len__(self) -> int:
        return len(self.energy)

    def __getitem__(self, rows: Any) -> Starts:
        return Starts(**{name: values[rows] for name, values in vars(self).items()})

    def held(self, radius: Floats | float) -> Starts:
        """Return these starts with another fixed norm of the coefficients; infinite: free."""
        return replace(self, radius=np.broadcast_to(np.float64(radius), len(self)).copy())

    def best(self, count: int) -> Starts:
        """Return the ``count`` starts of least free energy, least first."""
        return self[np.argsort(self.energy, kind="stable")[:count]]


def joined(parts: Iterable[Starts]) -> Starts:
    """Concatenate several sets of starts."""
    parts = list(parts)
    return Starts(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in vars(parts[0])})


class FreeEnergy:
    """Free energy of images as a function of wall coefficients and mean object.

    Parameters
    ----------
    images : ndarray, (K, n, n)
        Images divided by their maximum.
    sigmas : ndarray, (K,)
        Noise in the same unit.
    pupil_psf : PupilPSF
        Point spread with Zernike coefficients, of any shape.
    defocus : ndarray, (K,)
        Known additional defocus (Noll 4) of each image, m rms.
    grid : int
        Samples p along each side of the padded FFT grid, at least n.
    fit_background : bool
        Whether each image has an unknown uniform background.
    dtype : type
        ``numpy.float32`` or ``numpy.float64``.

    Notes
    -----
    With residuals r, noise s, prior strength kappa, differences D, mean object m, variances v,
    transfer functions H and posterior covariance C [1]_::

        2 F = sum r^2/s^2 + sum kappa log((D m)^2 + v) + (n/p)^2 sum_f (C |H|^2/s^2 - log C)

    The gradient treats v and C as constants, since F is minimal with respect to them.

    References
    ----------
    .. [1] Levin, Weiss, Durand and Freeman, CVPR (2011) 2657.
    """

    def __init__(
        self,
        images: Floats,
        sigmas: Floats,
        pupil_psf: PupilPSF,
        defocus: Floats,
        *,
        grid: int,
        fit_background: bool = True,
        dtype: type = np.float32,
    ) -> None:
        self.sigma = float(np.mean(np.square(sigmas)) ** 0.5)
        weights = self.sigma / np.asarray(sigmas, dtype=np.float64)
        self._weights = weights
        self._images: Floats = np.ascontiguousarray(images * weights[:, None, None], dtype=dtype)
        self._dtype, self._grid = dtype, grid
        self._fit_background = fit_background
        modes = np.array(pupil_psf.modes)
        orders = (np.sqrt(8.0 * modes - 7.0) - 1.0) // 2.0
        #: signs that convert a wall to the one with the same in-focus point spread, W(x) -> -W(-x)
        self.twin = np.where(orders % 2 == 0, -1.0, 1.0)
        self._share = (self._images.shape[1] / grid) ** 2
        self._steps: Floats = (2.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(grid) / grid)).astype(
            dtype
        )
        optics, basis = _pupil(pupil_psf, grid)
        self._cells = optics.share.shape
        self._amplitude = torch.from_numpy(_array(optics, "_amplitude").reshape(-1).astype(dtype))
        self._basis = torch.from_numpy(np.ascontiguousarray(basis, dtype=dtype))
        turns = np.asarray(defocus) / optics.wavelength
        side = math.copysign(2.0 * math.pi, optics.image_distance)
        known = side * np.outer(turns, noll_mode(DEFOCUS, optics))
        self._known = torch.from_numpy(known.astype(dtype))
        pixel = (
            _array(optics, "_pixel") if optics.pixel_integrated else np.ones((grid, grid // 2 + 1))
        )
        self._pixel: Floats = (pixel * weights[:, None, None]).astype(dtype)

    @property
    def modes(self) -> int:
        """Number of coefficients of a wall."""
        return int(self._basis.shape[0])

    def starts(self, coefficients: Floats, noise: float, radius: Any = np.inf) -> Starts:
        """Return starts with given walls and Wiener-filtered objects.

        Parameters
        ----------
        coefficients : ndarray, (B, M)
            Coefficients of the walls, waves rms.
        noise : float
            Ratio of the assumed noise to the actual one.
        radius : float or ndarray, (B,)
            Fixed norm of the coefficients, waves rms; infinite: free.
        """
        wall: Floats = np.ascontiguousarray(coefficients, dtype=self._dtype)
        found = []
        for first in range(0, len(wall), _CHUNK):
            found.append(self._objects(wall[first : first + _CHUNK], noise))
        mean = np.concatenate(found)
        count = len(wall)
        return Starts(
            coefficients=wall,
            free=(mean - _SOFTNESS**2 / (4.0 * mean)).astype(self._dtype),
            variances=np.full((count, 2), 1e-3),
            energy=np.full(count, np.inf),
            chi_square=np.full((count, len(self._images)), np.inf),
            radius=np.broadcast_to(np.float64(radius), count).copy(),
        )

    def descend(self, starts: Starts, stage: Stage) -> Starts:
        """Run one stage; return the resulting starts with their energies."""
        rows = range(0, len(starts), _CHUNK)
        return joined(self._descend(starts[row : row + _CHUNK], stage) for row in rows)

    def objects(self, starts: Starts) -> Floats:
        """Return the mean objects, (B, n, n), in the images' unit."""
        mean = np.empty_like(starts.free)
        kernels.softly_positive(starts.free, _SOFTNESS, mean)
        return mean

    def evaluate(
        self, starts: Starts, wall: Floats, noise: float, kappa: float, want_energy: bool
    ) -> tuple[dict[str, Floats], Floats, Floats, Floats]:
        """Return energies and gradients for given walls.

        Parameters
        ----------
        starts : Starts
            Objects and variances.
        wall : ndarray, (B, M)
            Coefficients, used instead of those of ``starts``.
        noise : float
            Ratio of the assumed noise to the actual one.
        kappa : float
            Strength of the object's prior.
        want_energy : bool
            Whether to compute the energies.

        Returns
        -------
        values : dict
            ``energy`` (B,), without meaning if not wanted; ``squares`` (B, K), the squared
            residuals over the noise variance; ``background`` (B, K), times the images' weights;
            ``variances`` (B, 2).
        by_data : ndarray, (B, p, p)
            Gradient of the data term with respect to the mean object, in its first n x n samples.
        by_prior : ndarray, (B, n, n)
            Gradient of the prior with respect to the mean object.
        by_wall : ndarray, (B, M)
            Gradient with respect to the coefficients.
        """
        mean, grid = self.objects(starts), (self._grid, self._grid)
        count, frames = len(mean), len(self._images)
        transfer, pupil, field = self._transfer(wall)
        spectrum = torch.fft.rfft2(torch.from_numpy(mean), s=grid).numpy()
        product = np.empty_like(transfer)
        kernels.predict(transfer, self._pixel, spectrum, product)
        seen = torch.fft.irfft2(torch.from_numpy(product), s=grid).numpy()
        squares, background = np.empty((count, frames)), np.empty((count, frames))
        kernels.residuals(seen, self._images, self._fit_background, squares, background)
        residual = torch.fft.rfft2(torch.from_numpy(seen)).numpy()
        by_prior, roughness = np.empty_like(mean), np.empty(count)
        weights = np.empty((count, 2))
        kernels.roughness(
            mean, starts.variances.astype(self._dtype), kappa, by_prior, weights, roughness,
            want_energy,
        )  # fmt: skip
        precision = np.full(count, 1.0 / (noise * self.sigma) ** 2)
        variances, volume = np.empty((count, 2)), np.empty(count)
        kernels.spectra(
            transfer, residual, spectrum, self._pixel, self._steps, weights, precision,
            self._share, product[:, 0], variances, volume, want_energy,
        )  # fmt: skip
        by_data = torch.fft.irfft2(torch.from_numpy(product[:, 0]), s=grid).numpy()
        energy = 0.5 * (squares.sum(axis=1) * precision + roughness + volume)
        values = {
            "energy": energy,
            "squares": squares / self.sigma**2,
            "background": background,
            "variances": variances,
        }
        return values, by_data, by_prior, self._wall_gradient(residual, pupil, field)

    def background(self, starts: Starts) -> Floats:
        """Return the fitted uniform background of each image, (B, K), in the images' unit."""
        values = self.evaluate(starts, starts.coefficients, 1.0, 0.5, False)[0]
        level: Floats = values["background"] / self._weights
        return level

    def _descend(self, starts: Starts, stage: Stage) -> Starts:
        wall, free = starts.coefficients.copy(), starts.free.copy()
        now = replace(starts, free=free, variances=starts.variances.copy())
        first, second = np.zeros_like(free), np.zeros_like(free)
        wall_first, wall_second = np.zeros(wall.shape), np.zeros(wall.shape)
        held = np.isfinite(starts.radius)[:, None]
        radius = np.where(held, starts.radius[:, None], 1.0)
        for step in range(stage.iterations):
            length = np.linalg.norm(wall, axis=1, keepdims=True)
            placed = np.where(held, wall * (radius / np.maximum(length, 1e-12)), wall)
            placed = np.ascontiguousarray(placed, dtype=self._dtype)
            last = step == stage.iterations - 1
            values, by_data, by_prior, slope = self.evaluate(
                now, placed, stage.noise(step), stage.kappa, last
            )
            along = (slope * placed).sum(axis=1, keepdims=True) * placed / radius**2
            slope = np.where(held, (slope - along) * (radius / np.maximum(length, 1e-12)), slope)
            np.maximum(
                0.5 * (now.variances + values["variances"]), _LEAST_VARIANCE, out=now.variances
            )
            bias, bias_square = 1.0 - _SHRINK ** (step + 1)
            pace = stage.pace(step) / bias
            kernels.object_step(
                free, by_data, by_prior, first, second, _SOFTNESS, stage.object_rate * pace,
                bias_square,
            )  # fmt: skip
            wall_first += 0.1 * (slope - wall_first)
            wall_second += 0.01 * (slope**2 - wall_second)
            root = np.sqrt(wall_second / bias_square) + 1e-10
            wall = (wall - stage.wave_rate * pace * wall_first / root).astype(self._dtype)
        pixels = self._images[0].size
        return replace(
            now,
            coefficients=placed if held.all() else np.where(held, placed, wall),
            energy=values["energy"],
            chi_square=values["squares"] / pixels,
        )

    def _objects(self, wall: Floats, noise: float) -> Floats:
        """Return Wiener-filtered objects, (B, n, n), at least 0.01 of the image's maximum.

        ``noise`` is the ratio of the assumed noise to the actual one.
        """
        n, grid = self._images.shape[1], (self._grid, self._grid)
        transfer = self._transfer(wall)[0] * self._pixel
        level = np.zeros(len(self._images))
        if self._fit_background:
            edges = [self._images[:, [0, -1]], self._images[:, :, [0, -1]].swapaxes(1, 2)]
            level = np.median(np.concatenate(edges, axis=1), axis=(1, 2))
        data = torch.fft.rfft2(torch.from_numpy(self._images - level[:, None, None]), s=grid)
        rough = self._steps[:, None] + self._steps[: self._grid // 2 + 1]
        prior = (noise * self.sigma) ** 2 * (rough / 0.02 + 1e-3)
        power = (transfer.real**2 + transfer.imag**2).sum(axis=1)
        spectrum = (transfer.conj() * data.numpy()).sum(axis=1) / (power + prior)
        mean = torch.fft.irfft2(torch.from_numpy(spectrum), s=grid).numpy()[:, :n, :n]
        bright: Floats = np.maximum(mean, 0.01)
        return bright

    def _transfer(self, wall: Floats) -> tuple[Floats, Tensor, Floats]:
        """Return transfer functions (B, K, p, q), pupil functions, and image fields.

        The transfer functions do not contain that of the detector's pixels.
        """
        count, frames, p = len(wall), len(self._images), self._grid
        phase = (torch.from_numpy(wall) @ self._basis)[:, None] + self._known
        pupil = torch.complex(phase.cos() * self._amplitude, phase.sin() * self._amplitude)
        lit = pupil.view(count, frames, *self._cells)
        field = torch.fft.fft(torch.fft.fft(lit, n=p, dim=-2), n=p, dim=-1).numpy()
        spread = np.empty(field.shape, dtype=self._dtype)
        kernels.intensity(field, spread)
        return torch.fft.rfft2(torch.from_numpy(spread)).numpy(), pupil, field

    def _wall_gradient(self, toward: Floats, pupil: Tensor, field: Floats) -> Floats:
        p, (rows, columns) = self._grid, self._cells
        spread = torch.fft.irfft2(torch.from_numpy(toward), s=(p, p)).numpy()
        pulled = np.empty(field.shape, dtype=field.dtype)
        kernels.pull_back(field, spread, 2.0 * float(p) ** 4, pulled)
        cells = torch.fft.ifft(torch.from_numpy(pulled), dim=-1)[..., :columns]
        cells = torch.fft.ifft(cells, dim=-2)[..., :rows, :].contiguous()
        phase = np.empty((len(field), rows * columns), dtype=self._dtype)
        kernels.phase_gradient(pupil.numpy(), cells.view(pupil.shape).numpy(), phase)
        slope: Floats = (torch.from_numpy(phase) @ self._basis.T).numpy()
        return slope


def _pupil(pupil_psf: PupilPSF, grid: int) -> tuple[PupilOptics, Floats]:
    """Return the pupil sampled for the padded grid, and the phases of its modes.

    The phases are (M, cells), rad per wave of the coefficient.
    """
    given = pupil_psf.optics
    waves = pupil_psf.waves
    if not isinstance(waves, ZernikeWaves):
        raise SceneError(
            f"pupil_psf has coefficients of kind {type(waves).__name__}, must be Zernike modes for "
            "the evidence fit; build it by PupilPSF.from_zernike"
        )
    if waves.rest is not None:
        share = torch.as_tensor(given.share).to(waves.rest)
        mean = (share * waves.rest).sum() / share.sum()
        rest = float(((share * (waves.rest - mean) ** 2).sum() / share.sum()).sqrt())
        if rest > _MOST_REST:
            raise SceneError(
                f"pupil_psf has a known wave of {rest:.3g} waves rms besides its modes, limit "
                f"{_MOST_REST:g}, because the evidence fit uses modes alone; give more modes, or "
                'use recipe "staged"'
            )
    pitch = given.pitch
    if pitch > given.nyquist_pitch:
        if pitch > given.nyquist_pitch * _NYQUIST_SLACK:
            raise SamplingError(
                f"pitch = {pitch:.6g} m is wider than Nyquist's {given.nyquist_pitch:.6g} m; "
                "use pixels of lambda |d|/(4 radius) or less for the evidence fit"
            )
        pitch = given.nyquist_pitch
    optics = PupilOptics(
        wavelength=given.wavelength,
        pupil_radius=given.pupil_radius,
        image_distance=given.image_distance,
        pitch=pitch,
        shape=grid,
        pixel_integrated=given.pixel_integrated,
        dtype=torch.float64,
    )
    side = math.copysign(2.0 * math.pi, given.image_distance)
    basis = np.stack([noll_mode(mode, optics).ravel() for mode in waves.modes])
    return optics, side * basis


def _array(optics: PupilOptics, name: str) -> Floats:
    values: Floats = getattr(optics, name).numpy()
    return values
