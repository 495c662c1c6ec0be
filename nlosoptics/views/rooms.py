"""The scene in three dimensions, and the light's paths through it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..scene import PlanarObject, Scene
from . import room_parts as parts
from .canvas import round_step
from .rays import COLOURS, chosen_paths, colour_style, path_lines
from .sketch import CAMERA, LASER, OBJECT, OCCLUDER
from .stages import INK, add_legend, bar_style, finish_bar, look_at, new_plotter

if TYPE_CHECKING:
    from pyvista import Plotter

    from ..psf import Wavefront
    from ..raytrace import RayPaths

WALL, GRID = "#707070", "#a8a8a8"
MATT: dict[str, Any] = {"ambient": 0.35, "diffuse": 0.65, "smooth_shading": False}
FLAT: dict[str, Any] = {"lighting": False}
GLYPH = 0.045  # of the room's extent: the camera's and the laser's housings
THIN = 0.0016  # likewise: least radius of the beam and of the optical axis


def scene_3d(scene: Scene, *, plotter: Plotter | None = None) -> Plotter:
    """Draw a scene as a room that can be walked around.

    Parameters
    ----------
    scene : Scene
    plotter : pyvista Plotter, optional
        Where to draw; a new one off the screen by default. A room that it already shows is
        replaced.

    Returns
    -------
    Plotter
        World coordinates in m: the wall, the laser beam, the hidden object with its picture, the
        camera with its lens and optical axis, occluders, a grid on the floor whose step the legend
        names, and the axes x, y and z.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.

    Notes
    -----
    Places are to scale; the lens and the wall's extent are too. Not to scale are what would be too
    small to see: the housings of laser and camera stand for their places, beam and optical axis
    are at least `THIN` of the room thick, and the shading of the wall shows the directions of its
    slopes, the steepest always with one contrast; the legend says how steep it is. Waves finer
    than three of the shading's 768 points are left out of it. The grain and the highlight tell
    rough from mirror-like materials, and are no picture of the material.
    """
    if plotter is None:
        plotter = new_plotter("Scene: relay wall, laser, hidden object and camera")
    size = parts.room_size(scene)
    around = np.concatenate(
        [parts.outline(scene), [(x * size[0] / 2, y * size[1] / 2, 0.0) for x, y in _SIDES]]
    )
    low, high = around.min(axis=0), around.max(axis=0)
    extent = float((high - low).max())
    legend = _draw_wall(plotter, scene, size)
    legend |= _draw_light(plotter, scene, extent)
    legend |= _draw_hidden(plotter, scene)
    legend |= _draw_camera(plotter, scene, extent)
    if scene.occluding_mesh is not None:
        mesh = parts.mesh_surface(scene.occluding_mesh)
        plotter.add_mesh(mesh, color=OCCLUDER, name="occluders", **MATT)
        legend["occluders"] = OCCLUDER
    step = round_step(extent / 6)
    floor = parts.floor_grid(low, high, step)
    plotter.add_mesh(floor, color=GRID, line_width=1, name="floor grid", **FLAT)
    legend[f"floor grid, {step:g} m"] = GRID
    frame = look_at(
        plotter,
        np.concatenate([around, floor.points]),
        [
            (scene.laser.position, 0.0),
            (scene.laser.aim, 0.0),
            (scene.camera.position, 0.0),
            (scene.object_point, parts.object_radius(scene)),
        ],
    )
    origin = np.array(floor.points[np.argmin(floor.points @ frame[0])])
    # away from the floor's corner, or the wall would hide letters
    origin[2] += np.copysign(1.2 * step, floor.center[2] - origin[2])
    plotter.add_mesh(parts.triad(origin, 0.6 * step, frame), color=INK, name="axes", **FLAT)
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
    """Draw light paths through their scene.

    Parameters
    ----------
    paths : RayPaths
        Traced with ``keep_paths=True``, or of `raytrace.pupil_rays`.
    scene : Scene
        That they were traced in.
    colour : {"bounces", "path_length", "weight", "aberration"}
        By the reflections before each leg; the length from the source, m, running along the path;
        the power at the path's end, W, on a logarithmic scale; or the wave aberration at the pupil,
        in waves.
    wavefront : Wavefront, optional
        Of these paths, as of `psf.wavefront_from_rays`: one node for each detected path, in their
        order. Wanted for "aberration" only, which draws detected paths alone.
    n_bounces : int, optional
        Draw only paths of so many reflections.
    only_detected : bool
        Draw only paths that reach the detector through the pupil.
    most : int
        How many to draw. Where there are more, those are drawn that carry more than their share of
        the power, and the others at even steps of it in the order of the trace, so that lines are
        as dense as the light.
    plotter : pyvista Plotter, optional
        Where to draw; a new one off the screen by default. Room and paths that it already shows
        are replaced.

    Returns
    -------
    Plotter
        The room as of `scene_3d`, with all legs as one set of lines named "ray paths". Its cells
        are the legs, with the data "path", "reflections so far" and what was asked for; world, m.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed.
    SceneError
        If no paths were kept, none passes the filters, or the wavefront does not belong to them.
    """
    chosen = chosen_paths(paths, n_bounces=n_bounces, only_detected=only_detected, most=most)
    lines = path_lines(paths, chosen, colour=colour, wavefront=wavefront)
    if plotter is None:
        plotter = new_plotter("Light paths from the laser by wall and object to the camera")
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


_SIDES = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _draw_wall(plotter: Plotter, scene: Scene, size: tuple[float, float]) -> dict[str, str]:
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
        how = "waves too fine to draw"
    return {f"relay wall, {how}": WALL}


def _draw_light(plotter: Plotter, scene: Scene, extent: float) -> dict[str, str]:
    laser = scene.laser
    x, y, _ = laser.aim
    spot = np.array([x, y, float(scene.wall.height(x, y))])
    radius = max(laser.beam_diameter / 2, THIN * extent)
    plotter.add_mesh(
        parts.tube(laser.position, spot, radius), color=LASER, name="laser beam", **FLAT
    )
    body = parts.laser_body(laser, spot, GLYPH * extent)
    plotter.add_mesh(body, color=LASER, name="laser", **MATT)
    return {"laser and its beam": LASER}


def _draw_hidden(plotter: Plotter, scene: Scene) -> dict[str, str]:
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        mesh = parts.object_picture(hidden)
        texture = parts.picture_texture(hidden.reflectance)
        plotter.add_mesh(mesh, texture=texture, name="hidden object", **FLAT)
        frame = mesh.extract_feature_edges()
        plotter.add_mesh(frame, color=OBJECT, line_width=4, name="object's frame", **FLAT)
    else:
        mesh = parts.mesh_surface(hidden.surface)
        plotter.add_mesh(mesh, color=OBJECT, name="hidden object", **MATT)
    return {"hidden object": OBJECT}


def _draw_camera(plotter: Plotter, scene: Scene, extent: float) -> dict[str, str]:
    camera = scene.camera
    body = parts.camera_body(camera, GLYPH * extent)
    plotter.add_mesh(body, color=CAMERA, name="camera", **MATT)
    plotter.add_mesh(parts.lens(camera), color="#9fd3f5", name="lens", **FLAT)
    axis = parts.dashes(
        camera.position, parts.where_axis_ends(camera), 0.02 * extent, 0.6 * THIN * extent
    )
    plotter.add_mesh(axis, color=CAMERA, name="optical axis", **FLAT)
    return {"camera, lens and optical axis": CAMERA}


def _angle(slope: float) -> str:
    """A slope as an angle in the unit that reads best."""
    for unit, size in (("rad", 1.0), ("mrad", 1e-3), ("urad", 1e-6)):
        if slope >= 0.1 * size or unit == "urad":
            return f"{slope / size:.2g} {unit}"
    raise AssertionError
