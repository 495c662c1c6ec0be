"""Linear model of a wall's scattered light: from the cells of a hidden plane to the pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import ArrayLike, NDArray

from .._checks import (
    available_memory,
    fits_memory,
    in_range,
    one_of,
    positive,
    vector,
    whole,
    whole_pair,
)
from .._nouns import Noun
from ..errors import SamplingError
from ..kernels.codes import LAMBERT, RETROREFLECTOR
from ..raytrace import occluded
from ..scene import Material, Occluder, Scene
from .geometry import chief_rays
from .objects import plate
from .penumbra import Edges, checked_planes, in_bands
from .radiometry import (
    check_beam,
    has_highlight,
    laser_spot,
    spot_irradiance,
    visible_shares,
    wall_lobes,
    wall_paths,
)
from .thin_factors import thin_factors

if TYPE_CHECKING:
    import trimesh
    from scipy.sparse.linalg import LinearOperator

Array = NDArray[np.float64]

FINE = 40  # samples per distance between plane and wall: the midpoint rule errs by 2e-4
MOST_SAMPLES = 1024  # of the plane along one side


@dataclass(frozen=True, eq=False)
class WallTransport(Noun):
    """Electrons in each pixel for each cell of a hidden plane, by way of the scattering wall.

    The camera looks at the wall. The light of the hidden plane, divided into cells of uniform
    brightness f, makes the wall shine, and ``y = A f`` are the electrons in the pixels. Occluders
    cast shadows with exact penumbrae. On a matt wall, these shadows carry nearly all that an image
    tells about the plane.

    Parameters
    ----------
    scene : Scene
        Scene. Its hidden object gives the plane, and not the picture on it; a mesh is replaced by
        a plate of its width and height that faces the wall. All occluders must be black.
    cells : (int, int)
        Rows and columns of cells.
    pixels : (int, int), optional
        Rows and columns of detector areas of equal size; by default the camera's image pixels.
    exposure : float, optional
        Exposure time, s; by default the camera's.
    source : {"laser", "luminous", "ambient"}
        What makes the plane bright, and with it the unit of f. "laser": the laser's spot on the
        wall; f is the reflectance relative to ``scene.hidden.material``. "luminous": the plane
        itself; f is its radiance along the normal, W/(m^2 sr). "ambient": light from all sides that
        no occluder shades; f is its irradiance times the relative reflectance, W/m^2, reflected as
        by a matt surface with the albedo of ``scene.hidden.material`` at normal incidence.
    lobe : (float, float)
        For a luminous plane, powers p and q of its radiance ``f cos(a)^p cos(b)^q``, in which a and
        b are the angles to the normal of the direction projected to the horizontal and to the
        vertical plane. (0, 0) is a matt source.
    material : Material, optional
        Reflection of the wall; by default that of the scene without perfectly smooth lobes, which
        form an image instead (see `form_image`).
    samples : int, optional
        Points of the wall for each pixel. By default as many as the shadows need, 5 to 64.

    Attributes
    ----------
    cell_shape, pixel_shape : (int, int)
        Rows and columns. Row 0 of the cells is on top, as in a picture; row 0 of the pixels is at
        the lowest y of the detector, as in `SpeckleImage`.

    Raises
    ------
    SceneError
        If an argument is out of range, an occluder reflects light or cuts the laser's beam, or the
        beam misses the wall.
    SamplingError
        If a lobe is too narrow for the cells.
    MemoryLimitError
        If the matrix, or the wall points of all pixels, would not fit in memory.

    See Also
    --------
    form_image : Image in electrons, with noise.
    ForwardModel : Image of the mirror-like lobes.

    Notes
    -----
    A pixel's row of A is the mean over wall points w of

    ``gain sum_x dA V(w, x) f_r(x - w, lens - w) cos(w) L(x, w - x) cos(x)/|x - w|^2``

    with the radiance L of cell point x at f = 1, and electrons per radiance ``gain``. V is the
    share of the cell that w sees and the laser's spot lights. All occluders are projected from w,
    and from the spot, onto the plane, and the union of these shadows is clipped to each cell; the
    area that remains is exact. The wall points lie on a lattice over the area of the wall that a
    pixel sees, each with its own point of the lens, by which defocus is included. Their way to the
    lens is free or blocked. Light that is reflected more than once between wall and plane is
    neglected, and so is the shade of a curved wall on itself.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import Scene, imaging
    >>> scene = Scene.load("examples/scenes/letter_occluder.toml")
    >>> transport = imaging.WallTransport(scene, cells=(6, 6), pixels=(4, 4))
    >>> transport.matrix.shape, transport.forward(np.ones((6, 6))).shape
    ((16, 36), (4, 4))
    """

    scene: Scene
    _: KW_ONLY
    cells: tuple[int, int]
    pixels: tuple[int, int] | None = None
    exposure: float | None = None
    source: Literal["laser", "luminous", "ambient"] = "laser"
    lobe: tuple[float, float] = (0.0, 0.0)
    material: Material | None = None
    samples: int | None = None

    def __post_init__(self) -> None:
        one_of("source", self.source, ("laser", "luminous", "ambient"))
        camera = self.scene.camera
        exposure = camera.exposure if self.exposure is None else self.exposure
        values: dict[str, Any] = {
            "cells": whole_pair("cells", self.cells, (MOST_SAMPLES, MOST_SAMPLES)),
            "pixels": whole_pair("pixels", self.pixels or camera.shape, camera.shape),
            "exposure": positive("exposure", exposure, unit="s"),
            "lobe": tuple(in_range("lobe", power, 0.0, 1e3) for power in self.lobe),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.samples is not None:
            whole("samples", self.samples, 1, 4096)
        self.scene.check_black_occluders()

    @property
    def cell_shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.cells

    @property
    def pixel_shape(self) -> tuple[int, int]:
        """Rows and columns of pixels."""
        assert self.pixels is not None  # set by __post_init__
        return self.pixels

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pixels and of cells, the shape of the matrix."""
        return math.prod(self.pixel_shape), math.prod(self.cells)

    @cached_property
    def matrix(self) -> Array:
        """A, (n_pixels, n_cells) float64, read-only; pixels and cells in rows, row by row."""
        count, n_cells = self.shape
        fits_memory(
            f"a matrix of {count} pixels by {n_cells} cells",
            8 * count * n_cells,
            "use fewer pixels or cells; forward and adjoint need no matrix",
        )
        matrix = self._rows(slice(0, count))
        matrix.flags.writeable = False
        return matrix

    def forward(self, f: ArrayLike) -> Any:
        """Return the electrons ``A f``.

        Parameters
        ----------
        f : array_like or torch.Tensor, (..., rows, columns)
            Brightness of the cells; see ``source`` for its unit.

        Returns
        -------
        ndarray or torch.Tensor, (..., rows, columns)
            Electrons in the pixels, of the kind of ``f``. Tensors pass gradients.

        Raises
        ------
        SceneError
            If ``f`` has another shape or is not finite.
        """
        return self._applied("f", f, self.cells, self.pixel_shape, transposed=False)

    def adjoint(self, y: ArrayLike) -> Any:
        """Return ``A^T y``, the adjoint of `forward`.

        Parameters
        ----------
        y : array_like or torch.Tensor, (..., rows, columns)
            Values of the pixels.

        Returns
        -------
        ndarray or torch.Tensor, (..., rows, columns)
            Values of the cells, of the kind of ``y``.

        Raises
        ------
        SceneError
            If ``y`` has another shape or is not finite.
        """
        return self._applied("y", y, self.pixel_shape, self.cells, transposed=True)

    def linear_operator(self) -> LinearOperator:
        """Return A as a `scipy.sparse.linalg.LinearOperator`."""
        return scipy.sparse.linalg.LinearOperator(
            self.shape,
            matvec=lambda f: self.forward(f.reshape(self.cells)).ravel(),
            rmatvec=lambda y: self.adjoint(y.reshape(self.pixel_shape)).ravel(),
            dtype=np.float64,
        )

    def factors(self, tol: float = 1e-3) -> tuple[Array, Array]:
        """Factorise A into thin matrices, by a randomised singular value decomposition.

        Parameters
        ----------
        tol : float
            Largest singular value that is left out, relative to the largest of all, 1e-12 to 0.5.

        Returns
        -------
        left : ndarray, (n_pixels, rank)
            Left singular vectors times singular values.
        right : ndarray, (rank, n_cells)
            Right singular vectors; A is close to ``left @ right``.

        Raises
        ------
        SceneError
            If ``tol`` is out of range.
        """
        return thin_factors(self, in_range("tol", tol, 1e-12, 0.5))

    def with_occluders(self, occluders: Sequence[Occluder | trimesh.Trimesh]) -> WallTransport:
        """Return the operator with other occluders; wall points of the pixels are shared.

        Parameters
        ----------
        occluders : sequence of Occluder or trimesh.Trimesh
            Black occluders of the new scene.

        Returns
        -------
        WallTransport
            New operator with the same ``samples``.

        Raises
        ------
        SceneError
            If an occluder is of another type, reaches behind the wall or reflects light.
        """
        scene = replace(self.scene, occluders=tuple(occluders))
        changed = replace(self, scene=scene, samples=self._samples)
        vars(changed)["_paths"] = self._paths
        return changed

    def moved(
        self, occluder: int, shift: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)
    ) -> WallTransport:
        """Return the operator with one occluder in another place.

        Parameters
        ----------
        occluder : int
            Index of the occluder in the scene.
        shift : array_like, (3,)
            Shift along the axes of the world frame, m.
        turn : array_like, (3,)
            Axis of a rotation times its angle, rad, about the mean of the occluder's vertices.

        Returns
        -------
        WallTransport
            New operator with the same ``samples``.

        Raises
        ------
        SceneError
            If an argument is out of range, or the occluder reaches behind the wall.
        """
        index = whole("occluder", occluder, 0, len(self.scene.occluders) - 1)
        offset, angles = np.array(vector("shift", shift)), np.array(vector("turn", turn))
        mesh = self.scene.occluder_surfaces[index][0].copy()
        centre = self._centre(index)
        rotation = scipy.spatial.transform.Rotation.from_rotvec(angles)
        mesh.vertices = centre + offset + rotation.apply(mesh.vertices - centre)
        occluders = list(self.scene.occluders)
        occluders[index] = mesh
        return self.with_occluders(occluders)

    def pose_derivative(self, f: ArrayLike, occluder: int = 0) -> Array:
        """Return the derivatives of ``A f`` as an occluder is shifted and turned.

        Parameters
        ----------
        f : array_like, (rows, columns)
            Brightness of the cells.
        occluder : int
            Index of the occluder in the scene.

        Returns
        -------
        ndarray, (6, rows, columns)
            Derivatives by the shift along x, y and z, electrons/m, and by the turns about these
            axes, electrons/rad, as `moved` defines them. The part of the wall that the occluder
            hides from the lens is taken as fixed.

        Raises
        ------
        SceneError
            If ``f`` has another shape or is not finite, or ``occluder`` is out of range.
        """
        index = whole("occluder", occluder, 0, len(self.scene.occluders) - 1)
        values = checked_planes("f", f, self.cells, single=True).reshape(1, -1)
        rates = self._rates(values, np.zeros(self.shape[0], dtype=np.int64))[:, index]
        return np.ascontiguousarray(rates.T).reshape(6, *self.pixel_shape)

    def pose_gradient(self, weights: ArrayLike) -> Array:
        """Return the derivatives of the sum of ``weights * matrix`` by all poses of occluders.

        Parameters
        ----------
        weights : array_like, (n_pixels, n_cells)
            Weights, such as the derivatives of a figure of merit by the elements of the matrix.

        Returns
        -------
        ndarray, (n_occluders, 6)
            Derivatives by the shift of each occluder along x, y and z, 1/m, and by its turns about
            these axes, 1/rad; see `pose_derivative`.

        Raises
        ------
        SceneError
            If ``weights`` has another shape or is not finite.
        """
        values = checked_planes("weights", weights, self.shape, single=True)
        return np.asarray(self._rates(values, np.arange(len(values))).sum(axis=0))

    def _rates(self, values: Array, which: NDArray[np.int64]) -> Array:
        """Return rates (n_pixels, n_occluders, 6) of each pixel's light from ``values[which]``."""
        from . import _penumbra_kernels

        out = np.zeros((len(which), len(self.scene.occluders), 6))
        *paths, lens = self._open_paths(slice(None))
        nodes, *arguments = self._arguments((*paths, which, lens), self._edges.rigid())
        in_bands(_penumbra_kernels.fill_rates, nodes, *arguments, self._parts, values, out)
        return out

    def _applied(
        self,
        name: str,
        values: Any,
        shape: tuple[int, int],
        result: tuple[int, int],
        *,
        transposed: bool,
    ) -> Any:
        """Return the product of arrays (..., *shape) with A or its transpose."""
        if hasattr(values, "new_tensor"):
            if tuple(values.shape[-2:]) != shape:
                checked_planes(name, np.empty(tuple(values.shape)), shape)
            cached = vars(self).setdefault("_tensors", {})
            key = str((values.dtype, values.device))
            if key not in cached:
                cached[key] = values.new_tensor(self.matrix)
            matrix = cached[key] if transposed else cached[key].T
            return (values.reshape(-1, math.prod(shape)) @ matrix).reshape(
                *values.shape[:-2], *result
            )
        array = checked_planes(name, values, shape)
        flat = array.reshape(-1, math.prod(shape))
        total = np.zeros((len(flat), math.prod(result)))
        for rows, block in self._blocks():
            if transposed:
                total += flat[:, rows] @ block
            else:
                total[:, rows] = flat @ block.T
        return total.reshape(*array.shape[:-2], *result)

    def _blocks(self) -> Iterator[tuple[slice, Array]]:
        """Yield slices of the pixels and their rows of A: all at once if they fit in memory."""
        count, n_cells = self.shape
        if "matrix" in vars(self) or 8.0 * count * n_cells < available_memory() / 4:
            yield slice(0, count), self.matrix
            return
        step = max(1, 2**25 // n_cells)
        for start in range(0, count, step):
            rows = slice(start, min(start + step, count))
            yield rows, self._rows(rows)

    def _rows(self, rows: slice) -> Array:
        from . import _penumbra_kernels

        out = np.empty((rows.stop - rows.start, self.shape[1]))
        arguments = self._arguments(self._open_paths(rows), self._edges.still())
        in_bands(_penumbra_kernels.fill_rows, *arguments, self._parts, out)
        return out

    def _open_paths(self, rows: slice) -> tuple[Array, Array, Array, Array]:
        """Return the wall points of some pixels, without those that an occluder hides."""
        points, normals, weights, lens = self._paths
        mesh, free = self.scene.occluding_mesh, weights[rows]
        if mesh is not None:
            way = np.broadcast_to(lens, points[rows].shape)
            free = free * ~occluded(mesh, way, points[rows])
        return points[rows], normals[rows], free, lens

    def _arguments(
        self,
        nodes: tuple[NDArray[Any], ...],
        speeds: Array,
        finer: tuple[int, int] = (1, 1),
    ) -> tuple[Any, ...]:
        """Return the arguments that the kernels share, for the wall points of some pixels.

        Shadows are cut into ``finer`` parts of the plane's samples, down and across.
        """
        from . import _penumbra_kernels

        (n_rows, n_columns), frame, plane = self._samples_of_plane
        n_rows, n_columns = n_rows * finer[0], n_columns * finer[1]
        frame = frame * np.array([1, finer[1], finer[0], 1])[:, None]
        arrays, most = self._edges.arrays, 0
        if self.source == "laser":
            most = len(arrays[2]) + 5 * len(arrays[1])
        spot: Any = (
            np.empty((most, 5)),
            np.empty(most, np.int64),
            np.empty((most, speeds.shape[1], 4)),
        )
        if most:
            # a copy, since numba would compile the kernel again for a read-only array
            point = laser_spot(self.scene).point.copy()
            count = _penumbra_kernels.outline(
                point, frame, (n_rows, n_columns), arrays, speeds, *spot, 0
            )
            spot = tuple(array[:count] for array in spot)
        return nodes, frame, plane, arrays, speeds, spot, self._wall_lobes, self._radiance

    @cached_property
    def _edges(self) -> Edges:
        return Edges.of([mesh for mesh, _ in self.scene.occluder_surfaces])

    def _centre(self, occluder: int) -> Array:
        first, last = self._edges.groups[occluder, :2]
        return np.asarray(self._edges.vertices[first:last].mean(axis=0))

    @cached_property
    def _wall_lobes(self) -> Array:
        return wall_lobes(self.scene, self.material)

    @cached_property
    def _parts(self) -> tuple[int, int]:
        """Rows and columns of samples in each cell."""
        centre, (right, up, _), size = plate(self.scene)
        nearest = centre[2] - (size[0] * abs(right[2]) + size[1] * abs(up[2])) / 2
        tables = [self._wall_lobes]
        if self.source == "laser":
            tables.append(self.scene.hidden.material.lobe_table())
        slopes = [row[2] for table in tables for row in table if row[0] >= RETROREFLECTOR]
        step = nearest * min(1.0 / FINE, *(slope / 2 for slope in slopes), 1.0)
        parts = []
        for count, side in zip(self.cells, size[::-1], strict=True):
            parts.append(math.ceil(side / count / step))
            if count * parts[-1] > max(MOST_SAMPLES, 2 * count):
                raise SamplingError(
                    f"a mirror-like lobe of rms slope {min(slopes):.3g} needs samples of "
                    f"{step:.3g} m on the plane of {side:g} m, limit {MOST_SAMPLES} along a side; "
                    "leave it out with material=, and form its image by form_image"
                )
        return parts[0], parts[1]

    @cached_property
    def _samples_of_plane(self) -> tuple[tuple[int, int], Array, tuple[Array, float]]:
        """Rows and columns of samples, and the kernels' ``frame`` and ``plane``."""
        centre, (right, up, normal), (width, height) = plate(self.scene)
        rows, columns = (n * parts for n, parts in zip(self.cells, self._parts, strict=True))
        corner = centre - right * width / 2 + up * height / 2
        across, down = right * width / columns, -up * height / rows
        frame = np.array([corner, right * columns / width, -up * rows / height, normal])
        axes = np.array([corner + (across + down) / 2, across, down, normal, right, up])
        return (rows, columns), frame, (axes, width * height / (rows * columns))

    @cached_property
    def _radiance(self) -> tuple[Array, Array, Array, int]:
        """Radiance of the plane's samples, as the kernels take it."""
        shape, _, (axes, _) = self._samples_of_plane
        table, kind = np.zeros((1, 7)), 0
        radiance, to_spot = np.ones(shape), np.zeros((0, 0, 3))
        material = self.scene.hidden.material
        if self.source == "ambient":
            radiance *= float(material.albedo(0.0)) / math.pi
        elif self.source == "luminous" and any(self.lobe):
            kind = 2
            table[0, :2] = self.lobe
        elif self.source == "laser":
            spot, mesh = laser_spot(self.scene), self.scene.occluding_mesh
            if mesh is not None:
                check_beam(self.scene, mesh, spot)
            row, column = (index[..., None] for index in np.indices(shape))
            to_spot = spot.point - (axes[0] + column * axes[1] + row * axes[2])
            to_spot /= np.linalg.norm(to_spot, axis=-1, keepdims=True)
            # a highlight may be narrower than a sample, which gets its mean
            count = 1
            if has_highlight(self.scene):
                blur = min(slope for slope in self.scene.mirror_slopes if slope > 0.0)
                blur *= float(np.linalg.norm(self.scene.object_point - spot.point)) / 2
                count = min(64, math.ceil(float(np.abs(axes[1:3]).max()) / blur))
            inside = (np.arange(count) + 0.5) / count - 0.5
            across = np.add.outer(np.arange(shape[1]), inside).ravel()[:, None]
            for i in range(shape[0]):
                points = axes[0] + across * axes[1] + (i + inside)[:, None, None] * axes[2]
                light = spot_irradiance(self.scene, spot, points, axes[3])[0]
                radiance[i] = light.reshape(count, shape[1], count).mean(axis=(0, 2))
            table, kind = material.lobe_table(), 1
            if (table[:, 0] == LAMBERT).all():
                radiance, kind = radiance * float((table[:, 1] * table[:, 3]).sum()) / math.pi, 0
        return radiance, np.ascontiguousarray(to_spot), np.ascontiguousarray(table), kind

    @cached_property
    def _samples(self) -> int:
        """Wall points of each pixel."""
        if self.samples is not None:
            return self.samples
        centre, _, size = plate(self.scene)
        need = self._step * FINE / centre[2]
        cell = min(side / count for side, count in zip(size, self.cells[::-1], strict=True))
        for mesh, _ in self.scene.occluder_surfaces:
            near = max(float(mesh.vertices[:, 2].min()), 0.02 * centre[2])
            if near < centre[2]:
                need = max(need, 3.0 * self._step * (centre[2] - near) / near / cell)
        return int(min(max(need * need, 5.0), 64.0))

    @cached_property
    def _step(self) -> float:
        """Side of the area of the wall that a pixel sees, m; inf if the wall is narrower."""
        x, y, _ = self._bins()
        points = chief_rays(
            self.scene, *(np.append(c - d / 2, c[-1] + d / 2) for c, d in (x, y))
        ).points
        steps = (np.linalg.norm(np.diff(points, axis=axis), axis=-1) for axis in (0, 1))
        return max(float(np.median(s[s < np.inf] if (s < np.inf).any() else np.inf)) for s in steps)

    def _bins(self) -> tuple[tuple[Any, float], tuple[Any, float], float]:
        """Return centres and sides of the detector's areas along x and y, m, and their pixels."""
        camera = self.scene.camera
        axes = []
        for count, side in zip(self.pixel_shape[::-1], camera.shape[::-1], strict=True):
            pitch = camera.image_pitch * side / count
            axes.append(((np.arange(count) - (count - 1) / 2) * pitch, pitch))
        return axes[0], axes[1], math.prod(camera.shape) / self.shape[0]

    @cached_property
    def _paths(self) -> tuple[Array, Array, Array, Array]:
        """Wall points of all pixels, see `_traced`."""
        fits_memory(
            f"{self._samples} wall points for each of {self.shape[0]} pixels",
            160 * self._samples * self.shape[0],
            "use fewer pixels or samples",
        )
        (x, width), (y, height), _ = self._bins()
        visible = visible_shares(self.scene, (x, y), (width, height), self.pixel_shape)
        return self._traced(x, y, visible)

    def _traced(self, x: Array, y: Array, visible: Array) -> tuple[Array, Array, Array, Array]:
        """Return `wall_paths` of pixels centred at ``x`` and ``y``."""
        assert self.exposure is not None  # set by __post_init__
        self.scene.check_in_front()
        (_, width), (_, height), pixels = self._bins()
        centres, sides = (x, y), (width, height)
        paths = wall_paths(self.scene, centres, sides, visible, self._samples, self.exposure)
        return paths[0], paths[1], pixels * paths[2], paths[3]
