"""Export of 3-D views as binary glTF 2.0, which model viewers and web pages read.

The exporter of VTK assigns wrong colours to lines, drops names and transparency, and has no binary
format; that of trimesh gives a whole path one colour. A binary glTF file is a JSON text followed
by one block of bytes (Khronos Group, glTF 2.0 specification).
"""

from __future__ import annotations

import io
import json
import math
import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from .stages import pyvista

if TYPE_CHECKING:
    from pyvista import Actor, Plotter, PolyData

# enumeration values of the glTF 2.0 specification
FLOAT, USHORT, UINT = 5126, 5123, 5125
VERTICES, INDICES = 34962, 34963
LINES, TRIANGLES = 1, 4
LINEAR, MIPMAPS = 9729, 9987
CLAMPED: Final = 33071
UNLIT: Final = "KHR_materials_unlit"
TABLES: Final = (
    "accessors",
    "bufferViews",
    "cameras",
    "images",
    "materials",
    "meshes",
    "nodes",
    "samplers",
    "textures",
)
Array = NDArray[Any]


class _File:
    """JSON tables and binary block of a glTF file while it is written."""

    def __init__(self) -> None:
        self.bytes = bytearray()
        self.tables: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}

    def put(self, table: str, entry: dict[str, Any]) -> int:
        """Append an entry to a table and return its index."""
        self.tables[table].append(entry)
        return len(self.tables[table]) - 1

    def view(self, content: bytes, **more: Any) -> int:
        """Append bytes at a multiple of four and return the index of their buffer view."""
        self.bytes += b"\0" * (-len(self.bytes) % 4)
        start = len(self.bytes)
        self.bytes += content
        entry = {"buffer": 0, "byteOffset": start, "byteLength": len(content)}
        return self.put("bufferViews", entry | more)

    def array(self, values: Array, kind: str, component: int, target: int, **more: Any) -> int:
        """Append an array and return the index of its accessor."""
        types = {FLOAT: "<f4", USHORT: "<u2", UINT: "<u4"}
        content = np.ascontiguousarray(values, dtype=types[component])
        entry = {
            "bufferView": self.view(content.tobytes(), target=target),
            "componentType": component,
            "count": len(content),
            "type": kind,
        }
        return self.put("accessors", entry | more)

    def whole(self) -> bytes:
        """Return the file: header, JSON and bytes, each padded to a multiple of four bytes."""
        text: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "nlosoptics"},
            "extensionsUsed": [UNLIT],
            "scene": 0,
            "scenes": [{"nodes": list(range(len(self.tables["nodes"])))}],
            "buffers": [{"byteLength": len(self.bytes)}],
        }
        text |= {name: table for name, table in self.tables.items() if table}
        head = json.dumps(text, separators=(",", ":"), allow_nan=False).encode()
        head += b" " * (-len(head) % 4)
        body = bytes(self.bytes) + b"\0" * (-len(self.bytes) % 4)
        return b"".join(
            [
                struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(body)),
                struct.pack("<I4s", len(head), b"JSON"),
                head,
                struct.pack("<I4s", len(body), b"BIN\0"),
                body,
            ]
        )


def glb(plotter: Plotter) -> bytes:
    """Return surfaces, lines, textures and camera of a plotter as binary glTF, without rendering.

    Nodes have the names of the plotter's actors. Coordinates are world coordinates, m. The file
    has no legend, colour bars or other 2-D text.
    """
    file = _File()
    for name, actor in plotter.actors.items():
        if isinstance(actor, pyvista().Actor) and actor.visibility and actor.mapper is not None:
            _add_actor(file, name, actor)
    _add_camera(file, plotter)
    return file.whole()


