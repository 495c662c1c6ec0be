"""Hidden objects: an image on a plane, or a triangle mesh."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import in_range, is_single, pair, real, reason
from ..._pictures import opened_picture, upright_picture
from ...errors import SceneError
from ._posed import Posed, PosedMesh
from ._quantities import Radiance
from ._sources import SourceFile, picture_file, source
from .materials import Lambert, Material

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
NO_PICTURE = np.ones((1, 1))  # reflectance of an object whose picture is not given


def _check_hidden(hidden: PlanarObject | MeshObject) -> None:
    """Raise `SceneError` for a wrong type of material or a position behind the wall."""
    if not isinstance(hidden.material, Material):
        raise SceneError(
            f"hidden.material = {hidden.material!r} is a {type(hidden.material).__name__}; give a "
            "Material, such as Lambert(0.8)"
        )
    if hidden.position[2] <= 0:
        raise SceneError(
            f"hidden.position has z = {hidden.position[2]:g} m, behind the wall; must be above 0"
        )


@dataclass(frozen=True, eq=False)
class PlanarObject(Posed):
    """Greyscale image on a plane, such as a hidden letter.

    Without rotation the image faces the wall, with its top toward +y. Seen from the wall it is not
    mirrored: the right side of the image points to -x and its normal to -z.

    Parameters
    ----------
    image : str, Path, array_like (ny, nx) or None
        Greyscale image: a file (PNG, TIFF, JPEG or ``.npy``) or an array with row 0 on top. The
        brightness, 0 (black) to 1 (white), multiplies the reflectance of ``material``. Integers of
        8 and 16 bits are divided by the largest value of their type. None: unknown, as for
        measurements; a white plate of the given size takes its place.
    size : float or (float, float)
        Width and height of the image in the room, m. A single number is the width; the height then
        follows from the image's shape.
    position : (float, float, float)
        Centre of the image, world frame, m.
    yaw, pitch, roll : float
        Right-handed rotations about the world's y, x and z axis, rad, applied in the order roll,
        pitch, yaw.
    material : Material
        Bidirectional reflectance of a white pixel.
    luminous : float, optional
        Radiance of a white pixel along the normal of the image, W/(m^2 sr), for an object that
        emits light itself, such as a screen or a window. By default it emits none.
    luminous_lobe : (float, float)
        Exponents p and q of the emitted light's lobe. In a direction whose angles to the normal are
        a, across, and b, along the height, the radiance is multiplied by cos(a)^p cos(b)^q. The
        default, (0, 0), is equal radiance in all directions.

    Raises
    ------
    SceneError
        If the file is missing or not an image, a value is out of range, or a part of the image lies
        behind the plane z = 0.

    See Also
    --------
    MeshObject : Hidden triangle mesh.
    Scene : Complete scene.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.scene import PlanarObject
    >>> bar = PlanarObject(np.ones((40, 10)), 0.1, position=(0.5, 0.0, 1.0))
    >>> bar.size
    (0.1, 0.4)
    >>> bar.corners.min(axis=0).round(3).tolist()
    [0.45, -0.2, 1.0]
    """

    table: ClassVar[str] = "hidden"
    source: ClassVar[str] = "image"
    image: Any
    size: Any
    _: KW_ONLY
    material: Material = Lambert(0.8)
    luminous: Radiance | None = None
    luminous_lobe: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_hidden(self)
        put = object.__setattr__
        if self.luminous is not None:
            in_range("hidden.luminous", self.luminous, 0.0, 1e18, unit="W/(m^2 sr)")
        lobe = self.luminous_lobe
        if not isinstance(lobe, tuple | list) or len(lobe) != 2:
            raise SceneError(
                f"hidden.luminous_lobe = {lobe!r}; give two exponents, across and along the height"
            )
        powers = (in_range(f"hidden.luminous_lobe[{k}]", lobe[k], 0.0, 1e3) for k in range(2))
        put(self, "luminous_lobe", tuple(powers))
        put(self, "image", source(NO_PICTURE if self.image is None else self.image))
        if not isinstance(self.image, SourceFile):
            put(self, "image", checked_picture("hidden.image", self.image))
        if is_single(self.size):
            ny, nx = self.reflectance.shape
            width = real("hidden.size[x]", self.size)
            put(self, "size", pair("hidden.size", (width, width * ny / nx)))
        else:
            put(self, "size", pair("hidden.size", self.size))
        drop = self.position[2] - float(self.corners[:, 2].min())
        if self.position[2] <= drop:
            raise SceneError(
                f"hidden.position has z = {self.position[2]:g} m, which puts a corner of the "
                f"image at z = {self.position[2] - drop:g} m, behind the wall; move it into the "
                "room, turn it less or make hidden.size smaller"
            )

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        if not isinstance(self.image, SourceFile):
            state["image"] = picture_file(self.image)
        return state

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        super().__setstate__(state)
        if isinstance(self.image, tuple):
            suffix, content = self.image
            picture = checked_picture("hidden.image", _decoded(suffix, content, "hidden.image"))
            object.__setattr__(self, "image", picture)

    def _same_source(self, other: Any) -> bool:
        """Return whether the images are equal; a file and an array are compared by pixels."""
        if isinstance(self.image, SourceFile) == isinstance(other.image, SourceFile):
            return super()._same_source(other)
        return np.array_equal(self.reflectance, other.reflectance)

    @cached_property
    def reflectance(self) -> Array:
        """Relative reflectance of the pixels, (ny, nx) float64, 0 to 1, row 0 on top."""
        if isinstance(self.image, SourceFile):
            return read_picture(self.image)
        return np.asarray(self.image)

    @property
    def axes(self) -> Array:
        """Unit vectors right, up and normal of the image as rows, world frame, (3, 3)."""
        unturned = np.array([[-1.0, 0, 0], [0, 1, 0], [0, 0, -1]])
        return np.asarray(unturned @ self.rotation.T)

    @property
    def corners(self) -> Array:
        """Corners of the image, (4, 3), world frame, m.

        Their order is top right, bottom right, bottom left, top left, as seen in the image itself.
        """
        right, up, _ = self.axes
        sides = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) / 2 * self.size
        return np.asarray(self.position + sides[:, :1] * right + sides[:, 1:] * up)


def checked_picture(name: str, values: Any) -> Array:
    """Return a greyscale image as a read-only float64 array with values from 0 to 1."""
    try:
        raw = np.asarray(values)
    except ValueError:
        raise SceneError(
            f"{name} has rows of unequal length; give a greyscale image (ny, nx)"
        ) from None
    if raw.ndim != 2 or raw.size == 0:
        raise SceneError(f"{name} has shape {raw.shape}; give a greyscale image (ny, nx)")
    if raw.dtype.kind not in "biuf":
        raise SceneError(f"{name} holds {raw.dtype} values; give real brightness from 0 to 1")
    short = raw.dtype.kind in "iu" and raw.dtype.itemsize <= 2
    scale = float(np.iinfo(raw.dtype).max) if short else 1.0
    picture = raw.astype(np.float64)
    if not np.isfinite(picture).all():
        raise SceneError(f"{name} holds NaN or infinity; give finite brightness")
    picture /= scale
    low, high = float(picture.min()), float(picture.max())
    if low < 0 or high > 1:
        raise SceneError(f"{name} spans {low:g} to {high:g}, must be within 0 to 1; rescale it")
    picture.flags.writeable = False
    return picture


def read_picture(path: Path) -> Array:
    """Read an image file as relative reflectance, (ny, nx), 0 to 1, row 0 on top."""
    file = SourceFile.at(path)
    if not file.is_held and not file.is_file():
        raise SceneError(f"hidden.image: there is no file {path}; give the path of an image")
    content = file.content
    try:
        raw = _decoded(path.suffix, content, f"hidden.image: {path}")
    except SceneError:
        raise
    # Pillow raises SyntaxError for broken files
    except Exception as error:
        raise SceneError(
            f"hidden.image: {path} is no readable image ({reason(error)}); give PNG, TIFF, JPEG or "
            ".npy"
        ) from None
    if not isinstance(raw, np.ndarray):
        raise SceneError(f"hidden.image: {path} holds several arrays; give a .npy file of one")
    return checked_picture(f"hidden.image ({path})", raw)


def _decoded(suffix: str, content: bytes, name: str) -> NDArray[Any]:
    """Return the unscaled values of an image file; colour images are converted to grey."""
    file = io.BytesIO(content)
    if suffix == ".npy":
        held: NDArray[Any] = np.load(file, allow_pickle=False)
        return held
    with opened_picture(file, name) as picture:
        upright = upright_picture(picture, name)
        if picture.mode not in ("1", "L", "I", "F") and not picture.mode.startswith("I;16"):
            return np.asarray(upright.convert("L"))
        return np.asarray(upright)


@dataclass(frozen=True, eq=False)
class MeshObject(PosedMesh):
    """Hidden object given by a triangle mesh.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        Mesh file (STL, OBJ, PLY, ...) or mesh. Its coordinates, m, refer to an origin of its own.
    scale : float
        Factor applied to the mesh's coordinates, for example 1e-3 for a file in millimetres.
    position : (float, float, float)
        Position of the mesh's origin, world frame, m.
    yaw, pitch, roll : float
        Right-handed rotations about the world's y, x and z axis, rad, applied in the order roll,
        pitch, yaw.
    material : Material
        Bidirectional reflectance of the whole surface.

    Raises
    ------
    SceneError
        If a value is out of range. The file is read when the property `surface` (the mesh in the
        world frame) is first used. Only then is an error raised if the file is missing or the mesh
        reaches behind the plane z = 0.

    See Also
    --------
    PlanarObject : Hidden image on a plane.
    Occluder : Surface that blocks light, black or of any material.
    """

    table: ClassVar[str] = "hidden"
    _: KW_ONLY
    material: Material = Lambert(0.8)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_hidden(self)

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """Mesh in the world frame, m; its file is read at the first access."""
        mesh = self._placed()
        lowest = float(mesh.vertices[:, 2].min())
        if lowest <= 0:
            raise SceneError(
                f"hidden.mesh reaches z = {lowest:g} m, behind the wall, must be above 0; move "
                "hidden.position into the room or make hidden.scale smaller"
            )
        return mesh


HiddenObject = PlanarObject | MeshObject
