"""Triangle meshes: loading, checking, and the smooth wall surface behind one."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import positive
from ..errors import SceneError
from .walls import GRID, Array, Wall, _term

if TYPE_CHECKING:
    import trimesh


def load_mesh(name: str, source: Any) -> trimesh.Trimesh:
    """Load and check a triangle mesh; ``name`` is the key named in errors.

    Raises
    ------
    SceneError
        If the file is missing or unreadable, or holds no triangles or non-finite vertices.
    """
    import trimesh

    if isinstance(source, trimesh.Trimesh):
        mesh = source
    else:
        path = Path(source)
        if not path.is_file():
            raise SceneError(f"{name}: there is no file {path}; give the path of a mesh")
        try:
            mesh = trimesh.load(path, force="mesh", process=False)
        except Exception as error:  # trimesh's loaders raise whatever their format raises
            raise SceneError(
                f"{name}: {path} is not a mesh ({type(error).__name__}); give STL, OBJ or PLY"
            ) from None
    if not isinstance(mesh, trimesh.Trimesh) or len(getattr(mesh, "faces", ())) == 0:
        raise SceneError(f"{name}: {source} holds no triangles; give a surface mesh")
    if not np.isfinite(mesh.vertices).all():
        raise SceneError(f"{name}: {source} has NaN or infinite vertices; mend the mesh")
    if not mesh.area > 0:
        raise SceneError(f"{name}: {source} has no area; give a surface mesh")
    return mesh


@dataclass(frozen=True, eq=False)
class MeshWall(Wall):
    """Relay wall given by a mesh that is a height field over z = 0.

    Waves need a smooth surface, which triangles are not: the vertices are joined by a bicubic
    surface with continuous slopes, and `fit_residual` says how far that can be from the truth.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        File (STL, OBJ, PLY) or mesh, m, world frame, facing +z.
    scale : float
        Factor on the mesh's coordinates, for files in other units.
    """

    mesh: Any
    _: KW_ONLY
    scale: float = 1.0

    def __post_init__(self) -> None:
        if isinstance(self.mesh, str):
            object.__setattr__(self, "mesh", Path(self.mesh))
        positive("wall.scale", self.scale)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeshWall):
            return NotImplemented
        return self.mesh == other.mesh and self.scale == other.scale

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def triangles(self) -> trimesh.Trimesh:
        """The mesh itself, scaled."""
        mesh = load_mesh("wall.mesh", self.mesh)
        if self.scale != 1.0:
            mesh = mesh.copy()
            mesh.vertices = mesh.vertices * self.scale
        return mesh

    @property
    def size(self) -> tuple[float, float]:  # type: ignore[override]
        """Extent in x and y that is centred on the origin and covered by the mesh, m."""
        low, high = self.triangles.bounds
        reach = np.minimum(-low[:2], high[:2])
        if not (reach > 0).all():
            raise SceneError(
                f"wall.mesh spans x {low[0]:g} to {high[0]:g} m and y {low[1]:g} to {high[1]:g} m; "
                "it must surround the origin"
            )
        return (2 * float(reach[0]), 2 * float(reach[1]))
