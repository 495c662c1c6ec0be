"""Edges of occluding meshes, from which the kernels draw their shadows on a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import numbers
from .._nouns import Noun
from ..errors import SceneError
from ..raytrace.intersection.meshes import worker_pool

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Edges(Noun):
    """Triangles of several meshes with the edges that they share."""

    vertices: Array  # (n, 3): world frame, m
    faces: NDArray[np.int64]  # (n_faces, 3)
    # (n_meshes, 6): first and last of each mesh's vertices, faces and edges
    groups: NDArray[np.int64]
    ends: NDArray[np.int64]  # (n_edges, 2): vertices
    # (n_edges + 1,): first of the sides of each edge, (n_sides,): their faces, and 1 or -1 for the
    # order in which they pass the edge's vertices
    starts: NDArray[np.int64]
    sides: NDArray[np.int64]
    turned: NDArray[np.int64]

    @classmethod
    def of(cls, meshes: Sequence[trimesh.Trimesh]) -> Edges:
        """Collect the edges of meshes; vertices at the same place are one."""
        lists: list[list[Array]] = [[] for _ in range(7)]
        counts = np.zeros(4, dtype=np.int64)  # of vertices, faces, edges and sides
        for mesh in meshes:
            vertices, same = np.unique(np.asarray(mesh.vertices), axis=0, return_inverse=True)
            faces = same.ravel()[np.asarray(mesh.faces)].reshape(-1, 3)
            pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
            ends, edge = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
            order = np.argsort(edge.ravel(), kind="stable")
            first = np.searchsorted(edge.ravel()[order], np.arange(len(ends)))
            signs = np.where(pairs[order, 0] < pairs[order, 1], 1, -1)
            sizes = np.array([len(vertices), len(faces), len(ends), len(order)])
            group = np.stack([counts[:3], (counts + sizes)[:3]], axis=1).ravel()
            parts = [vertices, faces + counts[0], group[None], ends + counts[0]]
            parts += [first + counts[3], order // 3 + counts[1], signs]
            for values, part in zip(lists, parts, strict=True):
                values.append(part)
            counts += sizes
        empty = [(0, 3), (0, 3), (0, 6), (0, 2), (0,), (0,), (0,)]
        arrays: list[Any] = [
            np.concatenate([np.zeros(shape), *parts]).astype(np.int64 if i else np.float64)
            for i, (shape, parts) in enumerate(zip(empty, lists, strict=True))
        ]
        arrays[4] = np.append(arrays[4], counts[3])
        return cls(*arrays)

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """All arrays in the order in which the kernels take them."""
        topology = self.ends, self.starts, self.sides, self.turned
        return (self.vertices, self.faces, *topology, self.groups)

    def still(self) -> Array:
        """Return the velocities of vertices of which none is asked for, (n, 0, 3)."""
        return np.zeros((len(self.vertices), 0, 3))

    def rigid(self) -> Array:
        """Return the velocities (n, 6, 3) of vertices as their mesh is shifted or turned.

        Shifts along the axes come first, per metre, then turns about them through the mean of the
        mesh's vertices, per radian.
        """
        speeds = np.zeros((len(self.vertices), 6, 3))
        speeds[:, :3] = np.eye(3)
        for first, last in self.groups[:, :2]:
            arm = self.vertices[first:last] - self.vertices[first:last].mean(axis=0)
            speeds[first:last, 3:] = np.cross(np.eye(3), arm[:, None])
        return speeds


def in_bands(kernel: Any, nodes: tuple[NDArray[Any], ...], *arguments: Any) -> None:
    """Run a kernel for bands of the pixels in several threads; the last argument is its output.

    The last of ``nodes`` are points of the lens, and the others are divided into the bands.
    """
    *others, out = arguments

    def band(start: int) -> None:
        rows = slice(start, start + 32)
        kernel((*(array[rows] for array in nodes[:-1]), nodes[-1]), *others, out[rows])

    list(worker_pool().map(band, range(0, len(out), 32)))


def checked_planes(
    name: str, values: ArrayLike, shape: tuple[int, int], *, single: bool = False
) -> Array:
    """Return values as finite float64 of a shape (..., rows, columns), or (rows, columns) alone."""
    array = numbers(name, values)
    if array.shape[-2:] != shape or (single and array.ndim > 2):
        raise SceneError(
            f"{name} has the shape {array.shape}, must {'be' if single else 'end with'} {shape}; "
            "resample it, or build the operator with other cells and pixels"
        )
    if not np.isfinite(array).all():
        raise SceneError(
            f"{name} has {np.count_nonzero(~np.isfinite(array))} values that are not finite, limit "
            "0; replace them"
        )
    return array
