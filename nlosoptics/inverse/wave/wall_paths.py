"""Path lengths via a curved wall, with derivatives by radius, object and pupil points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import normalize

from ...psf.pupil.aiming import aim
from ...scene import ConcaveWall, ConvexWall, Wall

Array = NDArray[np.float64]
CurvedWall = ConcaveWall | ConvexWall


class WallPaths(torch.autograd.Function):
    """Path lengths object - wall - pupil minus the distance from the mirrored object point.

    ``apply(radius, object_point, points, axis, wall)`` takes float64 tensors of shape (), (3,),
    `(n, 3)` and (3,), world frame, m; ``axis`` is the pupil plane's normal. It returns the excess
    (n,), m, as in `psf.wall_aberration`, and the wall points (n, 3), m. Wall points and axis have
    no gradient. The radius replaces that of a `ConcaveWall` or `ConvexWall`; other walls are
    unchanged.

    Notes
    -----
    A path is stationary at its wall point H (Fermat), so that its derivative is the explicit one at
    fixed H. With respect to O and p this is a unit vector along the leg. With respect to the radius
    it is the sum of the legs' cosines times the change of the wall's height at H.
    """

    @staticmethod
    def forward(
        radius: Tensor, object_point: Tensor, points: Tensor, axis: Tensor, wall: Wall
    ) -> tuple[Tensor, Tensor]:
        """Return path excess (n,), m, and wall points (n, 3), m."""
        if isinstance(wall, CurvedWall):
            wall = replace(wall, radius=float(radius))
        o, nodes, normal = (tensor.detach().numpy() for tensor in (object_point, points, axis))
        rays = aim(wall, o, np.ascontiguousarray(nodes), normal)
        return torch.from_numpy(rays.excess.copy()), torch.from_numpy(rays.points.copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        """Save the tensors that the gradient needs."""
        radius, object_point, points, _, ctx.wall = inputs
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(radius, object_point, points, output[1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients with respect to radius, object point and pupil points."""
        radius, object_point, points, hits = ctx.saved_tensors
        mirror = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
        to_object, to_points = normalize(object_point - hits), normalize(points - hits)
        straight = normalize(points - object_point * mirror)
        by_object = to_object + mirror * straight
        by_points = to_points - straight
        lift = torch.from_numpy(height_by_radius(ctx.wall, float(radius), hits.numpy()))
        by_radius = -(to_object + to_points)[:, 2] * lift
        return (
            (gradient * by_radius).sum(),
            (gradient[:, None] * by_object).sum(dim=0),
            gradient[:, None] * by_points,
            None,
            None,
        )


def height_by_radius(wall: Wall, radius: float, hits: Array) -> Array:
    """Return the derivative of the wall's height by its radius, (n,), at wall points (n, 3).

    It is 0 for walls without a radius.
    """
    if not isinstance(wall, CurvedWall):
        return np.zeros(len(hits))
    square = np.sum(hits[:, :2] ** 2, axis=1)
    if wall.shape == "cylinder":
        square = hits[:, 0 if wall.axis == "y" else 1] ** 2
    # h = R - sqrt(R^2 - s^2) toward the room of a hollow wall
    depth = np.sqrt(radius**2 - square)
    slope = -square / (depth * (depth + radius))
    return np.asarray(slope if isinstance(wall, ConcaveWall) else -slope)
