"""Reading camera images: file formats, dark frame, flat field, saturated pixels, perspective."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import ArrayLike, NDArray

from .._checks import counted, one_of, path_of, positive, real, squarable, whole
from .._nouns import Noun
from .._pictures import picture_values
from ..errors import MissingExtraError, SamplingError, SceneError, ValidityWarning

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Source = str | Path | NDArray[Any]
Channel = Literal["red", "green", "blue", "grey", "rgb"]

FORMATS = "PNG or TIFF of 8 or 16 bits, .npy, JPEG, or a raw file"


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraImage(Noun):
    """Measured camera image, corrected for dark frame and flat field and ready for a solver.

    `camera_image` reads it from files.

    Parameters
    ----------
    values : ndarray, (ny, nx) or (ny, nx, 3) float64
        Corrected counts of each pixel: the dark frame is subtracted, the rest is divided by the
        flat field scaled to a mean of 1, and binned pixels are added up. Row 0 is the top row of
        the file; it corresponds to row 0 of a `SpeckleImage`. Dead pixels hold the mean of those
        that are not masked.
    masked : ndarray of bool, of the shape of ``values``
        True for pixels that are saturated, dead (below 5 % of the mean of the flat field), or
        outside the file's frame.
    saturated : ndarray of bool, of the shape of ``values``
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


def read_camera_file(
    source: Source, channel: Channel | None = None, gamma: str = "linear"
) -> tuple[Array, Array, float | None]:
    """Return the linear counts of an image, its values as stored, and its type's largest value.

    Both are (ny, nx), or (ny, nx, 3) for the channel "rgb", row 0 at the top. For "grey" the stored
    value is that of the brightest channel. The largest value is 255 or 65535 for unsigned integers
    of 8 or 16 bits, and None for others.
    """
    raw, name, jpeg = _raw_values(source)
    if raw.dtype.kind not in "biuf":
        raise SceneError(f"{name} holds {raw.dtype} values; give counts as whole or real numbers")
    stored = raw.astype(np.float64)
    n_bad = int(np.count_nonzero(~np.isfinite(stored)))
    if n_bad:
        raise SceneError(
            f"{name}: {n_bad} of {stored.size} values are not finite; replace bad pixels by their "
            "neighbours"
        )
    squarable(name, float(np.abs(stored).max()))
    short = raw.dtype.kind == "u" and raw.dtype.itemsize <= 2
    largest = float(np.iinfo(raw.dtype).max) if short else None
    counts = stored
    if gamma == "srgb":
        if largest is None:
            raise SceneError(
                f"{name} has {raw.dtype} values and gamma = 'srgb' is for 8 or 16 bits; use linear"
            )
        part = stored / largest
        counts = largest * np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    if jpeg or (gamma == "srgb" and largest == 255.0):
        warnings.warn(
            f"{name} has {'JPEG artefacts and ' if jpeg else ''}8 bits: its noise is not that of a "
            "camera, and dark tones are coarse; "
            + (
                "a raw file or a linear 16-bit TIFF shows more"
                if gamma == "srgb"
                else "a JPEG is seldom linear, give gamma = 'srgb'"
            ),
            ValidityWarning,
            stacklevel=3,
        )
    if raw.ndim == 2 or channel == "rgb":
        return counts, stored, largest
    if channel == "grey" or (channel is None and np.ptp(stored, axis=2).max() == 0.0):
        return counts.mean(axis=2), stored.max(axis=2), largest
    if channel is None:
        raise SceneError(
            f"{name} is in colour; give channel = 'red', 'green' or 'blue' (that of the laser), "
            "'grey', or 'rgb' to sharpen all"
        )
    at = ("red", "green", "blue").index(channel)
    return counts[..., at], stored[..., at], largest


