"""JSON schema of scene files, with descriptions from the docstrings of the dataclasses."""

from __future__ import annotations

import inspect
from typing import Any

from ..parts.camera import Camera
from ..parts.hidden import MeshObject, PlanarObject
from ..parts.laser import Laser
from ..parts.materials import Lambert, OrenNayar, SpecularMicrofacet, Ward
from ..parts.occluders import Occluder
from ..parts.transient_scan import TransientScan
from ..walls.analytic import ConcaveWall, FlatWall, SumWall, WavyWall
from ..walls.height_maps import HeightMapWall
from ..walls.mesh_walls import MeshWall
from ..walls.relief import FacetWall, GaussianWall
from ..walls.roughness import WallRoughness
from . import tables


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
    """Return the description of each parameter of a numpydoc docstring, in one line."""
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
    return notes


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
        form = f" ({schema['description']})" if "description" in schema else ""
        schema["description"] = notes[key] + form
    example = tables.example(section, key)
    if example is not None and not schema.keys() & {"const", "enum"}:
        schema["examples"] = [example]
