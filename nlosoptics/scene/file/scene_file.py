"""Scene files: TOML in which lengths, times, rates, powers and angles carry their units.

A file has the tables ``[wall]``, ``[hidden]`` and ``[camera]``, and usually ``[laser]``. It may
have ``[transient]``, ``[burst]``, ``[ambient]`` and any number of ``[[occluder]]``.
``[wall.material]`` and ``[hidden.material]`` are one lobe; with double brackets they are a sum of
lobes; ``material = "whiteboard"`` takes the lobes of the library. ``[wall.roughness]`` is a relief
on the wall. ``[camera]`` may name another ``file`` with a camera table and override its keys. Paths
are relative to the file that contains them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..._checks import in_range, positive
from ..._whole_files import write_whole
from ...errors import SceneError
from ..parts._quantities import Kind
from ..parts._sources import SourceFile
from ..parts.camera import Camera
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.laser import NO_LASER, Laser
from ..parts.materials import Material, SumMaterial
from ..parts.occluders import Occluder
from ..parts.spectrum import Spectrum
from ..walls.analytic import SumWall, Wall
from ..walls.mesh_walls import MeshWall
from ..walls.roughness import WallRoughness
from . import tables as _file_tables
from .addresses import CAMERA_PAIRS, CURVATURE, changed, value_at
from .errors import located, validated
from .schema import scene_schema
from .text import saved_files, scene_files
from .units import written

__all__ = ["read_scene", "save_scene", "scene_files", "scene_schema"]

T = TypeVar("T")
#: Returns the path of a picture, mesh or height map by its name in a table.
Opener = Callable[[str], Path]

SURFACE = ("material", "roughness")  # keys of a wall that are parts of the scene


def read_scene(
    path: str | Path, scene: Callable[..., T], changes: Mapping[str, Any] | None = None
) -> T:
    """Read a scene file, and open the images and meshes that it names."""
    path = Path(path)
    raw = scene_tables(path, changes)
    return scene_from_tables(raw, path, lambda name: _resolved(path.parent, name), scene, {})


def scene_tables(path: Path, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the tables of a scene file as the file writes them, without a file for the camera."""
    raw = _read(path)
    with located(f"{path}: "):
        raw = changed(raw, {})
        validated(_file_tables.SceneFile, raw)
    raw["camera"] = _whole_camera(path, raw["camera"], (path.resolve(),))
    with located(f"{path}: "):
        raw = changed(raw, changes or {})
        validated(_file_tables.SceneFile, raw)
    if "file" in raw["camera"]:  # one of the changes
        raw["camera"] = _whole_camera(path, raw["camera"], (path.resolve(),))
    return raw


def scene_from_tables(
    raw: dict[str, Any],
    path: Path,
    opened: Opener,
    scene: Callable[..., T],
    changes: Mapping[str, Any],
    parts: dict[str, Any] | None = None,
) -> T:
    """Return the scene of tables from `scene_tables`."""
    with located(f"{path}: "):
        tables: _file_tables.SceneFile = validated(_file_tables.SceneFile, changed(raw, changes))
    parts = {} if parts is None else parts

    def part(make: Callable[[Any, Any], Any], table: Any, key: Any) -> Any:
        text = f"{make.__name__} {key!r}"
        if text not in parts:
            parts[text] = make(table, opened)
        return parts[text]

    with located(f"{path}: "):
        optional: dict[str, Any] = {}
        if tables.wall.material is not None:
            optional["wall_material"] = _material("wall.material", tables.wall.material)
        if tables.wall.roughness is not None:
            optional["wall_roughness"] = _roughness(
                tables.wall.roughness, optional.get("wall_material"), opened
            )
        for key in _file_tables.OPTIONAL:
            if (table := getattr(tables, key)) is not None:
                optional[key] = table.source(**_given(table))
        if tables.ambient is not None:
            optional["ambient_irradiance"] = tables.ambient.irradiance
        made = scene(
            NO_LASER if tables.laser is None else _laser(tables.laser),
            part(_wall, tables.wall, _given(tables.wall, *SURFACE)),
            part(_hidden, tables.hidden, tables.hidden),
            _camera(_given(tables.camera)),
            part(_occluders, tables.occluder or [], tables.occluder),
            **optional,
        )
        _open_files(made)
    return made


