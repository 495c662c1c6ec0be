"""Image models, and power spectra of images: at the frequencies of a frame, and what optics pass.

Half spectra, (H, W//2 + 1), as ``rfft2`` of an image (H, W) returns them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..._checks import counted
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from .arrays import half_spectrum_weights

Array = NDArray[np.float64]


def model_shape(model: Any) -> tuple[int, int]:
    """Return the shape (H, W) of an image model; raise for any other object."""
    if not isinstance(model, ForwardModel):
        raise SceneError(
            f"model of type {type(model).__name__} is not an image model; "
            "give an imaging.ForwardModel(point_spread, shape=image.shape)"
        )
    return model.shape


def one_kernel_shape(model: Any) -> tuple[int, int]:
    """Return the shape (H, W) of a model; raise if its point spread varies over the field."""
    shape = model_shape(model)
    if model.weights is not None:
        raise SamplingError(
            "the model's point spread varies over the field "
            f"({counted(len(model.weights), 'mode')}), but this solver needs a single one; "
            "give a model of one PointSpread"
        )
    return shape


def mean_transfer(model: ForwardModel) -> NDArray[np.complex128]:
    """Return the ``rfft2`` of a model's kernel averaged over the frame, on the model's grid.

    It is a single transfer function, (rows, columns//2 + 1), also for a field of point spreads.
    """
    if model.weights is None:
        return model.transfer
    return np.tensordot(model.weights.mean((-2, -1)), model.transfer, 1)


def widened(model: ForwardModel, factor: float = math.sqrt(2.0)) -> ForwardModel:
    """Return the image model of a point spread that is ``factor`` > 1 times as wide.

    The kernel is interpolated linearly on the model's grid. The mean transfer function keeps its
    largest modulus.
    """
    kernel = np.fft.fftshift(scipy.fft.irfft2(model.transfer, model.grid), axes=(-2, -1))
    for axis in (-2, -1):
        middle = kernel.shape[axis] // 2
        at = middle + (np.arange(kernel.shape[axis]) - middle) / factor
        low = at.astype(np.intp)
        part = (at - low).reshape(-1, *(1,) * (-1 - axis))
        lower, upper = (np.take(kernel, low + step, axis) for step in (0, 1))
        kernel = (1.0 - part) * lower + part * upper
    twin = ForwardModel.__new__(ForwardModel)
    transfer = scipy.fft.rfft2(np.fft.ifftshift(kernel, axes=(-2, -1)))
    for name, value in {**vars(model), "kernel": kernel, "transfer": transfer}.items():
        object.__setattr__(twin, name, value)
    scale = abs(mean_transfer(model)).max() / abs(mean_transfer(twin)).max()
    kernel *= scale
    transfer *= scale
    return twin


def passed_power(model: ForwardModel) -> Array:
    """Return the squared modulus of the transfer function at the frequencies of the frame.

    For a field it is the mean over the object, so that different speckle in each part of the object
    does not cancel: with weights w_i and transfer functions T_i, it is the sum over i and j of
    ``mean(w_i w_j) T_i T_j*``.
    """
    if model.weights is None:
        return squared(frame_transfer(model.transfer, model))
    flat = model.weights.reshape(len(model.weights), -1)
    values, vectors = np.linalg.eigh(flat @ flat.T / flat.shape[1])
    each = np.stack([frame_transfer(part, model) for part in model.transfer])
    parts = zip(values, np.tensordot(vectors.T, each, 1), strict=True)
    return np.asarray(sum(max(float(value), 0.0) * squared(part) for value, part in parts))


def frame_transfer(transfer: NDArray[np.complex128], model: ForwardModel) -> NDArray[np.complex128]:
    """Return a transfer function on a model's grid, at the frequencies of its frame."""
    kernel = scipy.fft.irfft2(transfer, model.grid)
    for axis, (side, length) in enumerate(zip(model.grid, model.shape, strict=True)):
        # Offsets of at least the frame's length are negative ones.
        offsets = np.arange(side)
        offsets = np.where(offsets < length, offsets, offsets - side) % length
        wrapped = np.zeros((length, kernel.shape[1 - axis]))
        np.add.at(wrapped, offsets, np.moveaxis(kernel, axis, 0))
        kernel = np.moveaxis(wrapped, 0, axis)
    return np.asarray(scipy.fft.rfft2(kernel))


def half_weights(shape: tuple[int, ...]) -> Array:
    """Return how often each frequency of a half spectrum counts; the mean does not count."""
    rows, columns = shape
    twice = np.tile(half_spectrum_weights(columns), (rows, 1))
    twice[0, 0] = 0.0
    return twice


def power(image: Array) -> Array:
    """Return the power of each frequency of an image; for white noise its variance, on average."""
    return squared(scipy.fft.rfft2(image)) / image.size


def periodic_power(image: Array) -> Array:
    """Return the `power` of an image without the jumps between opposite edges of its frame."""
    return squared(periodic_spectrum(image)) / image.size


def periodic_spectrum(image: Array, along: int = 1) -> NDArray[np.complex128]:
    """Return the ``rfft2`` of an image without the jumps between opposite edges of its frame.

    Each jump is the median of ``along`` ones along the edge.

    The smooth image whose second differences cancel those of the jumps is subtracted (Moisan,
    J. Math. Imaging Vis. 39 (2011) 161).
    """
    rows, columns = image.shape
    down, across = image[-1] - image[0], image[:, -1] - image[:, 0]
    if along > 1:
        down, across = (
            np.median(sliding_window_view(np.pad(jump, along // 2, "wrap"), along), axis=1)
            for jump in (down, across)
        )
    jumps = np.zeros_like(image)
    jumps[0] += down
    jumps[-1] -= down
    jumps[:, 0] += across
    jumps[:, -1] -= across
    y, x = _angles(rows, columns)
    curvature = 2.0 * (np.cos(y) + np.cos(x)) - 4.0
    curvature[0, 0] = 1.0
    smooth = scipy.fft.rfft2(jumps) / curvature
    smooth[0, 0] = 0.0
    return np.asarray(scipy.fft.rfft2(image) - smooth)


def noise_share(shape: tuple[int, ...]) -> Array:
    """Return the expected `periodic_power` of white noise of variance 1.

    Above the lowest frequencies it is about 1 - 2/N in a frame of N x N pixels: the noise of the
    edges is taken for jumps. The noise that the four corners share is left out, a part of 1/N^2.
    """
    rows, columns = shape
    y, x = _angles(rows, columns)
    down, across = 2.0 - 2.0 * np.cos(y), 2.0 - 2.0 * np.cos(x)
    both = down + across
    both[0, 0] = 1.0  # the mean keeps its power
    jumps = down / rows + across / columns
    return 1.0 - 2.0 * jumps / both + 2.0 * jumps / both**2


def object_power(shape: tuple[int, ...]) -> Array:
    """Return the power spectrum 1/(f^2 + f_0^2) of an object, f_0 one cycle per frame; mean 0."""
    y, x = _angles(*shape)
    spectrum = 1.0 / (y**2 + x**2 + (2.0 * math.pi / max(shape)) ** 2)
    spectrum[0, 0] = 0.0
    return spectrum


def expected_signal(
    image_power: Array,
    passed: Array | float,
    variance: float,
    shape: tuple[int, ...],
) -> Array:
    """Return the power of the image of an object with spectrum `object_power`.

    ``image_power`` (H, W//2 + 1): power of the image, from `periodic_power`. Its excess over the
    noise is the object's. ``passed`` (H, W//2 + 1): squared modulus of the transfer function.
    ``variance``: variance of the noise, image units squared. ``shape`` (int, int): rows H and
    columns W of the image.
    """
    twice = half_weights(shape)
    signal = passed * object_power(shape)
    excess = float((twice * (image_power - variance)).sum())
    return signal * (max(excess, 0.0) / max(float((twice * signal).sum()), 1e-300))


def beyond_optics(signal: Array, variance: float) -> NDArray[np.bool_]:
    """Return the mask of frequencies at which the `expected_signal` is below 5 % of the noise."""
    return signal < 0.05 * variance


def squared(spectrum: NDArray[Any]) -> Array:
    """Return the squared modulus of a spectrum."""
    return np.asarray(spectrum.real**2 + spectrum.imag**2)


def _angles(rows: int, columns: int) -> tuple[Array, Array]:
    """Return the angular frequencies of a half spectrum, radians per pixel, as column and row."""
    y = np.array(2.0 * math.pi * np.fft.fftfreq(rows))[:, None]
    x = np.array(2.0 * math.pi * np.fft.rfftfreq(columns))[None]
    return y, x
