"""Triangle meshes with the arrays that rays need of them, prepared once and kept between calls.

A kept mesh is found by its contents: every lookup compares all vertices and faces with the copies
that the structures were built from. A mesh that was changed, in whatever way, is therefore prepared
anew, and an equal mesh in another scene, or from a pickle, is not.
"""

from __future__ import annotations

import threading
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from .triangles import Facets

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
MOST_TRIANGLES: Final = 1 << 20  # of all kept meshes but the latest, 0.5 kB each
MOST_MESHES: Final = 32  # a lookup compares with each of them


class KeptMesh:
    """Triangles of one or several meshes, and the arrays and search structures made from them.

    Each of these is computed when it is first asked for.

    Parameters
    ----------
    meshes : tuple of trimesh.Trimesh
        Meshes to join in this order, world frame, m. Their vertices and faces are copied.
    """

    def __init__(self, *meshes: trimesh.Trimesh) -> None:
        # copied first and built from the copies, which then belong together whatever others write
        self.parts = [(_bits(mesh.vertices).copy(), _faces(mesh).copy()) for mesh in meshes]
        self.triangles = sum(len(faces) for _, faces in self.parts)

    def holds(self, *meshes: trimesh.Trimesh) -> bool:
        """Return whether these meshes have bitwise the vertices and faces that were copied."""
        return len(meshes) == len(self.parts) and all(
            np.array_equal(vertices, _bits(mesh.vertices)) and np.array_equal(faces, _faces(mesh))
            for (vertices, faces), mesh in zip(self.parts, meshes, strict=True)
        )

    @cached_property
    def facets(self) -> Facets:
        """Search structures of all triangles."""
        return Facets(self._mesh)

    @cached_property
    def normals(self) -> Array:
        """Unit normals of the triangles, (n, 3)."""
        return np.array(self._mesh.face_normals, dtype=np.float64)

    @cached_property
    def reach(self) -> float:
        """Largest absolute coordinate, m."""
        return float(np.abs(self._mesh.bounds).max())

    @cached_property
    def corners(self) -> Array:
        """First corner and two edges from there of each triangle, (n, 9), m."""
        corners = np.asarray(self._mesh.triangles, dtype=np.float64)
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        return np.concatenate([corners[:, 0], first, second], axis=1)

    @cached_property
    def area_shares(self) -> Array:
        """Cumulative shares of the triangles in the area, (n + 1,), from 0 to 1."""
        return cumulative(self._areas)

    @cached_property
    def area(self) -> float:
        """Area of all triangles, m^2."""
        return float(self._areas.sum())

    @property
    def _areas(self) -> Array:
        across = np.cross(self.corners[:, 3:6], self.corners[:, 6:])
        return np.asarray(0.5 * np.sqrt((across * across).sum(axis=1)))

    @cached_property
    def ball(self) -> Array:
        """Centre (x, y, z) and radius of a sphere that holds all triangles, (4,), m."""
        return ball_around(np.asarray(self._mesh.triangles, dtype=np.float64).reshape(-1, 3))

    @property
    def _mesh(self) -> trimesh.Trimesh:
        import trimesh

        starts = np.cumsum([0, *(len(vertices) for vertices, _ in self.parts)])
        vertices = np.concatenate([vertices.view(np.float64) for vertices, _ in self.parts])
        faces = [faces + start for (_, faces), start in zip(self.parts, starts, strict=False)]
        return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


_kept: list[KeptMesh] = []  # the latest used last
_lock = threading.Lock()


def kept_mesh(*meshes: trimesh.Trimesh) -> KeptMesh:
    """Return the prepared triangles of the meshes together, kept ones if there are any.

    At most `MOST_TRIANGLES` triangles are kept beside the latest mesh; those not used for longest
    go first.

    Parameters
    ----------
    meshes : tuple of trimesh.Trimesh
        Meshes to join in this order, world frame, m.
    """
    found = next((kept for kept in reversed(_kept.copy()) if kept.holds(*meshes)), None)
    if found is None:
        found = KeptMesh(*meshes)
    with _lock:
        if found in _kept:
            _kept.remove(found)
        _kept.append(found)
        while len(_kept) > 1 and (
            len(_kept) > MOST_MESHES or sum(k.triangles for k in _kept[:-1]) > MOST_TRIANGLES
        ):
            del _kept[0]
    return found


def ball_around(points: Array) -> Array:
    """Return centre (x, y, z) and radius of a sphere that holds the points (n, 3), (4,), m."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max()))
    return np.array([*centre, radius])


def cumulative(values: Array) -> Array:
    """Return cumulative shares along the last axis, from 0 to 1; uniform if all values are 0."""
    total = values.sum(axis=-1, keepdims=True)
    shares = np.where(total > 0.0, values, 1.0)
    sums = np.cumsum(shares, axis=-1) / shares.sum(axis=-1, keepdims=True)
    sums = np.minimum(np.insert(sums, 0, 0.0, axis=-1), 1.0)
    sums[..., -1] = 1.0  # exact, so that no random number falls beyond the last share
    return np.asarray(sums)


def _bits(vertices: Any) -> NDArray[np.uint64]:
    """Return the bits of coordinates, which also compare NaN and the sign of zero."""
    return np.asarray(np.ascontiguousarray(vertices, dtype=np.float64)).view(np.uint64)


def _faces(mesh: trimesh.Trimesh) -> NDArray[np.int64]:
    """Return the faces of a mesh as a plain array."""
    return np.asarray(mesh.faces, dtype=np.int64)
