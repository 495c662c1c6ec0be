"""Images of one object via unknown walls, prepared for a fit of object and walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..._checks import counted, one_of
from ...errors import SamplingError, SceneError
from ..data.measurement import Measurement, measurement, real_array, shape_of
from .pupil_psf import MOST_DEFOCUS, PupilPSF
from .pupil_waves import ZernikeWaves

#: Ratio of FFT grid to frame, so that light leaving at one edge does not re-enter at the other.
_PADDING = 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Frames:
    """Checked images and the grid of their point spreads, for K images of (H, W) pixels.

    Parameters
    ----------
    measured : tuple of Measurement
        The images with their noise.
    images : Tensor, (K, H, W)
        Images minus their known background, divided by ``scale``.
    precision : Tensor, (K, H, W) or (K, 1, 1)
        1/sigma^2 in these units.
    shapes : Tensor, (K, H, W) or (K, 1, 1)
        Shape of the unknown background, mean 1.
    scale : float
        Largest range of an image, image units.
    pupil : PupilPSF
        Point spread on the FFT grid of (rows, columns), not smaller than (H, W).
    walls : Tensor of int, (K,)
        Number of the wall, hence of the set of coefficients, of each image.
    defocus : Tensor, (K,)
        Known additional defocus, m rms.
    """

    measured: tuple[Measurement, ...]
    images: Tensor
    precision: Tensor
    shapes: Tensor
    scale: float
    pupil: PupilPSF
    walls: Tensor
    defocus: Tensor

    @property
    def n_walls(self) -> int:
        """Number of different walls."""
        return int(self.walls.max()) + 1

    @property
    def counted(self) -> int:
        """Number of pixels with finite noise, over all images."""
        return sum(one.counted for one in self.measured)

    @property
    def fit_background(self) -> bool:
        """Whether each image has a further background of unknown strength."""
        return self.measured[0].fit_background

    def transfer(self, coefficients: Tensor) -> Tensor:
        """Return the transfer functions for coefficients (B, n_walls, M).

        Their shape is (B, K, rows, columns//2 + 1).
        """
        each = coefficients[:, self.walls]
        turns = self.pupil.waves(each) + self.pupil.defocus_turns(self.defocus.to(each))
        return self.pupil.optics.transfer(turns)

    def seen(self, level: Tensor, transfer: Tensor) -> Tensor:
        """Return the images (B, K, H, W) of objects ``level`` (B, H, W)."""
        grid = self.pupil.shape
        spectrum = torch.fft.rfft2(level, s=grid).unsqueeze(-3) * transfer
        rows, columns = self.images.shape[-2:]
        seen: Tensor = torch.fft.irfft2(spectrum, s=grid)
        return seen[..., :rows, :columns]

    def backgrounds(self, misfit: Tensor) -> Tensor:
        """Return the best-fitting background strengths (B, K, 1, 1) of a misfit (B, K, H, W)."""
        if not self.fit_background:
            return torch.zeros_like(misfit[..., :1, :1])
        weighted = self.precision * self.shapes
        norm = (weighted * self.shapes).expand(self.images.shape).sum((-2, -1), keepdim=True)
        return (weighted * misfit).sum((-2, -1), keepdim=True) / norm

    def residual(self, seen: Tensor) -> Tensor:
        """Return measured minus modelled images ``seen`` and best background, (B, K, H, W)."""
        misfit = self.images - seen
        return misfit - self.backgrounds(misfit) * self.shapes

    def mean_square(self, residual: Tensor) -> Tensor:
        """Return the mean squared residual over the noise variance, (B,).

        Pixels with infinite noise are excluded.
        """
        return (self.precision * residual.square()).sum((-3, -2, -1)) / self.counted


def frames_of(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any,
    walls: Any,
    noise_sigma: Any,
    background: Any,
    fit_background: bool,
    background_shape: Any,
    boundary: str,
) -> Frames:
    """Check images and the information about them; the arguments are those of `pcin`."""
    if not isinstance(pupil_psf, PupilPSF):
        raise SceneError(
            f"pupil_psf of type {type(pupil_psf).__name__} is not a point spread with an unknown "
            "wave; give an inverse.PupilPSF"
        )
    if not isinstance(pupil_psf.waves, ZernikeWaves):
        raise SceneError(
            "pupil_psf has slopes instead of Zernike coefficients; build it by "
            "PupilPSF.from_zernike"
        )
    stack = _stack(images)
    count, shape = stack.shape[0], (int(stack.shape[1]), int(stack.shape[2]))
    sigmas = _per_image("noise_sigma", noise_sigma, count, stack.ndim)
    backgrounds = _per_image("background", background, count, stack.ndim)
    measured = tuple(
        measurement(
            image,
            shape,
            noise_sigma=sigma,
            background=known,
            fit_background=fit_background,
            background_shape=background_shape,
        )
        for image, sigma, known in zip(stack, sigmas, backgrounds, strict=True)
    )
    for number, one in enumerate(measured):
        if one.sigma == 0.0:
            raise SceneError(f"the estimated noise of image {number} is 0; give noise_sigma")
    pupil = _on_grid(pupil_psf, shape, boundary)
    like = torch.zeros((), dtype=pupil.optics.dtype, device=pupil.optics.device)
    scale = max(float(one.data.max() - one.data.min()) for one in measured)
    if not scale > 0.0:
        scale = max(one.sigma for one in measured)
    ones = torch.ones((1, 1), dtype=torch.float64)
    return Frames(
        measured=measured,
        images=torch.stack([one.data / scale for one in measured]).to(like),
        precision=torch.stack(
            [(scale / one.sigma) ** 2 * _or(one.weights, ones) for one in measured]
        ).to(like),
        shapes=torch.stack([_or(one.background_shape, ones) for one in measured]).to(like),
        scale=scale,
        pupil=pupil,
        walls=_wall_numbers(walls, count).to(pupil.optics.device),
        defocus=known_defoci(defocus, count).to(like),
    )


def _or(value: Tensor | None, other: Tensor) -> Tensor:
    return other if value is None else value


def _stack(images: Any) -> Any:
    try:
        stack = images if isinstance(images, Tensor) else np.asarray(images)
    except ValueError:
        raise SamplingError("images differ in shape; give one array (K, H, W)") from None
    if stack.ndim == 2:
        stack = stack[None]
    if stack.ndim != 3 or 0 in stack.shape:
        raise SamplingError(f"images have shape {tuple(stack.shape)}, must be (K, H, W) or (H, W)")
    return stack


def _per_image(name: str, value: Any, count: int, ndim: int) -> list[Any]:
    """Return one value for each of ``count`` images.

    ``value`` is common to all, a number or (H, W), or has one entry per image, (K,) or (K, H, W).
    ``ndim`` is that of the stack of images.
    """
    dimensions = len(shape_of(name, value))
    if dimensions in (0, ndim - 1):
        return [value] * count
    if len(value) != count:
        raise SamplingError(
            f"{name} has {counted(len(value), 'value')} for {counted(count, 'image')}; give one "
            "for each"
        )
    return list(value)


def _wall_numbers(walls: Any, count: int) -> Tensor:
    if walls is None:
        return torch.zeros(count, dtype=torch.int64)
    shape_of("walls", walls)  # refuses rows of different length
    numbers = np.asarray(walls)
    if numbers.shape != (count,) or numbers.dtype.kind not in "iu":
        raise SamplingError(
            f"walls has shape {numbers.shape} and type {numbers.dtype}; give "
            f"{counted(count, 'whole number')}, the wall of each image"
        )
    if sorted(set(numbers.tolist())) != list(range(int(numbers.max()) + 1)):
        raise SamplingError(f"walls = {numbers.tolist()}; number them 0, 1, ... without gaps")
    return torch.from_numpy(numbers.astype(np.int64))


def known_defoci(defocus: Any, count: int) -> Tensor:
    """Return the known additional defocus of each image, (K,) float64, m rms; 0 by default."""
    values = np.zeros(count) if defocus is None else real_array("defocus", defocus)
    if values.shape != (count,):
        raise SamplingError(
            f"defocus has shape {values.shape}, must be ({count},); give one value per image"
        )
    if not (np.abs(values) <= MOST_DEFOCUS).all():  # nor is NaN
        raise SceneError(
            f"defocus = {values.tolist()} m rms, limit {MOST_DEFOCUS:g}; give metres, not waves"
        )
    return torch.from_numpy(values)


def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the FFT grid (rows, columns) that surrounds frames of a shape with a margin."""
    rows, columns = (2 * round(_PADDING * side / 2) for side in shape)
    return rows, columns


def _on_grid(pupil_psf: PupilPSF, shape: tuple[int, int], boundary: str) -> PupilPSF:
    """Return the point spread on the FFT grid: the frame, or a larger grid if padded."""
    one_of("boundary", boundary, ("padded", "circular"))
    own = pupil_psf.shape
    if own[0] < shape[0] or own[1] < shape[1]:
        raise SamplingError(
            f"pupil_psf has shape {own} and the images {shape}; give a point spread of the "
            "images' shape or larger"
        )
    if boundary == "circular" and own != shape:
        raise SamplingError(
            f"pupil_psf has shape {own} and a circular frame {shape}; make them equal, or use "
            "boundary='padded'"
        )
    wide = own
    if boundary == "padded":
        rows, columns = padded_shape(shape)
        wide = (max(own[0], rows), max(own[1], columns))
    optics = pupil_psf.optics
    if wide == own:
        return pupil_psf
    if pupil_psf.holds_more:
        raise SamplingError(
            f"pupil_psf has shape {own}, but padded images need {wide} samples, on which its known "
            "wave or transmission is not available; build it with that shape"
        )
    samples = None
    if optics.method == "mdft":
        samples = math.ceil(len(optics.u) * max(wide) / max(own))
    return PupilPSF.from_zernike(
        pupil_psf.modes,
        wavelength=optics.wavelength,
        pupil_radius=optics.pupil_radius,
        image_distance=optics.image_distance,
        pitch=optics.pitch,
        shape=wide,
        method=optics.method,  # type: ignore[arg-type]
        samples=samples,
        pixel_integrated=optics.pixel_integrated,
        device=optics.device,
        dtype=optics.dtype,
    )
