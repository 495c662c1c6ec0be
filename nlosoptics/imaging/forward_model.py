"""The linear image model: an object convolved with one point spread function."""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from .._checks import fits_memory, one_of, positive, whole
from ..errors import SamplingError

Array = NDArray[np.float64]
Boundary = Literal["padded", "circular"]


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """Convolution of an object image with a point spread function, and its adjoint.

    Object and image live on the same pixels: ``image[i] = sum_j kernel[centre + i - j] object[j]``.

    Parameters
    ----------
    point_spread : PointSpread or array_like
        The kernel, (ky, kx), energy per pixel, its centre at ``[ky//2, kx//2]``; a `PointSpread`
        also gives its ``pitch``. It is used as it is, without renormalisation.
    shape : (int, int)
        Rows and columns of object and image.
    boundary : {"padded", "circular"}
        What lies around the object: nothing (light that leaves the frame is lost), or its own
        periodic copies.

    Attributes
    ----------
    kernel : ndarray
        (ky, kx) float64, read-only.
    pitch : float or None
        Pixel pitch of the point spread, m; None for a plain array.
    grid : (int, int)
        Rows and columns of the FFT grid; object and image are its first ``shape`` samples.
    transfer : ndarray
        ``rfft2`` of the kernel on ``grid``, origin at sample [0, 0], complex128, read-only.

    Raises
    ------
    SamplingError
        If the kernel is not a finite image with energy, or is larger than a circular frame.
    SceneError
        If ``shape``, ``boundary`` or the pitch is out of range.
    MemoryLimitError
        If the FFT grid would not fit memory.

    Notes
    -----
    A padded grid holds the frame and the kernel's longer arm, not the sum of both sizes: what
    wraps around lands outside the frame and is cut off. Kernel samples that cannot reach from
    one edge of the frame to the other are left out. scipy's transforms run on one thread, so the
    result has the same bits everywhere.
    """

    point_spread: InitVar[Any]
    shape: tuple[int, int] = field(kw_only=True)
    boundary: Boundary = field(default="padded", kw_only=True)
    kernel: Array = field(init=False, repr=False)
    pitch: float | None = field(init=False)
    grid: tuple[int, int] = field(init=False)
    transfer: NDArray[np.complex128] = field(init=False, repr=False)

    def __post_init__(self, point_spread: Any) -> None:
        shape = _frame_shape(self.shape)
        one_of("boundary", self.boundary, ("padded", "circular"))
        kernel = _finite_kernel(getattr(point_spread, "intensity", point_spread))
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
            arms = (_longer_arm(k, n) for k, n in zip(kernel.shape, shape, strict=True))
            rows, columns = (
                int(fft.next_fast_len(n + arm, real=True))
                for n, arm in zip(shape, arms, strict=True)
            )
            grid = (rows, columns)
        fits_memory(
            f"forward model of {shape[0]} x {shape[1]} pixels on a {grid[0]} x {grid[1]} grid",
            40.0 * math.prod(grid),
            "bin the pixels or cut out a region",
        )
        kernel.flags.writeable = False
        transfer = fft.rfft2(_on_grid(kernel, shape, grid))
        transfer.flags.writeable = False
        for name, value in (
            ("shape", shape),
            ("kernel", kernel),
            ("pitch", pitch),
            ("grid", grid),
            ("transfer", transfer),
        ):
            object.__setattr__(self, name, value)

    def forward(self, object_image: ArrayLike) -> Array:
        """Image of an object.

        Parameters
        ----------
        object_image : array_like
            (..., H, W), with (H, W) the model's shape; any unit.

        Returns
        -------
        ndarray
            (..., H, W) float64, the object's unit times the kernel's.
        """
        return self._filter("object_image", object_image, self.transfer)

    def adjoint(self, image: ArrayLike) -> Array:
        """Transpose of `forward`: correlation of an image with the kernel.

        Parameters
        ----------
        image : array_like
            (..., H, W), with (H, W) the model's shape.

        Returns
        -------
        ndarray
            (..., H, W) float64.
        """
        return self._filter("image", image, np.conj(self.transfer))

    def _filter(self, name: str, value: ArrayLike, transfer: NDArray[np.complex128]) -> Array:
        picture = np.asarray(value, dtype=np.float64)
        if picture.shape[-2:] != self.shape:
            raise SamplingError(
                f"{name} has shape {picture.shape}, must end in {self.shape}; "
                "resample it or build the model for that shape"
            )
        if not np.isfinite(picture).all():
            raise SamplingError(
                f"{name} has {np.count_nonzero(~np.isfinite(picture))} values that are not "
                "finite; replace them before the transform spreads them over the image"
            )
        rows, columns = self.shape
        spectrum = fft.rfft2(picture, s=self.grid)
        spectrum *= transfer
        return np.ascontiguousarray(fft.irfft2(spectrum, s=self.grid)[..., :rows, :columns])


def _frame_shape(shape: Any) -> tuple[int, int]:
    if not hasattr(shape, "__len__") or len(shape) != 2:
        raise SamplingError(f"shape = {shape!r} is not an image size; give (rows, columns)")
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
            f"kernel has shape {values.shape}, must be (ky, kx) with at least one pixel"
        )
    if not np.isfinite(values).all():
        raise SamplingError(
            f"kernel has {np.count_nonzero(~np.isfinite(values))} values that are not finite; "
            "compute the point spread again on a grid that holds it"
        )
    if not values.any():
        raise SamplingError("kernel is zero everywhere; give a point spread that carries energy")
    return values


def _longer_arm(kernel_length: int, frame_length: int) -> int:
    arm = max(kernel_length // 2, (kernel_length - 1) // 2)
    return min(arm, frame_length - 1)


def _on_grid(kernel: Array, shape: tuple[int, int], grid: tuple[int, int]) -> Array:
    """Kernel with its centre at [0, 0] of the FFT grid, its arms wrapped around."""
    wrapped = np.zeros(grid)
    offsets = [np.arange(k) - k // 2 for k in kernel.shape]
    kept = [np.abs(o) < n for o, n in zip(offsets, shape, strict=True)]
    wrapped[np.ix_(offsets[0][kept[0]], offsets[1][kept[1]])] = kernel[np.ix_(*kept)]
    return wrapped
