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
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.materials import Lambert, Material, OrenNayar, SpecularMicrofacet, SumMaterial, Ward
from ..parts.occluders import BLACK, Occluder
from ..walls.analytic import ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from ..walls.relief import FacetWall, GaussianWall
from ..walls.roughness import WallRoughness
from . import tables as _file_tables

#: Function of a key and its data that returns the file name to write in the scene file. The data
#: are a `SourceFile`, or suffix and bytes if they are in memory.
Naming = Callable[[str, SourceFile | tuple[str, bytes]], str]


def saved_files(scene: Any, path: Path) -> dict[Path, bytes]:
    """Return the files to write for saving ``scene`` at ``path``.

    Returns
    -------
    dict of Path to bytes
        The scene file in SI units, and one file for each image, height map or mesh that is in
        memory or whose file is missing or was changed since it was read. Their names consist of
        the stem of ``path`` and their key, such as ``room_hidden_image.png``. Other files are not
        copied; the scene file refers to them by relative paths.

    Raises
    ------
    SceneError
        If a wall or material cannot be written in a scene file.
    """
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
    """Return the files of a self-contained folder for ``scene`` that can be moved anywhere.

    Parameters
    ----------
    scene : Scene
        Scene to write.

    Returns
    -------
    dict of str to bytes
        ``scene.toml``, and copies of all images, meshes and height maps. Their names are their
        keys, such as ``hidden_image.png``.

    Raises
    ------
    SceneError
        If a file cannot be read, or a wall or material cannot be written in a scene file.
    """
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
    laser, camera = scene.laser, scene.camera
    tables = _file_tables.SceneFile.model_construct(
        laser=_file_tables.LaserTable.model_construct(**vars(laser)),
        wall=_wall_table("wall", scene.wall, named).model_copy(
            update={
                "material": _material_table(scene.wall_material),
                "roughness": _roughness_table(scene.wall_roughness, named),
            }
        ),
        hidden=_hidden_table(scene.hidden, named),
        camera=_file_tables.CameraTable.model_construct(
            **vars(camera) | {"pixels": list(camera.pixels)}
        ),
        occluder=[
            _occluder_table(f"occluder[{index}].mesh", occluder, named)
            for index, occluder in enumerate(scene.occluders)
        ]
        or None,
        transient=None
        if scene.transient is None
        else _file_tables.TransientTable.model_construct(**vars(scene.transient)),
    )
    return _toml(tables.model_dump(exclude_none=True))


def _material_table(material: Material) -> Any:
    """Return the table of a material; a list of tables for a sum."""
    if isinstance(material, SumMaterial):
        return [_material_table(part) for part in material.parts]
    spectrum: Any = material.spectrum and _file_tables.SpectrumTable.model_construct(
        wavelengths=list(material.spectrum.wavelengths), values=list(material.spectrum.values)
    )
    if isinstance(material, Lambert):
        return _file_tables.LambertTable.model_construct(
            lobe="lambert", albedo=spectrum or material.rho
        )
    if isinstance(material, OrenNayar):
        return _file_tables.OrenNayarTable.model_construct(
            lobe="oren_nayar",
            albedo=spectrum or material.rho,
            slope_rms=material.slope_rms,
            model=material.model,
            normalised=material.normalised,
        )
    if isinstance(material, SpecularMicrofacet):
        return _file_tables.SpecularTable.model_construct(
            lobe="specular",
            reflectance=spectrum or material.reflectance,
            slope_rms=material.slope_rms,
            distribution=material.distribution,
            index=None if material.index is None else [material.index.real, material.index.imag],
        )
    if isinstance(material, Ward):
        return _file_tables.WardTable.model_construct(
            lobe="ward",
            albedo=spectrum or material.rho,
            alpha=material.alpha,
            variant=material.variant,
        )
    raise SceneError(
        f"{type(material).__name__} cannot be written in a scene file; use a material made of lobes"
    )


def _roughness_table(roughness: WallRoughness | None, named: Naming) -> Any:
    """Return the table of a wall's roughness; None without one."""
    if roughness is None:
        return None
    heights, realisation = roughness.heights, roughness.realisation
    if isinstance(heights, FacetWall):
        return _file_tables.FacetsTable.model_construct(
            model="facets",
            cell=heights.cell,
            slope_rms=heights.slope_rms,
            seed=heights.seed,
            realisation=realisation,
        )
    if isinstance(heights, GaussianWall):
        return _file_tables.GaussianTable.model_construct(
            model="gaussian",
            correlation_length=heights.correlation_length,
            height_rms=heights.height_rms,
            seed=heights.seed,
            realisation=realisation,
        )
    return _file_tables.RoughMapTable.model_construct(
        model="height_map",
        heights=_file("wall.roughness.heights", heights.heights, named),
        pitch=heights.pitch,
        realisation=realisation,
    )


def _wall_table(key: str, wall: Wall, named: Naming) -> Any:
    """Return the table of a wall without its material; ``key`` is the table's key in the file."""
    common: dict[str, Any] = {"size": wall.size}
    if isinstance(wall, MeshWall):
        return _file_tables.MeshWallTable.model_construct(
            shape="mesh",
            mesh=_file(f"{key}.mesh", wall.mesh, named),
            scale=wall.scale,
            smooth=None if wall.smooth else False,
        )
    if isinstance(wall, HeightMapWall) and wall.drawn is not None:
        return _file_tables.RandomTable.model_construct(shape="random", **wall.drawn)
    if isinstance(wall, HeightMapWall):
        return _file_tables.HeightMapTable.model_construct(
            shape="height_map",
            heights=_file(f"{key}.heights", wall.heights, named),
            pitch=wall.pitch,
            **common,
        )
    if isinstance(wall, FlatWall):
        return _file_tables.FlatTable.model_construct(shape="flat", **common)
    if isinstance(wall, WavyWall):
        return _file_tables.WavyTable.model_construct(shape="wavy", **{**vars(wall), **common})
    if isinstance(wall, SumWall):
        terms = [
            _wall_table(f"{key}.terms[{index}]", term, named)
            for index, term in enumerate(wall.terms)
        ]
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
    if isinstance(wall, FacetWall | GaussianWall):
        raise SceneError(
            f"{type(wall).__name__} cannot be written as a wall in a scene file; give the scene a "
            "FlatWall and wall_roughness"
        )
    raise SceneError(
        f"{type(wall).__name__} cannot be written in a scene file; save its heights as .npy and "
        "use HeightMapWall"
    )


def _hidden_table(hidden: PlanarObject | MeshObject, named: Naming) -> Any:
    """Return the table of a hidden object."""
    common = {name: getattr(hidden, name) for name in ("position", "yaw", "pitch", "roll")}
    common["material"] = _material_table(hidden.material)
    if isinstance(hidden, PlanarObject):
        image = _file("hidden.image", hidden.image, named)
        return _file_tables.PictureTable.model_construct(image=image, size=hidden.size, **common)
    mesh = _file("hidden.mesh", hidden.mesh, named)
    return _file_tables.MeshObjectTable.model_construct(mesh=mesh, scale=hidden.scale, **common)


def _occluder_table(key: str, occluder: Any, named: Naming) -> Any:
    """Return the table of an occluder; ``key`` is the key of its mesh."""
    if not isinstance(occluder, Occluder):
        occluder = Occluder(occluder)
    values = {key: getattr(occluder, key) for key in ("scale", "position", "yaw", "pitch", "roll")}
    if occluder.material != BLACK:
        values["material"] = _material_table(occluder.material)
    mesh = _file(key, occluder.mesh, named)
    return _file_tables.OccluderTable.model_construct(mesh=mesh, **values)


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