def _add_actor(file: _File, name: str, actor: Actor) -> None:
    """Add the triangles and lines of an actor as one node."""
    mesh = actor.mapper.dataset
    if not isinstance(mesh, pyvista().PolyData):
        mesh = mesh.extract_geometry()
    colours, by_cell = _colours(actor)
    primitives = []
    if mesh.n_lines:
        pairs, line = _segments(mesh)
        shades = None if colours is None else colours[line if by_cell else pairs]
        points = np.asarray(mesh.points)[pairs].reshape(-1, 3)
        shades = None if shades is None else _each_end(shades, by_cell)
        material = _material(file, actor, name, coloured=shades is not None, lit=False)
        primitives.append(_primitive(file, points, None, material, LINES, colours=shades))
    if mesh.GetNumberOfPolys():
        primitives.append(_triangles(file, actor, name, mesh, colours, by_cell))
    if not primitives:
        return
    node: dict[str, Any] = {
        "mesh": file.put("meshes", {"name": name, "primitives": primitives}),
        "name": name,
    }
    matrix = pyvista().array_from_vtkmatrix(actor.GetMatrix())
    if not np.array_equal(matrix, np.eye(4)):
        node["matrix"] = matrix.T.ravel().tolist()
    file.put("nodes", node)


def _triangles(
    file: _File, actor: Actor, name: str, mesh: PolyData, colours: Array | None, by_cell: bool
) -> dict[str, Any]:
    """Add the faces of a mesh, with colours per point or per face, and return their primitive.

    glTF has no colours per face, so that faces get three vertices of their own.
    """
    smooth = actor.prop.interpolation.name != "FLAT" and "Normals" in mesh.point_data
    places = mesh.active_texture_coordinates if actor.texture is not None else None
    mesh = mesh.copy(deep=False)
    mesh.cell_data["_face"] = np.arange(mesh.n_cells)
    cut = mesh.triangulate()
    index = cut.regular_faces
    points: Any = np.asarray(cut.points)
    normals: Any = np.asarray(cut.point_data["Normals"]) if smooth else None
    if by_cell and colours is not None:
        colours = np.repeat(colours[np.asarray(cut.cell_data["_face"])], 3, axis=0)
        points, normals, places = (
            None if part is None else np.asarray(part)[index.ravel()]
            for part in (points, normals, places)
        )
        index = np.arange(len(points)).reshape(-1, 3)
    lit = bool(actor.prop.lighting)
    material = _material(file, actor, name, coloured=colours is not None, lit=lit)
    return _primitive(
        file, points, index, material, TRIANGLES, normals=normals, places=places, colours=colours
    )


