"""The two hidden scenes, a corridor with letters and one with a dragon, and where to look."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from nlosoptics import scene, transient

Array = NDArray[np.float64]
Surfaces = list[tuple[trimesh.Trimesh, scene.Material]]

SIDE = 1.792  # m, of the square of laser points about the origin
ROOM = (2.0, 2.0, 3.0)  # m, of the corridor along x, y and z; the relay wall is its end z = 0
OPENING = 1.0  # m along z from the relay wall, the whole height of the side x = +1 m
APERTURES = (0.9, 1.6, 1.792)  # m
ALPHAS = (1.0, 0.4, 0.2)
MATERIALS = ("lambert", "ward-1", "ward-0.4", "ward-0.2")
#: Later forms of Ward's model, whose lobes have other energies away from its axis.
VARIANTS = ("ward-1-duer", "ward-1-bounded", "ward-0.2-duer", "ward-0.2-bounded")
CORRIDOR_ALBEDO = 0.5  # the paper has none
OBJECT_ALBEDO = 0.8  # of Lambert, and Ward's specular albedo
#: m: where the depths of each scene's voxels begin and end
DEPTHS = {"letters": (0.9, 2.1), "dragon": (0.8, 1.9)}
THICK = 0.1  # m, of a letter
STROKE = 0.16


def material(name: str) -> scene.Material:
    """An object's, by its name in `MATERIALS` or `VARIANTS`."""
    if name == "lambert":
        return scene.Lambert(OBJECT_ALBEDO)
    _, alpha, *later = name.split("-")
    return scene.Ward(OBJECT_ALBEDO, float(alpha), variant=later[0] if later else "1992")


def surfaces(name: str, cloth: str, *, corridor: bool = True, cell: float = 0.025) -> Surfaces:
    """Everything that light meets: the objects of one material, and the corridor."""
    found: Surfaces = [(mesh, material(cloth)) for mesh in objects(name, cell=cell)]
    if corridor:
        found.append((corridor_mesh(), scene.Lambert(CORRIDOR_ALBEDO)))
    return found


def objects(name: str, *, cell: float = 0.025) -> list[trimesh.Trimesh]:
    """Hidden objects, world, m; `cell` is how fine the dragon is."""
    if name == "dragon":
        return [dragon(cell)]
    return [letter("R", (-0.5, 1.25)), letter("D", (-0.25, 1.70))]


def corridor_mesh() -> trimesh.Trimesh:
    """Floor, ceiling, far end and sides without the opening, as quadrilaterals seen from within."""
    x, y, z = 0.5 * ROOM[0], 0.5 * ROOM[1], ROOM[2]
    quads = [
        [(-x, -y, 0), (x, -y, 0), (x, -y, z), (-x, -y, z)],  # floor
        [(-x, y, 0), (-x, y, z), (x, y, z), (x, y, 0)],  # ceiling
        [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],  # far end
        [(-x, -y, 0), (-x, -y, z), (-x, y, z), (-x, y, 0)],  # whole side
        [(x, -y, OPENING), (x, y, OPENING), (x, y, z), (x, -y, z)],  # side with the opening
    ]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return trimesh.Trimesh(
        np.array(quads, dtype=np.float64).reshape(-1, 3),
        np.concatenate([faces + 4 * i for i in range(len(quads))]),
        process=False,
    )


def letter(name: str, place: tuple[float, float]) -> trimesh.Trimesh:
    """A letter of 0.75 m x 0.8 m that reads as seen from the wall.

    ``place`` is its left edge as the wall sees it, which is -x, and its front, z; it is centred on
    y = 0.
    """
    outline, hole = OUTLINES[name]()
    flat, faces = triangulated([outline, hole])
    solid: trimesh.Trimesh = trimesh.creation.extrude_triangulation(flat, faces, THICK)
    left, front = place
    points = np.array(solid.vertices)
    moved = np.column_stack([-(points[:, 0] + left), points[:, 1] - 0.4, points[:, 2] + front])
    # the mirrored x turns the triangles over
    return trimesh.Trimesh(moved, np.array(solid.faces)[:, ::-1], process=False)


def _arc(centre: tuple[float, float], radii: tuple[float, float], n: int = 13) -> list[Any]:
    """Half an ellipse, from below by the right to above."""
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, n)
    x, y = centre[0] + radii[0] * np.cos(angles), centre[1] + radii[1] * np.sin(angles)
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _letter_d() -> tuple[list[Any], list[Any]]:
    w = STROKE
    outline = [(0.0, 0.0), *_arc((0.35, 0.4), (0.4, 0.4), 17), (0.0, 0.8)]
    return outline, [(w, w), *_arc((0.35, 0.4), (0.4 - w, 0.4 - w), 13), (w, 0.8 - w)]