def _raw_values(source: Source) -> tuple[NDArray[Any], str, bool]:
    """Return values (ny, nx) or (ny, nx, 3), a name for errors, and whether it is a JPEG."""
    jpeg = False
    of_cameras = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".rw2")
    if isinstance(source, np.ndarray):
        raw, name = source, "the image"
    else:
        path = path_of("path", source)
        name = str(path)
        if not path.is_file():
            raise SceneError(f"there is no file {path}; give the path of an image")
        try:
            if path.suffix.lower() in of_cameras:
                raw = _developed(path)
            elif path.suffix == ".npy":
                raw = np.load(path, allow_pickle=False)
            else:
                raw, jpeg = picture_values(path, name)
        except (SceneError, MissingExtraError):
            raise
        # Pillow's decoders raise SyntaxError for broken files
        except Exception as error:
            raise SceneError(f"{path} is no readable image ({error}); give {FORMATS}") from None
    shape = getattr(raw, "shape", "several arrays")
    if not isinstance(raw, np.ndarray) or raw.size == 0 or not (raw.ndim == 2 or shape[2:] == (3,)):
        raise SceneError(
            f"{name} holds {shape}, must be one (ny, nx) image, or (ny, nx, 3) in colour; "
            f"give {FORMATS}"
        )
    return raw, name, jpeg


def _developed(path: Path) -> NDArray[Any]:
    """Return the linear colours (ny, nx, 3) of a camera's raw file, without white balance."""
    try:
        import rawpy
    except ImportError:
        raise MissingExtraError(
            f"{path} is a raw file, and rawpy is not installed; run pip install "
            "'nlosoptics[photo]', or export a linear 16-bit TIFF"
        ) from None
    with rawpy.imread(str(path)) as file:
        values: NDArray[Any] = file.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_bps=16,
            output_color=rawpy.ColorSpace.raw,
            user_wb=[1.0, 1.0, 1.0, 1.0],
        )
    return values


