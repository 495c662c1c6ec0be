"""Photographs, parts of a larger view: what is beyond the frame, and a smooth veil."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from ...errors import SamplingError
from ...imaging import CameraImage, ForwardModel
from ..data.arrays import as_numpy, check_finite, real_array, shape_of
from ..data.measurement import Measurement, measured
from ..data.reconstruction import Reconstruction

Array = NDArray[np.float64]


def is_kernel(model: Any) -> bool:
    """Return whether a model is a point spread alone: a `PointSpread` or an array."""
    return hasattr(model, "intensity") or isinstance(model, (np.ndarray, list))


def photograph(
    solver: Callable[..., Reconstruction], image: Any, point_spread: Any, start: Any
) -> Reconstruction:
    """Return what a solver finds in a photograph, and separate a veil from it.

    The solver gets a larger, periodic frame whose margins, half as wide as the point spread, are
    masked.
    """
    if isinstance(image, CameraImage):
        image = Measurement(image.values, masked=image.masked, saturated=image.saturated)
    given = measured(image)
    values = real_array("image", given.image)
    if values.ndim != 2:
        raise SamplingError(f"image has shape {values.shape}, must be (H, W); give one channel")
    rows, columns = values.shape
    kernel = _trimmed(getattr(point_spread, "intensity", point_spread))
    if kernel.shape[0] > rows or kernel.shape[1] > columns:
        raise SamplingError(
            f"the point spread has {kernel.shape[1]} x {kernel.shape[0]} pixels, the image "
            f"{columns} x {rows}; crop the point spread, or use a larger image"
        )
    shape: list[int] = []
    widths = []  # of the margins along each axis, before and after
    for side, length in zip(values.shape, kernel.shape, strict=True):
        shape.append(scipy.fft.next_fast_len(side + 2 * (length // 2), real=True))
        widths.append((length // 2, shape[-1] - side - length // 2))
    frame = tuple(
        slice(before, side - after) for side, (before, after) in zip(shape, widths, strict=True)
    )

    def padded(name: str, value: Any, **how: Any) -> Any:
        is_picture = len(shape_of(name, value)) == 2
        return np.pad(as_numpy(value), widths, **how) if is_picture else value

    masked = np.zeros(values.shape, dtype=bool) if given.masked is None else as_numpy(given.masked)
    result = solver(
        replace(
            given,
            image=padded("image", values, mode="edge"),
            masked=padded("masked", masked, constant_values=True),
            noise_sigma=padded("noise_sigma", given.noise_sigma, mode="edge"),
            saturated=padded("saturated", given.saturated, constant_values=False),
            background=padded("background", given.background, mode="edge"),
            background_shape=padded("background_shape", given.background_shape, mode="edge"),
            fit_background=given.background_shape is not None,
            gain=1.0,
        ),
        ForwardModel(kernel, shape=(shape[0], shape[1]), boundary="circular"),
        start=padded("start", start, mode="edge") if isinstance(start, np.ndarray) else start,
    )
    level = result.object[frame]
    parameters = {
        name: value[frame] if np.shape(value) == tuple(shape) else value
        for name, value in result.physical_parameters.items()
    }
    veil = _veil(level) if given.background_shape is None else None
    if veil is not None:
        level, parameters["veil"] = np.maximum(level - veil, 0.0), veil
    gain = given.gain or float(level.max()) or 1.0
    if "object_error" in parameters:
        parameters["object_error"] = parameters["object_error"] / gain
    parameters["gain"] = gain
    return replace(result, object=level / gain, physical_parameters=parameters)


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
    return kernel / kernel.sum()


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
    if np.hypot(*rest).sum() > least * whole:
        return None
    veil = np.tensordot(values, terms, 1)
    return np.asarray(veil + np.quantile(level - veil, 0.01))
