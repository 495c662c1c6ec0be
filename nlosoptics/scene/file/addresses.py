"""Dotted addresses of the values in a scene file, such as ``occluder[0].position``."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from ..._checks import counted
from ...errors import SceneError
from ..parts._quantities import Kind
from ..parts.library import lobe_tables
from .units import parse, written

_ADDRESS = re.compile(r"[A-Za-z_]\w*(\[\d+\])*(\.[A-Za-z_]\w*(\[\d+\])*)+")
_KEYS = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")
#: Address of a signed number that stands for the shape and radius of a wall.
CURVATURE = "wall.curvature"
#: Keys of a camera of which either determines the other; an override replaces both.
CAMERA_PAIRS = (("focal_length", "field_of_view"), ("stop_diameter", "f_number"))
#: Keys that say the same thing in two ways, by table. Setting one side removes the other.
_ALTERNATIVES = (
    ("laser", ("position",), ("distance", "incidence", "azimuth")),
    *(("camera", (one,), (other,)) for one, other in CAMERA_PAIRS),
)

#: Values that change neither the wave nor the point spread at the object's reference point.
NOT_IN_POINT_SPREAD = (
    "laser.power",
    "laser.beam_diameter",
    "laser.independent_patterns",
    "hidden.image",
    "hidden.size",
    "hidden.material",
    "camera.exposure",
    "camera.quantum_efficiency",
    "camera.transmission",
    "camera.full_well",
    "camera.read_noise",
    "camera.dark_current",
    "camera.bit_depth",
    "camera.glare_fraction",
)


def parsed(changes: list[str]) -> dict[str, Any]:
    """Return changes such as ``wall.radius=2 m`` as values by address.

    A value is read like one of a scene file; text needs no quotation marks.
    """
    values: dict[str, Any] = {}
    for change in changes:
        address, equals, text = change.partition("=")
        address = address.strip()
        if not equals:
            raise SceneError(f"--set {change!r} has no value; write for example wall.radius=2m")
        if address in values:
            raise SceneError(f"--set {address} is given twice; give one value")
        try:
            values[address] = tomllib.loads(f"value = {text}")["value"]
        except ValueError:  # no TOML, or an integer of too many digits for Python
            values[address] = text.strip()
    return values


def value_at(raw: Mapping[str, Any], address: str) -> Any:
    """Return the value at an address, as the file writes it; None where the file has none."""
    if address == CURVATURE:
        return written(_curvature(raw["wall"]), Kind.CURVATURE)
    place: Any = raw
    for name, index in _KEYS.findall(address):
        try:
            place = _lobes_of(place)[int(index)] if index else place[name]
        except (KeyError, IndexError, TypeError):
            return None
    return place


def _lobes_of(value: Any) -> Any:
    """Return the lobe tables of a material's name; another value as it is."""
    return lobe_tables(value) if isinstance(value, str) else value


def changed(raw: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a scene file's tables with other values at some addresses."""
    tables = copy.deepcopy(raw)
    for address in changes:
        if not _ADDRESS.fullmatch(str(address)):
            raise SceneError(
                f"{address!r} is not the address of a value; write for example wall.radius or "
                "occluder[0].position"
            )
    for table, one, other in _ALTERNATIVES:
        for new, old in ((one, other), (other, one)):
            if any(f"{table}.{key}" in changes for key in new):
                for key in old:
                    tables.get(table, {}).pop(key, None)
    for address, value in changes.items():
        _set(tables, address, value)
    wall = tables.get("wall")
    if isinstance(wall, dict) and "curvature" in wall:
        if "radius" in wall and (CURVATURE not in changes or "wall.radius" in changes):
            raise SceneError("wall.radius and wall.curvature are both given; remove one of them")
        tables["wall"] = _bent(wall)
    return tables


def _curvature(wall: Mapping[str, Any]) -> float:
    """Return the signed curvature of a wall's spheres and cylinders, 1/m, positive if concave."""
    if wall.get("shape") == "sum":
        return sum(map(_curvature, wall.get("terms", ())))
    bend = str(wall.get("shape")).partition("_")[0]
    sign = {"concave": 1.0, "convex": -1.0}.get(bend, 0.0)
    return sign / parse(wall["radius"], Kind.LENGTH) if sign else 0.0


def _bent(wall: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a wall whose key ``curvature`` is written as shape and radius.

    It replaces the curvature of a flat or curved wall; to all others a sphere is added.
    """
    try:
        curvature = parse(wall["curvature"], Kind.CURVATURE)
    except ValueError as error:
        raise SceneError(f"{CURVATURE} = {wall['curvature']!r} {error}") from None
    surface = {key: wall[key] for key in ("size", "material", "roughness") if key in wall}
    own = {key: value for key, value in wall.items() if key not in (*surface, "curvature")}
    shape = str(own.get("shape"))
    flat, cylinder = {"shape": "flat"}, shape.endswith("cylinder")
    curved = flat
    if curvature:
        bend, kind = "concave" if curvature > 0 else "convex", "cylinder" if cylinder else "sphere"
        curved = {"shape": f"{bend}_{kind}", "radius": written(1 / abs(curvature), Kind.LENGTH)}
        curved |= {"axis": own["axis"]} if cylinder and "axis" in own else {}
    if shape == "flat" or shape.startswith(("concave", "convex")):
        return curved | surface
    if shape != "sum":
        if not curvature:
            return own | surface
        size = {"size": surface["size"]} if "size" in surface else {}
        terms = [own | size]
    else:
        terms = [term for term in own["terms"] if not _curvature(term)]
    return {"shape": "sum", "terms": [*terms, curved]} | surface


def _set(tables: dict[str, Any], address: str, value: Any) -> None:
    """Set the value at an address."""
    keys: list[str | int] = [
        int(index) if index else name for name, index in _KEYS.findall(address)
    ]
    place: Any = tables
    path = ""
    for depth, key in enumerate(keys):
        last = depth + 1 == len(keys)
        if isinstance(key, int):
            if not isinstance(place, list):
                raise SceneError(f"{address}: {path} is not a list here; leave out [{key}]")
            if key >= len(place):
                raise SceneError(
                    f"{address}: {path} has {counted(len(place), 'element')}, counted from 0; "
                    "give a smaller index, or write the list in the file"
                )
        elif not isinstance(place, dict):
            kind = "a list; give an index such as [0]" if isinstance(place, list) else "one value"
            raise SceneError(f"{address}: {path} is {kind}")
        path += f"[{key}]" if isinstance(key, int) else f".{key}" if path else key
        if last:
            place[key] = copy.deepcopy(value)
        elif isinstance(key, int):
            place = place[key]
        else:
            inner = place.setdefault(key, {})
            if key == "material" and isinstance(inner, str):
                try:
                    place[key] = inner = lobe_tables(inner)
                except SceneError as error:
                    raise SceneError(f"{path} = {error}") from None
            place = inner
