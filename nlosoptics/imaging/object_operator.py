"""Camera image as a linear operator on the picture of the hidden object."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..psf import PointSpread, PointSpreadField
from ..scene import PlanarObject, Scene
from .forward_model import ForwardModel
from .geometry import (
    Footprints,
    chief_rays,
    picture_coordinates,
    picture_points,
    picture_positions,
    pixel_edges,
)
from .images import diffuse_background, mirror_image, point_background
from .lit_walls import lit_transports, picture_cells
from .radiometry import Chebyshev
from .shadows import Shadows
from .wall_transport import WallTransport

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ObjectOperator:
    """Object's part of the mean image as a linear function of its picture, and the adjoint.

    The mirror-like image is linear in the picture. Diffuse light of `form_image` is that of
    patches, whose places depend a little on the picture (see `objects.object_patches`); here it is
    the exact sum, from which it differs by some 1e-4.
    """

    scene: Scene  # with a picture of the right shape
    spread: PointSpread | PointSpreadField | None
    shadows: Shadows | None  # without interpolation; None without occluders
    tol: float = 1e-5  # of the diffuse light as a function of places on the picture
    most_cells: int = 32  # of a picture along each side, past occluders

    def forward(self, picture: Array) -> Array:
        """Return the electrons (ny, nx) of a picture's light."""
        result = np.zeros(self.scene.camera.shape)
        if self.spread is not None:
            model, footprints, white = self._mirror
            result += model.forward(white * footprints.average(picture))
        if self.scene.wall_material.diffuse is None:
            return result
        if self.shadows is None:
            (rows, columns), images = self._nodes
            return result + np.tensordot(rows.T @ picture @ columns, images)
        return result + self._scale * self._transported(picture)

    def adjoint(self, values: Array) -> Array:
        """Return values of the texels from values (ny, nx) of the pixels."""
        result = np.zeros(self._texels)
        if self.spread is not None:
            model, footprints, white = self._mirror
            result += footprints.adjoint(white * model.adjoint(values))
        if self.scene.wall_material.diffuse is None:
            return result
        if self.shadows is None:
            (rows, columns), images = self._nodes
            return result + rows @ np.tensordot(images, values) @ columns.T
        _, blocks = self._cells
        values = self._scale * values
        total = sum(t.adjoint(values) * scale for t, scale in self._transports)
        return np.asarray(result + np.kron(total, np.ones(blocks)) / math.prod(blocks))

    @property
    def _hidden(self) -> PlanarObject:
        assert isinstance(self.scene.hidden, PlanarObject)  # checked by SceneModel
        return self.scene.hidden

    @property
    def _texels(self) -> tuple[int, int]:
        rows, columns = self._hidden.reflectance.shape
        return rows, columns

    @cached_property
    def _mirror(self) -> tuple[ForwardModel, Footprints, Array]:
        """Blur, footprints of the pixels, and the electrons of a white object before the blur."""
        scene, ones = self.scene, np.ones(self._texels)
        bright = replace(scene, hidden=replace(self._hidden, image=ones))
        rays, image = mirror_image(bright, self.shadows)
        at = None
        if isinstance(self.spread, PointSpreadField):
            at = picture_positions(self._hidden, rays)
        model = ForwardModel(self.spread, shape=image.shape, at=at)
        corners = chief_rays(scene, *pixel_edges(scene.camera))
        footprints = Footprints(
            (len(ones), ones.shape[1]), *picture_coordinates(self._hidden, corners)
        )
        share = footprints.average(ones)
        white = np.divide(image, share, out=np.zeros_like(image), where=share > 0.0)
        return model, footprints, white

    @cached_property
    def _nodes(self) -> tuple[list[Array], Array]:
        """Interpolation from nodes on the picture to its texels, (2, n, nodes), and their images.

        The images are those of a texel at each node. They are analytic functions of the place, up
        to the distance of the wall in units of the picture's half side.
        """
        hidden = self._hidden
        right, up, _ = hidden.axes
        drop = (hidden.size[0] * abs(right[2]) + hidden.size[1] * abs(up[2])) / 2
        near = 2.0 * (hidden.position[2] - drop) / max(hidden.size)
        count = math.ceil(-math.log(self.tol) / math.asinh(near))
        axes = [Chebyshev(np.array([0.0, n]), min(count, 16)) for n in self._texels]
        row, column = np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij")
        points = picture_points(hidden, column.ravel(), row.ravel())
        area = math.prod(hidden.size) / math.prod(self._texels)
        images = point_background(self.scene, points, area).reshape(
            *row.shape, *self.scene.camera.shape
        )
        # means over the texels, by three Gauss points
        inside, weights = np.polynomial.legendre.leggauss(3)
        texels = [np.arange(n)[:, None] + (1.0 + inside) / 2 for n in self._texels]
        means = [(weights / 2) @ axis.basis(at) for axis, at in zip(axes, texels, strict=True)]
        return means, images

    @cached_property
    def _cells(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Rows and columns of cells, and the texels in each, past occluders."""
        texels = self._texels
        rows, columns = (
            max(k for k in range(1, min(n, self.most_cells) + 1) if n % k == 0) for n in texels
        )
        return (rows, columns), (texels[0] // rows, texels[1] // columns)

    @cached_property
    def _transports(self) -> list[tuple[WallTransport, float]]:
        material = self.scene.wall_material.diffuse
        assert material is not None  # see forward
        # as many points of the wall as the shadows of images take
        cells = picture_cells(self.scene, material, self._texels)
        samples = WallTransport(self.scene, cells=cells, material=material)._samples
        cells = self._cells[0]
        return lit_transports(self.scene, cells=cells, material=material, samples=samples)

    def _transported(self, picture: Array) -> Array:
        """Return the diffuse light (ny, nx) of a picture by `WallTransport`."""
        cells, blocks = self._cells
        means = picture.reshape(cells[0], blocks[0], cells[1], blocks[1]).mean(axis=(1, 3))
        return np.asarray(sum(t.forward(means) * scale for t, scale in self._transports))

    @cached_property
    def _scale(self) -> Array | float:
        """Diffuse light of `form_image`, which is that of pixel centres, over that of pixels."""
        if not self._hidden.reflectance.any():
            return 1.0
        image = diffuse_background(self.scene, shadows=self.shadows)
        light = self._transported(self._hidden.reflectance)
        return np.divide(image, light, out=np.ones_like(light), where=light > 0.0)
