"""Free energy of object and walls: the object's uncertainty integrated out, gradients sparse."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..wave.frames import Frames

#: Sharpness of the sparse prior; a larger value prefers few large gradients to many small ones.
_SHARPNESS = 0.5
_SMALLEST_VARIANCE = 1e-6
_FIRST_VARIANCE = 1e-3
#: Objects are ``_SOFTNESS softplus(theta/_SOFTNESS)`` of the fitted theta, hence not negative.
_SOFTNESS = 0.1
_DARKEST = 0.01


class Energy:
    """Variational free energy of batches of objects and wall coefficients.

    The object is Gaussian about its estimate m, with a covariance C that is diagonal in Fourier
    space. Its gradients have a sparse density, a Gaussian scale mixture of sharpness a. Summed over
    images k, pixels i, directions d and frequencies f, for the noise s,

    ``F = 1/2 {sum |H_k m - I_k|^2/s^2 + sum [w_di ((D_d m)_i^2 + v_d) - a log w_di] + sum [C sum_k
    |H_k|^2/s^2 - log C]}``, with ``w_di = a/((D_d m)_i^2 + v_d)``, ``C = 1/(sum_k |H_k|^2/s^2 +
    sum_d mean(w_d) |D_d|^2)`` and v_d the variance of C along d.

    The third sum compensates what a sharp point spread gains by fitting noise. Without it, a point
    spread without blur would explain every image best [1]_. Each call sets w, C and v to their
    optimal values. The gradient treats them as constants, which is exact at the optimum.

    Parameters
    ----------
    frames : Frames
        Images with their noise and point spread.
    support : Tensor or None, (H, W)
        0 where the object is known to be dark.

    References
    ----------
    .. [1] Levin, Weiss, Durand and Freeman, CVPR 2009, 1964.
    """

    def __init__(self, frames: Frames, support: Tensor | None) -> None:
        self.frames = frames
        rows, columns = frames.pupil.shape
        like = frames.images
        across = torch.fft.rfftfreq(columns, dtype=torch.float64)
        up = torch.fft.fftfreq(rows, dtype=torch.float64)
        twice = torch.full((columns // 2 + 1,), 2.0, dtype=torch.float64)
        twice[0] = 1.0
        if columns % 2 == 0:
            twice[-1] = 1.0
        ones = torch.ones((rows, columns // 2 + 1), dtype=torch.float64)
        self._differences = torch.stack(
            [
                (2.0 - 2.0 * torch.cos(2.0 * math.pi * up))[:, None] * ones,
                (2.0 - 2.0 * torch.cos(2.0 * math.pi * across)) * ones,
            ]
        ).to(like)
        # the sums over frequencies are those of the frame, which is a part of the grid
        height, width = like.shape[-2:]
        self._share = (twice * (height * width / (rows * columns))).to(like)
        self._per_pixel = (twice / (rows * columns)).to(like)
        # Fourier sums need one precision per image
        self._precision = frames.precision.expand(like.shape).mean((-2, -1))[:, None, None]
        self.support = support

    def level(self, theta: Tensor) -> Tensor:
        """Return the objects (B, H, W) of fitted parameters."""
        level = _SOFTNESS * torch.nn.functional.softplus(theta / _SOFTNESS)
        return level if self.support is None else level * self.support

    def theta(self, level: Tensor) -> Tensor:
        """Return the fitted parameters of objects (B, H, W); the inverse of `level`."""
        ratio = level.clamp_min(_DARKEST) / _SOFTNESS
        return _SOFTNESS * (ratio + torch.log(-torch.expm1(-ratio)))

    def first_variances(self, count: int) -> Tensor:
        """Return the initial variances v, (B, 2, 1, 1), for ``count`` starts."""
        return torch.full((count, 2, 1, 1), _FIRST_VARIANCE).to(self.frames.images)

    def wiener(self, transfer: Tensor, factor: float) -> Tensor:
        """Return Wiener-filtered objects (B, H, W) for given transfer functions.

        ``factor`` is the ratio of the assumed noise to the actual one.
        """
        frames = self.frames
        misfit = frames.images
        if frames.fit_background:
            misfit = misfit - misfit.flatten(1).quantile(0.1, dim=1)[:, None, None]
        spectrum = torch.fft.rfft2(misfit, s=frames.pupil.shape)
        precision = self._precision / factor**2
        prior = self._differences.sum(0) / 0.02 + 1e-3
        power = (precision * _power(transfer)).sum(-3) + prior
        spectrum = (precision * transfer.conj() * spectrum).sum(-3) / power
        rows, columns = misfit.shape[-2:]
        level: Tensor = torch.fft.irfft2(spectrum, s=frames.pupil.shape)[..., :rows, :columns]
        return level if self.support is None else level * self.support

    def __call__(
        self,
        level: Tensor,
        transfer: Tensor,
        variances: Tensor,
        factor: float,
        gains: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return free energies (B,) and mean squared residuals over the noise variance (B,).

        Parameters
        ----------
        level : Tensor, (B, H, W)
            Objects, in the unit of the images.
        transfer : Tensor, (B, K, rows, columns//2 + 1)
            Transfer functions.
        variances : Tensor, (B, 2, 1, 1)
            Posterior variances of the objects' differences along y and x; updated.
        factor : float
            Ratio of the assumed noise to the actual one.
        gains : Tensor, (B, K, 1, 1), optional
            Relative brightness of the images.
        """
        fit = self.squares(level, transfer, gains)
        slopes = torch.stack(
            [
                level.diff(dim=-2, append=level[..., -1:, :]),
                level.diff(dim=-1, append=level[..., -1:]),
            ],
            dim=-3,
        )
        power = (self._precision / factor**2 * _power(transfer)).sum(-3)
        with torch.no_grad():
            weights = _SHARPNESS / (slopes.square() + variances)
            mean = weights.mean((-2, -1), keepdim=True)
            covariance = 1.0 / (power + (mean * self._differences).sum(-3) + _SMALLEST_VARIANCE)
            spread = (covariance.unsqueeze(-3) * self._differences * self._per_pixel).sum((-2, -1))
            rest = (weights * variances - _SHARPNESS * weights.log()).sum((-3, -2, -1))
            rest -= (self._share * covariance.log()).sum((-2, -1))
            variances.lerp_(spread[..., None, None], 0.5).clamp_min_(_SMALLEST_VARIANCE)
        energy = fit / factor**2 + (weights * slopes.square()).sum((-3, -2, -1)) + rest
        energy = energy + (self._share * covariance * power).sum((-2, -1))
        return 0.5 * energy, fit.detach() / self.frames.counted

    def squares(self, level: Tensor, transfer: Tensor, gains: Tensor | None) -> Tensor:
        """Return the sum of squared residuals over the noise variance, (B,)."""
        frames = self.frames
        seen = frames.seen(level, transfer)
        residual = frames.residual(seen if gains is None else gains * seen)
        return (frames.precision * residual.square()).sum((-3, -2, -1))


