"""Ray aiming: the paths from an object point by the relay wall to given points of a pupil."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import vector
from ..._vectors import Array
from ...errors import CausticError, SceneError
from ...scene import CallableWall, Scene, Wall
from ...scene.parts.camera import pupil_frame


@dataclass(frozen=True, eq=False, kw_only=True)
class AimedRays:
    """Stationary paths from an object point by the wall to pupil points."""

    points: Array  # (n, 3); Points at which the paths meet the wall, world frame, m
    excess: Array  # (n,); Path length minus the distance from the mirrored object point, m
    spreading: Array  # (n,); Irradiance on the pupil plane per unit radiant intensity, 1/m^2


def point_of(scene: Scene, object_point: ArrayLike | None) -> Array:
    """Return an object point (3,), m; by default the reference point of the hidden object."""
    if object_point is None:
        return scene.object_point
    return np.array(vector("object_point", object_point))


def aim(wall: Wall, object_point: ArrayLike, nodes: Array, axis: Array) -> AimedRays:
    """Find the stationary path from an object point by the wall to each pupil node (n, 3), m.

    Points are in the world frame, and ``axis`` is the unit normal of the pupil plane. Raises
    `CausticError` if several rays or none reach a node, or rays to the pupil cross.
    """
    o = np.array(vector("object_point", object_point))
    for name, height in (("object_point", o[2]), ("pupil", float(nodes[:, 2].min()))):
        if height <= 0:
            raise SceneError(f"{name} has z = {height:g} m, behind the wall; must be above 0")
    share = o[2] / (o[2] + nodes[:, 2])
    mirror_hits = o + share[:, None] * (nodes - o)
    if wall.is_flat:
        legs = np.linalg.norm(nodes - o * (1, 1, -1), axis=1)
        cosine = abs((nodes - o * (1, 1, -1)) @ axis) / legs
        mirror_hits[:, 2] = 0.0
        zeros, spreading = np.zeros(len(nodes)), cosine / legs**2
        return AimedRays(points=mirror_hits, excess=zeros, spreading=spreading)
    out = _stationary_paths(wall, o, nodes, mirror_hits[:, :2], axis)
    lost = out[:, 7] == 0
    if lost.any():
        where = _caustic(wall, o, nodes[0], mirror_hits[0] * (1, 1, 0))
        raise CausticError(
            f"no stationary path by the wall was found to {int(lost.sum())} of {len(nodes)} pupil "
            f"nodes, first node {int(np.argmax(lost))}: {where}"
        )
    curvature = out[:, 6]
    if out[:, 5].min() <= 0 <= out[:, 5].max() or curvature.min() < 0 < curvature.max():
        raise CausticError(
            f"rays to the pupil cross on a caustic (over the pupil the path's smaller curvature "
            f"runs from {curvature.min():.3g} to {curvature.max():.3g} 1/m): "
            f"{_caustic(wall, o, nodes[0], out[0, :3])}"
        )
    _refuse_several_paths(wall, o, nodes, axis, out)
    return AimedRays(points=out[:, :3], excess=out[:, 3], spreading=out[:, 4])


def _stationary_paths(wall: Wall, o: Array, nodes: Array, starts: Array, axis: Array) -> Array:
    """Return a stationary path from O to each node, (n, 8) as the kernel `aim`, from its start."""
    from ...kernels.heights import tables_for
    from . import _aiming_kernels, callable_aiming

    nodes, starts = np.ascontiguousarray(nodes), np.ascontiguousarray(starts)
    out = np.empty((len(nodes), 8))
    if isinstance(wall, CallableWall):
        callable_aiming.aim(wall, o, nodes, starts, axis, out)
        return out
    # One thread for few nodes: others would wait longer than they help.
    loop = _aiming_kernels.aim if len(nodes) > 30_000 else _aiming_kernels.aim.alone
    terms, tables = wall.compiled()
    loop(terms, tables_for(terms, tables), o, nodes, starts, axis, out)
    return out


def _refuse_several_paths(wall: Wall, o: Array, nodes: Array, axis: Array, aimed: Array) -> None:
    """Raise `CausticError` if a node has further stationary paths; only curved walls can."""
    first = aimed[0]
    d1 = float(np.linalg.norm(first[:3] - o))
    d2 = float(np.linalg.norm(first[:3] - nodes[0]))
    cosines = (o[2] / d1, float(nodes[0, 2]) / d2)
    # Below this curvature the path is a convex function on the wall, with a single minimum.
    least = cosines[0] ** 2 / d1 + cosines[1] ** 2 / d2
    if sum(cosines) * wall.max_curvature < 0.8 * least:
        return
    reach = 2 * math.hypot(o[0] - nodes[0, 0], o[1] - nodes[0, 1]) + o[2] + float(nodes[0, 2])
    if math.isfinite(wall.finest_period):
        slope = wall.max_curvature * wall.finest_period / (2 * math.pi)
        reach = min(reach, 4 * slope * d1 * d2 / (d1 + d2) + 2 * wall.finest_period)
    n_starts = int(min(129, max(9, 2 * math.ceil(4 * reach / wall.finest_period) + 1)))
    offsets = np.linspace(-reach, reach, n_starts)
    for node in (0, len(nodes) - 1):
        centre = aimed[node, :2]
        around = centre + np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        target = np.broadcast_to(nodes[node], (len(around), 3))
        others = _stationary_paths(wall, o, target, around, axis)
        apart = np.hypot(*(others[:, :2] - centre).T) > 1e-6
        seen = (others[:, 7] == 1) & apart & wall.contains(others[:, 0], others[:, 1])
        if seen.any():
            x, y = others[int(np.argmax(seen)), :2]
            raise CausticError(
                f"the wall shows the object more than once: pupil node {node} receives light "
                f"from x = {x:.4g} m, y = {y:.4g} m and from x = {centre[0]:.4g} m, "
                f"y = {centre[1]:.4g} m: {_caustic(wall, o, nodes[node], first[:3])}"
            )


def _caustic(wall: Wall, o: Array, node: Array, hit: Array) -> str:
    """Return why no single path leads from o to node: radii of wall and caustic, by Coddington."""
    d1, d2 = (float(np.linalg.norm(hit - end)) for end in (o, node))
    c1, c2 = float(o[2]) / d1, float(node[2]) / d2
    sagittal, tangential = (c1 + c2) / (1 / d1 + 1 / d2), (c1 + c2) / (c1**2 / d1 + c2**2 / d2)
    # Below this curvature, an unbounded surface has one path to each node.
    if wall.max_curvature * sagittal < 0.8:
        return "the wall ends before the point of reflection; enlarge it, or move object or camera"
    return (
        f"a caustic, since rays cross near radii of curvature of {sagittal:.3g} m to "
        f"{tangential:.3g} m and the wall's comes down to {1 / wall.max_curvature:.3g} m; use a "
        "flatter wall, a smaller stop, other distances, or rays instead of waves"
    )


def pupil_points(centre: ArrayLike, axis: Array, nodes: Array) -> Array:
    """Return world coordinates (n, 3), m, of pupil nodes (u, v), (n, 2), m.

    The pupil plane passes through ``centre`` and is perpendicular to the unit vector ``axis``.
    """
    e1, e2, _ = pupil_frame(axis)
    return np.asarray(np.asarray(centre) + nodes[:, :1] * e1 + nodes[:, 1:] * e2)
