"""Reading camera images: file formats, dark frame, flat field, saturated pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, path_of, positive, squarable, whole
from .._nouns import Noun
from .._pictures import opened_picture
from ..errors import SamplingError, SceneError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORMATS = "grey PNG or TIFF of 8 or 16 bits, or .npy"


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraImage(Noun):
    """Measured camera image, corrected for dark frame and flat field and ready for a solver.

    `camera_image` reads it from files.

    Parameters
    ----------
    values : ndarray, (ny, nx) float64
        Corrected counts of each pixel: the dark frame is subtracted, the rest is divided by the
        flat field scaled to a mean of 1, and binned pixels are added up. Row 0 is the top row of
        the file; it corresponds to row 0 of a `SpeckleImage`. Dead pixels hold the mean of those
        that are not masked.
    masked : ndarray of bool, (ny, nx)
        True for pixels that are saturated, or dead (below 5 % of the mean of the flat field).
    saturated : ndarray of bool, (ny, nx)
        True for pixels that are saturated and not dead: their values are lower limits.
    saturated_fraction : float
        Fraction of the pixels that are saturated.

    See Also
    --------
    camera_image : Read, average and correct camera files.
    SpeckleImage : Simulated camera image with its parts.
    """

    values: Array
    masked: Mask
    saturated: Mask
    saturated_fraction: float

    def __post_init__(self) -> None:
        for name in ("values", "masked", "saturated"):
            getattr(self, name).flags.writeable = False


def read_camera_file(path: str | Path) -> tuple[Array, float | None]:
    """Return the counts (ny, nx) of an image file, row 0 at the top, and its type's largest value.

    The largest value is 255 or 65535 for unsigned integers of 8 or 16 bits, and None for others.
    """
    path = path_of("path", path)
    if not path.is_file():
        raise SceneError(f"there is no file {path}; give the path of an image")
    try:
        raw = np.load(path, allow_pickle=False) if path.suffix == ".npy" else _decoded(path)
    except SceneError:
        raise
    # Pillow's decoders raise SyntaxError for broken files
    except Exception as error:
        raise SceneError(
            f"{path} is not an image ({type(error).__name__}); give {FORMATS}"
        ) from None
    if not isinstance(raw, np.ndarray) or raw.ndim != 2 or raw.size == 0:
        shape = getattr(raw, "shape", "several arrays")
        raise SceneError(f"{path} holds {shape}, must be one (ny, nx) image; give {FORMATS}")
    if raw.dtype.kind not in "biuf":
        raise SceneError(f"{path} holds {raw.dtype} values; give counts as whole or real numbers")
    counts = raw.astype(np.float64)
    n_bad = int(np.count_nonzero(~np.isfinite(counts)))
    if n_bad:
        raise SceneError(
            f"{path}: {n_bad} of {counts.size} values are not finite; replace bad pixels by their "
            "neighbours"
        )
    squarable(str(path), float(np.abs(counts).max()))
    short = raw.dtype.kind == "u" and raw.dtype.itemsize <= 2
    return counts, float(np.iinfo(raw.dtype).max) if short else None


def _decoded(path: Path) -> NDArray[Any]:
    with opened_picture(path, str(path)) as picture:
        frames = getattr(picture, "n_frames", 1)
        if frames > 1:
            raise SceneError(f"{path} holds {frames} images, must be one; save one per file")
        if picture.mode not in ("1", "L", "I", "F") and not picture.mode.startswith("I;16"):
            raise SceneError(
                f"{path} is in colour (mode {picture.mode}); save the laser's channel as grey"
            )
        values = np.asarray(picture)
    # 16-bit PNGs open as 32-bit integers in some versions of Pillow
    if picture.mode == "I" and picture.format == "PNG":
        return values.astype(np.uint16)
    return values


def camera_image(
    paths: str | Path | Sequence[str | Path],
    *,
    shape: tuple[int, int] | None = None,
    dark: str | Path | None = None,
    flat: str | Path | None = None,
    full: float | None = None,
) -> CameraImage:
    """Read a camera image from one file, or the average of several exposures of the same scene.

    Parameters
    ----------
    paths : path or sequence of paths
        Image files: greyscale PNG or TIFF of 8 or 16 bits, or ``.npy``.
    shape : (int, int), optional
        Rows and columns of the result, for binning. The files must have k times as many rows and
        columns, with one integer k for both. The counts of k x k pixels are then added up, and a
        group with a saturated or dead pixel is masked. None: no binning.
    dark : path, optional
        Dark frame: an image with the same exposure time but without light. It is subtracted from
        the images and from the flat field. None: nothing is subtracted.
    flat : path, optional
        Flat field: an image of an evenly lit surface. The images are divided by the flat field
        scaled to a mean of 1, so that they remain counts. Pixels in which it is below 5 % of its
        mean are dead. None: no division.
    full : float, optional
        Count from which on a pixel is saturated. None: 255 for unsigned 8-bit and 65535 for
        unsigned 16-bit data, and no limit for other types.

    Returns
    -------
    CameraImage
        Corrected image with the mask of saturated and dead pixels.

    Raises
    ------
    SceneError
        If a file cannot be read, all pixels have the same value, the image is not brighter than
        the dark frame, more than half of the pixels are saturated or dead, or ``full`` exceeds the
        range of a file's type.
    SamplingError
        If image sizes differ, or ``shape`` does not divide them.

    See Also
    --------
    nlosoptics.inverse.tv_deconvolve : Non-negative deconvolution with total variation.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> from nlosoptics.imaging import camera_image
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "exposure.npy"
    ...     np.save(file, np.arange(16, dtype=np.uint16).reshape(4, 4))
    ...     image = camera_image(file, shape=(2, 2))
    >>> image.values
    array([[10., 18.],
           [42., 50.]])
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if not files:
        raise SceneError("no image is given; name one file or more")
    full = None if full is None else positive("full", full, unit="counts")
    shape = None if shape is None else _whole_shape(shape)
    total: Array | None = None
    saturated: Mask | None = None
    for path in files:
        counts, largest = read_camera_file(path)
        if float(counts.min()) == float(counts.max()):
            raise SceneError(
                f"{path} reads {counts.flat[0]:g} in every pixel; open the shutter, or check the "
                "file"
            )
        if total is None or saturated is None:
            total, saturated = np.zeros(counts.shape), np.zeros(counts.shape, dtype=bool)
        _same_shape(path, counts, files[0], total)
        limit = largest if full is None else full
        if limit is not None and largest is not None and limit > largest:
            raise SceneError(
                f"full = {limit:g} counts, {path} holds up to {largest:g}: no pixel could be "
                "saturated; give the count at which the camera saturates"
            )
        if limit is not None:
            saturated |= counts >= limit
        total += counts / len(files)
    assert total is not None and saturated is not None  # noqa: PT018  (there is a file)
    values, dead = _corrected(total, files[0], dark, flat)
    return _checked(files[0], *_grouped(files[0], values, saturated, dead, shape))


