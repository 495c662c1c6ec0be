"""3-D views of a scene and of light paths through it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import expect
from ..scene import PlanarObject, Scene
from . import room_parts as parts
from .canvas import BLUE, BROWN, GREEN, GREY, VERMILION
from .rays import COLOURS, chosen_paths, colour_style, path_lines
from .stages import FLAT, add_floor, add_legend, bar_style, drawn_on, finish_bar

if TYPE_CHECKING:
    from pyvista import Plotter

    from ..psf import Wavefront
    from ..raytrace import RayPaths

MATT: dict[str, Any] = {"ambient": 0.35, "diffuse": 0.65, "smooth_shading": False}
GLYPH = 0.045  # size of the camera and laser housings over the extent of the scene
THIN = 0.0016  # smallest radius of the beam and the optical axis over that extent


def scene_3d(scene: Scene, *, plotter: Plotter | None = None) -> Plotter:
    """Draw a scene in 3-D: relay wall, laser, hidden object, camera and occluders.

    Parameters
    ----------
    scene : Scene
        Scene to draw.
    plotter : pyvista Plotter, optional
        Plotter to draw on; by default a new one that renders off screen, for `save`. For a window,
        give that of `window`. A scene that the plotter already shows is replaced.

    Returns
    -------
    Plotter
        Plotter in world coordinates, m. It shows the relay wall, the laser and its beam, the hidden
        object, the camera with its lens and optical axis, the occluders, a floor grid and the
        axes x, y and z. The legend states the step of the grid.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.

    See Also
    --------
    ray_paths : Adds light paths to this view.
    scene_sketch : 2-D views of a scene.

    Notes
    -----
    Positions, the lens and the wall are to scale. The housings of laser and camera only mark
    positions. Beam and optical axis have a minimum width, so that they are always visible.

    The shading of the wall shows its slopes relative to the steepest one, which the legend states.
    It has 768 samples along the wall's longer side. If waves of the wall have a period of at most
    three samples, or if a height map can contain such waves, the shading shows no slopes, and the
    legend says so. Grain and highlights only distinguish rough from mirror-like materials; they do
    not show how the wall would look.

    Examples
    --------
    >>> from nlosoptics import Scene, views
    >>> plotter = views.scene_3d(Scene.load("examples/scenes/letter_flat.toml"))
    >>> "relay wall" in plotter.actors
    True
    """
    scene = expect("scene", scene, "Scene")
    plotter = drawn_on(plotter, "Scene with relay wall, laser, hidden object and camera")
    size = parts.room_size(scene)
    half = np.array([*size, 0.0]) / 2
    corners = half * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    around = np.concatenate([parts.outline(scene), corners])
    low, high = around.min(axis=0), around.max(axis=0)
    extent = float((high - low).max())
    legend = _draw_wall(plotter, scene, size)
    if scene.laser.power > 0.0:
        legend |= _draw_light(plotter, scene, extent)
    legend |= _draw_hidden(plotter, scene)
    legend |= _draw_camera(plotter, scene, extent)
    if scene.occluding_mesh is not None:
        mesh = parts.mesh_surface(scene.occluding_mesh)
        # seen through, because an occluder may stand between the viewer and the hidden object
        plotter.add_mesh(mesh, color=BROWN, name="occluders", opacity=0.4, **MATT)
        legend["occluders"] = BROWN
    apart: list[tuple[Any, float]]
    lit = (scene.laser.position, scene.laser.aim) if scene.laser.power > 0.0 else ()
    apart = [(place, 0.0) for place in lit]
    apart += [(scene.camera.position, 0.0), (scene.object_point, parts.object_radius(scene))]
    legend |= add_floor(plotter, around, low, high, apart)
    add_legend(plotter, legend)
    return plotter


def ray_paths(
    paths: RayPaths,
    scene: Scene,
    *,
    colour: str = "bounces",
    wavefront: Wavefront | None = None,
    n_bounces: int | None = None,
    only_detected: bool = True,
    most: int = 1000,
    plotter: Plotter | None = None,
) -> Plotter:
    """Draw light paths through a scene in 3-D.

    Parameters
    ----------
    paths : RayPaths
        Paths from `nlosoptics.raytrace.trace` with ``keep_paths=True``, or from
        `nlosoptics.raytrace.pupil_rays`.
    scene : Scene
        Scene in which the paths were traced.
    colour : {"bounces", "path_length", "weight", "aberration"}
        Quantity that sets the colours. "bounces": number of reflections before each segment of a
        path. "path_length": length from the source along the path, m. "weight": power at the end of
        the path, W, on a logarithmic scale. "aberration": wave aberration of the path at the pupil,
        waves.
    wavefront : Wavefront, optional
        Wave computed from these paths by `nlosoptics.psf.wavefront_from_rays`, with one value per
        detected path in the same order. Required for "aberration", which also needs
        ``only_detected=True``.
    n_bounces : int, optional
        Draw only paths with this number of reflections. None: any number.
    only_detected : bool
        Whether to draw only paths with status 0: those that reach the detector or, for
        `nlosoptics.raytrace.pupil_rays`, the lens.
    most : int
        Largest number of paths drawn. Paths that the hidden object reflected are chosen first. Only
        if there are fewer than ``most``, paths of stray light, which never met the object, are
        added. If one of these two kinds has more paths than can be drawn, a sample is chosen in
        proportion to their power. The density of lines then shows the power.
    plotter : pyvista Plotter, optional
        Plotter to draw on; by default a new one that renders off screen, for `save`. A scene and
        paths that the plotter already shows are replaced.

    Returns
    -------
    Plotter
        Plotter with the view of `scene_3d` and the paths, in world coordinates, m. All segments of
        paths are one set of lines, the actor "ray paths", with one cell per segment. Its cell
        arrays are "path" (index into ``paths``) and "preceding reflections"; also "power", W, for
        ``colour="weight"``, and "aberration", waves, for ``colour="aberration"``. For
        ``colour="path_length"`` it has the point array "path length", m.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    SceneError
        If ``paths`` is empty, no path passes the filters, or ``wavefront`` does not belong to the
        paths.

    See Also
    --------
    save : Writes the view as an image, a web page or glTF.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace, views
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> paths = raytrace.pupil_rays(scene, n_rays=64)
    >>> plotter = views.ray_paths(paths, scene, colour="path_length")
    >>> list(plotter.scalar_bars.keys())
    ['path length from the source (m)']
    """
    paths = expect("paths", paths, "RayPaths")
    chosen = chosen_paths(paths, n_bounces=n_bounces, only_detected=only_detected, most=most)
    lines = path_lines(paths, chosen, colour=colour, wavefront=wavefront)
    plotter = drawn_on(plotter, "Light paths from the laser via wall and object to the camera")
    if "ray paths" in plotter.actors:
        plotter.remove_actor("ray paths")
    for _, title in COLOURS.values():
        if title in plotter.scalar_bars:
            plotter.remove_scalar_bar(title)
    scene_3d(scene, plotter=plotter)
    name, title = COLOURS[colour]
    style = colour_style(colour, np.asarray(lines[name]))
    bar, steps = style.pop("bar"), style.pop("steps", ())
    plotter.add_mesh(
        lines,
        scalars=name,
        name="ray paths",
        line_width=1.2,
        opacity=0.75,
        scalar_bar_args=bar_style(title, **bar),
        reset_camera=False,
        **style,
        **FLAT,
    )
    finish_bar(plotter, title, steps)
    return plotter


def _draw_wall(plotter: Plotter, scene: Scene, size: tuple[float, float]) -> dict[str, str]:
    """Draw the relay wall and return its legend entry."""
    if scene.wall.true_triangles is not None:
        mesh = parts.mesh_surface(scene.wall.true_triangles)
        plotter.add_mesh(mesh, color=GREY, name="relay wall", **MATT)
        return {"relay wall, triangles": GREY}
    mesh, texture, steepest = parts.wall_surface(scene, size)
    style = parts.gloss(scene.wall_material)
    plotter.add_mesh(
        mesh,
        texture=texture,
        name="relay wall",
        smooth_shading=True,
        ambient=0.7,
        diffuse=0.35,
        **style,
    )
    if scene.wall.is_flat:
        how = "flat"
    elif steepest > 0.0:
        how = f"slopes up to {_angle(steepest)}"
    else:
        how = "waviness too fine to draw"
    return {f"relay wall, {how}": GREY}


def _draw_light(plotter: Plotter, scene: Scene, extent: float) -> dict[str, str]:
    """Draw the laser and its beam and return their legend entry."""
    laser = scene.laser
    x, y, _ = laser.aim
    spot = np.array([x, y, float(scene.wall.height(x, y)) if scene.wall.has_height else 0.0])
    radius = max(laser.beam_diameter / 2, THIN * extent)
    plotter.add_mesh(
        parts.tube(laser.position, spot, radius), color=VERMILION, name="laser beam", **FLAT
    )
    body = parts.laser_body(laser, spot, GLYPH * extent)
    plotter.add_mesh(body, color=VERMILION, name="laser", **MATT)
    return {"laser and its beam": VERMILION}


def _draw_hidden(plotter: Plotter, scene: Scene) -> dict[str, str]:
    """Draw the hidden object and return its legend entry."""
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        mesh = parts.object_picture(hidden)
        texture = parts.picture_texture(hidden.reflectance)
        plotter.add_mesh(mesh, texture=texture, name="hidden object", **FLAT)
        frame = mesh.extract_feature_edges()
        plotter.add_mesh(frame, color=GREEN, line_width=4, name="object's frame", **FLAT)
    else:
        mesh = parts.mesh_surface(hidden.surface)
        plotter.add_mesh(mesh, color=GREEN, name="hidden object", **MATT)
    return {"hidden object": GREEN}


def _draw_camera(plotter: Plotter, scene: Scene, extent: float) -> dict[str, str]:
    """Draw the camera with lens and optical axis and return their legend entry."""
    camera = scene.camera
    body = parts.camera_body(camera, GLYPH * extent)
    plotter.add_mesh(body, color=BLUE, name="camera", **MATT)
    plotter.add_mesh(parts.lens(camera), color="#9FD3F5", name="lens", **FLAT)
    axis = parts.dashes(
        camera.position, parts.where_axis_ends(camera), 0.02 * extent, 0.6 * THIN * extent
    )
    plotter.add_mesh(axis, color=BLUE, name="optical axis", **FLAT)
    return {"camera, lens and optical axis": BLUE}


def _angle(slope: float) -> str:
    """Format a slope as an angle in rad, mrad or urad."""
    unit, size = next(
        (u, s) for u, s in (("rad", 1.0), ("mrad", 1e-3), ("urad", 0.0)) if slope >= 0.1 * s
    )
    return f"{slope / (size or 1e-6):.2g} {unit}"