def changed_scene(scene: T, changes: Mapping[str, Any]) -> T:
    """Return a scene with other values by address, numbers in SI units or texts with a unit."""
    raw, files = own_tables(scene)

    def opened(name: str) -> Path:
        return SourceFile.held(name, files[name]) if name in files else _resolved(Path(), name)

    return scene_from_tables(raw, Path("scene"), opened, type(scene), with_units(raw, changes))


def own_tables(scene: Any) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return the tables of a scene, and the contents of the files that they name."""
    files = scene_files(scene)
    return tomllib.loads(files.pop("scene.toml").decode()), files


def with_units(raw: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by address, numbers as texts with their SI units as a file writes them."""
    values = {a: np.asarray(v).tolist() if _is_number(v) else v for a, v in changes.items()}
    bent: Any = values.get(CURVATURE)
    if _is_number(bent):
        values[CURVATURE] = written(bent, Kind.CURVATURE)
    with located("scene: "):
        table = validated(_file_tables.SceneFile, changed(raw, values), si=True)
    whole = table.model_dump(exclude_none=True)
    return {a: value_at(whole, a) if _is_number(v) else v for a, v in values.items()}


def _is_number(value: Any) -> bool:
    """Whether a value is a number, or a list or array of numbers."""
    if isinstance(value, list | tuple):
        return all(map(_is_number, value))
    return isinstance(value, np.ndarray | Real) and not isinstance(value, bool)


def save_scene(scene: Any, path: str | Path) -> None:
    """Write a scene file that `Scene.load` reads back without any change of values.

    Images, heights and meshes that came from files are not copied; the scene file refers to them by
    paths relative to its own folder. Those in memory, and those whose file is missing or was
    changed, are written losslessly next to the scene file. Their names consist of its stem and
    their key, for ``room.toml``: ``room_hidden_image.png`` (``.npy`` if the values are no 8- or
    16-bit levels), ``room_wall_heights.npy`` and ``room_wall_mesh.ply``. If writing fails, no
    incomplete file is left behind.
    """
    path = Path(path)
    if path.is_dir():
        raise SceneError(f"{path} is a folder; name a file")
    with located(f"{path}: "):
        files = saved_files(scene, path)
    write_whole({**files, path: files[path]})


