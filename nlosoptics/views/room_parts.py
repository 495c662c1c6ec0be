"""Parts of a scene as pyvista surfaces in the world frame, m."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..raytrace.fans.material_slopes import material_slope
from ..scene import Camera, Laser, Material, Occluder, PlanarObject, Scene
from .canvas import pyvista

if TYPE_CHECKING:
    from pyvista import PolyData, Texture

Array = NDArray[np.float64]

CELLS = 128  # cells of the wall's mesh along its longer side
TEXELS = 768  # texels of the wall's shading along its longer side
GRAIN = 0.035  # rms brightness of the grain for facet tilts of `ROUGH` or more
ROUGH = 0.3  # rms tilt of facets, rad
RELIEF = 0.2  # change of brightness at the steepest slope
GREY = 0.85  # mean brightness of the wall


def room_size(scene: Scene) -> tuple[float, float]:
    """Return the drawn size (x, y) of the wall, m; an unbounded wall is cut to the scene."""
    if scene.wall.size is not None:
        return scene.wall.size
    reach = float(np.abs(outline(scene)[:, :2]).max()) * 1.15
    while True:
        half = np.array([-reach, reach])
        try:
            scene.wall.height(*np.meshgrid(half, half))
        except SceneError:
            reach *= 0.8  # an unbounded spherical wall ends at its radius
        else:
            return (2 * reach, 2 * reach)


def outline(scene: Scene) -> Array:
    """Return points (n, 3), world, m, whose bounding box contains the scene without the wall."""
    hidden = scene.hidden
    shape = hidden.corners if isinstance(hidden, PlanarObject) else hidden.surface.bounds
    places = [shape, [scene.camera.position]]
    if scene.laser.power > 0.0:
        places.append([scene.laser.position, scene.laser.aim])
    places += [surface(o).bounds for o in scene.occluders]
    return np.concatenate([np.asarray(p, dtype=np.float64) for p in places])


def object_radius(scene: Scene) -> float:
    """Return half the longer side of a planar object, or half the box diagonal of a mesh, m."""
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        return float(max(hidden.size)) / 2
    return float(np.linalg.norm(np.ptp(hidden.surface.bounds, axis=0))) / 2


def surface(occluder: Any) -> Any:
    """Return the mesh of an occluder in the world frame."""
    return occluder.surface if isinstance(occluder, Occluder) else occluder


def wall_surface(scene: Scene, size: tuple[float, float]) -> tuple[PolyData, Texture, float]:
    """Return the wall, its shading as a texture, and the steepest slope in the shading, rad."""
    pv = pyvista()
    cell = max(size) / CELLS
    counts = [max(2, math.ceil(side / cell) + 1) for side in size]
    x, y = (np.linspace(-side / 2, side / 2, n) for side, n in zip(size, counts, strict=True))
    gx, gy = np.meshgrid(x, y)
    found = scene.wall.derivatives(gx, gy)
    points = np.stack([gx, gy, found[..., 0]], axis=-1).reshape(-1, 3)
    corner = (np.arange(len(y) - 1)[:, None] * len(x) + np.arange(len(x) - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + len(x) + 1, corner + len(x)], axis=1)
    mesh = pv.PolyData.from_regular_faces(points, quads)
    normals = np.stack([-found[..., 1], -found[..., 2], np.ones_like(gx)], axis=-1).reshape(-1, 3)
    mesh.point_data["Normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    mesh.point_data.active_normals_name = "Normals"
    mesh.active_texture_coordinates = np.stack(
        [gx / size[0] + 0.5, gy / size[1] + 0.5], axis=-1
    ).reshape(-1, 2)
    shading, steepest = _shading(scene, size)
    return mesh, picture_texture(shading), steepest


def _shading(scene: Scene, size: tuple[float, float]) -> tuple[Array, float]:
    """Return the wall's brightness (ny, nx), row 0 on top, and its steepest slope, rad."""
    texel = max(size) / TEXELS
    nx, ny = (max(8, round(side / texel)) for side in size)
    shade = np.full((ny, nx), GREY)
    steepest = 0.0
    # waviness with a period below three texels would be drawn with a false period (aliasing)
    if not scene.wall.is_flat and scene.wall.finest_period > 3 * texel:
        x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (nx, ny))
        slopes = scene.wall.derivatives(*np.meshgrid(x * size[0], -y * size[1]))[..., 1:3]
        steepest = float(np.linalg.norm(slopes, axis=-1).max())
        if steepest > 0.0:
            # light from the principal direction of the slopes, which gives the highest contrast
            spread = np.einsum("ijk,ijl->kl", slopes, slopes)
            shade += RELIEF * (slopes @ np.linalg.eigh(spread)[1][:, 1]) / steepest
    tilt = rough_tilt(scene)
    grain = np.random.default_rng(0).standard_normal((ny // 2 + 1, nx // 2 + 1))
    grain = grain.repeat(2, axis=0)[:ny].repeat(2, axis=1)[:, :nx]
    return np.clip(shade + GRAIN * min(tilt / ROUGH, 1.0) * grain, 0.0, 1.0), steepest


def rough_tilt(scene: Scene) -> float:
    """Return the rms tilt of the wall's facets, rad; `ROUGH` for a diffuse wall without facets."""
    try:
        return material_slope(scene)
    except SceneError:
        return 0.0 if scene.wall_material.diffuse is None else ROUGH


def gloss(material: Material) -> dict[str, float]:
    """Return strength and exponent of the Phong highlight of a material's specular lobes.

    The exponent 2/slope^2 gives the highlight the width of the facets' slope distribution.
    """
    share = material.specular_reflectance
    slopes = [lobe.slope_rms for lobe in material.mirror_lobes]
    power = min(2.0 / max(min(slopes), 0.1) ** 2, 128.0) if slopes else 1.0
    return {"specular": min(1.0, math.sqrt(share)) if share > 0 else 0.0, "specular_power": power}


def picture_texture(brightness: Array) -> Texture:
    """Return a texture from brightness (ny, nx), 0 to 1, row 0 on top."""
    grey = np.round(255 * np.asarray(brightness)).astype(np.uint8)
    texture = pyvista().Texture(np.repeat(grey[..., None], 3, axis=2))
    texture.interpolate = True
    return texture


def object_picture(hidden: PlanarObject) -> PolyData:
    """Return the rectangle of a planar object with texture coordinates."""
    pv = pyvista()
    right, up, _ = hidden.axes
    sides = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
    points = np.array(hidden.position) + (sides * hidden.size) @ np.stack([right, up])
    mesh = pv.PolyData.from_regular_faces(points, np.array([[0, 1, 2, 3]]))
    mesh.active_texture_coordinates = sides + 0.5
    return mesh


def mesh_surface(mesh: Any) -> PolyData:
    """Convert a trimesh mesh to pyvista."""
    return pyvista().PolyData.from_regular_faces(np.array(mesh.vertices), np.array(mesh.faces))


def tube(start: Any, end: Any, radius: float) -> PolyData:
    """Return a cylinder between two points, world, m."""
    pv = pyvista()
    start, end = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    along = end - start
    return pv.Cylinder(
        center=(start + end) / 2,
        direction=along,
        radius=radius,
        height=float(np.linalg.norm(along)),
        resolution=16,
    )


def dashes(start: Any, end: Any, length: float, radius: float) -> PolyData:
    """Return a dashed cylinder between two points, world, m, with dashes of about ``length``."""
    start, end = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    whole = float(np.linalg.norm(end - start))
    count = max(1, round(whole / (2 * length)))
    along = (end - start) / count
    parts = [tube(start + k * along, start + (k + 0.5) * along, radius) for k in range(count)]
    return pyvista().merge(parts)


def camera_body(camera: Camera, side: float) -> PolyData:
    """Return a housing of about ``side``, m, behind the lens, and a barrel that holds the lens."""
    pv = pyvista()
    box = pv.Cube(x_length=side, y_length=0.75 * side, z_length=0.6 * side)
    box.points = np.asarray(box.points) @ camera.frame
    behind = np.array(camera.position) - 0.65 * side * camera.axis
    box.points = np.asarray(box.points) + behind
    barrel = pv.Cylinder(
        center=np.array(camera.position) - 0.175 * side * camera.axis,
        direction=camera.axis,
        radius=max(0.6 * camera.stop_diameter, 0.22 * side),
        height=0.349 * side,  # ends just behind the lens: coincident surfaces flicker
        resolution=48,
    )
    return pv.merge([box, barrel.triangulate()])


def lens(camera: Camera) -> PolyData:
    """Return the lens, which is stop and exit pupil, as a disc of its true diameter."""
    return pyvista().Disc(
        center=camera.position,
        inner=0.0,
        outer=camera.stop_diameter / 2,
        normal=camera.axis,
        c_res=48,
    )


def laser_body(laser: Laser, spot: Array, side: float) -> PolyData:
    """Return a housing of about ``side``, m, whose front is at the start of the beam."""
    back = np.array(laser.position) - spot
    back /= np.linalg.norm(back)
    return tube(laser.position, np.array(laser.position) + 1.6 * side * back, 0.3 * side)


def where_axis_ends(camera: Camera) -> Array:
    """Return the intersection of the optical axis with the mean wall plane, (3,), world, m."""
    start = np.array(camera.position)
    return np.asarray(start - camera.axis * start[2] / camera.axis[2])


def floor_grid(low: Array, high: Array, step: float) -> PolyData:
    """Return grid lines on the floor y = low[1], world, m, at multiples of ``step``."""
    xs, zs = (
        np.arange(math.floor(low[i] / step + 1e-9), math.ceil(high[i] / step - 1e-9) + 1) * step
        for i in (0, 2)
    )
    y = low[1]
    ends = [((x, y, zs[0]), (x, y, zs[-1])) for x in xs]
    ends += [((xs[0], y, z), (xs[-1], y, z)) for z in zs]
    return pyvista().line_segments_from_points(np.array(ends).reshape(-1, 3))


def triad(origin: Array, length: float, facing: Array) -> PolyData:
    """Return arrows along the world axes, with letters that face the viewer.

    Parameters
    ----------
    origin : ndarray, (3,)
        Start of the arrows, world, m.
    length : float
        Length of an arrow, m.
    facing : ndarray, (3, 3)
        Unit vectors right, up and toward the viewer, as rows, world frame.
    """
    pv = pyvista()
    found = []
    for name, direction in zip("xyz", np.eye(3), strict=True):
        arrow = pv.Arrow(
            start=origin, direction=direction, scale=length, shaft_radius=0.03, tip_radius=0.08
        )
        letter = pv.Text3D(name, depth=0.0, height=0.4 * length)
        flat = np.asarray(letter.points)
        letter.points = (flat - flat.mean(axis=0)) @ facing + origin + 1.35 * length * direction
        found += [arrow.triangulate(), letter.triangulate()]
    return pv.merge(found)
