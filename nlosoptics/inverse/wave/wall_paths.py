"""Paths by a curved wall, with derivatives by all that moves them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...psf.pupil.aiming import aim
from ...scene import ConcaveWall, ConvexWall, Wall

Array = NDArray[np.float64]
CurvedWall = ConcaveWall | ConvexWall


class WallPaths(torch.autograd.Function):
    """Path lengths O - wall - p over the distance from the mirrored O, as `psf.wall_aberration`.

    ``apply(radius, object_point, points, axis, wall)`` with tensors of shape (), (3,), (n, 3) and
    (3,), float64, world, m, gives the paths (n,), m, and their wall points (n, 3), which have no
    gradient; nor has the axis, the pupil plane's normal. The radius replaces that of a
    `ConcaveWall` or `ConvexWall`, other walls stay.

    Notes
    -----
    A path is stationary in its wall point H (Fermat), so that its derivative is the explicit one
    at fixed H: unit vectors along the legs by O and by p, and by the radius the sum of the legs'
    cosines times what the wall's height changes by under H.
    """

    @staticmethod
    def forward(
        radius: Tensor, object_point: Tensor, points: Tensor, axis: Tensor, wall: Wall
    ) -> tuple[Tensor, Tensor]:
        """Excess paths (n,), and where they meet the wall (n, 3)."""
        wall = with_radius(wall, float(radius))
        o, nodes, normal = (tensor.detach().numpy() for tensor in (object_point, points, axis))
        rays = aim(wall, o, np.ascontiguousarray(nodes), normal)
        return torch.from_numpy(rays.excess.copy()), torch.from_numpy(rays.points.copy())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        """Keep what the explicit derivative needs."""
        radius, object_point, points, _, ctx.wall = inputs
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(radius, object_point, points, output[1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients by radius, object point and pupil points."""
        radius, object_point, points, hits = ctx.saved_tensors
        mirror = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
        to_object, to_points = _unit(object_point - hits), _unit(points - hits)
        straight = _unit(points - object_point * mirror)
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


def with_radius(wall: Wall, radius: float) -> Wall:
    """The wall, with another radius if it is a sphere or cylinder."""
    return replace(wall, radius=radius) if isinstance(wall, CurvedWall) else wall


def height_by_radius(wall: Wall, radius: float, hits: Array) -> Array:
    """Derivative of a wall's height by its radius at points (n, 3), (n,); 0 of other walls."""
    if not isinstance(wall, CurvedWall):
        return np.zeros(len(hits))
    square = np.sum(hits[:, :2] ** 2, axis=1)
    if wall.shape == "cylinder":
        square = hits[:, 0 if wall.axis == "y" else 1] ** 2
    # h = R - sqrt(R^2 - s^2) toward the room of a hollow wall
    depth = np.sqrt(radius**2 - square)
    slope = -square / (depth * (depth + radius))
    return np.asarray(slope if isinstance(wall, ConcaveWall) else -slope)


def _unit(vectors: Tensor) -> Tensor:
    unit: Tensor = vectors / vectors.norm(dim=-1, keepdim=True)
    return unit
