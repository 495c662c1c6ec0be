"""Conversion of scenes to the text of scene files, in SI units."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import SceneError
from ..parts._sources import SourceFile, array_file, mesh_file, picture_file
from ..parts.hidden import NO_PICTURE, PlanarObject
from ..parts.laser import NO_LASER
from ..parts.library import LOBE_CLASSES
from ..parts.materials import Material, SumMaterial
from ..parts.occluders import BLACK, Occluder
from ..walls.analytic import SumWall, Wall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from ..walls.relief import FacetWall, GaussianWall
from ..walls.roughness import WallRoughness
from . import tables as _tables

#: Function of a key and its data that returns the file name to write in the scene file. The data
#: are a `SourceFile`, or suffix and bytes if they are in memory.
Naming = Callable[[str, SourceFile | tuple[str, bytes]], str]


def saved_files(scene: Any, path: Path) -> dict[Path, bytes]:
    """Return the files to write for saving ``scene`` at ``path``."""
    base = path.parent.resolve()
    made: dict[Path, bytes] = {}

    def placed(key: str, held: SourceFile | tuple[str, bytes]) -> str:
        """Return the name for ``key``; collect the data unless an unchanged file holds them."""
        if isinstance(held, SourceFile):
            if held.is_in_place:
                return _relative(held, base)
            held = held.suffix, held.content
        name = f"{path.stem}_{_name(key)}{held[0]}"
        made[path.with_name(name)] = held[1]
        return name

    text = _text(scene, placed)
    return {**made, path: text.encode()}


def scene_files(scene: Any) -> dict[str, bytes]:
    """Return the files of a self-contained folder for ``scene`` that can be moved anywhere."""
    copies: dict[str, bytes] = {}

    def copied(key: str, held: SourceFile | tuple[str, bytes]) -> str:
        """Return the name for ``key``, and collect a copy of the data."""
        try:
            suffix, content = (held.suffix, held.content) if isinstance(held, SourceFile) else held
        except SceneError as error:
            raise SceneError(f"{key}: {error}") from None
        copies[_name(key) + suffix] = content
        return _name(key) + suffix

    return {"scene.toml": _text(scene, copied).encode(), **copies}


def _text(scene: Any, named: Naming) -> str:
    """Return the TOML text of a scene."""
    wall = _wall_table("wall", scene.wall, named)
    values = {
        "laser": None
        if scene.laser == NO_LASER
        else _table(_tables.LaserTable, "laser", scene.laser, named),
        "wall": wall.model_copy(
            update={
                "material": _material_table(scene.wall_material),
                "roughness": _roughness_table(scene.wall_roughness, named),
            }
        ),
        "hidden": _table(
            _tables.PictureTable if isinstance(scene.hidden, PlanarObject) else _tables.MeshTable,
            "hidden",
            scene.hidden,
            named,
        ),
        "camera": _table(_tables.CameraTable, "camera", scene.camera, named, f_number=None),
    }
    if scene.occluders:
        values["occluder"] = [
            _occluder_table(f"occluder[{index}]", occluder, named)
            for index, occluder in enumerate(scene.occluders)
        ]
    if scene.ambient_irradiance > 0.0:
        values["ambient"] = _tables.AmbientTable(irradiance=f"{scene.ambient_irradiance!r} W/m^2")
    for key, table in _tables.OPTIONAL.items():
        if (part := getattr(scene, key)) is not None:
            values[key] = _table(table, key, part, named)
    return _toml(_tables.SceneFile.model_construct(**values).model_dump(exclude_none=True))


def _table(table: Any, key: str, part: Any, named: Naming, /, **own: Any) -> Any:
    """Return the table of a part, whose attributes are the keys; ``key`` is that of the table."""
    values = {name: getattr(part, name) for name in table.model_fields if hasattr(part, name)}
    if np.array_equal(values.get("image", ()), NO_PICTURE):
        del values["image"]
    for name in values.keys() & _tables.FILES:
        values[name] = _file(f"{key}.{name}", values[name], named)
    if isinstance(values.get("material"), Material):
        values["material"] = _material_table(values["material"])
    for name in values.keys() & {"pixels", "luminous_lobe"}:
        values[name] = list(values[name])
    return table.model_construct(**values | own)


def _material_table(material: Material) -> Any:
    """Return the table of a material; a list of tables for a sum."""
    if isinstance(material, SumMaterial):
        return [_material_table(part) for part in material.parts]
    lobe = next((name for name, kind in LOBE_CLASSES.items() if type(material) is kind), None)
    if lobe is None:
        raise SceneError(
            f"{type(material).__name__} cannot be written in a scene file; use a material made of "
            "lobes"
        )
    model = _tables.LOBES[lobe]
    values = {name: getattr(material, name, None) for name in model.model_fields}
    value = "albedo" if "albedo" in values else "reflectance"
    values[value] = getattr(material, "rho", values[value])
    if material.spectrum is not None:
        values[value] = _tables.SpectrumTable.model_construct(
            wavelengths=list(material.spectrum.wavelengths), values=list(material.spectrum.values)
        )
    index = values.get("index")
    if index is not None:
        values["index"] = [index.real, index.imag]
    return model.model_construct(**values | {"lobe": lobe})


def _roughness_table(roughness: WallRoughness | None, named: Naming) -> Any:
    """Return the table of a wall's roughness; None without one."""
    if roughness is None:
        return None
    heights = roughness.heights
    own: dict[str, Any] = {"realisation": roughness.realisation}
    model = "height_map"
    if isinstance(heights, FacetWall):
        model = "facets"
    elif isinstance(heights, GaussianWall):
        model, own["slope_rms"] = "gaussian", None  # height_rms says the same
    table = _tables.ROUGHNESSES[model]
    return _table(table, "wall.roughness", heights, named, model=model, **own)


