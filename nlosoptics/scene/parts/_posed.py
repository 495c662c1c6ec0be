"""Base classes of objects with a position and a rotation."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import Vector, positive, real, vector
from ..._nouns import Noun
from ._quantities import Angle
from ._sources import bare_mesh, equal_sources, source

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


def rotation_matrix(yaw: float, pitch: float, roll: float) -> Array:
    """Return the (3, 3) rotation by roll about z, then pitch about x, then yaw about y.

    Angles are in rad and right-handed; all axes are those of the world.
    """
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a), math.sin(a)) for a in (yaw, pitch, roll))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


@dataclass(frozen=True, eq=False)
class Posed(Noun):
    """Base class of objects with a position and a rotation."""

    #: Table of the scene file, for error messages.
    table: ClassVar[str]
    #: Name of the field that holds a file path or the contents of a file.
    source: ClassVar[str]
    _: KW_ONLY
    position: Vector
    yaw: Angle = 0.0
    pitch: Angle = 0.0
    roll: Angle = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "position", vector(f"{self.table}.position", self.position))
        for name in ("yaw", "pitch", "roll"):
            put(self, name, real(f"{self.table}.{name}", getattr(self, name)))

    @property
    def rotation(self) -> Array:
        """Matrix that rotates vectors from the object's frame to the world frame, (3, 3)."""
        return rotation_matrix(self.yaw, self.pitch, self.roll)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = [field.name for field in fields(self) if field.name != self.source]
        return self._same_source(other) and all(
            getattr(self, name) == getattr(other, name) for name in names
        )

    def _same_source(self, other: Any) -> bool:
        """Return whether the files or data of two objects are equal."""
        return equal_sources(getattr(self, self.source), getattr(other, self.source))

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class PosedMesh(Posed):
    """Base class of triangle meshes, or paths of mesh files, with a pose and a scale."""

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
        """Return the mesh in the world frame, m."""
        from .meshes import load_mesh

        mesh = load_mesh(f"{self.table}.mesh", self.mesh).copy()
        mesh.vertices = mesh.vertices * self.scale @ self.rotation.T + np.array(self.position)
        return mesh