def _letter_r() -> tuple[list[Any], list[Any]]:
    w = STROKE
    bowl = _arc((0.49, 0.55), (0.26, 0.25))
    foot = [(0.0, 0.0), (w, 0.0), (w, 0.3), (0.3, 0.3), (0.55, 0.0), (0.75, 0.0)]
    hole = [(w, 0.43), *_arc((0.47, 0.55), (0.13, 0.12), 9), (w, 0.67)]
    return [*foot, *bowl, (0.0, 0.8)], hole


OUTLINES = {"D": _letter_d, "R": _letter_r}


def triangulated(rings: list[list[Any]], step: float = 0.05) -> tuple[Array, NDArray[np.int64]]:
    """Triangles between the first ring and those within it.

    Delaunay's of points on the rings, which hold the rings' own edges where these are short against
    the strokes; triangles whose middle is outside are left out.
    """
    from scipy.spatial import Delaunay

    closed = [_divided(np.array(ring, dtype=np.float64), step) for ring in rings]
    points = np.concatenate(closed)
    faces = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    middles = points[faces].mean(axis=1)
    inside = _within(closed[0], middles)
    for ring in closed[1:]:
        inside &= ~_within(ring, middles)
    faces = faces[inside]
    sides = points[faces]
    a, b = (sides[:, 1] - sides[:, 0]).T, (sides[:, 2] - sides[:, 0]).T
    across = a[0] * b[1] - a[1] * b[0]
    faces, across = faces[np.abs(across) > 1e-9], across[np.abs(across) > 1e-9]
    faces[across < 0.0] = faces[across < 0.0][:, ::-1]
    return points, faces


def _divided(ring: Array, step: float) -> Array:
    """A ring with its edges in pieces of at most `step`."""
    pieces = []
    for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        n = max(1, int(np.ceil(np.linalg.norm(end - start) / step)))
        pieces.append(start + (end - start) * (np.arange(n) / n)[:, None])
    return np.concatenate(pieces)


def _within(ring: Array, points: Array) -> NDArray[np.bool_]:
    """Whether points are inside a ring, by crossings of a ray along x."""
    x, y = points.T[:, :, None]
    (x0, y0), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
    between = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return np.asarray((between & (x < at)).sum(axis=1) % 2 == 1)