def _read(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise `SceneError` if it cannot be read."""
    if not path.is_file():
        what = "a folder" if path.is_dir() else "missing"
        raise SceneError(f"{path}: the scene file is {what}; give the path of a TOML file")
    try:
        text = path.read_text(encoding="utf-8")
        # a parser's time grows with the square of both
        if len(text) > 4_000_000 or max(map(len, text.splitlines()), default=0) > 20_000:
            raise SceneError(
                f"{path}: {len(text)} characters, limit 4,000,000 and 20,000 in a line; give a "
                "scene file, and keep heights and meshes in files of their own"
            )
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{path}: byte {error.start} is not UTF-8 text; give a TOML file"
        ) from None
    except RecursionError:
        raise SceneError(f"{path}: tables are nested too deeply; give a scene file") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: not TOML: {error}; correct that line") from None
    except SceneError:
        raise
    except ValueError:  # of Python, for an integer of more than 4300 digits
        raise SceneError(f"{path}: an integer has thousands of digits; give fewer") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); check the file") from None


def _given(table: Any, *without: str) -> dict[str, Any]:
    """Return the keys that the file sets; the others get the defaults of the dataclasses."""
    return {name: getattr(table, name) for name in table.model_fields_set if name not in without}


def _made(place: str, table: Any, opened: Opener, *without: str) -> Any:
    """Return the part of a table; ``place`` is the table's key."""
    values = _given(table, *without)
    for name in values.keys() & _file_tables.FILES:
        values[name] = opened(values[name])
    if table.source is PlanarObject:
        values.setdefault("image", None)
    if "material" in values:
        values["material"] = _material(f"{place}.material", values["material"])
    return table.source(**values, **table.fixed)


def _laser(table: Any) -> Laser:
    """Return the laser, with its position from distance and incidence if these are given."""
    values = _given(table, "distance", "incidence", "azimuth")
    polar = [name for name in ("distance", "incidence") if name in table.model_fields_set]
    if table.position is not None:
        if polar or table.azimuth is not None:
            raise SceneError(
                f"laser.{(*polar, 'azimuth')[0]} and laser.position are both given; give position, "
                "or distance and incidence"
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


def _wall(table: Any, opened: Opener) -> Wall:
    """Return the wall of a table."""
    if table.shape == "sum":
        return SumWall(*_terms(table.terms, opened), **_given(table, "shape", "terms", *SURFACE))
    wall: Wall = _made("wall", table, opened, "shape", *SURFACE)
    return wall


def _terms(tables: list[Any], opened: Opener) -> Iterator[Wall]:
    """Yield the summands of a wall."""
    for index, table in enumerate(tables):
        for key in SURFACE:
            if getattr(table, key) is not None:
                raise SceneError(
                    f"wall.terms[{index}].{key} belongs to a summand, which has no {key} of its "
                    f"own; move it to wall.{key}"
                )
        with located(f"wall.terms[{index}].", "wall."):
            yield _wall(table, opened)


def _roughness(table: Any, material: Material | None, opened: Opener) -> WallRoughness:
    """Return the roughness of a table; a slope that it omits is that of a mirror-like lobe."""
    values = _given(table, "model", "realisation")
    with located("wall.roughness.", "wall."):
        if table.model == "height_map":
            values["heights"] = opened(values["heights"])
        elif table.model == "gaussian":
            values = _with_height(values, material)
        elif "slope_rms" not in values:
            values["slope_rms"] = _lobe_slope(material, "slope_rms")
        heights = table.source(**values)
    with located("wall.roughness.", "wall_roughness."):
        return WallRoughness(heights, **_given(table, *values, "slope_rms", "model"))


def _with_height(values: dict[str, Any], material: Material | None) -> dict[str, Any]:
    """Return the keys of Gaussian roughness with ``height_rms`` in place of its slope."""
    if "height_rms" in values:
        if "slope_rms" in values:
            raise SceneError(
                "height_rms and slope_rms are both given, limit is one of them; remove the other"
            )
        return values
    slope = values.pop("slope_rms", None)
    if slope is None:
        slope = _lobe_slope(material, "height_rms or slope_rms")
    slope = in_range("slope_rms", slope, 0.0, 1.0, unit="rad")
    length = positive("correlation_length", values["correlation_length"], unit="m")
    return {**values, "height_rms": slope * length / math.sqrt(2.0)}


def _lobe_slope(material: Material | None, missing: str) -> float:
    """Return the slope of the wall's mirror-like lobe, which replaces the key ``missing``."""
    lobes = () if material is None else material.mirror_lobes
    slopes = [lobe.slope_rms for lobe in lobes if lobe.slope_rms > 0.0]
    if not slopes:
        raise SceneError(
            f"{missing} is missing, and no mirror-like lobe of wall.material has a slope; add for "
            'example slope_rms = "2 mrad"'
        )
    return slopes[0]


def _hidden(table: Any, opened: Opener) -> PlanarObject | MeshObject:
    """Return the hidden object of a table."""
    hidden: PlanarObject | MeshObject = _made("hidden", table, opened)
    return hidden


def _occluders(tables: list[Any], opened: Opener) -> tuple[Occluder, ...]:
    """Return the occluders of a scene file."""
    occluders = []
    for index, table in enumerate(tables):
        with located(f"occluder[{index}].", "occluder."):
            occluders.append(_made("occluder", table, opened))
    return tuple(occluders)


def _resolved(folder: Path, name: str) -> Path:
    """Return the absolute path of a file named relative to ``folder``."""
    try:
        path = (folder / name).resolve()
        path.stat()
    except FileNotFoundError:
        pass  # told with the key's name where the file is opened
    except (OSError, ValueError) as error:  # a null character is a ValueError
        raise SceneError(
            f"{name[:60]!r} cannot be the path of a file ({getattr(error, 'strerror', error)}); "
            "correct it"
        ) from None
    return path


def _material(name: str, table: Any) -> Material:
    """Return the material of one lobe table or of a list of them; ``name`` is its key."""
    if isinstance(table, list):
        parts = [_lobe(f"{name}[{index}].", lobe) for index, lobe in enumerate(table)]
        with located(f"{name}: "):
            return SumMaterial(*parts)
    return _lobe(f"{name}.", table)


def _lobe(place: str, table: Any) -> Material:
    """Return the material of one lobe table; errors are prefixed with ``place``."""
    values = _given(table, "lobe")
    if "index" in values:
        values["index"] = complex(*values["index"])
    for key, value in values.items():
        if isinstance(value, _file_tables.SpectrumTable):
            with located(f"{place}{key}."):
                values[key] = Spectrum(**_given(value))
    with located(place):
        lobe: Material = table.source(**values)
        return lobe


def _whole_camera(path: Path, own: dict[str, Any], seen: tuple[Path, ...]) -> dict[str, Any]:
    """Return a checked camera table of a file, joined with that of the file that it names.

    ``seen`` are the files read so far, to find a circular reference.
    """
    for one, other in CAMERA_PAIRS:
        if one in own and other in own:
            raise SceneError(
                f"{path}: camera.{other} and camera.{one} are both given, limit is one of them; "
                "remove the other"
            )
    if "file" not in own:
        return own
    name = own["file"]
    with located(f"{path}: camera.file = "):
        file = _resolved(path.parent, name)
    if file in seen:
        raise SceneError(f"{path}: camera.file = {name!r} leads back to itself; remove it")
    if not file.is_file():
        raise SceneError(
            f"{path}: camera.file = {name!r}: there is no file {file}; give the path of a TOML "
            "file with a [camera] table"
        )
    raw = _read(file)
    with located(f"{file}: "):
        validated(_file_tables.CameraFile, raw)
    values = _whole_camera(file, raw["camera"], (*seen, file))
    return _without_alternatives(values, own) | {k: own[k] for k in own if k != "file"}


def _without_alternatives(values: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return camera values without those that the keys of ``own`` replace."""
    gone = {name for pair in CAMERA_PAIRS if not own.keys().isdisjoint(pair) for name in pair}
    return {name: value for name, value in values.items() if name not in gone}


def _camera(values: dict[str, Any]) -> Camera:
    """Return the camera, with field of view and F-number converted to focal length and stop."""
    for name in ("position", "aim"):
        if name not in values:
            raise SceneError(f"camera.{name} is missing; add {name} with three lengths")
    for pair in CAMERA_PAIRS:
        if not any(name in values for name in pair):
            raise SceneError(f"camera.{pair[0]} is missing; add {pair[0]} or {pair[1]}")
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
    """Open all files of the scene, so that a missing or broken one is reported at once."""
    hidden, wall = scene.hidden, scene.wall
    _ = hidden.surface if isinstance(hidden, MeshObject) else hidden.reflectance
    if isinstance(wall, MeshWall):
        _ = wall.size
    for index, occluder in enumerate(scene.occluders):
        with located(f"occluder[{index}].", "occluder."):
            _ = occluder.surface if isinstance(occluder, Occluder) else occluder
