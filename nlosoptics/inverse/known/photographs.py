"""Photographs, parts of a larger view: what is beyond the frame, and a smooth veil."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ...errors import SamplingError
from ...imaging import CameraImage, ForwardModel
from ..data.arrays import check_finite, real_array
from ..data.driver import reconstructed
from ..data.measurement import Measurement, measured
from ..data.models import beyond_optics, expected_signal, passed_power, periodic_power, power
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction

Array = NDArray[np.float64]
Fit = Callable[[NoisyImage, ForwardModel], dict[str, Any]]


def fitted(fit: Fit, image: Any, model: Any) -> Reconstruction:
    """Return what a fit finds in an image: a photograph, if the model is a point spread alone.

    A point spread is a `PointSpread`, an object that holds one, or an array.
    """
    point_spread = getattr(model, "point_spread", model)
    if hasattr(point_spread, "intensity") or isinstance(model, (np.ndarray, list)):
        return photograph(fit, image, point_spread)
    return reconstructed(lambda data: fit(data, model), image, model)


def photograph(fit: Fit, image: Any, point_spread: Any) -> Reconstruction:
    """Return what a fit finds in a photograph, grey or in colour, with its veil apart.

    ``fit`` gets a larger, periodic frame with margins half as wide as the point spread, whose
    pixels do not count, and returns the arguments of `concluded`. Noise and bad pixels are those of
    the photograph alone.
    """
    if isinstance(image, CameraImage):
        image = Measurement(image.values, masked=image.masked, saturated=image.saturated)
    given = replace(measured(image), image=real_array("image", measured(image).image))
    shape = given.image.shape
    if len(shape) == 2:
        return _sharpened(fit, given, point_spread)
    if len(shape) != 3 or shape[2] != 3:
        raise SamplingError(f"image has shape {shape}, must be (H, W) or (H, W, 3); give one image")
    colours = []
    for k in range(3):
        parts = {f.name: getattr(given, f.name) for f in fields(given)}
        parts = {name: v[..., k] for name, v in parts.items() if np.ndim(v) == 3}
        colours.append(_sharpened(fit, replace(given, **parts), point_spread))
    return _joined(colours, given.gain)


def _joined(colours: list[Reconstruction], gain: float | None) -> Reconstruction:
    """Return one answer for three colours: the numbers are those of the one that fits worst."""
    gains = [colour.physical_parameters["gain"] for colour in colours]
    gain = gain or max(gains)
    worst = max(colours, key=lambda colour: (colour.status != "converged", colour.score))
    parameters = {**worst.physical_parameters, "gain": gain}
    for name in {name for colour in colours for name in colour.physical_parameters}:
        maps = [np.asarray(colour.physical_parameters.get(name, 0)) for colour in colours]
        if any(values.ndim == 2 for values in maps):
            if name == "object_error":
                maps = [values * (own / gain) for values, own in zip(maps, gains, strict=True)]
            parameters[name] = np.stack(np.broadcast_arrays(*maps), axis=-1)
    objects = [colour.object * (own / gain) for colour, own in zip(colours, gains, strict=True)]
    seconds = sum(colour.seconds for colour in colours)
    return replace(
        worst, object=np.stack(objects, -1), physical_parameters=parameters, seconds=seconds
    )


def _sharpened(fit: Fit, given: Measurement, point_spread: Any) -> Reconstruction:
    """Return what a fit finds in one colour (H, W)."""
    values = given.image
    kernel = _trimmed(getattr(point_spread, "intensity", point_spread))
    if kernel.shape[0] > values.shape[0] or kernel.shape[1] > values.shape[1]:
        raise SamplingError(
            f"the point spread has {kernel.shape[1]} x {kernel.shape[0]} pixels, the image "
            f"{values.shape[1]} x {values.shape[0]}; crop the point spread, or use a larger image"
        )
    shape, widths = [], []  # widths of the margins along each axis, before and after
    for side, length in zip(values.shape, kernel.shape, strict=True):
        arm = length // 2
        shape.append(scipy.fft.next_fast_len(side + 2 * arm, real=True))
        widths.append((arm, shape[-1] - side - arm))
    inside = tuple(
        np.s_[before : before + n] for n, (before, _) in zip(values.shape, widths, strict=True)
    )
    wide = ForwardModel(kernel, shape=(shape[0], shape[1]), boundary="circular")
    narrow = ForwardModel(kernel, shape=values.shape)

    def solve(data: NoisyImage) -> dict[str, Any]:
        data = _continued(_with_white_noise(data, passed_power(narrow)), widths)
        data = replace(data, fit_background=given.background_shape is not None)
        return {"data": data, "model": wide, **fit(data, wide)}

    result = reconstructed(solve, replace(given, gain=1.0), narrow)
    level, parameters = result.object, dict(result.physical_parameters)
    if level.shape == wide.shape:  # an object was detected
        level = level[inside]
        maps = {name: v[inside] for name, v in parameters.items() if np.shape(v) == wide.shape}
        sigma = parameters["noise_sigma"] * math.sqrt(values.size / math.prod(wide.shape))
        parameters |= {**maps, "noise_sigma": sigma}
    veil = _veil(level) if given.background_shape is None else None
    if veil is not None:
        level, parameters["veil"] = np.maximum(level - veil, 0.0), veil
    gain = given.gain or float(level.max()) or 1.0
    if "object_error" in parameters:
        parameters["object_error"] = parameters["object_error"] / gain
    parameters["gain"] = gain
    return replace(result, object=level / gain, physical_parameters=parameters)


def _with_white_noise(data: NoisyImage, passed: Array) -> NoisyImage:
    """Return an image whose noise is white, with random numbers where it has hardly any.

    Demosaicing and JPEG remove the noise of high frequencies, beyond the optics' cut-off, where it
    is measured. The lowest quarter of those frequencies has the noise of the detail; the others are
    filled up to it, which hides nothing, if they have less by a third.
    """
    image, shape, variance = data.data, data.data.shape, data.sigma**2
    window = np.multiply.outer(*(np.hanning(length + 2)[1:-1] for length in shape))
    middle = (image - np.average(image, weights=window)) * window
    spectrum, whole = power(middle) / np.mean(window**2), periodic_power(image)
    radius = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    lack = np.zeros_like(spectrum)
    for _ in range(2):  # more noise hides more frequencies
        beyond = beyond_optics(expected_signal(whole, passed, variance, shape), variance)
        order = np.argsort(radius[beyond])
        if len(order) < 64:  # 8 a band: 35 %
            break
        bands = np.array_split(order, 8)
        levels = np.array([spectrum[beyond][band].mean() for band in bands])
        centres = np.array([radius[beyond][band].mean() for band in bands])
        level = float(levels[:2].mean())
        if level < max(1.5 * levels.min(), variance):
            break
        variance = level
        rest = level - np.interp(radius, centres, levels)
        lack = np.where(beyond, np.maximum(rest, 0.0), 0.0)
    noise = scipy.fft.rfft2(np.random.default_rng(0).normal(size=shape)) * np.sqrt(lack)
    return replace(data, data=image + scipy.fft.irfft2(noise, shape), sigma=math.sqrt(variance))


def _continued(data: NoisyImage, widths: list[tuple[int, int]]) -> NoisyImage:
    """Return an image with margins that do not count; those around the others get more weight."""

    def padded(values: Any, **how: Any) -> Any:
        return None if values is None else np.pad(values, widths, **how)

    weights = padded(data.weights)
    more = weights.size / data.data.size
    return replace(
        data,
        data=padded(data.data, constant_values=np.average(data.data, weights=data.weights)),
        sigma=data.sigma * math.sqrt(more),
        weights=weights * more,
        background_shape=padded(data.background_shape, mode="edge"),
        bad_pixels=padded(data.bad_pixels),
        saturated=padded(data.saturated),
        least=padded(data.least, constant_values=-np.inf),
    )


def _trimmed(point_spread: Any) -> Array:
    """Return a point spread of sum 1 without the rim that holds less than a thousandth of it."""
    kernel = real_array("point spread", point_spread)
    if kernel.ndim != 2 or kernel.size == 0:
        raise SamplingError(f"point spread has shape {kernel.shape}, must be (ky, kx); give one")
    check_finite("point spread", kernel, "replace them by their neighbours")
    total = float(kernel.sum())
    if not total > 0.0:
        raise SamplingError(f"point spread has the sum {total:g}, must be positive; give its light")
    rows, columns = (length // 2 for length in kernel.shape)
    light = np.abs(kernel)
    for rim in range(min(rows, columns), 0, -1):
        inside = light[rim : len(light) - rim, rim : light.shape[1] - rim]
        if inside.sum() >= 0.999 * light.sum():
            kernel = kernel[rim : len(kernel) - rim, rim : kernel.shape[1] - rim]
            break
    return np.asarray(kernel / kernel.sum())


def _veil(level: Array) -> Array | None:
    """Return a smooth veil of a picture, image units; None if it has none.

    The polynomial is that which leaves the least total variation, whose mean is the objective of
    the solver, by reweighted least squares. It is a veil if it takes more than 1 % of the total.
    """
    order, least = 4, 0.99
    y, x = (np.linspace(-1.0, 1.0, length) for length in level.shape)
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i) if i + j > 0]
    terms = np.stack([np.multiply.outer(y**i, x**j) for i, j in powers])

    def gradients(picture: Array) -> Array:  # (2, ..., n)
        parts = np.diff(picture, axis=-2)[..., :-1], np.diff(picture, axis=-1)[..., :-1, :]
        return np.stack([part.reshape(*part.shape[:-2], -1) for part in parts])

    slopes, steps = gradients(level), gradients(terms)
    whole = np.hypot(*slopes).sum()
    if min(level.shape) < 2 * order or whole == 0.0:
        return None
    smallest, rest = 1e-2 * np.hypot(*slopes).mean(), slopes
    for _ in range(30):
        weights = 1.0 / np.sqrt((rest**2).sum(0) + smallest**2)
        normal = np.einsum("kin,n,kjn->ij", steps, weights, steps, optimize=True)
        values = np.linalg.solve(normal, np.einsum("kin,n,kn->i", steps, weights, slopes))
        rest = slopes - np.einsum("i,kin->kn", values, steps)
    veil = np.tensordot(values, terms, 1)
    veil = np.maximum(veil + np.quantile(level - veil, 0.01), 0.0)  # a veil is light
    return veil if np.hypot(*gradients(level - veil)).sum() <= least * whole else None