def dragon(cell: float) -> trimesh.Trimesh:
    """A dragon-like free form of 1.25 m x 0.9 m x 0.55 m whose nearest point is at z = 1.1 m.

    Rounded limbs that grow into one another, ridges and scales: an implicit function, contoured on
    cells of `cell` metres.
    """
    import pyvista

    low, high = np.array([-0.72, -0.56, -0.4]), np.array([0.72, 0.56, 0.4])
    counts = np.ceil((high - low) / cell).astype(int) + 1
    axes = [low[i] + cell * np.arange(counts[i]) for i in range(3)]
    u, v, w = np.meshgrid(*axes, indexing="ij")
    grid = pyvista.ImageData(dimensions=tuple(counts), spacing=(cell,) * 3, origin=tuple(low))
    values = _dragon_field(u, v, w)
    found = grid.contour([0.0], scalars=values.ravel(order="F")).triangulate().clean()
    points = np.array(found.points, dtype=np.float64)
    faces = np.array(found.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    extent = np.ptp(points, axis=0)
    points = (points - points.min(axis=0)) / extent * [1.25, 0.9, 0.55]
    points -= [0.625, 0.45, 0.0]
    moved = np.column_stack([-points[:, 0], points[:, 1], points[:, 2] + 1.1])
    mesh = trimesh.Trimesh(moved, faces, process=True)
    mesh.update_faces(mesh.area_faces > 1e-5 * cell * cell)
    mesh.remove_unreferenced_vertices()
    return mesh


#: Limbs of the dragon as the wall sees it, u to the right, v up, w away: ends (u, v, w, radius).
LIMBS = (
    # tail, from its tip to the hips
    ((-0.62, 0.10, 0.02, 0.020), (-0.60, -0.12, 0.06, 0.035)),
    ((-0.60, -0.12, 0.06, 0.035), (-0.50, -0.28, 0.08, 0.055)),
    ((-0.50, -0.28, 0.08, 0.055), (-0.32, -0.26, 0.04, 0.085)),
    # trunk, from hips to shoulders
    ((-0.32, -0.26, 0.04, 0.085), (-0.16, -0.14, 0.00, 0.150)),
    ((-0.16, -0.14, 0.00, 0.150), (0.14, -0.06, 0.00, 0.165)),
    # neck and head, jaws, horns
    ((0.14, -0.06, 0.00, 0.150), (0.30, 0.14, -0.02, 0.095)),
    ((0.30, 0.14, -0.02, 0.095), (0.34, 0.30, -0.06, 0.080)),
    ((0.34, 0.30, -0.06, 0.085), (0.46, 0.31, -0.12, 0.075)),
    ((0.46, 0.33, -0.12, 0.055), (0.60, 0.29, -0.16, 0.038)),
    ((0.44, 0.26, -0.12, 0.045), (0.56, 0.19, -0.14, 0.028)),
    ((0.33, 0.36, -0.10, 0.035), (0.20, 0.45, -0.12, 0.015)),
    ((0.33, 0.36, 0.00, 0.035), (0.20, 0.45, 0.04, 0.015)),
    # legs: thigh, shin and foot, near and far
    ((-0.22, -0.20, -0.10, 0.100), (-0.14, -0.34, -0.16, 0.060)),
    ((-0.14, -0.34, -0.16, 0.055), (-0.12, -0.42, -0.24, 0.040)),
    ((-0.22, -0.20, 0.10, 0.090), (-0.30, -0.42, 0.16, 0.045)),
    ((0.16, -0.14, -0.10, 0.080), (0.24, -0.30, -0.14, 0.055)),
    ((0.24, -0.30, -0.14, 0.050), (0.30, -0.42, -0.22, 0.040)),
    ((0.16, -0.14, 0.10, 0.080), (0.12, -0.42, 0.18, 0.045)),
    # wings: arms of the membranes
    ((0.06, 0.06, -0.08, 0.050), (-0.10, 0.40, -0.20, 0.028)),
    ((-0.10, 0.40, -0.20, 0.028), (-0.44, 0.28, -0.12, 0.022)),
    ((0.06, 0.06, 0.08, 0.050), (-0.02, 0.42, 0.24, 0.028)),
)
#: Membranes between three points, with their half thickness.
WINGS = (
    ((0.02, 0.08, -0.08), (-0.10, 0.40, -0.20), (-0.44, 0.28, -0.12), 0.022),
    ((0.02, 0.08, -0.08), (-0.44, 0.28, -0.12), (-0.34, 0.02, -0.02), 0.022),
    ((0.02, 0.08, 0.08), (-0.02, 0.42, 0.24), (-0.34, 0.20, 0.20), 0.022),
)


def _dragon_field(u: Array, v: Array, w: Array) -> Array:
    """Below 0 within: a soft union of limbs and membranes, with scales."""
    points = np.stack([u, v, w], axis=-1)
    blend = 0.015
    total = np.zeros_like(u)
    for start, end in LIMBS:
        total += np.exp(-np.minimum(_limb(points, start, end) / blend, 60.0))
    for a, b, c, thick in WINGS:
        total += np.exp(-np.minimum((_sheet(points, a, b, c) - thick) / blend, 60.0))
    distance = -blend * np.log(np.maximum(total, 1e-30))
    scales = np.sin(52.0 * u) * np.sin(52.0 * v + 1.0) * np.cos(40.0 * w)
    return np.asarray(distance - 0.010 * scales)


def _limb(points: Array, start: Any, end: Any) -> Array:
    """Distance from a rounded cone, nearly."""
    a, b = np.array(start[:3]), np.array(end[:3])
    along = b - a
    share = np.clip(((points - a) @ along) / (along @ along), 0.0, 1.0)
    radius = start[3] + share * (end[3] - start[3])
    return np.asarray(np.linalg.norm(points - a - share[..., None] * along, axis=-1) - radius)


def _sheet(points: Array, a: Any, b: Any, c: Any) -> Array:
    """Distance from a triangle: from its plane within, from its sides without."""
    corners = np.array([a, b, c])
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    inside = np.ones(points.shape[:-1], dtype=bool)
    edges = []
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside &= (points - first) @ np.cross(normal, second - first) >= 0.0
        edges.append(_limb(points, (*first, 0.0), (*second, 0.0)))
    plane = np.abs((points - corners[0]) @ normal)
    return np.asarray(np.where(inside, plane, np.min(edges, axis=0)))


def volume(name: str, voxel: float, offset: float = 0.0) -> transient.Volume:
    """Cubes that fill the wall's square, as many as fit best, between a scene's depths.

    ``offset`` moves the planes by a share of a voxel.
    """
    count = round(SIDE / voxel)
    near, far = DEPTHS[name]
    planes = near + voxel * (np.arange(int((far - near) / voxel) + 1) + offset)
    return transient.Volume.before(SIDE, count, planes)


def facing(meshes: list[trimesh.Trimesh], grid: transient.Volume) -> Array:
    """Cosine between +z and the normal of the first surface, (ny, nx); NaN where there is none."""
    from nlosoptics.raytrace import intersect_mesh

    origins = np.zeros((len(grid.y), len(grid.x), 3))
    origins[..., 0], origins[..., 1] = grid.x, grid.y[:, None]
    nearest = np.full(origins.shape[:2], np.inf)
    cosine = np.full(origins.shape[:2], np.nan)
    for mesh in meshes:
        hits = intersect_mesh(mesh, origins, (0.0, 0.0, 1.0))
        first = (hits.status == 0) & (hits.distance < nearest)
        nearest = np.where(first, hits.distance, nearest)
        cosine = np.where(first, np.abs(hits.normals[..., 2]), cosine)
    return cosine
