"""Triangle meshes from files or from memory."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import SceneError
from ._sources import SourceFile

if TYPE_CHECKING:
    import trimesh


def load_mesh(name: str, given: Any) -> trimesh.Trimesh:
    """Load and check a triangle mesh; ``name`` is the key named in errors.

    Raises
    ------
    SceneError
        If the file is missing or unreadable, or holds no triangles or non-finite vertices.
    """
    import trimesh

    mesh: Any = given
    if isinstance(given, (str, Path)):
        path = SourceFile.at(given)
        if not path.is_held and not path.is_file():
            raise SceneError(f"{name}: there is no file {path}; give the path of a mesh")
        # from its place where it can be: a mesh may name further files beside it
        file: Any = io.BytesIO(path.content) if path.is_held else str(path)
        try:
            mesh = trimesh.load(file, file_type=path.suffix[1:], force="mesh", process=False)
        except Exception as error:  # trimesh's loaders raise whatever their format raises
            raise SceneError(
                f"{name}: {path} is not a mesh ({type(error).__name__}); give STL, OBJ or PLY"
            ) from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"{name}: {given} holds no triangles; give a surface mesh")
    if not np.isfinite(mesh.vertices).all():
        raise SceneError(f"{name}: {given} has NaN or infinite vertices; mend the mesh")
    if not mesh.area > 0:
        raise SceneError(f"{name}: {given} has no area; give a surface mesh")
    return mesh