def camera_image(
    paths: Source | Sequence[Source],
    *,
    shape: tuple[int, int] | None = None,
    dark: Source | None = None,
    flat: Source | None = None,
    full: float | None = None,
    channel: Channel | None = None,
    gamma: Literal["linear", "srgb"] = "linear",
    rotate: float = 0.0,
    crop: tuple[int, int, int, int] | None = None,
    corners: ArrayLike | None = None,
) -> CameraImage:
    """Read a camera image from one file, or the average of several exposures of the same scene.

    Parameters
    ----------
    paths : path, ndarray or sequence of them
        Image files: PNG or TIFF of 8 or 16 bits, JPEG, ``.npy``, or a raw file of a camera (needs
        ``pip install 'nlosoptics[photo]'``); or arrays (ny, nx) or (ny, nx, 3). A file is turned as
        its EXIF entry says.
    shape : (int, int), optional
        Rows and columns of the result, for binning. The files must have k times as many rows and
        columns, with one integer k for both. The counts of k x k pixels are then added up, and a
        group with a saturated or dead pixel is masked. With ``corners`` any shape is possible.
        None: no binning.
    dark : path or ndarray like the images, optional
        Dark frame: an image with the same exposure time but without light. It is subtracted from
        the images and from the flat field. None: nothing is subtracted.
    flat : path or ndarray like the images, optional
        Flat field: an image of an evenly lit surface. The images are divided by the flat field
        scaled to a mean of 1, so that they remain counts. Pixels in which it is below 5 % of its
        mean are dead. None: no division.
    full : float, optional
        Count from which on a pixel is saturated. None: 255 for unsigned 8-bit and 65535 for
        unsigned 16-bit data, and no limit for other types.
    channel : {"red", "green", "blue", "grey", "rgb"}, optional
        What is used of a picture in colour: one channel, the mean of the three, or all three. None:
        the picture must be grey.
    gamma : {"linear", "srgb"}
        How the file stores light: in proportion to it, or by the curve of sRGB, which is undone.
    rotate : float
        Angle by which the picture is turned counter-clockwise, degrees. Turned by other angles than
        multiples of 90, it keeps its frame, and pixels from outside the old one are masked.
    crop : (int, int, int, int), optional
        Part of the turned picture: column and row of its first pixel, width and height, pixels.
    corners : array_like, (4, 2), optional
        Positions (x, y) in the turned and cropped picture, pixels from its top left corner, of the
        corners of a flat area that was photographed in perspective. It becomes the whole result:
        they are its top left, top right, bottom right and bottom left corners. Each pixel is the
        mean over its area. Needs ``shape``.

    Returns
    -------
    CameraImage
        Corrected image with the mask of saturated and dead pixels.

    Raises
    ------
    SceneError
        If a file cannot be read, all pixels have the same value, the image is not brighter than
        the dark frame, more than half of the pixels are saturated or dead, ``full`` exceeds the
        range of a file's type, or an option is out of range.
    SamplingError
        If image sizes differ, or ``shape`` does not divide them.
    MissingExtraError
        If a raw file is given and rawpy is not installed.

    See Also
    --------
    nlosoptics.inverse.tv_deconvolve : Non-negative deconvolution with total variation.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import camera_image
    >>> exposure = np.arange(16, dtype=np.uint16).reshape(4, 4)
    >>> camera_image(exposure, shape=(2, 2)).values
    array([[10., 18.],
           [42., 50.]])

    A wall that was photographed at an angle, of which the corners were marked by hand:

    >>> marked = [(0, 0), (4, 1), (4, 3), (0, 4)]
    >>> camera_image(exposure, shape=(2, 2), corners=marked).values.shape
    (2, 2)
    """
    given: Any = paths
    if isinstance(given, Mapping) or not isinstance(given, (Path, Iterable)):
        path_of("paths", given)  # raises
    files = [paths] if isinstance(paths, (str, Path, np.ndarray)) else list(paths)
    if not files:
        raise SceneError("no image is given; name one file or more")
    full = None if full is None else positive("full", full, unit="counts")
    shape = None if shape is None else _whole_shape(shape)
    one_of("gamma", gamma, ("linear", "srgb"))
    if channel is not None:
        one_of("channel", channel, ("red", "green", "blue", "grey", "rgb"))
    read = partial(read_camera_file, channel=channel, gamma=gamma)
    total: Array | None = None
    saturated: Mask | None = None
    for path in files:
        counts, stored, largest = read(path)
        if float(counts.min()) == float(counts.max()):
            raise SceneError(
                f"{_name(path)} reads {counts.flat[0]:g} in every pixel; open the shutter, or "
                "check the file"
            )
        if total is None or saturated is None:
            total, saturated = np.zeros(counts.shape), np.zeros(counts.shape, dtype=bool)
        _same_shape(path, counts, files[0], total)
        limit = largest if full is None else full
        if limit is not None and largest is not None and limit > largest:
            raise SceneError(
                f"full = {limit:g} counts, {_name(path)} holds up to {largest:g}: no pixel could "
                "be saturated; give the count at which the camera saturates"
            )
        if limit is not None:
            saturated |= stored >= limit
        total += counts / len(files)
    assert total is not None and saturated is not None  # noqa: PT018  (there is a file)
    still = None if dark is None else read(dark)[0]
    even = None if flat is None else read(flat)[0]
    values, dead = _corrected(total, files[0], (dark, still), (flat, even))
    name, parts = _name(files[0]), (values, saturated, dead)
    turned = _turned(parts, real("rotate", rotate))
    parts = turned if crop is None else _cropped(name, turned, crop)
    if corners is None:
        return _checked(name, *_grouped(name, *parts, shape))
    if shape is None:
        raise SamplingError("corners are given without shape; give the result's rows and columns")
    return _checked(name, *_seen(parts, _homography(corners, shape), shape))


def _whole_shape(shape: tuple[int, int]) -> tuple[int, int]:
    if len(shape) != 2:
        raise SamplingError(f"shape has {counted(len(shape), 'count')}; give (rows, columns)")
    rows, columns = (whole(f"shape[{i}]", count) for i, count in enumerate(shape))
    return rows, columns


