"""What stands in a room, as surfaces in the world frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..raytrace.fans.facets import material_slope
from ..scene import Camera, Laser, Material, Occluder, PlanarObject, Scene
from .stages import pyvista

if TYPE_CHECKING:
    from pyvista import PolyData, Texture

Array = NDArray[np.float64]

CELLS = 128  # of the wall's mesh along its longer side
TEXELS = 768  # of its shading, likewise
GRAIN = 0.035  # rms brightness of a wall whose facets tilt by `ROUGH` or more
ROUGH = 0.3  # rad
RELIEF = 0.2  # brightness that the steepest slope changes
GREY = 0.85  # brightness of the wall


def room_size(scene: Scene) -> tuple[float, float]:
    """Extent of the wall that is drawn, m: its own, or what lies before an unbounded one."""
    if scene.wall.size is not None:
        return scene.wall.size
    reach = float(np.abs(outline(scene)[:, :2]).max()) * 1.15
    while True:
        half = np.array([-reach, reach])
        try:
            scene.wall.height(*np.meshgrid(half, half))
        except SceneError:
            reach *= 0.8  # an unbounded sphere ends at its radius
        else:
            return (2 * reach, 2 * reach)


def outline(scene: Scene) -> Array:
    """Points (n, 3), world, m, between which the scene lies, the wall left out."""
    hidden = scene.hidden
    shape = hidden.corners if isinstance(hidden, PlanarObject) else hidden.surface.bounds
    places = [shape, [scene.laser.position, scene.laser.aim, scene.camera.position]]
    places += [surface(o).bounds for o in scene.occluders]
    return np.concatenate([np.asarray(p, dtype=np.float64) for p in places])


def object_radius(scene: Scene) -> float:
    """About how far the hidden object reaches from its reference point, m."""
    hidden = scene.hidden
    if isinstance(hidden, PlanarObject):
        return float(max(hidden.size)) / 2
    return float(np.linalg.norm(np.ptp(hidden.surface.bounds, axis=0))) / 2


def surface(occluder: Any) -> Any:
    """Mesh of an occluder in the world frame."""
    return occluder.surface if isinstance(occluder, Occluder) else occluder


def wall_surface(scene: Scene, size: tuple[float, float]) -> tuple[PolyData, Texture, float]:
    """The wall, its shading, and the steepest slope that the shading shows, rad."""
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
    """Brightness (ny, nx) of the wall, row 0 on top, and the steepest slope in it, rad."""
    texel = max(size) / TEXELS
    nx, ny = (max(8, round(side / texel)) for side in size)
    shade = np.full((ny, nx), GREY)
    steepest = 0.0
    # finer waves than three texels would show as waves that are not there
    if not scene.wall.is_flat and scene.wall.finest_period > 3 * texel:
        x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (nx, ny))
        slopes = scene.wall.derivatives(*np.meshgrid(x * size[0], -y * size[1]))[..., 1:3]
        steepest = float(np.linalg.norm(slopes, axis=-1).max())
        if steepest > 0.0:
            # lit from where the slopes show most
            spread = np.einsum("ijk,ijl->kl", slopes, slopes)
            shade += RELIEF * (slopes @ np.linalg.eigh(spread)[1][:, 1]) / steepest
    tilt = rough_tilt(scene)
    grain = np.random.default_rng(0).standard_normal((ny // 2 + 1, nx // 2 + 1))
    grain = grain.repeat(2, axis=0)[:ny].repeat(2, axis=1)[:, :nx]
    return np.clip(shade + GRAIN * min(tilt / ROUGH, 1.0) * grain, 0.0, 1.0), steepest


def rough_tilt(scene: Scene) -> float:
    """Rms tilt, rad, of the wall's facets; `ROUGH` for a matt wall that has none."""
    try:
        return material_slope(scene)
    except SceneError:
        return 0.0 if scene.wall_material.diffuse is None else ROUGH


def gloss(material: Material) -> dict[str, float]:
    """Strength and width of the highlight on a material: Phong's, of its mirror-like lobes.

    The exponent 2/slope^2 gives Phong's highlight the width of the facets' slopes.
    """
    share = material.specular_reflectance
    slopes = [lobe.slope_rms for lobe in material.mirror_lobes]
    power = min(2.0 / max(min(slopes), 0.1) ** 2, 128.0) if slopes else 1.0
    return {"specular": min(1.0, math.sqrt(share)) if share > 0 else 0.0, "specular_power": power}


