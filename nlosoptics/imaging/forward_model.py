"""Linear image model: an object convolved with one point spread, or with a field of them."""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass, field
from typing import Any, Literal

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory, one_of, positive, shown, whole
from .._nouns import Noun
from ..errors import SamplingError
from ..psf import PointSpreadField

Array = NDArray[np.float64]
Boundary = Literal["padded", "circular"]


@dataclass(frozen=True, eq=False)
class ForwardModel(Noun):
    """Linear image model: convolution of an object with a point spread function, and its adjoint.

    Object and image share the same pixels: ``image[i] = sum_j kernel[centre + i - j] object[j]``,
    where i and j are pixels. If the point spread varies over the object, it is given as a
    `nlosoptics.psf.PointSpreadField`. The kernel then depends on the object pixel j: it is a sum of
    a few fixed modes, with a weight for each mode and pixel.

    Parameters
    ----------
    point_spread : PointSpread, PointSpreadField or array_like
        Kernel of the convolution, (ky, kx), energy per pixel, with its centre at
        ``[ky//2, kx//2]``. It is used as it is, without normalisation. A field costs one
        convolution per mode.
    shape : (int, int)
        Rows H and columns W of object and image.
    boundary : {"padded", "circular"}
        What surrounds the object. "padded": darkness, and light that is spread beyond the frame is
        lost. "circular": periodic copies of the object.
    at : (array_like, array_like), optional
        Only for a field: which point of the hidden object each pixel shows. Two arrays (H, W) with
        coordinates along the object's width and height, -1 at its left and lower edges, 1 at its
        right and upper edges. None: the frame covers the object exactly, with row 0 at its lower
        edge.

    Attributes
    ----------
    kernel : ndarray, (ky, kx) or (K, ky, kx)
        Kernel, or the K modes of a field; float64, read-only.
    weights : ndarray, (K, H, W), or None
        Weight of each mode of a field at each object pixel, read-only; None for a single kernel.
    pitch : float or None
        Pixel pitch of the point spread, m; None for a plain array.
    grid : (int, int)
        Rows and columns of the grid of the Fourier transforms. Object and image occupy its first H
        x W samples.
    transfer : ndarray, (rows, columns//2 + 1) or (K, rows, columns//2 + 1)
        Fourier transform of the kernel, or of each mode, by ``rfft2`` on ``grid``, with the
        kernel's centre at sample [0, 0]; complex128, read-only.

    Raises
    ------
    SamplingError
        If the kernel is not finite, is zero everywhere, or is larger than a circular frame, or if
        the arrays in ``at`` do not have the given shape.
    SceneError
        If ``shape``, ``boundary`` or the pitch is out of range.
    MemoryLimitError
        If the FFT grid would not fit in memory.

    See Also
    --------
    nlosoptics.inverse.SceneModel : Differentiable image of a scene, in torch.
    nlosoptics.psf.scene_point_spread : Wave and PSF of a scene.
    nlosoptics.psf.point_spread_field : PSFs over the hidden object.

    Notes
    -----
    The convolution is computed by fast Fourier transforms. With "padded", the grid exceeds the
    frame along each axis by at least the larger of the two distances from the centre of the kernel
    to its ends. Light that wraps around then falls outside the frame and is cropped. Kernel samples
    farther from the centre than the frame is wide have no effect and are dropped. The transforms
    run on one thread, so that results do not depend on the number of threads.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import ForwardModel
    >>> model = ForwardModel(np.array([[0.25, 0.5, 0.25]]), shape=(1, 4))
    >>> model.forward(np.array([[0.0, 1.0, 2.0, 0.0]])).round(6)
    array([[0.25, 1.  , 1.25, 0.5 ]])
    """

    point_spread: InitVar[Any]
    shape: tuple[int, int] = field(kw_only=True)
    boundary: Boundary = field(default="padded", kw_only=True)
    at: InitVar[tuple[ArrayLike, ArrayLike] | None] = field(default=None, kw_only=True)
    kernel: Array = field(init=False, repr=False)
    weights: Array | None = field(init=False, repr=False)
    pitch: float | None = field(init=False)
    grid: tuple[int, int] = field(init=False)
    transfer: NDArray[np.complex128] = field(init=False, repr=False)

    def __post_init__(self, point_spread: Any, at: tuple[ArrayLike, ArrayLike] | None) -> None:
        shape = _frame_shape(self.shape)
        one_of("boundary", self.boundary, ("padded", "circular"))
        if isinstance(point_spread, PointSpreadField):
            weights = _weights(point_spread, shape, at)
            modes = [_finite_kernel(mode) for mode in point_spread.modes]
        else:
            if at is not None:
                raise SamplingError(
                    "at is given, but the point spread is not a field; leave at out"
                )
            weights = None
            modes = [_finite_kernel(getattr(point_spread, "intensity", point_spread))]
        kernel = modes[0]
        pitch = getattr(point_spread, "pitch", None)
        if pitch is not None:
            pitch = positive("point_spread.pitch", pitch, unit="m")
        if self.boundary == "circular":
            if kernel.shape[0] > shape[0] or kernel.shape[1] > shape[1]:
                raise SamplingError(
                    f"kernel of {kernel.shape} pixels is larger than the circular frame {shape}; "
                    "crop the kernel or use boundary='padded'"
                )
            grid = shape
        else:
            grid = padded_grid(kernel.shape, shape)
        fits_memory(
            f"forward model of {shape[0]} x {shape[1]} pixels on a {grid[0]} x {grid[1]} grid",
            40.0 * len(modes) * math.prod(grid),
            "bin the pixels or cut out a region",
        )
        transfer = np.stack([scipy.fft.rfft2(_on_grid(mode, shape, grid)) for mode in modes])
        if weights is None:
            transfer = transfer[0]
        else:
            kernel = np.stack(modes)
            weights.flags.writeable = False
        kernel.flags.writeable = False
        transfer.flags.writeable = False
        for name, value in (
            ("shape", shape),
            ("kernel", kernel),
            ("weights", weights),
            ("pitch", pitch),
            ("grid", grid),
            ("transfer", transfer),
        ):
            object.__setattr__(self, name, value)

    def forward(self, object_image: ArrayLike) -> Array:
        """Compute the image of an object.

        Parameters
        ----------
        object_image : array_like, (..., H, W)
            Object, in any unit; (H, W) is the model's shape.

        Returns
        -------
        ndarray, (..., H, W)
            Image, float64, in the unit of the object times that of the kernel.
        """
        picture = self._checked("object_image", object_image)
        if self.weights is None:
            return self._filter(picture, self.transfer)
        parts = zip(self.weights, self.transfer, strict=True)
        spectrum = sum(scipy.fft.rfft2(w * picture, self.grid) * t for w, t in parts)
        return self._frame(spectrum)

    def adjoint(self, image: ArrayLike) -> Array:
        """Apply the transpose of `forward` to an image, as gradients of a fit need it.

        Parameters
        ----------
        image : array_like, (..., H, W)
            Image; (H, W) is the model's shape.

        Returns
        -------
        ndarray, (..., H, W)
            Correlation of the image with the kernel, float64.
        """
        picture = self._checked("image", image)
        if self.weights is None:
            return self._filter(picture, np.conj(self.transfer))
        spectrum, total = scipy.fft.rfft2(picture, self.grid), np.zeros(picture.shape)
        for w, t in zip(self.weights, self.transfer, strict=True):
            total += w * self._frame(spectrum * np.conj(t))
        return total

    def _checked(self, name: str, value: ArrayLike) -> Array:
        picture = np.asarray(value, dtype=np.float64)
        if picture.shape[-2:] != self.shape:
            raise SamplingError(
                f"{name} has shape {picture.shape}, must end in {self.shape}; "
                "resample it or build the model for that shape"
            )
        if not np.isfinite(picture).all():
            raise SamplingError(
                f"{name} has {np.count_nonzero(~np.isfinite(picture))} of {picture.size} values "
                "that are not finite; replace them first"
            )
        return picture

    def _filter(self, picture: Array, transfer: NDArray[np.complex128]) -> Array:
        spectrum = scipy.fft.rfft2(picture, self.grid)
        spectrum *= transfer
        return self._frame(spectrum)

    def _frame(self, spectrum: NDArray[np.complex128]) -> Array:
        rows, columns = self.shape
        return np.ascontiguousarray(scipy.fft.irfft2(spectrum, self.grid)[..., :rows, :columns])