def _name(source: Source) -> str:
    return "the image" if isinstance(source, np.ndarray) else str(source)


def _corrected(
    counts: Array,
    path: Source,
    dark: tuple[Source | None, Array | None],
    flat: tuple[Source | None, Array | None],
) -> tuple[Array, Mask]:
    """Return counts minus dark frame over flat/mean(flat), and the mask of dead pixels.

    Both frames come with their source.
    """
    still, even = dark[1], flat[1]
    if still is not None:
        _same_shape(dark[0], still, path, counts, "the dark frame")
    values = counts if still is None else counts - still
    none = np.zeros(counts.shape, dtype=bool)
    if still is not None and not float(values.mean()) > 0.0:
        raise SceneError(
            f"{_name(path)} is not brighter than the dark frame: mean {values.mean():.3g} counts "
            "above it, must be positive; expose longer, or check that the files are not swapped"
        )
    if even is None:
        return values, none
    _same_shape(flat[0], even, path, counts, "the flat field")
    even = even if still is None else even - still
    mean = even.mean(axis=(0, 1))
    if not float(mean.min()) > 0.0:
        raise SceneError(
            "the flat field has no light above the dark frame (mean "
            f"{float(mean.min()):.3g} counts); record it under uniform illumination"
        )
    dead = even < 0.05 * mean
    return values / np.where(dead, mean, even) * mean, dead


Parts = tuple[Array, Mask, Mask]  # values, saturated and dead pixels


def _turned(parts: Parts, angle: float) -> Parts:
    """Turn an image and its masks counter-clockwise by an angle in degrees."""
    quarters = round(angle / 90.0)
    values, saturated = np.rot90(parts[0], quarters), np.rot90(parts[1], quarters)
    dead = np.rot90(parts[2], quarters)
    rest = math.radians(angle - 90.0 * quarters)
    if rest == 0.0:
        return values, saturated, dead
    rows, columns = values.shape[:2]
    cos, sin, x, y = math.cos(rest), math.sin(rest), 0.5 * columns, 0.5 * rows
    turn = [[cos, -sin, x - cos * x + sin * y], [sin, cos, y - sin * x - cos * y], [0.0, 0.0, 1.0]]
    return _seen((values, saturated, dead), np.array(turn), (rows, columns))


def _cropped(name: str, parts: Parts, crop: tuple[int, int, int, int]) -> Parts:
    """Return a part of an image and of its masks."""
    rows, columns = parts[0].shape[:2]
    if np.shape(crop) != (4,):
        raise SceneError(f"crop = {crop!r} is no part of an image; give x, y, width, height")
    x, y = (whole(f"crop[{i}]", crop[i], 0) for i in (0, 1))
    width, height = (whole(f"crop[{i}]", crop[i]) for i in (2, 3))
    if x + width > columns or y + height > rows:
        raise SceneError(
            f"crop = {x},{y},{width},{height} reaches column {x + width} and row {y + height}, "
            f"{name} has {columns} x {rows} pixels; give a part inside it"
        )
    inside = np.s_[y : y + height, x : x + width]
    return parts[0][inside], parts[1][inside], parts[2][inside]