class KnownObjectEnergy(Energy):
    """Half the squared residual over the noise variance, for a known object of unknown brightness.

    Parameters
    ----------
    frames : Frames
        Images with their noise and point spread.
    known : Tensor, (H, W)
        The object.
    """

    def __init__(self, frames: Frames, known: Tensor) -> None:
        super().__init__(frames, None)
        self._known = known / known.abs().max()

    def level(self, theta: Tensor) -> Tensor:
        """Return the known object times the fitted brightness, (B, H, W)."""
        return self._known * theta[..., :1, :1]

    def theta(self, level: Tensor) -> Tensor:
        """Return a brightness of 1 for each start."""
        return torch.ones_like(level)

    def wiener(self, transfer: Tensor, factor: float) -> Tensor:
        """Return the known object for each start, (B, H, W)."""
        return self._known.expand(transfer.shape[0], *self._known.shape).clone()

    def __call__(
        self,
        level: Tensor,
        transfer: Tensor,
        variances: Tensor,
        factor: float,
        gains: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return energies (B,) and mean squared residuals over the noise variance (B,).

        The arguments are those of `Energy`; ``variances`` is not used.
        """
        fit = self.squares(level, transfer, gains)
        return 0.5 * fit / factor**2, fit.detach() / self.frames.counted


def _power(transfer: Tensor) -> Tensor:
    return transfer.real.square() + transfer.imag.square()