def _primitive(
    file: _File,
    points: Array,
    index: Array | None,
    material: int,
    mode: int,
    *,
    normals: Array | None = None,
    places: Array | None = None,
    colours: Array | None = None,
) -> dict[str, Any]:
    """Add points with their normals, texture coordinates and colours; return their primitive."""
    single = np.asarray(points, dtype=np.float32)
    ends = {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
    attributes = {"POSITION": file.array(single, "VEC3", FLOAT, VERTICES, **ends)}
    if normals is not None:
        attributes["NORMAL"] = file.array(normals, "VEC3", FLOAT, VERTICES)
    if places is not None:
        # texture coordinates have v = 0 at the bottom in VTK and at the top in glTF
        upper_left = np.asarray(places) * (1.0, -1.0) + (0.0, 1.0)
        attributes["TEXCOORD_0"] = file.array(upper_left, "VEC2", FLOAT, VERTICES)
    if colours is not None:
        light = colours.astype(np.float64) / 255.0
        light[:, :3] = _linear(light[:, :3])
        steps = np.round(65535 * light)
        attributes["COLOR_0"] = file.array(steps, "VEC4", USHORT, VERTICES, normalized=True)
    made: dict[str, Any] = {"attributes": attributes, "material": material, "mode": mode}
    if index is not None:
        made["indices"] = file.array(index.reshape(-1), "SCALAR", UINT, INDICES)
    return made


def _segments(mesh: PolyData) -> tuple[Array, Array]:
    """Return the point indices (n, 2) of all line segments, and the line (n,) of each."""
    cells, array = mesh.GetLines(), pyvista().convert_array
    starts, points = array(cells.GetOffsetsArray()), array(cells.GetConnectivityArray())
    pairs = np.stack([points[:-1], points[1:]], axis=1)
    line = np.searchsorted(starts, np.arange(len(points)), side="right") - 1
    inside = line[:-1] == line[1:]
    return pairs[inside], line[:-1][inside]


def _each_end(shades: Array, by_cell: bool) -> Array:
    """Return the colours (2n, 4) of the segment ends from those of n segments or point pairs."""
    return np.repeat(shades, 2, axis=0) if by_cell else shades.reshape(-1, 4)


def _colours(actor: Actor) -> tuple[Array | None, bool]:
    """Return the colours (n, 4) uint8 of the actor's scalars, and whether they are per cell."""
    mapper = actor.mapper
    if not mapper.scalar_visibility:
        return None, False
    by_cell = mapper.scalar_map_mode == "cell"
    data = mapper.dataset.GetCellData() if by_cell else mapper.dataset.GetPointData()
    values = data.GetAbstractArray(mapper.array_name)
    if values is None:
        return None, False
    table = mapper.lookup_table
    mapped = table.MapScalars(values, mapper.GetColorMode(), mapper.GetArrayComponent())
    found = np.asarray(pyvista().convert_array(mapped))
    if found.shape[1] == 3:
        found = np.concatenate([found, np.full((len(found), 1), 255, np.uint8)], axis=1)
    return found, by_cell


def _material(file: _File, actor: Actor, name: str, *, coloured: bool, lit: bool) -> int:
    """Add a material and return its index.

    Its base colour is that of the actor, or white where a texture or the vertices have colours.
    """
    prop = actor.prop
    textured = actor.texture is not None
    base = np.ones(3) if coloured or textured else _linear(prop.color.float_rgb)
    # Beckmann width with the same highlight as Phong's exponent: Walter et al. 2007, eq. 32
    alpha = math.sqrt(2.0 / (prop.specular_power + 2.0)) if prop.specular > 0.0 else 1.0
    surface: dict[str, Any] = {
        "baseColorFactor": [*base.tolist(), float(prop.opacity)],
        "metallicFactor": 0.0,
        "roughnessFactor": math.sqrt(alpha),
    }
    if textured:
        surface["baseColorTexture"] = {"index": _texture(file, actor.texture)}
    made: dict[str, Any] = {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}
    if prop.opacity < 1.0:
        made["alphaMode"] = "BLEND"
    if not lit:
        made["extensions"] = {UNLIT: {}}
    return file.put("materials", made)


def _texture(file: _File, texture: Any) -> int:
    """Add a texture as PNG and return its index."""
    from PIL import Image

    picture = np.asarray(texture.to_array())
    if picture.ndim == 3 and picture.shape[2] == 3 and np.ptp(picture, axis=2).max() == 0:
        picture = picture[..., 0]  # one channel takes a third of the bytes
    content = io.BytesIO()
    Image.fromarray(picture).save(content, format="PNG", optimize=True)
    image = {"bufferView": file.view(content.getvalue()), "mimeType": "image/png"}
    near = {"magFilter": LINEAR, "minFilter": MIPMAPS, "wrapS": CLAMPED, "wrapT": CLAMPED}
    return file.put(
        "textures", {"source": file.put("images", image), "sampler": file.put("samplers", near)}
    )


def _add_camera(file: _File, plotter: Plotter) -> None:
    """Add the camera of the plotter."""
    camera = plotter.camera
    width, height = plotter.window_size
    near, far = camera.clipping_range
    lens = {
        "yfov": math.radians(camera.view_angle),
        "aspectRatio": width / height,
        "znear": near / 10,
        "zfar": 10 * far,
    }
    number = file.put("cameras", {"type": "perspective", "perspective": lens})
    toward = np.subtract(camera.position, camera.focal_point)
    toward /= np.linalg.norm(toward)
    right = np.cross(camera.up, toward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(toward, right), toward, camera.position], axis=1)
    file.put("nodes", {"name": "camera", "camera": number, "matrix": matrix.T.ravel().tolist()})


def _linear(colours: Any) -> Array:
    """Return linear intensities of sRGB components, IEC 61966-2-1."""
    c = np.asarray(colours, dtype=np.float64)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