def _whole_shape(shape: tuple[int, int]) -> tuple[int, int]:
    if len(shape) != 2:
        raise SamplingError(f"shape has {counted(len(shape), 'count')}; give (rows, columns)")
    rows, columns = (whole(f"shape[{i}]", count) for i, count in enumerate(shape))
    return rows, columns


def _corrected(
    counts: Array, path: str | Path, dark: str | Path | None, flat: str | Path | None
) -> tuple[Array, Mask]:
    """Return counts minus dark frame over flat/mean(flat), and the mask of dead pixels."""
    still = np.zeros(counts.shape)
    if dark is not None:
        still = read_camera_file(dark)[0]
        _same_shape(dark, still, path, counts)
    values, dead = counts - still, np.zeros(counts.shape, dtype=bool)
    if dark is not None and not float(values.mean()) > 0.0:
        raise SceneError(
            f"{path} is not brighter than the dark frame {dark}: mean {values.mean():.3g} counts "
            "above it, must be positive; expose longer, or check that the files are not swapped"
        )
    if flat is None:
        return values, dead
    even = read_camera_file(flat)[0]
    _same_shape(flat, even, path, counts)
    even = even - still
    mean = float(even.mean())
    if not mean > 0.0:
        raise SceneError(
            f"{flat}: the flat field has no light above the dark frame (mean {mean:.3g} counts); "
            "record it under uniform illumination"
        )
    dead = even < 0.05 * mean
    return values / np.where(dead, mean, even) * mean, dead


def _grouped(
    path: str | Path, values: Array, saturated: Mask, dead: Mask, shape: tuple[int, int] | None
) -> tuple[Array, Mask, Mask]:
    """Sum counts over groups of k x k pixels to a shape; also return both masks of the groups.

    A group with a saturated or dead pixel is itself saturated or dead.
    """
    if shape is None or values.shape == tuple(shape):
        return values, saturated, dead
    groups = {n // m if n % m == 0 else 0 for n, m in zip(values.shape, shape, strict=True)}
    if len(groups) != 1 or groups == {0}:
        raise SamplingError(
            f"{path} has {values.shape[1]} x {values.shape[0]} pixels, the scene's camera reads "
            f"{shape[1]} x {shape[0]}, which does not divide them; give the camera's whole frame "
            "or another size"
        )
    (side,) = groups
    cells = (shape[0], side, shape[1], side)
    return (
        values.reshape(cells).sum(axis=(1, 3)),
        np.asarray(saturated.reshape(cells).any(axis=(1, 3))),
        np.asarray(dead.reshape(cells).any(axis=(1, 3))),
    )


def _checked(path: str | Path, values: Array, saturated: Mask, dead: Mask) -> CameraImage:
    masked = saturated | dead
    if float(masked.mean()) > 0.5:
        raise SceneError(
            f"{path}: {100 * masked.mean():.3g} % of the pixels are saturated, or dead in the flat "
            "field, limit 50 %; expose shorter, or record another flat field"
        )
    good = values[~masked]
    if not float(good.max()) > 0.0:
        raise SceneError(
            f"{path} has no pixel above 0 counts; expose longer, or check the dark frame"
        )
    if float(good.min()) == float(good.max()):
        raise SceneError(f"{path} reads {good[0]:g} in every good pixel; check the file")
    return CameraImage(
        values=np.where(dead, float(good.mean()), values),
        masked=masked,
        saturated=saturated & ~dead,
        saturated_fraction=float(saturated.mean()),
    )


def _same_shape(path: str | Path, picture: Array, other: str | Path, frame: Array) -> None:
    if picture.shape != frame.shape:
        raise SamplingError(
            f"{path} has {picture.shape[1]} x {picture.shape[0]} pixels, {other} has "
            f"{frame.shape[1]} x {frame.shape[0]}; take both with the same frame"
        )