def _homography(corners: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return the (3, 3) matrix that maps positions (x, y, 1) in a result to those in an image.

    ``corners`` (4, 2) are the images of the result's corners. Hartley and Zisserman, Multiple View
    Geometry (2004), section 4.1.
    """
    marked = np.asarray(corners, dtype=np.float64)
    if marked.shape != (4, 2) or not np.isfinite(marked).all():
        raise SceneError(f"corners = {corners!r} must be four finite positions (x, y); mark four")
    edges = np.roll(marked, -1, axis=0) - marked
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if not (abs(np.sign(turns).sum()) == 4 and abs(turns).min() > 1.0):
        raise SceneError(
            f"corners = {marked.tolist()} do not go around a convex area; give top left, top "
            "right, bottom right, bottom left"
        )
    rows, columns = shape
    ends = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=np.float64)
    x, y, u, v = *ends.T, *marked.T
    one, zero = np.ones(4), np.zeros(4)
    across = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], axis=1)
    down = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], axis=1)
    values = np.linalg.solve(np.concatenate([across, down]), np.concatenate([u, v]))
    return np.append(values, 1.0).reshape(3, 3)


def _seen(parts: Parts, mapping: Array, shape: tuple[int, int]) -> Parts:
    """Return an image and its masks in the pixels that a homography maps to it.

    A pixel is the mean over points of its area, at most one pixel of the image apart. It is
    saturated or dead if a point of it is, and dead if one is outside the image.
    """

    def places(x: Array, y: Array) -> Array:  # of rows and columns in the image, (2, ny, nx)
        u, v, w = np.einsum("ij,jyx->iyx", mapping, np.stack([x, y, np.ones_like(x)]))
        return np.asarray(np.stack([v / w, u / w]) - 0.5)

    y, x = np.indices(shape).astype(np.float64)
    step = max(
        float(np.sqrt(((places(x + 1.0 - i, y + i) - places(x, y)) ** 2).sum(0)).max())
        for i in (0.0, 1.0)
    )
    count = math.ceil(step - 1e-6)
    sides, results = parts[0].shape[:2], [np.zeros((*shape, *part.shape[2:])) for part in parts]
    layers = [part.astype(np.float64) if part.any() else None for part in parts]
    for i, j in np.ndindex(count, count):
        at = places(x + (j + 0.5) / count, y + (i + 0.5) / count)
        outside = np.any((at < -0.5) | (at > np.array(sides)[:, None, None] - 0.5), axis=0)
        results[2][outside] += 1.0
        for layer, result in zip(layers, results, strict=True):
            if layer is not None:
                result += _interpolated(layer, at)
    values, saturated, dead = results
    return values / count**2, saturated > 1e-9, dead > 1e-9


def _interpolated(layer: Array, at: Array) -> Array:
    """Return an image, or each of its colours, at rows and columns (2, ny, nx)."""
    if layer.ndim == 3:
        return np.stack([_interpolated(layer[..., k], at) for k in range(layer.shape[2])], axis=-1)
    return np.asarray(scipy.ndimage.map_coordinates(layer, at, order=1, mode="nearest"))


def _grouped(
    name: str, values: Array, saturated: Mask, dead: Mask, shape: tuple[int, int] | None
) -> Parts:
    """Sum counts over groups of k x k pixels to a shape; also return both masks of the groups.

    A group with a saturated or dead pixel is itself saturated or dead.
    """
    if shape is None or values.shape[:2] == shape:
        return values, saturated, dead
    groups = {n // m if n % m == 0 else 0 for n, m in zip(values.shape[:2], shape, strict=True)}
    if len(groups) != 1 or groups == {0}:
        raise SamplingError(
            f"{name} has {values.shape[1]} x {values.shape[0]} pixels, the scene's camera reads "
            f"{shape[1]} x {shape[0]}, which does not divide them; give the camera's whole frame, "
            "another size, or the corners of the area that it shows"
        )
    (side,) = groups
    cells = (shape[0], side, shape[1], side, *values.shape[2:])
    return (
        values.reshape(cells).sum(axis=(1, 3)),
        np.asarray(saturated.reshape(cells).any(axis=(1, 3))),
        np.asarray(dead.reshape(cells).any(axis=(1, 3))),
    )


def _checked(path: str, values: Array, saturated: Mask, dead: Mask) -> CameraImage:
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


def _same_shape(
    source: Source | None, picture: Array, other: Source, frame: Array, array: str = "an image"
) -> None:
    if picture.shape != frame.shape:
        name = array if source is None or isinstance(source, np.ndarray) else str(source)
        raise SamplingError(
            f"{name} has {picture.shape[1]} x {picture.shape[0]} pixels"
            f"{' in colour' if picture.ndim == 3 else ''}, {_name(other)} has "
            f"{frame.shape[1]} x {frame.shape[0]}; take both with the same frame"
        )