def picture_texture(brightness: Array) -> Texture:
    """Texture of a grey picture (ny, nx), 0 to 1, row 0 on top."""
    grey = np.round(255 * np.asarray(brightness)).astype(np.uint8)
    texture = pyvista().Texture(np.repeat(grey[..., None], 3, axis=2))
    texture.interpolate = True
    return texture


def object_picture(hidden: PlanarObject) -> PolyData:
    """The plane of a picture with its texture's coordinates, seen from either side."""
    pv = pyvista()
    right, up, _ = hidden.axes
    sides = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
    points = np.array(hidden.position) + (sides * hidden.size) @ np.stack([right, up])
    mesh = pv.PolyData.from_regular_faces(points, np.array([[0, 1, 2, 3]]))
    mesh.active_texture_coordinates = sides + 0.5
    return mesh


def mesh_surface(mesh: Any) -> PolyData:
    """The same triangles for pyvista."""
    return pyvista().PolyData.from_regular_faces(np.array(mesh.vertices), np.array(mesh.faces))


def tube(start: Any, end: Any, radius: float) -> PolyData:
    """A round rod between two points."""
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
    """A dashed rod between two points."""
    start, end = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    whole = float(np.linalg.norm(end - start))
    count = max(1, round(whole / (2 * length)))
    along = (end - start) / count
    parts = [tube(start + k * along, start + (k + 0.5) * along, radius) for k in range(count)]
    return pyvista().merge(parts)


def camera_body(camera: Camera, side: float) -> PolyData:
    """A box of about ``side`` behind the lens, and a barrel that holds it."""
    pv = pyvista()
    box = pv.Cube(x_length=side, y_length=0.75 * side, z_length=0.6 * side)
    box.points = np.asarray(box.points) @ camera.frame
    behind = np.array(camera.position) - 0.65 * side * camera.axis
    box.points = np.asarray(box.points) + behind
    barrel = pv.Cylinder(
        center=np.array(camera.position) - 0.175 * side * camera.axis,
        direction=camera.axis,
        radius=max(0.6 * camera.stop_diameter, 0.22 * side),
        height=0.349 * side,  # ends just behind the lens, or the two would flicker
        resolution=48,
    )
    return pv.merge([box, barrel.triangulate()])


def lens(camera: Camera) -> PolyData:
    """The clear lens, which is stop and exit pupil: a disc of its true diameter."""
    return pyvista().Disc(
        center=camera.position,
        inner=0.0,
        outer=camera.stop_diameter / 2,
        normal=camera.axis,
        c_res=48,
    )


def laser_body(laser: Laser, spot: Array, side: float) -> PolyData:
    """A rod of about ``side`` that ends where the beam starts."""
    back = np.array(laser.position) - spot
    back /= np.linalg.norm(back)
    return tube(laser.position, np.array(laser.position) + 1.6 * side * back, 0.3 * side)


def where_axis_ends(camera: Camera) -> Array:
    """Point of the optical axis in the mean wall plane, world, m."""
    start = np.array(camera.position)
    return np.asarray(start - camera.axis * start[2] / camera.axis[2])


def floor_grid(low: Array, high: Array, step: float) -> PolyData:
    """Lines a ``step`` apart over the floor y = low[1], through multiples of it."""
    xs, zs = (
        np.arange(math.floor(low[i] / step + 1e-9), math.ceil(high[i] / step - 1e-9) + 1) * step
        for i in (0, 2)
    )
    y = low[1]
    ends = [((x, y, zs[0]), (x, y, zs[-1])) for x in xs]
    ends += [((xs[0], y, z), (xs[-1], y, z)) for z in zs]
    return pyvista().line_segments_from_points(np.array(ends).reshape(-1, 3))


def triad(origin: Array, length: float, facing: Array) -> PolyData:
    """Arrows along the world's axes, with letters that face the viewer.

    Parameters
    ----------
    origin : ndarray, (3,)
        World, m.
    length : float
        Of an arrow, m.
    facing : ndarray, (3, 3)
        Rows right, up and toward the viewer, world frame.
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
