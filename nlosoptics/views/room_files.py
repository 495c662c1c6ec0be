"""3-D views as glTF models and as web pages, by trimesh and its viewer."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh as _trimesh
from trimesh.viewer.notebook import scene_to_html

from .._html import joined, tag
from .canvas import pyvista
from .stages import legend_entries

if TYPE_CHECKING:
    from pyvista import Plotter

trimesh: Any = _trimesh  # untyped


def model(plotter: Plotter) -> Any:
    """Return surfaces, lines (as thin tubes), textures and camera of a plotter, without rendering.

    Parts have the names of the plotter's actors. Coordinates are world coordinates, m. Legend,
    colour bars and other 2-D text are left out.
    """
    scene = trimesh.Scene()
    thin = 4e-4 * plotter.renderer.length
    for name, actor in plotter.actors.items():
        if isinstance(actor, pyvista().Actor) and actor.visibility and actor.mapper is not None:
            scene.add_geometry(_mesh(actor, name, thin), node_name=name, geom_name=name)
    camera = plotter.camera
    toward = np.subtract(camera.position, camera.focal_point)
    toward /= np.linalg.norm(toward)
    right = np.cross(camera.up, toward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(toward, right), toward, camera.position], axis=1)
    width, height = plotter.window_size
    angle = math.radians(camera.view_angle)
    across = 2 * math.atan(math.tan(angle / 2) * width / height)
    far = camera.clipping_range[1]
    scene.camera = trimesh.scene.Camera(
        name="viewpoint", fov=np.degrees([across, angle]), z_near=far / 1000
    )
    scene.camera_transform = matrix
    return scene


def _mesh(actor: Any, name: str, thin: float) -> Any:
    """Return an actor as a mesh of trimesh; lines become tubes of the radius ``thin``, m."""
    surface = actor.mapper.dataset
    if surface.n_lines:
        surface = surface.tube(radius=thin, n_sides=3).cell_data_to_point_data()
    surface = surface.triangulate()
    prop, texture = actor.prop, actor.texture
    colour = np.ones(4) if texture else np.array([*prop.color.float_rgb, prop.opacity])
    colour[:3] = _linear(colour[:3])
    look: dict[str, Any] = {"alphaMode": "BLEND"} if prop.opacity < 1.0 else {}
    # Beckmann width with the same highlight as Phong's exponent: Walter et al. 2007, eq. 32
    alpha = math.sqrt(2.0 / (prop.specular_power + 2.0)) if prop.specular > 0.0 else 1.0
    visual = trimesh.visual.TextureVisuals(uv=surface.active_texture_coordinates)
    if actor.mapper.scalar_visibility:
        values = surface.point_data[actor.mapper.array_name]
        shades = np.array(actor.mapper.lookup_table(values), dtype=np.float64)
        shades[:, :3] = _linear(shades[:, :3])
        visual.vertex_attributes["color"] = np.rint(255 * shades).astype(np.uint8)
        colour[:3] = 1.0
    elif texture:
        from PIL import Image

        look["baseColorTexture"] = Image.fromarray(np.asarray(texture.to_array())[..., 0])
    visual.material = trimesh.visual.material.PBRMaterial(
        name=name,
        baseColorFactor=colour,
        metallicFactor=0.0,
        roughnessFactor=math.sqrt(alpha),
        doubleSided=True,
        **look,
    )
    # a mesh without normals is drawn with flat faces
    smooth = prop.interpolation.name != "FLAT" and "Normals" in surface.point_data
    return trimesh.Trimesh(
        np.array(surface.points),
        np.array(surface.regular_faces),
        vertex_normals=np.array(surface.point_data["Normals"]) if smooth else None,
        visual=visual,
        process=False,
    )


def _linear(colours: Any) -> Any:
    """Return linear intensities of sRGB components, IEC 61966-2-1."""
    c = np.asarray(colours)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def html_page(plotter: Plotter) -> str:
    """Return the text of a web page that shows a 3-D view; it loads nothing from the network.

    The page has the plotter's title, legend, and the ranges of its colour bars. The view is turned
    by mouse or touch.
    """
    title = getattr(plotter, "title", "") or "Scene in 3-D"
    rows = [
        tag("li", tag("b", "■ ", style=f"color: {colour}"), name)
        for name, colour in legend_entries(plotter).items()
    ]
    rows += [tag("li", _bar(name, bar)) for name, bar in plotter.scalar_bars.items()]
    style = "position: fixed; left: 1em; bottom: 1em; margin: 0; padding: 0; list-style: none; "
    legend = tag("ul", *rows, style=style + "font: 14px/1.4 sans-serif; pointer-events: none")
    page = scene_to_html(model(plotter))
    page = re.sub("<title>.*?</title>", lambda _: tag("title", title), page, count=1)
    return page.replace("<body>", f"<body>{legend}", 1)


def _bar(title: str, bar: Any) -> Any:
    """Return a colour bar as a gradient between its ends."""
    table = bar.GetLookupTable()
    low, high = table.GetRange()
    ends = np.geomspace(low, high, 9) if table.UsingLogScale() else np.linspace(low, high, 9)
    colours = []
    for value in ends.tolist():
        rgb = [0.0, 0.0, 0.0]
        table.GetColor(value, rgb)
        colours.append(pyvista().Color(rgb).hex_rgb)
    style = "display: inline-block; width: 12em; height: 0.8em; margin: 0 0.5em; "
    style += f"background: linear-gradient(90deg, {', '.join(colours)})"
    return joined([f"{title}: {low:.3g}", tag("span", style=style), f"{high:.3g}"])