def padded_grid(kernel: tuple[int, ...], shape: tuple[int, int]) -> tuple[int, int]:
    """Return the FFT grid that holds a frame and the kernel's longer arm along each axis."""
    arms = (_longer_arm(k, n) for k, n in zip(kernel, shape, strict=True))
    rows, columns = (
        scipy.fft.next_fast_len(n + arm, real=True) for n, arm in zip(shape, arms, strict=True)
    )
    return rows, columns


def _weights(
    point_spreads: PointSpreadField,
    shape: tuple[int, int],
    at: tuple[ArrayLike, ArrayLike] | None,
) -> Array:
    if at is None:
        # pixel centres in the picture's coordinates, which run from -1 to 1
        rows, columns = ((2 * np.arange(n) + 1) / n - 1 for n in shape)
        return point_spreads.at(columns[None, :], rows[:, None])
    across, up = (np.asarray(v, dtype=np.float64) for v in at)
    if across.shape != shape or up.shape != shape:
        raise SamplingError(
            f"at has shapes {across.shape} and {up.shape}, must be the model's {shape}; give the "
            "picture's coordinates of every pixel"
        )
    return point_spreads.at(across, up)


def _frame_shape(shape: Any) -> tuple[int, int]:
    if not hasattr(shape, "__len__") or len(shape) != 2:
        raise SamplingError(f"shape = {shown(shape)} is not an image size; give (rows, columns)")
    return (whole("shape[0]", shape[0]), whole("shape[1]", shape[1]))