def _wall_table(key: str, wall: Wall, named: Naming) -> Any:
    """Return the table of a wall without its material; ``key`` is the table's key in the file."""
    if isinstance(wall, HeightMapWall) and wall.drawn is not None:
        return _tables.SHAPES["random"].model_construct(shape="random", **wall.drawn)
    if isinstance(wall, FacetWall | GaussianWall):
        raise SceneError(
            f"{type(wall).__name__} cannot be written as a wall in a scene file; give the scene a "
            "FlatWall and wall_roughness"
        )
    shape = next((shape for shape, table in _tables.SHAPES.items() if _fits(wall, table)), None)
    if shape is None:
        raise SceneError(
            f"{type(wall).__name__} cannot be written in a scene file; save its heights as .npy "
            "and use HeightMapWall"
        )
    own: dict[str, Any] = {"shape": shape}
    if isinstance(wall, SumWall):
        own["terms"] = [
            _wall_table(f"{key}.terms[{index}]", term, named)
            for index, term in enumerate(wall.terms)
        ]
    if isinstance(wall, MeshWall) and wall.smooth:
        own["smooth"] = None
    return _table(_tables.SHAPES[shape], key, wall, named, **own)


def _fits(wall: Wall, table: Any) -> bool:
    """Return whether a table describes walls of this kind."""
    fixed = table.fixed.items()
    return type(wall) is table.source and all(getattr(wall, k) == value for k, value in fixed)


def _occluder_table(key: str, occluder: Any, named: Naming) -> Any:
    """Return the table of an occluder; ``key`` is the key of its table."""
    if not isinstance(occluder, Occluder):
        occluder = Occluder(occluder)
    own = {"material": None} if occluder.material == BLACK else {}
    return _table(_tables.OccluderTable, key, occluder, named, **own)


def _file(key: str, held: Any, named: Naming) -> str:
    """Return the file name of an image, height map or mesh, as text for the scene file."""
    if isinstance(held, SourceFile):
        return named(key, held)
    if key == "hidden.image":
        return named(key, picture_file(held))
    if isinstance(held, np.ndarray):
        return named(key, (".npy", array_file(held)))
    return named(key, (".ply", mesh_file(held)))


def _name(key: str) -> str:
    """Return a key as part of a file name, with underscores for dots and brackets."""
    return "_".join(re.findall(r"\w+", key))


def _relative(path: Path, base: Path) -> str:
    """Return a path relative to ``base``, with forward slashes."""
    try:
        return Path(os.path.relpath(path, base)).as_posix()
    except ValueError:  # Windows: on another drive there is no relative path
        return path.as_posix()


def _toml(document: dict[str, Any]) -> str:
    """Return nested tables and arrays of tables as TOML text."""
    lines: list[str] = []
    for name, table in document.items():
        _toml_table(name, table, lines)
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml_table(name: str, table: Any, lines: list[str], brackets: str = "[]") -> None:
    """Append the lines of a table, or of an array of tables, to ``lines``."""
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
    """Return a value as TOML text; a float as the shortest text that reads back exactly."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    # JSON strings are valid TOML, except that JSON does not escape the control character DEL
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
