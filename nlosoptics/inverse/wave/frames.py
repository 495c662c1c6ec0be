"""Images of one object via an unknown wall, prepared for a fit of object and wall."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data.arrays import real_array
from ..data.measurement import measured
from ..data.noisy_image import NoisyImage, noisy_image
from .pupil_psf import PupilPSF, check_defocus
from .pupil_waves import ZernikeWaves

Array = NDArray[np.float64]


@contextmanager
def fitting() -> Iterator[None]:
    """Record gradients, even if the caller has disabled them, and run torch on one thread.

    Images of 512 x 512 gain nothing from a second thread, and on a busy machine OpenMP's spinning
    barriers make each transform tens of times slower (0.5 s became 38 s). One thread also gives the
    same bits on every machine.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode(False), torch.enable_grad():
            yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True, eq=False, kw_only=True)
class Frames:
    """Checked images of one object, for K images of (H, W) pixels.

    ``measured``: the images with their noise. ``images`` (K, H, W): images minus their known
    background, divided by ``scale``, float64. ``sigmas`` (K,): reference noise of each image in
    this unit. ``scale``: largest range of an image, image units. ``defocus`` (K,): known additional
    defocus, m rms.
    """

    measured: tuple[NoisyImage, ...]
    images: Array
    sigmas: Array
    scale: float
    defocus: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of an image."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def counted(self) -> Array:
        """Number of pixels with finite noise in each image, (K,)."""
        return np.array([float(one.counted) for one in self.measured])

    def picture(self, name: str, value: Any) -> Array | None:
        """Return an optional non-negative image (H, W) given by the user, checked."""
        if value is None:
            return None
        picture = real_array(name, value)
        if picture.shape != self.shape:
            raise SamplingError(
                f"{name} has shape {picture.shape}, must be {self.shape} like the images"
            )
        if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() <= 0.0:
            raise SceneError(
                f"{name} spans {picture.min():g} to {picture.max():g}, must be finite and "
                "non-negative with some light; leave it out if it is unknown"
            )
        return picture


def frames_of(images: Any, pupil_psf: PupilPSF, *, defocus: Any = None) -> Frames:
    """Check images and the information about them; the arguments are those of `evidence_fit`."""
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
    each = measured(images).each()
    count, shape = len(each), tuple(each[0].image.shape)
    own = pupil_psf.shape
    if own[0] < shape[0] or own[1] < shape[1]:
        raise SamplingError(
            f"pupil_psf has shape {own} and the images {shape}; give a point spread of the "
            "images' shape or larger"
        )
    model = ForwardModel(_sharpest(pupil_psf, shape), shape=shape)
    checked = tuple(noisy_image(one, model) for one in each)
    for number, one in enumerate(checked):
        if one.sigma == 0.0:
            raise SceneError(f"the estimated noise of image {number} is 0; give noise_sigma")
    scale = max(float(one.data.max() - one.data.min()) for one in checked)
    if not scale > 0.0:
        scale = max(one.sigma for one in checked)
    return Frames(
        measured=checked,
        images=np.stack([one.data / scale for one in checked]),
        sigmas=np.array([one.sigma for one in checked]) / scale,
        scale=scale,
        defocus=known_defoci(defocus, count),
    )


def _sharpest(pupil_psf: PupilPSF, shape: tuple[int, int]) -> Array:
    """Return the point spread without aberration, (H, W): no wall passes more of any frequency."""
    with torch.no_grad():
        turns = torch.zeros(pupil_psf.optics.share.shape).to(pupil_psf.coefficients)
        spread = pupil_psf.optics.point_spread(turns).double().cpu().numpy()
    first = [own // 2 - side // 2 for own, side in zip(spread.shape, shape, strict=True)]
    return spread[first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]


def known_defoci(defocus: Any, count: int) -> Array:
    """Return the known additional defocus of each image, (K,) float64, m rms; 0 by default."""
    values = np.zeros(count) if defocus is None else real_array("defocus", defocus)
    if values.shape != (count,):
        raise SamplingError(
            f"defocus has shape {values.shape}, must be ({count},); give one value per image"
        )
    check_defocus(values)
    return values
