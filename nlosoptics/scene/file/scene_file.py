"""Scene files: TOML whose lengths, times, powers and angles carry their unit.

A file has the tables ``[laser]``, ``[wall]``, ``[hidden]`` and ``[camera]``, and any number of
``[[occluder]]``, and may have ``[transient]``; ``[wall.material]`` and ``[hidden.material]`` are
one lobe, or with double brackets a sum of lobes. ``[camera]`` may name a ``file`` with a camera
table, whose keys it may override. Paths are relative to the file that they stand in.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from ..._checks import in_range, positive
from ..._whole_files import write_whole
from ...errors import SceneError
from ..parts.camera import Camera
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.laser import Laser
from ..parts.materials import Lambert, Material, OrenNayar, SpecularMicrofacet, SumMaterial, Ward
from ..parts.occluders import Occluder
from ..parts.transient_scan import TransientScan
from ..walls.analytic import ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from . import tables as _file_tables
from .errors import located, missing_key, validated
from .schema import scene_schema
from .text import saved_files, scene_files

__all__ = ["read_scene", "save_scene", "scene_files", "scene_schema"]

T = TypeVar("T")

#: Either key of a pair determines the other; an override replaces both.
_ALTERNATIVES = (("focal_length", "field_of_view"), ("stop_diameter", "f_number"))


def read_scene(path: str | Path, scene: Callable[..., T]) -> T:
    """Read a scene file, and open the pictures and meshes that it names.

    Parameters
    ----------
    path : str or Path
        TOML file.
    scene : callable
        Called with laser, wall, hidden object, camera and occluders, and the optional keywords
        ``wall_material`` and ``transient``; `Scene`, which is above this file in the import order.

    Returns
    -------
    Scene
        Whatever ``scene`` returns.

    Raises
    ------
    SceneError
        In one line that names file, key, value, limit and remedy.
    SamplingError, MemoryLimitError
        The same, if the pitch of a random wall is too coarse or too fine.
    """
    path = Path(path)
    folder = path.parent
    raw = _read(path)
    with located(f"{path}: "):
        tables: _file_tables.SceneFile = validated(_file_tables.SceneFile, raw)
    camera = _camera_values(path, tables.camera, (path.resolve(),))
    with located(f"{path}: "):
        optional: dict[str, Any] = {}
        if tables.wall.material is not None:
            optional["wall_material"] = _material("wall.material", tables.wall.material)
        if tables.transient is not None:
            optional["transient"] = TransientScan(**_given(tables.transient))
        made = scene(
            _laser(tables.laser),
            _wall(tables.wall, folder),
            _hidden(tables.hidden, folder),
            _camera(camera),
            tuple(_occluders(tables.occluder or [], folder)),
            **optional,
        )
        _open_files(made)
    return made


def save_scene(scene: Any, path: str | Path) -> None:
    """Write a scene file that `Scene.load` reads back to a scene of the same numbers.

    Pictures, heights and meshes that came from files stay where they are; the scene file names them
    relative to its own folder. Those in memory, and those whose file is gone or was changed, are
    written next to it without loss, under its name and their key, such as ``room_hidden_image.png``
    (``.npy`` where a picture's values are no 8- or 16-bit levels), ``room_wall_heights.npy`` and
    ``room_wall_mesh.ply``. All files appear complete or not at all.

    Parameters
    ----------
    scene : Scene
    path : str or Path
        Where to write; existing files of these names are replaced.

    Raises
    ------
    SceneError
        If the folder does not exist, or a wall or material has no form in a scene file.
    """
    path = Path(path)
    if path.is_dir():
        raise SceneError(f"{path} is a folder; name a file")
    with located(f"{path}: "):
        files = saved_files(scene, path)
    write_whole(files)


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        what = "a folder" if path.is_dir() else "missing"
        raise SceneError(f"{path}: the scene file is {what}; give the path of a TOML file")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{path}: byte {error.start} is not UTF-8 text; give a TOML file"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: not TOML: {error}; mend that line") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); check the file") from None


def _given(table: Any, *without: str) -> dict[str, Any]:
    """Keys that the file sets; the dataclasses' defaults stand for the others."""
    return {name: getattr(table, name) for name in table.model_fields_set if name not in without}


def _laser(table: _file_tables.LaserTable) -> Laser:
    values = _given(table, "distance", "incidence", "azimuth")
    polar = [name for name in ("distance", "incidence") if name in table.model_fields_set]
    if table.position is not None:
        if polar or table.azimuth is not None:
            raise SceneError(
                f"laser.{(*polar, 'azimuth')[0]} stands beside laser.position; give position, or "
                "distance and incidence"
            )
        return Laser(**values)
    if table.distance is None or table.incidence is None:
        raise SceneError(
            'laser.position is missing; give position = ["1 m", "0 m", "1 m"], or distance = '
            '"1.2 m" and incidence = "15 deg"'
        )
    distance = positive("laser.distance", table.distance, unit="m")
    incidence = in_range(
        "laser.incidence",
        table.incidence,
        0,
        math.radians(89),
        unit="rad",
        remedy="from 0 deg to 89 deg, beyond which the beam grazes the wall",
    )
    azimuth, (x, y, z) = table.azimuth or 0.0, table.aim or (0.0, 0.0, 0.0)
    across = distance * math.sin(incidence)
    position = (
        x + across * math.cos(azimuth),
        y + across * math.sin(azimuth),
        z + distance * math.cos(incidence),
    )
    return Laser(**values, position=position)


def _wall(table: Any, folder: Path) -> Wall:
    values = _given(table, "shape", "material")
    if table.shape == "mesh":
        return MeshWall(_resolved(folder, values.pop("mesh")), **values)
    if table.shape == "random":
        return HeightMapWall.random(**values)
    if table.shape == "height_map":
        return HeightMapWall(_resolved(folder, values.pop("heights")), **values)
    if table.shape == "flat":
        return FlatWall(**values)
    if table.shape == "wavy":
        return WavyWall(**values)
    if table.shape == "sum":
        return SumWall(*_terms(values.pop("terms"), folder), **values)
    bend, shape = table.shape.split("_")
    kind = ConcaveWall if bend == "concave" else ConvexWall
    return kind(values.pop("radius"), shape=shape, **values)


def _terms(tables: list[Any], folder: Path) -> Iterator[Wall]:
    for index, table in enumerate(tables):
        if table.material is not None:
            raise SceneError(
                f"wall.terms[{index}].material stands in a summand; move it to wall.material"
            )
        with located(f"wall.terms[{index}].", "wall."):
            yield _wall(table, folder)


def _hidden(table: Any, folder: Path) -> PlanarObject | MeshObject:
    values = _given(table, "material")
    if table.material is not None:
        values["material"] = _material("hidden.material", table.material)
    if isinstance(table, _file_tables.MeshObjectTable):
        return MeshObject(_resolved(folder, values.pop("mesh")), **values)
    return PlanarObject(_resolved(folder, values.pop("image")), **values)


def _occluders(tables: list[_file_tables.OccluderTable], folder: Path) -> Iterator[Occluder]:
    for index, table in enumerate(tables):
        values = _given(table)
        mesh = _resolved(folder, values.pop("mesh"))
        with located(f"occluder[{index}].", "occluder."):
            yield Occluder(mesh, **values)


def _resolved(folder: Path, name: str) -> Path:
    return (folder / name).resolve()


def _material(name: str, table: Any) -> Material:
    if isinstance(table, list):
        parts = [_lobe(f"{name}[{index}].", lobe) for index, lobe in enumerate(table)]
        with located(f"{name}: "):
            return SumMaterial(*parts)
    return _lobe(f"{name}.", table)


def _lobe(place: str, table: Any) -> Material:
    kinds: dict[str, type[Material]] = {
        "lambert": Lambert,
        "oren_nayar": OrenNayar,
        "specular": SpecularMicrofacet,
        "ward": Ward,
    }
    with located(place):
        material = kinds[table.lobe](**_given(table, "lobe"))
        return material


def _camera_values(
    path: Path, table: _file_tables.CameraTable, seen: tuple[Path, ...]
) -> dict[str, Any]:
    """Keys of a camera table over those of the file that it starts from."""
    own = _given(table, "file")
    for pair in _ALTERNATIVES:
        if all(name in own for name in pair):
            raise SceneError(
                f"{path}: camera.{pair[1]} stands beside camera.{pair[0]}, limit is one of them; "
                "remove the other"
            )
    if table.file is None:
        return own
    other = path.parent / table.file
    if other.resolve() in seen:
        raise SceneError(f"{path}: camera.file = {table.file!r} leads back to itself; remove it")
    if not other.is_file():
        raise SceneError(
            f"{path}: camera.file = {table.file!r}: there is no file {other}; give the path of a "
            "TOML file with a [camera] table"
        )
    raw = _read(other)
    with located(f"{other}: "):
        included: _file_tables.CameraFile = validated(_file_tables.CameraFile, raw)
    values = _camera_values(other, included.camera, (*seen, other.resolve()))
    for pair in _ALTERNATIVES:
        if any(name in own for name in pair):
            values = {name: value for name, value in values.items() if name not in pair}
    return values | own


def _camera(values: dict[str, Any]) -> Camera:
    """Turn field of view and F-number into focal length and stop."""
    for name in ("position", "aim"):
        if name not in values:
            raise SceneError(missing_key(f"camera.{name}", name))
    for pair in _ALTERNATIVES:
        if not any(name in values for name in pair):
            raise SceneError(missing_key(f"camera.{pair[0]}", pair[0]))
    values = dict(values)
    if "pixels" in values:
        values["pixels"] = tuple(values["pixels"])
    width = values.pop("sensor_width", None)
    field = values.pop("field_of_view", None)
    f_number = values.pop("f_number", None)
    if field is not None:
        in_range("camera.field_of_view", field, 0, 3.0, open_low=True, unit="rad")
        if width is None:
            pixels = values.get("pixels", Camera.pixels)
            width = pixels[0] * values.get("pixel_pitch", Camera.pixel_pitch)
        width = positive("camera.sensor_width", width, unit="m")
        values["focal_length"] = width / 2 / math.tan(field / 2)
    if f_number is not None:
        values["stop_diameter"] = values["focal_length"] / positive("camera.f_number", f_number)
    return Camera(**values)


def _open_files(scene: Any) -> None:
    """Meet missing and broken files now, before anything is computed."""
    hidden, wall = scene.hidden, scene.wall
    _ = hidden.surface if isinstance(hidden, MeshObject) else hidden.reflectance
    if isinstance(wall, MeshWall):
        _ = wall.size
    for index, occluder in enumerate(scene.occluders):
        with located(f"occluder[{index}].", "occluder."):
            _ = occluder.surface if isinstance(occluder, Occluder) else occluder
