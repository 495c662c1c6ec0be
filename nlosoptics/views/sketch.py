"""Sketch of a scene: top view and side view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import expect
from ..errors import SceneError
from ..scene import Occluder, PlanarObject, Scene
from .canvas import BLACK, BLUE, BROWN, GREEN, ORANGE, VERMILION, few_ticks, new_axes

if TYPE_CHECKING:
    import trimesh
    from matplotlib.axes import Axes


def scene_sketch(scene: Scene, *, axes: Sequence[Axes] | None = None) -> tuple[Axes, Axes]:
    """Draw the scene from above (x, z) and from the side (z, y).

    Parameters
    ----------
    scene : Scene
        Scene to draw.
    axes : sequence of two matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    (Axes, Axes)
        Axes of the top view and of the side view, m. They show the wall's profile through the
        origin, the laser beam, the hidden object and its mirror image in the plane z = 0, the
        camera with its axis, and boxes around the occluders. A dashed line is the central path of
        the light, from the laser spot via object and wall to the camera, drawn as for a flat wall.

    See Also
    --------
    scene_3d : 3-D view of a scene.
    overview : One figure of a whole run.

    Examples
    --------
    >>> from nlosoptics import Scene, views
    >>> top, side = views.scene_sketch(Scene.load("examples/scenes/letter_flat.toml"))
    >>> top.get_xlabel(), side.get_ylabel()
    ('x (m)', 'y, up (m)')
    """
    scene = expect("scene", scene, "Scene")
    top, side = axes if axes is not None else new_axes(2, width=10.5, height=5.4)
    room_from_above(scene, top)
    _draw(scene, side, across=2, up=1)
    side.set(xlabel="z, into the room (m)", ylabel="y, up (m)", title="side view")
    if axes is None:
        figure: Any = top.get_figure(root=True)
        figure.legend(*side.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    else:
        side.legend()
    return top, side


def room_from_above(scene: Scene, axes: Axes) -> None:
    """Draw the top view of a scene: x to the right, z toward the reader, m."""
    _draw(scene, axes, across=0, up=2)
    axes.yaxis.set_inverted(True)  # in a top view with x to the right, z points down
    axes.set(xlabel="x (m)", ylabel="z, into the room (m)", title="top view")


def _draw(scene: Scene, axes: Axes, *, across: int, up: int) -> None:
    """Draw one view; ``across`` and ``up`` are the indices of its world axes."""
    outlines = _outlines(scene)
    reach = 1.1 * max(np.abs(points[:, :2]).max() for _, points, _ in outlines)
    profile = _profile(scene, along=0 if across == 0 else 1, reach=reach)
    axes.plot(*profile[:, [across, up]].T, color=BLACK, linewidth=2.5, label="relay wall")
    for label, points, style in outlines:
        axes.plot(*points[:, [across, up]].T, label=label, **style)
    axes.set_aspect("equal", adjustable="datalim")
    few_ticks(axes)
    axes.grid(alpha=0.25)


def _profile(scene: Scene, *, along: int, reach: float) -> Any:
    """Return points of the wall along world x or y through the origin, (n, 3), m."""
    if scene.wall.true_triangles is not None:
        import trimesh

        cut: Any = trimesh.intersections.mesh_plane  # untyped
        lines = cut(scene.wall.true_triangles, np.eye(3)[1 - along], np.zeros(3))
        ends = np.full((len(lines), 1, 3), np.nan)  # which interrupt the curve
        return np.concatenate([lines, ends], axis=1).reshape(-1, 3)
    size = scene.wall.size
    half = reach if size is None else size[along] / 2
    t, zero = np.linspace(-half, half, 401), np.zeros(401)
    x, y = (t, zero) if along == 0 else (zero, t)
    try:
        return np.stack([x, y, scene.wall.height(x, y)], axis=1)
    except SceneError:
        if size is not None:
            raise
        # an unbounded spherical wall ends at its radius
        return _profile(scene, along=along, reach=reach / 2)


def _outlines(scene: Scene) -> list[tuple[str, Any, dict[str, Any]]]:
    """Return label, world points (n, 3) in m and line style of everything but the wall."""
    camera, laser = np.array(scene.camera.position), np.array(scene.laser.position)
    x, y, _ = scene.laser.aim
    spot = np.array([x, y, float(scene.wall.height(x, y)) if scene.wall.has_height else 0.0])
    hidden, mirrored = scene.object_point, scene.mirrored_object_point
    # where the straight line from the camera to the mirrored object crosses z = 0
    crossing = camera + (mirrored - camera) * camera[2] / (camera[2] - mirrored[2])
    lens = scene.camera.frame[:2] * scene.camera.stop_diameter / 2
    shape = _object_outline(scene)
    dot = {"marker": "o", "markersize": 3, "linewidth": 2.5}
    path, beam = [hidden, crossing, camera], []
    if scene.laser.power > 0.0:
        path = [spot, *path]
        beam = [("laser beam", np.stack([laser, spot]), {"color": VERMILION, "linewidth": 1.5})]
    return [
        *beam,
        ("chief path", np.stack(path), {"color": ORANGE, "linewidth": 1, "linestyle": "--"}),
        ("hidden object", shape, {"color": GREEN, **dot}),
        ("mirrored object", shape * (1, 1, -1), {"color": "#8FCFBA", **dot}),
        (
            "camera axis",
            np.stack([camera, np.array(scene.camera.aim)]),
            {"color": BLUE, "linewidth": 1, "linestyle": ":"},
        ),
        (
            "camera lens",
            camera + np.stack([lens[0], -lens[0], 0 * lens[0], lens[1], -lens[1]]),
            {"color": BLUE, **dot, "marker": "s"},
        ),
        *_occluder_boxes(scene),
    ]


def _occluder_boxes(scene: Scene) -> list[tuple[str, Any, dict[str, Any]]]:
    """Return the outlines of boxes around the occluders; only the first is in the legend."""
    boxes = []
    for index, occluder in enumerate(scene.occluders):
        mesh = occluder.surface if isinstance(occluder, Occluder) else occluder
        label = "_occluder" if index else "occluder"
        boxes.append((label, _box(mesh), {"color": BROWN, "linewidth": 2.5}))
    return boxes


def _object_outline(scene: Scene) -> Any:
    """Return the outline of a planar object, or of the box around a mesh, (n, 3), world, m."""
    if isinstance(scene.hidden, PlanarObject):
        right, up, _ = scene.hidden.axes
        half = np.array(scene.hidden.size) / 2
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
        return scene.object_point + corners @ np.stack([right, up])
    return _box(scene.hidden.surface)


def _box(mesh: trimesh.Trimesh) -> Any:
    """Return an outline that shows the box around a mesh along x, y and z, (7, 3), world, m."""
    low, high = mesh.bounds
    pick = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), (0, 0, 1), (0, 0, 0)])
    return np.where(pick, high, low)
