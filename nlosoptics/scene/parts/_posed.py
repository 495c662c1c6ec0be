"""Position and rotation of what stands in the room, and meshes placed by them."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, positive, real, vector
from ..._nouns import Noun
from ._sources import bare_mesh, equal_sources, source

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


def rotation_matrix(yaw: float, pitch: float, roll: float) -> Array:
    """Rotate by roll about z, then pitch about x, then yaw about y (right-handed, rad)."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a), math.sin(a)) for a in (yaw, pitch, roll))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


@dataclass(frozen=True, eq=False)
class Posed(Noun):
    """Position and rotation; ``table`` names the table of scene files in errors."""

    table: ClassVar[str]
    #: Field that holds a file, or its contents.
    source: ClassVar[str]
    _: KW_ONLY
    position: Vector
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "position", vector(f"{self.table}.position", self.position))
        for name in ("yaw", "pitch", "roll"):
            put(self, name, real(f"{self.table}.{name}", getattr(self, name)))

    @property
    def rotation(self) -> Array:
        """Rotation of the object's axes into the world's, (3, 3)."""
        return rotation_matrix(self.yaw, self.pitch, self.roll)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = [field.name for field in fields(self) if field.name != self.source]
        return self._same_source(other) and all(
            getattr(self, name) == getattr(other, name) for name in names
        )

    def _same_source(self, other: Any) -> bool:
        return equal_sources(getattr(self, self.source), getattr(other, self.source))

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class PosedMesh(Posed):
    """A triangle mesh, or the path of one, with its place."""

    source: ClassVar[str] = "mesh"
    mesh: Any
    _: KW_ONLY
    scale: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "mesh", source(self.mesh))
        object.__setattr__(self, "scale", positive(f"{self.table}.scale", self.scale))

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"mesh": bare_mesh(self.mesh)}

    def _placed(self) -> trimesh.Trimesh:
        """Mesh in the world frame."""
        from .meshes import load_mesh

        mesh = load_mesh(f"{self.table}.mesh", self.mesh).copy()
        mesh.vertices = mesh.vertices * self.scale @ self.rotation.T + np.array(self.position)
        return mesh
