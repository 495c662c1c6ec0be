"""Scenes into the text of scene files, in SI units."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError
from . import _file_tables
from .height_maps import HeightMapWall
from .hidden import MeshObject, PlanarObject
from .materials import Lambert, Material, OrenNayar, SpecularMicrofacet, SumMaterial, Ward
from .mesh import MeshWall
from .occluders import Occluder
from .walls import ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall

if TYPE_CHECKING:
    from .scene import Scene


def format_scene(scene: Scene, folder: str | Path) -> str:
    """Text of the scene file of ``scene``, SI units, paths relative to ``folder``.

    Raises
    ------
    SceneError
        If a picture or mesh is an array that no file holds.
    """
    base = Path(folder).resolve()
    laser, camera = scene.laser, scene.camera
    tables = _file_tables.SceneFile.model_construct(
        laser=_file_tables.LaserTable.model_construct(**vars(laser)),
        wall=_wall_table(scene.wall, base, _material_table(scene.wall_material)),
        hidden=_hidden_table(scene.hidden, base),
        camera=_file_tables.CameraTable.model_construct(
            **vars(camera) | {"pixels": list(camera.pixels)}
        ),
        occluder=[
            _occluder_table(f"occluder[{index}].mesh", occluder, base)
            for index, occluder in enumerate(scene.occluders)
        ]
        or None,
        transient=None
        if scene.transient is None
        else _file_tables.TransientTable.model_construct(**vars(scene.transient)),
    )
    return _toml(tables.model_dump(exclude_none=True))


def _material_table(material: Material) -> Any:
    if isinstance(material, SumMaterial):
        return [_material_table(part) for part in material.parts]
    if isinstance(material, Lambert):
        return _file_tables.LambertTable.model_construct(lobe="lambert", albedo=material.rho)
    if isinstance(material, OrenNayar):
        return _file_tables.OrenNayarTable.model_construct(
            lobe="oren_nayar",
            albedo=material.rho,
            slope_rms=material.slope_rms,
            model=material.model,
            normalised=material.normalised,
        )
    if isinstance(material, SpecularMicrofacet):
        return _file_tables.SpecularTable.model_construct(lobe="specular", **vars(material))
    if isinstance(material, Ward):
        return _file_tables.WardTable.model_construct(
            lobe="ward", albedo=material.rho, alpha=material.alpha, variant=material.variant
        )
    raise SceneError(f"{type(material).__name__} has no form in a scene file; write a sum of lobes")


def _wall_table(wall: Wall, base: Path, material: Any = None) -> Any:
    common = {"size": wall.size, "material": material}
    if isinstance(wall, MeshWall):
        return _file_tables.MeshWallTable.model_construct(
            shape="mesh",
            mesh=_relative("wall.mesh", wall.mesh, base),
            scale=wall.scale,
            material=material,
        )
    if isinstance(wall, HeightMapWall) and wall.drawn is not None:
        return _file_tables.RandomTable.model_construct(
            shape="random", material=material, **wall.drawn
        )
    if isinstance(wall, HeightMapWall):
        return _file_tables.HeightMapTable.model_construct(
            shape="height_map",
            heights=_relative("wall.heights", wall.heights, base),
            pitch=wall.pitch,
            **common,
        )
    if isinstance(wall, FlatWall):
        return _file_tables.FlatTable.model_construct(shape="flat", **common)
    if isinstance(wall, WavyWall):
        return _file_tables.WavyTable.model_construct(shape="wavy", **{**vars(wall), **common})
    if isinstance(wall, SumWall):
        terms = [_wall_table(term, base) for term in wall.terms]
        return _file_tables.SumTable.model_construct(shape="sum", terms=terms, **common)
    if isinstance(wall, (ConcaveWall, ConvexWall)):
        shape = f"{'concave' if isinstance(wall, ConcaveWall) else 'convex'}_{wall.shape}"
        if wall.shape == "sphere":
            return _file_tables.SphereTable.model_construct(
                shape=shape, radius=wall.radius, **common
            )
        return _file_tables.CylinderTable.model_construct(
            shape=shape, radius=wall.radius, axis=wall.axis, **common
        )
    raise SceneError(
        f"{type(wall).__name__} has no form in a scene file; save its heights as an .npy file and "
        "use HeightMapWall"
    )


def _hidden_table(hidden: PlanarObject | MeshObject, base: Path) -> Any:
    common = {name: getattr(hidden, name) for name in ("position", "yaw", "pitch", "roll")}
    common["material"] = _material_table(hidden.material)
    if isinstance(hidden, PlanarObject):
        image = _relative("hidden.image", hidden.image, base)
        return _file_tables.PictureTable.model_construct(image=image, size=hidden.size, **common)
    mesh = _relative("hidden.mesh", hidden.mesh, base)
    return _file_tables.MeshObjectTable.model_construct(mesh=mesh, scale=hidden.scale, **common)


def _occluder_table(name: str, occluder: Any, base: Path) -> Any:
    if not isinstance(occluder, Occluder):
        occluder = Occluder(occluder)
    places = {key: getattr(occluder, key) for key in ("scale", "position", "yaw", "pitch", "roll")}
    mesh = _relative(name, occluder.mesh, base)
    return _file_tables.OccluderTable.model_construct(mesh=mesh, **places)


def _relative(name: str, source: Any, base: Path) -> str:
    if not isinstance(source, (str, Path)):
        raise SceneError(
            f"{name} is {type(source).__name__} in memory and a scene file holds paths; write it "
            "to a file and give its path"
        )
    try:
        return Path(os.path.relpath(Path(source).resolve(), base)).as_posix()
    except ValueError:  # another drive
        return Path(source).resolve().as_posix()


def _toml(document: dict[str, Any]) -> str:
    """Write nested tables and arrays of tables."""
    lines: list[str] = []
    for name, table in document.items():
        _toml_table(name, table, lines)
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml_table(name: str, table: Any, lines: list[str], brackets: str = "[]") -> None:
    if isinstance(table, list):
        for item in table:
            _toml_table(name, item, lines, "[[]]")
        return
    half = len(brackets) // 2
    lines += ["", f"{brackets[:half]}{name}{brackets[half:]}"]
    nested = {
        key: value
        for key, value in table.items()
        if isinstance(value, dict) or (isinstance(value, list) and isinstance(value[0], dict))
    }
    lines += [f"{key} = {toml_value(value)}" for key, value in table.items() if key not in nested]
    for key, value in nested.items():
        _toml_table(f"{name}.{key}", value, lines)


def toml_value(value: Any) -> str:
    """Write one value; a float as the shortest text that reads back."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    # a JSON string is a TOML string, but for the one control character that JSON leaves bare
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