def _finite_kernel(kernel: Any) -> Array:
    try:
        values = np.array(kernel, dtype=np.float64)
    except (TypeError, ValueError):
        raise SamplingError(
            f"kernel of type {type(kernel).__name__} is not an array of numbers; "
            "give a PointSpread or a (ky, kx) array"
        ) from None
    if values.ndim != 2 or values.size == 0:
        raise SamplingError(
            f"kernel has shape {values.shape}, must be (ky, kx) with at least one pixel; give a "
            "PointSpread or such an array"
        )
    if not np.isfinite(values).all():
        raise SamplingError(
            f"kernel has {np.count_nonzero(~np.isfinite(values))} of {values.size} values that are "
            "not finite; compute the point spread again on a grid that holds it"
        )
    if not values.any():
        raise SamplingError("kernel is zero everywhere; give a point spread that carries energy")
    return values


def _longer_arm(kernel_length: int, frame_length: int) -> int:
    arm = max(kernel_length // 2, (kernel_length - 1) // 2)
    return min(arm, frame_length - 1)


def _on_grid(kernel: Array, shape: tuple[int, int], grid: tuple[int, int]) -> Array:
    """Place the kernel on the FFT grid with its centre at [0, 0] and its arms wrapped around."""
    wrapped = np.zeros(grid)
    offsets = [np.arange(k) - k // 2 for k in kernel.shape]
    kept = [np.abs(o) < n for o, n in zip(offsets, shape, strict=True)]
    wrapped[np.ix_(offsets[0][kept[0]], offsets[1][kept[1]])] = kernel[np.ix_(*kept)]
    return wrapped
