"""Sources of a scene's images, heights and meshes: files whose bytes are kept, or memory."""

from __future__ import annotations

import io
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ..._checks import path_of
from ..._pictures import MOST_PIXELS
from ...errors import SceneError

if TYPE_CHECKING:
    import trimesh

    _Path = Path
else:
    _Path = type(Path())  # Python 3.11 has a class of paths for each system


class SourceFile(_Path):
    """Path of a file whose bytes are read once and then kept with it, also in a pickle.

    A scene can therefore be used on a machine without the file. The data that a result was
    computed from stay known even if the file is changed later.
    """

    @classmethod
    def at(cls, path: str | Path) -> SourceFile:
        """Return a `SourceFile` with the absolute path; a given `SourceFile` stays unchanged."""
        return path if isinstance(path, cls) else cls(path_of("path", path).resolve())

    @cached_property
    def content(self) -> bytes:
        """Bytes of the file, read at the first access."""
        try:
            return Path(self).read_bytes()
        except OSError as error:
            raise SceneError(
                f"{self} cannot be read ({error.strerror}); put it back or correct its permissions"
            ) from None

    @property
    def is_held(self) -> bool:
        """Whether the bytes have been read, so that the file is no longer needed."""
        return "content" in vars(self)

    @property
    def is_in_place(self) -> bool:
        """Whether the file still has the bytes that were read, or has not been read yet."""
        if not self.is_held:
            return True
        try:
            return Path(self).read_bytes() == self.content
        except OSError:
            return False

    def with_segments(self, *parts: Any) -> Path:
        """Return derived paths, such as the parent folder, as plain `Path` objects."""
        return Path(*parts)

    @classmethod
    def held(cls, path: str | Path, content: bytes) -> SourceFile:
        """Return a `SourceFile` with known bytes; the file itself need not exist."""
        file = cls(path)
        vars(file)["content"] = content
        return file

    def __reduce__(self) -> Any:
        return SourceFile.held, (str(self), self.content)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


def source(value: Any) -> Any:
    """Return a path or string as a `SourceFile`, and any other value unchanged."""
    return SourceFile.at(value) if isinstance(value, (str, Path)) else value


def equal_sources(one: Any, other: Any) -> bool:
    """Return whether two sources are the same path, equal arrays or meshes of equal triangles."""
    if isinstance(one, Path) or isinstance(other, Path):
        return isinstance(one, Path) and one == other
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    return one is other or all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("vertices", "faces")
    )


def bare_mesh(value: Any) -> Any:
    """Return a mesh without cached data such as a ray tree; any other value is unchanged."""
    if not hasattr(value, "faces"):
        return value
    import trimesh

    return trimesh.Trimesh(np.array(value.vertices), np.array(value.faces), process=False)


def picture_file(values: NDArray[np.float64]) -> tuple[str, bytes]:
    """Encode an image losslessly in the smallest possible file format."""
    from PIL import Image

    depths = ((255, np.uint8), (65535, np.uint16))  # that a PNG file can store
    for largest, kind in depths if values.size <= MOST_PIXELS else ():
        levels = np.rint(values * largest)
        if (levels / largest).tobytes() == values.tobytes():
            held = io.BytesIO()
            Image.fromarray(levels.astype(kind)).save(held, format="PNG", optimize=True)
            return ".png", held.getvalue()
    return ".npy", array_file(values)


def array_file(values: NDArray[Any]) -> bytes:
    """Return the bytes of an ``.npy`` file with these values."""
    held = io.BytesIO()
    np.save(held, values, allow_pickle=False)
    return held.getvalue()


def mesh_file(mesh: trimesh.Trimesh) -> bytes:
    """Return the bytes of a binary PLY file with float64 vertices in their order.

    The writers of trimesh are not used because they round the coordinates.
    """
    faces = np.zeros(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return head.encode() + np.asarray(mesh.vertices, dtype="<f8").tobytes() + faces.tobytes()
