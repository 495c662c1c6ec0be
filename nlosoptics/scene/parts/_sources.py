"""Where a scene's pictures, heights and meshes come from: a file that travels along, or memory."""

from __future__ import annotations

import io
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError

if TYPE_CHECKING:
    import trimesh

    _Path = Path
else:
    _Path = type(Path())  # Python 3.11 has a class of paths for each system

#: Largest values of the integers that a PNG holds.
_DEPTHS = ((255, np.uint8), (65535, np.uint16))


class SourceFile(_Path):
    """Path of a file whose bytes travel with it: read once, and held in a pickle.

    So a scene can be used where the file is not, and what it was computed from stays known when
    the file is changed.
    """

    @classmethod
    def at(cls, path: str | Path) -> SourceFile:
        """Absolute path of a file; one that holds its bytes already is returned as it is."""
        return path if isinstance(path, cls) else cls(Path(path).resolve())

    @cached_property
    def content(self) -> bytes:
        """Bytes of the file.

        Raises
        ------
        SceneError
            If it cannot be read.
        """
        try:
            return Path(self).read_bytes()
        except OSError as error:
            raise SceneError(f"{self} cannot be read ({error.strerror}); put it back") from None

    @property
    def is_held(self) -> bool:
        """Whether the bytes are known, so that the file itself is not needed any more."""
        return "content" in vars(self)

    @property
    def is_in_place(self) -> bool:
        """Whether the file holds the bytes that were read, or none were read yet."""
        if not self.is_held:
            return True
        try:
            return Path(self).read_bytes() == self.content
        except OSError:
            return False

    def with_segments(self, *parts: Any) -> Path:
        """Paths made of this one are plain ones."""
        return Path(*parts)

    def __reduce__(self) -> Any:
        return _held, (str(self), self.content)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


def _held(path: str, content: bytes) -> SourceFile:
    file = SourceFile(path)
    vars(file)["content"] = content
    return file


def source(value: Any) -> Any:
    """A path, or the text of one, as a `SourceFile`; all else as it is."""
    return SourceFile.at(value) if isinstance(value, (str, Path)) else value


def equal_sources(one: Any, other: Any) -> bool:
    """Whether two sources are the same path, equal arrays or meshes of the same triangles."""
    if isinstance(one, Path) or isinstance(other, Path):
        return isinstance(one, Path) and one == other
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    return one is other or all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("vertices", "faces")
    )


def bare_mesh(value: Any) -> Any:
    """A mesh without what it keeps of its triangles, such as a tree for rays; all else as it is."""
    if not hasattr(value, "faces"):
        return value
    import trimesh

    return trimesh.Trimesh(np.array(value.vertices), np.array(value.faces), process=False)


def picture_file(values: NDArray[np.float64]) -> tuple[str, bytes]:
    """Suffix and bytes of the smallest file that holds brightness 0 to 1 to the last bit.

    Parameters
    ----------
    values : ndarray, (ny, nx)
        float64, row 0 on top.

    Returns
    -------
    suffix : str
        ``.png`` where all values are 8- or 16-bit integers over their largest, else ``.npy``.
    content : bytes
    """
    from PIL import Image

    for largest, kind in _DEPTHS:
        levels = np.rint(values * largest)
        if (levels / largest).tobytes() == values.tobytes():
            held = io.BytesIO()
            Image.fromarray(levels.astype(kind)).save(held, format="PNG", optimize=True)
            return ".png", held.getvalue()
    return ".npy", array_file(values)


def array_file(values: NDArray[Any]) -> bytes:
    """Bytes of an ``.npy`` file."""
    held = io.BytesIO()
    np.save(held, values, allow_pickle=False)
    return held.getvalue()


def mesh_file(mesh: trimesh.Trimesh) -> bytes:
    """Bytes of a binary PLY file that keeps float64 vertices and their order.

    trimesh's own writers round the coordinates.
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
