"""JSON schema of scene files, with descriptions from the docstrings of the dataclasses."""

from __future__ import annotations

import inspect
import re
from typing import Any

from ..parts.camera import Camera
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.laser import Laser
from ..parts.materials import Lambert, OrenNayar, SpecularMicrofacet, Ward
from ..parts.occluders import Occluder
from ..parts.spectrum import Spectrum
from ..parts.transient_scan import TransientScan
from ..walls.analytic import ConcaveWall, FlatWall, SumWall, WavyWall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from ..walls.relief import FacetWall, GaussianWall
from ..walls.roughness import WallRoughness
from . import tables

#: Descriptions of keys that every wall has, which are parts of the scene and not of the wall.
WALL_KEYS = {
    "material": "Bidirectional reflectance of the wall: one lobe (a table), a sum of lobes (an "
    "array of tables), or the name of a material of the library. By default matt paint of albedo "
    "0.7 with a smooth mirror-like lobe of reflectance 0.05.",
    "roughness": "Random or measured heights that are added to the wall. They determine the slope "
    "of its mirror-like lobes. By default no heights are added.",
}


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors that complete and check TOML.

    Returns
    -------
    dict
        Schema after draft 2020-12, with a description and an example of every key.
    """
    schema = tables.SceneFile.model_json_schema()
    documented: dict[str, Any] = {
        "LaserTable": Laser,
        "FlatTable": FlatWall,
        "SphereTable": ConcaveWall,
        "CylinderTable": ConcaveWall,
        "WavyTable": WavyWall,
        "SumTable": SumWall,
        "MeshWallTable": MeshWall,
        "HeightMapTable": HeightMapWall,
        "RandomTable": HeightMapWall.random,
        "FacetsTable": FacetWall,
        "GaussianTable": GaussianWall,
        "RoughMapTable": HeightMapWall,
        "PictureTable": PlanarObject,
        "MeshObjectTable": MeshObject,
        "OccluderTable": Occluder,
        "CameraTable": Camera,
        "TransientTable": TransientScan,
        "SpectrumTable": Spectrum,
        "LambertTable": Lambert,
        "OrenNayarTable": OrenNayar,
        "SpecularTable": SpecularMicrofacet,
        "WardTable": Ward,
    }
    for name, table in schema["$defs"].items():
        notes = _parameter_notes(inspect.getdoc(documented[name]) or "")
        notes |= {
            "realisation": _parameter_notes(inspect.getdoc(WallRoughness) or "")["realisation"]
        }
        notes |= WALL_KEYS if "shape" in table["properties"] else {}
        section = "wall" if name in ("HeightMapTable", "RandomTable") else ""
        section = (
            "roughness" if name in ("FacetsTable", "GaussianTable", "RoughMapTable") else section
        )
        for key, value in table["properties"].items():
            _tidy(key, value, notes, section)
    _tidy("", schema, {})
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "nlosoptics scene",
        **schema,
    }


def _parameter_notes(docstring: str) -> dict[str, str]:
    """Return the description of each parameter of a numpydoc docstring, in one line.

    References such as [1]_ and the marks of code are left out.
    """
    notes: dict[str, str] = {}
    names: list[str] = []
    _, _, section = docstring.partition("Parameters\n----------\n")
    for line in section.splitlines():
        if line.startswith("---"):
            break
        if line and not line.startswith(" "):
            names = line.partition(" : ")[0].strip().lstrip("*").split(", ")
        elif line:
            for name in names:
                notes[name] = f"{notes.get(name, '')} {line.strip()}".strip()
    return {name: re.sub(r" \[\d+\]_|``?", "", note) for name, note in notes.items()}


def _tidy(key: str, schema: dict[str, Any], notes: dict[str, str], section: str = "") -> None:
    """Remove null types, which TOML does not have, and add description and example of ``key``."""
    schema.pop("title", None)
    if "default" in schema and schema["default"] is None:
        del schema["default"]
    choices = [choice for choice in schema.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) == 1:
        del schema["anyOf"]
        schema.update({**choices[0], **schema})
    elif choices:
        schema["anyOf"] = choices
    if key in notes:
        form = f" Written as {schema['description']}." if "description" in schema else ""
        schema["description"] = notes[key] + form
    example = tables.example(section, key)
    if example is not None and not schema.keys() & {"const", "enum"}:
        schema["examples"] = [example]
