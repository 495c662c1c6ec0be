"""Library of wall materials by name, with the source and the spread of each value.

The values are in ``library.toml``.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from ...errors import SceneError
from .materials import (
    Lambert,
    Material,
    OrenNayar,
    Retroreflector,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)

#: Material class of each kind of lobe in a scene file.
LOBE_CLASSES: dict[str, type[Material]] = {
    "lambert": Lambert,
    "oren_nayar": OrenNayar,
    "retroreflector": Retroreflector,
    "specular": SpecularMicrofacet,
    "ward": Ward,
}
ANGLES = ("slope_rms",)  # keys whose values are angles, rad


@dataclass(frozen=True, kw_only=True)
class MaterialValue:
    """One value of a named material, with its spread and source.

    Parameters
    ----------
    address : str
        Place of the value within the material: number of the lobe, from 0, and key, such as
        "[1].slope_rms" for the slope of the second lobe.
    value : float
        Value, in rad for a slope, otherwise without unit.
    low, high : float
        Smallest and largest value to expect for a real surface of this name.
    basis : str
        How the value was obtained. "published": it is stated in the source. "fitted": it is the rms
        slope of a lobe fitted to measured reflectance. "computed": it follows from constants of the
        material, such as the refractive index. "estimate": it is an informed guess with wide
        limits.
    source : str
        Publication with the table used, or how the value was estimated.

    """

    address: str
    value: float
    low: float
    high: float
    basis: str
    source: str

    @property
    def key(self) -> str:
        """Key of the value in the table of its lobe in a scene file, such as "slope_rms"."""
        return self.address.partition(".")[2]

    @property
    def unit(self) -> str:
        """Unit of ``value``, ``low`` and ``high``: "rad" for a slope, otherwise empty."""
        return "rad" if self.key in ANGLES else ""


@dataclass(frozen=True, kw_only=True)
class NamedMaterial:
    """Wall material of the built-in library, with range and source of each value.

    Parameters
    ----------
    name : str
        Name by which a scene file refers to the material.
    what : str
        Description of the surface.
    note : str
        Restrictions on the use of the material; may be empty.
    material : Material
        Bidirectional reflectance: one lobe, or a sum of lobes.
    values : tuple of MaterialValue
        Values of all lobes, each with its range and source.

    See Also
    --------
    material_library : All materials by name.
    """

    name: str
    what: str
    note: str
    material: Material
    values: tuple[MaterialValue, ...]

    @property
    def is_estimate(self) -> bool:
        """Whether all values of the material are estimates."""
        return all(value.basis == "estimate" for value in self.values)

    def __str__(self) -> str:
        """Return surface, values, spreads and sources as text."""
        lines = [f"{self.name}: {self.what}"]
        for v in self.values:
            spread = f"{v.low:.4g} to {v.high:.4g} {v.unit}".rstrip()
            lines += [
                f"  {v.address:16s} {v.value:.4g} {v.unit}".rstrip() + f"  ({spread}), {v.basis}",
                f"      {v.source}",
            ]
        return "\n".join(lines + ([f"  {self.note}"] if self.note else []))


def material_library() -> Mapping[str, NamedMaterial]:
    """Return all wall materials of the built-in library by name.

    Returns
    -------
    mapping of str to NamedMaterial
        Read-only mapping from name, such as "whiteboard", to material.

    See Also
    --------
    named_material : Material with a given name.

    Examples
    --------
    >>> from nlosoptics.scene import material_library
    >>> slope = material_library()["whiteboard"].values[-1]
    >>> slope.address, slope.low, slope.value, slope.high, slope.basis
    ('[1].slope_rms', 0.001, 0.002509, 0.02, 'fitted')
    """
    return MappingProxyType(_library())


def named_material(name: str) -> Material:
    """Return a wall material of the built-in library, such as "whiteboard".

    Parameters
    ----------
    name : str
        Name in the library. Case, hyphens and underscores do not matter.

    Returns
    -------
    Material
        One lobe, or a sum of lobes.

    Raises
    ------
    SceneError
        If the library has no such name; the message lists near ones and all others.

    See Also
    --------
    material_library : All materials, with ranges and sources.

    Examples
    --------
    >>> from nlosoptics.scene import named_material
    >>> named_material("white ceramic tile").mirror_lobes
    (Ward(rho=0.05, alpha=0.071, variant='1992'),)
    """
    return entry(name).material


def lobe_tables(name: str) -> list[dict[str, Any]]:
    """Return the lobes of a named material as a scene file writes them."""
    return [
        {key: f"{value!r} rad" if key in ANGLES else value for key, value in lobe.items()}
        for lobe in _lobes(_entries()[entry(name).name])
    ]


def entry(name: str) -> NamedMaterial:
    """Return the library's entry of a name; raise `SceneError` for an unknown name."""
    library = _library()
    plain = {_plain(known): material for known, material in library.items()}
    wanted = _plain(str(name))
    if wanted not in plain:
        near = [known for known in plain if wanted and wanted in known]
        near += difflib.get_close_matches(wanted, plain, n=3, cutoff=0.5)
        hint = " or ".join(f'"{plain[one].name}"' for one in list(dict.fromkeys(near))[:3])
        raise SceneError(
            f"{name!r} is not in the library of materials; "
            + (f"did you mean {hint}? Its" if near else "its")
            + f" names are {', '.join(library)}"
        )
    return plain[wanted]


def _plain(name: str) -> str:
    return " ".join(name.lower().replace("-", " ").replace("_", " ").split())


@cache
def _file() -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath("library.toml").read_text(encoding="utf-8"))


@cache
def _entries() -> dict[str, dict[str, Any]]:
    return {entry["name"]: entry for entry in _file()["material"]}


def _lobes(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the lobes of a table of the file with bare values."""
    return [
        {key: given["value"] if isinstance(given, dict) else given for key, given in lobe.items()}
        for lobe in table["lobe"]
    ]


@cache
def _library() -> dict[str, NamedMaterial]:
    sources, found = _file()["source"], {}
    for name, table in _entries().items():
        parts = [
            LOBE_CLASSES[lobe["lobe"]](**{key: lobe[key] for key in lobe if key != "lobe"})
            for lobe in _lobes(table)
        ]
        values = tuple(
            MaterialValue(
                address=f"[{index}].{key}",
                value=given["value"],
                low=given["from"],
                high=given["to"],
                basis=given["basis"],
                source=sources[given["source"]],
            )
            for index, lobe in enumerate(table["lobe"])
            for key, given in lobe.items()
            if isinstance(given, dict)
        )
        found[name] = NamedMaterial(
            name=name,
            what=table["what"],
            note=table["note"],
            material=parts[0] if len(parts) == 1 else SumMaterial(*parts),
            values=values,
        )
    return found
