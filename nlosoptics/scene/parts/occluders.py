"""Black bodies in the room, which block light."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..._checks import Vector
from ...errors import SceneError
from ._posed import PosedMesh
from .meshes import load_mesh

if TYPE_CHECKING:
    import trimesh

ROUNDING = 1e-12  # of the largest coordinate: what turning a mesh onto the wall leaves


@dataclass(frozen=True, eq=False)
class Occluder(PosedMesh):
    """A black body: a triangle mesh that absorbs what meets it, from either side.

    It may stand on the plane z = 0 and not reach behind it. What a curved wall hides of it blocks
    nothing, and a face that lies in the wall covers nothing of it.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        File (STL, OBJ, PLY, ...) or mesh, in its own frame, m.
    scale : float
        Factor on the mesh's coordinates, for files in other units.
    position : (float, float, float)
        Where the mesh's origin goes, m, world.
    yaw, pitch, roll : float
        Turns about world y, x and z, rad, roll first.
    """

    table: ClassVar[str] = "occluder"
    _: KW_ONLY
    position: Vector = (0.0, 0.0, 0.0)

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """Mesh in the world frame."""
        mesh = self._placed()
        _refuse_behind("occluder.mesh", mesh, "move occluder.position into the room")
        return mesh


def checked_occluders(values: Any) -> tuple[Occluder | trimesh.Trimesh, ...]:
    """Tuple of `Occluder` and of meshes in the world frame, or raise `SceneError`."""
    try:
        occluders = tuple(values)
    except TypeError:
        raise SceneError(
            f"scene.occluders is a {type(values).__name__}; give a tuple of meshes"
        ) from None
    for index, occluder in enumerate(occluders):
        if isinstance(occluder, Occluder):
            continue
        import trimesh

        name = f"scene.occluders[{index}]"
        if not isinstance(occluder, trimesh.Trimesh):
            raise SceneError(
                f"{name} is a {type(occluder).__name__}; give a trimesh.Trimesh or an Occluder"
            )
        _refuse_behind(name, load_mesh(name, occluder), "move it into the room")
    return occluders


def joined(occluders: tuple[Occluder | trimesh.Trimesh, ...]) -> trimesh.Trimesh | None:
    """All occluders as one mesh in the world frame; None without any."""
    if not occluders:
        return None
    import trimesh

    meshes = [o.surface if isinstance(o, Occluder) else o for o in occluders]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [np.asarray(m.faces) + start for m, start in zip(meshes, starts, strict=True)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def _refuse_behind(name: str, mesh: trimesh.Trimesh, remedy: str) -> None:
    lowest = float(mesh.vertices[:, 2].min())
    if lowest < -ROUNDING * float(np.abs(mesh.vertices).max()):
        raise SceneError(
            f"{name} reaches z = {lowest:g} m, behind the wall's plane, must be at least 0; "
            f"{remedy}"
        )
