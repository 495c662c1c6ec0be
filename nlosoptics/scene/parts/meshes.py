"""Loading and checking of triangle meshes."""

from __future__ import annotations

import io
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._checks import MOST, reason
from ...errors import SceneError
from ._sources import SourceFile

if TYPE_CHECKING:
    import trimesh


_NO_LOG = logging.NullHandler()


def load_mesh(name: str, given: Any) -> trimesh.Trimesh:
    """Return a triangle mesh from a file or from memory, checked."""
    import trimesh

    # Otherwise trimesh's log of a file that it cannot read, with a traceback, goes to stderr.
    logging.getLogger("trimesh").addHandler(_NO_LOG)
    mesh: Any = given
    if isinstance(given, (str, Path)):
        path = SourceFile.at(given)
        if not path.is_held and not path.is_file():
            raise SceneError(f"{name}: there is no file {path}; give the path of a mesh")
        try:
            # Bytes instead of the path: a glTF file could name any other file of this machine.
            file = io.BytesIO(path.content if path.is_held else Path(path).read_bytes())
            mesh = trimesh.load(file, file_type=path.suffix[1:], force="mesh", process=False)
        except Exception as error:  # the loaders of trimesh raise arbitrary exception types
            raise SceneError(
                f"{name}: {path} is not a mesh that can be read ({reason(error)}); give STL, "
                "OBJ or PLY"
            ) from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"{name}: {given} holds no triangles; give a surface mesh")
    n_vertices = len(mesh.vertices)
    if np.shape(mesh.vertices) != (n_vertices, 3):
        raise SceneError(f"{name}: {given} has vertices without three coordinates; repair the mesh")
    if mesh.faces.min() < 0 or mesh.faces.max() >= n_vertices:
        raise SceneError(
            f"{name}: {given} has triangles between vertices {mesh.faces.min()} and "
            f"{mesh.faces.max()}, limit 0 to {n_vertices - 1}; repair the mesh"
        )
    if not np.isfinite(mesh.vertices).all():
        raise SceneError(f"{name}: {given} has NaN or infinite vertices; repair the mesh")
    most = float(np.abs(mesh.vertices).max())
    if most > MOST:
        raise SceneError(
            f"{name}: {given} has a vertex at {most:.3g} m, limit {MOST:g}; repair the mesh"
        )
    if not mesh.area > 0:
        raise SceneError(f"{name}: {given} has no area; give a surface mesh")
    return mesh
