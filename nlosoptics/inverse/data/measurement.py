"""Camera images with all that is known of their noise and background, the input of every solver."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..._checks import counted, positive
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from .arrays import as_numpy, is_tensor, shape_of


@dataclass(frozen=True, eq=False)
class Measurement(Noun):
    """One or several camera images of an object, with their noise and background.

    Every solver takes a measurement in place of an array. An array or a tensor alone stands for a
    measurement with the defaults below.

    Parameters
    ----------
    image : ndarray or Tensor
        Camera image, (H, W), or K images, (K, H, W), in any unit, which is called the image unit.
    noise_sigma : float, array_like or None
        Standard deviation of the noise, image units: one number, (H, W), or for several images (K,)
        or (K, H, W). It gives the shape of the noise; its scale is measured in the image, see
        Notes. Pixels of infinite noise are ignored. None: uniform noise.
    masked : array_like of bool or None
        Pixels to ignore, for example dead ones: (H, W), or (K, H, W) for several images. Their
        values may be NaN.
    saturated : array_like of bool or None
        Pixels that the camera has read as full, (H, W), or (K, H, W) for several images: without
        saturation they would be at least as bright as they are in ``image``. `tv_deconvolve` uses
        these lower limits, also of pixels that are ``masked``; the other solvers ignore the pixels.
        None: unknown; solvers with a known point spread search for saturated pixels.
    background : float or array_like
        Known background, image units: one number, (H, W), (K,) or (K, H, W).
    fit_background : bool
        Whether each image has an additional background of unknown strength.
    background_shape : array_like or None
        Distribution of the additional background over the image, (H, W), non-negative, in any unit.
        None: it is uniform.
    gain : float or None
        Image units per unit of the object, if known. None: the object is scaled to a maximum of 1.

    Raises
    ------
    SamplingError
        If images or values of one argument differ in shape.
    SceneError
        If ``gain`` is not positive, or ``masked`` or ``saturated`` is not boolean. Solvers raise
        errors for arrays that do not have the shape of their image model, and for values that are
        not finite.

    See Also
    --------
    estimate_noise : Noise of an image from its pixels.
    nlosoptics.imaging.camera_image : Read camera files, with their masked pixels.

    Notes
    -----
    The scale of the noise follows from the image as in `estimate_noise`, since a stated value that
    is wrong by some per cent would spoil a deconvolution. If the optics pass most frequencies, the
    detail of the object may add to this estimate, and a smaller ``noise_sigma`` is used as it is.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import ForwardModel
    >>> from nlosoptics.inverse import Measurement, tv_deconvolve
    >>> model = ForwardModel(np.full((3, 3), 1.0 / 9.0), shape=(32, 32))
    >>> object_ = np.zeros((32, 32))
    >>> object_[10:20, 12:18] = 1.0
    >>> image = model.forward(object_) + np.random.default_rng(1).normal(0.0, 0.01, (32, 32))
    >>> dead = np.zeros((32, 32), dtype=bool)
    >>> dead[15, 15] = True
    >>> image[dead] = np.nan
    >>> found = tv_deconvolve(Measurement(image, noise_sigma=0.01, masked=dead), model)
    >>> bool(abs(found.object - object_)[15, 15] < 0.05)
    True
    """

    image: Any
    noise_sigma: Any = field(default=None, kw_only=True)
    masked: Any = field(default=None, kw_only=True)
    saturated: Any = field(default=None, kw_only=True)
    background: Any = field(default=0.0, kw_only=True)
    fit_background: bool = field(default=True, kw_only=True)
    background_shape: Any = field(default=None, kw_only=True)
    gain: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.gain is not None:
            positive("gain", self.gain)
        for name, meaning in (("masked", "pixels to ignore"), ("saturated", "full pixels")):
            mask = getattr(self, name)
            shape_of(name, mask)  # refuses rows of different length
            if mask is not None and as_numpy(mask).dtype != bool:
                raise SceneError(
                    f"{name} has values of type {as_numpy(mask).dtype}, must be boolean, True for "
                    f"{meaning}"
                )

    def each(self) -> list[Measurement]:
        """Return the images one by one, (H, W), each with its own noise and background."""
        stack = _stack(self.image)
        names = ("noise_sigma", "masked", "saturated", "background")
        given = {name: _per_image(name, getattr(self, name), len(stack)) for name in names}
        return [
            replace(self, image=image, **{name: given[name][i] for name in names})
            for i, image in enumerate(stack)
        ]


def measured(image: Any) -> Measurement:
    """Return a measurement as it is, and an image as a measurement with the defaults.

    Of a `nlosoptics.imaging.SpeckleImage` the image is its electrons.
    """
    return (
        image if isinstance(image, Measurement) else Measurement(getattr(image, "electrons", image))
    )


def _stack(images: Any) -> Any:
    try:
        stack = images if is_tensor(images) else np.asarray(images)
    except ValueError:
        raise SamplingError("images differ in shape; give one array (K, H, W)") from None
    if stack.ndim == 2:
        stack = stack[None]
    if stack.ndim != 3 or 0 in stack.shape:
        raise SamplingError(f"images have shape {tuple(stack.shape)}, must be (K, H, W) or (H, W)")
    if stack.shape[2] in (3, 4) and min(stack.shape[:2]) > 4:
        raise SamplingError(
            f"images have shape {tuple(stack.shape)}, which looks like a colour picture, must be "
            "(K, H, W) or (H, W); give the channel of the laser"
        )
    return stack


def _per_image(name: str, value: Any, count: int) -> list[Any]:
    """Return one value for each of ``count`` images.

    ``value`` is common to all, a number or (H, W), or has one entry per image, (K,) or (K, H, W).
    """
    if len(shape_of(name, value)) in (0, 2):
        return [value] * count
    if len(value) != count:
        raise SamplingError(
            f"{name} has {counted(len(value), 'value')} for {counted(count, 'image')}; give one "
            "for each"
        )
    return list(value)
